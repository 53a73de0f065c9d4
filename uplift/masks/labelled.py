"""Which true shapes training may learn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from uplift.config import Settings
from uplift.data.load import of_labelled
from uplift.errors import UserError
from uplift.masks.choose import chosen_masks, wanted_masks
from uplift.masks.container import MaskData, Placed
from uplift.masks.joining import join
from uplift.meshes.mesh import Mesh

__all__ = ["known_shapes", "labelled_masks", "truth_of_labelled"]


def labelled_masks(
    settings: Settings, train: MaskData, load: Callable[[Settings], MaskData]
) -> tuple[MaskData, list[str]]:
    """Return the training masks with `MaskData.labelled` as ``data.labelled`` says, those of its file among them, and notes.

    A file's own `labelled` does not count: settings alone say what may be learned from. ``load`` returns the
    training masks that settings name. With ``data.labelled.only`` the labelled masks alone are returned.

    Raises:
        UserError: no such masks, or masks whose shapes are not known.
    """
    chosen = settings.data.labelled
    wanted = wanted_masks(chosen)
    marked = 0 if train.labelled is None else int(train.labelled.sum())
    train = replace(train, labelled=None)
    if not wanted and chosen.file is None:
        if chosen.only:
            raise UserError(
                "data.labelled.only is on, but no mask is labelled: set data.labelled.fraction (1 for all)."
            )
        return train, [
            f"train: {marked:,} masks are marked as labelled in the file; not used, as data.labelled is not set"
        ] * bool(marked)
    source = train
    if chosen.file is not None:
        data = replace(of_labelled(settings).data, simulate=0, most=None)
        source = replace(load(replace(settings, data=data)), labelled=None)
    if source.truth is None:
        raise UserError(
            f"{source.source}: holds no true shapes to learn from: data.labelled needs masks with truth "
            "(`uplift data render`)."
        )
    rows = chosen_masks(source, wanted, settings.seed)
    more = replace(source, labelled=rows)
    if chosen.file is None:
        found = more.select(rows) if chosen.only else more
    else:
        more = more.select(rows)
        blank = replace(train, labelled=np.zeros(len(train), bool), truth=train.truth or _unknown(len(train)))
        found = more if chosen.only else join([blank, more])
    count = int(rows.sum())
    where = f" from {source.source}" if chosen.file is not None else ""
    return found, [f"labelled: {count:,} of these masks, in 3D{where}"]


def truth_of_labelled(data: MaskData) -> MaskData:
    """Return the masks with the true shapes of labelled items alone; of the others nothing is left but a `scale` of NaN."""
    if data.truth is None or data.labelled is None or not data.labelled.any():
        return data.without_truth()
    truth, blank = data.truth, _unknown(len(data))
    kept, place = np.unique(truth.shape[data.labelled], return_inverse=True)
    shape = np.full(len(data), len(kept))
    shape[data.labelled] = place
    parts = {}
    for name in ("view", "scale", "offset", "distance"):
        own, none = getattr(truth, name), getattr(blank, name)
        parts[name] = np.where(data.labelled.reshape(-1, *[1] * (own.ndim - 1)), own, none)
    meshes = [truth.meshes[number] for number in kept.tolist()]
    return replace(data, truth=Placed([*meshes, *blank.meshes], shape, **parts))


def known_shapes(data: MaskData) -> MaskData | None:
    """Return the items whose true shapes are known; None without any."""
    if data.truth is None:
        return None
    known = np.isfinite(data.truth.scale)
    return data if known.all() else data.select(known) if known.any() else None


def _unknown(items: int) -> Placed:
    """Return what stands for shapes that are not known."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), "unknown", "")
    view, gap = np.repeat(np.eye(3)[None], items, 0), np.full(items, np.nan)
    return Placed([nothing], np.zeros(items, np.int64), view, gap, np.full((items, 2), np.nan), gap)
