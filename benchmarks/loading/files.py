"""Simulated files of Human3.6M's full size, in VideoPose3D's format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.data.datasets.h36m_files import ACTIONS, CAMERAS, OF_32, published
from uplift.data.formats.layouts import H36M_JOINTS as JOINTS
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton

__all__ = ["FRAMES", "settings_of", "write_full_size"]

SUBJECTS = ("S1", "S5", "S6", "S7", "S8", "S9", "S11")
FRAMES = 530_000
"""Motion capture frames at 50 Hz over all subjects, each seen by four cameras."""


def write_full_size(
    folder: Path, frames: int = FRAMES, *, keypoints: tuple[str, ...] = ("gt",), compress: bool = True
) -> None:
    """Write data_3d_h36m.npz and data_2d_h36m_gt.npz: 7 subjects, 15 actions twice, four cameras.

    The same motion repeats, shifted and rotated so that no two sequences are equal. ``keypoints`` may include ``cpn``:
    the ground truth with noise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    motion = _standing(simulate(load_skeleton("h36m17"), 20_000, fps=50.0, clip_seconds=20.0))
    each = frames // (len(SUBJECTS) * len(ACTIONS) * 2)
    metres: dict[str, dict[str, np.ndarray]] = {}
    seen: dict[str, dict[str, list[np.ndarray]]] = {}
    for subject in SUBJECTS:
        metres[subject], seen[subject] = {}, {}
        for name in (name for action in ACTIONS for name in (action, f"{action} 1")):
            if (subject, name) == ("S11", "Directions"):
                continue
            length = int(each * rng.uniform(0.8, 1.2))
            body = _moved(rng, motion, length)
            points = np.repeat(body[:, :1], 32, 1)
            points[:, OF_32] = body
            metres[subject][name] = points / np.float32(1000)
            cameras = [published(subject, camera, swapped=True) for camera in CAMERAS]
            seen[subject][name] = [camera.lens.project(camera.see(body)) for camera in cameras]
    save = np.savez_compressed if compress else np.savez
    save(folder / "data_3d_h36m.npz", positions_3d=_boxed(metres))
    symmetry = [[JOINTS.index(joint) for joint in JOINTS if joint[0] == side] for side in "lr"]
    metadata = {"num_joints": len(JOINTS), "keypoints_symmetry": symmetry}
    if "gt" in keypoints:
        save(folder / "data_2d_h36m_gt.npz", positions_2d=_boxed(seen), metadata=_boxed(metadata))
    if "cpn" in keypoints:
        for views in (views for of in seen.values() for views in of.values()):
            for view in views:
                view += rng.standard_normal(view.shape, np.float32) * 3
        save(folder / "data_2d_h36m_cpn_ft_h36m_dbb.npz", positions_2d=_boxed(seen), metadata=_boxed(metadata))


def settings_of(folder: str | Path, *more: str) -> Settings:
    """Return the settings of a fit at the full frame rate, with the files in ``folder``."""
    return load_settings("h36m", ["data.options.fps=50", f"data.root={folder}", *more])


def _standing(data) -> np.ndarray:
    """Return simulated poses as (frames, 17, 3) mm in a world with z up, feet on the floor."""
    pose, tilt = data.pose, np.radians(data.tilt_deg)[:, None]
    down = np.cos(tilt) * pose[..., 1] + np.sin(tilt) * pose[..., 2]
    away = np.cos(tilt) * pose[..., 2] - np.sin(tilt) * pose[..., 1]
    return np.stack([pose[..., 0], away, down.max(1, keepdims=True) - down], -1).astype(np.float32)


def _moved(rng: np.random.Generator, motion: np.ndarray, length: int) -> np.ndarray:
    """Return ``length`` frames from a random start, rotated about the vertical and shifted."""
    rows = (rng.integers(len(motion)) + np.arange(length)) % len(motion)
    turn = rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]], np.float32)
    body = motion[rows] @ rotation.T * np.float32(rng.uniform(0.9, 1.1))
    body[..., :2] += rng.uniform(-800, 800, 2).astype(np.float32)
    return body


def _boxed(value: object) -> np.ndarray:
    box = np.empty((), object)
    box[()] = value
    return box
