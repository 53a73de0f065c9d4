"""The whole way from videos to poses, scored: 2D by the built-in detector, 3D by a run, against triangulated truth.

python -m benchmarks.video RUN [--videos FOLDER] [--detector-options model=heavy]

The truth is that of beam/ below UPLIFT_DATA (`beam_body25b_cam1.npz` ... 4). Its videos are those of Pose2Sim, BSD-3-Clause:
pip download --no-deps pose2sim==0.10.49, unpacked, the folder Pose2Sim/Demo_SinglePerson/videos; --videos names it, or
UPLIFT_VIDEOS. A video that is not there is left out.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.common import ROOT, BenchmarkError, data_folder, facts, write_json
from uplift.config.yaml_file import read_value
from uplift.data.load import in_skeleton, load_file
from uplift.data.poses import PoseData
from uplift.metrics.alignment import length, procrustes
from uplift.models.model import Model, load_poses
from uplift.video.detect import keypoints_of
from uplift.video.detector import make_detector
from uplift.video.frames import open_frames

_SIDES = ("l", "r")
_LEG = ("hip", "knee", "ankle")
_JOINTS = ("nose", *(side + joint for joint in ("shoulder", "elbow", "wrist", *_LEG) for side in _SIDES))
"""Of h36m17, which both trackers' layouts have."""
_FEWEST = 6


class _Timed:
    """An iterator or detector whose work is timed, in seconds of this process."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def call(self, function: Callable, *words: Any) -> Any:
        """Return what a function returns."""
        start = time.process_time()
        try:
            return function(*words)
        finally:
            self.seconds += time.process_time() - start


def _measure(model: Model, video: Path, truth: PoseData, options: dict[str, Any]) -> dict[str, float]:
    """Return the scores of one camera's video, and the frames a second of each stage on one core."""
    decode, detect, lift = _Timed(), _Timed(), _Timed()
    detector = make_detector("mediapipe", {"threads": 1, **options}, model.skeleton)
    look = detector.detect
    detector.detect = lambda image: detect.call(look, image)  # type: ignore[method-assign]
    with open_frames(video) as frames:
        read = iter(frames)
        frames._frames = _each(decode, read)
        data = keypoints_of(frames, detector, people=1)
    count = frames.count or len(data)
    prediction = lift.call(lambda: model.predict(in_skeleton([data], [], model.skeleton)))
    found = _scores(model, prediction.pose, data.identity["frame"], truth)
    stages = {"decode": decode.seconds, "detect": detect.seconds, "lift": lift.seconds}
    rates = {f"{name}, frames a second": round(count / seconds, 1) for name, seconds in stages.items()}
    return {**found, **rates, "all, frames a second": round(count / sum(stages.values()), 1)}


def _each(timer: _Timed, frames: Iterator) -> Iterator:
    while (frame := timer.call(next, frames, None)) is not None:
        yield frame


def _scores(model: Model, pose: np.ndarray, frame: np.ndarray, truth: PoseData) -> dict[str, float]:
    """Return p_mpjpe of the shared joints, mm, and the mean absolute error of both knees' flexion, degrees."""
    assert truth.pose is not None
    places = [model.skeleton.index(joint) for joint in _JOINTS]
    poses, true = pose[:, places].astype(float), truth.pose[frame][:, places].astype(float)
    known = np.isfinite(true).all(-1) & np.isfinite(poses).all(-1)
    rows = known.sum(1) >= _FEWEST
    aligned = procrustes(poses[rows], np.nan_to_num(true[rows]), known[rows].astype(float))
    error = np.where(known[rows], length(aligned - true[rows]), np.nan)
    knees = np.stack([_flexion(poses, side) - _flexion(true, side) for side in _SIDES])
    return {
        "frames": int(rows.sum()),
        "p_mpjpe": round(float(np.nanmean(np.nanmean(error, 1))), 1),
        "knee flexion, degrees": round(float(np.nanmean(np.abs(knees))), 1),
    }


def _flexion(pose: np.ndarray, side: str) -> np.ndarray:
    """Return (frames,) degrees that a knee is bent."""
    hip, knee, ankle = (pose[:, _JOINTS.index(side + joint)] for joint in _LEG)
    cosine = ((knee - hip) * (ankle - knee)).sum(-1) / (length(knee - hip) * length(ankle - knee))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def main() -> None:
    """Measure, print and store."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.video", description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder, lifter's file or ready lifter whose skeleton is h36m17")
    parser.add_argument("--videos", default=os.environ.get("UPLIFT_VIDEOS"), help="folder of cam01.mp4 ... cam04.mp4")
    parser.add_argument("--detector-options", nargs="*", default=[], metavar="KEY=VALUE")
    words = parser.parse_args()
    if not words.videos:
        raise BenchmarkError(
            "--videos, or UPLIFT_VIDEOS: the folder Pose2Sim/Demo_SinglePerson/videos of pose2sim 0.10.49"
        )
    torch.set_num_threads(1)
    options = {key: read_value(value) for key, _, value in (word.partition("=") for word in words.detector_options)}
    model, found = load_poses(words.run), {}
    for camera in range(1, 5):
        video = Path(words.videos) / f"cam0{camera}.mp4"
        if not video.is_file():
            print(f"camera {camera}: left out, no file {video}")
            continue
        truth = load_file(data_folder() / f"beam/beam_body25b_cam{camera}.npz", model.skeleton)
        found[f"camera {camera}"] = _measure(model, video, truth, options)
        print(
            f"camera {camera}",
            *(f"  {name}: {value}" for name, value in found[f"camera {camera}"].items()),
            sep="\n",
            flush=True,
        )
    if not found:
        raise BenchmarkError(f"no video of the four in {words.videos}")
    found["mean"] = {
        name: round(float(np.mean([one[name] for one in found.values()])), 1) for name in next(iter(found.values()))
    }
    print("mean", *(f"  {name}: {value}" for name, value in found["mean"].items()), sep="\n")
    command = " ".join(["python -m benchmarks.video RUN", *words.detector_options])
    write_json(ROOT / "benchmarks/results/video.json", {"command": command, **facts(), "figures": found})


if __name__ == "__main__":
    main()
