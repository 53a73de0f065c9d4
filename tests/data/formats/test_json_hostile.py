"""Damaged and hostile files of the JSON and text formats end in one clear error, or in a whole `PoseData`."""

from __future__ import annotations

import copy
import json
import random
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tracker_files_json import (
    alphapose_list,
    alphapose_objects,
    alphatracker,
    coco_annotations,
    coco_results,
    kinetics,
    mmpose,
    mmpose_instance,
    mpii,
    openpose_frame,
    people,
    ultralytics_list,
    ultralytics_row,
    write_json,
)

from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError

BODIES = people(4, 5, seed=1)
NAMES = tuple("abcde")


def video() -> dict[str, Any]:
    content = coco_annotations(
        np.where(BODIES[..., 2:] > 0, np.concatenate([BODIES[..., :2], BODIES[..., 2:] > 0], -1), 0), NAMES
    )
    for number, image in enumerate(content["images"]):
        image.update(frame_id=number, video_id=1)
    for number, record in enumerate(content["annotations"]):
        record["track_id"] = number % 2
    return {**content, "videos": [{"id": 1, "name": "v"}]}


CONTENTS = {
    "coco": [coco_annotations(BODIES, NAMES), video()],
    "coco_results": [coco_results(BODIES)],
    "alphapose": [alphapose_list(BODIES), alphapose_objects(BODIES, "cmu")],
    "openpose": [openpose_frame([{"pose": one, "face": one} for one in BODIES])],
    "mmpose": [
        mmpose([[one, one] for one in BODIES], NAMES, tracks=True),
        [mmpose_instance(one) for one in BODIES],
        [[mmpose_instance(one)] for one in BODIES],
    ],
    "kinetics_skeleton": [kinetics([[one] for one in BODIES]), kinetics([[one] for one in BODIES], flat=False)],
    "mpii_json": [mpii(BODIES)],
    "alphatracker": [alphatracker([[BODIES[0, :, :2]], [BODIES[1, :, :2]]])],
    "ultralytics_json": [ultralytics_list(BODIES, tracks=True), [ultralytics_list(BODIES)] * 2],
}
CASES = [(name, number) for name, contents in CONTENTS.items() for number in range(len(contents))]
HOSTILE: tuple[Any, ...] = (
    None, True, -1, 0, 3.5, 10**400, 2**63, 1e300, float("nan"), float("inf"), -float("inf"), "x", "", "1", "\ud800",
    [], {}, [[]], [1], {"a": 1}, [[[[[[1]]]]]], "y" * 5000,
)  # fmt: skip


def survives(path: Path, format: str) -> None:
    """Read; anything but a `PoseData` that is whole, or a `UserError` that names the file, fails the test."""
    try:
        data = read(path, ReadOptions(format=format))
    except UserError as error:
        assert str(path) in str(error) or path.parent.name in str(error)
        assert len(str(error)) < 1500
        return
    assert len(data) > 0
    assert data.keypoints.dtype == data.confidence.dtype == np.float32
    assert ((data.confidence >= 0) & (data.confidence <= 1)).all()
    assert (data.confidence > 0).any(1).all()
    assert np.isfinite(data.keypoints[data.confidence > 0]).all()
    assert len(set(data.joint_names)) == len(data.joint_names)
    if "frame" in data.identity:
        assert data.identity["frame"].dtype == np.int64
        assert (data.identity["frame"] >= 0).all()
    data.follows()


