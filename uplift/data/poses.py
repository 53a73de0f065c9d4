"""`PoseData`: 2D keypoints, and what is known beside them: confidence, poses, masks, identity, cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from uplift.data.names import Names, codes_of
from uplift.data.samples import TRUTH, Samples
from uplift.errors import UserError
from uplift.geometry.lens import Lens

if TYPE_CHECKING:
    from uplift.geometry.normalise import Intrinsics

__all__ = [
    "IDENTITY_KEYS",
    "UNITS",
    "USUAL_FPS",
    "PoseData",
    "clips_of",
    "mask_maps",
    "masks_of",
    "previous_frames",
]

UNITS = ("mm", "px", "relative")
USUAL_FPS = 30.0
"""Frames a second where the rate is not known."""

IDENTITY_KEYS = ("subject", "action", "sequence", "camera", "frame", "instance", "image", "category")


def _runs_of(codes: np.ndarray) -> Iterator[tuple[int, slice | np.ndarray]]:
    """Yield each code with its rows: as slices where equal codes stand together, which copy nothing."""
    starts = np.flatnonzero(np.diff(codes, prepend=codes[:1] - 1))
    if 16 * len(starts) > len(codes):
        yield from ((int(code), np.flatnonzero(codes == code)) for code in np.unique(codes))
        return
    yield from ((int(codes[a]), slice(a, b)) for a, b in zip(starts, np.append(starts[1:], len(codes)), strict=True))


@dataclass
class PoseData(Samples):
    """Frames of 2D keypoints; poses where they are known.

    Missing joints have confidence 0 and keypoint 0 once `uplift.data.clean.clean` has run; a
    reader may leave NaN. The truth (`pose`, `root`, `tilt_deg`, `gravity`) is never an input of training
    from 2D alone.
    """

    keypoints: Float[np.ndarray, "frames joints 2"]
    """float32, pixels, x right, y down."""
    confidence: Float[np.ndarray, "frames joints"]
    """float32, 0..1, 0 = missing."""
    joint_names: tuple[str, ...]
    pose: Float[np.ndarray, "frames joints 3"] | None = field(default=None, metadata=TRUTH)
    """Camera frame, relative to the root joint, in `unit`."""
    root: Float[np.ndarray, "frames 3"] | None = field(default=None, metadata=TRUTH)
    """The root joint in the camera frame, in `unit`."""
    unit: str = "mm"
    identity: dict[str, Any] = field(default_factory=dict)
    """Any of `IDENTITY_KEYS`: arrays (frames,) of numbers, and text as `Names`; one sequence seen by one camera is a clip."""
    fps: float | None = None
    image_size: tuple[int, int] | None = None
    focal_px: float | None = None
    tilt_deg: Float[np.ndarray, " frames"] | None = field(default=None, metadata=TRUTH)
    """Down-tilt of the camera: gravity is (0, cos, sin) in the frame of a camera without roll."""
    gravity: Float[np.ndarray, "frames 3"] | None = field(default=None, metadata=TRUTH)
    """Unit vectors in the camera frame, for cameras that may roll; None: not known but for `tilt_deg`."""
    root_filled: Bool[np.ndarray, " frames"] | None = None
    """The root was missing; its keypoint is the mean of its neighbours, its confidence 0."""
    labelled: Bool[np.ndarray, " frames"] | None = field(default=None, metadata=TRUTH)
    """Frames whose pose training may learn from; None: no frame's."""
    masks: UInt8[np.ndarray, "frames side side"] | None = None
    """Square crops of the image: 0 outside the body, 255 inside; row 0 is the top."""
    mask_box: Float[np.ndarray, "frames 3"] | None = None
    """float32, x0, y0, side of each crop, px in the image; NaN = frame without a mask."""
    stills: bool = False
    """Frames of a sequence do not follow one another as those of a film do: each is a clip of its own."""
    source: str = ""
    lenses: tuple[Lens, ...] = ()
    """The cameras, where more is known of them than `focal_px` and `image_size`."""
    lens: Int[np.ndarray, " frames"] | None = None
    """Which of `lenses` saw the frame; None without lenses."""
    bones: tuple[tuple[str, str], ...] = ()
    """Lines between joints, by name, where the file has them; training goes by the skeleton's."""
    mirror: tuple[tuple[str, str], ...] = ()
    """Pairs of partners, by name, where the file has them."""
    notes: tuple[str, ...] = ()
    """What the reader assumed or left out, one sentence each."""

    def __post_init__(self) -> None:
        self.joint_names = tuple(str(name) for name in self.joint_names)
        where = f"{self.source}: " if self.source else ""
        self.keypoints = _numbers(where, "keypoints", self.keypoints)
        self.confidence = _numbers(where, "confidence", self.confidence)
        if not all(isinstance(values, (np.ndarray, Names)) for values in self.identity.values()):
            self.identity = {key: _column(values, len(self.keypoints)) for key, values in self.identity.items()}
        text = {key: Names.of(values) for key, values in self.identity.items() if values.dtype.kind == "U"}
        self.identity = self.identity | text if text else self.identity
        _check_masks(self.source or "the data", self.masks, self.mask_box, len(self))
        wrong = self.misfit()
        if not wrong and len(self.joint_names) != self.keypoints.shape[1]:
            wrong = f"{len(self.joint_names)} joint names for {self.keypoints.shape[1]} joints in 'keypoints'"
        if wrong:
            raise UserError(f"{where}{wrong}.")

    @property
    def centre_px(self) -> tuple[float, float] | None:
        """The middle of the image, taken as the pixel of the optical axis; None without an image size."""
        return None if self.image_size is None else (self.image_size[0] / 2, self.image_size[1] / 2)

    def with_focal_px(self, focal_px: Float[np.ndarray, " frames"], among: np.ndarray | None = None) -> PoseData:
        """Return the frames with the focal length of each, in pixels; where they differ the image size must be known.

        ``among`` are those of all frames, where these are a part of them.
        """
        values = np.unique(focal_px if among is None else among)
        lens = np.searchsorted(values, focal_px)
        if len(values) == 1:
            return replace(self, focal_px=float(values[0]), lenses=(), lens=None)
        if self.image_size is None:
            note = "focal_px is not the same in all frames, needs image_size=WIDTHxHEIGHT then, and is not used"
            return replace(self, focal_px=None, lenses=(), lens=None, notes=(*self.notes, note))
        lenses = tuple(Lens.ideal(float(value), self.image_size) for value in values)
        return replace(self, focal_px=None, lenses=lenses, lens=lens.astype(np.int16))

    def straightened(self) -> PoseData:
        """Return the frames as one ideal camera without distortion sees them; the same where no lenses are known."""
        if self.lens is None:
            return self
        focal_px = float(np.mean([lens.focal_px for lens in self.lenses]))
        size = self.lenses[0].image_size or (1000, 1000)
        straight = np.empty_like(self.keypoints)
        middle = np.array(size, np.float32) / 2
        for place, rows in _runs_of(self.lens):
            straight[rows] = self.lenses[place].rays(self.keypoints[rows]) * np.float32(focal_px) + middle
        seen = self.confidence > 0
        if self.root_filled is not None and self.root_filled.any():  # what stands in for a root is measured from, too
            seen = seen | (self.root_filled[:, None] & (self.keypoints != 0).any(-1))
        if not seen.all():
            straight[~seen] = 0
        bent = ["masks are not used: the lenses bend their images, or differ"] if self.masks is not None else []
        changed = {"focal_px": focal_px, "image_size": size}
        changed |= {"lenses": (), "lens": None, "masks": None, "mask_box": None}
        return replace(self, keypoints=straight.astype(np.float32, copy=False), notes=(*self.notes, *bent), **changed)

    def rays(self) -> np.ndarray | None:
        """Return (frames joints 2) keypoints as x/z and y/z of the camera's frame; None where the camera is not known."""
        if self.lens is not None:
            straight = self.straightened()
            return None if straight is self else straight.rays()
        if self.focal_px is None or self.centre_px is None:
            return None
        return (self.keypoints - np.array(self.centre_px, np.float32)) / np.float32(self.focal_px)

    def in_order(self) -> np.ndarray:
        """Return the rows with the frames of each clip together and in time, clips as they first come."""
        rows = np.arange(len(self))
        if "sequence" not in self.identity or self.stills:
            return rows
        clip = self.clips()
        _, first, code = np.unique(clip, return_index=True, return_inverse=True)
        when = self.identity["frame"].astype(np.float64) if "frame" in self.identity else rows
        return np.lexsort((rows, when, first[code]))

    def clips(self) -> np.ndarray:
        """Return (frames,) clip numbers: frames of one subject, sequence, camera and instance.

        Frames without a ``sequence``, and `stills`, are clips of their own: nothing says that
        neighbours in the file are neighbours in time.
        """
        if "sequence" not in self.identity or self.stills:
            return np.arange(len(self), dtype=np.int64)
        return clips_of(self.identity)

    def bodies(self) -> Int[np.ndarray, " frames"]:
        """Return the number of each frame's body, from 0 without gaps: by subject if they are named, else by clip, else one for all."""
        if "subject" in self.identity:
            return clips_of(self.identity, ("subject", "instance"))
        clips = self.clips()
        return clips if clips.max(initial=-1) + 1 < len(clips) else np.zeros_like(clips)

    def previous(self) -> Int[np.ndarray, " frames"]:
        """Return the row of the frame before each in its clip, -1 without one (see `previous_frames`)."""
        return previous_frames(self.clips(), self.identity.get("frame"))

    def follows(self) -> Bool[np.ndarray, " frames"]:
        """Return whether each frame is the next of its clip after the one before it in the file."""
        previous = self.previous()
        return (previous >= 0) & (previous == np.arange(len(self)) - 1)


