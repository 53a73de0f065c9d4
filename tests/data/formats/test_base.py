"""The first look at a file, what the user says of it, and refusals of what holds no keypoints."""

from __future__ import annotations

import gzip
import json
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import Peek, ReadOptions, size_of
from uplift.data.load import load_file
from uplift.data.parsers.json import load_json
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

TABLE = "frame,head_x,head_y,head_confidence,tail_x,tail_y,tail_confidence,leg_x,leg_y,leg_confidence\n"


def table(path: Path, rows: int = 4) -> Path:
    path.write_text(TABLE + "".join(f"{n},{n},2,0.9,3,{n}.5,0.4,5,6,1\n" for n in range(rows)))
    return path


def test_every_format_is_what_its_name_says():
    for name in KEYPOINT_FORMATS:
        assert KEYPOINT_FORMATS[name].name == name
        assert KEYPOINT_FORMATS[name].title


def test_what_the_user_says_wins(tmp_path: Path):
    path = table(tmp_path / "a.csv")
    plain = read(path)
    assert "format=csv" in plain.notes[0] and plain.fps is None
    told = read(path, ReadOptions(format="csv", fps=25.0, image_size=(640, 480), focal_px=700.0, min_confidence=0.5))
    assert (told.fps, told.image_size, told.focal_px) == (25.0, (640, 480), 700.0)
    assert "guessed" not in told.notes[0] and "4 keypoints of confidence below 0.5" in told.notes[-1]
    tail = told.joint_names.index("tail")
    assert (told.confidence[:, tail] == 0).all() and (plain.confidence[:, tail] > 0).all()


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ('{"a": {"b": 1}, "c": [{"d": 2}]}', ("a", "c")),
        ('[{"a": 1, "b": {"c": 2}}, {"d": 3}]', ("a", "b")),
        ('  {"quo\\"te": 1', ('quo"te',)),
        ("[1, 2]", ()),
        ("[", ()),
        ("plain", ()),
    ],
)
def test_keys_of_json_that_may_go_on(tmp_path: Path, text: str, keys: tuple[str, ...]):
    (tmp_path / "a.json").write_text(text)
    assert Peek(tmp_path / "a.json").json_keys == keys


@pytest.mark.parametrize("text", ["1920x1080", "1920, 1080", "[1920,1080]", " (1920 x 1080) "])
def test_image_sizes(text: str):
    assert size_of(text) == (1920, 1080)


@pytest.mark.parametrize("text", ["1920", "0x100", "axb", "-4x3", "1e3x2"])
def test_no_image_sizes(text: str):
    with pytest.raises(UserError, match="1920x1080"):
        size_of(text)


def test_what_holds_no_keypoints(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    several = tmp_path / "several"
    several.mkdir()
    table(several / "a.csv")
    table(several / "b.csv")
    files = {
        "a.mp4": b"\0\0\0 ftyp",
        "a.trc": b"PathFileType\t4",
        "a.bin": b"\x01\x02",
        "nothing.csv": b"",
        "a.h5": b"\x89HDF\r\n\x1a\nxx",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    says = {
        "empty": "an empty folder", "several": r"such as .*several/\*\.csv", "a.mp4": "a video", "a.trc": "3D marker data",
        "a.bin": "not in a known format", "nothing.csv": "0 bytes", "a.h5": "damaged", "none.csv": "No file",
    }  # fmt: skip
    for name, text in says.items():
        with pytest.raises(UserError, match=text):
            KEYPOINT_FORMATS.guess(tmp_path / name)
    with pytest.raises(UserError, match="Did you mean 'deeplabcut'"):
        read(table(tmp_path / "a.csv"), ReadOptions(format="deplabcut"))


def test_two_keypoints_are_too_few(tmp_path: Path):
    (tmp_path / "a.csv").write_text("frame,head_x,head_y,tail_x,tail_y\n0,1,2,3,4\n")
    assert read(tmp_path / "a.csv").keypoints.shape == (1, 2, 2)
    with pytest.raises(UserError, match=r"holds 2 keypoints \(head, tail\)"):
        load_file(tmp_path / "a.csv", load_skeleton("h36m17"))


def test_files_of_two_points_are_refused_with_the_reason(benchmark_data):
    for name in ("sleap/clip.2node.slp", "deeplabcut/DLC_sample_poses.csv", "nwb/minimal.pose.nwb"):
        path = benchmark_data(f"trackers/{name}")
        assert np.isfinite(read(path).keypoints[read(path).confidence > 0]).all()
        with pytest.raises(UserError, match="holds 2 keypoints"):
            load_file(path, load_skeleton("rat23"))


def _npy(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros((3, 2, 2)))


def _mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"keypoints": np.zeros((3, 4))})


