"""The verbs detect and detectors: keypoints of videos and pictures into a file, and where the networks are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uplift.cli.parsing import keyed
from uplift.config.files import refuse_existing, shipped_names
from uplift.config.plugins import find_class
from uplift.config.progress import say
from uplift.config.trust import Trust, consents
from uplift.data.formats import with_options
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.csv import write_keypoints_csv
from uplift.data.formats.npz import write_keypoints
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean, listed
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import match_joints
from uplift.video.detect import Detection, detect_in
from uplift.video.detector import DETECTORS, Detector
from uplift.video.frames import is_frames
from uplift.video.weights import FETCHED, fetch_networks, has_networks

__all__ = ["check_keypoints_output", "detect", "detect_command", "detectors_command", "keypoints_in"]

_ENDINGS = (".npz", ".csv")
_READING = ("fps", "focal_px", "min_confidence", "flip_x", "flip_y", "rotate")
"""What a user may say of a video as of a file of keypoints."""


@consents
def detect(
    input: str | Path,
    output: str | Path | None = None,
    *,
    detector: str | Detector | None = None,
    detector_options: Mapping[str, Any] | None = None,
    people: int | None = None,
    start_s: int | float | None = None,
    end_s: int | float | None = None,
    skeleton: str | Path | Skeleton | None = None,
    reading: ReadOptions | None = None,
    csv_safe: bool = False,
    trust: Trust = None,
) -> PoseData:
    """Return the keypoints of everyone in a video or pictures, in the detector's joints, and write them to ``output``, if given.

    The output is an .npz or .csv, which `uplift.predict` and fits read. ``detector`` is a built-in, ``file.py:Class`` or an
    object of a subclass of `uplift.Detector`; without one it is the built-in that finds the joints of ``skeleton``, or bodies.
    ``people`` is how many there are at most: the largest and longest in the picture. ``start_s`` and ``end_s`` are the part of
    a video that is looked at, seconds. ``reading`` is what the user knows of
    the video.

    Raises:
        UserError: no video or pictures, a detector that is not there or does not find the skeleton's joints, an output
            that exists or has another ending, nobody in it.
    """
    if not is_frames(input):
        raise UserError(f"input={input}: expected a video, a picture, a folder of pictures or camera:0.")
    if output is not None:
        check_keypoints_output(output, "output")
    chosen = skeleton if isinstance(skeleton, Skeleton) or skeleton is None else load_skeleton(skeleton)
    how = Detection(detector, detector_options or {}, people, start_s, end_s)
    return keypoints_in(input, output, how, chosen, reading, csv_safe=csv_safe)


def keypoints_in(
    input: str | Path,
    output: str | Path | None,
    how: Detection,
    skeleton: Skeleton | None,
    reading: ReadOptions | None,
    *,
    csv_safe: bool = False,
) -> PoseData:
    """Return the keypoints of a video or pictures, with what the user says of it, and write them to ``output``, if given.

    Raises:
        UserError: as `detect`.
    """
    given = reading or ReadOptions()
    for name in given.set_names():
        if name not in _READING:
            raise UserError(f"{name}= goes with files of keypoints; {input} is a video or pictures.")
    data = with_options(detect_in(input, how, skeleton), given)
    if output is not None and Path(output).suffix.lower() == ".csv":
        write_keypoints_csv(data, output, csv_safe=csv_safe)
    elif output is not None:
        write_keypoints(data, output)
    return data


def check_keypoints_output(output: str | Path, of: str) -> None:
    """Refuse a file of keypoints that cannot be written, before any work."""
    if Path(output).suffix.lower() not in _ENDINGS:
        raise UserError(f"{of}={output}: keypoints are written as {' or '.join(_ENDINGS)}.")
    refuse_existing(Path(output))
    if not Path(output).absolute().parent.is_dir():
        raise UserError(f"{of}={output}: no folder {Path(output).absolute().parent}. Create it first.")


def detect_command(words: Sequence[str]) -> None:
    """Detect, write, and print what was found."""
    keys = keyed("detect", words)
    reading = ReadOptions(**keys.given("fps", "focal_px", "min_confidence"))
    data = detect(
        keys["input"],
        keys["output"],
        **keys.detection(),
        skeleton=keys.value("skeleton"),
        reading=reading,
        csv_safe=keys.value("csv_safe"),
    )
    say("\n".join([*data.notes, _summary(data), f"wrote {keys['output']}"]))


def _summary(data: PoseData) -> str:
    """Return how many frames show how many, and how sure the detector is."""
    count = len(data) if data.stills else len(np.unique(data.clips()))
    what = "body" if data.stills else "clip"
    several = "bodies" if data.stills else "clips"
    rows = f"{count:,} {what if count == 1 else several}, {len(data):,} rows, {len(data.joint_names)} joints"
    return f"found {rows}, mean confidence {data.confidence[data.confidence > 0].mean():.2f}"


# detectors: what is built in, and its networks.


def detectors_command(words: Sequence[str]) -> None:
    """List the built-in detectors, or fetch the networks of one."""
    if not words:
        print("\n".join(_listing()))
        return
    if words[0] != "get" or len(words) > 2:
        raise UserError(
            f"detectors: found '{' '.join(words)}', expected `uplift detectors` or `uplift detectors get NAME`."
        )
    name = words[1] if len(words) == 2 else next(iter(DETECTORS))
    if name not in DETECTORS:
        raise UserError(f"detectors get {name}: no such built-in.{did_you_mean(name, DETECTORS)}")
    say(
        f"wrote {fetch_networks()}: {len(FETCHED)} networks of MediaPipe (Apache-2.0); no network is needed from now on"
    )


def _listing() -> list[str]:
    """Return a line for each built-in detector: its joints, whether its networks are there, the shipped skeletons it serves."""
    lines = []
    for name in DETECTORS:
        found = find_class(name, DETECTORS, "detector")
        there = "networks present" if has_networks(found.networks) else "networks missing"
        fits = [one for one in shipped_names("skeletons") if _fits(found.names, one)]
        lines.append(f"{name:<16} {len(found.names):>3} joints  {there:<17} for {listed(fits)}")
    hint = "uplift detectors get mediapipe fetches them once; your own: detector=my.py:MyDetector (docs/video.md)"
    return [*lines, "", hint]


def _fits(names: Sequence[str], skeleton: str) -> bool:
    try:
        return bool(match_joints(names, load_skeleton(skeleton)))
    except UserError:
        return False
