"""Small files that claim to be huge are refused before they cost time or memory; what never ends is not opened."""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PIL import Image

from uplift.config.files import files_of
from uplift.data.formats import read, read_masks
from uplift.data.formats.base import ReadOptions
from uplift.data.parsers import files, pictures
from uplift.data.parsers.json import load_json
from uplift.data.parsers.matlab import load_mat
from uplift.data.parsers.meshes import read_meshes
from uplift.data.parsers.npz import read_arrays
from uplift.data.parsers.pickles import load_object_npz, load_pickle
from uplift.errors import UserError

_MOST_BYTES = 600_000_000
_MOST_SECONDS = 10


@pytest.fixture(autouse=True)
def little(tmp_path: Path) -> Iterator[None]:
    """Allow a test the memory and the time that any refusal may take."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + _MOST_BYTES, hard))
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail(f"not refused within {_MOST_SECONDS} s"))
    signal.alarm(_MOST_SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


# Files of keypoints.


def member(shape: tuple[int, ...], descr: str, data: bytes = b"") -> bytes:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"shape": shape, "fortran_order": False, "descr": descr})
    return head.getvalue() + data


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


_POINTS = member((4, 3, 2), "<f4", bytes(96))


def endless_names(folder: Path) -> Path:
    return npz(folder / "a.npz", keypoints=_POINTS, joint_names=member((10**10,), "<U0"))


def endless_frames(folder: Path) -> Path:
    return npz(folder / "a.npz", keypoints=member((10**10, 0, 2), "<f4"), joint_names=member((0,), "<U1"))


def long_header(folder: Path) -> Path:
    return npz(folder / "a.npz", keypoints=b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1) + bytes(2**24))


def packed_npz(folder: Path) -> Path:
    frames = files._MOST_UNPACKED // 64 + 1
    return npz(folder / "a.npz", keypoints=member((frames, 8, 2), "<f4", bytes(frames * 64)), joint_names=_POINTS)


def packed_hdf5(folder: Path) -> Path:
    """Return an analysis file as SLEAP writes it, whose tracks are 5 GB of zeros in one block, stored once a keypoint."""
    with h5py.File(folder / "a.h5", "w") as file:
        file["node_names"] = [f"n{number}".encode() for number in range(20)]
        file.create_dataset("track_occupancy", (16_000_000, 1), "u1", compression="gzip")
        tracks = file.create_dataset(
            "tracks", (1, 2, 20, 16_000_000), "f8", compression="gzip", chunks=(1, 1, 1, 2**21)
        )
        block = zlib.compress(bytes(2**24), 9)
        for place in np.ndindex(2, 20, 8):
            tracks.id.write_direct_chunk((0, *place[:2], place[2] * 2**21), block)
    return folder / "a.h5"


def endless_hdf5(folder: Path) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file["node_names"] = [b"a", b"b", b"c"]
        file["track_occupancy"] = np.ones((4, 1), np.uint8)
        file.create_dataset("tracks", (0, 2, 3, 10**10), "f8", maxshape=(None, 2, 3, None))
    return folder / "a.h5"


def wide_table(folder: Path) -> Path:
    columns = 150_000
    text = ",".join(f"a{number}_{axis}" for number in range(columns // 2) for axis in "xy")
    (folder / "a.csv").write_text(f"{text}\n{','.join('1' * columns)}\n")
    return folder / "a.csv"


def joints_of_their_own(folder: Path) -> Path:
    """Return a table whose every row is of another frame and another joint."""
    rows = "".join(f"{row},j{row},1,1\n" for row in range(9000))
    (folder / "a.csv").write_text(f"frame,joint,x,y\n{rows}")
    return folder / "a.csv"


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (joints_of_their_own, "a table of 9,000 joints in 9,000 frames would grow from 0.1 MB to 1.0 GB"),
        (endless_names, r"'joint_names' has shape \(10000000000,\) and not a byte of data"),
        (endless_frames, r"'keypoints' has shape \(10000000000, 0, 2\) and not a byte of data"),
        (long_header, "'keypoints' is damaged"),
        (packed_npz, r"it would grow from \d\.\d MB to 0\.3 GB.*UPLIFT_MAX_UNPACKED_GB=1 before"),
        (packed_hdf5, r"'tracks' would grow from \d\.\d MB to 5\.1 GB.*UPLIFT_MAX_UNPACKED_GB=6"),
        (endless_hdf5, r"'tracks' has shape \(0, 2, 3, 10000000000\) and not a byte"),
        (wide_table, "a table of 150,000 columns, expected at most 100,000"),
    ],
)
def test_keypoints_that_claim_to_be_huge(made: Callable[[Path], Path], message: str, tmp_path: Path) -> None:
    path = made(tmp_path)
    with pytest.raises(UserError, match=message):
        read(path, ReadOptions(format="csv") if path.suffix == ".csv" else None)


def test_who_trusts_a_packed_file_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_MOST_UNPACKED", 10**6)
    frames = 100_000
    names = member((8,), "<U1", "".join("abcdefgh").encode("utf-32-le"))
    path = npz(tmp_path / "a.npz", keypoints=member((frames, 8, 2), "<f4", bytes(frames * 64)), joint_names=names)
    with pytest.raises(UserError, match="would grow"):
        read(path)
    monkeypatch.setenv("UPLIFT_MAX_UNPACKED_GB", "1")
    assert len(read(path)) == frames
    monkeypatch.setenv("UPLIFT_MAX_UNPACKED_GB", "much")
    with pytest.raises(UserError, match="expected a number of gigabytes"):
        read(path)


# Masks.


def coco(folder: Path, segmentations: list[Any]) -> Path:
    found = {
        "images": [{"id": 1, "file_name": "a.png", "width": 10_000, "height": 10_000}],
        "categories": [{"id": 1, "name": "x"}],
        "annotations": [
            {"id": number, "image_id": 1, "category_id": 1, "segmentation": one}
            for number, one in enumerate(segmentations)
        ],
    }
    (folder / "a.json").write_text(json.dumps(found))
    return folder / "a.json"


_SQUARE = [100, 100, 9900, 100, 9900, 9900, 100, 9900]
_ZIGZAG = [number for corner in range(1000) for number in (100 + corner, 9900 if corner % 2 else 100)]


def many_runs(folder: Path) -> Path:
    return coco(folder, [{"size": [10_000, 10_000], "counts": [1_000_100, 98_000_000, 999_900]}] * 100)


def many_squares(folder: Path) -> Path:
    return coco(folder, [[_SQUARE]] * 1000)


def squares_in_one(folder: Path) -> Path:
    return coco(folder, [[_SQUARE] * 1000])


def long_outline(folder: Path) -> Path:
    return coco(folder, [[_ZIGZAG]] * 20)


def picture(folder: Path, size: int, depth: int, colour: int) -> Path:
    """Return a PNG that says how large it is, and has nothing more."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", size, size, depth, colour, 0, 0, 0))
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(9))))
    return folder / "a.png"


