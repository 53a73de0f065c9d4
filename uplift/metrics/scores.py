"""Put a prediction beside its truth, joints matched by name, and compute every protocol per frame and per joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from uplift.data.poses import PoseData, clips_of, previous_frames
from uplift.errors import UserError, listed
from uplift.metrics.alignment import ALIGNED_ERRORS, align, counted, length
from uplift.metrics.pose_metrics import (
    bone_lengths,
    facing_sign,
    flip_depth,
    frame_mean,
    has_handedness,
    joint_errors,
    mpjve,
    not_flipped,
    share_above,
    stress,
    symmetry,
    wrong_signs,
)
from uplift.metrics.protocols import JOINTS_14, MISSING
from uplift.skeleton import Skeleton
from uplift.skeleton.core import mirrored_bones

if TYPE_CHECKING:
    from uplift.models.prediction import Prediction

__all__ = ["GivenPoses", "Matched", "Scores", "match_poses", "previous_rows", "score"]

_FLIPPED_ERRORS = ("mpjpe_gt_scale", "n_mpjpe", "p_mpjpe")
"""The errors that have a ``*_best_of_flip``."""

_CHUNK = 8192


@dataclass(frozen=True)
class Matched:
    """A prediction and its truth over the same frames, in the skeleton's order of joints."""

    pose: Float[np.ndarray, "frames joints 3"]
    truth: Float[np.ndarray, "frames joints 3"]
    weight: Float[np.ndarray, "frames joints"]
    """1 for joints that were visible in 2D and are known in both poses, else 0."""
    unseen: Float[np.ndarray, "frames joints"]
    """1 for joints that were missing in 2D and are known in both poses, else 0."""
    skeleton: Skeleton
    metric: bool
    """The prediction is in the truth's unit of length."""
    pck: bool
    """Whether 150 mm says something: the truth is in mm, of bodies that are large enough."""
    previous: Int[np.ndarray, " frames"] | None = None
    """The row of the frame before in the clip, or -1; None where clips are not known."""
    coverage: float = 1.0
    """The share of the joints known in 2D and in the truth that the prediction has, over all frames."""

    def rows(self, rows: Int[np.ndarray, " rows"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and truth in double precision and the weight of some rows."""
        return self.pose[rows].astype(np.float64), self.truth[rows].astype(np.float64), self.weight[rows]


@dataclass
class Scores:
    """What `score` measured; names are those of the protocols."""

    frames: dict[str, Float[np.ndarray, " frames"]] = field(default_factory=dict)
    """Per frame, NaN where a protocol does not apply."""
    joints: dict[str, Float[np.ndarray, " joints"]] = field(default_factory=dict)
    """Mean over the frames in which the joint counts, NaN where it never does."""
    lengths: Float[np.ndarray, "frames bones"] = field(default_factory=lambda: np.empty((0, 0)))
    """Bone lengths at the metric or `n_mpjpe` scale."""
    wrong: Float[np.ndarray, "frames bones"] = field(default_factory=lambda: np.empty((0, 0)))
    """1 where a bone's depth sign is wrong, 0 where it is right, NaN where it does not count (`wrong_signs`)."""


def score(matched: Matched) -> Scores:
    """Return every protocol the data allows; memory stays that of one chunk beside the results."""
    frames: dict[str, list[np.ndarray]] = {}
    sums: dict[str, np.ndarray] = {}
    lengths, wrong = [], []
    total = len(matched.pose)
    for start in range(0, total, _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, total))
        by_joint, by_frame, bones = _score_rows(matched, rows)
        weight = matched.weight[rows]
        for name, values in by_joint.items():
            sums[name] = sums.get(name, 0.0) + np.where(weight > 0, values, 0).sum(0)
            by_frame[name] = frame_mean(values, weight)
        for name in (name for name in ("mpjpe", *_FLIPPED_ERRORS) if name in by_joint):
            by_frame[name + MISSING] = frame_mean(by_joint[name], matched.unseen[rows])
        for name, values in by_frame.items():
            frames.setdefault(name, []).append(values)
        lengths.append(bones.astype(np.float32))
        wrong.append(wrong_signs(*matched.rows(rows), matched.skeleton).astype(np.float32))
    often = matched.weight.sum(0)
    often[often == 0] = np.nan
    return Scores(
        frames={name: np.concatenate(parts) for name, parts in frames.items()},
        joints={name: part / often for name, part in sums.items()},
        lengths=np.concatenate(lengths),
        wrong=np.concatenate(wrong),
    )


def _score_rows(matched: Matched, rows: np.ndarray):
    """Return what is measured per joint, what per frame, and the bone lengths, of some rows."""
    pose, truth, weight = matched.rows(rows)
    by_joint, facing = _errors(matched, pose, truth, weight)
    scaled = align(_scale_of(matched), pose, truth, matched.skeleton.root_index, weight)
    if matched.pck:
        errors = by_joint[_scale_of(matched)]
        by_joint |= {"pck@150": (errors < 150.0).astype(np.float64), "auc": share_above(errors)}
        by_joint["pck_z@150"] = (np.abs(scaled - truth)[..., 2] < 150.0).astype(np.float64)
    by_frame = {"stress": stress(scaled, truth, weight), "facing": facing}
    if matched.pck and set(JOINTS_14) <= set(matched.skeleton.joints):
        places = [matched.skeleton.index(joint) for joint in JOINTS_14]
        for name, found in (("pck14@150", "pck@150"), ("auc14", "auc")):
            by_frame[name] = frame_mean(by_joint[found][:, places], weight[:, places])
    if matched.previous is not None:
        by_frame["mpjve"] = _velocity_error(matched, rows)
    seen = np.where((weight > 0)[..., None], scaled, np.nan)
    if has_handedness(matched.skeleton):
        known = np.where((weight > 0)[..., None], pose, np.nan)
        by_frame["facing_sign"] = facing_sign(known, matched.skeleton)
    lengths = bone_lengths(seen, matched.skeleton)
    pairs = mirrored_bones(matched.skeleton)
    if len(pairs):
        by_frame["symmetry"] = symmetry(lengths, pairs)
    return by_joint, by_frame, lengths


def _scale_of(matched: Matched) -> str:
    return "mpjpe" if matched.metric else "n_mpjpe"


def _errors(matched: Matched, pose, truth, weight) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the joint errors of every alignment, and `facing`, which shares two of them."""
    root = matched.skeleton.root_index
    names = [name for name in ALIGNED_ERRORS if matched.metric or name != "mpjpe"]
    errors = {name: joint_errors(name, pose, truth, root, weight) for name in names}
    flipped, facing = flip_depth(pose), np.empty(0)
    for name in _FLIPPED_ERRORS:
        other = joint_errors(name, flipped, truth, root, weight)
        kept_mean, other_mean = frame_mean(errors[name], weight), frame_mean(other, weight)
        errors[f"{name}_best_of_flip"] = np.where((other_mean < kept_mean)[:, None], other, errors[name])
        if name == "p_mpjpe":
            facing = not_flipped(kept_mean, other_mean)
    return errors, facing


def _velocity_error(matched: Matched, rows: np.ndarray) -> np.ndarray:
    """Return `mpjve` of some rows; frames before them may lie in another chunk, so they are aligned again."""
    assert matched.previous is not None
    values = np.full(len(rows), np.nan)
    later = np.flatnonzero(matched.previous[rows] >= 0)
    count = len(later)
    if count:
        pose, truth, weight = matched.rows(np.concatenate([rows[later], matched.previous[rows[later]]]))
        scaled = align(_scale_of(matched), pose, truth, matched.skeleton.root_index, weight)
        previous = np.concatenate([np.arange(count) + count, np.full(count, -1)])
        values[later] = mpjve(scaled, truth, previous, weight)[:count]
    return values


def previous_rows(identity: Mapping[str, Any]) -> Int[np.ndarray, " frames"] | None:
    """Return the row of the frame before each in its clip, -1 without one; None where clips are not known.

    None without ``sequence`` or ``frame``, where a frame number occurs twice in a clip (then something that
    tells clips apart, such as ``camera``, is missing), and where no two frames follow each other.
    """
    frame = identity.get("frame")
    if "sequence" not in identity or frame is None or frame.dtype.kind not in "iuf":
        return None
    clip = clips_of(identity)
    order = np.lexsort((frame, clip))
    if ((np.diff(clip[order]) == 0) & (np.diff(frame[order]) == 0)).any():
        return None
    previous = previous_frames(clip, frame)
    return previous if (previous >= 0).any() else None


# Put a prediction and its truth side by side: joints by name, frames by row, and what counts.

_MIN_JOINTS = 3
_LEAST_SIZE = 500.0
"""mm; for smaller bodies, such as hands and mice, 150 mm is more than 30 % of their size, and nearly any pose passes."""
_SCALELESS = ("px", "relative")


@dataclass(frozen=True)
class GivenPoses:
    """3D poses of any origin: camera frame, relative to the root, in the frames' order of the truth."""

    pose: Float[np.ndarray, "frames joints 3"]
    joint_names: tuple[str, ...]
    unit: str = "relative"
    """``mm`` (or whatever the truth's is) for a metric pose; ``px`` or ``relative`` for one without scale."""
    tilt_deg: Float[np.ndarray, " frames"] | None = None
    """The camera's estimated down-tilt."""
    identity: Mapping[str, Any] = field(default_factory=dict)
    """Checked against the truth's where both have a key."""
    source: str = ""
    uncertainty: np.ndarray | None = None
    """(frames joints), the expected absolute error of each depth (a Laplace scale), in the pose's unit."""
    gravity: np.ndarray | None = None
    """(frames 3), unit vectors of the estimated gravity in the camera's frame."""
    hypotheses: np.ndarray | None = None
    """(frames hypotheses joints 3), further poses, the most likely first."""
    weights: np.ndarray | None = None
    """(frames hypotheses), their probabilities."""


def match_poses(
    prediction: GivenPoses | Prediction, truth: PoseData, skeleton: Skeleton
) -> tuple[Matched, np.ndarray, list[str]]:
    """Return both over the frames that can be compared, which frames those are, and notes for the reader.

    Raises UserError: no truth, a joint missing on either side, other frames, or no frame left.
    """
    names = prediction.source or "the prediction", truth.source or "the truth"
    target = _check_frames(prediction, truth, names)
    ours, ours_extra = _pick(prediction.joint_names, skeleton, names[0])
    theirs, theirs_extra = _pick(truth.joint_names, skeleton, names[1])
    pose, target, seen = np.asarray(prediction.pose)[:, ours], target[:, theirs], truth.confidence[:, theirs] > 0
    weight, wanted = counted(pose, target, seen), seen & np.isfinite(target).all(-1)
    kept = weight.sum(1) >= _MIN_JOINTS
    if not kept.any():
        raise UserError(
            f"{names[0]}: no frame has {_MIN_JOINTS} joints that are finite there, visible in 2D and known "
            f"in {names[1]}: nothing to compare."
        )
    size = _body_size(target[kept], weight[kept])
    matched = Matched(
        pose=pose[kept],
        truth=target[kept],
        weight=weight[kept],
        unseen=counted(pose, target, ~seen)[kept],
        skeleton=skeleton,
        metric=prediction.unit == truth.unit and truth.unit not in _SCALELESS,
        pck=truth.unit == "mm" and size >= _LEAST_SIZE,
        previous=previous_rows({key: np.asarray(value)[kept] for key, value in truth.identity.items()}),
        coverage=float(weight[wanted].sum() / wanted.sum()),
    )
    notes = [*ours_extra, *theirs_extra, *_notes(matched, len(kept), truth.unit, size), *_pose_notes(matched)]
    return matched, kept, notes


def _body_size(pose: Float[np.ndarray, "frames joints 3"], weight: Float[np.ndarray, "frames joints"]) -> float:
    """Return the median diagonal of the box around the joints that count."""
    known = np.where((weight > 0)[..., None], pose, np.nan)
    return float(np.median(length(np.nanmax(known, axis=1) - np.nanmin(known, axis=1))))


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
    for key in (key for key in truth.identity if key in prediction.identity):
        one, other = np.asarray(prediction.identity[key]), np.asarray(truth.identity[key])
        numbers = one.dtype.kind in "iufb" and other.dtype.kind in "iufb"
        differs = one != other if numbers else one.astype(str) != other.astype(str)
        if np.shape(one) != np.shape(other) or np.any(differs):
            row = int(np.argmax(differs)) if np.shape(one) == np.shape(other) else 0
            raise UserError(
                f"{names[0]}: '{key}' is not that of {names[1]}: row {row} has {one.flat[row]!s}, expected "
                f"{other.flat[row]!s}. The frames must be the same, in the same order."
            )
    return truth.pose


def _pick(given: Sequence[str], skeleton: Skeleton, name: str) -> tuple[list[int], list[str]]:
    """Return the place of each of the skeleton's joints in ``given``, and a note of the joints left over."""
    given = [str(joint) for joint in given]
    extra = [joint for joint in given if joint not in skeleton.joints]
    lacking = [joint for joint in skeleton.joints if joint not in given]
    if lacking:
        instead = f" It has {listed(extra)} instead." if extra else ""
        raise UserError(
            f"{name}: lacks {len(lacking)} of the {len(skeleton.joints)} joints of skeleton "
            f"'{skeleton.name}': {listed(lacking)}.{instead} Joints are matched by name."
        )
    twice = [joint for joint in skeleton.joints if given.count(joint) > 1]
    if twice:
        raise UserError(f"{name}: joint '{twice[0]}' is there {given.count(twice[0])} times; names must differ.")
    note = f"left out, as skeleton '{skeleton.name}' does not have them: {listed(extra)} of {name}"
    return [given.index(joint) for joint in skeleton.joints], [note] if extra else []


def _notes(matched: Matched, total: int, unit: str, size: float) -> list[str]:
    """Return what a reader must know to compare these figures with others."""
    skeleton = matched.skeleton
    notes = [f"{len(skeleton.joints)} joints, root '{skeleton.root}' included; overall is the mean over frames"]
    left = total - len(matched.pose)
    if left:
        notes.append(f"{left:,} of {total:,} frames left out: fewer than {_MIN_JOINTS} joints to compare")
    scale = f"the metric pose ({unit})" if matched.metric else "the pose at n_mpjpe scale"
    shares = "pck, auc, " if matched.pck else ""
    notes.append(f"{shares}stress, mpjve and bone_cv use {scale}")
    if unit != "mm":
        notes.append(f"no pck and auc: the truth's unit is '{unit}', not mm")
    elif not matched.pck:
        notes.append(f"no pck and auc: 150 mm is too much for bodies of {size:.3g} mm; they need {_LEAST_SIZE:g}")
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
