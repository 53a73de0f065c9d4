"""The keys of a skeleton file as a JSON schema: for editors, and for the loader, which takes names and defaults from it."""

from __future__ import annotations

import copy
from typing import Any

from uplift.config.schema import DRAFT

__all__ = [
    "ANGLE_KEYS", "BODY_KEYS", "DEFAULTS", "DIRECTIONS", "KEYS", "LEVEL", "MAX_JOINTS", "REQUIRED", "SIZE_KEYS",
    "skeleton_schema",
]  # fmt: skip

MAX_JOINTS = 1000
LEVEL = ("up", "down", "image_right", "image_left")
"""Directions of the level frame that an angle may be measured from."""
REQUIRED = ("joints", "root", "bones")
BODY_KEYS = ("proportions", "rest", "limits")

_NAME = {"type": "string", "pattern": r"^\S([\s\S]*\S)?$"}
_PARTS = {"anyOf": [_NAME, {"type": "array", "items": _NAME, "minItems": 1, "uniqueItems": True}]}
_FINITE = {"type": "number", "minimum": -1e9, "maximum": 1e9}
_RANGE = {"type": "array", "items": _FINITE, "minItems": 2, "maxItems": 2}


def _switch(default: bool, about: str) -> dict[str, Any]:
    return {"type": "boolean", "default": default, "description": about}


def _pairs(about: str, **more: Any) -> dict[str, Any]:
    pair = {"type": "array", "items": _NAME, "minItems": 2, "maxItems": 2, "uniqueItems": True}
    return {"type": "array", "items": pair, "description": about, **more}


def _by_joint(value: dict[str, Any], about: str, **more: Any) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": value, "description": about, **more}


def _direction(about: str) -> dict[str, Any]:
    return {"type": "array", "items": _PARTS, "minItems": 2, "maxItems": 2, "description": f"[from, to]: {about}"}


