"""Lifting as frames come: each alone, smoothed by what came before it, with no lag but the filter's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from uplift.data.clean import MIN_VISIBLE
from uplift.data.poses import PoseData
from uplift.models.model import Model
from uplift.models.predict import to_level
from uplift.skeleton.match import build_joints

__all__ = ["LiveLifter", "LivePose", "OneEuro"]

_GRAVITY_S = 2.0
"""The camera's tilt is the mean of this long: it stands, and a frame alone says little of it."""
_FORGOTTEN_S = 1.0
"""Someone who was away for longer is not smoothed with what was before."""
_LEAST_HZ, _SLOPE, _SPEED_HZ = 1.7, 4.0, 1.0
"""Of the filter: cut-off of what stands still, how it grows with speed (body sizes a second), and that of the speed."""


class OneEuro:
    """A low-pass filter whose cut-off grows with speed: little jitter at rest, little lag in motion.

    Casiez, Roussel and Vogel 2012 (CHI), equations 2 to 7, for each number of an array.
    """

    def __init__(self, least_hz: float = _LEAST_HZ, slope: float = _SLOPE, speed_hz: float = _SPEED_HZ):
        self._least_hz, self._slope, self._speed_hz = least_hz, slope, speed_hz
        self._value: np.ndarray | None = None
        self._speed: np.ndarray | None = None

    def __call__(self, value: Float[np.ndarray, "*shape"], step_s: float) -> Float[np.ndarray, "*shape"]:
        """Return the filtered value, ``step_s`` seconds after the one before; NaN leaves what is known as it is."""
        if self._value is None or self._speed is None or self._value.shape != value.shape:
            self._value, self._speed = value, np.zeros_like(value)
            return value
        known = np.where(np.isfinite(self._value), self._value, value)
        change = np.nan_to_num((value - known) / step_s)
        self._speed = self._speed + _share(self._speed_hz, step_s) * (change - self._speed)
        share = _share(self._least_hz + self._slope * np.abs(self._speed), step_s)
        self._value = np.where(np.isfinite(value), known + share * (value - known), known)
        return self._value


def _share(cut_off_hz: float | Float[np.ndarray, "*shape"], step_s: float) -> float | Float[np.ndarray, "*shape"]:
    """Return how much of a new value is taken: 1 / (1 + tau / step), tau = 1 / (2 pi cut-off)."""
    return 1 / (1 + 1 / (2 * np.pi * cut_off_hz * step_s))


@dataclass(frozen=True)
class LivePose:
    """Someone in the frame that came last."""

    number: int
    """The same from frame to frame."""
    keypoints: Float[np.ndarray, "joints 2"]
    """px, in the skeleton's joints."""
    confidence: Float[np.ndarray, " joints"]
    pose: Float[np.ndarray, "joints 3"]
    """Relative to the root, level (x right, y down, z away), in sizes of the body: its mean 2D radius."""
    size_px: float
    """That radius."""


@dataclass
class _Person:
    smooth: OneEuro
    time_s: float


class LiveLifter:
    """Lifts the people of one frame after the other with ``model``, of keypoints with ``names``.

    Frames are lifted alone, without `uplift.models.refine`, whose clips end later; each body is smoothed by `OneEuro`, and
    gravity is that of the last seconds. ``image_size`` and ``focal_px`` are the camera's, where they are known.
    Raises UserError for joints that do not fit the model's skeleton.
    """

    def __init__(
        self,
        model: Model,
        names: Sequence[str],
        image_size: tuple[int, int] | None = None,
        focal_px: int | float | None = None,
    ):
        self._model, self._names = model, tuple(names)
        self._image_size, self._focal_px = image_size, focal_px
        self._people: dict[int, _Person] = {}
        self._gravity: np.ndarray | None = None
        self._last_s = 0.0

    def lift(
        self,
        keypoints: Float[np.ndarray, "people theirs 2"],
        confidence: Float[np.ndarray, "people theirs"],
        numbers: Int[np.ndarray, " people"],
        time_s: float,
    ) -> list[LivePose]:
        """Return the people of a frame at ``time_s`` who can be lifted; ``numbers`` tell them apart from frame to frame."""
        self._people = {n: one for n, one in self._people.items() if time_s - one.time_s <= _FORGOTTEN_S}
        points, seen, _ = build_joints(keypoints, confidence, self._names, self._model.skeleton)
        enough = (seen > 0).sum(1) >= MIN_VISIBLE
        points, seen, numbers = points[enough], seen[enough], numbers[enough]
        if not len(points):
            return []
        data = PoseData(
            points.astype(np.float32),
            seen.astype(np.float32),
            self._model.skeleton.joints,
            image_size=self._image_size,
            focal_px=self._focal_px,
        )
        found = self._model.predict(data, refine=False)
        pose = found.pose if found.gravity is None else self._levelled(found.pose, found.gravity, time_s)
        self._last_s = time_s
        rows = np.flatnonzero(np.isfinite(pose).all((1, 2)))
        return [self._smoothed(int(numbers[row]), points[row], seen[row], pose[row], time_s) for row in rows]

    def _levelled(self, pose: np.ndarray, gravity: np.ndarray, time_s: float) -> np.ndarray:
        """Return poses with y along the gravity of the last seconds."""
        new = np.nanmean(gravity, axis=0)
        if np.isfinite(new).all():
            share = max(1 - np.exp(-max(time_s - self._last_s, 0.0) / _GRAVITY_S), 0.01)
            old = new if self._gravity is None else self._gravity + share * (new - self._gravity)
            self._gravity = old / max(float(np.linalg.norm(old)), 1e-9)
        if self._gravity is None:
            return pose
        down = torch.from_numpy(np.repeat(self._gravity[None], len(pose), 0).astype(np.float32))
        return to_level(pose.astype(np.float32), down)

    def _smoothed(self, number: int, points: np.ndarray, seen: np.ndarray, pose: np.ndarray, time_s: float) -> LivePose:
        person = self._people.setdefault(number, _Person(OneEuro(), time_s))
        step_s = max(time_s - person.time_s, 1e-3)
        person.time_s = time_s
        there = points[seen > 0]
        size_px = max(float(np.linalg.norm(there - there.mean(0), axis=-1).mean()), 1e-6)
        radius = max(float(np.linalg.norm(pose[:, :2] - pose[:, :2].mean(0), axis=-1).mean()), 1e-9)
        return LivePose(number, points, seen, person.smooth((pose / radius).astype(np.float64), step_s), size_px)
