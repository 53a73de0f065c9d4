"""OpenSim's inverse kinematics of lifted people: errors of the markers, and angles against those of the true poses.

python -m benchmarks.opensim RUN      # real video (beam/) and motion capture (cmu/test.npz) below UPLIFT_DATA
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT, data_folder, facts, write_json
from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.export import write
from uplift.metrics.alignment import length
from uplift.models.metric_scale import KnownLength
from uplift.models.model import Model, load_poses
from uplift.models.prediction import Prediction

_BEAM = tuple(f"beam/beam_blazepose_cam{camera}.npz" for camera in (1, 2, 3, 4))
_CMU = {
    "05_01": "walk", "16_15": "walk", "16_17": "walk, 90-degree turn", "16_35": "run/jog", "127_03": "run",
    "16_01": "jump", "135_04": "kick", "05_08": "dance", "127_24": "dive and roll", "127_02": "range of motion",
}  # fmt: skip
"""Clips of cmu/test.npz, of which the first camera is taken."""
_BENT = {
    "knee_angle": ("hip", "knee", "ankle"),
    "elbow_flex": ("shoulder", "elbow", "wrist"),
}
"""Coordinates of hinges, and the three joints of h36m17 that span the same angle."""


def measure(model: Model, truth: PoseData) -> dict[str, float]:
    """Return the figures of one clip: mm, degrees (mean absolute, both sides), frames a second (start-up included)."""
    skeleton, along = model.skeleton, tuple(model.skeleton.size["along"])
    places = [skeleton.index(joint) for joint in along]
    assert truth.pose is not None
    size = KnownLength(along, float(np.nanmedian(length(np.diff(truth.pose[:, places], axis=1)).sum(1))))
    lifted = model.predict(truth.without_truth(), size=size)
    start = sum(os.times()[:4])  # of one core, this process and OpenSim's
    motion, errors = _solved(lifted)
    took = sum(os.times()[:4]) - start
    found = {
        "frames": len(lifted),
        "marker error, RMS mm": round(1000 * float(np.sqrt(np.mean(errors["marker_error_RMS"] ** 2))), 1),
        "marker error, largest mm": round(1000 * float(errors["marker_error_max"].max())),
        "frames a second of one core": round(len(lifted) / took),
    }
    for coordinate, joints in _BENT.items():
        sides = [(motion[f"{coordinate}_{side}"], [skeleton.index(side + joint) for joint in joints]) for side in "rl"]
        for name, poses in (("lifted", lifted.pose), ("true", truth.pose)):
            gaps = [np.abs(solved - _bend(poses, *three)) for solved, three in sides]
            found[f"{coordinate}, degrees from {name} joints"] = round(float(np.nanmean(gaps)), 1)
        found[f"{coordinate}, least"] = round(float(min(solved.min() for solved, _ in sides)))
        found[f"{coordinate}, largest"] = round(float(max(solved.max() for solved, _ in sides)))
    return found


def _solved(lifted: Prediction) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the columns of the motion and of the errors that are written."""
    with tempfile.TemporaryDirectory() as folder:
        write(lifted, Path(folder) / "clip.osim")
        return _columns(Path(folder) / "clip_ik.mot"), _columns(Path(folder) / "clip_ik_marker_errors.sto")


def _columns(file: Path) -> dict[str, np.ndarray]:
    lines = file.read_text().splitlines()
    start = lines.index("endheader") + 1
    table = np.array([line.split() for line in lines[start + 1 :]], float)
    return dict(zip(lines[start].split(), table.T, strict=True))


def _bend(pose: np.ndarray, above: int, at: int, below: int) -> np.ndarray:
    """Return how far three joints are from a straight line, degrees."""
    one, other = pose[:, above] - pose[:, at], pose[:, below] - pose[:, at]
    cosine = (one * other).sum(-1) / (np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1))
    return 180 - np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.opensim", description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder or lifter.pt, of the skeleton h36m17")
    model = load_poses(parser.parse_args().run)
    clips: dict[str, PoseData] = {}
    for file in _BEAM:
        clips[Path(file).stem], _ = clean(load_file(data_folder() / file, model.skeleton), model.skeleton)
    motions, _ = clean(load_file(data_folder() / "cmu/test.npz", model.skeleton), model.skeleton)
    sequence, camera = motions.identity["sequence"], motions.identity["camera"]
    for name, what in _CMU.items():
        rows = np.flatnonzero(sequence == name)
        clips[f"cmu {name}, {what}"] = motions.select(rows[camera[rows] == camera[rows][0]])
    found = {}
    for name, truth in clips.items():
        found[name] = measure(model, truth)
        print(name, *(f"  {figure}: {value}" for figure, value in found[name].items()), sep="\n", flush=True)
    command = "python -m benchmarks.opensim RUN"
    write_json(ROOT / "benchmarks/results/opensim.json", {"command": command, **facts(), "figures": found})


if __name__ == "__main__":
    main()
