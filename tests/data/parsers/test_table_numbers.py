"""The numbers of a table are those that Python reads one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.parsers.table import Table
from uplift.errors import UserError


@pytest.fixture(scope="module")
def parsed(tmp_path_factory: pytest.TempPathFactory):
    """Return a function that reads a column of cells; it raises UserError, naming the line, for one that is not a number."""
    path: Path = tmp_path_factory.mktemp("tables") / "a.csv"

    def read(cells: list[str]) -> list[float]:
        path.write_text("row;value\n" + "".join(f"{row};{cell}\n" for row, cell in enumerate(cells)))
        return Table.read(path, 1, [], exact=[1]).exact[1].tolist()

    return read


DIGITS = st.text("0123456789", max_size=24)
WRITTEN = st.builds(
    lambda sign, whole, point, share: sign + whole + (point + share if share else ""),
    st.sampled_from(["", "-", "+"]), DIGITS, st.just("."), DIGITS,
).filter(lambda text: any(sign.isdigit() for sign in text))  # fmt: skip


@given(cells=st.lists(WRITTEN | st.floats(allow_nan=False, allow_infinity=False).map(repr), min_size=1, max_size=50))
def test_numbers_are_those_of_float(parsed, cells):
    assert parsed(cells) == [float(cell) for cell in cells]


def test_the_middle_between_two_float32_is_rounded_as_float_does(parsed):
    low = np.random.default_rng(0).random(3000, np.float32)
    middle = (low.astype(float) + np.nextafter(low, np.float32(2)).astype(float)) / 2
    cells = [f"{value:.{digits}f}" for value in middle for digits in (15, 17, 18, 21)]
    assert parsed(cells) == [float(cell) for cell in cells]


@given(cells=st.lists(st.floats(-1e6, 1e6, width=32).map(repr), min_size=1, max_size=30))
def test_a_decimal_comma(parsed, cells):
    assert parsed([cell.replace(".", ",") for cell in cells]) == [float(cell) for cell in cells]


def test_what_stands_for_a_missing_number(parsed):
    assert np.isnan(parsed(["", " ", "nan", "NaN", "NA", "null", "None", "-", "#N/A", "N/a", "nAn"])).all()


@pytest.mark.parametrize(
    "cell", ["abc", "1.2.3", "1_000", "--3", "inf", "-inf", "0x10", ".", "1e", "12 3", "1,5", "١", "True"]
)
def test_other_cells_are_refused(parsed, cell):
    with pytest.raises(UserError, match="line 3: .* in the column 'value' is not a number"):
        parsed(["1.5", cell, "2"] if cell != "1,5" else ["1,5", "1.5", "2"])


@given(cells=st.lists(st.text("0123456789.-+eE, x", max_size=12), min_size=1, max_size=20))
def test_no_text_is_read_as_another_number(parsed, cells):
    for cell in (cell.replace(",", "") for cell in cells):
        try:
            expected = float(cell.strip(" ") or "nan") if cell.strip(" ") not in ("-", "--") else np.nan
        except ValueError:
            with pytest.raises(UserError, match="line 2"):
                parsed([cell])
        else:
            np.testing.assert_array_equal(parsed([cell]), [expected])


def test_a_line_that_is_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uplift.data.parsers.table._LONGEST_LINE", 1 << 20)
    path = tmp_path / "a.csv"
    path.write_text("a,b\n1,2\n" + "3," + "4" * (1 << 20) + "\n")
    with pytest.raises(UserError, match=r"a\.csv, line 3: longer than 1 MB"):
        Table.read(path, 1, [0, 1])
