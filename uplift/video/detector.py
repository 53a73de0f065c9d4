"""The class to subclass for a detector of your own, the detectors there are, and what one returns checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Float32, UInt8

from uplift.config.plugins import blame, build, find_class
from uplift.data.formats.rows import honest
from uplift.errors import UserError, listed
from uplift.skeleton import Skeleton
from uplift.skeleton.match import match_joints

__all__ = ["DETECTORS", "Detector", "found_in", "make_detector"]

DETECTORS = {
    "mediapipe": "uplift.video.blazepose:BlazePose",
    "mediapipe_hand": "uplift.video.blazepose:BlazeHand",
}


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

    def forget(self) -> None:
        """Be told that the next frame does not follow the one before, as with photos; nothing by default."""

    def close(self) -> None:
        """Let go of what is held, after the last frame; nothing by default."""


def make_detector(
    name: str | Detector | None, options: Mapping[str, Any], skeleton: Skeleton | None = None
) -> Detector:
    """Return the detector that ``name`` says, a built-in or ``file.py:Class``, made with ``options``; one that is made as it is.

    Without a name it is the built-in that finds the joints of ``skeleton``.

    Raises:
        UserError: no such detector, code that was not consented to, options that it does not take, no names of joints,
            or joints that do not fit the skeleton.
    """
    if isinstance(name, Detector):
        return _checked(name, type(name).__name__, skeleton)
    name = name or _fitting(skeleton)
    made = build(name, DETECTORS, options, "detector", Detector, setting="detector")
    return _checked(made, name, skeleton)


def _checked(made: Detector, name: str, skeleton: Skeleton | None) -> Detector:
    """Return a detector that can detect, and whose joints have names that differ and fit the skeleton."""
    kind, names = type(made), made.names
    if kind.detect is Detector.detect:
        raise UserError(f"detector={name}: {kind.__name__} has no method detect(self, image).")
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(one, str) for one in names):
        raise UserError(f"detector={name}: {kind.__name__}.names is {names!r:.60}, expected the names of its joints.")
    twice = [one for one, count in Counter(names).items() if count > 1]
    if twice or not names:
        wrong = (
            f"holds '{twice[0]}' twice; names must differ" if twice else "is empty, expected the names of its joints"
        )
        raise UserError(f"detector={name}: {kind.__name__}.names {wrong}.")
    if skeleton is not None:
        try:
            match_joints(names, skeleton)
        except UserError as error:
            made.close()
            raise UserError(f"detector={name}: {error}") from None
    return made


def _fitting(skeleton: Skeleton | None) -> str:
    """Return the built-in detector that finds the joints of a skeleton; the body's where there is none."""
    if skeleton is None:
        return next(iter(DETECTORS))
    for name in DETECTORS:
        with suppress(UserError):
            match_joints(find_class(name, DETECTORS, "detector").names, skeleton)
            return name
    raise UserError(
        f"no built-in detector finds the joints of {skeleton.name} ({listed(skeleton.joints, 4)}): give your own, "
        f"detector=my.py:MyDetector (docs/video.md), or keypoints of a tracker as input=. Built in: {listed(DETECTORS)}."
    )


def found_in(
    detector: Detector, image: UInt8[np.ndarray, "height width 3"]
) -> tuple[Float32[np.ndarray, "people joints 2"], Float32[np.ndarray, "people joints"]]:
    """Return what a detector finds in a frame, checked: keypoints, NaN and confidence 0 where a joint is not seen.

    Raises:
        UserError: it fails, or returns anything but two arrays of these shapes.
    """
    kind = type(detector)
    image.flags.writeable = False  # the same frame is shown behind the keypoints later
    with blame(f"detector: {kind.__name__}.detect", kind):
        found = detector.detect(image)
    try:
        keypoints, confidence = (np.asarray(one, np.float32) for one in found)
    except (TypeError, ValueError):
        raise UserError(
            f"detector: {kind.__name__}.detect returned {_kind_of(found)}, expected two arrays, keypoints (people, joints, 2) "
            "and confidence (people, joints)."
        ) from None
    count = len(detector.names)
    shape = (len(keypoints) if keypoints.ndim else 0, count)
    if keypoints.size == 0:
        return np.zeros((0, count, 2), np.float32), np.zeros((0, count), np.float32)
    if keypoints.shape != (*shape, 2) or confidence.shape != shape:
        raise UserError(
            f"detector: {kind.__name__}.detect returned keypoints of shape {keypoints.shape} and confidence of "
            f"{confidence.shape}, expected (people, {count}, 2) and (people, {count}): its {count} names."
        )
    return honest(keypoints, confidence)


def _kind_of(found: Any) -> str:
    return f"{type(found).__name__} of {len(found)}" if isinstance(found, tuple | list) else type(found).__name__