def _numbers(where: str, name: str, values: Any) -> np.ndarray:
    """Return what was given as an array of real numbers: lists and whole numbers as float32, arrays of floats as they are."""
    if isinstance(values, np.ndarray) and values.dtype.kind == "f":
        return values
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise UserError(f"{where}'{name}' has rows of different lengths, expected one array of numbers.") from None
    if array.ndim == 0 or array.dtype.kind not in "fiub":
        kind = type(values).__name__ if array.ndim == 0 else f"{array.dtype} of shape {array.shape}"
        raise UserError(f"{where}'{name}' is {kind}, expected an array of numbers.")
    return array.astype(np.float32)


def _column(values: Any, frames: int) -> Any:
    """Return values of frames as an array; one value holds for all of them."""
    array = values if isinstance(values, Names) else np.asarray(values)
    return np.repeat(array, frames) if array.ndim == 0 else array


def clips_of(
    identity: Mapping[str, Any], by: Sequence[str] = ("subject", "sequence", "camera", "instance")
) -> Int[np.ndarray, " frames"]:
    """Return clip numbers from 0 without gaps: one for all frames that are alike in what ``by`` names."""
    keys = [identity[key] for key in by if key in identity]
    clip = np.zeros(len(keys[0]), np.int64)
    for key in keys:
        _, code = codes_of(key)
        _, clip = codes_of(clip * (code.max(initial=0) + 1) + code)
    return clip


