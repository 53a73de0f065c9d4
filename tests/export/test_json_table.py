"""The JSON writer, read back by the json module."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from writers_samples import complete_prediction, prediction

from uplift.errors import UserError
from uplift.export.scene import AXES, in_axes
from uplift.export.tables import write_json
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def read(path: Path) -> dict:
    return json.loads(path.read_bytes(), parse_constant=refuse)


def column(found: dict, name: str) -> np.ndarray:
    return np.array([frame[name] for frame in found["frames"]], dtype=float)


@pytest.fixture
def sample() -> Prediction:
    return complete_prediction(frames=5)


def test_everything_comes_back(sample: Prediction, tmp_path: Path) -> None:
    write_json(sample, tmp_path / "poses.json")
    found = read(tmp_path / "poses.json")
    for name, rtol in {"pose": 5e-7, "root": 5e-7, "keypoints": 5e-6, "uncertainty": 5e-6, "tilt_deg": 5e-6}.items():
        np.testing.assert_allclose(column(found, name), getattr(sample, name), rtol=rtol, atol=1e-12)
    np.testing.assert_array_equal(column(found, "confidence"), sample.confidence)
    assert sample.filled is not None
    assert [frame["filled"] for frame in found["frames"]] == sample.filled.tolist()
    for key, values in sample.identity.items():
        assert [frame["identity"][key] for frame in found["frames"]] == values.tolist()


def test_the_file_says_what_it_holds(sample: Prediction, tmp_path: Path) -> None:
    write_json(in_axes(sample, "opensim"), tmp_path / "poses.json")
    found = read(tmp_path / "poses.json")
    assert (found["format"], found["version"]) == ("uplift poses", 1)
    assert (found["skeleton"], found["root_joint"]) == ("figure", "hip")
    assert found["joint_names"] == list(sample.joint_names)
    assert [tuple(bone) for bone in found["bones"]] == list(sample.skeleton.bones)
    assert (found["unit"], found["axes"], found["axes_meaning"]) == ("mm", "opensim", AXES["opensim"])
    assert (found["fps"], found["image_size"]) == (30, [640, 480])
    assert list(found["fields"]) and {*found["fields"]} == {*found["frames"][0]}


def test_what_is_not_known_is_left_out_or_null(tmp_path: Path) -> None:
    sample = replace(prediction(frames=3, tilt=False), fps=None, image_size=None)
    sample.pose[1, 2] = np.nan
    sample.pose[2, 2, 0] = np.inf
    sample.keypoints[0, 1], sample.confidence[0, 1] = 0, 0
    sample = replace(sample, identity={"frame": np.array([1.0, np.nan, 3])})
    write_json(sample, tmp_path / "poses.json")
    found = read(tmp_path / "poses.json")
    assert found["fps"] is None and found["image_size"] is None
    assert set(found["frames"][0]) == {"identity", "pose", "keypoints", "confidence"} == set(found["fields"])
    assert found["frames"][1]["pose"][2] == [None] * 3 and found["frames"][2]["pose"][2][0] is None
    assert found["frames"][0]["keypoints"][1] == [None, None]
    assert [frame["identity"]["frame"] for frame in found["frames"]] == [1, None, 3]


@given(names=st.lists(st.text(min_size=1), min_size=2, unique=True), label=st.text())
def test_no_name_breaks_the_file(names: list[str], label: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("json")
    skeleton = Skeleton(label, tuple(names), names[0], ((names[0], names[1]),))
    pose = np.arange(len(names) * 3, dtype=float)[None].reshape(1, len(names), 3)
    identity = {"action": np.array([label], dtype=object), "camera": np.array([b"c\xff"])}
    odd = Prediction(pose, pose, "px", pose[..., :2], pose[..., 0], tuple(names), skeleton, identity=identity)
    write_json(odd, folder / "poses.json")
    found = read(folder / "poses.json")
    assert found["joint_names"] == names and found["skeleton"] == label
    assert found["frames"][0]["identity"] == {"action": label, "camera": "c\ufffd"}
    np.testing.assert_array_equal(column(found, "pose"), pose)


def test_same_poses_give_the_same_bytes_and_none_an_empty_list(sample: Prediction, tmp_path: Path) -> None:
    write_json(sample, tmp_path / "a.json")
    write_json(sample, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    write_json(sample.select(np.zeros(len(sample), bool)), tmp_path / "none.json")
    assert read(tmp_path / "none.json")["frames"] == []


def test_a_long_film_is_not_held_as_text(tmp_path: Path) -> None:
    sample = prediction(frames=4_000, joints=10)
    tracemalloc.start()
    write_json(sample, tmp_path / "poses.json")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.7 * (tmp_path / "poses.json").stat().st_size


def test_a_missing_folder_is_named(sample: Prediction, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist"):
        write_json(sample, tmp_path / "nowhere" / "poses.json")
