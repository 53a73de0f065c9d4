"""What a film shows at each moment: keypoints, poses on the floor, and the camera that turns about them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from uplift.axes import in_axes
from uplift.prediction import Prediction
from uplift.skeleton.sides import bone_sides, joint_sides
from uplift.writers.clips import Clip
from uplift.writers.gallery_views import filled_points
from uplift.writers.moving import from_y_down, known_points, row_places

__all__ = ["FilmScene", "film_scene", "turns_deg"]

_FOLLOW_S = 1.0
_SURE = 0.3
_TURN_S = 18.0
_SHORT_S = 12.0
_SWING_DEG_PER_S, _SWING_DEG = 7.0, 60.0
_MOST = 98.0
"""Percentile for sizes that a few wild joints must not set."""


@dataclass(frozen=True)
class FilmScene:
    """A clip as it is drawn; world axes are x right, y down with the floor at 0, z away, level."""

    title: str
    names: tuple[str, ...]
    frames: tuple[int, ...]
    points: Float[np.ndarray, "moments individuals joints 3"]
    keypoints: Float[np.ndarray, "moments individuals joints 2"]
    unsure: Bool[np.ndarray, "moments individuals joints"]
    centre: Float[np.ndarray, "moments 3"]
    turn_deg: Float[np.ndarray, " moments"]
    radius: float
    wide: float
    """How far the poses reach from the centre along the floor."""
    tall: float
    """How far they reach up and down."""
    floor: bool
    square: float
    """The side of the floor's squares."""
    bones: list[tuple[int, int]]
    joint_sides: list[int]
    bone_sides: list[int]
    flat_centre: Float[np.ndarray, "moments 2"]
    """The point of the image that is in the middle, px."""
    flat_reach: tuple[float, float]
    """How far keypoints are from it, px."""
    image_size: tuple[int, int] | None


def film_scene(prediction: Prediction, clip: Clip, rate: float) -> FilmScene:
    """Return what a clip shows at so many frames a second.

    Joints that were filled, not seen or seen with little confidence are unsure; where they have no keypoint it is that
    of the pose. Under gravity the floor is at the lowest feet: of the clip where the root's place is known, else
    of each pose.
    """
    level = _levelled(prediction)
    pose = known_points(level.pose)
    points = pose + row_places(level, clip)[:, None]
    floor = prediction.skeleton.gravity
    if floor:
        points[..., 1] -= _floor(points[clip.rows], level.root is not None, points)
    keypoints, unsure = _keypoints(prediction, pose)
    points, keypoints = _stacked(clip, points), _stacked(clip, keypoints)
    centre, flat_centre = _followed(points, rate), _followed(keypoints, rate)
    centre[:, 1] = np.median(centre[:, 1])
    away, flat_away = points - centre[:, None, None], keypoints - flat_centre[:, None, None]
    radius = _most(np.linalg.norm(away, axis=-1))
    bones = prediction.bone_indices.tolist()
    sides = joint_sides(prediction.skeleton, prediction.joint_names)
    return FilmScene(
        title=prediction.title or clip.name or prediction.skeleton.name,
        names=clip.individual_names,
        frames=clip.frames,
        points=points,
        keypoints=keypoints,
        unsure=_stacked(clip, unsure.astype(float)) > 0,
        centre=centre,
        turn_deg=turns_deg(len(clip.frames), rate),
        radius=radius,
        wide=_most(np.linalg.norm(away[..., ::2], axis=-1)),
        tall=_most(np.abs(away[..., 1])),
        floor=floor,
        square=_round_length(radius / 3),
        bones=[(start, end) for start, end in bones],
        joint_sides=sides,
        bone_sides=bone_sides(sides, bones),
        flat_centre=flat_centre,
        flat_reach=(_most(np.abs(flat_away[..., 0])), _most(np.abs(flat_away[..., 1]))),
        image_size=None
        if prediction.image_size is None
        else (int(prediction.image_size[0]), int(prediction.image_size[1])),
    )


