"""Tables in text files: header rows, then rows of numbers and words, read in chunks and checked on the way."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from uplift.data.parsers.files import check_memory
from uplift.errors import UserError

__all__ = ["PADDING", "Table", "first_lines", "header_of", "parse_numbers"]

# Numbers out of text, all cells of a table at once: as exact as Python's own, in a tenth of the time.

PADDING = 24
"""Bytes that stand before the text, so that what comes before a number can be looked at."""
_ZEROS, _BYTES = np.uint64(0x3030303030303030), np.uint64(0x000000FF000000FF)
_TENS = 10.0 ** np.arange(23)
_WHOLE_TENS = 10 ** np.arange(19, dtype=np.int64)
_MISSING = {b"", b"nan", b"na", b"n/a", b"#n/a", b"null", b"none", b"nil", b"-", b"--", b"-nan", b"<na>"}
_NUMBER = re.compile(rb"[+-]?(\d+[.]?\d*|[.]\d+)([eE][+-]?\d{1,6})?")


def parse_numbers(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells' numbers as float64, NaN for empty ones and the usual words, and the places of the other cells.

    ``text`` is bytes (uint8) that begin with `PADDING`; ``point`` is the sign before decimals. Each number,
    rounded to float32, is the one that ``float`` gives; as float64 it may be the neighbour of it.
    """
    starts, ends = _without_spaces(text, starts, ends)
    first = text[starts]
    negative = first == ord("-")
    from_ = starts + (negative | (first == ord("+")))
    value, plain = _plain(text, from_, ends, point)
    np.negative(value, where=negative, out=value)
    empty = starts == ends
    value[empty] = np.nan
    bad = []
    for place in np.flatnonzero(~(plain | empty)).tolist():
        cell = text[starts[place] : ends[place]].tobytes()
        number = _one(cell, point)
        if number is None:
            bad.append(place)
        else:
            value[place] = number
    return value, np.array(bad, np.int64)


