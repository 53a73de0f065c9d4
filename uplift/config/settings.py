"""Every setting with its default, unit and range; a task file or ``key=value`` overrides them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields
from typing import Any, Optional

from uplift.errors import UserError, did_you_mean

__all__ = [
    "MAX_SIDE",
    "MIN_SIDE",
    "ChoiceSettings",
    "DataSettings",
    "LifterSettings",
    "Settings",
    "ShapeSettings",
    "StageSettings",
    "StudentSettings",
    "TeacherSettings",
    "TrainerSettings",
    "ViewSettings",
    "check_settings",
    "seconds_of",
]

# Every setting with its default and unit; a task file or ``key=value`` overrides them.

MIN_SIDE, MAX_SIDE = 8, 1024
"""Pixels along the crop of a mask."""

# OmegaConf reads these annotations at run time, where "X | None" of a string is not resolved.


@dataclass
class ChoiceSettings:
    """Which frames: all that match every key given. Values are compared as text."""

    subjects: list[str] = field(default_factory=list)
    actions: list[str] = field(default_factory=list)
    sequences: list[str] = field(default_factory=list)
    cameras: list[str] = field(default_factory=list)
    categories: list[str] = field(default_factory=list)  # of masks, which have none of the others
    fraction: Optional[float] = None  # share of the frames left, as whole clips in seeded order; of masks: by shape


@dataclass
class _LabelledSettings(ChoiceSettings):
    """Which training frames may be learned from with their true pose; none unless something here is set."""

    file: Optional[str] = None  # of other frames with poses: FILE, or SET:SPLIT of a published set
    only: bool = False  # leave all other frames out: supervised training
    share: Optional[float] = 0.9  # most of a batch that is labelled; unset: as many as there are among the frames


@dataclass
class DataSettings:
    """Where the 2D keypoints or masks come from."""

    name: str = ""  # of the data set; its folder is $UPLIFT_DATA/<name>, else data/<name>
    root: Optional[str] = None  # the folder of the set's own files, in place of the above
    use: Optional[str] = None  # reader of a published data set: h36m, mpii, ..., or file.py:Class; unset: files
    options: dict[str, Any] = field(default_factory=dict)  # of that reader
    train: Optional[str] = None  # file or folder to train on, several with commas or *, or the set's split
    test: Optional[str] = None  # the same, to evaluate on after the fit
    format: Optional[str] = None  # of the files: deeplabcut, openpose, coco, ...; unset: guessed
    layout: Optional[str] = None  # skeleton whose joints name the keypoints of files without names
    image_size: Optional[str] = None  # of files that do not say it: 1920x1080
    fps: Optional[float] = None  # frames a second, of files that do not say it
    focal_px: Optional[float] = None  # focal length of the camera in pixels, where it is known
    min_confidence: float = 0.0  # keypoints of less confidence count as missing
    simulate: int = 0  # frames, or masks, to simulate instead of reading a file
    family: str = "chairs"  # of made-up shapes whose masks are simulated
    side: int = 64  # pixels along a mask's crop
    border: str = "skip"  # masks that touch the border of their image: skip, keep
    pieces: str = "skip"  # masks of several pieces: skip, largest
    category: Optional[str] = None  # only masks of this category, several with commas
    most: Optional[int] = None  # masks at most, spread over the files
    images: Optional[str] = None  # folder of the photos that masks belong to
    unit: Optional[str] = None  # of poses and roots in the files, whatever they say: mm, relative
    get: str = ""  # how to get the files, for the message when they are not there
    select: ChoiceSettings = field(default_factory=ChoiceSettings)  # training frames to use
    hold_out: ChoiceSettings = field(default_factory=ChoiceSettings)  # training frames kept for the test instead
    labelled: _LabelledSettings = field(default_factory=_LabelledSettings)  # training frames whose truth may be used


@dataclass
class RefineSettings:
    """How the lifted poses of a clip are mended together."""

    iterations: int = 50  # of gradient descent; 0 leaves the poses as they were lifted
    rate: float = 0.03  # first step size, in mean 2D radii of the body
    bones: float = 8.0  # weight of constant bone lengths over a clip
    smooth: float = 2.0  # weight of little acceleration
    near: float = 0.2  # weight of the lifted depths
    seen: float = 100.0  # weight of doubtful keypoints; those of confidence 1 do not move


@dataclass
class LifterSettings:
    """The network and the geometry around it."""

    network: str = "residual"  # kudo, residual, or file.py:Class
    options: dict[str, Any] = field(default_factory=dict)  # of the network
    camera: str = "perspective"  # or orthographic
    intrinsics: str = "auto"  # auto: use the file's focal_px and image_size where it has them; off: never
    distance: float = 10.0  # of the perspective camera without intrinsics, in mean 2D radii of the body
    tilt: str = "predicted"  # camera tilt: predicted (per pose), learned (one for all), level
    radius: str = "without_root"  # joints the normalising mean runs over: all, or without_root
    root_free: bool = False  # leave the root's own depth in
    confidence_input: bool = True  # the network sees confidence beside the keypoints
    fill: bool = True  # the network says where missing joints are
    spread: bool = True  # and how far off each depth may be, or the place of a hidden joint: learned by the student
    denoise: Optional[bool] = None  # it moves seen joints too; unset: where refined clips show that they are noisy
    both_ways: bool = True  # predict as the mean over the keypoints and their mirror image
    refine: RefineSettings = field(default_factory=lambda: RefineSettings(smooth=1.0, near=0.5))  # of predicted clips


@dataclass
class ViewSettings:
    """How lifted poses are turned. Without gravity views are uniform on SO(3)."""

    azimuth_deg: tuple[float, float] = (-180.0, 180.0)  # range about gravity
    elevation: str = "batch"  # tilt of new views: batch (another pose's), normal (batch mean and sd), same
    renormalise: bool = True  # bring views to mean radius 1, as real keypoints are
    count_root: bool = True  # set from lifter.radius


@dataclass
class ShapeSettings:
    """What is lifted from masks: `lifts: masks`."""

    resolution: int = 32  # voxels along the grid of a shape
    gravity: bool = True  # shapes stand upright; false: seen from anywhere, views uniform on SO(3)
    symmetric: bool = True  # shapes are their own mirror image, left and right
    elevation_deg: tuple[float, float] = (15.0, 10.0)  # mean and sd of how far down the cameras look
    distance: float = 6.0  # of the camera, in half sides of a shape's box
    parts: int = 4  # shapes that the kind of object is a mixture of, at first
    splits: list[int] = field(default_factory=lambda: [4, 4, 3])  # how many each becomes, in each later stage
    detail: int = 32  # voxels along the grids of the mixture
    crop: int = 40  # pixels along the crops that masks and silhouettes are compared on
    proportions: float = 0.15  # how unlike in width over height a mask and its shape may be, sd of the logarithm
    hot: float = 0.1  # temperature of the likelihood at the start of the first stage: how unsure views are held to be
    cold: float = 0.02  # temperature from four fifths of that stage on; lifting has 3/4 of it


@dataclass
class StageSettings:
    """One stage of training and its optimiser."""

    share: float = 1.0  # of the budget of the whole fit; 0 leaves the stage out
    batch_size: int = 512
    learning_rate: float = 5e-4
    beta1: float = 0.5
    beta2: float = 0.99
    weight_decay: float = 0.0  # L2, in Adam's gradient
    decay_from: float = 0.6  # share of the stage after which the rate falls to 2 % (half a cosine)
    average: Optional[float] = 0.999  # decay of the averaged weights; none if unset
    warm_up: float = 0.0  # share of the stage over which the rate rises from 0
    mirror: bool = True  # show each frame mirrored half the time


@dataclass
class TeacherSettings(StageSettings):
    """The first stage: priors judge lifted poses and their turned views."""

    hide: float = 0.0  # share of known joints hidden from the network in each step
    prior_learning_rate: Optional[float] = None  # of the priors' own parameters; the same if unset
    same_real: bool = False  # adversarial priors see the batch's own keypoints as real, not another draw


@dataclass
class StudentSettings(StageSettings):
    """The second stage: learn from the teacher's own poses, turned everywhere."""

    share: float = 0.0
    learning_rate: float = 1e-3
    beta1: float = 0.9
    beta2: float = 0.99
    warm_up: float = 0.05
    decay_from: float = 0.0
    rounds: list[float] = field(default_factory=lambda: [0.35, 0.65])  # share of the stage for each round
    network: Optional[str] = None  # the student's, where it is not lifter.network
    options: dict[str, Any] = field(default_factory=dict)  # of that network, over lifter.options
    last_options: dict[str, Any] = field(default_factory=dict)  # over these, in the last round
    warm: bool = False  # a round goes on with the last round's weights where its network is the same
    occlude: float = 0.0  # share of views in which joints are hidden: some of them, or a whole limb
    noise: bool = True  # add to the views what refinement found wrong in the keypoints
    refine: RefineSettings = field(default_factory=RefineSettings)
    frames: int = 60_000  # most that are lifted and refined for a round, whole clips at random
    turn: bool = True  # show poses from everywhere; off: each from where it was seen
    mix: float = 0.7  # share of poses that take limbs of others
    mix_limb: float = 0.4  # chance of each limb of such a pose


