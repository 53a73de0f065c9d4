"""From settings to the masks that a fit trains on and is evaluated on: make up or read, choose, label, split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uplift.config.files import data_root
from uplift.config.settings import Settings
from uplift.data.concat import join
from uplift.data.load import find_data, of_labelled
from uplift.data.masks import MaskData, Placed
from uplift.data.select import chosen_masks, wanted_masks
from uplift.errors import UserError
from uplift.geometry.mesh import Mesh

__all__ = ["LoadedMasks", "known_shapes", "load_mask_split", "load_masks", "truth_of_labelled", "views_of"]

# Which true shapes training may learn from.


def _labelled_masks(
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


# From settings to the masks that a fit trains on and is evaluated on: make up or read, choose, label, split.

_MOST_TEST = 200


@dataclass(frozen=True)
class LoadedMasks:
    """What a fit of masks trains on and is evaluated on, and what was noticed on the way."""

    train: MaskData
    """Its `labelled` says which true shapes may be learned from; items without a known shape have a `scale` of NaN."""
    test: MaskData | None
    notes: list[str]

    def for_training(self) -> LoadedMasks:
        """Return what training may see: no true shape but those of labelled items."""
        test = None if self.test is None else self.test.without_truth()
        return replace(self, train=truth_of_labelled(self.train), test=test)


def load_masks(settings: Settings) -> LoadedMasks:
    """Return the training and test masks that ``settings.data`` names; the same settings give the same masks.

    Raises:
        UserError: a file that is missing or wrong, no masks left, labels asked for where no shape is known.
    """
    chosen = settings.data
    train = load_mask_split(settings, "train")
    test = load_mask_split(settings, "test") if chosen.test or chosen.simulate else None
    held_out = wanted_masks(chosen.hold_out)
    if held_out:
        if test is not None:
            other = "data.simulate, which makes up test masks of its own," if chosen.simulate else "data.test"
            raise UserError(f"{other} and data.hold_out are both set: the test masks come from one of them.")
        rows = chosen_masks(train, held_out, settings.seed)
        if rows.all():
            raise UserError(f"data.hold_out={held_out} leaves no mask to train on.")
        test, train = train.select(rows), train.select(~rows)
    wanted = wanted_masks(chosen.select)
    if wanted:
        train = train.select(chosen_masks(train, wanted, settings.seed))
    notes = _notes("train", train)
    train, told = _labelled_masks(settings, train, lambda other: load_mask_split(other, "train"))
    notes += told
    if test is not None:
        test = replace(test, labelled=None)
        notes += _notes("test", test)
    return LoadedMasks(train, test, notes)


def load_mask_split(settings: Settings, which: str) -> MaskData:
    """Return the ``train`` or ``test`` masks, made up or of files.

    Raises:
        UserError: a file that is missing or wrong, no mask that can be used.
    """
    if settings.data.simulate and not (which == "test" and settings.data.test):
        return _simulated(settings, which)
    from uplift.data.formats import read_masks

    chosen = settings.data
    images = chosen.images
    if images is not None:
        images = str((data_root(chosen.name, chosen.root) / images).absolute())
    return read_masks(
        find_data(settings, which),
        format=chosen.format,
        side=chosen.side,
        border=chosen.border,
        pieces=chosen.pieces,
        category=chosen.category,
        most=chosen.most,
        images=images,
    )


def _simulated(settings: Settings, which: str) -> MaskData:
    from uplift.data.synthetic.masks import simulate_masks

    chosen, views = settings.data, views_of(settings)
    if which == "train":
        data = simulate_masks(chosen.family, chosen.simulate, seed=settings.seed, side=chosen.side, views=views)
        return replace(data, source=f"made-up {chosen.family}")
    # Other shapes and cameras than any training seed's.
    count = max(1, min(_MOST_TEST, chosen.simulate // 10))
    data = simulate_masks(chosen.family, count, seed=settings.seed + 2**31, side=chosen.side, views=views)
    return replace(data, source=f"made-up {chosen.family}, other shapes")


def views_of(settings: Settings):
    """Return the `uplift.data.synthetic.masks.ViewChoice` of the cameras that the lifter is told of."""
    from uplift.data.synthetic.masks import ViewChoice

    mean, sd = settings.shape.elevation_deg
    low, high = ViewChoice.elevation_deg
    wide = (max(min(low, mean - 2 * sd), -90.0), min(max(high, mean + 2 * sd), 90.0))
    near = settings.shape.distance / 6
    return ViewChoice(
        elevation_deg=wide,
        elevation_mean_deg=mean,
        elevation_sd_deg=sd,
        upright=settings.shape.gravity,
        distance=(max(2.0, 4 * near), 8 * near),
    )


def _notes(which: str, data: MaskData) -> list[str]:
    several = np.unique(data.category) if data.category is not None else np.array([])
    kinds = f", {len(several)} categories" if len(several) > 1 else ""
    return [f"{which}: {len(data):,} masks from {data.source}{kinds}", *(f"{which}: {note}" for note in data.notes)]
