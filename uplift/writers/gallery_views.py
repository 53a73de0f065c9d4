"""A pose from all sides, and its keypoints, as small SVG drawings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.prediction import Prediction
from uplift.skeleton.sides import bone_sides, joint_sides

__all__ = ["HIGH", "WIDE", "Body", "Crop", "crop_of", "drawn_input", "drawn_views", "filled_points", "turned"]

WIDE, HIGH = 400, 480
"""Of a turned view, in drawing units; the input is ``WIDE`` squared."""
_DISTANCE = 10.0
_SIDES = "mlr"
_MARGIN = 0.03


@dataclass(frozen=True)
class Body:
    """What is drawn of every frame alike: bones and the side that each belongs to."""

    bones: Int[np.ndarray, "bones 2"]
    joint_sides: Sequence[int]
    bone_sides: Sequence[int]

    @classmethod
    def of(cls, prediction: Prediction) -> Body:
        """Return the body of a prediction."""
        bones, sides = prediction.bone_indices, joint_sides(prediction.skeleton, prediction.joint_names)
        return cls(bones, sides, bone_sides(sides, bones.tolist()))


@dataclass(frozen=True)
class Crop:
    """A square of the image, in pixels: its left top corner and its side."""

    left: float
    top: float
    side: float

    def place(self, points: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Return pixels as drawing units."""
        return (points - [self.left, self.top]) * (WIDE / self.side)


def turned(
    pose: Float[np.ndarray, "joints 3"],
    level: Float[np.ndarray, "3 3"],
    centre: Float[np.ndarray, "3"],
    angles_deg: Sequence[int],
) -> Float[np.ndarray, "views joints 3"]:
    """Return the pose as cameras see it that walked round it, as high and as tilted as the real one.

    ``level`` takes the camera frame to one whose y is gravity. At 0 degrees it is the real camera's view; at 90
    the camera stands on the image's right.
    """
    angle = np.radians(np.asarray(angles_deg, float))
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    about = np.stack([cos, zero, sin, zero, one, zero, -sin, zero, cos], -1).reshape(-1, 3, 3)
    return np.einsum("vik,jk->vji", level.T @ about @ level, pose - centre)


def drawn_views(poses: Sequence[Float[np.ndarray, "views joints 3"]], missing: Sequence, body: Body) -> list[list[str]]:
    """Return one SVG drawing per pose and view, all of them at one scale.

    ``missing`` holds, for each pose, which of its joints were not seen (joints,).
    """
    size = float(np.nanmean(np.abs(poses[0]))) or 1.0
    seen = [_projected(views, _DISTANCE * 3 * size) for views in poses]
    flat = np.concatenate([points[..., :2].reshape(-1, 2) for points in seen])
    flat = flat[np.isfinite(flat).all(1)]
    half = np.maximum(np.abs(flat[:, 0]).max(initial=1e-9), 1e-9)
    low, high = (flat[:, 1].min(), flat[:, 1].max()) if len(flat) else (-1.0, 1.0)
    room = 1 - 2 * _MARGIN
    scale = room * min(WIDE / 2 / half, HIGH / max(high - low, 1e-9))
    drawings = []
    for points, unseen in zip(seen, missing, strict=True):
        placed = points.copy()
        placed[..., 0] = WIDE / 2 + scale * points[..., 0]
        placed[..., 1] = HIGH / 2 + scale * (points[..., 1] - (low + high) / 2)
        drawings.append([_figure(view, unseen, body) for view in placed])
    return drawings


def _projected(views: Float[np.ndarray, "views joints 3"], distance: float) -> Float[np.ndarray, "views joints 3"]:
    """Return x and y in mild perspective, and the depth from -1 (near) to 1."""
    depth = views[..., 2:]
    radius = np.nanmax(np.abs(views), initial=1e-9)
    flat = views[..., :2] / np.maximum(1 + depth / distance, 0.2)
    return np.concatenate([flat, depth / radius], -1)


