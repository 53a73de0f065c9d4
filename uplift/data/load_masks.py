"""From settings to the masks that a fit trains on and is evaluated on: simulate or read, choose, label, split."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uplift.config.files import data_root
from uplift.config.settings import Settings
from uplift.data.concat import concat_masks
from uplift.data.load import Load, find_data, format_of, not_simulated, with_labels_of, with_test
from uplift.data.masks import MaskData, Placed
from uplift.geometry.mesh import Mesh

__all__ = ["LoadedMasks", "known_shapes", "load_mask_split", "load_masks", "truth_of_labelled", "views_of"]

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


def load_masks(settings: Settings, load: Load[MaskData] | None = None) -> LoadedMasks:
    """Return the training and test masks that ``settings.data`` names, or that ``load`` returns.

    The same settings give the same masks.

    A file's own `labelled` does not count: settings alone say what may be learned from.

    Raises UserError: a file that is missing or wrong, no masks left, labels asked for where no shape is known.
    """
    load = load or load_mask_split
    train, test = with_test(settings, load)
    notes = [*not_simulated(settings), *_notes("train", train)]
    marked = 0 if train.labelled is None else int(train.labelled.sum())
    train, more = with_labels_of(settings, replace(train, labelled=None), load)
    labelled = train if more is None else more
    if labelled.labelled is not None:
        where = f" from {labelled.source}" if settings.data.labelled.file is not None else ""
        notes.append(f"labelled: {int(labelled.labelled.sum()):,} of these masks, in 3D{where}")
    elif marked:
        why = "not used, as data.labelled is not set"
        notes.append(f"train: {marked:,} masks are marked as labelled in the file; {why}")
    if more is not None:
        blank = replace(train, labelled=np.zeros(len(train), bool), truth=train.truth or _unknown(len(train)))
        train = concat_masks([blank, more])
    if test is not None:
        test = replace(test, labelled=None)
        notes += _notes("test", test)
    return LoadedMasks(train, test, notes)


def _notes(which: str, data: MaskData) -> list[str]:
    several = 0 if data.category is None else len(np.unique(data.category))
    kinds = f", {several} categories" if several > 1 else ""
    return [f"{which}: {len(data):,} masks from {data.source}{kinds}", *(f"{which}: {note}" for note in data.notes)]


def load_mask_split(settings: Settings, which: str) -> MaskData:
    """Return the ``train`` or ``test`` masks, simulated or of files.

    Raises UserError: a file that is missing or wrong, no mask that can be used.
    """
    if settings.data.simulate and not (which == "test" and settings.data.test):
        return _simulated(settings, which)
    from uplift.data.formats import read_masks

    chosen = settings.data
    images = chosen.images
    if images is not None:
        images = str((data_root(chosen.name, chosen.root) / images).absolute())
    options = {key: getattr(chosen, key) for key in ("side", "border", "pieces", "category", "most")}
    path = find_data(settings, which)
    return read_masks(path, **options, format=format_of(chosen, path), images=images)


def _simulated(settings: Settings, which: str) -> MaskData:
    from uplift.data.synthetic.masks import simulate_masks

    chosen, seed = settings.data, settings.seed
    count, source = chosen.simulate, f"simulated {chosen.family}"
    if which == "test":  # other shapes and cameras than any training seed's
        count, seed, source = max(1, min(_MOST_TEST, count // 10)), seed + 2**31, f"{source}, other shapes"
    data = simulate_masks(chosen.family, count, seed=seed, side=chosen.side, views=views_of(settings))
    return replace(data, source=source)


def views_of(settings: Settings):
    """Return the `uplift.data.synthetic.masks.ViewChoice` of the cameras that the lifter assumes."""
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


# True shapes: which are known, and which training may see.


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
    """Return a placeholder for shapes that are not known."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), "unknown", "")
    view, gap = np.repeat(np.eye(3)[None], items, 0), np.full(items, np.nan)
    return Placed([nothing], np.zeros(items, np.int64), view, gap, np.full((items, 2), np.nan), gap)