def previous_frames(
    clip: Int[np.ndarray, " frames"], frame: Shaped[np.ndarray, " frames"] | Names | None = None
) -> Int[np.ndarray, " frames"]:
    """Return the row of the frame before each in its clip, -1 without one.

    The step of a clip is the most common difference of its ``frame`` numbers; a larger one is a gap, and nothing
    comes before the frame after it. Without ``frame`` numbers the rows of a clip are neighbours in time.
    """
    time = np.arange(len(clip), dtype=np.float64) if frame is None else frame.astype(np.float64)
    order = np.lexsort((time, clip))
    before, after = order[:-1], order[1:]
    step = np.where(clip[before] == clip[after], time[after] - time[before], 0)
    follows = step > 0
    if frame is not None and follows.any():
        follows &= step <= 1.01 * _usual_steps(clip[after], step)
    previous = np.full(len(clip), -1, np.int64)
    previous[after[follows]] = before[follows]
    return previous


def _usual_steps(clip: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return, for each pair of frames, the most common step of its clip, the smallest of several.

    That of the file, where no step of the clip occurs twice: two frames alone do not tell a step from a gap.
    """
    steps, code = np.unique(step, return_inverse=True)
    pairs, count = np.unique(clip[step > 0] * len(steps) + code[step > 0], return_counts=True)
    clips, which = np.divmod(pairs, len(steps))
    order = np.lexsort((-which, count, clips))  # the last of each clip is its most common
    usual = np.full(int(clip.max()) + 1, steps[np.bincount(which, count).argmax()])
    several = order[count[order] > 1]
    usual[clips[several]] = steps[which[several]]
    return usual[clip]


# Masks of the bodies beside their keypoints: crops of the same images, and where keypoints are in them.

_SMALLEST = 8


def masks_of(where: str, arrays: dict[str, np.ndarray], frames: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return a file's `masks` as coverage 0..255 and `mask_box` as float32, NaN for frames without one; both None where absent.

    Raises UserError: one without the other, another type or shape, a box of negative side.
    """
    masks, box = arrays.get("masks"), arrays.get("mask_box")
    if masks is not None and masks.dtype == np.bool_:
        masks = masks.astype(np.uint8) * np.uint8(255)
    if box is not None and box.dtype.kind in "iuf":
        box = box.astype(np.float32)
    _check_masks(where, masks, box, frames)
    if masks is None or box is None:
        return None, None
    if masks.size and masks.max() == 1:  # written as 0 and 1
        masks = masks * np.uint8(255)
    without = ~np.isfinite(box).all(1) | (box[:, 2] == 0)
    if (box[~without, 2] < 0).any():
        raise UserError(f"{where}: 'mask_box' has negative sides, expected x0, y0, side in px of each crop.")
    return masks, np.where(without[:, None], np.float32(np.nan), box)


def _check_masks(where: str, masks: Any, box: Any, frames: int) -> None:
    """Raise UserError for masks and boxes that cannot be those of ``frames`` frames."""
    wrong = ""
    if (masks is None) != (box is None):
        there, gone = ("mask_box", "masks") if masks is None else ("masks", "mask_box")
        wrong = (
            f"'{there}' without '{gone}': a mask needs both, the crops (frames, side, side) and where each is in the "
            "image, x0, y0, side in px (frames, 3)"
        )
    elif masks is None:
        return
    elif masks.ndim != 3 or len(masks) != frames or masks.shape[1] != masks.shape[2] or masks.dtype != np.uint8:
        wrong = (
            f"'masks' is {masks.dtype} of shape {masks.shape}, expected uint8 ({frames}, side, side): square crops, 0 "
            "outside the body and 255 inside; zeros for a frame without a mask"
        )
    elif frames and masks.shape[1] < _SMALLEST:
        wrong = f"'masks' are {masks.shape[1]} px a side, expected {_SMALLEST} at least"
    elif box.shape != (frames, 3) or box.dtype.kind != "f":
        wrong = (
            f"'mask_box' is {box.dtype} of shape {box.shape}, expected numbers ({frames}, 3): x0, y0, side of each "
            "crop, px in the image; NaN for a frame without a mask"
        )
    if wrong:
        raise UserError(f"{where}: {wrong}.")


def mask_maps(
    data: PoseData,
    root: int,
    scale_px: np.ndarray,
    rotation: np.ndarray | None = None,
    intrinsics: Intrinsics | None = None,
) -> Float[np.ndarray, "frames 3 3"]:
    """Return what takes normalised keypoints (x, y, 1) to their crop, (u w, v w, w): u, v from -1 to 1 over it.

    A plain scale and shift, but with a camera that was turned to look at the root (`uplift.geometry.normalise`):
    its picture is turned back. NaN for frames without a mask.
    """
    assert data.masks is not None and data.mask_box is not None
    box = data.mask_box
    masked = np.isfinite(box).all(1) & (box[:, 2] > 0) & (data.masks > 127).any((1, 2))  # there, and not empty
    box = np.where(masked[:, None], box, np.nan).astype(np.float64)
    frames = len(box)
    crop = np.zeros((frames, 3, 3))  # from px of the image
    crop[:, 0, 0] = crop[:, 1, 1] = 2 / box[:, 2]
    crop[:, :2, 2] = -2 * box[:, :2] / box[:, 2:] - 1
    crop[:, 2, 2] = np.where(np.isnan(box[:, 2]), np.nan, 1)
    image = np.zeros((frames, 3, 3))  # from normalised keypoints
    image[:, 2, 2] = 1
    if rotation is None or intrinsics is None:
        image[:, 0, 0] = image[:, 1, 1] = scale_px
        image[:, :2, 2] = data.keypoints[:, root]
    else:
        image[:, 0, 0] = image[:, 1, 1] = scale_px / intrinsics.focal_px
        back = rotation.astype(np.float64).transpose(0, 2, 1)
        x, y = intrinsics.centre_px
        image = np.array([[intrinsics.focal_px, 0, x], [0, intrinsics.focal_px, y], [0, 0, 1]]) @ back @ image
    return (crop @ image).astype(np.float32)
