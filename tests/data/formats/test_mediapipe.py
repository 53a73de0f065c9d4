"""Landmarks of MediaPipe in the files that scripts keep them in: the same numbers, whatever stands around them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tracker_files_tables import POSE33, damaged, mediapipe_long, mediapipe_marks, mediapipe_wide, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.parsers.json import JsonText
from uplift.errors import UserError
from uplift.skeleton import load_skeleton
from uplift.skeleton.match import match_joints

SIZE = ReadOptions(image_size=(640, 480))
LOWER = tuple(name.lower() for name in POSE33)


def landmarks(frames: int = 7, count: int = 33) -> np.ndarray:
    """Return (frames landmarks 4) x, y, z, visibility."""
    return np.random.default_rng(0).uniform(0.05, 0.95, (frames, count, 4))


def variants(place: Path, values: np.ndarray) -> dict[str, Path]:
    """Return the same landmarks in every layout."""
    marks = mediapipe_marks(values)
    place.mkdir(exist_ok=True)
    named = [dict(zip(POSE33, frame, strict=True)) for frame in marks]
    found = {
        "long": mediapipe_long(place / "long.csv", values),
        "long_by_id": mediapipe_long(place / "id.csv", values, "frame,id,x,y,z,visibility"),
        "wide": mediapipe_wide(place / "wide.csv", values, named=True),
        "numbered": mediapipe_wide(place / "numbered.csv", values, named=False),
        "list": write_json(place / "list.json", marks),
        "tasks": write_json(
            place / "tasks.json", [{"pose_landmarks": [f], "pose_world_landmarks": [f]} for f in marks]
        ),
        "message": write_json(place / "message.json", [{"poseLandmarks": {"landmark": f}} for f in marks]),
        "frames": write_json(place / "f.json", {"frames": [{"frame": n, "landmarks": f} for n, f in enumerate(marks)]}),
        "by_number": write_json(place / "number.json", {str(n): f for n, f in enumerate(marks)}),
        "by_name": write_json(place / "name.json", [{"landmarks": f} for f in named]),
        "rows": write_json(place / "rows.json", {"landmarks": values.tolist()}),
        "flat": write_json(place / "flat.json", [{"landmarks": f.ravel().tolist()} for f in values]),
    }
    text = found["long_by_id"].read_text()
    for number, name in sorted(enumerate(POSE33), key=lambda one: -len(one[1])):
        text = text.replace(f",{name},", f",{number},")
    found["long_by_id"].write_text(text)
    np.savez(place / "a.npz", landmarks=values)
    np.savez(place / "b.npz", pose_landmarks=values.reshape(len(values), -1), pose_world_landmarks=values - 0.5)
    return found | {"npz": place / "a.npz", "npz_flat": place / "b.npz"}


LAYOUTS = (
    "long", "long_by_id", "wide", "numbered", "list", "tasks", "message", "frames", "by_number", "by_name", "rows",
    "flat", "npz", "npz_flat",
)  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same(tmp_path: Path, layout):
    values = landmarks()
    path = variants(tmp_path, values)[layout]
    assert KEYPOINT_FORMATS.guess(path).name == "mediapipe"
    data = read(path, SIZE)
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32) * np.float32([640, 480]))
    np.testing.assert_array_equal(data.confidence, values[..., 3].astype(np.float32))
    assert tuple(name.lower() for name in data.joint_names) == LOWER
    assert data.identity["frame"].tolist() == list(range(7))
    assert data.image_size == (640, 480)
    assert any("z of MediaPipe is left out" in note for note in data.notes)
    assert not match_joints(data.joint_names, load_skeleton("mediapipe33")).missing


def test_a_blank_first_line_is_no_header(tmp_path: Path):
    path = variants(tmp_path, landmarks())["long"]
    path.write_text("\n" + path.read_text())
    assert KEYPOINT_FORMATS.guess(path).name == "mediapipe" and len(read(path, SIZE)) == 7
    path.write_text("\nframe,joint,x,y,confidence\n\n0,nose,1,2,0.5\n")  # another's
    assert KEYPOINT_FORMATS.guess(path).name != "mediapipe"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_without_a_size_shares_stay_and_a_note_says_so(tmp_path: Path, layout):
    values = landmarks()
    data = read(variants(tmp_path, values)[layout])
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    assert any("say image_size=WIDTHxHEIGHT" in note for note in data.notes)


def test_the_real_file_is_of_the_world(benchmark_data):
    data = read(benchmark_data("trackers/mediapipe/landmarks.csv"))
    assert data.keypoints.shape == (340, 33, 2)
    assert (data.joint_names[0], data.joint_names[-1]) == ("NOSE", "RIGHT_FOOT_INDEX")
    np.testing.assert_array_equal(data.keypoints[0, 0], np.float32([-0.023920254781842232, -0.6285610198974609]))
    np.testing.assert_array_equal(data.keypoints[-1, -1], np.float32([-0.19440299272537231, 0.8731479048728943]))
    assert data.identity["frame"][-1] == 339
    assert (data.confidence == 1).all()
    assert any("world landmarks, in metres" in note for note in data.notes)
    sized = read(benchmark_data("trackers/mediapipe/landmarks.csv"), SIZE)
    np.testing.assert_array_equal(sized.keypoints, data.keypoints)  # metres are no shares of an image


def test_frames_of_the_world_only(tmp_path: Path):
    marks = mediapipe_marks(landmarks())
    data = read(write_json(tmp_path / "a.json", {"fps": 30, "pose_world_landmarks": marks}))
    assert data.identity["frame"].tolist() == list(range(7))
    both = read(write_json(tmp_path / "b.json", {"pose_world_landmarks": marks[::-1], "pose_landmarks": marks}))
    np.testing.assert_array_equal(both.keypoints, data.keypoints)


def test_pixels_stay_pixels(tmp_path: Path):
    values = landmarks() * [640, 480, 1, 1]
    data = read(mediapipe_wide(tmp_path / "a.csv", values, named=True), SIZE)
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    assert any("taken as pixels" in note for note in data.notes)


def test_what_the_json_says_of_the_video(tmp_path: Path):
    values = landmarks()
    content = {"fps": 25, "width": 100, "height": 50, "frames": mediapipe_marks(values)}
    data = read(write_json(tmp_path / "a.json", content))
    assert (data.fps, data.image_size) == (25, (100, 50))
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32) * np.float32([100, 50]))


def test_frames_without_anybody_give_no_row(tmp_path: Path):
    marks = mediapipe_marks(landmarks(4))
    data = read(write_json(tmp_path / "a.json", [{"landmarks": m} for m in (marks[0], None, [], marks[3])]))
    assert data.identity["frame"].tolist() == [0, 3]
    zeros = landmarks(4)
    zeros[2] = 0
    assert read(mediapipe_wide(tmp_path / "a.csv", zeros, named=False)).identity["frame"].tolist() == [0, 1, 3]


@pytest.mark.parametrize("kind", ["json", "npz"])
def test_several_bodies_are_told_apart_by_place(tmp_path: Path, kind):
    values = landmarks(6) * [0.2, 0.2, 1, 1]
    both = np.stack([values, values + [0.7, 0.7, 0, 0]], 1)
    both[3:] = both[3:, ::-1]  # the order of the file changes, the bodies stay where they are
    if kind == "json":
        path = write_json(tmp_path / "a.json", [mediapipe_marks(bodies) for bodies in both])
    else:
        path = tmp_path / "a.npz"
        np.savez(path, landmarks=both)
    data = read(path)
    assert set(data.identity["instance"]) == {"0", "1"}
    for instance in "01":
        x = data.keypoints[data.identity["instance"] == instance, :, 0].mean(1)
        assert len(x) == 6
        assert np.ptp(x) < 0.3


def test_hands_and_faces_have_no_visibility(tmp_path: Path):
    values = landmarks(3, 21)
    values[..., 3] = 0
    data = read(write_json(tmp_path / "a.json", mediapipe_marks(values)))
    assert (data.confidence == 1).all()
    assert not match_joints(data.joint_names, load_skeleton("hand21")).missing
    holistic = landmarks(3, 501)
    holistic[:, 33:, 3] = 0
    data = read(mediapipe_wide(tmp_path / "a.csv", holistic, named=False))
    assert data.joint_names[:33] == LOWER
    assert (data.confidence[:, 33:] == 1).all()
    np.testing.assert_array_equal(data.confidence[:, :33], holistic[:, :33, 3].astype(np.float32))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([{"landmarks": [{"x": "a", "y": 1}]}], "landmark '0' is {'x': 'a', 'y': 1}"),
        ([{"landmarks": [{"x": 1, "y": float("inf")}]}], "expected numbers x and y"),
        ([{"landmarks": [{"x": 1, "y": 2}]}, {"landmarks": [{"x": 1, "y": 2}] * 2}], "2 landmarks, expected the 1"),
        ([{"landmarks": "x"}], "expected landmarks"),
        ([{"landmarks": None}], "no landmarks in it"),
        ([{"landmarks": [{"x": 1, "y": 2}], "frame": -4}], "-4 is not a frame number"),
        ([{"landmarks": [{"x": 1e300, "y": 2}]}], "expected pixels"),
        ([{"landmarks": [[[[[[[[[[1]]]]]]]]]]}], "deeper than any landmarks"),
        ({"landmarks": []}, "no landmarks in it"),
    ],
)
def test_wrong_json_is_told(tmp_path: Path, content, says):
    path = write_json(tmp_path / "a.json", content)
    with pytest.raises(UserError, match="a.json") as caught:
        read(path, ReadOptions(format="mediapipe"))
    assert says in str(caught.value)


def test_a_landmark_twice_in_a_frame_is_told(tmp_path: Path):
    path = mediapipe_long(tmp_path / "a.csv", landmarks(3))
    path.write_text(path.read_text() + "2,NOSE,0.1,0.1,0,1\n")
    with pytest.raises(UserError, match="line 101: 'NOSE' of frame 2 is there twice"):
        read(path)


def test_lists_in_lists_do_not_overflow(tmp_path: Path):
    path = tmp_path / "a.json"
    path.write_text('{"landmarks":' + "[" * 100_000)
    with pytest.raises(UserError, match="a.json"):
        read(path)


@pytest.mark.parametrize("layout", ["long", "wide", "tasks", "by_number", "npz"])
def test_a_damaged_file_is_refused_or_read_in_full(tmp_path: Path, layout):
    path = variants(tmp_path, landmarks(2))[layout]
    for content in damaged(path.read_bytes(), 2, 20):
        path.write_bytes(content)
        try:
            data = read(path)
        except UserError as error:
            assert path.name in str(error)
        else:
            assert np.isfinite(data.keypoints[data.confidence > 0]).all()


def test_json_of_others_is_not_claimed(tmp_path: Path):
    for number, content in enumerate(([1, 2], {"a": {"b": 1}}, [{"keypoints": [1, 2, 3]}], {"shapes": []})):
        path = tmp_path / f"{number}.json"
        path.write_text(json.dumps(content))
        with pytest.raises(UserError):
            read(path)


@pytest.mark.parametrize("odd", [5, "a", [1], {"x": 1.0, "y": True, "visibility": 0.5}])
def test_a_landmark_that_is_none_is_told_wherever_it_stands(tmp_path, odd):
    marks = mediapipe_marks(np.random.default_rng(0).random((3, 33, 4)))
    marks[1][20] = odd
    with pytest.raises(UserError, match=r"frame 1 of the file: landmark '20'"):
        read(write_json(tmp_path / "odd.json", marks))


def test_landmarks_of_all_kinds_of_numbers_are_read_alike(tmp_path):
    values = np.random.default_rng(0).random((3, 33, 4))
    marks = mediapipe_marks(values)
    whole = read(write_json(tmp_path / "film.json", marks))
    marks[0][4]["x"], marks[1][5]["y"], marks[2][6]["visibility"] = None, 2, 1
    del marks[2][7]["visibility"]
    some = read(write_json(tmp_path / "film.json", marks))
    changed = (some.keypoints != whole.keypoints).any(-1) | (some.confidence != whole.confidence)
    assert sorted(map(tuple, np.argwhere(changed).tolist())) == [(0, 4), (1, 5), (2, 6), (2, 7)]
    assert some.confidence[0, 4] == 0 and some.confidence[2, 6] == 1


def test_frames_are_taken_one_at_a_time(tmp_path, monkeypatch):
    path = write_json(tmp_path / "film.json", mediapipe_marks(np.random.default_rng(0).random((5, 33, 4))))
    monkeypatch.setattr(JsonText, "value", lambda _: pytest.fail("all of it at once"))
    assert len(read(path)) == 5
