"""The class to subclass for a detector of your own, the detectors there are, and what one returns checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Float32, UInt8

from uplift.config.plugins import blame, build
from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.match import match_joints

__all__ = ["DETECTORS", "Detector", "detector_for", "found_in", "make_detector"]

DETECTORS = {
    "mediapipe": "uplift.video.blazepose:BlazePose",
    "mediapipe_hand": "uplift.video.blazepose:BlazeHand",
}
_JOINTS = {"mediapipe": "body", "mediapipe_hand": "hand"}


class Detector:
    """Subclass this, set `names`, write `detect`, and name the class: ``detector=my.py:MyDetector``.

    It is made once for a video, with ``detector.options.KEY=VALUE`` as the arguments of its ``__init__``, and is given the
    frames in order, so that it may remember where people were. It need not tell people apart: they are followed
    from frame to frame afterwards.
    """

    names: ClassVar[tuple[str, ...]] | tuple[str, ...] = ()
    """The joints that it finds, in the order of the arrays; matched with a skeleton by name."""
    notes: tuple[str, ...] = ()
    """What a user should know of what it found, one sentence each; asked for after the last frame."""

    def detect(
        self, image: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[Float[np.ndarray, "people joints 2"], Float[np.ndarray, "people joints"]]:
        """Return the keypoints of everyone in an RGB image, pixels (x right, y down), and confidences from 0 to 1.

        A joint that is not seen has confidence 0, or NaN in place of a number; nobody there: arrays of no rows.
        """
        raise NotImplementedError(f"{type(self).__name__} has no detect(self, image)")

    def close(self) -> None:
        """Let go of what is held, after the last frame; nothing by default."""
