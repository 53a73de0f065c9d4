"""Tables in text files: header rows, then rows of numbers and words, checked line by line and parsed by pandas."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from uplift.data.parsers.files import check_memory, encoding_of, reason_of
from uplift.errors import UserError

__all__ = ["Table", "Words", "first_lines", "first_rows", "header_of", "safe_cell"]

_START = 1 << 16
_LONGEST_HEADER = 1 << 22
_MOST_COLUMNS = 100_000
"""Twenty animals of 133 keypoints have 8,000."""
_LONGEST_LINE = 1 << 26
_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "nil", "-", "--", "-nan", "<na>"}
_SWAPPED = str.maketrans(",.", ".,")
_FORMULA = re.compile(r"(^|[;,\t\r\n])(?=\s*[=+\-@\uff1d\uff0b\uff0d\uff20]|[\t\r])")
"""Where a cell begins, or would in a spreadsheet with another separator, with what makes it a formula."""
_NUMBER = re.compile(r"[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Words:
    """A column of text."""

    codes: np.ndarray
    """(rows,) place of each row's text in ``names``."""
    names: list[str]
    """Without spaces around them, by first appearance."""

    def values(self) -> np.ndarray:
        """Return (rows,) text."""
        return np.array(self.names, np.str_)[self.codes]


@dataclass(frozen=True)
class Table:
    """The rows of a text file below its header."""

    path: Path
    header: list[list[str]]
    numbers: np.ndarray
    """(rows, columns) float32 of the columns asked for; NaN where empty."""
    exact: dict[int, np.ndarray]
    """Column -> (rows,) float64."""
    words: dict[int, Words]
    lines: np.ndarray
    """(rows,) line numbers in the file, from 1."""
    notes: tuple[str, ...] = ()
    """What was assumed."""

    def __len__(self) -> int:
        return len(self.lines)

    @classmethod
    def read(
        cls, path: Path, rows: int, numbers: Sequence[int], exact: Sequence[int] = (), words: Sequence[int] = ()
    ) -> Table:
        """Read the file below ``rows`` header lines: ``numbers``, ``exact`` and ``words`` are places of columns.

        Raises:
            UserError: no text, no rows, rows longer than the header, a file that ends within a row, or a cell that
                is not a number where one must be.
        """
        check_memory(path, "it", path.stat().st_size)
        header, separator = header_of(path, rows)
        kinds: dict[int, type] = dict.fromkeys(numbers, np.float32) | dict.fromkeys(exact, np.float64)
        with _opened(path) as file:
            lines, skipped, short = _checked_lines(file, path, header, separator)
            if not len(lines):
                raise UserError(f"{path}: no row below the header.")
            options = {
                "sep": separator, "header": None, "names": range(len(header[-1])), "index_col": False,
                "skiprows": skipped, "usecols": sorted({*kinds, *words}),
                "keep_default_na": False, "skipinitialspace": True, "encoding_errors": "surrogateescape",
            }  # fmt: skip
            frame = _parsed(file, kinds, options)
            if frame is None:
                frame = _parsed_one_by_one(file, path, header, lines, kinds, options)
        return cls(
            path,
            header,
            frame[list(numbers)].to_numpy(np.float32),
            {place: frame[place].to_numpy() for place in exact},
            {place: _words(frame[place]) for place in words},
            lines,
            _short_notes(short, lines),
        )


def _opened(path: Path) -> TextIO:
    with path.open("rb") as file:
        encoding = encoding_of(file.read(4))
    return path.open(encoding=encoding, errors="replace" if encoding == "utf-16" else "surrogateescape")  # see `_words`


def _short_notes(short: list[int], lines: np.ndarray) -> tuple[str, ...]:
    """Return the note on rows, by their line, without their last cells."""
    if not short:
        return ()
    return (f"{len(short):,} of {len(lines):,} rows end early (first in line {short[0]}): their last cells are empty",)


