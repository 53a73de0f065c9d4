"""A motion file, or a folder of them, as joints in the world at a lower frame rate."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.amc import read_amc
from uplift.mocap.asf import AsfSkeleton, read_asf
from uplift.mocap.bvh import open_bvh
from uplift.mocap.human import human_joints, mended, unit_of
from uplift.mocap.layouts import layout_of
from uplift.mocap.trials import Trial

__all__ = ["Clip", "Rates", "read_clip"]

_WORLD_MM = 1e6


@dataclass(frozen=True)
class Rates:
    """Frames a second of the files, and of what is made of them."""

    fps: float = 10.0
    amc: float = 120.0
    """An .amc does not say its rate; CMU's are 120 Hz, some 60 Hz."""
    own: dict[str, float] = field(default_factory=dict)
    """Rates of subjects or motions, in place of anything else."""

    def step(self, trial: Trial, rate: float) -> int:
        """Return which frames to keep; raises UserError where ``fps`` does not divide the rate."""
        rate = self.own.get(trial.sequence, self.own.get(trial.subject, rate))
        step = round(rate / self.fps)
        if step < 1 or abs(rate / self.fps - step) > 0.001 * step:
            near = rate / max(1, step)
            raise UserError(
                f"{trial.path}: {rate:.4g} frames a second cannot be thinned out to fps={self.fps:g}. "
                f"Nearest: fps={near:.4g}. (A wrong rate is set right with rate={trial.sequence}:60.)"
            )
        return step


@dataclass(frozen=True)
class Clip:
    """The 17 joints of a motion."""

    subject: str
    sequence: str
    joints: Float[np.ndarray, "frames 17 3"]
    """mm, world, y up."""


def read_clip(trial: Trial, rates: Rates, unit_mm: float | None = None) -> Clip:
    """Read one motion.

    Raises:
        UserError: a file that is damaged or another one than it should be.
    """
    if trial.skeleton is not None:
        skeleton = _skeleton(trial.skeleton)
        layout = layout_of(skeleton.tree, skeleton.path)
        unit = unit_of(skeleton.tree, layout, skeleton.path, unit_mm or skeleton.unit_mm)
        figure = read_amc(trial.path, skeleton, rates.step(trial, rates.amc))
    else:
        file = open_bvh(trial.path)
        layout = layout_of(file.tree, file.path)
        unit = unit_of(file.tree, layout, file.path, unit_mm)
        # A captured root is never turned by exactly nothing.
        first = 0 if any(file.row(0)[3:6]) else layout.rest_frames
        if file.frames <= first:
            raise UserError(f"{trial.path}: no frames after the rest pose.")
        figure = file.figure(first, rates.step(trial, file.rate), mended(file.tree, layout))
    joints = human_joints(figure, layout, unit)
    if not (np.abs(joints) < _WORLD_MM).all():
        raise UserError(f"{trial.path}: joints farther than a kilometre from the origin: damaged, or another unit.")
    return Clip(trial.subject, trial.sequence, joints)


@lru_cache(maxsize=8)
def _skeleton(path: Path) -> AsfSkeleton:
    return read_asf(path)