def places(value: Any, path: tuple = ()) -> list[tuple]:
    """Return the paths to all values inside one."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, part in inside for found in [(*path, key), *places(part, (*path, key))]]


@pytest.mark.parametrize(("name", "number"), CASES)
def test_whole_files_are_read(tmp_path: Path, name: str, number: int) -> None:
    assert len(read(write_json(tmp_path / "a_1.json", CONTENTS[name][number]), ReadOptions(format=name)))


@pytest.mark.parametrize(("name", "number"), CASES)
def test_truncated(tmp_path: Path, name: str, number: int) -> None:
    text = json.dumps(CONTENTS[name][number])
    path = tmp_path / "a_1.json"
    for end in [*range(1, len(text), max(1, len(text) // 80)), len(text) - 1]:
        path.write_text(text[:end])
        with pytest.raises(UserError) as error:
            read(path, ReadOptions(format=name))
        assert str(path) in str(error.value)


@pytest.mark.parametrize(("name", "number"), CASES)
def test_flipped_bytes(tmp_path: Path, name: str, number: int) -> None:
    whole = json.dumps(CONTENTS[name][number]).encode()
    path, chance = tmp_path / "a_1.json", random.Random(7)
    for _ in range(80):
        changed = bytearray(whole)
        for _ in range(chance.choice((1, 1, 3))):
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
        path.write_bytes(changed)
        survives(path, name)


@pytest.mark.parametrize(("name", "number"), CASES)
def test_other_values_in_place(tmp_path: Path, name: str, number: int) -> None:
    content, path, chance = CONTENTS[name][number], tmp_path / "a_1.json", random.Random(5)
    every = places(content)
    named = [place for place in every if not all(isinstance(key, int) for key in place[-2:])]
    for place in [*named[:40], *chance.sample(every, min(40, len(every)))]:
        changed = copy.deepcopy(content)
        inside = changed
        for key in place[:-1]:
            inside = inside[key]
        inside[place[-1]] = chance.choice(HOSTILE)
        survives(write_json(path, changed), name)
        if isinstance(place[-1], str):
            inside.pop(place[-1])
            survives(write_json(path, changed), name)


@pytest.mark.parametrize("name", sorted(CONTENTS))
def test_another_formats_file(tmp_path: Path, name: str) -> None:
    for contents in CONTENTS.values():
        for content in contents:
            survives(write_json(tmp_path / "a_1.json", content), name)
    for content in (
        "[" * 100_000,
        "{" * 10,
        '{"people": ' + "[" * 5000,
        "5",
        "null",
        '"x"',
        "",
        "{}",
        "[]",
        "[{}]",
        "\x00",
    ):
        (tmp_path / "a_1.json").write_text(content)
        with pytest.raises(UserError):
            read(tmp_path / "a_1.json", ReadOptions(format=name))
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="folder"):
        read(tmp_path / "folder", ReadOptions(format=name))


def test_two_kinds_in_a_folder(tmp_path: Path) -> None:
    kinds = [(name, content) for name, contents in CONTENTS.items() for content in contents if name != "coco_results"]
    pairs = [(one, other) for one, other in zip(kinds, kinds[3:] + kinds[:3], strict=True) if one[0] != other[0]]
    assert len(pairs) > 8
    for one, other in pairs:
        write_json(tmp_path / "both/a_1.json", one[1])
        write_json(tmp_path / "both/a_2.json", other[1])
        for name in ("openpose", "mmpose", "kinetics_skeleton", "alphapose", "ultralytics_json"):
            with pytest.raises(UserError) as error:
                read(tmp_path / "both", ReadOptions(format=name))
            assert "a_1.json" in str(error.value) or "a_2.json" in str(error.value)


def test_damaged_labels(tmp_path: Path) -> None:
    path, chance = tmp_path / "labels/img.txt", random.Random(3)
    path.parent.mkdir()
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(0.4, 0.6, (5, 8, 2)), rng.integers(0, 3, (5, 8, 1))], -1)
    whole = "\n".join(ultralytics_row(one) for one in points).encode()
    tokens = whole.split(b" ")
    for number in range(150):
        changed = bytearray(whole)
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
        path.write_bytes(changed if number % 2 else changed[: chance.randrange(len(changed))])
        if path.stat().st_size:
            survives(path, "ultralytics")
    for hostile in (b"nan", b"inf", b"1e300", b"x", b"-1", b"1e-300", b"", b"9" * 5000, b"0x10"):
        for place in range(0, len(tokens), 9):
            path.write_bytes(b" ".join([*tokens[:place], hostile, *tokens[place + 1 :]]))
            survives(path, "ultralytics")


def test_damaged_descriptions(tmp_path: Path) -> None:
    whole = (
        b"kpt_shape: [5, 3]\nnames: {0: person, 1: dog}\nflip_idx: [0, 2, 1, 4, 3]\nkpt_names: {0: [a, b, c, d, e]}\n"
    )
    row = ultralytics_row(np.array([[0.4, 0.5, 2], [0.5, 0.5, 1], [0.6, 0.4, 2], [0.5, 0.6, 0], [0.45, 0.55, 2]]))
    (tmp_path / "img.txt").write_text(row)
    path, chance = tmp_path / "data.yaml", random.Random(4)
    for number in range(60):
        changed = bytearray(whole)
        for _ in range(1 + number % 3):
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
        path.write_bytes(changed)
        survives(tmp_path / "img.txt", "ultralytics")
    bombs = (
        "a: &a [x, x]\nb: &b [*a, *a]\nkpt_shape: *b\n",
        "kpt_shape: " + "[" * 3000,
        "? [1]\n: kpt_shape",
        "!!python/object:os.system kpt_shape",
    )
    for content in bombs:
        path.write_text(content)
        survives(tmp_path / "img.txt", "ultralytics")


def test_long_names_take_no_memory(tmp_path: Path) -> None:
    content = coco_results(people(5000, 17))
    content[7]["image_id"] = "x" * 2_000_000
    with pytest.raises(UserError, match="a name of 2,000,000 characters"):
        read(write_json(tmp_path / "a.json", content), ReadOptions(format="coco_results"))
    content = coco_annotations(BODIES, NAMES)
    content["annotations"][1]["id"] = "x" * 2_000_000
    with pytest.raises(UserError, match="a name of 2,000,000 characters"):
        read(write_json(tmp_path / "a.json", content))


def test_long_strings_take_no_memory(tmp_path: Path) -> None:
    content = coco_results(people(50, 17))
    content[7]["keypoints"][3] = "9" * 20_000_000
    path = write_json(tmp_path / "a.json", content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match="entry 7"):
        read(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # KiB
