"""What one fresh process finds of a writer: ``ENDING PATH FRAMES``; JSON on its last line."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reading.measure import measured
from uplift.data.synthetic.simulate import simulate
from uplift.export import write
from uplift.models.prediction import Prediction
from uplift.skeleton import load_skeleton

__all__ = ["FILMS", "MOST_FRAMES", "prediction", "written"]

FILMS = (".gif", ".mp4")
"""Endings that get a hundredth of the frames."""
MOST_FRAMES = {".c3d": 65_535}
"""What a file of an ending can hold."""
_CLIP, _FPS = 1000, 25.0


def prediction(frames: int) -> Prediction:
    """Return simulated motion of one body, to and fro, as a lifter hands it over."""
    skeleton = load_skeleton("h36m17")
    length = min(frames, _CLIP)
    clip = simulate(skeleton, length, fps=_FPS, clip_seconds=length / _FPS, subjects=1)
    assert clip.pose is not None
    turn = np.arange(frames) % max(2 * length - 2, 1)
    rows = np.minimum(turn, 2 * length - 2 - turn) if length > 1 else turn
    rng = np.random.default_rng(0)
    pose = clip.pose[rows] + rng.normal(0, 1, (frames, *clip.pose.shape[1:]))  # mm; no two frames alike
    return Prediction(
        pose=pose - pose[:, skeleton.root_index, None],
        level_pose=pose,
        unit=clip.unit,
        keypoints=clip.keypoints[rows],
        confidence=clip.confidence[rows],
        joint_names=clip.joint_names,
        skeleton=skeleton,
        tilt_deg=None,
        identity={"frame": np.arange(frames), "sequence": np.full(frames, "walk")},
        fps=_FPS,
        image_size=clip.image_size,
        root=None if clip.root is None else clip.root[rows],
        spread=np.full(pose.shape[:2], 20.0),
        source="walk",
    )


def written(ending: str, path: Path, frames: int) -> dict[str, Any]:
    """Write a prediction, and return what that took."""
    of = prediction(frames)
    files, found = measured(lambda: write(of, path / f"walk{ending}"))
    return found | {"frames": frames, "bytes": sum(file.stat().st_size for file in files)}


if __name__ == "__main__":
    print(json.dumps(written(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))))
