"""Tables in text files: header rows, then rows of numbers and words, read in chunks and checked on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.readers.decimals import PADDING, parse_numbers
from uplift.readers.table_lines import check_memory, chunks, decoded, header_of

__all__ = ["Column", "Table"]

_IN_QUOTES = 0x1F  # what stands for a separator inside quotes until the cells are cut


@dataclass
class Column:
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
        UserError: (as `read` does) no text, rows of different lengths, a cell that is no number where one must be.
    """

    path: Path
    header: list[list[str]]
    separator: str
    numbers: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """(rows, columns) float32 of the columns asked for; NaN where empty."""
    exact: dict[int, np.ndarray] = field(default_factory=dict)
    """Column -> (rows,) float64."""
    words: dict[int, Column] = field(default_factory=dict)
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
        check_memory(path, len(numbers))
        table = cls(path, header, separator, words={place: Column() for place in words})
        taken = _Taken(table, list(numbers), list(exact))
        with path.open("rb") as file:
            for first_line, chunk in chunks(path, file, rows):
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
            # A comma can only be a decimal point where it parts no columns, and then there is no full stop.
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
            raise UserError(f"{self.table.path}, line {lines[row]}: {cell[:40]!r} in the column '{name}' is no number.")
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


def _column(codes: np.ndarray, known: dict[bytes, int]) -> Column:
    """Return the column with its names as text; names that differ in spaces around them only are one."""
    texts = [decoded(name).replace(chr(_IN_QUOTES), ",").strip() for name in known]
    names = list(dict.fromkeys(texts))
    if len(names) < len(texts):
        place = {name: at for at, name in enumerate(names)}
        codes = np.array([place[text] for text in texts], np.int32)[codes]
    return Column(codes, names)