def turns_deg(moments: int, rate: float) -> Float[np.ndarray, " moments"]:
    """Return the camera's turn at each moment: whole turns, or a swing where there is no time; it ends where it began."""
    share = np.arange(moments) / max(moments, 1)
    seconds = moments / rate
    if seconds < _SHORT_S:
        return min(_SWING_DEG, _SWING_DEG_PER_S * seconds) * np.sin(2 * np.pi * share)
    return 360.0 * max(1, round(seconds / _TURN_S)) * share


def _levelled(prediction: Prediction) -> Prediction:
    """Return the prediction with y down and level."""
    if prediction.axes in ("camera", "opencv"):
        return in_axes(prediction, "level")
    turn = from_y_down(prediction.axes)
    root = None if prediction.root is None else prediction.root @ turn
    return replace(prediction, pose=prediction.pose @ turn, root=root, axes="level")


def _floor(rows: np.ndarray, placed: bool, points: np.ndarray) -> np.ndarray:
    """Return the floor's y: one where the root has a place, else below each pose."""
    lowest = np.where(np.isfinite(rows[..., 1]), rows[..., 1], -np.inf).max(1)
    if placed:
        lowest = lowest[np.isfinite(lowest)]
        return np.asarray(np.percentile(lowest, _MOST) if len(lowest) else 0.0)
    below = np.where(np.isfinite(points[..., 1]), points[..., 1], -np.inf).max(1, keepdims=True)
    return np.where(np.isfinite(below), below, 0.0)


def _keypoints(prediction: Prediction, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints in full, and which joints are unsure."""
    points = np.asarray(prediction.keypoints, float)
    confidence = np.nan_to_num(np.asarray(prediction.confidence, float))
    seen = (confidence > 0) & np.isfinite(np.sum(points, axis=-1))
    unsure = ~seen | (confidence < _SURE)
    if prediction.filled is not None:
        unsure |= prediction.filled
    camera_pose = pose if prediction.axes not in ("camera", "opencv") else known_points(prediction.pose)
    points = np.where(seen[..., None], points, np.nan)
    for row in np.flatnonzero(~seen.all(1)):
        points[row] = filled_points(points[row], seen[row], camera_pose[row])
    return points, unsure


def _stacked(clip: Clip, values: np.ndarray) -> np.ndarray:
    """Return values by moment and individual, NaN where an individual is not there."""
    found = np.full((len(clip.frames), len(clip.individual_names), *values.shape[1:]), np.nan)
    found[clip.moment, clip.individual] = values[clip.rows]
    return found


def _followed(points: np.ndarray, rate: float) -> Float[np.ndarray, "moments axes"]:
    """Return the point to look at: the middle of all that is there, smoothly."""
    flat = points.reshape(len(points), -1, points.shape[-1])
    known = np.isfinite(flat)
    low, high = np.where(known, flat, np.inf).min(1), np.where(known, flat, -np.inf).max(1)
    there = np.isfinite(low).all(1)
    if not there.any():
        return np.zeros((len(points), points.shape[-1]))
    when = np.arange(len(points))
    middle = np.stack([np.interp(when, when[there], axis[there]) for axis in ((low + high) / 2).T], 1)
    reach = max(1, round(rate * _FOLLOW_S))
    kernel = np.hanning(2 * reach + 3)[1:-1]
    padded = np.pad(middle, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(axis, kernel / kernel.sum(), mode="valid") for axis in padded.T], 1)


def _most(distances: np.ndarray) -> float:
    known = distances[np.isfinite(distances)]
    return max(float(np.percentile(known, _MOST)) * 1.1, 1e-6) if len(known) else 1.0


def _round_length(about: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that squares can be counted."""
    power = 10.0 ** np.floor(np.log10(about))
    return float(power * next(k for k in (1, 2, 5, 10) if k * power >= about * 0.99))
