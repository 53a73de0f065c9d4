"""P-MPJPE of the real video with two to four cameras together: `python -m benchmarks.several_cameras runs/cmu/last DATA/beam`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.metrics.pose_metrics import joint_errors
from uplift.models.model import Model, load_poses

_SHARED = (
    "nose",
    *(f"{side}{joint}" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in "lr"),
)


def main(run: str, folder: str) -> None:
    """Print the error of each set of cameras, for both detectors, and of each camera alone."""
    model = load_poses(run)
    for detector in ("blazepose", "body25b"):
        views = [
            load_file(Path(folder) / f"beam_{detector}_cam{number}.npz", model.skeleton) for number in (1, 2, 3, 4)
        ]
        for count in (1, 2, 3, 4):
            for chosen in combinations(range(4), count):
                print(detector, [at + 1 for at in chosen], f"{_error(model, [views[at] for at in chosen], views):.1f}")
        guessed = [replace(view, focal_px=None) for view in views]
        print(detector, "focal lengths not known", f"{_error(model, guessed, views):.1f}")


def _error(model: Model, chosen: Sequence[PoseData], views: Sequence[PoseData]) -> float:
    """Return the mean over frames, in the axes-free way of Procrustes; a truth that one view lacks is another's."""
    body, _ = model.predict_together([view.without_truth() for view in chosen])
    shared = [model.skeleton.index(joint) for joint in _SHARED]
    errors = []
    for view in views:
        assert view.pose is not None
        frames = np.isin(view.identity["frame"], body.identity["frame"])
        truth = view.pose[frames][:, shared].astype(np.float64)
        errors.append(np.nanmean(joint_errors("p_mpjpe", body.pose[:, shared].astype(np.float64), truth, 0), axis=1))
    return float(np.nanmean(np.nanmean(errors, axis=0)))


if __name__ == "__main__":
    main(*sys.argv[1:])
