"""The lines of a text file that holds a table: its header, and the rest in chunks of whole lines."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from uplift.errors import UserError

__all__ = ["check_memory", "chunks", "decoded", "first_lines", "header_of"]

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
            lines = [line for line in decoded(start).splitlines() if line.strip()]
    if "\0" in "".join(lines[:rows]):
        raise UserError(f"{path} is no text, expected a table.")
    if len(lines) < rows:
        raise UserError(f"{path}: {len(lines)} lines, expected a header of {rows} and rows below it.")
    return lines[:rows]


def decoded(text: bytes) -> str:
    """Return text in UTF-8, or else in Windows' western code."""
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start >= len(text) - 4:  # a letter cut in two by the end of the start
            return text[: error.start].decode("utf-8-sig")
        return text.decode("cp1252", errors="replace")


def check_memory(path: Path, columns: int) -> None:
    """Refuse what cannot fit: each number is a cell of at least one byte and its separator, and becomes four."""
    size = path.stat().st_size
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if columns and size * 2 > memory:
        raise UserError(f"{path} is {size / 1e9:.1f} GB, more than half of this machine's memory. Split it.")


def chunks(path: Path, file: BinaryIO, rows: int) -> Iterator[tuple[int, bytes]]:
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