def header_of(path: Path, rows: int) -> tuple[list[list[str]], str]:
    """Return the cells of the first lines, without spaces around them, and the separator: comma, semicolon or tab.

    Raises:
        UserError: no text, fewer lines, or rows of different lengths.
    """
    cells, separator = first_rows(path, rows)
    if any(len(row) != len(cells[0]) for row in cells):
        lengths = ", ".join(str(len(row)) for row in cells)
        raise UserError(f"{path}: its first rows have {lengths} cells, expected as many in each.")
    return cells, separator


def first_rows(path: Path, rows: int) -> tuple[list[list[str]], str]:
    """Return what `header_of` does; rows may have different lengths.

    Raises:
        UserError: no text, or fewer lines.
    """
    lines = first_lines(path, rows)
    separator = max(",;\t", key=lambda sign: (lines[0].count(sign), sign == ","))
    columns = max(line.count(separator) for line in lines) + 1
    if columns > _MOST_COLUMNS:
        raise UserError(f"{path}: a table of {columns:,} columns, expected at most {_MOST_COLUMNS:,}.")
    try:
        return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)], separator
    except csv.Error as error:
        raise UserError(f"{path}: the header cannot be read: {error}.") from None


def first_lines(path: Path, rows: int) -> list[str]:
    """Return the first lines that are not blank, however long they are.

    Raises:
        UserError: no text, or fewer lines.
    """
    with path.open("rb") as file:
        start, lines = b"", []
        while len(start) <= _LONGEST_HEADER and len(lines) <= rows and (block := file.read(_START)):
            start += block
            utf16 = encoding_of(start) == "utf-16"
            text = start.decode("utf-16", errors="replace") if utf16 else _decoded(start, cut=True)
            lines = [line for line in text.splitlines() if line.strip()]
    if len(start) > _LONGEST_HEADER and len(lines) < rows:
        raise UserError(f"{path}: its header is longer than {_LONGEST_HEADER >> 20} MB, expected a table.")
    if "\0" in "".join(lines[:rows]):
        raise UserError(f"{path} is not text, expected a table.")
    if len(lines) < rows:
        raise UserError(f"{path}: {len(lines)} lines, expected a header of {rows} and rows below it.")
    return lines[:rows]


def _decoded(text: bytes, *, cut: bool = False) -> str:
    """Return text in UTF-8, or else in Windows' western code; ``cut``: it may end within a letter."""
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if cut and error.start >= len(text) - 4:
            return text[: error.start].decode("utf-8-sig")
        return text.decode("cp1252", errors="replace")


def _checked_lines(
    file: TextIO, path: Path, header: list[list[str]], separator: str
) -> tuple[np.ndarray, list[int], list[int]]:
    """Return the numbers, from 1, of the lines that hold rows, the places, from 0, of header and empty lines, and the
    numbers of rows without their last cells.

    Spreadsheets leave out empty cells at the end of a row; a file that was cut ends within a line. pandas would fill
    both with NaN, read on over line ends in quotes, and end a number at a zero byte.
    """
    lines: list[int] = []
    skipped: list[int] = []
    short: list[int] = []
    above, width, empty = len(header), len(header[-1]), separator + " \r\n"
    for number, line in enumerate(file, 1):
        if len(line) > _LONGEST_LINE:
            raise UserError(f"{path}, line {number}: longer than {_LONGEST_LINE >> 20} MB, expected a table.")
        plain = '"' not in line and "\0" not in line  # nearly all lines: counted here, as a call for each costs as much
        if plain and not above and line.count(separator) == width - 1 and line.strip(empty):
            lines.append(number)
            continue
        blank = not line.strip()
        if blank or above:
            above -= not blank
            skipped.append(number - 1)
            continue
        cells = _cells_in(path, number, line, separator)
        if cells > width or (cells < width and not line.endswith("\n")):
            raise UserError(
                f"{path}, line {number}: {cells} cells, expected {width} as the header has: "
                f"{'two files in one?' if cells > width else 'the file ends within the row. Truncated?'}"
            )
        if not line.strip(empty):
            skipped.append(number - 1)
            continue
        lines.append(number)
        short += [number] if cells < width else []
    return np.array(lines, np.int64), skipped, short