_FACING = {
    "type": "object",
    "default": {},
    "description": "directions of the body, each [from, to], an end a joint or a list of joints (their mean)",
    "properties": {
        "front": _direction("ahead, in nearly every pose"),
        "left": _direction("from a joint of the right side to its partner on the left"),
        "up": _direction("may be left out where gravity is true and the body stays upright"),
    },
    "additionalProperties": False,
    "anyOf": [{"maxProperties": 0}, {"required": ["front", "left"]}],
}
_SIZE = {
    "type": "object",
    "default": {},
    "description": "how large it is",
    "properties": {
        "along": {"type": "array", "items": _NAME, "minItems": 2, "description": "joints from one end to the other"},
        "mm": {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1e9, "description": "length along them"},
        "of_height": {
            "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1e9,
            "description": "length along them as a share of the body's height",
        },
    },
    "additionalProperties": False,
    "anyOf": [{"maxProperties": 0}, {"required": ["along"], "oneOf": [{"required": ["mm"]}, {"required": ["of_height"]}]}],
}  # fmt: skip
_LIMITS = {
    "type": ["object", "array"],
    "properties": {
        "flexion": {**_RANGE, "description": "degrees that the bone beyond the joint swings forward, [from, to]"},
        "abduction": {**_RANGE, "description": "degrees away from the midline, [from, to]"},
        "rotation": {**_RANGE, "description": "degrees about itself, [from, to]"},
        "follows": {**_NAME, "description": "joint that it goes through its range together with"},
        "human": {**_PARTS, "description": "point of the simulator's human body, or points (their mean)"},
    },
}
_WAY = {"anyOf": [{"enum": list(LEVEL)}, {"type": "array", "items": _PARTS, "minItems": 2, "maxItems": 3}]}
_ANGLE = {
    "type": "object",
    "properties": {
        "joints": {
            "type": "array", "items": _PARTS, "minItems": 3, "maxItems": 3,
            "description": "[a, b, c]: how far b bends; short for segment: [b, c], from: [a, b]",
        },
        "segment": {**_WAY, "description": "what is measured: [from, to], an end a joint or a list of joints (their mean)"},
        "from": {**_WAY, "description": "the direction it is measured from, where the angle is 0"},
        "about": {**_WAY, "description": "axis of the turn, right-handed; unset: the angle between the two, 0 to 180"},
        "towards": {**_WAY, "description": "the angle out of the plane across this direction, -90 to 90"},
        "zero": {"type": "number", "minimum": -360, "maximum": 360, "default": 0, "description": "degrees taken off"},
    },
    "additionalProperties": False,
    "anyOf": [{"required": ["joints"]}, {"required": ["segment", "from"]}, {"required": ["segment", "towards"]}],
}  # fmt: skip
_PROPERTIES: dict[str, dict[str, Any]] = {
    "name": {**_NAME, "description": "the file's name if not given"},
    "description": {"type": "string", "default": "", "description": "one line; shown by `uplift skeletons`"},
    "joints": {
        "type": "array", "items": _NAME, "minItems": 3, "maxItems": MAX_JOINTS, "uniqueItems": True,
        "description": "names of the joints, spelt as in your files",
    },
    "root": {**_NAME, "description": "the joint that poses are measured from, near the middle and nearly always seen"},
    "bones": _pairs("pairs [parent, child] that lead from the root to every joint"),
    "loops": _switch(False, "true: bones may close loops, as the seat of a chair does"),
    "mirror": _pairs("pairs [right, left]; joints on the midline are in none", default=[]),
    "facing": _FACING,
    "trunk": _direction("up along the body when it is upright, where that is not facing's up; errors are told apart by its angle"),
    "gravity": _switch(True, "true: it stands on the ground and is turned about the vertical; false: every way"),
    "rigid": _switch(False, "true: one shape that does not bend"),
    "contacts": {
        "type": "array", "items": _NAME, "uniqueItems": True, "default": [],
        "description": "joints that stand on the ground; unset: ends of limbs that are mostly the lowest",
    },
    "angles": {
        "type": "object", "additionalProperties": _ANGLE, "default": {},
        "description": "joint angles by name; one whose name has the word right or left is measured on both sides",
    },
    "midpoints": _by_joint(_PARTS, "joint: the joints that it is the mean of", default={}),
    "from": _by_joint(
        {"type": "object", "additionalProperties": _PARTS, "minProperties": 1, "description": "joint: name in the file, or names (their mean)"},
        "other layouts by a name: which of their joints make each joint of this skeleton", default={},
    ),
    "size": _SIZE,
    "proportions": _by_joint(
        {"type": "number", "exclusiveMinimum": 0, "maximum": 1e9},
        "simulator: length of the bone to the joint, in body heights or any other unit",
    ),
    "rest": _by_joint(
        {"type": "array", "items": _FINITE, "minItems": 3, "maxItems": 3, "not": {"items": {"const": 0}}},
        "simulator: direction [x, y, z] of the bone to the joint; x is its left, y down, z behind it",
    ),
    "limits": _by_joint(_LIMITS, "simulator: how far the joint turns, or the point of the human body that it is"),
}  # fmt: skip
KEYS = tuple(_PROPERTIES)
DEFAULTS = {key: one["default"] for key, one in _PROPERTIES.items() if "default" in one}
DIRECTIONS = tuple(_FACING["properties"])
SIZE_KEYS = tuple(_SIZE["properties"])
ANGLE_KEYS = tuple(_ANGLE["properties"])


def skeleton_schema() -> dict[str, Any]:
    """Return the JSON schema of skeleton files.

    What hangs together is left to the loader: that names are joints, that bones connect them, that both sides match.
    """
    return copy.deepcopy(
        {
            "$schema": DRAFT,
            "title": "uplift skeleton",
            "type": "object",
            "properties": _PROPERTIES,
            "required": list(REQUIRED),
            "additionalProperties": False,
            # Where it may be seen from anywhere, facing needs all three directions.
            "if": {"properties": {"gravity": {"const": False}, "facing": {"minProperties": 1}}, "required": ["gravity", "facing"]},
            "then": {"properties": {"facing": {"required": list(DIRECTIONS)}}},
        }
    )  # fmt: skip
