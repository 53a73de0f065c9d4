"""Predictions for the tests of the writers: a walking stick figure seen from a tilted camera."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from uplift.export import WRITERS
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = ["ENDINGS", "chain", "complete_prediction", "figure", "needed", "pair", "places_of", "prediction", "tilted"]

ENDINGS = tuple(ending for ending in WRITERS["poses"] if ending != ".osim")
"""Of the formats that any skeleton is written in; OpenSim's is for people, and has tests of its own."""
_NEEDS = {
    ".nwb": ("pynwb", "ndx_pose"), ".nc": ("xarray", "h5netcdf"), ".dlc.h5": ("tables",), ".sleap.h5": ("h5py",),
    ".usda": ("pxr",), ".usdc": ("pxr",), ".c3d": ("ezc3d",), ".mp4": ("av",),
}  # fmt: skip
"""The modules that writers need beside what the package itself does."""
_REST = {
    "hip": (0, 0, 0), "neck": (0, -500, 0), "head": (0, -700, -40),
    "lhand": (350, -250, -60), "rhand": (-350, -250, 60), "lfoot": (120, 850, 0), "rfoot": (-120, 850, 0),
}  # fmt: skip


def needed(ending: str) -> str:
    """Return ``ending``; skips the test where a library that its writer needs is absent."""
    for module in _NEEDS.get(ending, ()):
        pytest.importorskip(module)
    return ending


def figure() -> Skeleton:
    """Return a skeleton of seven joints with gravity."""
    bones = (
        ("hip", "neck"),
        ("neck", "head"),
        ("neck", "lhand"),
        ("neck", "rhand"),
        ("hip", "lfoot"),
        ("hip", "rfoot"),
    )
    return Skeleton("figure", tuple(_REST), "hip", bones, mirror=(("rhand", "lhand"), ("rfoot", "lfoot")), gravity=True)


def chain(joints: int) -> Skeleton:
    """Return a skeleton of many joints in one line, without gravity."""
    names = tuple(f"point_{n}" for n in range(joints))
    return Skeleton("chain", names, names[0], tuple(pairwise(names)), gravity=False)


def tilted(tilt_deg: np.ndarray) -> np.ndarray:
    """Return rotations (frames 3 3) about x."""
    cos, sin, one, zero = np.cos(a := np.radians(tilt_deg)), np.sin(a), np.ones_like(a), np.zeros_like(a)
    return np.stack([one, zero, zero, zero, cos, -sin, zero, sin, cos], -1).reshape(-1, 3, 3)


def prediction(
    frames: int,
    individuals: int = 1,
    joints: int = 0,
    tilt: bool = True,
    uncertainty: bool = False,
    truth: bool = False,
    rooted: bool = False,
    **more,
) -> Prediction:
    """Return ``frames`` frames of each individual, of a chain instead of the figure if ``joints`` > 0.

    With ``rooted`` they walk to the right, 2 m apart, feet on the same floor, seen by a camera tilted by 8 degrees.
    """
    skeleton, random = (chain(joints) if joints else figure()), np.random.default_rng(3)
    rest = np.cumsum(random.normal(size=(joints, 3)) * 20, 0) if joints else np.array(list(_REST.values()), float)
    rest = rest - rest[0]
    rows, time = frames * individuals, np.tile(np.arange(frames), individuals)
    sway = np.sin(time / 5)[:, None, None] * random.normal(size=rest.shape) * 60
    level = (rest + sway) - (rest + sway)[:, :1]
    angle = random.normal(8, 3, rows) if tilt else np.zeros(rows)
    pose = np.einsum("fki,fjk->fji", tilted(angle), level)
    who = np.repeat(np.arange(individuals), frames)
    keypoints = pose[..., :2] * 0.2 + [320, 240] + (who[:, None] - (individuals - 1) / 2)[..., None] * [200, 0]
    walk = np.stack([2000.0 * who + 10 * time, 600 - level[..., 1].max(1), np.full(rows, 5000.0)], -1)
    values = {
        "root": walk @ tilted(np.array([8.0]))[0] if rooted else None,
        "tilt_deg": angle if tilt else None,
        "identity": {"frame": time * 3, "instance": np.array([f"animal {n}" for n in who])} if individuals > 1 else {},
        "uncertainty": np.full(pose.shape[:2], 150.0) if uncertainty else None,
        "truth": pose * 1.1 + random.normal(size=pose.shape) * 20 if truth else None,
        "fps": 30.0, "image_size": (640, 480), "source": "sample.npz", "title": "Sample",
    }  # fmt: skip
    ones = np.ones(pose.shape[:2])
    return Prediction(pose, level, "mm", keypoints, ones, skeleton.joints, skeleton, **{**values, **more})


def complete_prediction(frames: int) -> Prediction:
    """Return a prediction of two individuals with root, uncertainty and filled joints, for tables."""
    sample = prediction(frames=frames, individuals=2, uncertainty=True)
    rows, joints = sample.pose.shape[:2]
    root = np.random.default_rng(0).normal(size=(rows, 3)) * 1000 + [0, 0, 12345.678]
    return replace(sample, root=root, filled=np.arange(rows * joints).reshape(rows, joints) % 3 == 0)


def pair() -> Prediction:
    """Return Anna in frames 100 to 119 of a film but for 103 and 104, and Ben from 105 on; his head is missing in 110."""
    sample = prediction(20, individuals=2, rooted=True, uncertainty=True)
    frame, who = np.tile(np.arange(100, 120), 2), np.repeat(["Anna", "Ben"], 20)
    identity = {"sequence": np.full(40, "walk"), "frame": frame, "instance": who}
    sample = replace(sample, fps=25.0, identity=identity, filled=np.arange(280).reshape(40, 7) % 9 == 0)
    sample.pose[(who == "Ben") & (frame == 110), 2] = np.nan
    sample.confidence[:] = np.linspace(0.1, 1, 280).reshape(40, 7)
    return sample.select(np.where(who == "Anna", (frame != 103) & (frame != 104), frame >= 105))


def places_of(sample: Prediction, who: str, frame: int) -> np.ndarray:
    """Return the joints (joints 3) of one of a pair, NaN where that one is not there."""
    rows = np.flatnonzero((sample.identity["instance"] == who) & (sample.identity["frame"] == frame))
    return sample.points[rows[0]] if len(rows) else np.full(sample.pose.shape[1:], np.nan)