@dataclass
class TrainerSettings:
    """How long, on what, and what is kept."""

    max_time: Optional[str] = "00:10:00"  # hours:minutes:seconds of training; schedules stretch to it
    max_steps: Optional[int] = None  # optimiser steps of the whole fit
    max_epochs: Optional[float] = None  # the same in passes over the training frames
    checkpoint_every: float = 60.0  # seconds between checkpoints
    checkpoint_steps: Optional[int] = None  # optimiser steps between checkpoints, in place of seconds
    log_every: int = 50  # steps between rows of metrics.csv
    threads: Optional[int] = None  # of the CPU; unset: all, or one where a crowded machine makes that faster
    accelerator: str = "auto"  # the rest goes to Lightning's Trainer as it is
    devices: str = "auto"
    precision: str = "32-true"
    logger: Optional[str] = None  # beside metrics.csv: tensorboard, wandb


@dataclass
class Settings:
    """All settings of a fit."""

    task: str = ""  # name of the task file
    description: str = ""
    lifts: str = "keypoints"  # what: keypoints, or masks
    skeleton: str = ""  # of keypoints: a shipped name, or a YAML file
    seed: int = 0
    init: Optional[str] = None  # run whose weights to start from
    data: DataSettings = field(default_factory=DataSettings)
    lifter: LifterSettings = field(default_factory=LifterSettings)
    shape: ShapeSettings = field(default_factory=ShapeSettings)
    views: ViewSettings = field(default_factory=ViewSettings)
    priors: dict[str, Any] = field(default_factory=dict)  # name: {use, weight, the prior's own options}
    teacher: TeacherSettings = field(default_factory=TeacherSettings)
    student: StudentSettings = field(default_factory=StudentSettings)
    trainer: TrainerSettings = field(default_factory=TrainerSettings)


