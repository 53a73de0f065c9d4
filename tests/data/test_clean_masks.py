"""One mask becomes one crop: what moves with it, what does not, what is changed and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mask_files import blob

from uplift.data.clean_masks import CHANGES, REASONS, CleanOptions, Crop, clean, clean_mask, covered
from uplift.data.masks import FILL, Found, Skipped
from uplift.errors import UserError

SIDES = st.sampled_from([8, 31, 32, 64])
SEEDS = st.integers(0, 10_000)


def crop_of(mask: np.ndarray | Found, **options) -> Crop:
    crop = clean_mask(mask, CleanOptions(**options))
    assert isinstance(crop, Crop), crop
    return crop


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over union of two crops' coverages."""
    return float(np.minimum(one, other).sum() / np.maximum(one, other).sum())


@settings(max_examples=40)
@given(SEEDS, SIDES, st.integers(0, 9), st.integers(0, 9))
def test_moved_by_whole_pixels_it_is_the_same_crop(seed: int, side: int, right: int, down: int) -> None:
    mask = blob(seed=seed)
    moved = np.zeros((80, 100), bool)
    moved[down : down + 60, right : right + 80] = mask
    one, other = crop_of(mask, side=side), crop_of(moved, side=side)
    assert np.array_equal(one.mask, other.mask)
    assert one.scale_px == other.scale_px
    assert other.centre_px == (one.centre_px[0] + right, one.centre_px[1] + down)


@settings(max_examples=40)
@given(SEEDS, SIDES, st.sampled_from([(60, 80), (44, 44), (200, 150)]))
def test_flipped_and_turned_it_is_the_flipped_and_turned_crop(seed: int, side: int, size: tuple[int, int]) -> None:
    mask = blob(*size, seed=seed, margin=1)
    one = crop_of(mask, side=side)
    for turn in (np.fliplr, np.flipud, np.transpose, np.rot90):
        assert np.array_equal(crop_of(turn(mask), side=side).mask, turn(one.mask))
    assert crop_of(np.fliplr(mask), side=side).centre_px == (size[1] - one.centre_px[0], one.centre_px[1])


@given(SEEDS, st.integers(2, 5))
def test_larger_it_is_nearly_the_same_crop(seed: int, factor: int) -> None:
    mask = blob(seed=seed)
    one, other = crop_of(mask), crop_of(mask.repeat(factor, 0).repeat(factor, 1))
    assert other.scale_px == pytest.approx(factor * one.scale_px)
    assert other.centre_px == pytest.approx(np.multiply(one.centre_px, factor))
    assert overlap(one.mask, other.mask) > 0.9


@given(SEEDS)
def test_a_crop_cleaned_again_stays_as_it_is(seed: int) -> None:
    one = crop_of(blob(200, 260, seed=seed))
    other = crop_of(one.mask)
    assert overlap(one.mask, other.mask) > 0.94
    assert np.allclose(other.centre_px, 32, atol=0.51)
    assert other.scale_px == pytest.approx(32, abs=1)


@given(SEEDS, st.sampled_from([32, 64, 96]))
def test_the_longer_side_is_fill_and_the_middle_the_middle(seed: int, side: int) -> None:
    crop = crop_of(blob(200, 260, seed=seed), side=side).mask / 255
    across, down = crop.max(0), crop.max(1)
    for cover in (across, down):  # as much is free on one side as on the other
        assert np.argmax(cover > 0) == np.argmax(cover[::-1] > 0)
    assert max(across.sum(), down.sum()) == pytest.approx(FILL * side, abs=1.6)


@given(st.floats(8, 60), st.floats(0, 1), st.floats(0, 1))
def test_a_disc_stays_a_disc(radius: float, x: float, y: float) -> None:
    rows, columns = np.mgrid[:140, :150] + 0.5
    mask = (rows - 70 - y) ** 2 + (columns - 70 - x) ** 2 <= radius**2
    crop = crop_of(mask)
    rows, columns = np.mgrid[:64, :64] + 0.5
    ideal = np.clip(FILL * 32 + 0.5 - np.hypot(rows - 32, columns - 32), 0, 1) * 255
    assert overlap(crop.mask, ideal) > 1 - 1.25 / radius
    assert np.allclose(crop.centre_px, (70 + x, 70 + y), atol=0.51)