def scattered(folder: Path) -> Path:
    """Return a label image of 60 objects, each a stripe above and another below all those after it."""
    stripes = np.repeat(np.arange(1, 61, dtype=np.uint8), 6)
    image = np.repeat(np.concatenate([stripes, stripes[::-1]])[:, None], 720, 1)
    image[:, :12] = 0
    Image.fromarray(image).save(folder / "a.png")
    return folder / "a.png"


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (many_runs, r"its 100 outlines cover 9,80\d,000,000 pixels"),
        (many_squares, r"its 1,000 outlines cover 96,\d+,000,000 pixels in a file of 0.1 MB.*most=10"),
        (squares_in_one, "more than 100 million pixels"),
        (long_outline, "more than 100 million pixels"),
        (lambda folder: picture(folder, 10_001, 1, 0), "more than 100 million pixels"),
        (lambda folder: picture(folder, 7_200, 8, 2), "more than 50 million pixels in colours"),
        (scattered, "scattered over all of the picture"),
    ],
)
def test_masks_that_claim_to_be_huge(made: Callable[[Path], Path], message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        read_masks(made(tmp_path))


def test_a_few_of_many_outlines_can_be_taken(tmp_path: Path) -> None:
    """Those of a real file are far below the bound, and what ``most`` asks for counts alone."""
    triangle = [1000, 1000, 1400, 1000, 1200, 1400]
    path = coco(tmp_path, [[triangle]] * 3000)
    assert len(read_masks(path, most=5)) == 5
    assert len(read_masks(coco(tmp_path, [[triangle]] * 20))) == 20


# Meshes.

_SOLID = (
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4").tobytes()
    + np.array([0, 1, 2, 0, 1, 3, 0, 2, 3, 1, 2, 3], "<u2").tobytes()
)


def gltf(folder: Path, **changes: Any) -> Path:
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 72, "uri": "a.bin"}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
    }
    (folder / "a.bin").write_bytes(_SOLID)
    (folder / "a.gltf").write_text(json.dumps(tree | changes))
    return folder / "a.gltf"


def empty_accessors(targets: int) -> dict[str, Any]:
    rows = 50_000
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "targets": [{}] * targets}
    return {
        "accessors": [
            {"componentType": 5126, "count": rows, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [primitive]}],
    }


def test_meshes_that_claim_to_be_huge(tmp_path: Path) -> None:
    shared = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}] * 10_001}
    for changes, message in (
        ({"nodes": [{"mesh": 0}] * 10_001}, "shows more than 10,000 separate parts"),
        ({"meshes": [shared]}, "10,001 separate parts, expected at most 10,000"),
        (empty_accessors(targets=2000), "read the same bytes again and again"),
    ):
        with pytest.raises(UserError, match=message):
            read_meshes(gltf(tmp_path, **changes))
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf " + "1 2 3 4 " * 20_000
    (tmp_path / "a.obj").write_text(corners)
    with pytest.raises(UserError, match="a line of 160,002 characters"):
        read_meshes(tmp_path / "a.obj")


def test_instances_of_a_real_scene_are_read(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "translation": [number, 0, number % 7]} for number in range(500)]
    (mesh,) = read_meshes(gltf(tmp_path, nodes=nodes))
    assert len(mesh.faces) == 4 * 500


# What is not a file.


@pytest.mark.parametrize("place", ["pipe", "device"])
def test_pipes_and_devices_are_never_opened(place: str, tmp_path: Path) -> None:
    """Opening a pipe waits for its other end, and a device of zeros never ends: the alarm would end this test."""
    readers = {
        ".csv": (read, files_of), ".json": (read, read_masks, load_json), ".npz": (read, read_arrays, load_object_npz),
        ".h5": (read,), ".slp": (read,), ".pkl": (load_pickle,), ".mat": (lambda path: load_mat(path, ["a"]),),
        ".png": (read_masks,), ".obj": (read_meshes,), ".glb": (read_meshes,),
    }  # fmt: skip
    for ending, functions in readers.items():
        path = tmp_path / f"a{ending}"
        os.mkfifo(path) if place == "pipe" else path.symlink_to("/dev/zero")
        for function in functions:
            with pytest.raises(UserError, match="is a pipe or a device, expected a file"):
                function(path)
    with pytest.raises(pictures.PictureError):
        pictures.open_picture(tmp_path / "a.png")
