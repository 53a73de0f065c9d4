"""Masks as pictures: whatever a picture says, the same object comes out; what is no mask is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mask_files import blob, photo, save
from PIL import Image

from uplift.data.clean_masks import Crop, clean_mask
from uplift.data.formats import read_masks
from uplift.errors import UserError

MASK = blob(120, 160, seed=1)
CROP = clean_mask(MASK)
GREY = MASK * np.uint8(255)


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.minimum(one, other).sum() / np.maximum(one, other).sum())


RGBA = np.dstack([photo(), GREY])
AS_WRITTEN = {
    "white.png": (GREY, {}),
    "ones.png": (MASK.astype(np.uint8), {}),
    "bits.png": (MASK, {}),
    "grey.png": (MASK * np.uint8(100), {}),
    "colour.png": (np.dstack([GREY, 0 * GREY, 0 * GREY]), {}),
    "rgb.png": (np.dstack([GREY] * 3), {}),
    "cut_out.png": (RGBA, {}),
    "opaque.png": (np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)]), {}),
    "grey_alpha.png": (np.dstack([photo(colours=1), GREY]), {}),
    "deep.png": (MASK * np.uint16(65535), {}),
    "palette.png": (MASK.astype(np.uint8), {"palette": [0, 0, 0, 128, 0, 0]}),
    "palette_blue.png": (MASK * np.uint8(7), {"palette": [255, 255, 255] * 7 + [0, 0, 100]}),
    "lossless.webp": (GREY, {"lossless": True}),
    "plain.bmp": (GREY, {}),
    "plain.tiff": (GREY, {}),
    "float.tiff": (MASK.astype(np.float32), {}),
    "plain.gif": (GREY, {}),
    "plain.pgm": (GREY, {}),
    "black.png": (255 - GREY, {}),
}
"""File -> what is written; each shows `MASK`."""


@pytest.mark.parametrize("name", AS_WRITTEN)
def test_every_way_of_writing_a_mask_gives_the_same_crop(name: str, tmp_path: Path) -> None:
    array, options = AS_WRITTEN[name]
    data = read_masks(save(tmp_path / name, array, **options))
    assert isinstance(CROP, Crop)
    assert np.array_equal(data.masks[0], CROP.mask)
    assert data.centre_px.tolist() == [list(CROP.centre_px)]
    assert data.scale_px.tolist() == pytest.approx([CROP.scale_px])
    assert (data.names, data.category, data.images) == ([name], None, None)
    inverted = any("black on white" in note for note in data.notes)
    assert inverted == (name in ("black.png", "palette_blue.png"))


@pytest.mark.parametrize("name", ["a.jpg", "colour.jpg", "soft.png", "lossy.webp", "of_jpg.png"])
def test_soft_edges_and_lossy_pictures_give_nearly_that_crop(name: str, tmp_path: Path) -> None:
    array = np.dstack([GREY, 0 * GREY, GREY]) if name == "colour.jpg" else GREY
    if name == "soft.png":
        array = np.asarray(
            Image.fromarray(np.kron(GREY, np.ones((3, 3), np.uint8))).resize((160, 120), Image.Resampling.BICUBIC)
        )
    if name == "of_jpg.png":
        array = np.asarray(Image.open(save(tmp_path / "first" / "b.jpg", array, quality=60)))
    data = read_masks(save(tmp_path / name, array))
    assert isinstance(CROP, Crop)
    assert overlap(data.masks[0], CROP.mask) > 0.97
    assert "read as pictures of masks" in data.notes[0]


def test_a_folder_with_sub_folders_and_what_is_wrong_in_it(tmp_path: Path) -> None:
    for name, mask in {
        "cow/10": MASK,
        "cow/2": MASK,
        "horse/a": MASK,
        "horse/empty": MASK[:4],
        "horse/cut": MASK[40:],
    }.items():
        save(tmp_path / f"{name}.png", mask * np.uint8(255))
    save(tmp_path / "horse/photo.jpg", photo())
    save(tmp_path / "horse/labels.png", GREY // 255 + np.pad(GREY, ((0, 0), (60, 0)))[:, :160] // 255)
    (tmp_path / "horse/text.png").write_text("not a picture")
    (tmp_path / "horse/whole.png").write_bytes((tmp_path / "horse/a.png").read_bytes()[:120])
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "__MACOSX").mkdir()
    (tmp_path / "cow/._2.png").write_text("x")
    data = read_masks(tmp_path, format="png_folder")
    assert data.names == ["cow/2.png", "cow/10.png", "horse/a.png"]
    assert data.category is not None
    assert data.category.tolist() == ["cow", "cow", "horse"]
    notes = "\n".join(data.notes)
    for piece in (
        "1 files of other kinds were left out (notes.txt)",
        "2 of 9 masks skipped: no picture, or a damaged one (horse/text.png, horse/whole.png)",
        "skipped: empty (horse/empty.png)",
        "cut off (border=keep takes these) (horse/cut.png)",
        "not a mask (horse/photo.jpg)",
        "format=labels takes each as an object) (horse/labels.png)",
    ):
        assert piece in notes
    assert read_masks(tmp_path, format="png_folder", category="Cow").names == ["cow/2.png", "cow/10.png"]
    with pytest.raises(UserError, match=r"category=hors: .* no such category. Did you mean 'horse'"):
        read_masks(tmp_path, category="hors")


def test_several_folders_patterns_and_commas(tmp_path: Path) -> None:
    for name in ("cow/1", "cow/2", "horse/1"):
        save(tmp_path / f"{name}.png", GREY)
    both = read_masks(f"{tmp_path}/*")
    assert both.names == ["cow/1.png", "cow/2.png", "horse/1.png"]
    assert both.category is not None
    assert both.category.tolist() == ["cow", "cow", "horse"]
    assert read_masks(f"{tmp_path}/cow,{tmp_path}/horse").names == both.names
    assert read_masks(f"{tmp_path}/cow/*.png").names == ["1.png", "2.png"]
    with pytest.raises(UserError, match="category=cow: .* has no categories"):
        read_masks(tmp_path / "cow", category="cow")


def test_most_is_spread_and_always_the_same(tmp_path: Path) -> None:
    for number in range(20):
        save(tmp_path / f"{number}.png", blob(seed=number) * np.uint8(255))
    data = read_masks(tmp_path, most=6)
    places = [int(name.removesuffix(".png")) for name in data.names]
    assert places == sorted(places)
    assert len(places) == 6
    assert max(places) > 9
    assert any("most=6" in note for note in data.notes)
    assert read_masks(tmp_path, most=6).names == data.names
    whole = read_masks(tmp_path)
    assert np.array_equal(whole.masks[places], data.masks)
    assert not any("most" in note for note in whole.notes)


def test_photos_beside_masks(tmp_path: Path) -> None:
    for number in range(3):
        save(tmp_path / f"masks/{number}.png", GREY)
    save(tmp_path / "photos/0.jpg", photo())
    save(tmp_path / "photos/more/1.jpg", photo())
    data = read_masks(tmp_path / "masks", images=tmp_path / "photos")
    assert data.images is not None
    assert data.images.tolist() == [str(tmp_path / "photos/0.jpg"), str(tmp_path / "photos/more/1.jpg"), ""]
    assert f"1 masks have no photo in {tmp_path / 'photos'}" in data.notes
    with pytest.raises(UserError, match="images=nowhere: no such folder"):
        read_masks(tmp_path / "masks", images="nowhere")


def test_sizes_may_differ_and_the_side_is_asked_for(tmp_path: Path) -> None:
    for name, factor in (("1", 1), ("2", 2), ("3", 3)):
        save(tmp_path / f"{name}.png", GREY.repeat(factor, 0).repeat(factor, 1))
    data = read_masks(tmp_path, side=32)
    assert data.masks.shape == (3, 32, 32)
    assert data.scale_px == pytest.approx(data.scale_px[0] * np.array([1, 2, 3]))
    assert np.array_equal(data.masks[0], data.masks[2])


def test_a_picture_that_is_mostly_object_is_not_inverted(tmp_path: Path) -> None:
    save(tmp_path / "full.png", np.full((50, 60), 255, np.uint8))
    save(tmp_path / "touches.png", np.pad(np.full((50, 50), 255, np.uint8), ((0, 0), (0, 10))))
    with pytest.raises(UserError, match=r"(?s)the whole image is covered \(full.png\).*(?<!inverted)$"):
        read_masks(tmp_path)
