"""MPI-INF-3DHP's files of both MATLAB generations become frames whose 3D projects to their 2D."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi_inf_3dhp_files import (
    JOINTS,
    SCALE,
    TEST_JOINTS,
    arrays_of_test,
    calibration_text,
    extrinsics,
    save,
    train_arrays,
    world_motion,
    write_test,
    write_train,
)  # fmt: skip

from uplift.config.loading import load_settings
from uplift.data.datasets import read_cached
from uplift.data.datasets.mpi_inf_3dhp import _SEQUENCES, ACTIVITIES, MpiInf3dhp
from uplift.data.load import in_joints_of, load_data
from uplift.errors import UserError
from uplift.skeleton import load_skeleton


def projected(data) -> np.ndarray:
    points = (data.pose + data.root[:, None]).astype(np.float64)
    seen = np.empty((*points.shape[:2], 2))
    for place, lens in enumerate(data.lenses):
        seen[data.lens == place] = lens.project(points[data.lens == place])
    return seen


@pytest.fixture(scope="module")
def train(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("train")
    write_train(folder, "S1", frames=30, seed=0)
    write_train(folder, "S4", frames=20, seed=5, modern=True)
    return folder


@pytest.fixture(scope="module")
def official(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("test")
    for number in range(1, 7):
        write_test(folder / "mpi_inf_3dhp_test_set", number, modern=number % 2 == 0, bent=number == 5)
    return folder


@pytest.mark.parametrize("universal", [True, False])
def test_training_frames_project_to_what_was_seen(train: Path, universal: bool) -> None:
    data = MpiInf3dhp(train, subjects="S1,S4", universal=universal).read("train")
    assert data.joint_names == JOINTS
    assert len(data) == 5 * (30 + 15 + 20 + 20)  # S1 Seq2 has 50 frames a second
    assert np.abs(projected(data) - data.keypoints).max() < 0.02
    assert (data.confidence == 1).all()
    assert data.fps == 25
    assert data.image_size == (2048, 2048)
    np.testing.assert_allclose(data.pose[:, JOINTS.index("pelvis")], 0, atol=1e-3)


def test_the_universal_pose_is_the_measured_one_scaled(train: Path) -> None:
    own = MpiInf3dhp(train, subjects="S1", universal=False).read("train")
    universal = MpiInf3dhp(train, subjects="S1").read("train")
    np.testing.assert_allclose(universal.pose, SCALE * own.pose, atol=1e-2)
    np.testing.assert_allclose(universal.root, SCALE * own.root, rtol=1e-4)
    points = world_motion(30, 1) @ extrinsics(4)[0].T + extrinsics(4)[1]
    rows = (own.identity["camera"] == 4) & (own.identity["sequence"] == "Seq1")
    np.testing.assert_allclose((own.pose + own.root[:, None])[rows], points, atol=1e-2)


def test_clips_cameras_and_frames(train: Path) -> None:
    data = MpiInf3dhp(train, cameras="vnect", subjects="S1").read("train")
    assert sorted(set(data.identity["camera"])) == [0, 1, 2, 4, 5, 6, 7, 8]
    assert set(data.identity["subject"]) == {"S1"}
    assert len(set(data.clips())) == 2 * 8
    assert data.follows().sum() == len(data) - 16
    second = (data.identity["sequence"] == "Seq2") & (data.identity["camera"] == 0)
    np.testing.assert_array_equal(data.identity["frame"][second], np.arange(15))
    every = train_arrays(30, 2)["annot2"][0].reshape(30, 28, 2)
    np.testing.assert_allclose(data.keypoints[second], every[::2], atol=1e-3)
    thinned = MpiInf3dhp(train, cameras="4", subjects="S1", fps=5).read("train")
    assert len(thinned) == 6 + 3
    assert thinned.fps == 5


def test_lenses_and_tilt_are_those_of_the_calibration(train: Path) -> None:
    data = MpiInf3dhp(train, cameras="0,8", subjects="S1").read("train")
    assert [lens.focal_px for lens in data.lenses] == [(1497.693, 1497.103), (1500.172, 1500.837)]
    assert data.lenses[0].centre_px == (1024.704, 1051.394)
    gravity = extrinsics(0)[0] @ [0, -1, 0]
    tilt = np.degrees(np.arctan2(gravity[2], gravity[1]))
    np.testing.assert_allclose(data.tilt_deg[data.identity["camera"] == 0], tilt, atol=1e-4)
    assert 1.5 < tilt < 2.5


def test_the_28_joints_become_the_17_of_the_test_set_by_name(train: Path, official: Path) -> None:
    target = load_skeleton("mpi_inf_3dhp17")
    for data in (
        MpiInf3dhp(train, subjects="S1").read("train"),
        MpiInf3dhp(official).read("test"),
    ):
        built = in_joints_of(data, target)
        places = [data.joint_names.index(joint) for joint in target.joints]
        np.testing.assert_allclose(built.pose, data.pose[:, places], atol=1e-3)
        assert (built.confidence == 1).all()


@pytest.mark.parametrize("universal", [True, False])
def test_test_frames_project_to_what_was_seen(official: Path, universal: bool) -> None:
    data = MpiInf3dhp(official, universal=universal).read("test")
    assert data.joint_names == TEST_JOINTS
    assert len(data) == 6 * 14
    assert np.abs(projected(data) - data.keypoints).max() < 0.02
    assert list(dict.fromkeys(data.identity["subject"])) == [f"TS{n}" for n in range(1, 7)]
    np.testing.assert_array_equal(data.identity["frame"][:14], np.arange(0, 28, 2))
    np.testing.assert_array_equal(data.identity["action"][:14], np.tile(ACTIVITIES, 2))
    sizes = {lens.image_size for lens in data.lenses}
    assert sizes == {(2048, 2048), (1920, 1080)}
    assert [lens.bends for lens in data.lenses] == [False, True, False]
    assert data.lenses[0].focal_px == pytest.approx((1500.172, 1500.832), abs=1e-3)
    assert 11 < data.tilt_deg[0] < 13


def test_both_generations_give_the_same(tmp_path: Path) -> None:
    for modern in (False, True):
        write_test(tmp_path / str(modern), 2, modern=modern)
        write_train(tmp_path / str(modern), "S2", frames=8, modern=modern)
    for split in ("train", "test"):
        old, new = (MpiInf3dhp(tmp_path / name, subjects="S2,TS2").read(split) for name in ("False", "True"))
        for name in ("keypoints", "pose", "root", "tilt_deg"):
            np.testing.assert_array_equal(getattr(old, name), getattr(new, name))


def test_a_camera_that_is_not_the_published_one_is_found_from_the_points(tmp_path: Path) -> None:
    write_test(tmp_path, 1)
    other = write_test(tmp_path / "other", 1)
    arrays = arrays_of_test(1, 28, 10)
    arrays["annot2"] = arrays["annot2"] * 1.02 + 3  # another focal length and centre
    save(other, arrays, True)
    data = MpiInf3dhp(tmp_path / "other", subjects="TS1").read("test")
    assert np.abs(projected(data) - data.keypoints).max() < 0.02
    assert data.lenses[0].focal_px[0] == pytest.approx(1500.172 * 1.02, abs=0.05)


def test_another_test_sequence_is_no_camera_to_fit(tmp_path: Path) -> None:
    write_test(tmp_path, 1)
    write_test(tmp_path, 6).replace(tmp_path / "TS1/annot_data.mat")
    assert "another sequence's file?" in refused(tmp_path, "test")


def test_annotations_behind_the_last_image_are_left_out(train: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(_SEQUENCES, "S1", ((10, 25), (11, 50)))
    data = MpiInf3dhp(train, cameras="0,2", subjects="S1").read("train")
    assert len(data) == 2 * (10 + 6)
    assert data.identity["frame"].tolist() == 2 * list(range(10)) + 2 * list(range(6))


def test_the_task_loads_both_splits(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UPLIFT_CACHE", str(here / "cache"))
    folder = here / "data/mpi_inf_3dhp"
    for subject in range(1, 9):
        write_train(folder, f"S{subject}", frames=4)
    for number in range(1, 7):
        write_test(folder, number)
    settings = load_settings("mpi_inf_3dhp")
    found = load_data(settings, load_skeleton(settings.skeleton))
    assert len(found.train) == 5 * (11 * 4 + 5 * 2)  # 5 of 16 sequences have 50 frames a second
    assert found.train.joint_names == found.test.joint_names == TEST_JOINTS
    assert sorted(set(found.test.identity["action"])) == sorted(ACTIVITIES)
    straight = found.test.straightened()
    assert straight.keypoints.shape == (84, 17, 2)


def test_it_is_cached(train: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UPLIFT_CACHE", str(tmp_path))
    first = read_cached(MpiInf3dhp(train, subjects="S4"), "train")
    monkeypatch.setattr(MpiInf3dhp, "read", None)
    again = read_cached(MpiInf3dhp(train, subjects="S4"), "train")
    np.testing.assert_array_equal(first.pose, again.pose)
    assert first.lenses == again.lenses


def refused(folder: Path, split: str = "train", **options) -> str:
    with pytest.raises(UserError) as error:
        MpiInf3dhp(folder, **{"subjects": "S1,TS1", **options}).read(split)
    return str(error.value)


def test_missing_files_are_named(tmp_path: Path) -> None:
    write_train(tmp_path, "S1", frames=4)
    (tmp_path / "S1/Seq2/camera.calibration").unlink()
    missing = MpiInf3dhp(tmp_path, subjects="S1").missing("train")
    assert [file.path for file in missing] == [tmp_path / "S1/Seq2/camera.calibration"]
    assert len(MpiInf3dhp(tmp_path).missing("train")) == 7 * 4 + 1
    assert len(MpiInf3dhp(tmp_path).missing("test")) == 6


@pytest.mark.parametrize("modern", [False, True])
def test_wrong_training_files_are_refused(tmp_path: Path, modern: bool) -> None:
    def written(**changes) -> str:
        write_train(tmp_path, "S1", frames=4, modern=modern, **changes)
        return refused(tmp_path)

    whole = train_arrays(4, 1)
    assert "no 'univ_annot3'" in written(univ_annot3=None)
    assert "no 'annot2'" in written(annot2=None)
    assert "28 joints" in written(annot3=[a[:, :51] for a in whole["annot3"]])
    assert "different lengths" in written(annot2=[a[:3] for a in whole["annot2"]])
    assert "expected a cell for each camera" in written(annot2=whole["annot2"][0])
    assert "has no camera 7" in written(cameras=np.arange(7)[None])
    assert "cells, expected one" in written(annot2=whole["annot2"][:3])
    turned = [np.roll(a.reshape(4, 28, 3), 1, 2).reshape(4, -1) for a in whole["annot3"]]
    assert "px from 'annot2'" in written(annot3=turned)


@pytest.mark.parametrize("modern", [False, True])
def test_wrong_test_files_are_refused(tmp_path: Path, modern: bool) -> None:
    def written(**changes) -> str:
        write_test(tmp_path, 1, modern=modern, **changes)
        return refused(tmp_path, "test")

    whole = arrays_of_test(1, 28, 10)
    assert "no 'activity_annotation'" in written(activity_annotation=None)
    assert "expected (2, 17, 1, frames)" in written(annot2=np.zeros((2, 28, 1, 28)))
    assert "'valid_frame' has 5 values for 28 frames" in written(valid_frame=np.ones((1, 5)))
    assert "no frame of it is marked valid" in written(valid_frame=np.zeros((1, 28)))
    assert "expected 1 to 7" in written(activity_annotation=np.full((1, 28), 8.0))
    assert "different lengths" in written(annot3=whole["annot3"][..., :20])
    assert "px from 'annot2'" in written(annot3=whole["annot3"][..., ::-1] * [[[[1]]], [[[-3]]], [[[0.4]]]])
    write_train(tmp_path / "x", "S1", frames=4, modern=modern)
    (tmp_path / "x/S1/Seq1/annot.mat").rename(tmp_path / "TS1/annot_data.mat")
    assert "no 'valid_frame'" in refused(tmp_path, "test")


@pytest.mark.parametrize("modern", [False, True])
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path: Path, modern: bool) -> None:
    path = write_test(tmp_path, 1, modern=modern)
    whole = path.read_bytes()
    assert len(MpiInf3dhp(tmp_path, subjects="TS1").read("test")) == 14
    for share in (0.0, 0.01, 0.3, 0.7, 0.97):
        path.write_bytes(whole[: int(len(whole) * share)])
        assert str(path) in refused(tmp_path, "test")
    path.write_bytes(b"PK\x03\x04 something else" * 100)
    assert "MATLAB" in refused(tmp_path, "test")
    rng = np.random.default_rng(0)
    for _ in range(60):
        broken = bytearray(whole)
        for place in rng.integers(0, len(whole), 8):
            broken[place] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(broken))
        try:
            MpiInf3dhp(tmp_path, subjects="TS1").read("test")
        except UserError as error:
            assert "annot_data.mat" in str(error)


def test_a_link_out_of_the_file_is_not_followed(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path, other = write_test(tmp_path, 1), write_test(tmp_path / "other", 1)
    with h5py.File(path, "r+") as file:
        del file["annot2"]
        file["annot2"] = h5py.ExternalLink(str(other), "annot2")
    assert "is a link, expected an array" in refused(tmp_path, "test")


def test_an_array_that_claims_more_than_the_machine_has(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = write_test(tmp_path, 1)
    with h5py.File(path, "r+") as file:
        del file["annot2"]
        file.create_dataset("annot2", shape=(10**9, 1, 17, 2), chunks=(1000, 1, 17, 2), dtype="f8")
    assert "more than half of this machine's memory" in refused(tmp_path, "test")


def test_wrong_calibrations_are_refused(tmp_path: Path) -> None:
    write_train(tmp_path, "S1", frames=4)
    path = tmp_path / "S1/Seq1/camera.calibration"
    text = calibration_text()

    def written(content: str) -> str:
        path.write_text(content)
        return refused(tmp_path)

    assert "does not begin with 'Skeletool" in written("hello\n")
    assert "does not begin with 'Skeletool" in written("")
    assert "no camera 4, 7, 8" in written("\n".join(text.splitlines()[: 1 + 7 * 4]))
    assert "expected 'extrinsic' with 16" in written("\n".join(text.splitlines()[: 1 + 7 * 4 + 5]))
    assert "expected 'intrinsic' with 16" in written(text.replace("1497.693", "x"))
    assert "no rotation" in written(text.replace("0.9650164", "9.650164"))
    assert "px from 'annot2'" in written(text.replace("1497.693 0 1024.704", "1497.693 0 24.704"))
    path.write_bytes(b"\xff\xfe\x00")
    assert "cannot be read" in refused(tmp_path)


def test_options_are_checked(tmp_path: Path) -> None:
    for options, said in (
        ({"cameras": "chests"}, "expected one of chest"),
        ({"cameras": "0,99"}, "numbers from 0 to 13"),
        ({"fps": 50}, "expected 25, 5 or 1"),
        ({"subjects": "S9"}, "no subject 'S9'"),
    ):
        with pytest.raises(UserError, match=said):
            MpiInf3dhp(tmp_path, **options)
