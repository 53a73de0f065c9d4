"""Many keypoint files, read by several processes where that is worth their start."""

from __future__ import annotations

import os
import signal
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

from uplift.config.progress import progress
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData

__all__ = ["read_each"]

_WORTH = 60_000_000
"""Bytes of files that take longer to read than processes to start."""
_FOLDER = 1_000_000
"""Bytes that a folder is taken to hold."""


def read_each(files: Sequence[Path], options: ReadOptions | None, workers: int | None = None) -> Iterator[PoseData]:
    """Yield what `uplift.data.formats.read` makes of each file, in their order.

    By several processes, where there are several files of some size; no more than a few files are read ahead.

    Args:
        files: keypoint files or folders.
        options: what the user says of them.
        workers: processes; None: one for each core, if this process is uplift's own command. In a program of a user's
            a process that starts would run the program again.

    Raises:
        UserError: as `read`, of the first file that is wrong.
    """
    count = min(len(files), (_usual() if workers is None else workers))
    own = options is not None and options.format is not None and ":" in options.format  # trusted in this process alone
    if count < 2 or own or (workers is None and sum(map(_size, files)) < _WORTH):
        yield from (read(one, options) for one in progress(files, "reading files"))
        return
    pool = ProcessPoolExecutor(count, get_context("spawn"), _ignore_interrupts)
    try:
        rest = iter(files)
        ahead: deque[Future[PoseData]] = deque(pool.submit(read, one, options) for one in islice(rest, 2 * count))
        for _ in progress(files, "reading files"):
            found = ahead.popleft().result()
            ahead.extend(pool.submit(read, one, options) for one in islice(rest, 1))
            yield found
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the process that waits for this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _usual() -> int:
    started = Path(getattr(sys.modules["__main__"], "__file__", None) or "")
    ours = started.stem == "uplift" or started.parts[-3:] == ("uplift", "cli", "main.py")
    return len(os.sched_getaffinity(0)) if ours and hasattr(os, "sched_getaffinity") else 1


def _size(path: Path) -> int:
    """Return the bytes of a file, or about those of a folder."""
    return path.stat().st_size if path.is_file() else _FOLDER
