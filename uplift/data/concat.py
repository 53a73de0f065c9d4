"""Frames or masks of several files as one; what differs between the files is left out, with a note."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.clean_masks import resample
from uplift.data.masks import MaskData
from uplift.data.names import Names
from uplift.data.poses import IDENTITY_KEYS, PoseData
from uplift.errors import UserError
from uplift.geometry.lens import Lens

__all__ = ["concat_masks", "concat_poses", "joined_columns", "resized"]


def concat_poses(parts: Sequence[PoseData]) -> PoseData:
    """Return the frames of all ``parts``, which have the same joints in the same order, one after the other.

    Sequences stay apart: a part without names is one sequence named as its file, and a name
    that two parts share is put behind the file's. Known cameras that differ become `PoseData.lenses`. Another image
    size, frame rate or focal length that is not the same everywhere is left out, with a note.

    Raises UserError: poses in different units, masks of different sides.
    """
    if len(parts) == 1:
        return parts[0]
    notes = _common_notes(parts)
    units = {part.unit for part in parts if part.pose is not None}
    sides = {part.masks.shape[1] for part in parts if part.masks is not None}
    for what, values in (("poses in {}", units), ("masks of {} px a side", sides)):
        if len(values) > 1:
            found = " and ".join(map(str, sorted(values)))
            raise UserError(f"{_files(parts)}: {what.format(found)}; files must agree to be joined.")
    common: dict[str, Any] = _lenses(parts)
    for name in ("fps", "image_size", "focal_px"):
        values = {getattr(part, name) for part in parts}
        common[name] = values.pop() if len(values) == 1 else None
        if values and common[name] is None and (name == "fps" or not common.get("lenses")):
            notes.append(f"{name} is not the same in all {len(parts)} files and is not used")
    return PoseData.concat(
        parts,
        unit=units.pop() if units else parts[0].unit,
        identity=_identity(parts),
        source=_files(parts),
        notes=tuple(notes),
        **common,
    )


def _lenses(parts: Sequence[PoseData]) -> dict[str, Any]:
    """Return the cameras of parts that all know theirs, where they differ; nothing elsewhere, or where masks would go with it."""
    cameras = {(part.focal_px, part.image_size, part.lenses) for part in parts}
    known = all(part.lenses or (part.focal_px and part.image_size) for part in parts)
    if len(cameras) == 1:
        return {}
    if not known or any(part.masks is not None for part in parts):
        return {"lenses": (), "lens": None}
    lenses: dict[Lens, int] = {}
    rows = []
    for part in parts:
        own = part.lenses or (Lens.ideal(part.focal_px or 0.0, part.image_size or (0, 0)),)
        places = np.array([lenses.setdefault(lens, len(lenses)) for lens in own], np.int16)
        rows.append(places[np.zeros(len(part), int) if part.lens is None else part.lens])
    return {"lenses": tuple(lenses), "lens": np.concatenate(rows)}


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


def _identity(parts: Sequence[PoseData]) -> dict[str, Any]:
    keys = [key for key in IDENTITY_KEYS if any(key in part.identity for part in parts)]
    stills = all("image" in part.identity and "sequence" not in part.identity for part in parts)
    if not stills and "sequence" not in keys:
        keys.append("sequence")
    columns = {key: [_column(part, key) for part in parts] for key in keys}
    if "sequence" in columns:
        columns["sequence"] = _distinct(columns["sequence"], parts)
    return {key: joined_columns(values) for key, values in columns.items()}


def _column(part: PoseData, key: str) -> Any:
    if key in part.identity:
        return part.identity[key]
    if key == "frame":
        return np.arange(len(part))
    return np.full(len(part), Path(part.source).stem if key == "sequence" and "image" not in part.identity else "")


def _distinct(names: list[Any], parts: Sequence[PoseData]) -> list[Any]:
    """Return the names of sequences with the file's before those that another file has too."""
    found = [set(map(str, np.unique(values))) - {""} for values in names]
    shared = {name for one, own in enumerate(found) for name in own if any(name in o for o in found[:one])}
    if not shared:
        return names
    apart = []
    for part, values in zip(parts, map(Names.of, names), strict=True):
        longer = np.char.add(f"{part.source}: ", values.names)
        apart.append(Names(values.codes, np.where(np.isin(values.names, list(shared)), longer, values.names)))
    return apart


def joined_columns(values: Sequence[Any]) -> np.ndarray | Names:
    """Return what frames are of, of several parts, as one column: text where any is text."""
    text = any(value.dtype.kind not in "iuf" for value in values)
    return Names.concat(values) if text else np.concatenate(values)


def concat_masks(parts: Sequence[MaskData]) -> MaskData:
    """Return the items of all parts, in order, at the resolution of the first; what a part does not know is empty, and its truth then left out.

    Raises UserError: no part.
    """
    if not parts:
        raise UserError("No masks to join.")
    if len(parts) == 1:
        return parts[0]
    parts = [resized(part, parts[0].side) for part in parts]
    notes = [note for part in parts for note in part.notes]
    changed = {}
    if any(part.truth is None for part in parts):
        changed = {"truth": None, "labelled": None}
        if any(part.truth is not None for part in parts):
            notes.append("only some of the files have true shapes: these are left out")
    return MaskData.concat(parts, notes=tuple(dict.fromkeys(notes)), **changed)


def resized(data: MaskData, side: int) -> MaskData:
    """Return the same crops with another number of pixels."""
    if data.side == side:
        return data
    half = data.side / 2
    return replace(data, masks=np.stack([resample(mask, (half, half), half, side) for mask in data.masks]))
