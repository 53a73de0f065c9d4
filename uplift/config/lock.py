"""One command at a time: a lock that whatever ends the process opens."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uplift.errors import UserError

__all__ = ["only_one"]


@contextmanager
def only_one(path: Path, on: str) -> Iterator[None]:
    """Hold a lock, the file ``path``, that is made and removed again; nothing where the system has no such locks.

    Raises UserError where another command is at work ``on`` the same.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    with path.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{on}: another command is at work on it. Wait for that one, or choose another name."
            ) from None
        except OSError:  # a file system without locks
            pass
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
