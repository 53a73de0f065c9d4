"""The C3D writer, read back by ezc3d and byte by byte."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from writers_samples import prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.markers import write_c3d
from uplift.export.scene import in_axes
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton


@pytest.fixture(name="ezc3d")
def installed():
    return pytest.importorskip("ezc3d")


def walking(frames: int, individuals: int = 1) -> Prediction:
    sample = prediction(frames, individuals)
    return replace(sample, root=np.linspace([0, 0, 300], [900, 0, 400], frames * individuals))


def test_points_come_back(ezc3d, tmp_path: Path) -> None:
    sample = in_axes(replace(walking(9), fps=29.97), "opensim")
    write_c3d(sample, tmp_path / "walk.c3d")
    found = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    point = found["parameters"]["POINT"]
    assert point["LABELS"]["value"] == list(sample.joint_names)
    assert point["UNITS"]["value"] == ["mm"] and found["parameters"]["ANALOG"]["USED"]["value"][0] == 0
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Y"])
    assert found["parameters"]["UPLIFT"]["AXES"]["value"] == ["opensim"]
    np.testing.assert_allclose(point["RATE"]["value"], 29.97, rtol=1e-7)
    np.testing.assert_allclose(found["data"]["points"][:3].transpose(2, 1, 0), sample.points, atol=6.2e-5)
    np.testing.assert_array_equal(found["data"]["meta_points"]["residuals"], 0)


def test_the_error_is_that_of_32_bits(ezc3d, tmp_path: Path) -> None:
    sample = prediction(frames=50)
    sample.pose *= 500 / np.abs(sample.pose).max()
    write_c3d(sample, tmp_path / "walk.c3d")
    points = ezc3d.c3d(str(tmp_path / "walk.c3d"))["data"]["points"][:3].transpose(2, 1, 0)
    assert np.abs(points - sample.pose).max() < 3e-5
    np.testing.assert_array_equal(points, np.float32(sample.pose))


def test_what_is_missing_has_residual_minus_one_and_gaps_are_kept(ezc3d, tmp_path: Path) -> None:
    sample = replace(prediction(frames=4), identity={"frame": np.array([102, 100, 105, 101])})
    sample.pose[1, 3] = np.nan
    sample.pose[2, 4, 2] = np.inf
    write_c3d(sample, tmp_path / "walk.c3d")
    found = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    assert (found["header"]["points"]["first_frame"], found["header"]["points"]["last_frame"]) == (100, 105)
    points = found["data"]["points"][:3].transpose(2, 1, 0)
    expected = np.where(np.isfinite(sample.pose).all(-1, keepdims=True), sample.pose, np.nan)
    np.testing.assert_allclose(points[[2, 0, 5, 1]], expected, rtol=1e-6)
    assert np.isnan(points[3:5]).all()
    residuals = found["data"]["meta_points"]["residuals"][0].T
    np.testing.assert_array_equal(residuals, np.where(np.isnan(points).any(-1), -1, 0))


def test_the_bytes_are_those_of_the_format(ezc3d, tmp_path: Path) -> None:
    sample = walking(3)
    sample.pose[1] = np.nan
    write_c3d(sample, tmp_path / "walk.c3d")
    content = (tmp_path / "walk.c3d").read_bytes()
    joints = len(sample.joint_names)
    _, points, analog, first, last = struct.unpack("<5H", content[:10])
    assert content[1] == 0x50 and (points, analog, first, last) == (joints, 0, 1, 3)
    data = 512 * (struct.unpack("<H", content[16:18])[0] - 1)
    table = np.frombuffer(content[data : data + 16 * 3 * points], "<f4").reshape(3, joints, 4)
    np.testing.assert_allclose(table[[0, 2], :, :3], sample.points[[0, 2]], rtol=1e-6, atol=1e-4)
    np.testing.assert_array_equal(table[1], [[0, 0, 0, -1]] * joints)
    assert b"hip" in content and b"rfoot" in content


def test_each_person_has_a_file(ezc3d, tmp_path: Path) -> None:
    sample = walking(4, individuals=2)
    files = write(sample, tmp_path / "walk.c3d", axes="camera")
    assert [path.name for path in files] == ["walk_clip-1-animal-0.c3d", "walk_clip-1-animal-1.c3d"]
    for number, path in enumerate(files):
        found = ezc3d.c3d(str(path))
        assert found["parameters"]["POINT"]["LABELS"]["value"] == list(sample.joint_names)
        points = found["data"]["points"][:3].transpose(2, 1, 0)
        np.testing.assert_allclose(points, sample.points[4 * number : 4 * number + 4], rtol=1e-6, atol=1e-4)


def test_names_and_many_markers_come_back(ezc3d, tmp_path: Path) -> None:
    names = ("left ear", "tab\there", "line\nbreak", "中", "é" * 100, "", *(f"m{n}" for n in range(300)))
    pose = np.arange(2 * len(names) * 3, dtype=float).reshape(2, -1, 3)
    skeleton = Skeleton("odd", names, names[0], ())
    write_c3d(
        Prediction(pose, pose, "mm", pose[..., :2], pose[..., 0], names, skeleton, fps=30.0), tmp_path / "odd.c3d"
    )
    found = ezc3d.c3d(str(tmp_path / "odd.c3d"))
    point = found["parameters"]["POINT"]
    labels = [*point["LABELS"]["value"], *point["LABELS2"]["value"]]
    assert labels == ["left_ear", "tab_here", "line_break", "中", "é" * 60, "_", *names[6:]]
    np.testing.assert_array_equal(found["data"]["points"][:3].transpose(2, 1, 0), pose)


def test_a_late_clip_whose_numbers_do_not_fit_counts_from_one(ezc3d, tmp_path: Path) -> None:
    sample = replace(prediction(frames=3), identity={"frame": np.arange(65_534, 65_537)})
    write_c3d(sample, tmp_path / "walk.c3d")
    found = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    assert found["header"]["points"]["first_frame"] == 0 and found["data"]["points"].shape[2] == 3


def test_more_frames_than_the_format_counts_are_refused(ezc3d, tmp_path: Path) -> None:
    sample = replace(prediction(frames=3), identity={"frame": np.array([0, 1, 65_535])})
    with pytest.raises(UserError, match="65535 frames, found 65536"):
        write_c3d(sample, tmp_path / "long.c3d")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"unit": "px"}, "C3D holds mm, these poses are in px.*height_mm="),
        ({"fps": None}, "C3D needs the frame rate"),
        ({"identity": {"camera": np.array(["a", "a", "b"])}}, "one clip, found 2: a, b"),
    ],
)
def test_what_a_c3d_cannot_hold_is_refused(ezc3d, change: dict, told: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=told):
        write_c3d(replace(prediction(frames=3), **change), tmp_path / "walk.c3d")
    assert not list(tmp_path.iterdir())


def test_same_poses_give_the_same_bytes(ezc3d, tmp_path: Path) -> None:
    write_c3d(walking(5), tmp_path / "a.c3d")
    write_c3d(walking(5), tmp_path / "B.C3D")
    assert (tmp_path / "a.c3d").read_bytes() == (tmp_path / "B.C3D").read_bytes()


def test_a_full_disk_is_not_taken_for_success(ezc3d, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ezc3d.c3d, "write", lambda _, path: Path(path).write_bytes(b"\x02\x50"))
    with pytest.raises(OSError, match="written completely"):
        write_c3d(walking(5), tmp_path / "walk.c3d")
    assert not list(tmp_path.iterdir())
