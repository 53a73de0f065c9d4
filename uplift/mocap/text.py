"""Lines of a motion capture file, and errors that say in which of them something is wrong."""

from __future__ import annotations

from pathlib import Path

from uplift.errors import UserError

__all__ = ["MOST", "fault", "numbers", "read_lines", "shown"]

MOST = 1e9
"""No length or angle of a motion is as large."""


def read_lines(path: Path, what: str) -> list[bytes]:
    """Return the lines of a text file without their ends.

    Raises:
        UserError: no text, or a file that cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}).") from error
    if b"\0" in content:
        raise UserError(f"{path}: this is no text, expected {what}.")
    if not content.strip():
        raise UserError(f"{path}: empty, expected {what}.")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")


def fault(path: Path, line: int, message: str) -> UserError:
    """Return the error for line ``line`` (the first is 1) of ``path``."""
    return UserError(f"{path}, line {line}: {message}")


def shown(line: bytes, most: int = 40) -> str:
    """Return what is in a line, short and printable, in quotes."""
    text = line.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= most else text[:most] + "...")


def numbers(path: Path, line: int, words: list[bytes], count: int, what: str) -> list[float]:
    """Return the first ``count`` words as finite numbers; raises UserError where they are not."""
    try:
        found = [float(word) for word in words[:count]]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(number) < MOST for number in found):
        raise fault(path, line, f"{what} is {shown(b' '.join(words))}, expected {count} number{'s' * (count > 1)}.")
    return found
