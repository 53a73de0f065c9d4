"""Label images: each number is an object, as DAVIS, Cityscapes and annotation tools write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mask_files import blob, save

from uplift.data.clean_masks import Crop, clean_mask
from uplift.data.formats import read_masks
from uplift.errors import UserError

OBJECTS = [blob(70, 90, seed=seed) for seed in range(3)]
CROPS = [clean_mask(one) for one in OBJECTS]


def scene(ids: tuple[int, ...] = (1, 2, 3), kind: type = np.uint8) -> np.ndarray:
    """Return the objects side by side, each with its id."""
    return np.concatenate([one.astype(kind) * kind(id_) for one, id_ in zip(OBJECTS, ids, strict=True)], 1)


def check(data, names: list[str]) -> None:
    assert data.names == names
    for mask, crop, place, centre in zip(data.masks, CROPS, range(3), data.centre_px, strict=True):
        assert isinstance(crop, Crop)
        assert np.array_equal(mask, crop.mask)
        assert centre.tolist() == [crop.centre_px[0] + 90 * place, crop.centre_px[1]]


DAVIS = [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]
COLOURS = np.array([[0, 0, 0], [249, 145, 87], [250, 200, 99], [236, 95, 103]], np.uint8)


@pytest.mark.parametrize(
    ("name", "array", "options", "ids"),
    [
        ("palette.png", scene(), {"palette": DAVIS}, (1, 2, 3)),
        ("plain.png", scene(), {}, (1, 2, 3)),
        ("apart.png", scene((40, 80, 250)), {}, (40, 80, 250)),
        ("deep.png", scene((300, 4000, 65000), np.uint16), {}, (300, 4000, 65000)),
        ("deep.tif", scene((300, 4000, 65000), np.uint16), {}, (300, 4000, 65000)),
        ("whole.tif", scene((7, 70_000, 10**6), np.int32), {}, (7, 70_000, 10**6)),
        ("colours.png", COLOURS[scene()], {}, tuple((COLOURS[1:].astype(int) @ [1, 256, 65536]).tolist())),
    ],
)
def test_every_way_of_writing_labels_gives_the_same_crops(
    name: str, array: np.ndarray, options: dict, ids: tuple[int, ...], tmp_path: Path
) -> None:
    path = save(tmp_path / name, array, **options)
    data = read_masks(path)
    check(data, [f"{name}:{one}" for one in ids])
    assert data.notes[0] == "read as label images, an object for each number above 0 (guessed; format=labels)"
    assert len(data.notes) == 1


def test_folders_are_categories_and_the_cut_off_are_skipped(tmp_path: Path) -> None:
    save(tmp_path / "bear/00000.png", scene(), DAVIS)
    save(tmp_path / "bear/00001.png", scene()[:, 45:], DAVIS)
    save(tmp_path / "boat/00000.png", (OBJECTS[0] * np.uint8(1)), DAVIS)
    data = read_masks(tmp_path)
    assert data.names == [
        *(f"bear/00000.png:{n}" for n in (1, 2, 3)), "bear/00001.png:2", "bear/00001.png:3", "boat/00000.png:1",
    ]  # fmt: skip
    assert data.category is not None
    assert data.category.tolist() == ["bear"] * 5 + ["boat"]
    assert any("border" in note and "bear/00001.png:1" in note for note in data.notes)
    assert len(read_masks(tmp_path, border="keep")) == 7
    assert read_masks(tmp_path, category="boat").names == ["boat/00000.png:1"]


def test_void_is_no_object(tmp_path: Path) -> None:
    labels = scene()
    labels[:3] = labels[-3:] = 255
    labels[20:40, 84:96] = 255
    data = read_masks(save(tmp_path / "a.png", labels, [*DAVIS]))
    check(data, ["a.png:1", "a.png:2", "a.png:3"])
    assert any("label 255 is taken as void in 1 label images" in note for note in data.notes)


def test_cityscapes(tmp_path: Path) -> None:
    ids = scene((26_000, 26_001, 24_000), np.uint16)
    ids[ids == 0] = 7
    ids[60:] = 11
    folder = tmp_path / "aachen"
    save(folder / "aachen_0_gtFine_instanceIds.png", ids)
    save(folder / "aachen_0_gtFine_labelIds.png", (ids // 1000).astype(np.uint8))
    (folder / "aachen_0_gtFine_polygons.json").write_text("{}")
    save(tmp_path / "photos/aachen_0_leftImg8bit.png", np.zeros((5, 5, 3), np.uint8))
    data = read_masks(folder, images=tmp_path / "photos")
    assert data.names == [f"aachen_0_gtFine_instanceIds.png:{one}" for one in (24_000, 26_000, 26_001)]
    assert data.category is not None
    assert data.images is not None
    assert data.category.tolist() == ["person", "car", "car"]
    assert set(data.images.tolist()) == {str(tmp_path / "photos/aachen_0_leftImg8bit.png")}
    notes = "\n".join(data.notes)
    assert "2 areas of classes without instances" in notes
    assert "1 pictures that are not *_instanceIds.png were left out" in notes
    assert read_masks(folder, category="person").names == data.names[:1]
    with pytest.raises(UserError, match="no such category. Did you mean .person"):
        read_masks(folder, category="persons")


def test_labels_without_background_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "trimap.png", scene() + np.uint8(1))
    with pytest.raises(UserError, match="no pixel is 0, the background of a label image .trimap.png"):
        read_masks(tmp_path)


def test_an_object_in_parts_of_one_number_is_several_pieces(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", scene((1, 2, 1)))
    data = read_masks(path)
    assert data.names == ["a.png:2"]
    assert any("several pieces" in note for note in data.notes)
    assert read_masks(path, pieces="largest").names == ["a.png:1", "a.png:2"]


def test_masks_read_as_labels_are_the_same(tmp_path: Path) -> None:
    for number, one in enumerate(OBJECTS):
        save(tmp_path / f"{number}.png", one * np.uint8(255))
    masks, labels = read_masks(tmp_path), read_masks(tmp_path, format="labels")
    assert np.array_equal(masks.masks, labels.masks)
    assert labels.names == [f"{name}:255" for name in masks.names]
