"""Plain csv files: joints side by side or one row a joint, in the spellings that people use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_tables import damaged

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.csv import columns_of
from uplift.errors import UserError

JOINTS = ("nose", "left_ear", "tail base")


def written(path: Path, text: str) -> Path:
    path.write_bytes(text.encode())
    return path


def values_of(frames: int = 6, joints: int = 3) -> np.ndarray:
    """Return (frames joints 3) x, y, confidence."""
    return np.random.default_rng(0).uniform(0.1, 0.9, (frames, joints, 3)).astype(np.float32) * [640, 480, 1]


def wide(
    values: np.ndarray, spell: str = "{}_{}", words: tuple[str, ...] = ("x", "y", "confidence"), sep: str = ","
) -> str:
    head = sep.join(["frame", *(spell.format(joint, word) for joint in JOINTS for word in words)])
    rows = [sep.join([str(n), *map(repr, row)]) for n, row in enumerate(values.reshape(len(values), -1).tolist())]
    return "\n".join([head, *rows]) + "\n"


def check(data, values: np.ndarray) -> None:
    assert data.joint_names == JOINTS
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, values[..., 2].astype(np.float32))
    assert data.identity["frame"].tolist() == list(range(len(values)))


@pytest.mark.parametrize("spell", ["{}_{}", "{}.{}", "{} {}", "{}-{}", "{}:{}", "{} ({})", '"{}_{}"'])
@pytest.mark.parametrize("word", ["confidence", "likelihood", "score", "conf", "p"])
def test_spellings_of_columns(tmp_path: Path, spell, word):
    values = values_of()
    path = written(tmp_path / "a.csv", wide(values, spell, ("x", "y", word)))
    assert KEYPOINT_FORMATS.guess(path).name == "csv"
    check(read(path), values)


@pytest.mark.parametrize("sep", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_separators_and_line_ends(tmp_path: Path, sep, end, mark):
    values = values_of()
    text = mark + wide(values, sep=sep).replace("\n", end)
    check(read(written(tmp_path / "a.csv", text)), values)
    check(read(written(tmp_path / "b.csv", text.removesuffix(end))), values)
    check(read(written(tmp_path / "c.csv", text.replace(end, end + end))), values)  # blank lines


def test_prefixes_capitals_and_decimal_commas(tmp_path: Path):
    values = values_of()
    head = "Frame;" + ";".join(f"{word}_{joint}" for joint in JOINTS for word in ("X", "Y", "Likelihood"))
    body = wide(values, sep=";").split("\n", 1)[1].replace(".", ",")
    check(read(written(tmp_path / "a.csv", head + "\n" + body)), values)


@pytest.mark.parametrize("order", ["frames", "joints"])
@pytest.mark.parametrize("head", ["frame,joint,x,y,score", "frame_idx,keypoint,X,Y,Confidence", "Frame,bodypart,x,y,p"])
def test_one_row_a_joint(tmp_path: Path, head, order):
    values = values_of()
    rows = [
        (n, joint, *mark) for n, frame in enumerate(values.tolist()) for joint, mark in zip(JOINTS, frame, strict=True)
    ]
    if order == "joints":
        rows.sort(key=lambda row: (JOINTS.index(row[1]), row[0]))
    text = "\n".join([head, *(",".join(map(str, row)) for row in rows)])
    path = written(tmp_path / "a.csv", text)
    check(read(path), values)


def test_what_is_missing(tmp_path: Path):
    text = "frame,nose_x,nose_y,nose_score,tail_x,tail_y,tail_score\n0,1,2,.5,,,\n1,,,,,,\n2,1,2,0,3,4,NaN\n4,1,,1,3,4,1.2\n"
    data = read(written(tmp_path / "a.csv", text))
    assert data.identity["frame"].tolist() == [0, 4]
    np.testing.assert_array_equal(data.confidence, [[0.5, 0], [0, 1]])
    text = "frame,nose_x,nose_y,tail_x,tail_y\n0,1,2,0,0\n1,0,0,5,6\n2,0,0,0,0\n"
    data = read(written(tmp_path / "b.csv", text))  # no scores: zeros are nowhere
    np.testing.assert_array_equal(data.confidence, [[1, 0], [0, 1]])


def test_what_is_known_beside_the_keypoints(tmp_path: Path):
    text = (
        "subject,video,camera,animal_id,frame,time_ms,image_width,image_height,speed,nose_x,nose_y\n"
        "anna,run,0,m1,3,100,640,480,7,1,2\nanna,run,0,m2,3,100,640,480,7,5,6\n"
        "anna,run,0,m1,4,120,640,480,7,1,2\nanna,run,0,m2,6,160,640,480,7,5,6\n"
    )
    data = read(written(tmp_path / "a.csv", text))
    assert data.identity["instance"].tolist() == ["m1", "m1", "m2", "m2"]  # one after the other
    assert data.identity["frame"].tolist() == [3, 4, 3, 6]
    assert {key: set(data.identity[key]) for key in ("subject", "sequence", "camera")} == {
        "subject": {"anna"}, "sequence": {"run"}, "camera": {"0"}}  # fmt: skip
    assert (data.fps, data.image_size) == (50.0, (640, 480))
    assert "columns left out: speed" in data.notes
    assert "action" not in data.identity


@pytest.mark.parametrize(
    ("times", "fps"), [(("0", "0.04", "0.08"), 25), (("0", "33.3333", "66.6667"), 30), (("0", "1", "9"), None)]
)
def test_times_make_the_rate_where_they_are_even(tmp_path: Path, times, fps):
    text = "timestamp,nose_x,nose_y\n" + "".join(f"{time},1,2\n" for time in times)
    data = read(written(tmp_path / "a.csv", text))
    assert data.fps == (None if fps is None else pytest.approx(fps, rel=1e-4))
    assert data.identity["frame"].tolist() == [0, 1, 2]
    assert any("timestamp" in note for note in data.notes)


def test_times_with_gaps_make_frame_numbers(tmp_path: Path):
    times = [0, 1, 2, 3, 7, *range(8, 40)]
    text = "time_s,nose_x,nose_y\n" + "".join(f"{time / 50},1,2\n" for time in times)
    data = read(written(tmp_path / "a.csv", text))
    assert data.fps == pytest.approx(50, rel=0.2)
    assert data.identity["frame"].tolist() == times


def test_photos_are_no_video(tmp_path: Path):
    data = read(written(tmp_path / "a.csv", "image,nose_x,nose_y\nb.jpg,1,2\na.jpg,3,4\n"))
    assert list(data.identity) == ["image"]
    assert data.identity["image"].tolist() == ["b.jpg", "a.jpg"]


def test_bodies_without_names_are_told_apart(tmp_path: Path):
    rows = [f"{n},{x},{10 + n},{x + 30},{40 + n}" for n in range(5) for x in ((10, 500) if n % 2 else (500, 10))]
    data = read(written(tmp_path / "a.csv", "frame,nose_x,nose_y,tail_x,tail_y\n" + "\n".join(rows)))
    for instance in ("0", "1"):
        assert np.ptp(data.keypoints[data.identity["instance"] == instance, 0, 0]) == 0
    assert any("told apart" in note for note in data.notes)


def test_some_bodies_without_a_track(tmp_path: Path):
    rows = [
        f"{n},{track},{x},{10 + n},{x + 30},{40 + n}"
        for n in range(4)
        for track, x in (("t1", 10), ("", 300), ("", 700))
    ]
    data = read(written(tmp_path / "a.csv", "frame,track,nose_x,nose_y,tail_x,tail_y\n" + "\n".join(rows)))
    assert list(dict.fromkeys(data.identity["instance"])) == ["t1", "untracked 0", "untracked 1"]
    assert [np.ptp(data.keypoints[data.identity["instance"] == who, 0, 0]) for who in ("t1", "untracked 0")] == [0, 0]


def test_frames_that_count_anew_in_each_action_are_clips(tmp_path: Path):
    rows = [f"{action},{n},{n},2" for action in ("walk", "run") for n in range(3)]
    data = read(written(tmp_path / "a.csv", "action,frame,nose_x,nose_y\n" + "\n".join(rows)))
    assert data.identity["sequence"].tolist() == ["a walk"] * 3 + ["a run"] * 3
    assert data.keypoints[:, 0, 0].tolist() == [0, 1, 2, 0, 1, 2]
    assert "instance" not in data.identity


def test_a_file_larger_than_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = written(tmp_path / "a.csv", wide(values_of()))
    monkeypatch.setattr("uplift.data.parsers.files.os.sysconf", lambda name: 10)
    with pytest.raises(UserError, match="more than half of this machine's memory"):
        read(path)


def test_a_folder_is_no_table(tmp_path: Path):
    for name in ("csv", "deeplabcut", "mediapipe", "videopose3d"):
        with pytest.raises(UserError, match=tmp_path.name):
            read(tmp_path, ReadOptions(format=name))


def test_joints_that_are_numbers(tmp_path: Path):
    head = ",".join(f"x{n},y{n},v{n}" for n in range(1, 18))
    row = ",".join(f"{n},{n + 1},{n % 3}" for n in range(1, 18))
    path = written(tmp_path / "a.csv", f"{head}\n{row}\n")
    data = read(path)
    assert data.joint_names[:2] == ("keypoint_0", "keypoint_1")
    assert any("layout=SKELETON" in note for note in data.notes)
    np.testing.assert_array_equal(data.confidence[0, :4], [0.5, 1, 0, 0.5])  # COCO's flags
    assert read(path, ReadOptions(layout="coco17")).joint_names[0] == "nose"
    with pytest.raises(UserError, match="17 keypoints"):
        read(path, ReadOptions(layout="hand21"))


def test_our_own_predictions_are_read_as_what_was_seen(tmp_path: Path):
    head = "frame,unit,fps,nose_x,nose_y,nose_z,nose_u_px,nose_v_px,nose_confidence,nose_spread"
    data = read(written(tmp_path / "a.csv", head + "\n0,mm,50,1,2,3,11,12,0.5,2\n"))
    np.testing.assert_array_equal(data.keypoints[0, 0], [11, 12])
    assert data.confidence[0, 0] == 0.5
    assert data.fps == 50


WRONG = [
    ("frame,nose_x,nose_y\n0,1,2\n1,2", "line 3: 2 cells, expected 3"),
    ("frame,nose_x,nose_y\n0,1,2\n1,2,3,4\n", "line 3: 4 cells, expected 3"),
    ("frame,nose_x,nose_y\n0,1,2\n\n1,2,z\n", "line 4: 'z' in the column 'nose_y' is not a number"),
    ("frame,nose_x,nose_y,nose_x\n0,1,2,3\n", "the column 'nose_x' is there twice"),
    ("frame,nose_x,nose_y,nose_z\n0,1,2,3\n", "x, y and z: 3D points"),
    ("frame,nose_x,nose_y\n-1,1,2\n", "-1 is not a frame number"),
    ("frame,nose_x,nose_y\n1e17,1,2\n", "is not a frame number"),
    ("frame,nose_x,nose_y\n0,inf,2\n", "'inf' in the column 'nose_x' is not a number"),
    ("frame,nose_x,nose_y\n0,1e300,2\n", "expected pixels within an image"),
    ("frame,nose_x,nose_y,nose_score\n0,1,2,870\n", "confidence goes from 0 to 870"),
    ("frame,id,nose_x,nose_y\n0,a,1,2\n0,a,3,4\n", "'a' is in frame 0 twice"),
    ("frame,joint,x,y\n0,a,1,2\n0,a,3,4\n", "line 3: 'a' of frame 0 is there twice (first on line 2)"),
    ("frame,joint,x,y\n0,a,1,2\n0,,3,4\n", "line 3: no name of a joint"),
    ("frame,joint,x,y,z\n0,a,1,2,3\n", "3D points"),
    ("frame,nose_x,nose_y\n", "no row below the header"),
    ('frame,nose_x,nose_y\n0,"1,2\n', "quotation that does not end"),
    ("image_width,image_height,nose_x,nose_y\n0,0,1,2\n", "expected one number"),
]


@pytest.mark.parametrize(("text", "says"), WRONG, ids=range(len(WRONG)))
def test_wrong_tables_are_told(tmp_path: Path, text, says):
    path = written(tmp_path / "a.csv", text)
    with pytest.raises(UserError) as caught:
        read(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "x,y\n1,2\n", "hello\n", "1,2,3\n4,5,6\n", "frame,x,y\n0,1,2\n", "\n\n\n", "nose_x\n1\n"]
)
def test_other_tables_are_of_no_known_format(tmp_path: Path, text):
    with pytest.raises(UserError, match="not in a known format"):
        read(written(tmp_path / "a.csv", text))
    with pytest.raises(UserError, match="a.csv"):
        read(written(tmp_path / "a.csv", text), ReadOptions(format="csv"))


@pytest.mark.parametrize("form", ["wide", "long"])
def test_a_damaged_file_is_refused_or_read_in_full(tmp_path: Path, form):
    text = wide(values_of(4))
    if form == "long":
        text = "frame,id,joint,x,y,p\n" + "".join(f"{n},a,{j},{n + 0.5},2,0.7\n" for n in range(9) for j in JOINTS)
    for content in damaged(text.encode(), 4, 60):
        (tmp_path / "a.csv").write_bytes(content)
        try:
            data = read(tmp_path / "a.csv")
        except UserError as error:
            assert "a.csv" in str(error)
        else:
            assert np.isfinite(data.keypoints[data.confidence > 0]).all()


def test_joints_keep_their_names():
    for name in ("x", "foo_x", "left x", "a.b", "frame", "id_x"):
        found = columns_of(["frame", f"{name}_x", f"{name}_y", f"{name}_confidence"])
        assert found is not None
        assert list(found.joints) == [name]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_large_tables_are_read_in_full(tmp_path: Path, end):
    values = values_of(5000)
    check(read(written(tmp_path / "a.csv", wide(values).replace("\n", end))), values)
    comma = wide(values, sep=";").replace(".", ",")
    check(read(written(tmp_path / "b.csv", comma.replace("\n", end))), values)


def test_words_for_missing_numbers_and_spaces_around_numbers(tmp_path: Path):
    text = "frame,id,nose_x,nose_y\n0,NA,1, 2\n1,NA, 3 ,N/a\n2,NA,5 ,6\n"
    data = read(written(tmp_path / "a.csv", text))
    assert data.identity["instance"].tolist() == ["NA", "NA"]
    assert data.identity["frame"].tolist() == [0, 2]
    np.testing.assert_array_equal(data.keypoints[:, 0], [[1, 2], [5, 6]])


def test_words_in_windows_western_code(tmp_path: Path):
    (tmp_path / "a.csv").write_bytes("frame,id,nez_x,nez_y\n0,Zoé,1,2\n1,Zoé,3,4\n".encode("cp1252"))
    assert set(read(tmp_path / "a.csv").identity["instance"]) == {"Zoé"}