def _without_spaces(text: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not (text == 32).any():
        return starts, ends
    starts, ends = starts.copy(), ends.copy()
    while (space := (text[starts] == 32) & (starts < ends)).any():
        starts += space
    while (space := (text[ends - 1] == 32) & (starts < ends)).any():
        ends -= space
    return starts, ends


def _plain(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers that are digits and at most one point, and which cells are such."""
    dot, once = _points(text, starts, ends, point)
    before = dot - starts
    after = np.maximum(ends - dot - 1, 0)
    plain = once & (before >= 0) & (before <= 8) & (after <= 22) & (before + after > 0)
    before, after = np.where(plain, before, 0), np.where(plain, after, 0)
    whole, good = _eight(text, dot, before)
    plain &= good
    share, good = _digits(text, ends, after)
    plain &= good
    # More digits than 64 bits hold are left to Python, which is right and slow.
    plain &= (after <= 18) | (whole == 0)
    plain &= whole.astype(np.float64) * _TENS[after] < 4e18
    mantissa = whole * _WHOLE_TENS[np.minimum(after, 18)] + share
    value = mantissa / _TENS[after]
    return value, plain & ~_between(value, mantissa)


def _points(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where each cell's first point is, or its end where it has none, and which have no second."""
    dots = np.flatnonzero(text == point)
    if len(dots) == len(starts) and (dots >= starts).all() and (dots < ends).all():
        return dots, np.ones(len(dots), bool)
    first = np.searchsorted(dots, starts)
    dots = np.append(dots, [len(text), len(text)])
    return np.minimum(dots[first], ends), dots[np.minimum(first + 1, len(dots) - 1)] >= ends


def _between(value: np.ndarray, mantissa: np.ndarray) -> np.ndarray:
    """Return where float64 is not exact, and so near the middle of two float32 that rounding could go wrong."""
    tail = value.view(np.int64) & 0x1FFFFFFF
    return (mantissa >= 2**53) & (np.abs(tail - 0x10000000) < 8)


def _digits(text: np.ndarray, ends: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number that so many digits before ``ends`` make, and which were digits and not too many."""
    value, plain = _eight(text, ends, np.minimum(count, 8))
    factor, done, most = 10**8, 8, int(count.max(initial=0))
    while done < most:
        more, good = _eight(text, ends - done, np.clip(count - done, 0, 8))
        plain &= good
        if done == 16:
            plain &= more < 100
            more = np.where(more < 100, more, 0)
        value = value + more * factor
        factor, done = factor * 10**8, done + 8
    return value, plain


def _eight(text: np.ndarray, ends: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number that up to eight digits before ``ends`` make, and which were digits.

    Eight bytes are one integer of 64 bits, whose digits are added up in pairs, fours and eight
    (Lemire 2018, https://lemire.me/blog/2018/10/03/quickly-parsing-eight-digits).
    """
    words = np.ndarray((len(text) - 7,), "<u8", text, 0, (1,))
    others = (64 - 8 * count).view(np.uint64)
    eight = words[ends - 8]
    eight ^= _ZEROS
    eight >>= others  # by 64, NumPy makes it 0
    eight <<= others
    other = eight + np.uint64(0x7676767676767676)  # in place from here on: new arrays cost more than the sums
    other |= eight
    other &= np.uint64(0x8080808080808080)
    digits = other == 0
    np.right_shift(eight, np.uint64(8), out=other)
    eight *= np.uint64(10)
    eight += other
    np.right_shift(eight, np.uint64(16), out=other)
    eight &= _BYTES
    eight *= np.uint64(0x000F424000000064)
    other &= _BYTES
    other *= np.uint64(0x0000271000000001)
    eight += other
    eight >>= np.uint64(32)
    return eight.view(np.int64), digits


def _one(cell: bytes, point: int) -> float | None:
    """Return the number of one cell, NaN for the words that stand for a missing one, None for anything else."""
    if point != ord("."):
        cell = cell.replace(b".", b"x").replace(bytes([point]), b".")
    if _NUMBER.fullmatch(cell):
        return float(cell)
    return np.nan if cell.lower() in _MISSING else None


# The lines of a text file that holds a table: its header, and the rest in chunks of whole lines.

_CHUNK = 1 << 17  # so that what is made of one stays near the processor
_START = 1 << 16
_LONGEST_HEADER = 1 << 24
_LONGEST_LINE = 1 << 26


def header_of(path: Path, rows: int) -> tuple[list[list[str]], str]:
    """Return the cells of the first lines, without spaces around them, and the separator: comma, semicolon or tab.

    Raises:
        UserError: no text, fewer lines, or rows of different lengths.
    """
    lines = first_lines(path, rows)
    separator = max(",;\t", key=lambda sign: (lines[0].count(sign), sign == ","))
    try:
        cells = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    except csv.Error as error:
        raise UserError(f"{path}: the header cannot be read: {error}.") from None
    if any(len(row) != len(cells[0]) for row in cells):
        lengths = ", ".join(str(len(row)) for row in cells)
        raise UserError(f"{path}: its first rows have {lengths} cells, expected as many in each.")
    return cells, separator


def first_lines(path: Path, rows: int) -> list[str]:
    """Return the first lines that are not blank, however long they are.

    Raises:
        UserError: no text, or fewer lines.
    """
    with path.open("rb") as file:
        start, lines = b"", []
        while len(start) <= _LONGEST_HEADER and len(lines) <= rows and (block := file.read(_START)):
            start += block
            lines = [line for line in _decoded(start).splitlines() if line.strip()]
    if "\0" in "".join(lines[:rows]):
        raise UserError(f"{path} is not text, expected a table.")
    if len(lines) < rows:
        raise UserError(f"{path}: {len(lines)} lines, expected a header of {rows} and rows below it.")
    return lines[:rows]


def _decoded(text: bytes) -> str:
    """Return text in UTF-8, or else in Windows' western code."""
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start >= len(text) - 4:  # a letter cut in two by the end of the start
            return text[: error.start].decode("utf-8-sig")
        return text.decode("cp1252", errors="replace")


def _chunks(path: Path, file: BinaryIO, rows: int) -> Iterator[tuple[int, bytes]]:
    """Yield (number of its first line, whole lines) of the file below so many lines that are not blank."""
    rest, line, skipped = b"", 1, 0
    while block := file.read(_CHUNK):
        if line == 1 and not rest:
            block = block.removeprefix(b"\xef\xbb\xbf")
        rest += block
        if rest.endswith(b"\r"):
            rest += file.read(1)
        if b"\r" in rest:
            rest = rest.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        cut = rest.rfind(b"\n") + 1
        if len(rest) > _LONGEST_LINE and not cut:
            raise UserError(f"{path}, line {line}: longer than {_LONGEST_LINE >> 20} MB, expected a table.")
        whole, rest = rest[:cut], rest[cut:]
        while skipped < rows and whole:
            first, _, whole = whole.partition(b"\n")
            skipped, line = skipped + bool(first.strip()), line + 1
        if whole:
            yield line, whole
            line += whole.count(b"\n")
    if rest.strip() and skipped >= rows:
        yield line, rest + b"\n"


# The rows below the header, a chunk at a time.

_IN_QUOTES = 0x1F  # what stands for a separator inside quotes until the cells are cut


@dataclass
class _Column:
    """A column of words: row -> place in ``names``, which are in the order of their first appearance."""

    codes: np.ndarray = field(default_factory=lambda: np.empty(0, np.int32))
    names: list[str] = field(default_factory=list)

    def values(self) -> np.ndarray:
        """Return (rows,) text."""
        return np.array(self.names, np.str_)[self.codes] if self.names else np.empty(0, "U1")


@dataclass
class Table:
    """The rows of a text file below its header.

    Raises:
        UserError: (as `read` does) no text, rows of different lengths, a cell that is not a number where one must be.
    """

    path: Path
    header: list[list[str]]
    separator: str
    numbers: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """(rows, columns) float32 of the columns asked for; NaN where empty."""
    exact: dict[int, np.ndarray] = field(default_factory=dict)
    """Column -> (rows,) float64."""
    words: dict[int, _Column] = field(default_factory=dict)
    lines: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    """(rows,) line numbers in the file, from 1."""

    def __len__(self) -> int:
        return len(self.lines)

    @classmethod
    def read(
        cls, path: Path, rows: int, numbers: Sequence[int], exact: Sequence[int] = (), words: Sequence[int] = ()
    ) -> Table:
        """Read the file below ``rows`` header lines: ``numbers``, ``exact`` and ``words`` are places of columns."""
        header, separator = header_of(path, rows)
        if numbers:  # each is a cell of a byte and its separator at least, and becomes four bytes
            check_memory(path, "it", path.stat().st_size)
        table = cls(path, header, separator, words={place: _Column() for place in words})
        taken = _Taken(table, list(numbers), list(exact))
        with path.open("rb") as file:
            for first_line, chunk in _chunks(path, file, rows):
                taken.add(first_line, chunk)
        return taken.finished()


class _Taken:
    """What has been read of a table so far."""

    def __init__(self, table: Table, numbers: list[int], exact: list[int]):
        self.table, self.places, self.count = table, numbers + exact, len(numbers)
        self.exact = exact
        self.width = len(table.header[-1])
        self.separator = ord(table.separator)
        self.point = 0  # not known yet
        self.numbers: list[np.ndarray] = []
        self.doubles: list[np.ndarray] = []
        self.lines: list[np.ndarray] = []
        self.codes: dict[int, list[np.ndarray]] = {place: [] for place in table.words}
        self.known: dict[int, dict[bytes, int]] = {place: {} for place in table.words}

    def add(self, first_line: int, chunk: bytes) -> None:
        """Take in whole lines."""
        if b'"' in chunk:
            chunk = self._unquoted(first_line, chunk)
        text = np.frombuffer(bytes(PADDING) + chunk + bytes(8), np.uint8)
        starts, ends, lines = self._cells(text, first_line)
        if not len(lines):
            return
        self.lines.append(lines)
        self._add_numbers(text, starts[:, self.places], ends[:, self.places], lines)
        for place, known in self.known.items():
            pairs = zip((starts[:, place] - PADDING).tolist(), (ends[:, place] - PADDING).tolist(), strict=True)
            codes = [known.setdefault(chunk[a:b], len(known)) for a, b in pairs]
            self.codes[place].append(np.array(codes, np.int32))

    def finished(self) -> Table:
        """Return the table with all that was taken in."""
        table = self.table
        if not self.lines:
            raise UserError(f"{table.path}: no row below the header.")
        table.lines = np.concatenate(self.lines)
        table.numbers = np.concatenate(self.numbers)
        doubles = np.concatenate(self.doubles)
        table.exact = {place: doubles[:, at] for at, place in enumerate(self.exact)}
        table.words = {place: _column(np.concatenate(self.codes[place]), known) for place, known in self.known.items()}
        return table

    def _cells(self, text: np.ndarray, first_line: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (rows, columns) places where cells start and end, and (rows,) line numbers; blank rows are left out."""
        ends = np.flatnonzero((text == self.separator) | (text == 10))
        starts = np.concatenate([[PADDING], ends[:-1] + 1])
        last = np.flatnonzero(text[ends] == 10)
        count = np.diff(last, prepend=-1)
        lines = first_line + np.arange(len(last))
        blank = (count == 1) & (ends[last] - starts[last] < 1) & (self.width > 1)
        wrong = (count != self.width) & ~blank
        if wrong.any():
            at = int(np.argmax(wrong))
            raise UserError(
                f"{self.table.path}, line {lines[at]}: {count[at]} cells, expected {self.width} as the header has: "
                "truncated, or two files in one?"
            )
        if blank.any():
            keep = np.repeat(~blank, count)
            starts, ends, lines = starts[keep], ends[keep], lines[~blank]
        starts, ends = starts.reshape(-1, self.width), ends.reshape(-1, self.width)
        full = ends[:, -1] - starts[:, 0] >= self.width  # more in it than separators
        return (starts, ends, lines) if full.all() else (starts[full], ends[full], lines[full])

    def _add_numbers(self, text: np.ndarray, starts: np.ndarray, ends: np.ndarray, lines: np.ndarray) -> None:
        if not self.point:
            # A comma can only be a decimal point where it parts no columns, and then there is not a full stop.
            self.point = ord(",") if self.separator != ord(",") and not self._has_stop(text, starts, ends) else ord(".")
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = self._parsed(text, starts[:, : self.count], ends[:, : self.count], lines, self.places)
            self.numbers.append(numbers.astype(np.float32))
        self.doubles.append(self._parsed(text, starts[:, self.count :], ends[:, self.count :], lines, self.exact))

    def _parsed(
        self, text: np.ndarray, starts: np.ndarray, ends: np.ndarray, lines: np.ndarray, places: list[int]
    ) -> np.ndarray:
        values, bad = parse_numbers(text, starts.ravel(), ends.ravel(), self.point)
        if len(bad):
            row, place = divmod(int(bad[0]), starts.shape[1])
            cell = text[starts[row, place] : ends[row, place]].tobytes().decode(errors="replace")
            name = " ".join(dict.fromkeys(head[places[place]] for head in self.table.header))
            raise UserError(
                f"{self.table.path}, line {lines[row]}: {cell[:40]!r} in the column '{name}' is not a number."
            )
        return values.reshape(starts.shape)

    def _has_stop(self, text: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> bool:
        cells = zip(starts[:200].ravel().tolist(), ends[:200].ravel().tolist(), strict=True)
        return not any(b"," in text[a:b].tobytes() for a, b in cells)

    def _unquoted(self, first_line: int, chunk: bytes) -> bytes:
        """Return the lines without their quotes; separators inside become signs that part nothing."""
        text = np.frombuffer(chunk, np.uint8)
        quote = text == ord('"')
        inside = (np.cumsum(quote) & 1).astype(bool)
        if inside[-1] or (inside & (text == 10)).any():
            line = first_line + int((text[: int(np.argmax(inside & (text == 10)))] == 10).sum())
            raise UserError(f"{self.table.path}, line {line}: a quotation that does not end on its line.")
        text = np.where(inside & (text == self.separator), np.uint8(_IN_QUOTES), text)
        return text[~quote].tobytes()


def _column(codes: np.ndarray, known: dict[bytes, int]) -> _Column:
    """Return the column with its names as text; names that differ in spaces around them only are one."""
    texts = [_decoded(name).replace(chr(_IN_QUOTES), ",").strip() for name in known]
    names = list(dict.fromkeys(texts))
    if len(names) < len(texts):
        place = {name: at for at, name in enumerate(names)}
        codes = np.array([place[text] for text in texts], np.int32)[codes]
    return _Column(codes, names)
