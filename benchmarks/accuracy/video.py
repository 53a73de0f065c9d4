"""A real video: one man, four cameras that roll, two detectors; beside flat depth and MediaPipe's own 3D.

``python -m benchmarks.accuracy.video RUN FOLDER --json FILE``: FOLDER is ``beam`` of UPLIFT_DATA. It is one clip of
one man and is only scored: nothing is chosen by it.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from benchmarks.common import write_json
from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.data.parsers.npz import read_arrays
from uplift.errors import UserError
from uplift.geometry.gravity import gravity_at, roll_of, tilt_of
from uplift.metrics.alignment import counted
from uplift.metrics.baselines import flat_depth
from uplift.metrics.pose_metrics import flip_depth, frame_mean, joint_errors, not_flipped
from uplift.skeleton.match import match_joints

if TYPE_CHECKING:
    from uplift.models.model import Model

__all__ = ["CAMERAS", "DETECTORS", "shared_joints", "video"]

CAMERAS = (1, 2, 3, 4)
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FEWEST = 8
"""Frames with fewer of the 13 joints are left out."""

DETECTORS = {
    "blazepose": ("nose", *(f"{side}_{limb}" for limb in _LIMBS for side in ("left", "right"))),
    "body25b": ("Nose", *(f"{side}{limb.capitalize()}" for limb in _LIMBS for side in "LR")),
}
"""The 13 joints that both detectors have, in one order, by the names of each."""


def video(run: str | Path, folder: str | Path) -> dict[str, dict[str, dict[str, float]]]:
    """Return, by detector and camera, the errors of a run over the 13 joints, beside those of two other answers.

    ``p_mpjpe`` (mm) and ``facing`` of the run, ``frames`` that count, `p_mpjpe` of the keypoints at depth 0 (``flat``)
    and of MediaPipe's pose_world_landmarks (``mediapipe``), and the errors of ``tilt_deg`` and ``roll_deg``, pooled
    over the clip. ``mean`` is that over the cameras.

    Raises:
        UserError: a run of another skeleton, or files that are missing.
    """
    from uplift.models.model import load_poses

    model, folder = load_poses(run), Path(folder)
    cameras = json.loads((folder / "cameras.json").read_text())["cameras"]
    found: dict[str, dict[str, dict[str, float]]] = {}
    for detector in DETECTORS:
        by_camera = {}
        for camera in CAMERAS:
            stands = cameras[camera - 1]["tilt"], cameras[camera - 1]["roll"]
            by_camera[f"cam{camera}"] = _camera(model, folder, detector, camera, stands)
        names = by_camera["cam1"]
        by_camera["mean"] = {name: float(np.mean([of[name] for of in by_camera.values()])) for name in names}
        found[detector] = by_camera
    return found


def _camera(model: Model, folder: Path, detector: str, camera: int, stands: tuple[float, float]) -> dict[str, float]:
    """Return the figures of one detector's keypoints from one camera, whose true tilt and roll are given."""
    path = folder / f"beam_{detector}_cam{camera}.npz"
    data, _ = clean(load_file(path, model.skeleton), model.skeleton, drop=False)
    assert data.pose is not None
    places = [model.skeleton.index(joint) for joint in shared_joints(model, path, detector)]
    truth, seen = data.pose[:, places].astype(np.float64), data.confidence[:, places] > 0
    prediction = model.predict(data.without_truth())
    flat = flat_depth(data.keypoints, model.skeleton.root_index)[:, places]
    frames, error, facing = _errors(prediction.pose[:, places], truth, seen)
    found = {"frames": float(frames), "p_mpjpe": error, "facing": facing, "flat": _errors(flat, truth, seen)[1]}
    if detector == "blazepose":
        own = read_arrays(folder / f"mediapipe_world_cam{camera}.npz", ("pose", "joint_names"))
        names = own["joint_names"].tolist()
        found["mediapipe"] = _errors(own["pose"][:, [names.index(one) for one in DETECTORS[detector]]], truth, seen)[1]
    gravity = prediction.gravity
    if gravity is None and prediction.tilt_deg is not None:
        gravity = gravity_at(prediction.tilt_deg)
    if gravity is not None:
        pooled = gravity.mean(0, keepdims=True, dtype=np.float64)
        pooled /= np.linalg.norm(pooled)
        for name, value, true in zip(("tilt_deg", "roll_deg"), (tilt_of(pooled), roll_of(pooled)), stands, strict=True):
            found[name] = float(abs(value[0] - true))
    return found


def shared_joints(model: Model, path: Path, detector: str) -> list[str]:
    """Return the model's joints that are the 13 of `DETECTORS`, in its order; raises UserError where it lacks one."""
    with np.load(path, allow_pickle=False) as file:
        parts = match_joints(file["joint_names"].tolist(), model.skeleton).parts
    ours = {names[0]: joint for joint, names in parts.items() if len(names) == 1}
    lacking = [name for name in DETECTORS[detector] if name not in ours]
    if lacking:
        raise UserError(
            f"the run's skeleton '{model.skeleton.name}' has no joint that is {', '.join(lacking)} of {path}."
        )
    return [ours[name] for name in DETECTORS[detector]]


def _errors(
    pose: Float[np.ndarray, "frames joints 3"], truth: Float[np.ndarray, "frames joints 3"], seen: np.ndarray
) -> tuple[int, float, float]:
    """Return the number of frames that count, and their means of `p_mpjpe` and `facing`."""
    pose, weight = pose.astype(np.float64), counted(pose, truth, seen)
    rows = weight.sum(1) >= _FEWEST
    pose, truth, weight = pose[rows], truth[rows], weight[rows]
    kept, flipped = (
        frame_mean(joint_errors("p_mpjpe", one, truth, 0, weight), weight) for one in (pose, flip_depth(pose))
    )
    return int(rows.sum()), float(kept.mean()), float(not_flipped(kept, flipped).mean())


def main() -> int:
    """Print the figures of a run; with ``--json`` also write them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.video", description=__doc__)
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("folder", metavar="FOLDER")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the results to this file")
    given = parser.parse_args()
    try:
        found = video(given.run, given.folder)
    except (UserError, OSError) as error:
        print(f"video: {error}", file=sys.stderr)
        return 2
    if given.json:
        write_json(given.json, found)
    for detector, by_camera in found.items():
        for camera, figures in by_camera.items():
            print(f"{detector:10} {camera:5}", *(f"{name} {value:.2f}" for name, value in figures.items()), sep="  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
