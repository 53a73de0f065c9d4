"""What a user knows of how the camera stands, in place of estimates; and in words, what was known and what estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.geometry.gravity import gravity_at, roll_of, tilt_of

if TYPE_CHECKING:
    from uplift.data.poses import PoseData

__all__ = ["KnownCamera", "about_cameras", "with_guessed_focal"]


@dataclass(frozen=True)
class KnownCamera:
    """The tilt and roll of all cameras of the input, degrees; None: estimated.

    The tilt is how far the camera looks down; the roll is how far up leans to the right in the image. Raises UserError
    for a tilt beyond -90 to 90 or a roll beyond -180 to 180.
    """

    tilt_deg: float | None = None
    roll_deg: float | None = None

    def __post_init__(self) -> None:
        for name, most in (("tilt_deg", 90), ("roll_deg", 180)):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and -most <= value <= most):
                raise UserError(f"camera.{name}={value}: expected degrees from -{most} to {most}.")

    def gravity(self, estimated: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
        """Return gravity in the camera frame, unit vectors: at the known angles, and at the ``estimated`` ones else."""
        if self.tilt_deg is None and self.roll_deg is None:
            return estimated
        tilt = tilt_of(estimated) if self.tilt_deg is None else np.full(len(estimated), float(self.tilt_deg))
        roll = roll_of(estimated) if self.roll_deg is None else np.full(len(estimated), float(self.roll_deg))
        return gravity_at(tilt, roll).astype(estimated.dtype)


def with_guessed_focal(data: PoseData, estimated: Float[np.ndarray, " frames"] | None = None) -> PoseData:
    """Return ``data`` with a focal length where none is known: as estimated, else the longest side of the image.

    The guess is said in a note.

    Raises:
        UserError: neither a camera nor the size of the image is known.
    """
    if data.rays() is not None:
        return data
    if data.image_size is None:
        raise UserError(
            "ground=true needs the camera: add focal_px=... and image_size=WIDTHxHEIGHT, or image_size= alone, and the "
            "focal length is guessed."
        )
    if estimated is not None:
        return data.with_focal_px(estimated.astype(np.float64))
    guess = float(max(data.image_size))
    note = f"the focal length is not known: {guess:g} px, the longest side of the image, is taken (focal_px=)"
    return replace(data, focal_px=guess, lenses=(), lens=None, notes=(*data.notes, note))


# What is said of the cameras.

_MOST_LINES = 4
_NO_ROLL_DEG = 1e-3


def about_cameras(
    data: PoseData,
    by_frame: Float[np.ndarray, "frames 3"],
    used: Float[np.ndarray, "frames 3"],
    known: KnownCamera,
    focal_px: Float[np.ndarray, " frames"] | None = None,
) -> tuple[str, ...]:
    """Return a line for the camera of each clip, or one for all where they are many: angles, and how surely.

    ``by_frame`` is gravity as each frame alone has it, ``used`` that of the poses, ``focal_px`` as
    estimated. Behind +- is the spread of single
    frames, the standard deviation of a normal distribution with their median deviation.
    """
    lifted = np.asarray((data.confidence > 0).any(1))
    if not lifted.any():
        return ()
    names = _views(data)
    views = list(dict.fromkeys(names[lifted].tolist()))
    if len(views) > _MOST_LINES:
        angles = _angles(by_frame[lifted], used[lifted], known, many=True)
        return (f"cameras of {len(views):,} clips: {angles}; {_focal(data, focal_px, lifted)}",)
    lines = []
    for name in views:
        rows = np.asarray(lifted & (names == name))
        which = f"camera of {name}" if len(views) > 1 else "camera"
        lines.append(f"{which}: {_angles(by_frame[rows], used[rows], known)}; {_focal(data, focal_px, rows)}")
    return tuple(lines)


def _focal(data: PoseData, estimated: np.ndarray | None, rows: np.ndarray) -> str:
    if data.lens is not None or data.focal_px is not None:
        return "focal length given" + (f" ({data.focal_px:,.0f} px)" if data.focal_px is not None else "")
    return (
        "focal length not known"
        if estimated is None
        else f"focal length estimated ({np.median(estimated[rows]):,.0f} px)"
    )


def _views(data: PoseData) -> np.ndarray:
    """Return the name of what each frame belongs to that one camera sees: its sequence and camera."""
    keys = [data.identity[key].astype(str) for key in ("sequence", "camera") if key in data.identity]
    if not keys:
        return np.full(len(data), "the input")
    return keys[0] if len(keys) == 1 else np.char.add(np.char.add(keys[0], ", camera "), keys[1])


def _angles(by_frame: np.ndarray, used: np.ndarray, known: KnownCamera, many: bool = False) -> str:
    frames = f"{len(used):,} frames" if len(used) > 1 else "one frame"
    parts = []
    for name, given, of in (("tilt", known.tilt_deg, tilt_of), ("roll", known.roll_deg, roll_of)):
        values, single = of(used), of(by_frame)
        if given is not None:
            parts.append(f"{name} {given:.1f} degrees, given")
        elif name == "roll" and np.abs(single).max() < _NO_ROLL_DEG:
            parts.append("roll taken as 0")
        elif many:
            low, middle, high = np.percentile(values, [5, 50, 95])
            parts.append(f"{name} {middle:.1f} degrees ({low:.1f} to {high:.1f}), estimated from {frames}")
        else:
            spread = 1.4826 * np.median(np.abs(single - np.median(single)))
            within = f" +- {spread:.1f}" if len(single) > 1 else ""
            parts.append(f"{name} {np.median(values):.1f}{within} degrees, estimated from {frames}")
    return "; ".join(parts)
