"""What `predict ground=true` changes: sliding feet, the root's path, poses, the plane; scored on clips with true places.

python -m benchmarks.ground RUN FILE ...     # FILE below UPLIFT_DATA, such as cmu/test.npz
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.common import ROOT, data_folder, facts, write_json
from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.geometry.gravity import angle_deg, gravity_at
from uplift.metrics.alignment import length, procrustes
from uplift.models.metric_scale import KnownLength
from uplift.models.model import Model, load_poses
from uplift.models.prediction import Prediction

_STILL_MM = 20.0
"""A true foot that goes less far from one frame to the next, and is near its lowest, stands."""
_LOW_MM = 80.0


def measure(model: Model, truth: PoseData) -> dict[str, float]:
    """Return the figures of clips that were put on a ground, means over their frames; lengths in mm."""
    skeleton = model.skeleton
    along = tuple(skeleton.size["along"])
    places = [skeleton.index(joint) for joint in along]
    assert truth.pose is not None and truth.root is not None and truth.tilt_deg is not None
    size = KnownLength(along, float(np.median(length(np.diff(truth.pose[:, places], axis=1)).sum(1))))
    before = model.predict(truth.without_truth(), size=size)
    after = model.predict(truth.without_truth(), size=size, ground=True)
    assert after.ground is not None
    clips, feet = truth.clips(), np.flatnonzero(after.ground.contact.any(0))
    grounded = np.isfinite(after.ground.point[:, 0])
    rows = [
        (int((clips == clip).sum()), _of_clip(before, after, truth, clips == clip, feet))
        for clip in np.unique(clips[grounded])
    ]
    weight = [count for count, _ in rows]
    found = {}
    for name in rows[0][1]:
        values = np.array([figures[name] for _, figures in rows])
        known = np.isfinite(values)
        found[name] = round(float(np.average(values[known], weights=np.array(weight)[known])), 2)
        found[f"{name}, median clip"] = round(float(np.median(values[known])), 2)
    return {
        "clips": len(np.unique(clips)),
        "with a ground": len(rows),
        "share of frames": round(float(grounded.mean()), 3),
        **found,
    }


def _of_clip(
    before: Prediction, after: Prediction, truth: PoseData, rows: np.ndarray, feet: np.ndarray
) -> dict[str, float]:
    """Return the figures of one clip."""
    assert truth.pose is not None and truth.root is not None and truth.tilt_deg is not None and after.ground is not None
    true = (truth.pose + truth.root[:, None])[rows]
    down = gravity_at(truth.tilt_deg[rows])
    height = np.einsum("fjc,fc->fj", true[:, feet], down)
    level = np.median(height.max(1))
    still = (length(np.diff(true[:, feet], axis=0)) < _STILL_MM) & (height[1:] > level - _LOW_MM)
    still &= truth.follows()[rows][1:, None]
    contact = after.ground.contact[rows][:, feet]
    stays = contact[1:] & contact[:-1]
    normal, point = after.ground.normal[rows][0], after.ground.point[rows][0]
    found: dict[str, float] = {}
    for name, prediction in (("before", before), ("after", after)):
        assert prediction.root is not None
        points, root = prediction.points[rows], prediction.root[rows]
        way, true_root = length(np.diff(points[:, feet], axis=0)), true[:, after.skeleton.index(after.skeleton.root)]
        found[f"sliding {name}"] = float(way[still].mean()) if still.any() else np.nan
        path = procrustes(root[None], true_root[None])[0]
        found[f"root after a similarity, {name}"] = float(length(path - true_root).mean())
        shift = (root - true_root).mean(0)
        found[f"root after a shift, {name}"] = float(length(root - true_root - shift).mean())
        pose = prediction.pose[rows]
        found[f"p_mpjpe {name}"] = float(length(procrustes(pose, truth.pose[rows]) - truth.pose[rows]).mean())
    pairs = after.bone_indices
    bones = [length(np.diff(each.pose[rows][:, pairs], axis=2)[:, :, 0]) for each in (before, after)]
    found["greatest change of a bone"] = float(np.abs(bones[1] - bones[0]).max())
    assert before.gravity is not None
    found["gravity, degrees off"] = float(angle_deg(before.gravity[rows], down).mean())
    found["normal of the ground, degrees off"] = float(angle_deg(-normal[None], down).mean())
    found["height of the camera, share off"] = float(abs(-(normal @ point) / level - 1))
    found["contacts that stand"] = float((stays & still).sum() / max(stays.sum(), 1))
    found["standing that is in contact"] = float((stays & still).sum() / still.sum()) if still.any() else np.nan
    return found


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ground", description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder or lifter.pt")
    parser.add_argument("files", nargs="+", help="files below UPLIFT_DATA with pose, root and tilt_deg")
    words = parser.parse_args()
    model = load_poses(words.run)
    found = {}
    for file in words.files:
        truth, _ = clean(load_file(data_folder() / file, model.skeleton), model.skeleton)
        truth = truth.select(truth.in_order())
        found[file] = measure(model, truth)
        print(file, *(f"  {name}: {value}" for name, value in found[file].items()), sep="\n")
    command = " ".join(["python -m benchmarks.ground RUN", *words.files])
    write_json(ROOT / "benchmarks/results/ground.json", {"command": command, **facts(), "figures": found})


if __name__ == "__main__":
    main()
