"""Photos that a file names come from its own folder or from ``images=``: none from elsewhere gets into a page."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mask_files import blob, runs_of, save
from PIL import Image
from shape_samples import shapes

from uplift.data.formats import read_masks
from uplift.data.masks import MaskData
from uplift.errors import UserError
from uplift.export.shape_page import write_shape_page

RED, GREEN = (255, 0, 0), (0, 255, 0)


@pytest.fixture
def named(here: Path) -> list[str]:
    """Return the names of a green photo beside a file, and five ways to the red one elsewhere; the file is in ``ours``."""
    passport = save(here / "secret" / "passport.png", np.full((90, 120, 3), RED, np.uint8))
    save(here / "ours" / "photos" / "field.png", np.full((90, 120, 3), GREEN, np.uint8))
    (here / "ours" / "link.png").symlink_to(passport)
    (here / "ours" / "folder").symlink_to(passport.parent)
    (here / "passport.png").symlink_to(passport)  # in the current folder, as a name alone
    ways = ["../secret/passport.png", "link.png", "folder/passport.png", "photos/../../secret/passport.png"]
    return ["photos/field.png", str(passport), *ways, "passport.png"]


def coco(names: list[str]) -> str:
    mask = blob(90, 120)
    size = {"height": 90, "width": 120}
    outline = {"size": [90, 120], "counts": runs_of(mask)}
    content = {
        "images": [{"id": n, "file_name": name, **size} for n, name in enumerate(names)],
        "annotations": [{"id": n, "image_id": n, "category_id": 1, "segmentation": outline} for n in range(len(names))],
        "categories": [{"id": 1, "name": "thing"}],
    }
    Path("ours/masks.json").write_text(json.dumps(content))
    return "ours/masks.json"


def npz(names: list[str]) -> str:
    np.savez(
        "ours/masks.npz", masks=np.stack([blob(64, 64).astype(np.uint8) * 255] * len(names)), images=np.array(names)
    )
    return "ours/masks.npz"


def own(names: list[str]) -> str:
    """Write a file of a user's own format, whose reader hands on what the file says."""
    Path("reader.py").write_text(
        "import json, numpy, uplift\nfrom uplift.data.masks import Found\n\n"
        "class Mine(uplift.MaskFormat):\n    def read(self, path, options):\n"
        "        given = json.loads(path.read_text())\n"
        "        for n, name in enumerate(given['names']):\n"
        "            yield Found(str(n), numpy.array(given['mask'], bool), image=name)\n"
    )
    Path("ours/masks.txt").write_text(json.dumps({"names": names, "mask": blob(90, 120).tolist()}))
    return "ours/masks.txt"


def colours(data: MaskData) -> set[tuple[int, ...]]:
    """Return the colours in the middle of the photos that a page of these masks holds."""
    sample = shapes(len(data))
    sample.images, sample.centre_px, sample.scale_px = (
        data.images,
        np.full((len(data), 2), 45.0),
        np.full(len(data), 30.0),
    )
    write_shape_page(sample, "page.html")
    text = Path("page.html").read_text()
    found = [
        Image.open(io.BytesIO(base64.b64decode(one))) for one in re.findall(r"data:image/jpeg;base64,([\w+/=]+)", text)
    ]
    middles = [one.convert("RGB").getpixel((one.width // 2, one.height // 2)) for one in found]
    return {tuple(255 * (value > 128) for value in middle) for middle in middles}


@pytest.mark.parametrize("write", [coco, npz, own])
def test_photos_of_elsewhere_are_left_out(write: Callable[[list[str]], str], named: list[str]) -> None:
    options = {"format": "reader.py:Mine"} if write is own else {}
    data = read_masks(write(named), **options)
    assert data.images is not None
    assert [bool(one) and Path(one).is_file() for one in data.images] == [True] + [False] * 6
    (note,) = (note for note in data.notes if "photos" in note)
    assert note.startswith("5 photos, such as ") and note.endswith("images=FOLDER says where photos are")
    assert colours(data) == {GREEN}
    elsewhere = read_masks(write(["a/passport.png"]), images="secret", **options)
    assert colours(elsewhere) == {RED}, "a folder that the user names"
    linked = read_masks(write(["link.png"]), images="ours", **options)
    assert linked.images is None or linked.images.tolist() == [""]
    assert any("are not in ours and are left out" in note for note in linked.notes)


def test_a_gltf_takes_no_bytes_of_elsewhere(here: Path) -> None:
    from uplift.data.parsers.meshes import read_meshes

    (here / "secret.bin").write_bytes(bytes(400))
    (here / "ours").mkdir()
    (here / "ours" / "link.bin").symlink_to(here / "secret.bin")
    for uri in ("link.bin", "../secret.bin", str(here / "secret.bin")):
        buffer = {"uri": uri, "byteLength": 400}
        tree = {"asset": {"version": "2.0"}, "buffers": [buffer], "scenes": [{"nodes": []}], "nodes": []}
        (here / "ours" / "a.gltf").write_text(json.dumps(tree))
        with pytest.raises(UserError, match="expected a file beside it"):
            read_meshes(here / "ours" / "a.gltf")