# What settings may be, beyond their types: choices, ranges, contradictions.

_STAGE_RANGES = {
    "share": (0, 1e6),
    "batch_size": (2, 1 << 20),
    "learning_rate": (1e-12, 10),
    "prior_learning_rate": (1e-12, 10),
    "weight_decay": (0, 10),
    "beta1": (0, 0.99999),
    "beta2": (0, 0.9999999),
    "average": (0, 0.999999),
    "decay_from": (0, 1),
    "warm_up": (0, 1),
    "hide": (0, 0.9),
    "occlude": (0, 1),
    "frames": (1, 10**12),
    "mix": (0, 1),
    "mix_limb": (0, 1),
}
_REFINE_RANGES = {
    "iterations": (0, 1e5),
    "rate": (0, 10),
    "bones": (0, 1e6),
    "smooth": (0, 1e6),
    "near": (0, 1e6),
    "seen": (1e-6, 1e6),
}
_SHAPE_RANGES = {
    "resolution": (8, 256),
    "distance": (2, 1e4),
    "parts": (1, 64),
    "detail": (8, 128),
    "crop": (12, 64),
    "proportions": (0.01, 100),
    "hot": (1e-4, 10),
    "cold": (1e-4, 10),
}
_TRAINER_RANGES = {
    "max_steps": (1, 10**12),
    "max_epochs": (1e-9, 1e9),
    "threads": (1, 1024),
    "checkpoint_steps": (1, 10**12),
    "checkpoint_every": (0, 1e9),
    "log_every": (1, 10**9),
}