def _figure(points: Float[np.ndarray, "joints 3"], missing: Bool[np.ndarray, " joints"], body: Body) -> str:
    """Return bones from far to near, each with a rim that parts it from what it hides."""
    depth = points[body.bones, 2].mean(1)
    parts = []
    for bone in np.argsort(-depth, kind="stable").tolist():
        start, end = body.bones[bone]
        if not np.isfinite(points[[start, end]]).all():
            continue
        line = _line(points[start], points[end])
        tone = f"{_SIDES[body.bone_sides[bone]]}{_tone(depth[bone])}"
        if missing[start] or missing[end]:
            parts.append(f'<path class="{tone} u" d="{line}"/>')
        else:
            parts.append(f'<path class="k" d="{line}"/><path class="{tone}" d="{line}"/>')
    dots = [joint for joint in np.flatnonzero(missing).tolist() if np.isfinite(points[joint]).all()]
    return "".join(parts + [_ring(points[joint], _SIDES[body.joint_sides[joint]]) for joint in dots])


def drawn_input(
    points: Float[np.ndarray, "joints 2"], missing: Bool[np.ndarray, " joints"], body: Body, crop: Crop
) -> str:
    """Return the keypoints as an SVG drawing; joints that were not seen as rings, with dashed bones."""
    placed = crop.place(points)
    rims, lines = [], []
    for (start, end), side in zip(body.bones, body.bone_sides, strict=True):
        if not np.isfinite(placed[[start, end]]).all():
            continue
        line = _line(placed[start], placed[end])
        unseen = " u" if missing[start] or missing[end] else ""
        rims.append("" if unseen else f'<path class="k" d="{line}"/>')
        lines.append(f'<path class="{_SIDES[side]}0{unseen}" d="{line}"/>')
    for joint in np.flatnonzero(np.isfinite(placed).all(1)).tolist():
        side = _SIDES[body.joint_sides[joint]]
        x, y = np.rint(placed[joint]).astype(int)
        dot = f'<circle class="d{side}" cx="{x}" cy="{y}" r="8"/>'
        lines.append(_ring(placed[joint], side) if missing[joint] else dot)
    return "".join(rims + lines)


def filled_points(
    keypoints: Float[np.ndarray, "joints 2"], seen: Bool[np.ndarray, " joints"], pose: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "joints 2"]:
    """Return keypoints with those that were not seen where the lifted pose has them (scale and place by least squares)."""
    points = np.where(seen[:, None], keypoints, np.nan).astype(float)
    known = seen & np.isfinite(pose).all(1)
    if known.sum() < 2:
        return points
    flat, target = pose[known, :2].astype(float), points[known]
    flat_mean, target_mean = flat.mean(0), target.mean(0)
    spread = ((flat - flat_mean) ** 2).sum()
    if spread <= 0:
        return points
    scale = ((flat - flat_mean) * (target - target_mean)).sum() / spread
    guess = (pose[:, :2] - flat_mean) * scale + target_mean
    return np.where(seen[:, None], points, guess)


def crop_of(points: Float[np.ndarray, "joints 2"]) -> Crop:
    """Return the square around points that are known, with a margin."""
    known = points[np.isfinite(points).all(1)]
    if not len(known):
        return Crop(0.0, 0.0, 1.0)
    low, high = known.min(0), known.max(0)
    side = max(float((high - low).max()), 1e-6) * 1.3
    left, top = (low + high) / 2 - side / 2
    return Crop(float(left), float(top), side)


def _line(start: np.ndarray, end: np.ndarray) -> str:
    x0, y0, x1, y1 = (round(float(value)) for value in (start[0], start[1], end[0], end[1]))
    return f"M{x0} {y0}L{x1} {y1}"


def _ring(point: np.ndarray, side: str) -> str:
    return f'<circle class="o{side}" cx="{round(float(point[0]))}" cy="{round(float(point[1]))}" r="9"/>'


def _tone(depth: float) -> int:
    return 0 if depth < -0.12 else 1 if depth < 0.12 else 2