@given(SEEDS)
def test_a_crop_goes_back_to_where_it_was(seed: int) -> None:
    mask = blob(200, 260, seed=seed)
    crop = crop_of(mask, side=128)
    rows, columns = np.nonzero(mask)
    # each pixel's centre in the crop: centre i of a crop is at (2 i + 1) / side - 1
    places = [
        np.floor(((pixel + 0.5 - centre) / crop.scale_px + 1) / 2 * 128).astype(int)
        for pixel, centre in zip((rows, columns), crop.centre_px[::-1], strict=True)
    ]
    assert (crop.mask[places[0], places[1]] > 0).all()
    area = crop.mask.sum() / 255 * (2 * crop.scale_px / 128) ** 2
    assert area == pytest.approx(mask.sum(), rel=0.03)


def test_a_huge_mask_is_the_crop_of_a_small_one() -> None:
    """Of an object in more than 16 million pixels not all are looked at; what it is and where stays."""
    tall, wide = 2700, 2100

    def ellipse(factor: float) -> Crop:
        y, x = np.ogrid[: round(5800 * factor), : round(4600 * factor)]
        inside = ((y - 2901 * factor) / tall) ** 2 + ((x - 2307 * factor) / wide) ** 2 < factor**2
        if factor == 1:
            inside[5793:, 4593:] = True  # a speck
        found = clean_mask(inside, CleanOptions(side=64, border="keep"))
        assert isinstance(found, Crop)
        return found

    huge, small = ellipse(1), ellipse(0.1)
    assert np.abs(huge.mask.astype(int) - small.mask).mean() < 0.5
    assert huge.centre_px == pytest.approx((2307, 2901), abs=2)
    assert huge.scale_px == pytest.approx(tall / FILL, abs=2)
    assert huge.changes == {"specks"} and not small.changes


def test_any_type_of_mask_is_cut_at_half() -> None:
    mask = blob(seed=3)
    one = crop_of(mask).mask
    soft = np.where(mask, np.float32(0.9), np.float32(0.1))
    soft[0, 0] = np.nan
    for same in (
        mask.astype(np.uint8),
        mask * np.uint8(255),
        mask * np.uint8(38),
        mask * np.uint16(65535),
        mask.astype(np.float64),
        soft,
        np.where(mask, 130, 20) + np.eye(60, 80, dtype=int),
    ):
        assert np.array_equal(crop_of(same).mask, one)


@pytest.mark.parametrize("wrong", [np.zeros((4, 4, 3)), np.zeros(4), np.full((4, 4), "x"), np.zeros((4, 4), complex)])
def test_what_is_no_mask_is_an_error(wrong: np.ndarray) -> None:
    with pytest.raises(UserError, match="expected numbers of shape"):
        covered(wrong)


def test_specks_go_and_small_holes_are_filled_but_real_ones_stay() -> None:
    mask = blob(120, 160, seed=1)
    noisy = mask.copy()
    noisy[5, 5:7] = True
    y, x = np.argwhere(mask).mean(0).astype(int)
    noisy[y, x] = False
    crop = crop_of(noisy)
    assert crop.changes == {"specks", "holes"}
    assert np.array_equal(crop.mask, crop_of(mask).mask)
    real = mask.copy()
    real[y - 4 : y + 4, x - 4 : x + 4] = False
    crop = crop_of(real)
    assert crop.changes == frozenset()
    assert crop_of(mask).mask.sum() - crop.mask.sum() == pytest.approx(64 / crop.scale_px**2 * 32**2 * 255, rel=0.02)


def test_between_the_legs_of_a_chair_it_stays_open() -> None:
    chair = np.zeros((40, 40), bool)
    chair[4:22, 8:11] = True  # back
    chair[20:23, 8:30] = True  # seat
    chair[20:36, 8:10] = chair[20:36, 28:30] = True  # legs
    chair[30:32, 8:30] = True  # the bar between them makes a hole of 7 x 18
    crop = crop_of(chair)
    assert crop.changes == frozenset()
    assert crop.mask[45, 32] == 0  # in the hole


