"""What is not masks ends in one clear error, whatever it is."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from mask_files import blob, coco_file, photo, save

from uplift.data.formats import MASK_FORMATS, read_masks
from uplift.errors import UserError

GREY = blob(seed=1) * np.uint8(255)


def bomb(path: Path, side: int) -> Path:
    """Write a PNG that says it has side x side pixels."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")
    )
    return path


def refused(path: Path | str, match: str, **options) -> None:
    with pytest.raises(UserError, match=match) as found:
        read_masks(path, **options)
    assert len(str(found.value)) < 700


def test_nothing_there(tmp_path: Path) -> None:
    refused(tmp_path / "no", "No file")
    refused(f"{tmp_path}/*.png", "No file fits")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "is an empty folder, expected files of masks")
    refused(tmp_path / "empty", "has no pictures .it is empty.", format="png_folder")
    (tmp_path / "x.json").write_bytes(b"")
    refused(tmp_path / "x.json", "is empty .0 bytes., expected masks")
    (tmp_path / "x.png").write_bytes(b"")
    refused(tmp_path / "x.png", "none of 1 masks can be used: 1: no picture, or a damaged one")


@pytest.mark.parametrize("format", [None, "png_folder", "labels"])
def test_pictures_that_are_none(format: str | None, tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("hello")
    refused(tmp_path / "text.png", "none of 1 masks .* no picture, or a damaged one .text.png", format=format)
    whole = save(tmp_path / "whole.png", photo()).read_bytes()
    (tmp_path / "short.png").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path / "short.png", "no picture, or a damaged one", format=format)
    for side in (12_000, 60_000):
        refused(bomb(tmp_path / "bomb.png", side), "more than 100 million pixels .bomb.png", format=format)
    refused(bomb(tmp_path / "lies.png", 2000), "no picture, or a damaged one", format=format)


def test_a_folder_of_photos(tmp_path: Path) -> None:
    for number in range(4):
        save(tmp_path / f"{number}.{'jpg' if number % 2 else 'png'}", photo(seed=number))
        save(tmp_path / f"{number}_grey.png", photo(colours=1, seed=number))
    refused(tmp_path, "none of 8 masks can be used: 8: a photo or drawing of many shades, not a mask .0.png, ")


@pytest.mark.parametrize("name", ["a.mp4", "a.glb", "a.csv", "a.ckpt", "a.zip", "a.xyz", "a.xml"])
def test_other_files(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"anything\0at all")
    refused(tmp_path / name, rf"{name} is (a |the |an |XML|not in a known format)")


def test_other_npz_and_json(tmp_path: Path) -> None:
    np.savez(tmp_path / "poses.npz", keypoints=np.zeros((3, 2, 2)), joint_names=np.array(["a", "b"]))
    refused(tmp_path / "poses.npz", "not in a known format of masks .its arrays: keypoints, joint_names.")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    refused(tmp_path / "other.npz", "not in a known format of masks .its arrays: x.")
    (tmp_path / "other.json").write_text('{"version": 1}')
    refused(tmp_path / "other.json", "not in a known format of masks .its keys: version.")
    coco_file(tmp_path / "coco.json", [])
    refused(tmp_path / "coco.json", "has no annotations")
    (tmp_path / "cut.json").write_text((tmp_path / "coco.json").read_text()[:-30])
    refused(tmp_path / "cut.json", "cut.json")


def test_a_folder_of_other_files_says_what_to_give(tmp_path: Path) -> None:
    coco_file(tmp_path / "instances.json", [])
    refused(tmp_path, f"Give a file in it: {tmp_path / 'instances.json'}")
    save(tmp_path / "a.png", GREY)
    refused(f"{tmp_path}/a.png,{tmp_path}/instances.json", "several kinds")
    assert len(read_masks(tmp_path)) == 1


def test_options_that_cannot_be(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", GREY)
    refused(path, "format=png: no such format.*png_folder", format="png")
    refused(path, "side=100000: expected a whole number of pixels from 8 to 1024", side=100_000)
    refused(path, "border=kep: expected skip or keep. Did you mean 'keep'", border="kep")
    refused(path, "most=0: expected a whole number", most=0)


@pytest.mark.parametrize("format", sorted(set(MASK_FORMATS) - {"npz"}))
@pytest.mark.parametrize(
    "content", [b"PK\x03\x04junk", b"{}", b"[]", b"[1]", b'{"annotations": 3}', b"\xff\xd8\xff\xe0junk", bytes(50)]
)
def test_a_format_that_it_is_not(format: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(content)
    refused(path, "x.bin", format=format)
    refused(tmp_path, r"is a folder, expected COCO's|has no pictures .in it: x.bin.", format=format)


HOSTILE = (
    None, True, -1, 0, 3.5, 10**400, 2**63, 1e300, float("nan"), float("inf"), "x", "", [], {}, [[]], [1], {"a": 1},
    [[[1]]], "y" * 5000, "\ud800", [10**9] * 3, {"counts": "o" * 400, "size": [9, 9]}, {"counts": [5], "size": [10**9, 10**9]},
)  # fmt: skip


def test_hostile_values_anywhere_in_a_coco_file(tmp_path: Path) -> None:
    good = [[10, 10, 40, 10, 40, 40, 10, 40]]
    content = json.loads(coco_file(tmp_path / "x.json", [good, good]).read_text())
    for part in ("images", "annotations", "categories"):
        for key in content[part][0]:
            for value in HOSTILE:
                broken = json.loads(json.dumps(content))
                broken[part][0][key] = value
                (tmp_path / "x.json").write_text(json.dumps(broken))
                try:
                    data = read_masks(tmp_path / "x.json", format="coco")
                except UserError as error:
                    assert len(str(error)) < 700
                    continue
                assert 1 <= len(data) <= 2
                assert data.masks.any((1, 2)).all()
                assert sum(len(note) for note in data.notes) < 1500
