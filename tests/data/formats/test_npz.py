"""The npz reader takes the documented layout, refuses everything else, and runs nothing."""

from __future__ import annotations

import io
import pickle
import resource
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from bodies import body_arrays, write_body
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uplift.data.formats import read
from uplift.data.formats.npz import read_npz
from uplift.data.parsers.npz import read_arrays
from uplift.errors import UserError


class Payload:
    """Pickles to code that makes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array)
    return stream.getvalue()


def header_only(shape: tuple[int, ...], descr: str = "<f4") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def write_members(path: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_reads_every_documented_array(tmp_path: Path) -> None:
    arrays = body_arrays(frames=7)
    data = read(write_body(tmp_path / "a.npz", frames=7))
    np.testing.assert_array_equal(data.keypoints, arrays["keypoints"])
    np.testing.assert_array_equal(data.confidence, np.ones((7, 17)))
    np.testing.assert_array_equal(data.pose, arrays["pose"])
    np.testing.assert_array_equal(data.tilt_deg, arrays["tilt_deg"])
    assert data.joint_names == tuple(arrays["joint_names"])
    assert (data.fps, data.image_size, data.focal_px, data.unit) == (10, (1000, 1000), 1145, "mm")
    assert list(data.identity["subject"]) == list(arrays["subject"])
    assert data.source == str(tmp_path / "a.npz")


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(["f2", "f4", "f8", "i2", "i8", "u1"]), frames=st.integers(1, 5), packed=st.booleans())
def test_any_kind_of_number_is_taken(tmp_path: Path, kind: str, frames: int, packed: bool) -> None:
    points = np.random.default_rng(0).integers(0, 200, (frames, 3, 2)).astype(kind)
    save = np.savez_compressed if packed else np.savez
    save(tmp_path / "a.npz", keypoints=points, joint_names=np.array(["a", "b", "c"]))
    read_back = read_npz(tmp_path / "a.npz").keypoints
    assert read_back.dtype == np.float32
    np.testing.assert_array_equal(read_back, points.astype(np.float32))


def test_scalars_may_be_given_for_every_frame(tmp_path: Path) -> None:
    data = read_npz(write_body(tmp_path / "a.npz", 6, fps=np.full(6, 25.0), subject=np.array("S9")))
    assert data.fps == 25
    assert list(data.identity["subject"]) == ["S9"] * 6


def test_gravity_and_the_angles_it_has_are_read_either_way(tmp_path: Path) -> None:
    angles = {"tilt_deg": np.array([20.0, -5, np.nan]), "roll_deg": np.array([-14.0, 30, 0])}
    by_angles = read_npz(write_body(tmp_path / "a.npz", 3, **angles))
    assert by_angles.gravity is not None and by_angles.gravity[0, 0] > 0 > by_angles.gravity[1, 2]
    gravity = 9.81 * by_angles.gravity.astype(np.float64)
    by_gravity = read_npz(write_body(tmp_path / "b.npz", 3, gravity=gravity, tilt_deg=None))
    np.testing.assert_allclose(by_gravity.tilt_deg, angles["tilt_deg"], atol=1e-5)
    np.testing.assert_allclose(by_gravity.gravity, by_angles.gravity, atol=1e-6)
    assert read_npz(write_body(tmp_path / "c.npz", 3)).gravity is None


def test_a_prediction_is_readable_as_input(tmp_path: Path) -> None:
    changed = {"skeleton": np.array("h36m17"), "level_pose": np.zeros((4, 17, 3)), "unit": np.array("px")}
    np.savez(tmp_path / "b.npz", **{**body_arrays(4), **changed})
    assert read_npz(tmp_path / "b.npz").unit == "px"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"keypoints": None}, "no array 'keypoints'"),
        ({"joint_names": None}, "no array 'joint_names'"),
        ({"keypoints": np.zeros((6, 17, 3))}, "of shape (6, 17, 3), expected numbers of shape (any, any, 2)"),
        ({"keypoints": np.zeros((6, 34))}, "'keypoints' is float64 of shape (6, 34)"),
        ({"keypoints": np.full((6, 17, 2), "12.5")}, "'keypoints' is <U4 of shape (6, 17, 2), expected numbers"),
        (
            {"keypoints": np.zeros((6, 17, 2), complex)},
            "'keypoints' is complex128 of shape (6, 17, 2), expected numbers",
        ),
        (
            {"confidence": np.ones((6, 16))},
            "'confidence' is float64 of shape (6, 16), expected numbers of shape (6, 17)",
        ),
        ({"pose": np.zeros((5, 17, 3))}, "of shape (5, 17, 3), expected numbers of shape (6, 17, 3)"),
        ({"gravity": np.zeros((6, 3))}, "'gravity' is 0 in row 0, expected a direction in the camera's frame"),
        (
            {"gravity": np.full((6, 3), (0.1, 0.9, 0.4))},
            "'gravity' says a tilt of 23.8 and a roll of -6.3 degrees in row",
        ),
        ({"tilt_deg": None, "roll_deg": np.zeros(6)}, "'roll_deg' without 'tilt_deg', expected both, or 'gravity'"),
        ({"root": np.zeros((5, 3))}, "of shape (5, 3), expected numbers of shape (6, 3)"),
        ({"subject": np.array(["a"] * 5)}, "'subject' has shape (5,), expected (6,)"),
        ({"joint_names": np.arange(17)}, "'joint_names' is int64"),
        ({"frame": np.array(["abc"] * 6)}, "'frame' is <U3, expected numbers (frames,)"),
        ({"frame": np.array([0, 1, 2, 3, 4, np.nan])}, "'frame' is not finite"),
        ({"sequence": np.full(6, 1j)}, "'sequence' is complex128, expected text or numbers"),
        ({"joint_names": np.array(["a", "b"])}, "2 joint names for 17 joints"),
        ({"fps": np.array("ten")}, "'fps'"),
        ({"fps": np.array([10.0, 20.0])}, "'fps'"),
        ({"fps": np.float32("inf")}, "'fps'"),
        ({"focal_px": np.float32("nan")}, "'focal_px'"),
        ({"focal_px": np.float32(-3)}, "'focal_px'"),
        ({"image_size": np.array([1000, 0])}, "'image_size'"),
        ({"image_size": np.array([1000, np.inf])}, "'image_size'"),
        ({"unit": np.array("cm")}, "'unit' is 'cm', expected one of mm, px, relative"),
        ({"unit": np.array(["mm", "mm"])}, "'unit'"),
        ({"keypoint": np.zeros(3)}, "unknown array 'keypoint'. Did you mean 'keypoints'?"),
    ],
)
def test_a_wrong_array_is_named(tmp_path: Path, changes: dict, says: str) -> None:
    path = write_body(tmp_path / "a.npz", 6, **changes)
    with pytest.raises(UserError) as caught:
        read_npz(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty (0 bytes)"),
        (b"PK\x03\x04 and then nothing", "truncated, or another format"),
        (b"x,y\n1,2\n" * 50, "truncated, or another format"),
        (npy(np.zeros(3)), "truncated, or another format"),
        (pickle.dumps({"keypoints": [1, 2]}), "truncated, or another format"),
    ],
)
def test_what_is_no_npz_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(UserError, match="a.npz") as caught:
        read_npz(path)
    assert says in str(caught.value)


@pytest.mark.parametrize("packed", [False, True])
def test_no_truncated_or_damaged_file_passes_or_crashes(tmp_path: Path, packed: bool) -> None:
    (np.savez_compressed if packed else np.savez)(tmp_path / "whole.npz", **body_arrays(5))
    whole = (tmp_path / "whole.npz").read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "a.npz"
    for length in rng.integers(1, len(whole), 40):
        path.write_bytes(whole[:length])
        with pytest.raises(UserError):
            read_npz(path)
    for place in rng.integers(0, len(whole), 150):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            read_npz(path)  # a flipped byte in a time stamp harms nobody
        except UserError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize("where", ["keypoints", "joint_names", "subject", "extra"])
def test_pickles_never_run(tmp_path: Path, where: str) -> None:
    marker = tmp_path / "marker"
    trap = np.empty(1, object)
    trap[0] = Payload(marker)
    path = write_body(tmp_path / "a.npz", 6, **{where: trap})
    with pytest.raises(UserError, match="pickled Python objects|unknown array"):
        read_npz(path)
    with pytest.raises(UserError, match="pickled Python objects"):
        read_arrays(path)
    assert not marker.exists()


def test_a_member_that_is_a_bare_pickle_never_runs(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    good = {f"{name}.npy": npy(np.asarray(value)) for name, value in body_arrays(3).items()}
    for name in ("keypoints.npy", "payload", "payload.pkl"):
        path = write_members(tmp_path / "a.npz", good | {name: pickle.dumps(Payload(marker))})
        with pytest.raises(UserError):
            read_npz(path)
    assert not marker.exists()


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def test_a_header_that_claims_3_gb_takes_no_memory(tmp_path: Path) -> None:
    frames = 3_000_000_000 // (17 * 2 * 4)
    good = {"joint_names.npy": npy(np.array(body_arrays(1)["joint_names"]))}
    for shape in ((frames, 17, 2), (frames * 10**9, 17, 2), (-frames, 17, 2)):
        path = write_members(tmp_path / "a.npz", good | {"keypoints.npy": header_only(shape) + bytes(1000)})
        before = _peak_mb()
        with pytest.raises(UserError, match=r"claims -?[\d,]+ bytes but holds 1,000"):
            read_npz(path)
        assert _peak_mb() - before < 100


def test_a_zip_bomb_takes_no_memory(tmp_path: Path) -> None:
    """Zeros shrink a thousandfold: the file is small, the arrays are not, and no one asked for them."""
    frames = 100_000_000 // (17 * 2 * 4)
    zeros = header_only((frames, 17, 2)) + bytes(frames * 17 * 2 * 4)
    good = {"joint_names.npy": npy(np.array(body_arrays(1)["joint_names"]))}
    path = write_members(tmp_path / "a.npz", good | {"bomb.npy": zeros}, zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 1_000_000
    del zeros
    before = _peak_mb()
    with pytest.raises(UserError, match="unknown array 'bomb'"):
        read_npz(path)
    assert _peak_mb() - before < 50


def test_more_than_the_memory_is_refused_before_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_body(tmp_path / "a.npz", 300)
    monkeypatch.setattr("uplift.data.parsers.files.os.sysconf", lambda name: 200)
    with pytest.raises(UserError, match="more than half of this machine's memory"):
        read_npz(path)


def test_a_size_that_the_zip_lies_about_is_refused(tmp_path: Path) -> None:
    path = write_body(tmp_path / "a.npz", 6)
    raw = bytearray(path.read_bytes())
    entry = raw.find(b"PK\x01\x02")  # central directory: compressed size at +20, full size at +24
    raw[entry + 24 : entry + 28] = struct.pack("<I", 3_000_000_000)
    path.write_bytes(bytes(raw))
    with pytest.raises(UserError):
        read_npz(path)


def test_wrong_places(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is a folder"):
        read_npz(tmp_path)
    with pytest.raises(UserError, match="No file"):
        read(tmp_path / "none.npz")
    (tmp_path / "a.csv").write_text("no keypoints\n")
    with pytest.raises(UserError, match=r"is not in a known format of keypoints \(it begins 'no keypoints"):
        read(tmp_path / "a.csv")


def test_people_in_one_photo_are_no_clip(tmp_path: Path) -> None:
    names = np.array(["a.jpg", "a.jpg", "B.PNG"])
    arrays = {"keypoints": np.ones((3, 4, 2)), "joint_names": [*"abcd"], "sequence": names}
    np.savez(tmp_path / "a.npz", **arrays)
    data = read_npz(tmp_path / "a.npz")
    assert list(data.identity) == ["image"]
    assert data.identity["image"].tolist() == names.tolist()
    assert data.clips().tolist() == [0, 1, 2]
    np.savez(tmp_path / "b.npz", **arrays, frame=np.array([0, 1, 0]))
    assert len(set(read_npz(tmp_path / "b.npz").clips())) == 2
    np.savez(tmp_path / "c.npz", **{**arrays, "sequence": np.array(["a.jpg", "a.jpg", "walk"])})
    assert len(set(read_npz(tmp_path / "c.npz").clips())) == 2
