"""Numbers read all at once are those that Python reads one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.parsers.table import PADDING, parse_numbers


def parsed(cells: list[str], point: str = ".") -> tuple[list[float], list[int]]:
    text = np.frombuffer(bytes(PADDING) + b"".join(cell.encode() + b";" for cell in cells), np.uint8)
    ends = np.cumsum([len(cell.encode()) + 1 for cell in cells]) - 1 + PADDING
    starts = np.concatenate([[PADDING], ends[:-1] + 1])
    values, bad = parse_numbers(text, starts, ends, ord(point))
    return values.tolist(), bad.tolist()


def same(ours: float, theirs: float) -> bool:
    with np.errstate(over="ignore"):
        return bool(np.float32(ours) == np.float32(theirs)) and abs(ours - theirs) <= math.ulp(theirs)


DIGITS = st.text("0123456789", max_size=24)
WRITTEN = st.builds(
    lambda sign, whole, point, share: sign + whole + (point + share if share else ""),
    st.sampled_from(["", "-", "+"]), DIGITS, st.just("."), DIGITS,
).filter(lambda text: any(sign.isdigit() for sign in text))  # fmt: skip


@given(st.lists(WRITTEN | st.floats(allow_nan=False, allow_infinity=False).map(repr), min_size=1, max_size=50))
def test_numbers_are_those_of_float(cells):
    values, bad = parsed(cells)
    assert not bad
    for cell, value in zip(cells, values, strict=True):
        theirs = float(cell)
        assert same(value, theirs) or value == theirs, cell


def test_the_middle_between_two_float32_is_rounded_as_float_does():
    low = np.random.default_rng(0).random(3000, np.float32)
    middle = (low.astype(float) + np.nextafter(low, np.float32(2)).astype(float)) / 2
    cells = [f"{value:.{digits}f}" for value in middle for digits in (15, 17, 18, 21)]
    values, bad = parsed(cells)
    assert not bad
    np.testing.assert_array_equal(np.float32(values), np.float32([float(cell) for cell in cells]))


@given(st.lists(st.floats(-1e6, 1e6, width=32).map(repr), min_size=1, max_size=30))
def test_a_decimal_comma(cells):
    values, bad = parsed([cell.replace(".", ",") for cell in cells], ",")
    assert not bad
    np.testing.assert_array_equal(np.float32(values), np.float32([float(cell) for cell in cells]))


def test_what_stands_for_a_missing_number():
    values, bad = parsed(["", " ", "nan", "NaN", "NA", "null", "None", "-", "#N/A"])
    assert np.isnan(values).all()
    assert not bad


@pytest.mark.parametrize("cell", ["abc", "1.2.3", "1_000", "--3", "inf", "-inf", "0x10", ".", "1e", "12 3", "1,5", "١"])
def test_what_is_no_number_is_said_to_be_none(cell):
    values, bad = parsed(["1.5", cell, "2"])
    assert bad == [1]
    assert values[0] == 1.5
    assert values[2] == 2


@given(st.lists(st.text("0123456789.-+eE, x", max_size=12), min_size=1, max_size=20))
def test_no_text_is_read_as_another_number(cells):
    cells = [cell.replace(",", "") for cell in cells]
    values, bad = parsed(cells)
    for place, (cell, value) in enumerate(zip(cells, values, strict=True)):
        try:
            theirs = float(cell.strip(" ") or "nan")
        except ValueError:
            theirs = None if cell.strip(" ") not in ("-", "--") else np.nan
        if theirs is None:
            assert place in bad, cell
        else:
            assert place not in bad
            assert same(value, theirs) or value == theirs or (np.isnan(value) and np.isnan(theirs)), cell
