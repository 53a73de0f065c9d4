"""Every setting with its default, description, range and choices; a task file or ``key=value`` overrides them."""

# ruff: noqa: RUF009 (`_setting` returns a dataclass field)

from __future__ import annotations

import copy
import functools
import math
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, NamedTuple, Optional, TypeVar

from uplift.errors import UserError, nearest

__all__ = [
    "MAX_SIDE",
    "MIN_SIDE",
    "RENAMED",
    "ChoiceSettings",
    "DataSettings",
    "LifterSettings",
    "RefineSettings",
    "Setting",
    "Settings",
    "ShapeSettings",
    "StageSettings",
    "StudentSettings",
    "TeacherSettings",
    "TrainerSettings",
    "ViewSettings",
    "all_settings",
    "check_settings",
    "rename_old",
    "seconds_of",
    "settings_of",
]

MIN_SIDE, MAX_SIDE = 8, 1024
"""Pixels along the crop of a mask."""

# OmegaConf reads these annotations at run time, where "X | None" of a string is not resolved.


def _setting(default: Any, help: str = "", **limits: Any) -> Any:
    """Return a field with its description.

    ``low`` and ``high`` bound a number and each of a list, or one by one where they are tuples; ``choices`` are the
    valid texts. ``only`` is "keypoints" or "masks" where the setting does not go with the other.
    """
    limits["help"] = help
    if isinstance(default, (list, dict)):
        return field(default_factory=default.copy, metadata=limits)
    return field(default=default, metadata=limits)


@dataclass
class ChoiceSettings:
    """Which frames: all that match every key given. Values are compared as text."""

    subjects: list[str] = _setting([], "subjects to take", only="keypoints")
    actions: list[str] = _setting([], "actions to take", only="keypoints")
    sequences: list[str] = _setting([], "sequences to take", only="keypoints")
    cameras: list[str] = _setting([], "cameras to take", only="keypoints")
    categories: list[str] = _setting([], "categories of masks to take", only="masks")
    fraction: Optional[float] = _setting(
        None, "share of those frames, as whole clips in seeded order; of masks by shape"
    )


@dataclass
class _LabelledSettings(ChoiceSettings):
    """Which training frames may be learned from with their true pose; none unless something here is set."""

    file: Optional[str] = _setting(None, "other frames with poses: FILE, or SET:SPLIT of a published set")
    only: bool = _setting(False, "leave all other frames out: supervised training")
    share: Optional[float] = _setting(
        0.9, "most of a batch that is labelled; unset: as many as there are among the frames", low=0.001, high=0.999
    )


@dataclass
class DataSettings:
    """Where the 2D keypoints or masks come from."""

    name: str = _setting("", "name of the data set; its folder is $UPLIFT_DATA/<name>, else data/<name>")
    root: Optional[str] = _setting(None, "folder of the data set's own files, in place of that")
    use: Optional[str] = _setting(
        None, "reader of a published data set: h36m, mpii, ..., or file.py:Class; unset: files", only="keypoints"
    )
    options: dict[str, Any] = _setting({}, "options of that reader", only="keypoints")
    train: Optional[str] = _setting(None, "file or folder to train on, several with commas or *, or the set's split")
    test: Optional[str] = _setting(None, "the same, to evaluate on after the fit")
    format: Optional[str] = _setting(None, "format of the files: deeplabcut, openpose, coco, ...; unset: guessed")
    layout: Optional[str] = _setting(
        None, "skeleton whose joints name the keypoints of files without names", only="keypoints"
    )
    image_size: Optional[str] = _setting(None, "image size of files that do not give it: 1920x1080", only="keypoints")
    fps: Optional[float] = _setting(None, "frames per second of files that do not give it", only="keypoints")
    focal_px: Optional[float] = _setting(None, "focal length of the camera in pixels, where known", only="keypoints")
    min_confidence: float = _setting(0.0, "keypoints of less confidence count as missing", only="keypoints")
    simulate: int = _setting(0, "frames, or masks, to simulate instead of reading a file", low=0, high=10**8)
    family: str = _setting("chairs", "family of synthetic shapes whose masks are simulated", only="masks")
    side: int = _setting(64, "pixels along a mask's crop", low=MIN_SIDE, high=MAX_SIDE, only="masks")
    border: str = _setting("skip", "masks that touch the border of their image", choices=("skip", "keep"), only="masks")
    pieces: str = _setting("skip", "masks of several pieces", choices=("skip", "largest"), only="masks")
    category: Optional[str] = _setting(None, "only masks of this category, several with commas", only="masks")
    most: Optional[int] = _setting(None, "masks at most, spread over the files", low=1, high=10**8, only="masks")
    images: Optional[str] = _setting(None, "folder of the photos that masks belong to", only="masks")
    unit: Optional[str] = _setting(
        None, "unit of poses and roots in the files, whatever they say", choices=("mm", "relative"), only="keypoints"
    )
    get: str = _setting("", "how to get the files, for the message when they are not there")
    select: ChoiceSettings = field(default_factory=ChoiceSettings)  # training frames to use
    hold_out: ChoiceSettings = field(default_factory=ChoiceSettings)  # training frames kept for the test instead
    labelled: _LabelledSettings = field(default_factory=_LabelledSettings)  # training frames whose truth may be used


