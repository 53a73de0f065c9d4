"""Masks of several files as one, and at another resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.errors import UserError
from uplift.masks.container import MaskData, Placed
from uplift.masks.resample import resample

__all__ = ["join", "resized"]


def join(parts: list[MaskData]) -> MaskData:
    """Return the items of all parts, in order, at the resolution of the first; what a part does not know is empty, and its truth then left out.

    Raises:
        UserError: no part.
    """
    if not parts:
        raise UserError("No masks to join.")
    if len(parts) == 1:
        return parts[0]
    parts = [resized(part, parts[0].side) for part in parts]
    lengths = [len(part) for part in parts]
    truths = [part.truth for part in parts]
    truth = None if any(one is None for one in truths) else _placed([one for one in truths if one is not None])
    notes = [note for part in parts for note in part.notes]
    if truth is None and any(one is not None for one in truths):
        notes.append("only some of the files have true shapes: these are left out")
    labelled = None
    if truth is not None and any(part.labelled is not None for part in parts):
        labelled = np.concatenate([_or_empty(p.labelled, n, bool) for p, n in zip(parts, lengths, strict=True)])
    text = {
        name: np.concatenate([_or_empty(getattr(p, name), n, "U1") for p, n in zip(parts, lengths, strict=True)])
        for name in ("category", "images")
        if any(getattr(part, name) is not None for part in parts)
    }
    shared = set.intersection(*(set(part.extra) for part in parts))
    return MaskData(
        masks=np.concatenate([part.masks for part in parts]),
        names=[name for part in parts for name in part.names],
        centre_px=np.concatenate([part.centre_px for part in parts]),
        scale_px=np.concatenate([part.scale_px for part in parts]),
        truth=truth,
        labelled=labelled,
        notes=tuple(dict.fromkeys(notes)),
        source=parts[0].source,
        extra={name: np.concatenate([part.extra[name] for part in parts]) for name in sorted(shared)},
        **text,
    )


def resized(data: MaskData, side: int) -> MaskData:
    """Return the same crops with another number of pixels."""
    if data.side == side:
        return data
    half = data.side / 2
    return replace(data, masks=np.stack([resample(mask, (half, half), half, side) for mask in data.masks]))


def _placed(truths: list[Placed]) -> Placed:
    """Return the shapes of all, and where each item has its own."""
    first = np.cumsum([0, *(len(one.meshes) for one in truths[:-1])])
    return Placed(
        [mesh for one in truths for mesh in one.meshes],
        np.concatenate([one.shape + start for one, start in zip(truths, first, strict=True)]),
        *(np.concatenate([getattr(one, name) for one in truths]) for name in ("view", "scale", "offset", "distance")),
    )


def _or_empty(array: np.ndarray | None, rows: int, kind: type | str) -> np.ndarray:
    return np.zeros(rows, kind) if array is None else array
