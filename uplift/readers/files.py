"""Which files a path on the command line means: one, several with commas, or all that fit a pattern."""

from __future__ import annotations

import glob
from pathlib import Path

from uplift.errors import UserError

__all__ = ["absolute", "files_of"]


def files_of(path: str | Path) -> list[Path]:
    """Return the files or folders that ``path`` names: itself where it exists, else those between commas or that fit ``*``, ``?`` or ``[``.

    Raises:
        UserError: a file that is not there, or a pattern that nothing fits.
    """
    if Path(path).exists():
        return [Path(path)]
    found: list[Path] = []
    for part in str(path).split(","):
        if any(sign in part for sign in "*?["):
            fitting = sorted(Path(name) for name in glob.glob(part))
            if not fitting:
                raise UserError(f"No file fits {part} (looked in {Path(part).absolute().parent}).")
            found += fitting
        elif part:
            found.append(Path(part))
    missing = [one for one in found if not one.exists()]
    if missing or not found:
        where = missing[0] if missing else Path(path)
        raise UserError(f"No file {where} (looked in {where.absolute().parent}).")
    return list(dict.fromkeys(found))


def absolute(path: str) -> str:
    """Return the same files with each path from the root of the file system."""
    if Path(path).expanduser().exists():
        return str(Path(path).expanduser().absolute())
    return ",".join(str(Path(part).expanduser().absolute()) for part in path.split(",") if part)
