"""Coordinates that are shares of the image, and confidences that are per cent: made pixels and 0..1, or refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import uplift
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.npz import contents_of
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

SIZE = (1088, 1920)
JOINTS = ("nose", "left_hip", "right_hip")
PIXELS = np.array([[[568, 526], [610, 894], [700, 889]], [[563, 531], [605, 894], [695, 889]]], np.float64)
SURE = np.array([[0.22, 0.74, 0.79], [0.2, 0.73, 0.79]])


def write_csv(path: Path, points: np.ndarray, sure: np.ndarray | None, _: Path | None = None) -> Path:
    what = ("x", "y") if sure is None else ("x", "y", "score")
    values = points if sure is None else np.concatenate([points, sure[..., None]], -1)
    lines = ["frame," + ",".join(f"{joint}_{one}" for joint in JOINTS for one in what)]
    lines += [f"{frame}," + ",".join(f"{value:.6g}" for value in row.ravel()) for frame, row in enumerate(values)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_dlc(path: Path, points: np.ndarray, sure: np.ndarray) -> Path:
    values = np.concatenate([points, sure[..., None]], -1)
    head = ["scorer" + ",s" * 9, "bodyparts," + ",".join(j for j in JOINTS for _ in range(3))]
    head += ["coords" + ",x,y,likelihood" * 3]
    rows = [f"{frame}," + ",".join(f"{value:.6g}" for value in row.ravel()) for frame, row in enumerate(values)]
    path.write_text("\n".join([*head, *rows]) + "\n")
    return path


def write_npz(path: Path, points: np.ndarray, sure: np.ndarray, **more: np.ndarray) -> Path:
    np.savez(path, keypoints=points, confidence=sure, joint_names=np.array(JOINTS), **more)
    return path


def write_openpose(path: Path, points: np.ndarray, sure: np.ndarray) -> Path:
    path.mkdir()
    for frame, row in enumerate(np.concatenate([points, sure[..., None]], -1)):
        person = {"pose_keypoints_2d": row.ravel().tolist()}
        (path / f"v_{frame:03d}_keypoints.json").write_text(json.dumps({"people": [person]}))
    return path


def write_alphapose(path: Path, points: np.ndarray, sure: np.ndarray) -> Path:
    rows = np.concatenate([points, sure[..., None]], -1)
    people = [{"image_id": f"{n}.jpg", "keypoints": row.ravel().tolist(), "idx": 1} for n, row in enumerate(rows)]
    path.write_text(json.dumps(people))
    return path


def write_mmpose(path: Path, points: np.ndarray, sure: np.ndarray) -> Path:
    pairs = zip(points.tolist(), sure.tolist(), strict=True)
    frames = [
        {"frame_id": n, "instances": [{"keypoints": xy, "keypoint_scores": score}]}
        for n, (xy, score) in enumerate(pairs)
    ]
    path.write_text(json.dumps({"meta_info": {}, "instance_info": frames}))
    return path


WRITERS = {
    "a.csv": write_csv,
    "aDLC_x.csv": write_dlc,
    "a.npz": write_npz,
    "folder": write_openpose,
    "alphapose.json": write_alphapose,
    "mmpose.json": write_mmpose,
}
every_writer = pytest.mark.parametrize("name", WRITERS)


@every_writer
def test_shares_of_an_image_of_known_size_are_pixels(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, PIXELS / SIZE, SURE)
    data = read(path, ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(data.keypoints, PIXELS, atol=0.01)
    assert data.image_size == SIZE
    assert any("shares of the image, turned into pixels of its 1088x1920" in note for note in data.notes)


@pytest.mark.parametrize("turn", [{"flip_y": True}, {"flip_x": True}, {"rotate": 90}, {"rotate": 180}])
def test_shares_are_pixels_before_they_are_turned(tmp_path: Path, turn: dict) -> None:
    pixels = read(write_csv(tmp_path / "pixels.csv", PIXELS, SURE), ReadOptions(image_size=SIZE, **turn))
    shares = read(write_csv(tmp_path / "shares.csv", PIXELS / SIZE, SURE), ReadOptions(image_size=SIZE, **turn))
    np.testing.assert_allclose(shares.keypoints, pixels.keypoints, atol=0.01)
    assert shares.image_size == pixels.image_size
    if "flip_y" in turn:
        np.testing.assert_allclose(shares.keypoints[..., 1], SIZE[1] - PIXELS[..., 1], atol=0.01)


@every_writer
def test_shares_of_an_image_of_unknown_size_are_refused(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name, PIXELS / SIZE, SURE)
    with pytest.raises(UserError, match="coordinates go from 0.27.*: shares of the image.*image_size=WIDTHxHEIGHT"):
        read(path)


@every_writer
def test_pixels_stay_as_they_are(tmp_path: Path, name: str) -> None:
    data = read(WRITERS[name](tmp_path / name, PIXELS, SURE), ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(data.keypoints, PIXELS)
    assert not any("shares" in note for note in data.notes)


@every_writer
@pytest.mark.parametrize(("scale", "what"), [(100, "per cent"), (255, "numbers from 0 to 255")])
def test_confidences_on_other_scales_are_divided(tmp_path: Path, name: str, scale: float, what: str) -> None:
    data = read(WRITERS[name](tmp_path / name, PIXELS, SURE * scale))
    np.testing.assert_allclose(data.confidence, SURE, atol=1e-6)
    assert any(what in note for note in data.notes)


@every_writer
@pytest.mark.parametrize("sure", [SURE * 1000, SURE * 16 - 8])
def test_confidences_on_no_known_scale_are_refused(tmp_path: Path, name: str, sure: np.ndarray) -> None:
    with pytest.raises(UserError, match="confidence goes from .* expected 0 to 1, per cent, or 0 to 255"):
        read(WRITERS[name](tmp_path / name, PIXELS, sure))


def test_one_frame_one_joint_and_points_outside(tmp_path: Path) -> None:
    assert len(read(write_csv(tmp_path / "a.csv", PIXELS[:1] / SIZE, None), ReadOptions(image_size=SIZE))) == 1
    one = tmp_path / "one.csv"
    one.write_text("frame,tip_x,tip_y\n0,0.5,0.25\n")
    assert read(one, ReadOptions(image_size=(200, 100))).keypoints.tolist() == [[[100, 25]]]
    outside = PIXELS / SIZE + [[[0.7, 0]]]
    data = read(write_csv(tmp_path / "b.csv", outside, SURE), ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(data.keypoints, PIXELS + [0.7 * SIZE[0], 0], atol=0.01)


def test_a_missing_joint_does_not_hide_shares(tmp_path: Path) -> None:
    points, sure = PIXELS / SIZE, SURE.copy()
    points[0, 0], sure[0, 0] = (5000, 5000), 0
    data = read(write_npz(tmp_path / "a.npz", points, sure), ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(data.keypoints[1], PIXELS[1], atol=0.01)


def test_the_size_in_the_file_is_used(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "a.npz", PIXELS / SIZE, SURE, image_size=np.array(SIZE))
    np.testing.assert_allclose(read(path).keypoints, PIXELS, atol=0.01)
    assert contents_of(path).frames == 2


@pytest.mark.parametrize("sure", [SURE, SURE * 1000])
def test_what_a_fit_refuses_the_check_of_its_data_refuses(tmp_path: Path, sure: np.ndarray) -> None:
    with pytest.raises(UserError, match="expected (pixels|0 to 1)"):
        contents_of(write_npz(tmp_path / "a.npz", PIXELS / SIZE, sure))


def test_numbers_about_a_middle_are_told(tmp_path: Path) -> None:
    data = read(write_csv(tmp_path / "a.csv", PIXELS / SIZE * 2 - 1, SURE), ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(data.keypoints, PIXELS / SIZE * 2 - 1, atol=1e-5)
    assert any("neither pixels nor shares" in note for note in data.notes)


def test_what_stands_between_the_scales(tmp_path: Path) -> None:
    flags = np.array([[0, 1, 2], [2, 2, 2]])
    assert read(write_npz(tmp_path / "a.npz", PIXELS, flags)).confidence.tolist() == [[0, 0.5, 1], [1, 1, 1]]
    peaks = SURE + 0.5
    assert read(write_npz(tmp_path / "b.npz", PIXELS, peaks)).confidence.max() == 1
    gone = np.where(SURE == 0.22, -1, SURE * 100)
    np.testing.assert_allclose(read(write_csv(tmp_path / "c.csv", PIXELS, gone)).confidence[0], [0, 0.74, 0.79])
    with pytest.raises(UserError, match="confidence goes from 0 to 6.32"):
        read(write_npz(tmp_path / "d.npz", PIXELS, SURE * 8))
    data = read(write_mmpose(tmp_path / "rtm.json", PIXELS, SURE * 8))
    assert data.confidence.min() == 1 and any("RTMPose" in note for note in data.notes)


def test_arrays_in_python_are_pixels_too() -> None:
    skeleton = load_skeleton("h36m17")
    pixels = np.random.default_rng(0).uniform(100, 900, (20, 17, 2)).round()
    data = uplift.KeypointData(pixels / SIZE, skeleton="h36m17", val=0, image_size="1088x1920")
    data.setup("fit")
    np.testing.assert_allclose(data.train_samples.keypoints, pixels, atol=0.01)
    data = uplift.KeypointData((pixels, np.full((20, 17), 80.0)), skeleton=skeleton, val=0)
    data.setup("fit")
    np.testing.assert_allclose(data.train_samples.confidence, 0.8)
    with pytest.raises(UserError, match="arrays: .*shares of the image"):
        uplift.KeypointData(pixels / SIZE, skeleton=skeleton, val=0).setup("fit")


def test_files_that_are_lifted_are_in_pixels(tmp_path: Path) -> None:
    body = np.random.default_rng(0).uniform(100, 900, (20, 17, 2)).round()
    names = np.array(load_skeleton("h36m17").joints)
    np.savez(tmp_path / "a.npz", keypoints=body / SIZE, joint_names=names)
    lifted = load_file(tmp_path / "a.npz", load_skeleton("h36m17"), ReadOptions(image_size=SIZE))
    np.testing.assert_allclose(lifted.keypoints, body, atol=0.01)
