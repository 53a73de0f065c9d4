"""Keypoints written as csv are read back the same, by our readers and by pandas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.csv import write_keypoints_csv
from uplift.data.formats.deeplabcut import write_deeplabcut_csv
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import load_skeleton


@pytest.fixture(scope="module")
def body() -> PoseData:
    """Return simulated clips with some joints missing."""
    data = simulate(load_skeleton("h36m17"), 120, seed=0)
    rng = np.random.default_rng(0)
    data.confidence[:] = rng.uniform(0.1, 1, data.confidence.shape)
    gone = rng.random(data.confidence.shape) < 0.1
    data.confidence[gone] = 0
    data.keypoints[gone] = np.nan
    return data


def pair(data: PoseData) -> PoseData:
    """Return the first clip, seen as two individuals one after the other."""
    one = data.select(data.clips() == data.clips()[0])
    return PoseData(
        np.concatenate([one.keypoints, one.keypoints[1:] + 100]),
        np.concatenate([one.confidence, one.confidence[1:]]),
        one.joint_names,
        identity={
            "sequence": np.full(2 * len(one) - 1, "walk"),
            "frame": np.concatenate([one.identity["frame"], one.identity["frame"][1:]]),
            "instance": np.repeat(["b", "a"], [len(one), len(one) - 1]),
        },
    )


def check_equal(ours: PoseData, theirs: PoseData, keys: tuple[str, ...]) -> None:
    np.testing.assert_array_equal(ours.keypoints, theirs.keypoints)
    np.testing.assert_array_equal(ours.confidence, theirs.confidence)
    assert ours.joint_names == theirs.joint_names
    for key in keys:
        np.testing.assert_array_equal(ours.identity[key].astype(str), theirs.identity[key].astype(str))


def test_plain_csv_comes_back(tmp_path: Path, body: PoseData):
    path = tmp_path / "walk.csv"
    write_keypoints_csv(body, path)
    data = read(path)
    assert KEYPOINT_FORMATS.guess(path).name == "csv"
    check_equal(data, body, tuple(body.identity))
    assert set(data.identity) == set(body.identity)
    np.testing.assert_array_equal(data.clips(), body.clips())
    assert (data.fps, data.image_size) == (body.fps, body.image_size)
    table = pd.read_csv(path)
    np.testing.assert_array_equal(
        table["nose_x"].astype(np.float32), body.keypoints[:, body.joint_names.index("nose"), 0]
    )


def test_individuals_come_back(tmp_path: Path, body: PoseData):
    two = pair(body)
    for write, name in ((write_keypoints_csv, "csv"), (write_deeplabcut_csv, "deeplabcut")):
        path = tmp_path / "walk.csv"
        write(two, path)
        assert KEYPOINT_FORMATS.guess(path).name == name
        check_equal(read(path), two, ("sequence", "frame", "instance"))


def test_deeplabcuts_layout_is_that_of_pandas(tmp_path: Path, body: PoseData):
    one = body.select(body.clips() == 0)
    path = tmp_path / "walk.csv"
    write_deeplabcut_csv(one, path)
    check_equal(read(path), one, ("frame",))
    table = pd.read_csv(path, header=[0, 1, 2], index_col=0)
    assert table.columns.names == ["scorer", "bodyparts", "coords"]
    assert list(dict.fromkeys(table.columns.get_level_values(1))) == list(one.joint_names)
    np.testing.assert_array_equal(table.to_numpy(np.float32).reshape(len(one), -1, 3)[..., :2], one.keypoints)
    images = PoseData(
        one.keypoints,
        one.confidence,
        one.joint_names,
        identity={"image": np.array([f"{n}.png" for n in range(len(one))])},
    )
    write_deeplabcut_csv(images, path)
    check_equal(read(path), images, ("image",))


def test_what_a_layout_cannot_hold_is_told(tmp_path: Path, body: PoseData):
    with pytest.raises(UserError, match="videos .*DeepLabCut's csv holds one"):
        write_deeplabcut_csv(body, tmp_path / "a.csv")
    two = pair(body)
    two.identity["instance"][:] = "a"
    with pytest.raises(UserError, match="'a' is in '.*' twice"):
        write_deeplabcut_csv(two, tmp_path / "a.csv")
    for names in (("1", "2"), ("bbox", "b"), ("a ", "b"), ("a", "a"), ("", "b")):
        odd = PoseData(np.ones((1, 2, 2), np.float32), np.ones((1, 2), np.float32), names)
        with pytest.raises(UserError, match="cannot be distinguished from a column's"):
            write_keypoints_csv(odd, tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


def test_names_with_commas_and_quotes_come_back(tmp_path: Path):
    identity = {"sequence": np.array(["a,b", "c"]), "frame": np.array([0, 0]), "subject": np.array(["x", "y z"])}
    data = PoseData(
        np.ones((2, 2, 2), np.float32), np.ones((2, 2), np.float32), ("ear, left", "née"), identity=identity
    )
    write_keypoints_csv(data, tmp_path / "a.csv")
    check_equal(read(tmp_path / "a.csv"), data, tuple(identity))
