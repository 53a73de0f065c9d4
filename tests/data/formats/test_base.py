"""The first look at a file, what the user says of it, and refusals of what holds no keypoints."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import Peek, ReadOptions, size_of
from uplift.data.load import load_file
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
