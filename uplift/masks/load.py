"""From settings to the masks that a fit trains on and is evaluated on: make up or read, choose, label, split."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uplift.config import Settings
from uplift.data.load import find_data
from uplift.errors import UserError
from uplift.masks.choose import chosen_masks, wanted_masks
from uplift.masks.container import MaskData
from uplift.masks.labelled import labelled_masks, truth_of_labelled
from uplift.paths import data_root

__all__ = ["LoadedMasks", "load_mask_split", "load_masks", "views_of"]

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
    train, told = labelled_masks(settings, train, lambda other: load_mask_split(other, "train"))
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
    from uplift.masks.reading import read

    chosen = settings.data
    images = chosen.images
    if images is not None:
        images = str((data_root(chosen.name, chosen.root) / images).absolute())
    return read(
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
    from uplift.masks.simulate import simulate_masks

    chosen, views = settings.data, views_of(settings)
    if which == "train":
        data = simulate_masks(chosen.family, chosen.simulate, seed=settings.seed, side=chosen.side, views=views)
        return replace(data, source=f"made-up {chosen.family}")
    # Other shapes and cameras than any training seed's.
    count = max(1, min(_MOST_TEST, chosen.simulate // 10))
    data = simulate_masks(chosen.family, count, seed=settings.seed + 2**31, side=chosen.side, views=views)
    return replace(data, source=f"made-up {chosen.family}, other shapes")


def views_of(settings: Settings):
    """Return the `uplift.masks.simulate.ViewChoice` of the cameras that the lifter is told of."""
    from uplift.masks.simulate import ViewChoice

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
