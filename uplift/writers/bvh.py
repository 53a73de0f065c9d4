"""One individual's clip as a Biovision hierarchy (``.bvh``): a rig and its turns, for animation programs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.bvh_rig import Rig, fit_rig
from uplift.writers.moving import frame_rate, held, known_points, one_clip, seen_at, steps

__all__ = ["BvhFit", "euler_zxy", "write_bvh"]

_CM_PER = {"mm": 0.1}
_MOST_REPEATS = 20
"""Frames in the file for each one there is."""


@dataclass(frozen=True)
class BvhFit:
    """How far the file's joints are from the predicted ones, in ``unit``: BVH has bones of one length only."""

    largest_error: float
    mean_error: float
    unit: str
    frames: int
    added: tuple[str, ...]
    """Joints without length, added where children of one joint move on their own."""

    def __str__(self) -> str:
        """Return a sentence for a log."""
        unit = "" if self.unit == "relative" else f" {self.unit}"
        return (
            f"bones of one length each: joints are {self.mean_error:.3g}{unit} from the predicted ones on average, "
            f"{self.largest_error:.3g}{unit} at most"
        )


def write_bvh(prediction: Prediction, path: str | Path, fps: int | float | None = None) -> BvhFit:
    """Write one clip of one individual and return how well it fits; ``fps`` replaces the prediction's.

    Lengths are centimetres where the prediction is in mm, else as they are; axes as given. Every bone has its
    median length, every direction is kept; the twist about a bone is not observed and left as small as it can be
    (see `fit_rig`). A joint or frame that is missing holds what was last known: BVH has no gaps. A joint at the end of
    a limb gets an end site a tenth of its bone further on. Raises UserError for several clips or individuals, where
    no rate is known, and for frame numbers with wide gaps.
    """
    clip = one_clip(prediction, path, individuals=False)
    rate = frame_rate(prediction, fps)
    if rate is None:
        raise UserError(f"cannot write {path}: a .bvh needs frames a second, which the input does not say. Add fps=30.")
    when = steps(clip)
    count = round(float(when[-1])) + 1
    if count > _MOST_REPEATS * len(when):
        raise UserError(
            f"cannot write {path}: a .bvh has no gaps, and the frames {clip.frames[0]} to {clip.frames[-1]} hold only "
            f"{len(when):,} poses. Write each stretch of frames on its own, or a .glb."
        )
    rows = clip.rows[seen_at(when, np.arange(count, dtype=float))]
    pose = known_points(prediction.pose[rows])
    place = (
        np.zeros((count, 3)) if prediction.root is None else held(known_points(prediction.root[rows][:, None])[:, 0])
    )
    rig = fit_rig(prediction, pose)
    with replacing(path) as handle:
        handle.write(_text(rig, place, _CM_PER.get(prediction.unit, 1.0), rate).encode())
    return _fit(rig, pose, place, prediction)


def euler_zxy(rotation: Float[np.ndarray, "frames 3 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return degrees about z, x, y (each about the axes turned before it) that change little from frame to frame."""
    x = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    z = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    y = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    angles = np.stack([z, x, y], 1)
    locked = np.hypot(rotation[:, 0, 1], rotation[:, 1, 1]) < 1e-6
    sum_or_gap = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    for now in range(len(angles)):
        if locked[now]:  # z and y turn about one axis: z stays
            angles[now, 0] = angles[now - 1, 0] if now else 0.0
            angles[now, 2] = np.sign(angles[now, 1]) * (sum_or_gap[now] - angles[now, 0])
        if now:
            angles[now] = _nearest(angles[now], angles[now - 1])
    return np.degrees(angles)


def _nearest(angles: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the same rotation by the angles nearest to those before."""
    other = np.array([angles[0] + np.pi, np.pi - angles[1], angles[2] + np.pi])
    both = [way + 2 * np.pi * np.round((before - way) / (2 * np.pi)) for way in (angles, other)]
    return min(both, key=lambda way: float(np.abs(way - before).sum()))


def _text(rig: Rig, place: np.ndarray, scale: float, rate: float) -> str:
    names = _plain(rig.tree.names)
    lines = ["HIERARCHY"]
    children: dict[int, list[int]] = {joint: [] for joint in range(-1, len(names))}
    for joint, parent in enumerate(rig.tree.parents):
        children[parent].append(joint)
    open_joints = [(0, 0)]
    while open_joints:
        joint, depth = open_joints.pop()
        pad = "  " * depth
        if joint < 0:
            lines.append(f"{pad}}}")
            continue
        lines += _joint_lines(rig, joint, names[joint], pad, scale)
        open_joints.append((-1, depth))
        open_joints += [(child, depth + 1) for child in reversed(children[joint])]
    lines += ["MOTION", f"Frames: {len(place)}", f"Frame Time: {1 / rate:.8f}"]
    values = np.concatenate([place * scale, *map(euler_zxy, rig.turned)], 1)
    lines += [" ".join(f"{value:.5f}" for value in row) for row in values + 0.0]
    return "\n".join([*lines, ""])


def _joint_lines(rig: Rig, joint: int, name: str, pad: str, scale: float) -> list[str]:
    place, turns = "Xposition Yposition Zposition ", "Zrotation Xrotation Yrotation"
    root = joint == 0
    lines = [
        f"{pad}{'ROOT' if root else 'JOINT'} {name}",
        f"{pad}{{",
        f"{pad}  {_offset(rig.tree.offsets[joint], scale)}",
    ]
    lines.append(f"{pad}  CHANNELS {6 if root else 3} {place if root else ''}{turns}")
    if np.isfinite(tip := rig.tree.tips[joint]).all():
        lines += [f"{pad}  End Site", f"{pad}  {{", f"{pad}    {_offset(tip, scale)}", f"{pad}  }}"]
    return lines


def _offset(offset: np.ndarray, scale: float) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in offset * scale + 0.0)


def _plain(names: tuple[str, ...]) -> list[str]:
    """Return names without spaces and braces, which divide the words of the file, each once."""
    found: list[str] = []
    for name in names:
        plain = short = re.sub(r"[\s{}]+", "_", name) or "_"
        number = 1
        while plain in found:
            number += 1
            plain = f"{short}_{number}"
        found.append(plain)
    return found


def _fit(rig: Rig, pose: np.ndarray, place: np.ndarray, prediction: Prediction) -> BvhFit:
    gap = np.linalg.norm(
        rig.positions(place) - (pose + place[:, None])[:, list(rig.sources)].transpose(1, 0, 2), axis=-1
    )
    gap = gap[np.isfinite(gap)]
    added = tuple(name for name in rig.tree.names if name not in prediction.joint_names)
    return BvhFit(float(gap.max()), float(gap.mean()), prediction.unit, len(place), added)