@dataclass
class RefineSettings:
    """How the lifted poses of a clip are refined together."""

    iterations: int = _setting(50, "steps of gradient descent; 0 leaves the poses as they are", low=0, high=100_000)
    rate: float = _setting(0.03, "first step size, in mean 2D radii of the body", low=0, high=10)
    bones: float = _setting(8.0, "weight of constant bone lengths over a clip", low=0, high=1e6)
    smooth: float = _setting(2.0, "weight of little acceleration", low=0, high=1e6)
    near: float = _setting(0.2, "weight of the lifted depths", low=0, high=1e6)
    seen: float = _setting(100.0, "weight of doubtful keypoints; those of confidence 1 do not move", low=1e-6, high=1e6)


@dataclass
class LifterSettings:
    """The network and the geometry around it."""

    network: str = _setting("residual", "kudo, residual, or file.py:Class")
    options: dict[str, Any] = _setting({}, "options of the network")
    camera: str = _setting("perspective", "camera model", choices=("orthographic", "perspective"))
    intrinsics: str = _setting(
        "auto", "auto: use the file's focal_px and image_size where it has them; off: never", choices=("auto", "off")
    )
    distance: float = _setting(
        10.0, "of the perspective camera without intrinsics, in mean 2D radii of the body", low=2, high=1e4
    )
    tilt: str = _setting(
        "predicted",
        "camera tilt: predicted (per pose), learned (one for all), level",
        choices=("predicted", "learned", "level"),
    )
    radius: str = _setting("without_root", "joints the normalising mean runs over", choices=("all", "without_root"))
    root_free: bool = _setting(False, "leave the root's own depth in")
    confidence_input: bool = _setting(True, "the network sees confidence beside the keypoints")
    fill: bool = _setting(True, "the network predicts where missing joints are")
    spread: bool = _setting(True, "the student predicts how far off each depth, or the place of a hidden joint, may be")
    denoise: Optional[bool] = _setting(
        None, "the student moves seen joints too; unset: where refined clips show that they are noisy"
    )
    both_ways: bool = _setting(True, "predict as the mean over the keypoints and their mirror image")
    refine: RefineSettings = field(default_factory=lambda: RefineSettings(smooth=1.0, near=0.5))  # of predicted clips


@dataclass
class ViewSettings:
    """How lifted poses are turned. Without gravity views are uniform on SO(3)."""

    azimuth_deg: tuple[float, float] = _setting((-180.0, 180.0), "range about gravity", low=-360, high=360)
    elevation: str = _setting(
        "batch",
        "tilt of new views: batch (another pose's), normal (batch mean and sd), same",
        choices=("batch", "normal", "same"),
    )
    renormalise: bool = _setting(True, "bring views to mean radius 1, as real keypoints are")
    count_root: bool = _setting(True, "set from lifter.radius")


@dataclass
class ShapeSettings:
    """What is lifted from masks: `lifts: masks`."""

    resolution: int = _setting(32, "voxels along the grid of a shape", low=8, high=256)
    gravity: bool = _setting(True, "shapes stand upright; false: seen from anywhere, views uniform on SO(3)")
    symmetric: bool = _setting(True, "shapes are their own mirror image, left and right")
    elevation_deg: tuple[float, float] = _setting(
        (15.0, 10.0), "mean and sd of how far down the cameras look", low=(-90, 0), high=(90, 90)
    )
    distance: float = _setting(6.0, "of the camera, in half sides of a shape's box", low=2, high=1e4)
    parts: int = _setting(4, "shapes that the kind of object is a mixture of, at first", low=1, high=64)
    splits: list[int] = _setting([4, 4, 3], "how many each becomes, in each later stage", low=2, high=64)
    detail: int = _setting(32, "voxels along the grids of the mixture; even", low=8, high=128)
    crop: int = _setting(40, "pixels along the crops that masks and silhouettes are compared on", low=12, high=64)
    proportions: float = _setting(
        0.15,
        "how unlike in width over height a mask and its shape may be, sd of the logarithm",
        low=0.01,
        high=100,
    )
    temperature_start: float = _setting(
        0.1, "of the likelihood as the first stage starts: how uncertain views are taken to be", low=1e-4, high=10
    )
    temperature_end: float = _setting(
        0.02, "from four fifths of that stage on; lifting has three quarters of it", low=1e-4, high=10
    )


