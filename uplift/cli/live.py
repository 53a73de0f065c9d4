"""Live lifting: ``predict input=camera:0 output=live`` finds, lifts and shows frame after frame until it is stopped."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from uplift.cli.parsing import Keys
from uplift.config.progress import say
from uplift.config.run import Weights
from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError
from uplift.export.live import LivePage
from uplift.models.live import LiveLifter
from uplift.models.model import load_poses
from uplift.video.base import Frame, Frames
from uplift.video.detector import found_in, make_detector
from uplift.video.frames import is_frames, open_frames
from uplift.video.tracking import Tracker, sizes_of

__all__ = ["LIVE", "lift_live", "live_command"]

LIVE = "live"
"""The output that is a page of this machine."""
_TAKEN = (
    "run", "input", "output", "detector", "detector.options", "people", "video.start_s", "video.end_s", "focal_px", "trust",
    "port",
)  # fmt: skip
_MOST_PEOPLE = 4
"""Where ``people`` does not say how many: each costs time."""


def live_command(keys: Keys, weights: Weights) -> None:
    """Show the poses of a camera, or of a video in its place, as they come; print where, and how fast it was."""
    for key in keys:
        if key not in _TAKEN and not key.startswith("detector.options."):
            raise UserError(f"{key}= does not go with output=live, which takes {', '.join(_TAKEN[:-2])} and port.")
    if not is_frames(keys["input"]):
        raise UserError(f"output=live shows a camera, camera:0, or a video, not input={keys['input']}.")
    how = keys.detection()
    with open_frames(keys["input"], start_s=how["start_s"], end_s=how["end_s"]) as frames:
        if not frames.is_video:
            raise UserError(f"output=live shows a camera, camera:0, or a video; {keys['input']} is pictures.")
        lift_live(
            frames,
            weights,
            how["detector"],
            how["detector_options"],
            how["people"] or _MOST_PEOPLE,
            keys.reading(),
            keys.value("port"),
        )


def lift_live(
    frames: Frames,
    weights: Weights,
    detector: object,
    options: dict,
    people: int,
    reading: ReadOptions,
    port: int = 0,
    browse: bool = True,
) -> int:
    """Find, lift and show the frames until they end or Ctrl-C; return how many were shown.

    A frame is lifted while the next one is looked at, so two processors are used and the page is a frame behind.
    """
    model = load_poses(weights)
    finder = make_detector(detector, options, model.skeleton)  # type: ignore[arg-type]
    size = frames.width, frames.height
    given = reading.focal_px
    focal_px = float(given) if isinstance(given, int | float) else frames.focal_px
    lifter = LiveLifter(model, finder.names, size, focal_px)
    tracker, shown, start = Tracker(frames.fps), 0, time.monotonic()
    with LivePage(frames.source, model.skeleton, port=port) as page, ThreadPoolExecutor(1) as worker:
        say(f"look: {page.address} (Ctrl-C stops)")
        if browse:
            webbrowser.open(page.address)
        waiting: tuple[Frame, object] | None = None
        try:
            for frame in _paced(frames):
                found = worker.submit(found_in, finder, frame.image)
                if waiting is not None:
                    _show(page, lifter, tracker, people, *waiting)
                    shown += 1
                waiting = frame, found
            if waiting is not None:
                _show(page, lifter, tracker, people, *waiting)
                shown += 1
        except KeyboardInterrupt:
            pass
        finally:
            finder.close()
    seconds = time.monotonic() - start
    say(f"showed {shown:,} frames in {seconds:.1f} s, {shown / max(seconds, 1e-9):.1f} a second")
    return shown


def _show(page: LivePage, lifter: LiveLifter, tracker: Tracker, people: int, frame: Frame, found: object) -> None:
    """Lift the people that a frame shows, once they are found, and show them."""
    keypoints, confidence = found.result()  # type: ignore[attr-defined]
    there = np.flatnonzero((confidence > 0).any(1))
    keypoints, confidence = keypoints[there], confidence[there]
    largest = np.sort(np.argsort(-sizes_of(keypoints, confidence), kind="stable")[:people])
    keypoints, confidence = keypoints[largest], confidence[largest]
    numbers = tracker.follow(keypoints, confidence, frame.index)
    page.show(frame.index, frame.image, lifter.lift(keypoints, confidence, numbers, frame.time_s))


def _paced(frames: Frames) -> Iterator[Frame]:
    """Yield frames no sooner than they were taken; those of a camera come when they do."""
    start: float | None = None
    for frame in frames:
        if not frames.is_live:
            start = time.monotonic() - frame.time_s if start is None else start
            time.sleep(max(0.0, start + frame.time_s - time.monotonic()))
        yield frame
