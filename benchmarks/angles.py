"""How far off joint angles and gait of lifted poses are: by angle, with the calibration of their uncertainty, and by stride.

python -m benchmarks.angles RUN FILE ...     # FILE below UPLIFT_DATA with pose, such as cmu/test.npz or beam/beam_blazepose_cam1.npz
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT, data_folder, facts, write_json
from uplift.biomechanics.angles import Angles, angles_of, joint_angles, wrapped
from uplift.biomechanics.gait import MEASURES, gait_of
from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.geometry.gravity import gravity_at
from uplift.geometry.rigid import least_turn, quaternion_matrix
from uplift.metrics.evaluate import coverage_of
from uplift.models.metric_scale import KnownLength
from uplift.models.model import Model, load_poses
from uplift.models.prediction import Prediction

_DOWN = np.array([0.0, 1.0, 0.0])


def measure(model: Model, truth: PoseData, roll_deg: float) -> dict[str, object]:
    """Return the errors of every angle, degrees, over all frames, and those of gait over the strides of walks."""
    assert truth.pose is not None
    level = truth.pose
    if truth.tilt_deg is not None:
        turn = quaternion_matrix(least_turn(gravity_at(truth.tilt_deg, roll_deg), _DOWN))
        level = np.einsum("fij,fkj->fki", turn, truth.pose)
    found = model.predict(truth.without_truth(), size=_size(model, truth))
    angles = joint_angles(found)
    return {
        "frames": len(truth),
        "angles": _errors(angles, joint_angles(level, model.skeleton), truth.tilt_deg is not None, model),
        "gait of walks": _gait_errors(found, level, truth),
    }


def _roll_of(path: Path) -> float:
    """Return the roll of the camera of a file, degrees: of one of several whose ``cameras.json`` lies beside it, else 0."""
    cameras, number = path.with_name("cameras.json"), re.search(r"cam(\d+)$", path.stem)
    if number is None or not cameras.is_file():
        return 0.0
    return float(json.loads(cameras.read_text())["cameras"][int(number[1]) - 1]["roll"])


def _size(model: Model, truth: PoseData) -> KnownLength:
    """Return the true mean length along the skeleton's ``size``."""
    assert truth.pose is not None
    along = tuple(model.skeleton.size["along"])
    places = [model.skeleton.index(joint) for joint in along]
    return KnownLength(
        along, float(np.nanmedian(np.linalg.norm(np.diff(truth.pose[:, places], axis=1), axis=-1).sum(1)))
    )


def _errors(found: Angles, true: Angles, tilted: bool, model: Model) -> dict[str, dict[str, float]]:
    """Return for each angle, both sides together: mean and median error, the mean uncertainty, the shares inside its intervals."""
    off = np.abs(wrapped(found.values - true.values))
    groups: dict[str, list[int]] = {}
    for place, (name, angle) in enumerate(angles_of(model.skeleton).items()):
        if tilted or not any(isinstance(way, str) for way in angle[:4]):  # without a known tilt nothing is level
            groups.setdefault(name.removeprefix("right_").removeprefix("left_"), []).append(place)
    result = {}
    for name, places in groups.items():
        error = off[:, places]
        known = np.isfinite(error)
        if not known.any():
            continue
        figures = {"mean": error[known].mean(), "median": np.median(error[known]), "known": known.mean()}
        if found.uncertainty is not None:
            expected = found.uncertainty[:, places][known]
            inside = coverage_of(error[known], expected)
            figures |= {"uncertainty": expected.mean(), "inside 50 %": inside["0.5"], "inside 90 %": inside["0.9"]}
        result[name] = {key: round(float(value), 2) for key, value in figures.items()}
    return result


def _gait_errors(found: Prediction, level: np.ndarray, truth: PoseData) -> dict[str, float]:
    """Return mean absolute differences of every walk's mean measures from those of its true poses; lengths in mm."""
    action = truth.identity.get("action")
    if action is None or truth.fps is None:
        return {}
    clips, walks = truth.clips(), np.char.startswith(np.char.lower(action.astype(str)), "walk")
    rows, seen, walked = [], 0, 0
    for clip in np.unique(clips[walks]):
        here = np.flatnonzero(clips == clip)
        time = np.arange(len(here)) / truth.fps
        true, lifted = (gait_of(pose[here], time, found.skeleton) for pose in (level, found.level_pose))
        walked += bool(true.strides)
        seen += bool(true.strides and lifted.strides)
        if true.strides and lifted.strides:
            means = [
                {key: np.nanmean([one.measures[key] for one in gait.strides]) for key in MEASURES}
                for gait in (true, lifted)
            ]
            rows.append([abs(means[0][key] - means[1][key]) for key in MEASURES])
    figures = dict(zip(MEASURES, np.nanmean(rows, 0), strict=True)) if rows else {}
    return {"walks": walked, "found": seen, **{key: round(float(value), 3) for key, value in figures.items()}}


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.angles", description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder or lifter.pt")
    parser.add_argument("files", nargs="+", help="files below UPLIFT_DATA with pose")
    words = parser.parse_args()
    model = load_poses(words.run)
    found = {}
    for file in words.files:
        truth, _ = clean(load_file(data_folder() / file, model.skeleton), model.skeleton)
        found[file] = measure(model, truth.select(truth.in_order()), _roll_of(data_folder() / file))
        print(file, *(f"  {name}: {value}" for name, value in found[file].items()), sep="\n", flush=True)
    command = " ".join(["python -m benchmarks.angles RUN", *words.files])
    write_json(ROOT / "benchmarks/results/angles.json", {"command": command, **facts(), "figures": found})


if __name__ == "__main__":
    main()
