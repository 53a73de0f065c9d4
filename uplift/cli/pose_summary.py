"""What predict prints about poses, of one prediction or of many parts of a long one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uplift.data.poses import PoseData
from uplift.metrics.pose_metrics import bone_cv, bone_lengths, never_seen_so_long
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = ["Summary", "pose_summary"]

Mean = tuple[float, int]
"""A mean, and the weight behind it; the weight 0 where nothing is known."""


@dataclass(frozen=True)
class Summary:
    """What is said of a prediction, in numbers that parts can be put together from."""

    skeleton: Skeleton
    unit: str
    notes: tuple[str, ...]
    frames: int
    blank: int
    """Frames that cannot be lifted."""
    filled: Mean
    """The share of joints that were not seen; weighed by joints."""
    away_m: Mean
    """The median distance of the camera; by frames."""
    varies: Mean
    """How much bones vary within a clip; by clips."""
    too_long: Mean
    """The share of bones that are longer than they ever look; by frames."""

    @classmethod
    def of(cls, found: Prediction) -> Summary:
        """Return that of a prediction."""
        blank = int(np.isnan(found.pose).all((1, 2)).sum())
        lifted = len(found) - blank
        placed = found.root is not None and found.unit == "mm" and np.isfinite(found.root).any()
        away = float(np.nanmedian(found.root[:, 2])) / 1000 if placed and found.root is not None else 0.0
        long = never_seen_so_long(found.pose, found.skeleton)
        return cls(
            skeleton=found.skeleton,
            unit=found.unit,
            notes=found.notes,
            frames=len(found),
            blank=blank,
            filled=_filled(found),
            away_m=(away, lifted if placed else 0),
            varies=_varies(found),
            too_long=(long, lifted) if np.isfinite(long) else (0.0, 0),
        )

    @classmethod
    def joined(cls, parts: Sequence[Summary], notes: Sequence[str] = ()) -> Summary:
        """Return that of all parts; ``notes`` go before theirs."""
        return cls(
            skeleton=parts[0].skeleton,
            unit=parts[0].unit,
            notes=(*notes, *_alike([one.notes for one in parts])),
            frames=sum(one.frames for one in parts),
            blank=sum(one.blank for one in parts),
            filled=_mean([one.filled for one in parts]),
            away_m=_mean([one.away_m for one in parts]),
            varies=_mean([one.varies for one in parts]),
            too_long=_mean([one.too_long for one in parts]),
        )

    def __len__(self) -> int:
        return self.frames


def _filled(found: Prediction) -> Mean:
    if found.filled is None:
        return 0.0, 0
    known = found.filled[np.isfinite(found.pose[..., 0])]
    return (float(known.mean()), known.size) if known.size else (0.0, 0)


def _varies(found: Prediction) -> Mean:
    """Return how much bones vary over each clip, where there are clips."""
    clips = PoseData(found.keypoints, found.confidence, found.joint_names, identity=dict(found.identity)).clips()
    if not len(clips) or clips.max() + 1 == len(clips):
        return 0.0, 0
    lengths = bone_lengths(found.pose, found.skeleton)
    lengths = lengths / np.maximum(lengths.sum(1, keepdims=True), 1e-9) if found.unit != "mm" else lengths
    value = bone_cv(lengths, np.unique(clips, return_inverse=True)[1])
    return (value, int(clips.max()) + 1) if np.isfinite(value) else (0.0, 0)


def _mean(values: Sequence[Mean]) -> Mean:
    weight = sum(one[1] for one in values)
    return (sum(one[0] * one[1] for one in values) / weight, weight) if weight else (0.0, 0)


def _alike(parts: Sequence[Sequence[str]]) -> list[str]:
    """Return the notes of all parts; of those that differ in their numbers alone the first, with how many parts have one."""
    found: dict[str, list[str]] = {}
    for notes in parts:
        for kind, note in {re.sub(r"-?\d[\d,. ]*", "#", note): note for note in notes}.items():
            found.setdefault(kind, []).append(note)
    return [
        notes[0] if len(set(notes)) == 1 else f"{notes[0]} (the first of {len(notes)} parts with the like)"
        for notes in found.values()
    ]


def pose_summary(found: Prediction | Summary) -> list[str]:
    """Return what to print about poses."""
    found = Summary.of(found) if isinstance(found, Prediction) else found
    lines = [*found.notes, f"lifted {len(found) - found.blank:,} frames of {found.skeleton.name}, unit {found.unit}"]
    if found.blank:
        why = "too few joints, or all in one point"
        lines.append(f"{found.blank:,} of {len(found):,} frames cannot be lifted ({why}): their rows are NaN")
    if found.filled[0]:
        lines.append(f"{found.filled[0]:.1%} of joints were not seen and are filled in (`filled`)")
    if found.away_m[1]:
        lines.append(f"placed: the camera is {found.away_m[0]:.2f} m away (median)")
    if found.varies[0] > 1e-4:
        lines.append(f"bones vary by {found.varies[0]:.1%} within a clip; bones=constant makes them the same")
    if found.too_long[0] > 0.2:
        why = "too little training, or a body that is only ever seen from one side (docs/how-it-works.md)"
        lines.append(f"WARNING: many bones are twice as long as they ever look from the camera: {why}")
    if found.unit == "px":
        height = "height_mm=, or " if "of_height" in found.skeleton.size else ""
        lines.append(f"for millimetres give {height}bone=JOINT,JOINT bone_mm= (docs/output.md)")
    return lines
