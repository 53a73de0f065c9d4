"""A file that appears whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from uplift.errors import UserError

__all__ = ["replacing"]


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path`` and put it in the place of ``path`` once it is complete.

    Whatever goes wrong on the way (a full disk, Ctrl-C) removes the temporary file, leaves what was
    at ``path`` untouched and propagates. Raises UserError where no file can stand at ``path``.
    """
    target = Path(os.path.realpath(Path(path).expanduser()))
    if not target.parent.is_dir():
        raise UserError(f"cannot write {path}: the folder {target.parent} does not exist. Create it first.")
    if target.exists() and not target.is_file():
        raise UserError(f"cannot write {path}: it exists and is not an ordinary file. Choose another name.")
    temporary = target.with_name(f".{target.name[:80]}.{secrets.token_hex(4)}.part")
    try:
        handle = open(temporary, "xb")  # noqa: SIM115 (closed below, before the file is moved)
    except PermissionError as error:
        raise UserError(f"cannot write {path}: no permission to create files in {target.parent}.") from error
    try:
        with handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
