"""COCO's JSON: polygons and run lengths of the same object are the same crop."""

from __future__ import annotations

import json
import resource
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mask_files import blob, coco_file, runs_of, save, text_of_counts

from uplift.data.clean_masks import Crop, clean_mask
from uplift.data.formats import read_masks
from uplift.data.parsers.outlines import counts_of_text, window_of_polygons, window_of_runs
from uplift.errors import UserError

MASKS = [blob(60, 80, seed=seed) for seed in range(4)]
BOX = [[20, 15, 60, 15, 60, 45, 20, 45]]


def rle(mask: np.ndarray, packed: bool = True) -> dict:
    counts = runs_of(mask)
    return {"size": list(mask.shape), "counts": text_of_counts(counts) if packed else counts}


def whole(found, size: tuple[int, int]) -> np.ndarray:
    """Return a window put back into its image of size (height, width)."""
    image = np.zeros(size, bool)
    if found is not None:
        window, (x, y) = found[:2]
        image[y : y + window.shape[0], x : x + window.shape[1]] = window
    return image


@given(arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_runs_are_read_as_they_were_written(mask: np.ndarray) -> None:
    counts = runs_of(mask)
    text = text_of_counts(counts)
    assert counts_of_text(text).tolist() == counts
    for form in (counts, text):
        assert np.array_equal(whole(window_of_runs(form, list(mask.shape)), mask.shape), mask)
    assert (window_of_runs(counts, mask.shape) is None) == (not mask.any())


@given(st.lists(st.integers(0, 10**8), min_size=1, max_size=30))
def test_any_counts_go_into_text_and_back(counts: list[int]) -> None:
    assert counts_of_text(text_of_counts(counts)).tolist() == counts


# Pairs that CVAT tests its own coder with (cvat-canvas/rle).
@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ([0, 6, 1, 3], "061M"),
        ([0, 6, 1], "061"),
        ([0, 6, 1, 1], "061K"),
        ([0, 6, 1, 5], "061O"),
        ([0, 6, 1, 6], "0610"),
        ([0, 1, 1, 2, 1, 3, 1, 4, 1], "011101010"),
        ([0, 1024], "0PP1"),
    ],
)
def test_texts_of_others(counts: list[int], text: str) -> None:
    assert counts_of_text(text).tolist() == counts
    assert text_of_counts(counts) == text


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        ("", [5, 5]), ("o", [5, 5]), ("0P", [5, 5]), ("\x10", [5, 5]), ("é", [5, 5]), ("o" * 99 + "0", [5, 5]), ("0M", [5, 5]),
        ([26], [5, 5]), ([-1, 3], [5, 5]), ([1.5], [5, 5]), ([True], [5, 5]), ([10**30], [5, 5]), (None, [5, 5]), ([5], [0, 5]),
        ([5], [5]), ([5], None), ([5], ["5", 5]), ([2**62, 2**62, 2**62], [5, 5]), ("PPPPPP?" * 9, [5, 5]),
    ],
)  # fmt: skip
def test_runs_that_are_none(counts: object, size: object) -> None:
    with pytest.raises(ValueError):
        window_of_runs(counts, size)


