"""What the true direction of gravity tells: the errors of a camera's tilt and roll, and errors by how far the trunk leans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from uplift.data.poses import PoseData
from uplift.geometry.gravity import gravity_at, roll_of, tilt_of
from uplift.metrics.protocols import CLIP
from uplift.metrics.scores import GivenPoses, Scores

if TYPE_CHECKING:
    from uplift.models.prediction import Prediction

__all__ = ["TRUNK_BINS", "by_trunk_angle", "camera_errors", "pooled_camera_errors", "true_gravity", "trunk_angle"]

# The camera's tilt and roll.


def true_gravity(truth: PoseData) -> Float[np.ndarray, "frames 3"] | None:
    """Return gravity in the camera's frame; that of a camera without roll where only its tilt is known."""
    if truth.gravity is not None:
        return truth.gravity.astype(np.float64)
    return None if truth.tilt_deg is None else gravity_at(truth.tilt_deg.astype(np.float64))


def camera_errors(prediction: GivenPoses | Prediction, truth: PoseData) -> dict[str, Float[np.ndarray, " frames"]]:
    """Return each frame's absolute error of the tilt and, where the truth says how the camera rolls, of the roll."""
    errors = {}
    if prediction.tilt_deg is not None and truth.tilt_deg is not None:
        errors["elevation_deg"] = np.abs(np.asarray(prediction.tilt_deg, np.float64) - truth.tilt_deg)
    if prediction.gravity is not None and truth.gravity is not None:
        found = roll_of(np.asarray(prediction.gravity, np.float64))
        errors["roll_deg"] = _turn(found - roll_of(truth.gravity.astype(np.float64)))
    return errors


def pooled_camera_errors(
    prediction: GivenPoses | Prediction, truth: PoseData, clip: Int[np.ndarray, " frames"], kept: np.ndarray
) -> dict[str, float]:
    """Return the medians over clips of the errors of tilt and roll, each from the mean gravity of the clip's ``kept`` frames."""
    found, true = prediction.gravity, true_gravity(truth)
    if found is None and prediction.tilt_deg is not None:
        found = gravity_at(np.asarray(prediction.tilt_deg, np.float64))
    if found is None or true is None:
        return {}
    pooled = [_means(np.asarray(vectors, np.float64)[kept], clip[kept]) for vectors in (found, true)]
    errors = {"elevation_deg": np.abs(tilt_of(pooled[0]) - tilt_of(pooled[1]))}
    if prediction.gravity is not None and truth.gravity is not None:
        errors["roll_deg"] = _turn(roll_of(pooled[0]) - roll_of(pooled[1]))
    known = {name: values[np.isfinite(values)] for name, values in errors.items()}
    return {f"{name}{CLIP}": float(np.median(values)) for name, values in known.items() if len(values)}


def _means(vectors: np.ndarray, clip: np.ndarray) -> Float[np.ndarray, "clips 3"]:
    """Return the mean direction of each clip's vectors, NaN for a clip without any that is known."""
    known = np.isfinite(vectors).all(1)
    clip, vectors = np.unique(clip, return_inverse=True)[1][known], vectors[known]
    sums = np.stack([np.bincount(clip, axis, clip.max(initial=-1) + 1) for axis in vectors.T], -1)
    size = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, size, out=np.full_like(sums, np.nan), where=size > 0)


def _turn(degrees: np.ndarray) -> np.ndarray:
    """Return differences of angles as turns from 0 to 180."""
    return np.abs((degrees + 180) % 360 - 180)


# Errors by the angle of the trunk from upright.

TRUNK_BINS = ((0, 15), (15, 30), (30, 60), (60, 90), (90, 180))
"""Degrees, the upper end excluded but for the last."""


def trunk_angle(
    pose: Float[np.ndarray, "frames joints 3"],
    gravity: Float[np.ndarray, "frames 3"],
    upright: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, " frames"]:
    """Return the angle between ``upright @ pose`` (`Skeleton.upright`) and the vertical, degrees; NaN where unknown."""
    used = np.flatnonzero(upright)
    up = np.einsum("j,fjc->fc", upright[used], pose[:, used].astype(np.float64))
    along, size = -(up * gravity).sum(-1), np.linalg.norm(up, axis=-1)
    cosine = np.divide(along, size, out=np.full(len(up), np.nan), where=size > 0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def by_trunk_angle(scores: Scores, angle: Float[np.ndarray, " frames"]) -> dict[str, dict[str, int | float]]:
    """Return for each of `TRUNK_BINS` its ``frames``, their ``share`` of all of known angle, and their errors.

    Those are ``p_mpjpe``, ``flipped`` (the share of frames whose depth is the wrong way round: 1 - `facing`) and
    ``wrong_signs``. Bins without frames are absent.
    """
    found = {}
    known = int(np.isfinite(angle).sum())
    for low, high in TRUNK_BINS:
        rows = (angle >= low) & ((angle < high) | (high == TRUNK_BINS[-1][1]))
        if rows.any():
            figures = {
                "p_mpjpe": scores.frames["p_mpjpe"][rows].mean(),
                "flipped": 1 - scores.frames["facing"][rows].mean(),
            }
            wrong = scores.wrong[rows]
            if np.isfinite(wrong).any():
                figures["wrong_signs"] = np.nanmean(wrong)
            count = int(rows.sum())
            figures = {name: float(value) for name, value in figures.items()}
            found[f"{low}-{high}"] = {"frames": count, "share": count / known, **figures}
    return found
