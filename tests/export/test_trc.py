"""The TRC writer, read back by a parser of its own and laid beside a file of Pose2Sim's."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from writers_samples import prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.markers import marker_names, write_trc
from uplift.export.scene import in_axes
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

FACTS = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames")  # fmt: skip


@dataclass
class Trc:
    facts: dict[str, str]
    markers: list[str]
    frame: np.ndarray
    time: np.ndarray
    points: np.ndarray


def cells(line: str) -> list[str]:
    """Return the cells as OpenSim cuts a line: what follows the last tab is a cell only where it is something."""
    found = line.split("\t")
    return found if found[-1] else found[:-1]


def read(path: Path) -> Trc:
    """Return what a TRC holds; every rule that OpenSim checks is an assertion."""
    lines = path.read_bytes().decode().split("\n")
    assert lines.pop() == ""
    kind = lines[0].split("\t")
    assert kind[:3] == ["PathFileType", "4", "(X/Y/Z)"] and len(kind) == 4
    assert tuple(lines[1].split("\t")) == FACTS
    facts: dict[str, str] = dict(zip(FACTS, lines[2].split("\t"), strict=True))
    count = int(facts["NumMarkers"])
    labels = [cell for cell in lines[3].split("\t") if cell]
    assert labels[:2] == ["Frame#", "Time"] and len(labels) == count + 2
    axes = [cell for cell in lines[4].split("\t") if cell]
    assert axes == [f"{letter}{n + 1}" for n in range(count) for letter in "XYZ"]
    rows = [cells(line) for line in lines[5:] if line]
    assert len(rows) == int(facts["NumFrames"]) and all(len(row) == 2 + 3 * count for row in rows)
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    return Trc(facts, labels[2:], table[:, 0], table[:, 1], table[:, 2:].reshape(len(rows), count, 3))


def test_markers_come_back(tmp_path: Path) -> None:
    sample = in_axes(replace(prediction(frames=9), root=np.linspace([0, 0, 3000], [900, 0, 4000], 9)), "opensim")
    write_trc(sample, tmp_path / "walk.trc")
    found = read(tmp_path / "walk.trc")
    assert found.markers == list(sample.joint_names)
    np.testing.assert_allclose(found.points, sample.points, atol=6e-6)
    np.testing.assert_array_equal(found.frame, np.arange(1, 10))
    np.testing.assert_allclose(found.time, np.arange(9) / 30, atol=1e-6)
    assert found.facts == {
        "DataRate": "30", "CameraRate": "30", "NumFrames": "9", "NumMarkers": "7", "Units": "mm",
        "OrigDataRate": "30", "OrigDataStartFrame": "1", "OrigNumFrames": "9",
    }  # fmt: skip


def test_the_header_is_laid_out_as_in_a_file_of_pose2sim(benchmark_data: Callable[[str], Path], tmp_path: Path) -> None:
    real = benchmark_data("trackers/trc/S00_P00_T01_BalancingTrial_0-100.trc")
    theirs = read(real)
    np.testing.assert_allclose(theirs.points[0, 0], (-0.06497214796810755, 0.9015045550714222, -1.4005886926185436))
    names = tuple(theirs.markers)
    pose = theirs.points - theirs.points[:, :1]
    sample = Prediction(
        pose * 1000, pose * 1000, "mm", pose[..., :2], np.ones(pose.shape[:2]), names,
        Skeleton("pose2sim", names, names[0], ()), fps=60.0, root=theirs.points[:, 0] * 1000,
    )  # fmt: skip
    write_trc(sample, tmp_path / real.name)
    ours = read(tmp_path / real.name)
    np.testing.assert_allclose(ours.points, theirs.points * 1000, atol=6e-6)
    lines, other = ((path.read_text().split("\n")) for path in (tmp_path / real.name, real))
    assert lines[:2] == other[:2]
    assert lines[2].replace("\tmm\t", "\tm\t").split("\t")[:6] == other[2].split("\t")[:6]
    assert [line.rstrip("\t") for line in lines[3:5]] == [line.rstrip("\t") for line in other[3:5]]


def test_pandas_reads_it_as_it_reads_pose2sims(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    sample = prediction(frames=4)
    sample.pose[1], sample.pose[2, -1] = np.nan, np.nan
    write_trc(sample, tmp_path / "walk.trc")
    table = pandas.read_csv(tmp_path / "walk.trc", sep="\t", skiprows=4)
    numbers = table.iloc[:, 2:].loc[:, lambda t: ~t.columns.str.startswith("Unnamed")].to_numpy(float)
    np.testing.assert_allclose(numbers.reshape(4, -1, 3), sample.pose, atol=6e-6)


def test_what_is_missing_is_blank_and_gaps_keep_the_time(tmp_path: Path) -> None:
    sample = replace(prediction(frames=4), fps=29.97, identity={"frame": np.array([102, 100, 105, 101])})
    sample.pose[1, 3] = np.nan
    sample.pose[2, 4, 2] = np.inf
    sample.pose[3, -1] = np.nan
    write_trc(sample, tmp_path / "walk.trc")
    found = read(tmp_path / "walk.trc")
    np.testing.assert_array_equal(found.frame, np.arange(101, 107))
    np.testing.assert_allclose(found.time, np.arange(100, 106) / 29.97, atol=1e-6)
    assert found.facts["DataRate"] == "29.97" and found.facts["OrigDataStartFrame"] == "101"
    expected = np.where(np.isfinite(sample.pose).all(-1, keepdims=True), sample.pose, np.nan)
    np.testing.assert_allclose(found.points[[2, 0, 5, 1]], expected, atol=6e-6)
    assert np.isnan(found.points[3:5]).all()
    text = (tmp_path / "walk.trc").read_text()
    assert not re.search("nan|inf", text) and re.search(r"^104\t3\.4[0-9]+\t+$", text, re.MULTILINE)


def test_a_thinned_out_film_has_no_blanks(tmp_path: Path) -> None:
    sample = replace(prediction(frames=4), fps=10.0, identity={"frame": np.array([50, 55, 65, 60])})
    write_trc(sample, tmp_path / "walk.trc")
    found = read(tmp_path / "walk.trc")
    np.testing.assert_array_equal(found.frame, [11, 12, 13, 14])
    np.testing.assert_allclose(found.time, [1, 1.1, 1.2, 1.3])
    np.testing.assert_allclose(found.points, sample.pose[[0, 1, 3, 2]], atol=6e-6)


def people(rows: list[tuple[str, int]]) -> Prediction:
    """Return a prediction of who is seen in which frame of one video, at 30 frames a second."""
    sample = prediction(frames=len(rows))
    who, frames = np.array([one for one, _ in rows]), np.array([frame for _, frame in rows])
    identity = {"sequence": np.full(len(rows), "walk"), "instance": who, "frame": frames}
    return replace(sample, identity=identity)


def test_each_person_has_a_file_in_the_time_of_the_video(tmp_path: Path) -> None:
    """Anna is seen in every second frame, and Ben later: no frame of theirs is nearer or farther than the video has it."""
    rows = [
        ("Anna", 1),
        ("Anna", 3),
        ("Anna", 7),
        *(("Ben", frame) for frame in (2, 3, 4)),
        *(("Eve", f) for f in range(9)),
    ]
    sample = people(rows)
    files = write(sample, tmp_path / "poses.trc", axes="camera")
    assert [path.name for path in files] == [f"poses_walk-{who}.trc" for who in ("Anna", "Ben", "Eve")]
    for path, who, frames in zip(files, ("Anna", "Ben", "Eve"), ([1, 3, 7], [2, 3, 4], list(range(9))), strict=True):
        found = read(path)
        assert found.markers == list(sample.joint_names)
        np.testing.assert_array_equal(found.frame, np.arange(frames[0], frames[-1] + 1) + 1)
        np.testing.assert_allclose(found.time, np.arange(frames[0], frames[-1] + 1) / 30, atol=1e-6)
        seen = np.isfinite(found.points).all((1, 2))
        assert (np.flatnonzero(seen) + frames[0]).tolist() == frames
        mine = sample.identity["instance"] == who
        np.testing.assert_allclose(found.points[seen], sample.pose[mine], atol=6e-6)
    write(sample, tmp_path / "poses.bvh", axes="camera")
    text = (tmp_path / "poses_walk-Anna.bvh").read_text()
    assert "Frames: 7\n" in text and f"Frame Time: {1 / 30:.8f}" in text
    with pytest.raises(UserError, match="holds one individual, found 3: Anna, Ben, Eve"):
        write_trc(sample, tmp_path / "all.trc")
    with pytest.raises(UserError, match="of 'Bob' was asked for, found 3: Anna, Ben, Eve"):
        write_trc(sample, tmp_path / "bob.trc", "Bob")


def test_a_ghost_of_one_frame_has_no_file_and_is_named(tmp_path: Path) -> None:
    rows = [("1", 0), ("1", 1), ("2", 1), ("3", 0), ("3", 1), ("4", 0), ("4", 1)]
    sample = people(rows)
    sample.pose[4] = sample.pose[5:] = np.nan  # the third is lifted in one frame, the fourth in none
    for name in ("poses.trc", "poses.c3d", "poses.bvh"):
        files = write(sample, tmp_path / name)
        assert list(files) == [tmp_path / name]
        assert "no file for 3 bodies that are in one frame of a clip alone (2, 3, 4)" in files[tmp_path / name]
    photo = people([("1", 0), ("2", 0)])
    assert len(write(photo, tmp_path / "photo.trc")) == 2  # all of a photo's people are in one frame


@given(
    names=st.lists(
        st.text(st.sampled_from("ab\t\n\r\v\x1c\x85\u2028 _é中\x00nan"), min_size=1), min_size=1, unique=True
    ),
    file=st.text(st.sampled_from("a\t\n é"), min_size=1, max_size=5),
)
def test_no_name_breaks_the_table(names: list[str], file: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("trc")
    skeleton = Skeleton("odd", tuple(names), names[0], ())
    pose = np.arange(2 * len(names) * 3, dtype=float).reshape(2, len(names), 3)
    odd = Prediction(pose, pose, "mm", pose[..., :2], pose[..., 0], tuple(names), skeleton, fps=30.0)
    write_trc(odd, folder / f"{file}.trc")
    found = read(folder / f"{file}.trc")
    assert len((folder / f"{file}.trc").read_text().splitlines()) == 8
    assert len(set(found.markers)) == len(names)
    np.testing.assert_array_equal(found.points, pose)


@given(st.lists(st.text(st.characters(codec=None), max_size=200)))
def test_marker_names_are_short_different_and_without_white_space(names: list[str]) -> None:
    given = marker_names(names)
    assert len(set(given)) == len(names)
    assert all(name and not re.search(r"\s", name) and len(name.encode()) <= 127 for name in given)
    plain = ["hip", "lknee", "中"]
    assert marker_names(plain) == tuple(plain) == marker_names(marker_names(plain))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"unit": "px"}, "these poses are in px.*height_mm="),
        ({"unit": "relative"}, "in relative"),
        ({"fps": None}, "frame rate, which is not known.*fps=30"),
        ({"fps": 0.0}, "frame rate, which is 0"),
        ({"identity": {"sequence": np.array(["a", "a", "b"])}}, "one clip, found 2: a, b"),
        ({"identity": {"frame": np.array([4, 5, 5])}}, "2 rows are frame 5. Expected one"),
        ({"identity": {"frame": np.array([4, 4, 5]), "instance": np.array(["x", "x", "x"])}}, "are frame 4 of 'x'"),
        ({"identity": {"frame": np.array([0, 1, 10**9])}}, "3 frames are numbered 0 to 1000000000"),
    ],
)
def test_what_a_trc_cannot_hold_is_refused(change: dict, told: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=told):
        write_trc(replace(prediction(frames=3), **change), tmp_path / "walk.trc")
    assert not list(tmp_path.iterdir())


def test_no_frames_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the prediction is empty"):
        write_trc(prediction(frames=3).select(np.zeros(3, bool)), tmp_path / "walk.trc")


def test_same_poses_give_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_trc(prediction(frames=5), tmp_path / folder / "walk.trc")
    assert (tmp_path / "a/walk.trc").read_bytes() == (tmp_path / "b/walk.trc").read_bytes()