def _cells_in(path: Path, number: int, line: str, separator: str) -> int:
    if "\0" in line:
        raise UserError(f"{path}, line {number}: not text, expected a table.")
    if '"' not in line:
        return line.count(separator) + 1
    if line.count('"') % 2:
        raise UserError(f"{path}, line {number}: a quotation that does not end on its line.")
    try:
        return len(next(csv.reader([line], delimiter=separator, skipinitialspace=True)))
    except csv.Error as error:
        raise UserError(f"{path}, line {number}: {error}.") from None


def _parsed(file: TextIO, kinds: dict[int, type], options: dict[str, Any]) -> Any:
    """Return the columns as a DataFrame, ``kinds`` as numbers and others as text; None where a cell is not a number."""
    import pandas as pd

    dtype: Any = dict.fromkeys(options["usecols"], object) | kinds
    missing = {word for one in _MISSING for word in (one, one.upper(), one.title(), one.replace("nan", "NaN"))}
    # A comma can only be a decimal point where it does not separate columns.
    for decimal in "." if options["sep"] == "," else ".,":
        file.seek(0)
        try:
            with np.errstate(over="ignore"):
                frame = pd.read_csv(
                    file, dtype=dtype, decimal=decimal, na_values=dict.fromkeys(kinds, missing), **options
                )
        except ValueError:
            continue
        if not any(np.isinf(frame[place].to_numpy()).any() for place in kinds):  # "inf", or a very large number
            return frame
    return None


def _parsed_one_by_one(
    file: TextIO,
    path: Path,
    header: list[list[str]],
    lines: np.ndarray,
    kinds: dict[int, type],
    options: dict[str, Any],
) -> Any:
    """Return what `_parsed` does, cell by cell: rare spellings are read, and a cell that is not a number is found."""
    import pandas as pd

    file.seek(0)
    try:
        frame = pd.read_csv(file, dtype=object, na_filter=False, **options)
    except ValueError as error:
        raise UserError(f"{path} cannot be read as a table: {reason_of(error)}.") from None
    frame = frame.fillna("")  # cells that a short row lacks
    commas = options["sep"] != "," and any(frame[place].str.contains(",").any() for place in kinds)
    for place, kind in kinds.items():
        cells = frame[place].str.strip().tolist()
        values = [_number(cell.translate(_SWAPPED) if commas else cell) for cell in cells]
        if None in values:
            row = values.index(None)
            name = " ".join(dict.fromkeys(head[place] for head in header))
            raise UserError(f"{path}, line {lines[row]}: {cells[row][:40]!r} in the column '{name}' is not a number.")
        with np.errstate(over="ignore"):
            frame[place] = np.array(values, np.float64).astype(kind)
    return frame


def _number(cell: str) -> float | None:
    """Return the number of one cell, NaN for the words that stand for a missing one, None for anything else."""
    if _NUMBER.fullmatch(cell):
        return float(cell)
    return np.nan if cell.lower() in _MISSING else None


def _words(column: Any) -> Words:
    import pandas as pd

    codes, texts = pd.factorize(column.fillna(""))  # a short row lacks its last cells
    texts = [_decoded(text.encode(errors="surrogateescape")).strip() for text in texts]
    same, names = pd.factorize(np.array(texts, object))
    return Words(same[codes], names.tolist())


# Tables that are written.


def safe_cell(text: str) -> str:
    """Return a name so that no spreadsheet runs it: an apostrophe before ``= + - @``, tab and return; numbers as they are."""
    return text if _NUMBER.fullmatch(text) else _FORMULA.sub(r"\1'", text)