def test_hostile_runs_take_no_memory() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(OverflowError):
        window_of_runs([10**9, 10**9], [10**6, 10**6])
    with pytest.raises(ValueError):
        window_of_runs(text_of_counts([0, 10**8]), [100, 100])
    found = window_of_runs([10, 5], [10_000, 10_000])
    assert found is not None
    assert found[0].shape == (10_000, 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


CORNERS = st.lists(st.tuples(st.floats(-20, 60), st.floats(-20, 60)), min_size=3, max_size=9)


@given(CORNERS)
def test_a_pixel_is_covered_where_its_centre_is_inside(corners: list[tuple[float, float]]) -> None:
    from skimage.measure import points_in_poly

    polygon = np.array(corners, np.float32).astype(np.float64) + [0.003, 0.0017]  # no corner on a pixel's centre
    found = whole(window_of_polygons([polygon], (40, 30)), (30, 40))
    rows, columns = np.mgrid[:30, :40] + 0.5
    ideal = points_in_poly(np.stack([columns, rows], -1).reshape(-1, 2), polygon).reshape(30, 40)
    assert (found != ideal).mean() < 0.002  # points on an edge may fall either way


def test_polygons_and_runs_give_the_same_crop(tmp_path: Path) -> None:
    box = np.zeros((60, 80), bool)
    box[15:45, 20:60] = True
    data = read_masks(coco_file(tmp_path / "x.json", [BOX, BOX[0], rle(box), rle(box, packed=False)]))
    crop = clean_mask(box)
    assert isinstance(crop, Crop)
    for row in range(4):
        assert np.array_equal(data.masks[row], crop.mask)
        assert data.centre_px[row].tolist() == [40, 30]
    assert data.names == [f"field.jpg:{number}" for number in range(100, 104)]
    assert data.category is not None
    assert data.images is not None
    assert data.category.tolist() == ["horse", "cow"] * 2
    assert data.images.tolist() == [str(tmp_path / "field.jpg")] * 4
    assert data.notes == ("read as COCO's JSON with segmentations (guessed; format=coco)",)


def test_runs_of_any_mask_are_the_mask(tmp_path: Path) -> None:
    data = read_masks(coco_file(tmp_path / "x.json", [rle(mask, packed=n % 2 == 0) for n, mask in enumerate(MASKS)]))
    for row, mask in enumerate(MASKS):
        crop = clean_mask(mask)
        assert isinstance(crop, Crop)
        assert np.array_equal(data.masks[row], crop.mask)
    assert read_masks(tmp_path / "x.json", category="cow").names == ["field.jpg:101", "field.jpg:103"]
    with pytest.raises(UserError, match="category=dog: .* no such category.* Valid: cow, horse"):
        read_masks(tmp_path / "x.json", category="dog")


def test_what_is_skipped_and_why(tmp_path: Path) -> None:
    content = json.loads(coco_file(tmp_path / "x.json", [BOX] * 9).read_text())
    records = content["annotations"]
    records[1]["iscrowd"] = 1
    records[2]["segmentation"] = [[1.5, 15, 60, 15, 60, 45]]
    records[3]["segmentation"] = [[20, 15, 60]]
    records[4]["segmentation"] = {"size": [60, 80], "counts": [10**6]}
    records[5]["segmentation"] = []
    records[6]["image_id"] = 8
    records[7]["score"] = 0.3
    records[8]["segmentation"] = [[20, 15, 30, 15, 30, 45], [40, 15, 50, 15, 50, 45]]
    (tmp_path / "x.json").write_text(json.dumps(content))
    data = read_masks(tmp_path / "x.json")
    assert data.names == ["field.jpg:100"]
    notes = "\n".join(data.notes)
    for reason in (
        "a crowd, not one object (field.jpg:101)",
        "cut off (border=keep takes these) (field.jpg:102)",
        "2 of 9 masks skipped: the segmentation is damaged (field.jpg:103, field.jpg:104)",
        "no segmentation (field.jpg:105)",
        "an image that the file does not have (8:106)",
        "a score below 0.5 (field.jpg:107)",
        "several pieces of similar size (pieces=largest takes the largest of each) (field.jpg:108)",
    ):
        assert reason in notes


def test_what_detectors_hand_in(tmp_path: Path) -> None:
    results = [{"image_id": 3, "category_id": 18, "score": 0.9, "segmentation": rle(mask)} for mask in MASKS]
    (tmp_path / "x.json").write_text(json.dumps(results))
    data = read_masks(tmp_path / "x.json")
    assert data.names == [f"3:{n}" for n in range(4)]
    assert data.category is not None
    assert data.category.tolist() == ["18"] * 4


def test_a_file_for_each_image(tmp_path: Path) -> None:
    for number in (1, 2):
        image = {"image_id": number, "file_name": f"sa_{number}.jpg", "width": 80, "height": 60}
        content = {"image": image, "annotations": [{"id": 5, "segmentation": rle(MASKS[number])}]}
        (tmp_path / f"sa_{number}.json").write_text(json.dumps(content))
    data = read_masks(f"{tmp_path}/*.json")
    assert data.names == ["sa_1.jpg:5", "sa_2.jpg:5"]
    assert data.category is None


def test_images_without_a_size_and_photos(tmp_path: Path) -> None:
    path = coco_file(tmp_path / "x.json", [BOX], images=[{"id": "7", "file_name": "train/field.jpg"}])
    save(tmp_path / "photos/field.jpg", np.zeros((60, 80, 3), np.uint8))
    data = read_masks(path, images=tmp_path / "photos")
    assert data.images is not None
    assert data.images.tolist() == [str(tmp_path / "photos/field.jpg")]
    assert any("1 images have no width and height" in note for note in data.notes)


def test_real_outlines(benchmark_data) -> None:
    path = benchmark_data("trackers/coco/test_coco.json")
    data = read_masks(path, border="keep", pieces="largest")
    assert len(data) == 14
    records = {str(one["id"]): one for one in json.loads(path.read_text())["annotations"]}
    for name, centre, scale, mask in zip(data.names, data.centre_px, data.scale_px, data.masks, strict=True):
        record = records[name.split(":")[1]]
        if len(record["segmentation"]) > 1:
            continue
        x, y, width, height = record["bbox"]
        assert np.allclose(centre, (x + width / 2, y + height / 2), atol=1)
        assert scale == pytest.approx(max(width, height) / 1.7, abs=1.2)
        assert mask.sum() / 255 * (scale / 32) ** 2 == pytest.approx(record["area"], rel=0.05)
    assert read_masks(path, most=5).names == [
        name for name in read_masks(path).names if name in read_masks(path, most=5).names
    ]