def _xlsx(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("[Content_Types].xml", "_rels/.rels", "xl/workbook.xml", "xl/worksheets/sheet1.xml"):
            archive.writestr(name, "<x/>")


@pytest.mark.parametrize(
    ("write", "what", "how"),
    [
        (_npy, "a bare NumPy array", "np.savez"),
        (lambda path: path.write_bytes(pickle.dumps({"keypoints": np.zeros(3)})), "a Python pickle", "np.savez"),
        (_mat, "a MATLAB file", "writetable"),
        (_xlsx, "an Excel file", "as CSV"),
        (lambda path: pd.DataFrame({"x": [1.5]}).to_json(path, orient="records", lines=True), None, None),
        (lambda path: path.write_text('{"x": 1}\n\n{"x": 2}\n'), "several JSON values", "jq -s"),
        (lambda path: path.write_text('[{"x": 1}]\n[{"x": 2}]\n'), "several JSON values", "jq -s"),
        (lambda path: path.write_bytes(gzip.compress(b"a,b\n1,2\n")), "compressed", "Unpack"),
        (lambda path: path.write_bytes("frame,nose_x,nose_y\n0,1,2\n".encode("utf-16-le")), "text in UTF-16", "UTF-8"),
        (
            lambda path: path.write_bytes("frame,nose_x,nose_y\n0,1,2\n".encode("utf-32")),
            "text in UTF-16 or UTF-32",
            "UTF-8",
        ),
        (lambda path: path.write_text("<?xml version='1.0'?><annotations/>"), "XML", "COCO"),
        (lambda path: path.write_text("\n<!DOCTYPE html><html>"), "a web page", "link"),
        (
            lambda path: path.write_text("version https://git-lfs.github.com/spec/v1\noid"),
            "a pointer of Git LFS",
            "git lfs pull",
        ),
    ],
)
def test_what_is_not_read_says_what_it_is_and_what_to_do(tmp_path: Path, write, what, how):
    """Whatever the ending of its name; a list of formats helps nobody here."""
    write(tmp_path / "a.data")
    with pytest.raises(UserError) as caught:
        read(tmp_path / "a.data")
    said = str(caught.value)
    if what is None:  # one value is JSON, of no known format
        assert "its keys: x" in said
    else:
        assert said.startswith(f"{tmp_path / 'a.data'} is {what}") and how in said and "Known formats" not in said


def test_json_lines_of_a_known_format_are_told_too(tmp_path: Path):
    frame = '{"version": 1.3, "people": [{"pose_keypoints_2d": [' + ", ".join(["1"] * 75) + "]}]}\n"
    (tmp_path / "a.json").write_text(frame * 2)
    with pytest.raises(UserError, match="JSON lines hold one value a line.*jq -s"):
        read(tmp_path / "a.json")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
@pytest.mark.parametrize("separator", [",", "\t"])
def test_text_in_utf_16_is_read(tmp_path: Path, encoding: str, separator: str):
    """As Excel saves Unicode text, and PowerShell what is sent to a file."""
    text = TABLE + "".join(f"{n},{n},2,0.9,3,{n}.5,0.4,5,6,1\n" for n in range(3))
    text = text.replace("tail", "Schwänzchen").replace(",", separator)
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    (tmp_path / "a.csv").write_bytes((mark + text).encode(encoding))
    (tmp_path / "b.csv").write_text(text, encoding="utf-8")
    data, plain = read(tmp_path / "a.csv"), read(tmp_path / "b.csv")
    np.testing.assert_array_equal(data.keypoints, plain.keypoints)
    assert data.joint_names == plain.joint_names and "Schwänzchen" in data.joint_names
    boxes = {"nose": [1, 2]}
    (tmp_path / "a.json").write_bytes((mark + json.dumps(boxes)).encode(encoding))
    assert load_json(tmp_path / "a.json") == boxes


def test_a_damaged_file_in_utf_16_is_one_error(tmp_path: Path):
    whole = (TABLE + "0,0,2,0.9,3,0.5,0.4,5,6,1\n").encode("utf-16")
    for end in range(1, len(whole), 7):
        (tmp_path / "a.csv").write_bytes(whole[:end])
        with pytest.raises(UserError):
            read(tmp_path / "a.csv", ReadOptions(format="csv"))


@pytest.mark.parametrize(
    "focal",
    ["left:900,*r*:450", {"left": 900.0, "right": 450.0}, np.repeat([900.0, 450.0], 2)],
    ids=["text", "dict", "array"],
)
def test_each_camera_has_its_focal_length(focal, tmp_path: Path) -> None:
    wide = np.repeat([900.0, 450.0], 2)[:, None]  # of the frame's camera
    keypoints = np.stack([500 + 0.1 * wide, 400 - 0.2 * wide], -1) + np.zeros((4, 3, 1))
    each = {"focal_px": focal} if isinstance(focal, np.ndarray) else {}
    np.savez(
        tmp_path / "a.npz", keypoints=keypoints, joint_names=list("abc"), camera=np.repeat(["left", "right"], 2), **each
    )
    options = ReadOptions(image_size=(1000, 800), focal_px=None if each else focal)
    np.testing.assert_allclose(read(tmp_path / "a.npz", options).rays(), np.tile([0.1, -0.2], (4, 3, 1)), atol=1e-6)
    without = read(tmp_path / "a.npz", ReadOptions(focal_px=options.focal_px))
    assert without.rays() is None and "needs image_size=" in without.notes[-1]


@pytest.mark.parametrize(
    ("focal", "says"),
    [
        ("left:900", "focal_px= names left and has none for right. Name each camera"),
        ("left:900,700", "expected pixels, such as 1145, or those of several cameras: left:1145,right:1200"),
        ("0", "expected pixels"), ("nan", "expected pixels"), ("", "expected pixels"), ("a:b", "expected pixels"), ({}, "expected pixels"),
    ],
)  # fmt: skip
def test_wrong_focal_lengths(focal, says: str, tmp_path: Path) -> None:
    keypoints = np.ones((2, 3, 2))
    np.savez(tmp_path / "a.npz", keypoints=keypoints, joint_names=list("abc"), camera=["left", "right"])
    with pytest.raises(UserError, match=re.escape(says)):
        read(tmp_path / "a.npz", ReadOptions(focal_px=focal))
