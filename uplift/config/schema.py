"""The JSON schema of task files, for editors, from the settings and what they accept."""

from __future__ import annotations

import typing
from collections.abc import Iterable, Mapping
from typing import Any

from uplift.config.settings import PRIOR_SETTINGS, TRAINER_FLAGS, Setting, all_groups, all_settings

__all__ = ["DRAFT", "setting_schema", "task_schema"]

DRAFT = "http://json-schema.org/draft-07/schema#"
"""The version that editors know."""

_KINDS = {bool: "boolean", int: "integer", float: "number"}
_TEXT = {"type": ["string", "number", "boolean"]}
"""A name that looks like a number is a name to the loader."""


def task_schema(
    priors: Mapping[str, Iterable[Setting] | None] | None = None,
    networks: Mapping[str, Iterable[Setting]] | None = None,
) -> dict[str, Any]:
    """Return the JSON schema of task files.

    Args:
        priors: the options of each built-in prior; None for one that takes any.
        networks: the options of each built-in network.
    """
    schema: dict[str, Any] = {"$schema": DRAFT, "title": "uplift task", **_group("")}
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "a shipped task, or a file beside this one, whose settings are underneath these",
    }
    for name in (name for name in all_groups() if name):
        *above, last = name.split(".")
        _below(schema, above)["properties"][last] = _group(name)
    for one in all_settings().values():
        *above, last = one.name.split(".")
        _below(schema, above)["properties"][last] = setting_schema(one)
    schema["properties"]["priors"] = _priors(priors or {})
    trainer = schema["properties"]["trainer"]["properties"]
    trainer["max_time"]["type"].append("object")  # times by units, lengths by camera
    schema["properties"]["data"]["properties"]["focal_px"]["type"].append("object")
    trainer |= {name: {"description": f"the flag {name} of Lightning's Trainer"} for name in TRAINER_FLAGS}
    for group in ("callbacks", "loggers"):
        use = {"type": "string", "description": "Lightning's class by name, or file.py:Class; unset: that of this name"}
        schema["properties"][group]["additionalProperties"] = {"type": "object", "properties": {"use": use}}
    options = _options_of_networks(networks or {})
    for holder in ("lifter.options", "student.options", "student.last_options"):
        *above, last = holder.split(".")
        _below(schema, above)["properties"][last]["properties"] = options
    return schema


def _options_of_networks(networks: Mapping[str, Iterable[Setting]]) -> dict[str, Any]:
    """Return what each option is to which network; a file may name a network of the user's."""
    about: dict[str, list[str]] = {}
    for name, options in networks.items():
        for one in options:
            about.setdefault(one.name, []).append(f"{name}: {one.help} (default {one.default})")
    return {option: {"description": "; ".join(texts)} for option, texts in about.items()}


def _below(schema: dict[str, Any], groups: Iterable[str]) -> dict[str, Any]:
    for group in groups:
        schema = schema["properties"][group]
    return schema


def _group(name: str) -> dict[str, Any]:
    """Return the schema of a group without its settings: unknown keys are refused, as the loader does."""
    return {"type": "object", "description": all_groups()[name], "properties": {}, "additionalProperties": False}


def setting_schema(one: Setting) -> dict[str, Any]:
    """Return the schema of a setting's value: type, choices, range, default and description."""
    schema = _value(one)
    if one.kind is not one.type:  # it may be unset
        schema = _or_null(schema)
    only = f" ({one.only} only)" if one.only else ""
    default = list(one.default) if isinstance(one.default, tuple) else one.default
    return schema | {"description": f"{one.help}{only}"} | ({"default": default} if _is_plain(default) else {})


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, (str, bool, int, float, list, dict))


def _or_null(schema: dict[str, Any]) -> dict[str, Any]:
    if "enum" in schema:
        return {"enum": [*schema["enum"], None]}
    kinds = schema.get("type", [])
    return schema | {"type": [*([kinds] if isinstance(kinds, str) else kinds), "null"]}


def _value(one: Setting) -> dict[str, Any]:
    form, parts = typing.get_origin(one.kind), typing.get_args(one.kind)
    if one.choices:
        return {"enum": list(one.choices)}
    if form is tuple:
        lows, highs = (end if isinstance(end, tuple) else (end,) * len(parts) for end in (one.low, one.high))
        items = [_single(kind, low, high) for kind, low, high in zip(parts, lows, highs, strict=True)]
        return {"type": "array", "items": items, "minItems": len(parts), "maxItems": len(parts)}
    if form is list:
        return {"type": "array", "items": _single(parts[0], one.low, one.high)}
    if form is dict:
        return {"type": "object"}
    return _single(one.kind, one.low, one.high)


def _single(kind: Any, low: Any, high: Any) -> dict[str, Any]:
    if kind is str:
        return dict(_TEXT)
    if kind not in _KINDS:
        return {}
    limits = {"minimum": low, "maximum": high}
    return {"type": _KINDS[kind], **{key: value for key, value in limits.items() if value is not None}}


# Priors: any name; under a built-in's own name, and without another class, its options and no others.


def _priors(priors: Mapping[str, Iterable[Setting] | None]) -> dict[str, Any]:
    every = {one.name: setting_schema(one) for one in PRIOR_SETTINGS.values()}
    return {
        "type": "object",
        "description": all_settings()["priors"].help,
        "default": {},
        "propertyNames": {"pattern": r"^[^\W\d]\w*$"},
        "properties": {name: _prior(name, options, every) for name, options in priors.items()},
        "additionalProperties": {"type": "object", "properties": every},
    }


def _prior(name: str, options: Iterable[Setting] | None, every: Mapping[str, Any]) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "object", "properties": dict(every), "description": f"the prior {name}"}
    if options is None:
        return schema
    own = {one.name: _option(one) for one in options}
    return schema | {
        "if": {"not": {"required": ["use"]}},
        "then": {"properties": {**every, **own}, "additionalProperties": False},
    }


def _option(one: Setting) -> dict[str, Any]:
    """Return the schema of an option: any number where the default is one, as a class does not say more."""
    loose = one._replace(type=float) if one.kind is int else one
    return (
        setting_schema(loose)
        if one.kind in _KINDS
        else {key: value for key, value in setting_schema(one).items() if key in ("description", "default")}
    )