ROUND = blob(60, 80, seed=2)
CUT = ROUND.copy()
CUT[:, :40] = False
CUT = CUT[:, 40:]
TWO = np.zeros((60, 90), bool)
TWO[20:40, 10:30] = TWO[20:40, 50:66] = True
LINE = np.zeros((60, 90), bool)
LINE[30, 10:60] = True
SLANT = np.zeros((900, 900), bool)
SLANT[np.arange(50, 850), np.arange(50, 850)] = True
SMALL = np.zeros((60, 90), bool)
SMALL[30:36, 30:41] = True


@pytest.mark.parametrize(
    ("mask", "reason"),
    [
        (np.zeros((20, 30), bool), "empty"),
        (np.zeros((0, 0), bool), "empty"),
        (np.ones((20, 30)), "full"),
        (CUT, "border"),
        (TWO, "pieces"),
        (SMALL, "small"),
        (LINE, "thin"),
        (SLANT, "thin"),
    ],
)
def test_what_is_refused_and_why(mask: np.ndarray, reason: str) -> None:
    assert clean_mask(mask) == reason
    for turn in (np.fliplr, np.flipud, np.rot90):
        assert clean_mask(turn(mask)) == reason


def test_options_take_what_is_refused_otherwise() -> None:
    kept = crop_of(CUT, border="keep")
    assert kept.changes == {"cut"}
    padded = np.pad(CUT, ((0, 0), (9, 9)))
    assert np.array_equal(kept.mask, crop_of(padded).mask)
    largest = crop_of(TWO, pieces="largest")
    assert largest.changes == {"largest"}
    assert largest.centre_px == (20, 30)
    assert largest.scale_px == pytest.approx(10 / FILL)


def test_a_window_is_as_good_as_the_image() -> None:
    mask = blob(seed=5)
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    tight = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    window = Found("a", tight, corner_px=(int(columns[0]), int(rows[0])), image_size=(80, 60))
    one, other = crop_of(mask), crop_of(window)
    assert np.array_equal(one.mask, other.mask)
    assert (one.centre_px, one.scale_px) == (other.centre_px, other.scale_px)
    assert clean_mask(tight) == "border"
    window.slack_px = float(columns[0])
    assert clean_mask(window) == "border"


def test_the_report_counts_and_names() -> None:
    items = [Found(f"good{n}", blob(seed=n), "cow") for n in range(3)]
    items += [Found(f"empty{n}", np.zeros((9, 9))) for n in range(5)]
    data, report = clean([*items, Found("cut", CUT), Skipped("x.png", "unreadable")], source="here")
    assert data.names == ["good0", "good1", "good2"]
    assert data.category is not None
    assert data.category.tolist() == ["cow"] * 3
    assert data.masks.shape == (3, 64, 64)
    assert report.kept + report.skipped.total() == 10
    assert report.skipped == {"empty": 5, "border": 1, "unreadable": 1}
    assert report.lines()[0] == "5 of 10 masks skipped: empty (empty0, empty1, empty2, ...)"
    assert "border=keep" in report.lines()[1]
    assert "(cut)" in report.lines()[1]


def test_nothing_left_says_why() -> None:
    with pytest.raises(UserError, match=r"here: none of 2 masks can be used: 1: empty \(a\); 1: .*border=keep.* \(b\)"):
        clean([Found("a", np.zeros((9, 9))), Found("b", CUT)], source="here")
    with pytest.raises(UserError, match="none of 0 masks"):
        clean([])


@pytest.mark.parametrize("wrong", [{"side": 7}, {"side": 10**6}, {"side": True}, {"border": "kep"}, {"pieces": "all"}])
def test_options_that_cannot_be(wrong: dict) -> None:
    name = next(iter(wrong))
    with pytest.raises(UserError, match=rf"{name}={wrong[name]}: expected"):
        CleanOptions(**wrong)


def test_every_reason_is_in_words() -> None:
    assert all(text and not text.endswith(".") for text in [*REASONS.values(), *CHANGES.values()])
