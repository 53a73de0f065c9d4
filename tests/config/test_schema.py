"""The JSON schemas of task and skeleton files: all that is shipped is valid, and they agree with the loaders."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from bodies import refusal
from jsonschema import Draft7Validator

from uplift.cli.main import main
from uplift.cli.schema import full_task_schema
from uplift.config.files import shipped, shipped_names
from uplift.config.loading import load_settings
from uplift.config.settings import all_groups, all_settings
from uplift.config.yaml_file import read_yaml
from uplift.errors import UserError
from uplift.priors import PRIORS, build_priors
from uplift.skeleton import load_skeleton
from uplift.skeleton.schema import skeleton_schema

TASK = full_task_schema()
SKELETON = skeleton_schema()
SCHEMAS = {"tasks": TASK, "skeletons": SKELETON}


def faults(schema: dict[str, Any], data: object) -> list[str]:
    return [f"{list(error.path)}: {error.message}" for error in Draft7Validator(schema).iter_errors(data)]


@pytest.mark.parametrize("schema", SCHEMAS.values(), ids=SCHEMAS)
def test_they_are_schemas(schema: dict[str, Any]) -> None:
    Draft7Validator.check_schema(schema)


@pytest.mark.parametrize(("folder", "name"), [(folder, name) for folder in SCHEMAS for name in shipped_names(folder)])
def test_all_that_is_shipped_is_valid(folder: str, name: str) -> None:
    data, _ = read_yaml(shipped(folder) / f"{name}.yaml", folder)
    assert faults(SCHEMAS[folder], data) == []


def test_what_a_fit_writes_is_valid(tmp_path: Path) -> None:
    from uplift.config.loading import save_settings

    for name in shipped_names("tasks"):
        save_settings(load_settings(name), tmp_path / "config.yaml")
        data, _ = read_yaml(tmp_path / "config.yaml", "task")
        assert faults(TASK, data) == []
    for name in ("h36m17", "chair10", "hand21"):
        plain = yaml.safe_load(yaml.safe_dump(load_skeleton(name).to_dict()))
        assert faults(SKELETON, plain) == []


def part(schema: dict[str, Any], name: str) -> dict[str, Any]:
    for key in name.split("."):
        schema = schema["properties"][key]
    return schema


@pytest.mark.parametrize("name", all_settings())
def test_every_setting_is_described_with_default_range_and_choices(name: str) -> None:
    one, found = all_settings()[name], part(TASK, name)
    assert one.help in found["description"]
    default = list(one.default) if isinstance(one.default, tuple) else one.default
    assert found["default"] == default
    assert faults(found, default) == []
    if one.choices:
        assert [value for value in found["enum"] if value is not None] == list(one.choices)
    if one.low is not None and one.kind in (int, float):
        assert (found["minimum"], found["maximum"]) == (one.low, one.high)
        assert faults(found, one.low - 1)
        assert faults(found, one.high + 1)
    assert (faults(found, None) == []) is (one.kind is not one.type)


def test_every_group_refuses_unknown_keys() -> None:
    for group in all_groups():
        found = part(TASK, group) if group else TASK
        assert found["additionalProperties"] is False
        assert faults(found, {"no_such_key": 1})


def test_priors_and_networks_are_described() -> None:
    assert set(PRIORS) == set(part(TASK, "priors")["properties"])
    assert part(TASK, "priors")["properties"]["flow"]["then"]["properties"]["axes"]["default"] == 26
    assert "blocks" in part(TASK, "lifter.options")["properties"]


# Schema and loader agree.

TASKS = {
    "nothing unusual": ("extends: cmu\nseed: 3\n", True),
    "a group": ("extends: default\nlifter: {camera: orthographic, distance: 12}\n", True),
    "a name that looks like a number": ("data: {select: {subjects: [1, S5]}}\n", True),
    "nothing for what may be unset": ("trainer: {max_time: null, max_steps: 10}\n", True),
    "a time by units": ("trainer: {max_time: {minutes: 1, seconds: 30}}\n", True),
    "focal lengths by camera": ("data: {focal_px: {left: 1145, right: 1200}}\n", True),
    "a pair": ("views: {azimuth_deg: [-90, 90]}\n", True),
    "a prior of one's own": ("priors: {mine: {use: 'my.py:Mine', weight: 2, anything: [1, 2]}}\n", True),
    "an option of a prior": ("priors: {bones: {slack: 0.1}}\n", True),
    "another class under a built-in's name": ("priors: {bones: {use: critic, objective: minimax}}\n", True),
    "options of a network": ("lifter: {options: {units: 64, own: 3}}\n", True),
    "a whole number for a number": ("teacher: {learning_rate: 1}\n", True),
    "a typo": ("trainer: {max_tme: '00:01:00'}\n", False),
    "a typo at the top": ("extend: cmu\n", False),
    "another choice": ("lifter: {camera: fisheye}\n", False),
    "too much": ("lifter: {distance: 100000}\n", False),
    "too little": ("seed: -1\n", False),
    "text for a number": ("teacher: {batch_size: many}\n", False),
    "a number for a switch": ("lifter: {fill: [1]}\n", False),
    "half a number": ("teacher: {batch_size: 2.5}\n", False),
    "a value for a group": ("data: 3\n", False),
    "nothing for a group": ("data:\n", False),
    "nothing for what is needed": ("seed: null\n", False),
    "a list that is too long": ("views: {azimuth_deg: [-90, 0, 90]}\n", False),
    "a pair out of range": ("lifts: masks\nshape: {elevation_deg: [15, -1]}\n", False),
    "a list of the wrong kind": ("student: {rounds: [a, b]}\n", False),
    "no mapping": ("- seed\n", False),
    "a list to extend": ("extends: [cmu]\n", False),
    "a prior that is a number": ("priors: {bones: 3}\n", False),
    "a weight below 0": ("priors: {bones: {weight: -1}}\n", False),
    "a weight in words": ("priors: {mine: {use: bones, weight: much}}\n", False),
    "an option that a prior lacks": ("priors: {bones: {slak: 0.1}}\n", False),
    "an option of another kind": ("priors: {bones: {slack: some}}\n", False),
}  # fmt: skip


def loads_task(path: Path) -> None:
    settings = load_settings(str(path))
    own = {name: spec for name, spec in settings.priors.items() if "my.py" not in str(spec.get("use"))}
    build_priors(own, load_skeleton("h36m17"))


SKELETON_TEXT = "joints: [a, b, c]\nroot: a\nbones: [[a, b], [a, c]]\n"
SKELETONS = {
    "the least": ("", True),
    "all pairs": ("mirror: [[b, c]]\nmidpoints: {a: [b, c]}\n", True),
    "facing": ("joints: [a, b, c, d]\nbones: [[a, b], [a, c], [a, d]]\nfacing: {front: [a, d], left: [b, c]}\n", True),
    "a size": ("size: {along: [b, a, c], mm: 100}\n", True),
    "another layout": ("from: {tracker: {a: A, b: [B, C]}}\n", True),
    "a body": ("rest: {b: [0, 1, 0]}\nproportions: {b: 2}\nlimits: {b: {flexion: [-10, 10]}}\n", True),
    "a typo": ("mirrors: [[b, c]]\n", False),
    "no list of joints": ("joints: 3\n", False),
    "too few joints": ("joints: [a, b]\n", False),
    "a joint twice": ("joints: [a, b, c, c]\n", False),
    "a joint that is a number": ("joints: [a, b, c, 4]\n", False),
    "blanks around a name": ("joints: [a, b, c, ' d']\n", False),
    "a bone of three": ("bones: [[a, b, c]]\n", False),
    "a bone to itself": ("bones: [[a, a]]\n", False),
    "a word for a switch": ("gravity: sometimes\n", False),
    "a direction of no kind": ("facing: {front: [a, b], right: [b, c]}\n", False),
    "half of facing": ("facing: {front: [a, b]}\n", False),
    "up is missing": ("gravity: false\nfacing: {front: [a, b], left: [b, c]}\n", False),
    "a size without joints": ("size: {mm: 100}\n", False),
    "two sizes": ("size: {along: [a, b], mm: 100, of_height: 0.5}\n", False),
    "a size below 0": ("size: {along: [a, b], mm: -1}\n", False),
    "an empty layout": ("from: {tracker: {}}\n", False),
    "no length": ("proportions: {b: 0}\n", False),
    "no direction": ("rest: {b: [0, 0, 0]}\n", False),
    "half a direction": ("rest: {b: [0, 1]}\n", False),
    "a limit in words": ("limits: {b: far}\n", False),
}  # fmt: skip


def skeleton_text(changed: str) -> str:
    """Return the least skeleton with some keys replaced or added."""
    data = yaml.safe_load(SKELETON_TEXT) | (yaml.safe_load(changed) or {})
    return yaml.safe_dump(data, sort_keys=False)


@pytest.mark.parametrize(("text", "valid"), TASKS.values(), ids=TASKS)
def test_schema_and_loader_of_tasks_agree(text: str, valid: bool, tmp_path: Path) -> None:
    agree(TASK, text, valid, tmp_path, loads_task)


@pytest.mark.parametrize(("changed", "valid"), SKELETONS.values(), ids=SKELETONS)
def test_schema_and_loader_of_skeletons_agree(changed: str, valid: bool, tmp_path: Path) -> None:
    agree(SKELETON, skeleton_text(changed), valid, tmp_path, load_skeleton)


def agree(schema: dict[str, Any], text: str, valid: bool, folder: Path, load: Callable[[Path], object]) -> None:
    path = folder / "file.yaml"
    path.write_text(text)
    data, _ = read_yaml(path, "task")
    assert (faults(schema, data) == []) is valid, faults(schema, data)
    try:
        load(path)
        loaded = ""
    except UserError as error:
        loaded = str(error)
    assert (not loaded) is valid, loaded


# The verb.


@pytest.mark.parametrize("kind", ["task", "skeleton"])
def test_the_verb_writes_it_and_says_what_to_do(kind: str, here: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["schema", kind]) == 0
    said = capsys.readouterr().out
    assert f"wrote {kind}.schema.json" in said
    assert said.endswith(f"# yaml-language-server: $schema={kind}.schema.json\n")
    written = json.loads((here / f"{kind}.schema.json").read_text())
    assert written == SCHEMAS[f"{kind}s"]
    assert "is not overwritten" in refusal(capsys, "schema", kind)
    assert main(["schema", kind, "output=a.json"]) == 0
    assert "a schema is a .json file" in refusal(capsys, "schema", kind, "output=a.yaml")


def test_the_verb_needs_a_kind(here: Path, capsys: pytest.CaptureFixture) -> None:
    assert "expected `uplift schema task`" in refusal(capsys, "schema")
    assert "Did you mean 'output'?" in refusal(capsys, "schema", "task", "outptu=a.json")