@dataclass
class StageSettings:
    """One stage of training and its optimiser."""

    share: float = _setting(1.0, "of the budget of the whole fit; 0 leaves the stage out", low=0, high=1e6)
    batch_size: int = _setting(512, "frames a step", low=2, high=1 << 20)
    learning_rate: float = _setting(5e-4, "Adam's", low=1e-12, high=10)
    beta1: float = _setting(0.5, "Adam's", low=0, high=0.99999)
    beta2: float = _setting(0.99, "Adam's", low=0, high=0.9999999)
    weight_decay: float = _setting(0.0, "L2, in Adam's gradient", low=0, high=10)
    decay_from: float = _setting(
        0.6, "share of the stage after which the rate falls to 2 % (half a cosine)", low=0, high=1
    )
    average: Optional[float] = _setting(0.999, "decay of the averaged weights; none if unset", low=0, high=0.999999)
    warm_up: float = _setting(0.0, "share of the stage over which the rate rises from 0", low=0, high=1)
    mirror: bool = _setting(True, "show each frame mirrored half the time")


@dataclass
class TeacherSettings(StageSettings):
    """The first stage: priors judge lifted poses and their turned views."""

    hide: float = _setting(0.0, "share of known joints hidden from the network in each step", low=0, high=0.9)
    prior_learning_rate: Optional[float] = _setting(
        None, "of the priors' own parameters; the same if unset", low=1e-12, high=10
    )
    same_real: bool = _setting(False, "adversarial priors see the batch's own keypoints as real, not another draw")


@dataclass
class StudentSettings(StageSettings):
    """The second stage: learn from the teacher's own poses, turned everywhere."""

    share: float = _setting(0.0, "of the budget of the whole fit; 0 leaves the stage out", low=0, high=1e6)
    learning_rate: float = _setting(1e-3, "Adam's", low=1e-12, high=10)
    beta1: float = _setting(0.9, "Adam's", low=0, high=0.99999)
    warm_up: float = _setting(0.05, "share of the stage over which the rate rises from 0", low=0, high=1)
    decay_from: float = _setting(
        0.0, "share of the stage after which the rate falls to 2 % (half a cosine)", low=0, high=1
    )
    rounds: list[float] = _setting([0.35, 0.65], "share of the stage for each round", low=1e-6, high=1e6)
    network: Optional[str] = _setting(None, "the student's, where it is not lifter.network")
    options: dict[str, Any] = _setting({}, "options of that network, over lifter.options")
    last_options: dict[str, Any] = _setting({}, "options over these, in the last round")
    warm: bool = _setting(False, "a round goes on with the last round's weights where its network is the same")
    occlude: float = _setting(
        0.0, "share of views in which joints are hidden: some of them, or a whole limb", low=0, high=1
    )
    noise: bool = _setting(True, "add to the views what refinement found wrong in the keypoints")
    refine: RefineSettings = field(default_factory=RefineSettings)
    frames: int = _setting(
        60_000, "most that are lifted and refined for a round, whole clips at random", low=1, high=10**12
    )
    turn: bool = _setting(True, "show poses from everywhere; off: each from where it was seen")
    mix: float = _setting(0.7, "share of poses that take limbs of others", low=0, high=1)
    mix_limb: float = _setting(0.4, "chance of each limb of such a pose", low=0, high=1)


@dataclass
class TrainerSettings:
    """How long, on what, and what is kept."""

    max_time: Optional[str] = _setting("00:10:00", "hours:minutes:seconds of training; schedules stretch to it")
    max_steps: Optional[int] = _setting(None, "optimiser steps of the whole fit", low=1, high=10**12)
    max_epochs: Optional[float] = _setting(None, "the same in passes over the training frames", low=1e-9, high=1e9)
    checkpoint_every: float = _setting(60.0, "seconds between checkpoints", low=0, high=1e9)
    checkpoint_steps: Optional[int] = _setting(
        None, "optimiser steps between checkpoints, in place of seconds", low=1, high=10**12
    )
    log_every: int = _setting(50, "steps between rows of metrics.csv", low=1, high=10**9)
    threads: Optional[int] = _setting(
        None, "of the CPU; unset: all, or one where a crowded machine makes that faster", low=1, high=1024
    )
    accelerator: str = _setting("auto", "of Lightning's Trainer")  # as are the next three
    devices: str = _setting("auto", "of Lightning's Trainer")
    precision: str = _setting("32-true", "of Lightning's Trainer")
    logger: Optional[str] = _setting(None, "beside metrics.csv: tensorboard, wandb")