_OF_KEYPOINTS = (
    "skeleton", *(f"data.{key}" for key in ("use", "options", "layout", "image_size", "fps", "focal_px", "min_confidence", "unit")),
)  # fmt: skip
_OF_MASKS = (
    *(f"data.{key}" for key in ("family", "side", "border", "pieces", "category", "most", "images")),
    *(f"shape.{field.name}" for field in fields(ShapeSettings)),
)
_CHOOSE_BY = ("subjects", "actions", "sequences", "cameras")
_CHOICES = ("select", "hold_out", "labelled")
_MOST_BYTES = 4_000_000_000
_MOST_SHAPES = 4096


def check_settings(settings: Settings) -> None:
    """Refuse what types cannot: unknown choices, numbers out of range, contradictions. Raises UserError."""
    _one_of("lifts", settings.lifts, ("keypoints", "masks"))
    _check_kind(settings)
    _one_of("lifter.tilt", settings.lifter.tilt, ("predicted", "learned", "level"))
    _one_of("lifter.radius", settings.lifter.radius, ("all", "without_root"))
    _one_of("lifter.camera", settings.lifter.camera, ("orthographic", "perspective"))
    if settings.data.unit is not None:
        _one_of("data.unit", settings.data.unit, ("mm", "relative"))
    _one_of("lifter.intrinsics", settings.lifter.intrinsics, ("auto", "off"))
    _in_range("lifter.distance", settings.lifter.distance, 2, 1e4)
    _one_of("views.elevation", settings.views.elevation, ("batch", "normal", "same"))
    for end in settings.views.azimuth_deg:
        _in_range("views.azimuth_deg", end, -360, 360)
    settings.views.count_root = settings.lifter.radius == "all"
    for name, stage in (("teacher", settings.teacher), ("student", settings.student)):
        for key, (low, high) in _STAGE_RANGES.items():
            value = getattr(stage, key, None)
            if value is not None:
                _in_range(f"{name}.{key}", value, low, high)
    student = settings.student
    for name, refine in (("lifter", settings.lifter.refine), ("student", student.refine)):
        for key, (low, high) in _REFINE_RANGES.items():
            _in_range(f"{name}.refine.{key}", getattr(refine, key), low, high)
    if settings.data.labelled.share is not None:
        _in_range("data.labelled.share", settings.data.labelled.share, 0.001, 0.999)
    for share in student.rounds:
        _in_range("student.rounds", share, 1e-6, 1e6)
    if student.share > 0 and not student.rounds:
        raise UserError("student.rounds is empty: give a share for each round, or student.share=0 for no student.")
    if settings.teacher.share <= 0:
        raise UserError("teacher.share is 0: the first stage cannot be left out.")
    _check_trainer(settings.trainer)
    _in_range("data.simulate", settings.data.simulate, 0, 10**8)
    if not 0 <= settings.seed < 2**31:
        raise UserError(f"seed={settings.seed}: expected a whole number from 0 to {2**31 - 1}.")


