"""Put a prediction and its truth side by side: joints by name, frames by row, and what counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.evaluation.alignment import counted, length
from uplift.evaluation.protocols import MISSING
from uplift.evaluation.scores import Matched, previous_frames
from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.data.container import PoseData
    from uplift.prediction import Prediction

__all__ = ["GivenPoses", "match_poses"]

_MIN_JOINTS = 3
_SCALELESS = ("px", "relative")


@dataclass(frozen=True)
class GivenPoses:
    """Anybody's 3D poses: camera frame, relative to the root, in the frames' order of the truth."""

    pose: Float[np.ndarray, "frames joints 3"]
    joint_names: tuple[str, ...]
    unit: str = "relative"
    """``mm`` (or whatever the truth's is) for a metric pose; ``px`` or ``relative`` for one without scale."""
    tilt_deg: Float[np.ndarray, " frames"] | None = None
    """The camera's estimated down-tilt."""
    identity: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Checked against the truth's where both have a key."""
    source: str = ""
    spread: np.ndarray | None = None
    """(frames joints), the expected absolute error of each depth (a Laplace scale), in the pose's unit."""


def match_poses(
    prediction: GivenPoses | Prediction, truth: PoseData, skeleton: Skeleton
) -> tuple[Matched, np.ndarray, list[str]]:
    """Return both over the frames that can be compared, which frames those are, and notes for the reader.

    Raises:
        UserError: no truth, a joint missing on either side, other frames, or no frame left.
    """
    names = prediction.source or "the prediction", truth.source or "the truth"
    target = _check_frames(prediction, truth, names)
    ours, ours_extra = _pick(prediction.joint_names, skeleton, names[0])
    theirs, theirs_extra = _pick(truth.joint_names, skeleton, names[1])
    pose, target, seen = (
        np.asarray(prediction.pose)[:, ours],
        target[:, theirs],
        truth.confidence[:, theirs] > 0,
    )
    weight, wanted = counted(pose, target, seen), seen & np.isfinite(target).all(-1)
    kept = weight.sum(1) >= _MIN_JOINTS
    if not kept.any():
        raise UserError(
            f"{names[0]}: no frame has {_MIN_JOINTS} joints that are finite there, visible in 2D and known "
            f"in {names[1]}: nothing to compare."
        )
    matched = Matched(
        pose=pose[kept],
        truth=target[kept],
        weight=weight[kept],
        unseen=counted(pose, target, ~seen)[kept],
        skeleton=skeleton,
        metric=prediction.unit == truth.unit and truth.unit not in _SCALELESS,
        in_mm=truth.unit == "mm",
        previous=previous_frames({key: np.asarray(value)[kept] for key, value in truth.identity.items()}),
        coverage=float(weight[wanted].sum() / wanted.sum()),
    )
    notes = [*ours_extra, *theirs_extra, *_notes(matched, len(kept), truth.unit), *_pose_notes(matched)]
    return matched, kept, notes


def _check_frames(prediction: GivenPoses | Prediction, truth: PoseData, names: tuple[str, str]) -> np.ndarray:
    """Return the truth's pose; raises UserError where there is none or the frames are others."""
    if truth.pose is None:
        raise UserError(f"{names[1]}: no 'pose' in it, so nothing to evaluate against. Give a file that has one.")
    expected = (len(truth.pose), len(prediction.joint_names), 3)
    if np.shape(prediction.pose) != expected:
        raise UserError(
            f"{names[0]}: 'pose' has shape {np.shape(prediction.pose)}, expected {expected}: "
            f"(frames joints 3), one row for each frame of {names[1]}."
        )
    _check_identity(prediction.identity, truth.identity, names)
    return truth.pose


def _pick(given: Sequence[str], skeleton: Skeleton, name: str) -> tuple[list[int], list[str]]:
    """Return the place of each of the skeleton's joints in ``given``, and a note of the joints left over."""
    given = [str(joint) for joint in given]
    extra = [joint for joint in given if joint not in skeleton.joints]
    lacking = [joint for joint in skeleton.joints if joint not in given]
    if lacking:
        instead = f" It has {_some(extra)} instead." if extra else ""
        raise UserError(
            f"{name}: lacks {len(lacking)} of the {len(skeleton.joints)} joints of skeleton "
            f"'{skeleton.name}': {_some(lacking)}.{instead} Joints are matched by name."
        )
    twice = [joint for joint in skeleton.joints if given.count(joint) > 1]
    if twice:
        raise UserError(f"{name}: joint '{twice[0]}' is there {given.count(twice[0])} times; names must differ.")
    note = f"left out, as skeleton '{skeleton.name}' does not have them: {', '.join(extra)} of {name}"
    return [given.index(joint) for joint in skeleton.joints], [note] if extra else []


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


def _check_identity(
    found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], names: tuple[str, str]
) -> None:
    """Raise UserError where prediction and truth both name their frames and differ."""
    for key in (key for key in expected if key in found):
        one, other = np.asarray(found[key]), np.asarray(expected[key])
        numbers = one.dtype.kind in "iufb" and other.dtype.kind in "iufb"
        differs = one != other if numbers else one.astype(str) != other.astype(str)
        if np.shape(one) != np.shape(other) or np.any(differs):
            row = int(np.argmax(differs)) if np.shape(one) == np.shape(other) else 0
            raise UserError(
                f"{names[0]}: '{key}' is not that of {names[1]}: row {row} has {one.flat[row]!s}, expected "
                f"{other.flat[row]!s}. The frames must be the same, in the same order."
            )


def _notes(matched: Matched, total: int, unit: str) -> list[str]:
    """Return what a reader must know to compare these figures with others."""
    skeleton = matched.skeleton
    notes = [f"{len(skeleton.joints)} joints, root '{skeleton.root}' included; overall is the mean over frames"]
    left = total - len(matched.pose)
    if left:
        notes.append(f"{left:,} of {total:,} frames left out: fewer than {_MIN_JOINTS} joints to compare")
    scale = f"the metric pose ({unit})" if matched.metric else "the pose at n_mpjpe scale"
    shares = "pck, auc, " if matched.in_mm else ""
    notes.append(f"{shares}stress, mpjve and bone_cv use {scale}")
    if not matched.in_mm:
        notes.append(f"no pck and auc: the truth's unit is '{unit}', not mm")
    if matched.coverage < 1:
        notes.append(f"the prediction has {matched.coverage:.2%} of the joints it should; no mean has the others")
    unseen = int(matched.unseen.sum())
    if unseen:
        notes.append(f"{unseen:,} joints that were missing in 2D are in no mean but *{MISSING}")
    return notes


def _pose_notes(matched: Matched) -> list[str]:
    """Return what is odd about the predicted poses: a root off the origin, no depth."""
    some = matched.weight > 0
    distance = np.where(some, length(np.nan_to_num(matched.pose).astype(np.float64)), 0)
    radius = distance.sum() / some.sum()
    root = matched.skeleton.root_index
    away = distance[:, root].sum() / max(int(some[:, root].sum()), 1)
    notes = []
    if away > 1e-3 * radius:
        notes.append(f"the predicted root is {away / radius:.1%} of the mean radius off the origin; not re-centred")
    flat = int((np.where(some, np.abs(matched.pose[..., 2]), 0).max(1) <= 1e-9 * radius).sum())
    if flat:
        notes.append(f"{flat:,} predicted frames are flat (z = 0): their depth flip ties, which facing counts as right")
    return notes