@dataclass
class Settings:
    """All settings of a fit."""

    task: str = _setting("", "name of the task file")
    description: str = _setting("", "one line about the task")
    lifts: str = _setting("keypoints", "what is lifted to 3D", choices=("keypoints", "masks"))
    skeleton: str = _setting("", "a shipped name, or a YAML file", only="keypoints")
    seed: int = _setting(0, "of everything random", low=0, high=2**31 - 1)
    init: Optional[str] = _setting(None, "run whose weights to start from")
    data: DataSettings = field(default_factory=DataSettings)
    lifter: LifterSettings = field(default_factory=LifterSettings)
    shape: ShapeSettings = field(default_factory=ShapeSettings, metadata={"only": "masks"})
    views: ViewSettings = field(default_factory=ViewSettings)
    priors: dict[str, Any] = _setting({}, "name: {use, weight, the prior's own options}")
    teacher: TeacherSettings = field(default_factory=TeacherSettings)
    student: StudentSettings = field(default_factory=StudentSettings)
    trainer: TrainerSettings = field(default_factory=TrainerSettings)


# The settings as a list: what checks, command-line completion and help read.


class Setting(NamedTuple):
    """One setting as its field declares it."""

    name: str
    """In full, such as ``trainer.max_time``."""
    type: Any
    default: Any
    help: str
    low: Any
    high: Any
    choices: tuple[str, ...]
    only: str | None
    """What a fit must lift for the setting to count, "keypoints" or "masks"; None: either."""


@functools.cache
def all_settings() -> dict[str, Setting]:
    """Return every setting by its full name, in the order of the fields."""
    return {one.name: one for one in _walk(Settings(), "", None)}


def _walk(group: Any, above: str, only: str | None) -> Iterator[Setting]:
    hints = typing.get_type_hints(type(group))
    for one in fields(group):
        name, value, known = above + one.name, getattr(group, one.name), one.metadata
        whose = known.get("only", only)
        if is_dataclass(value):
            yield from _walk(value, f"{name}.", whose)
        else:
            low, high, choices = known.get("low"), known.get("high"), known.get("choices", ())
            yield Setting(name, hints[one.name], value, known.get("help", ""), low, high, choices, whose)


# What settings may be, beyond their types: choices, ranges, what goes with what is lifted, contradictions.

_MOST_BYTES = 4_000_000_000
_MOST_SHAPES = 4096


def check_settings(settings: Settings) -> None:
    """Refuse what types cannot: unknown choices, numbers out of range, contradictions. Raises UserError."""
    for one in all_settings().values():
        value = functools.reduce(getattr, one.name.split("."), settings)
        if one.only not in (None, settings.lifts):
            _check_default(one, value, settings.lifts)
        elif value is not None:
            _check_value(one, value)
    settings.views.count_root = settings.lifter.radius == "all"
    _check_stages(settings)
    _check_trainer(settings.trainer)
    if settings.lifts == "masks":
        _check_masks(settings)


def _check_default(one: Setting, value: Any, lifts: str) -> None:
    """Refuse a value of a setting that does not go with what the fit lifts."""
    if value == one.default or (isinstance(value, list) and tuple(value) == one.default):
        return
    hint = " Start from task=masks for those." if one.only == "masks" else ""
    choice = {key.name: key.metadata.get("only", lifts) for key in fields(ChoiceSettings)}
    if one.name.split(".")[-1] in choice:
        hint = f" Choose by {', '.join(key for key, only in choice.items() if only == lifts)}."
    raise UserError(f"{one.name} is set, but this fit lifts {lifts}: it goes with {one.only}.{hint}")


