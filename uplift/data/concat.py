"""Frames or masks of several files as one; what differs between the files is left out and said."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from uplift.data.clean_masks import resample
from uplift.data.masks import MaskData, Placed
from uplift.data.poses import IDENTITY_KEYS, PoseData, joined_masks
from uplift.errors import UserError

__all__ = ["join", "join_data", "resized"]

# Frames of several files as one: who and when stay apart, what differs between files is left out and said.


def join_data(parts: Sequence[PoseData]) -> PoseData:
    """Return the frames of all ``parts``, which have the same joints in the same order, one after the other.

    Sequences stay apart: a part without names of its own is one sequence named as its file, and a name
    that two parts share is put behind the file's. An image size, frame rate or focal length that is not
    the same everywhere is left out, with a note.

    Raises:
        UserError: poses in different units, masks of different sides.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    notes = _common_notes(parts)
    units = {part.unit for part in parts if part.pose is not None}
    if len(units) > 1:
        raise UserError(f"{_files(parts)}: poses in {' and '.join(sorted(units))}; files must agree to be joined.")
    common = {}
    for name in ("fps", "image_size", "focal_px"):
        values = {getattr(part, name) for part in parts}
        common[name] = values.pop() if len(values) == 1 else None
        if values and common[name] is None:
            notes.append(f"{name} is not the same in all {len(parts)} files and is not used")
    return replace(
        first,
        keypoints=np.concatenate([part.keypoints for part in parts]),
        confidence=np.concatenate([part.confidence for part in parts]),
        pose=_stacked(parts, "pose"),
        root=_stacked(parts, "root"),
        tilt_deg=_stacked(parts, "tilt_deg"),
        unit=units.pop() if units else first.unit,
        identity=_identity(parts),
        **_masks(parts),
        source=_files(parts),
        notes=tuple(notes),
        **common,
    )


def _common_notes(parts: Sequence[PoseData]) -> list[str]:
    """Return the notes of all parts; of those that differ in their numbers alone the first, with how many they are."""
    alike: dict[str, list[str]] = {}
    for note in (note for part in parts for note in part.notes):
        alike.setdefault(re.sub(r"\d[\d,.]*", "#", note), []).append(note)
    return [
        notes[0] if len(set(notes)) == 1 else f"{notes[0]} (the like in {len(notes)} of {len(parts)} files)"
        for notes in alike.values()
    ]


def _files(parts: Sequence[PoseData]) -> str:
    return f"{len(parts)} files, {Path(parts[0].source).name} to {Path(parts[-1].source).name}"


def _stacked(parts: Sequence[PoseData], name: str) -> np.ndarray | None:
    """Return an array of all parts, NaN where a part has none; None where all have none."""
    arrays = [getattr(part, name) for part in parts]
    known = next((array for array in arrays if array is not None), None)
    if known is None:
        return None
    blank = [np.full((len(part), *known.shape[1:]), np.nan, known.dtype) for part in parts]
    return np.concatenate([gap if array is None else array for array, gap in zip(arrays, blank, strict=True)])


def _masks(parts: Sequence[PoseData]) -> dict[str, np.ndarray | None]:
    try:
        return joined_masks(parts)
    except UserError as error:
        raise UserError(f"{_files(parts)}: {error}") from None


def _identity(parts: Sequence[PoseData]) -> dict[str, np.ndarray]:
    keys = [key for key in IDENTITY_KEYS if any(key in part.identity for part in parts)]
    stills = all("image" in part.identity and "sequence" not in part.identity for part in parts)
    if not stills and "sequence" not in keys:
        keys.append("sequence")
    columns = {key: [_column(part, key) for part in parts] for key in keys}
    if "sequence" in columns:
        columns["sequence"] = _told_apart(columns["sequence"], parts)
    return {key: np.concatenate(_alike(values)) for key, values in columns.items()}


def _column(part: PoseData, key: str) -> np.ndarray:
    if key in part.identity:
        return part.identity[key]
    if key == "frame":
        return np.arange(len(part))
    return np.full(len(part), Path(part.source).stem if key == "sequence" and "image" not in part.identity else "")


def _told_apart(names: list[np.ndarray], parts: Sequence[PoseData]) -> list[np.ndarray]:
    """Return the names of sequences with the file's before those that another file has too."""
    found = [set(map(str, np.unique(values))) - {""} for values in names]
    shared = {name for one, own in enumerate(found) for name in own if any(name in o for o in found[:one])}
    if not shared:
        return names
    told = []
    for values, part in zip(names, parts, strict=True):
        text = values.astype(str)
        told.append(np.where(np.isin(text, list(shared)), np.char.add(f"{part.source}: ", text), text))
    return told


def _alike(values: list[np.ndarray]) -> list[np.ndarray]:
    """Return columns of one kind: text where any is text."""
    if any(value.dtype.kind not in "iuf" for value in values):
        return [value.astype(str) for value in values]
    return values


# Masks of several files as one, and at another resolution.


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
