"""`Clip`: one sequence of Human3.6M seen by one camera, and the checks that all of its files share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.datasets.base import WantedFile
from uplift.datasets.h36m.cameras import CAMERAS, Camera
from uplift.datasets.h36m.names import ACTIONS, OF_32, is_corrupt, sequence_name
from uplift.errors import UserError

__all__ = ["Clip", "Family", "in_order", "in_room", "playable", "points_of", "table_of"]


@dataclass(frozen=True)
class Clip:
    """One sequence seen by one camera, not read yet."""

    subject: str
    action: str
    sequence: str
    camera_id: str
    camera: Camera
    where: str
    """Which file, and what in it, for messages."""
    frames: int
    """Of the motion capture, at 50 Hz."""
    positions: Callable[[int], np.ndarray]
    """Every so many frames: (frames, 17, 3) float32, camera frame, mm."""
    seen: Callable[[], np.ndarray] | None = None
    """(frames, joints, 2 or 3), px and confidence, in `layout`; None where the positions are projected."""
    layout: str = "h36m"


class Family:
    """One kind of files that Human3.6M comes in."""

    name: ClassVar[str] = ""
    files_of: ClassVar[dict[str, str]] = {}
    """Kind of keypoints to what it is read from."""

    def __init__(self, folder: Path, keypoints: str, partial: bool):
        self.folder, self.keypoints, self.partial = folder, keypoints, partial

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether the 3D of this kind is in ``folder``."""
        raise NotImplementedError

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether 2D of this kind is in ``folder``, or needs no file."""
        raise NotImplementedError

    def files(self, split: str) -> list[WantedFile]:
        """Return the files that ``split`` is read from."""
        raise NotImplementedError

    def clips(self, split: str) -> list[Clip]:
        """Return what is in them; raises UserError where they are not as they should be."""
        raise NotImplementedError


def table_of(value: Any, where: str, wanted: Collection[str] = ()) -> dict[str, Any]:
    """Return ``value`` where it is a dict by text that has the ``wanted`` keys; raises UserError."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise UserError(f"{where} is {_kind(value)}, expected a dict by name.")
    lacking = [key for key in wanted if key not in value]
    if lacking:
        found = ", ".join(sorted(value)[:12]) + (", ..." if len(value) > 12 else "")
        raise UserError(
            f"{where} has no {', '.join(lacking)} (found: {found or 'nothing'}): part of the file, or another's?"
        )
    return value


def points_of(value: Any, where: str, joints: Collection[int], size: Collection[int]) -> np.ndarray:
    """Return ``value`` as (frames, joints, size) where it is numbers of such a shape, flattened or not."""
    wanted = f"({', '.join(['frames', '|'.join(map(str, joints)), '|'.join(map(str, size))])}) of numbers"
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise UserError(f"{where} is {_kind(value)}, expected an array {wanted}.")
    if value.ndim == 2:
        fitting = [(j, s) for j in joints for s in size if j * s == value.shape[1]]
        value = value.reshape(len(value), *fitting[0]) if fitting else value
    if value.ndim != 3 or value.shape[1] not in joints or value.shape[2] not in size:
        raise UserError(f"{where} has shape {value.shape}, expected {wanted}.")
    return value


def _kind(value: Any) -> str:
    return f"an array of {value.dtype}, {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def in_room(points: np.ndarray, camera: Camera, factor: float = 1.0) -> Callable[[int], np.ndarray]:
    """Return `Clip.positions` for (frames, 32, 3) points of the room, ``factor`` mm a unit."""

    def positions(step: int) -> np.ndarray:
        chosen = points[::step, OF_32].astype(np.float32)
        if factor != 1:
            chosen *= np.float32(factor)
        return camera.see(chosen)

    return positions


def in_order(
    names: Sequence[str], subject: str, where: str, *, partial: bool, skip: Collection[tuple[str, str]] = ()
) -> list[tuple[str, str, str]]:
    """Return (name in the file, action, sequence) in the order of the papers' tables.

    Raises:
        UserError: a name that is no action, or an action that is missing, but for those in ``skip``.
    """
    known = [(name, *parsed) for name in names if (parsed := sequence_name(name, where))]
    place = {action: number for number, action in enumerate(ACTIONS)}
    lacking = [a for a in ACTIONS if a not in {action for _, action, _ in known} and (subject, a) not in skip]
    if lacking and not partial:
        raise UserError(
            f"{where}: {subject} has no {', '.join(lacking)} ({len(ACTIONS) - len(lacking)} of {len(ACTIONS)} actions). "
            "Get the rest, or set data.options.partial=true to go on with what is there."
        )
    sequences = [sequence for _, _, sequence in known]
    twice = [sequence for sequence in sequences if sequences.count(sequence) > 1]
    if twice:
        raise UserError(f"{where}: {subject} has '{twice[0]}' twice, under two names.")
    return sorted(known, key=lambda item: (place[item[1]], item[2]))


def playable(subject: str, sequence: str) -> list[str]:
    """Return the cameras that saw a sequence, but for the corrupt video."""
    return [camera for camera in CAMERAS if not is_corrupt(subject, sequence, camera)]