def _check_kind(settings: Settings) -> None:
    """Refuse settings that go with the other kind of lifter, and shapes and crops that cannot be."""
    masks = settings.lifts == "masks"
    own, other = ("masks", "keypoints") if masks else ("keypoints", "masks")
    for name in _OF_KEYPOINTS if masks else _OF_MASKS:
        if _value_of(settings, name) != _value_of(Settings(), name):
            what = f"it is about {other}" if masks else "it is about masks: start from task=masks"
            raise UserError(f"{name} is set, but this fit lifts {own}, and {what}.")
    for group in _CHOICES:
        choice = getattr(settings.data, group)
        for key in _CHOOSE_BY if masks else ("categories",):
            if getattr(choice, key):
                valid = "categories and fraction" if masks else ", ".join([*_CHOOSE_BY, "fraction"])
                raise UserError(f"data.{group}.{key}: {own} have no {key}. Choose by {valid}.")
    if masks:
        _check_masks(settings)


def _value_of(settings: Settings, name: str) -> Any:
    value: Any = settings
    for key in name.split("."):
        value = getattr(value, key)
    return tuple(value) if isinstance(value, list) else value


def _check_masks(settings: Settings) -> None:
    data, shape = settings.data, settings.shape
    for key, (low, high) in _SHAPE_RANGES.items():
        _in_range(f"shape.{key}", getattr(shape, key), low, high)
    if shape.detail % 2:
        raise UserError(
            f"shape.detail={shape.detail}: expected an even number, as the halves of a shape are grids too."
        )
    for times in shape.splits:
        _in_range("shape.splits", times, 2, 64)
    if shape.parts * math.prod(shape.splits) > _MOST_SHAPES:
        asked = shape.parts * math.prod(shape.splits)
        raise UserError(f"shape.parts and shape.splits ask for {asked:,} shapes, expected at most {_MOST_SHAPES:,}.")
    mean, sd = shape.elevation_deg
    _in_range("shape.elevation_deg (mean)", mean, -90, 90)
    _in_range("shape.elevation_deg (sd)", sd, 0, 90)
    _in_range("data.side", data.side, MIN_SIDE, MAX_SIDE)
    _one_of("data.border", data.border, ("skip", "keep"))
    _one_of("data.pieces", data.pieces, ("skip", "largest"))
    if data.most is not None:
        _in_range("data.most", data.most, 1, 10**8)
    if data.simulate * data.side**2 > _MOST_BYTES:
        size = data.simulate * data.side**2 / 1e9
        raise UserError(
            f"data.simulate={data.simulate} masks of data.side={data.side} take {size:,.0f} GB: ask for fewer."
        )
    for key in ("category", "most", "images", "format"):
        if data.simulate and getattr(data, key) is not None:
            raise UserError(f"data.{key} goes with files of masks, and data.simulate={data.simulate} makes masks up.")


def _check_trainer(trainer: TrainerSettings) -> None:
    if trainer.max_time is None and trainer.max_steps is None and trainer.max_epochs is None:
        raise UserError("Set one of trainer.max_time, trainer.max_steps, trainer.max_epochs: the fit would never end.")
    if trainer.max_time is not None:
        seconds_of(trainer.max_time)
    for key, (low, high) in _TRAINER_RANGES.items():
        value = getattr(trainer, key)
        if value is not None:
            _in_range(f"trainer.{key}", value, low, high)


def _one_of(name: str, value: str, valid: tuple[str, ...]) -> None:
    if value not in valid:
        raise UserError(f"{name}={value!r}: expected one of {', '.join(valid)}.{did_you_mean(value, valid)}")


def _in_range(name: str, value: float | int, low: float | int, high: float | int) -> None:
    if not low <= value <= high:
        raise UserError(f"{name}={value}: expected a number from {low:g} to {high:g}.")


def seconds_of(text: str) -> float:
    """Return the seconds of ``hours:minutes:seconds`` (or ``days:hours:minutes:seconds``)."""
    if not re.fullmatch(r"(\d+:){2,3}\d+(\.\d+)?", text):
        raise UserError(f"trainer.max_time={text!r}: expected hours:minutes:seconds, such as 00:10:00.")
    parts = [float(part) for part in text.split(":")]
    seconds = sum(part * unit for part, unit in zip(reversed(parts), (1, 60, 3600, 86400), strict=False))
    if seconds <= 0:
        raise UserError(f"trainer.max_time={text!r}: no time to train in.")
    return seconds
