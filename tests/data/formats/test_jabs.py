"""JABS's pose files are read with x before y and with the mice told apart."""

from __future__ import annotations

import numpy as np
import pytest
from tracker_files_hdf5 import outcomes, write_jabs

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.jabs import JOINTS
from uplift.errors import UserError


def made(*shape: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random points (uint16, y before x) and confidence."""
    random = np.random.default_rng(0)
    return random.integers(1, 800, (*shape, 12, 2)).astype("u2"), random.uniform(0.1, 1, (*shape, 12)).astype("f4")


def test_a_real_file(benchmark_data) -> None:
    data = read(benchmark_data("trackers/jabs/example_pose_est_v2.h5"))
    assert data.keypoints[0, 0].tolist() == [267, 371] and data.confidence[0, 0] == pytest.approx(0.983169, rel=1e-6)
    assert data.keypoints[99, 11].tolist() == [173, 412] and data.confidence[99, 11] == pytest.approx(
        0.992792, rel=1e-6
    )
    assert data.identity["frame"].tolist() == list(range(100)) and set(data.identity["sequence"]) == {"example"}
    assert (data.joint_names[0], data.joint_names[11], len(data.mirror)) == ("nose", "tip_tail", 3)


@pytest.mark.parametrize("version", [2, 3, 4, 6])
def test_as_sleap_io_reads_it(tmp_path, version) -> None:
    sleap_io = pytest.importorskip("sleap_io")
    points, score = made(5) if version == 2 else made(5, 3)
    score[2, ..., 4] = 0
    more: dict = {} if version == 2 else {"version": np.array([version, 0], "u2")}
    if version > 2:
        count = np.array([3, 2, 1, 0, 3], "u1")
        more["instance_count"] = count
        more["instance_track_id"] = np.tile(np.arange(3, dtype="u4"), (5, 1))
        for frame, there in enumerate(count):
            score[frame, there:] = 0
    if version > 3:
        more["instance_embed_id"] = np.array([[1, 2, 3], [2, 1, 0], [3, 0, 0], [0, 0, 0], [1, 0, 2]], "u4")
    path = write_jabs(tmp_path / f"cage_pose_est_v{version}.h5", points, score, **more)
    assert KEYPOINT_FORMATS.guess(path).name == "jabs"
    data = read(path)
    labels = sleap_io.load_jabs(str(path))
    names = data.identity.get("instance", np.full(len(data), "1"))
    found = {
        (int(frame), str(name)): (np.nan_to_num(k).tolist(), c.tolist())
        for frame, name, k, c in zip(data.identity["frame"], names, data.keypoints, data.confidence, strict=True)
    }
    expected = {
        (frame.frame_idx, one.track.name): (
            np.nan_to_num(one.numpy()).tolist(),
            np.where(one.points["visible"], one.points["score"], 0).astype("f4").tolist(),
        )
        for frame in labels
        for one in frame.instances
    }
    assert found == expected and data.joint_names == JOINTS
    assert [n.upper() for n in data.joint_names] == [node.name for node in labels.skeletons[0].nodes]
    assert set(data.identity["sequence"]) == {"cage"} and ("instance" in data.identity) == (version > 2)


@pytest.mark.parametrize(
    ("shape", "more", "says"),
    [
        ((4, 11, 2), {}, "'poseest/points' has shape (4, 11, 2)"),
        ((4, 2, 12, 3), {}, "'poseest/points' has shape (4, 2, 12, 3)"),
        ((4, 2, 12, 2), {}, "no array 'poseest/instance_track_id'"),
        ((4, 2, 12, 2), {"instance_embed_id": np.ones((4, 3), "u4")}, "expected whole numbers of shape (4, 2)"),
        ((4, 2, 12, 2), {"instance_embed_id": np.ones((4, 2))}, "is float64 of shape (4, 2)"),
        ((4, 2, 12, 2), {"instance_embed_id": np.zeros((4, 2), "u4")}, "no visible keypoint"),
        (
            (4, 2, 12, 2),
            {"instance_track_id": np.ones((4, 2), "u4"), "instance_count": np.ones(3, "u1")},
            "'poseest/instance_count' has shape (3,)",
        ),
    ],
)
def test_a_wrong_file_is_told(tmp_path, shape, more, says) -> None:
    path = write_jabs(tmp_path / "a_pose_est_v4.h5", np.ones(shape, "u2"), np.ones(shape[:-1], "f4"), **more)
    with pytest.raises(UserError) as caught:
        read(path)
    assert says in str(caught.value) and path.name in str(caught.value)


def test_confidence_over_one_is_clipped(tmp_path) -> None:
    points, score = made(3)
    score[1, 2] = 1.008
    assert read(write_jabs(tmp_path / "a.h5", points, score)).confidence[1, 2] == 1


def test_a_layout_names_the_keypoints_and_percentages_are_divided(tmp_path) -> None:
    points, score = made(3)
    skeleton = tmp_path / "mouse.yaml"
    names = [f"part_{letter}" for letter in "abcdefghijkl"]
    bones = [[names[0], name] for name in names[1:]]
    skeleton.write_text(f"name: mouse\njoints: {names}\nroot: part_a\nbones: {bones}\n")
    data = read(write_jabs(tmp_path / "a.h5", points, score * 100), ReadOptions(layout=str(skeleton)))
    assert list(data.joint_names) == names and data.bones == ()
    assert not any("no effect" in note for note in data.notes)
    np.testing.assert_allclose(data.confidence, score, rtol=1e-5)


def test_damaged_files_are_refused_or_read(tmp_path) -> None:
    whole = write_jabs(tmp_path / "whole.h5", *made(9))
    found = outcomes(whole, lambda path: read(path, ReadOptions(format="jabs")), 48)
    assert not found["wrong"] and found["refused"] >= 14 and found["read"] >= 5 and found["lost"] <= 3
