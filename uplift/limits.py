"""What settings may be, beyond their types: choices, ranges, contradictions."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from typing import Any

from uplift.config import MAX_SIDE, MIN_SIDE, Settings, ShapeSettings, TrainerSettings
from uplift.errors import UserError, did_you_mean

__all__ = ["check_settings", "seconds_of"]

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