def _check_value(one: Setting, value: Any) -> None:
    """Refuse an unknown choice, or a number out of range, alone or in a list."""
    if one.choices and value not in one.choices:
        expected = f"expected one of {', '.join(one.choices)}.{nearest(value, one.choices)}"
        raise UserError(f"{one.name}={value!r}: {expected}")
    if one.low is None:
        return
    several = isinstance(value, (list, tuple))
    for place, number in enumerate(value if several else [value]):
        low, high = (end[place] if isinstance(end, tuple) else end for end in (one.low, one.high))
        if not low <= number <= high:
            name = f"{one.name}[{place}]" if several else one.name
            raise UserError(f"{name}={number}: expected a number from {_plain(low)} to {_plain(high)}.")


def _plain(number: int | float) -> str:
    return f"{number:,}" if isinstance(number, int) else f"{number:g}"


def _check_stages(settings: Settings) -> None:
    if settings.student.share > 0 and not settings.student.rounds:
        raise UserError("student.rounds is empty: give a share for each round, or student.share=0 for no student.")
    if settings.teacher.share <= 0:
        raise UserError("teacher.share is 0: the first stage cannot be left out.")


def _check_masks(settings: Settings) -> None:
    data, shape = settings.data, settings.shape
    if shape.detail % 2:
        raise UserError(
            f"shape.detail={shape.detail}: expected an even number, as the halves of a shape are grids too."
        )
    shapes = shape.parts * math.prod(shape.splits)
    if shapes > _MOST_SHAPES:
        raise UserError(f"shape.parts and shape.splits ask for {shapes:,} shapes, expected at most {_MOST_SHAPES:,}.")
    size = data.simulate * data.side**2
    if size > _MOST_BYTES:
        raise UserError(
            f"data.simulate={data.simulate} masks of data.side={data.side} take {size / 1e9:,.0f} GB: ask for fewer."
        )
    for key in ("category", "most", "images", "format"):
        if data.simulate and getattr(data, key) is not None:
            raise UserError(f"data.{key} goes with files of masks, but data.simulate={data.simulate} simulates masks.")


def _check_trainer(trainer: TrainerSettings) -> None:
    if trainer.max_time is None and trainer.max_steps is None and trainer.max_epochs is None:
        raise UserError("Set one of trainer.max_time, trainer.max_steps, trainer.max_epochs: the fit would never end.")
    if trainer.max_time is not None:
        seconds_of(trainer.max_time)


def seconds_of(text: str) -> float:
    """Return the seconds of ``hours:minutes:seconds`` (or ``days:hours:minutes:seconds``)."""
    if not re.fullmatch(r"(\d+:){2,3}\d+(\.\d+)?", text):
        raise UserError(f"trainer.max_time={text!r}: expected hours:minutes:seconds, such as 00:10:00.")
    parts = [float(part) for part in text.split(":")]
    seconds = sum(part * unit for part, unit in zip(reversed(parts), (1, 60, 3600, 86400), strict=False))
    if seconds <= 0:
        raise UserError(f"trainer.max_time={text!r}: no time to train in.")
    return seconds


# Settings under former names: an error where a user gives them, translated where an earlier fit wrote them.

RENAMED = {
    "shape.hot": "shape.temperature_start",
    "shape.cold": "shape.temperature_end",
    **{
        f"data.{group}.{key}": f"data.{group}.{key}s"
        for group in ("select", "hold_out")
        for key in ("subject", "action", "sequence", "camera")
    },
}
"""The new full name of every setting that had another."""


def rename_old(plain: dict[str, Any]) -> None:
    """Give plain nested settings that an earlier version wrote their present names, in place."""
    for old, new in RENAMED.items():
        found, parts = plain, old.split(".")
        for part in parts[:-1]:
            found = found.get(part, {}) if isinstance(found, dict) else {}
        if isinstance(found, dict) and parts[-1] in found:
            value, place = found.pop(parts[-1]), plain
            for part in new.split(".")[:-1]:
                place = place.setdefault(part, {})
            place.setdefault(new.split(".")[-1], value)


Group = TypeVar("Group")


def settings_of(kind: type[Group], name: str, plain: dict[str, Any]) -> Group:
    """Return the settings called ``name``, such as "lifter", that a fit of this or an earlier version saved.

    Raises TypeError, ValueError or AttributeError for anything else.
    """
    whole = {name: copy.deepcopy(plain)}
    rename_old(whole)
    return _built(kind, whole[name])


def _built(kind: Any, plain: dict[str, Any]) -> Any:
    hints = typing.get_type_hints(kind)
    given = dict(plain)
    for key in given.keys() & hints.keys():
        if is_dataclass(hints[key]):
            given[key] = _built(hints[key], given[key])
        elif typing.get_origin(hints[key]) is tuple:
            given[key] = tuple(given[key])
    return kind(**given)
