"""What is said while something is done: `say` a text, `progress` of long work, and `quiet`, with less of both."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from tqdm import tqdm

__all__ = ["is_quiet", "progress", "quiet", "say"]

_QUIET = ContextVar("quiet", default=False)


@contextmanager
def quiet(on: bool = True) -> Iterator[None]:
    """Within, `say` tells only warnings and what was written, and `progress` nothing."""
    before = _QUIET.set(on)
    try:
        yield
    finally:
        _QUIET.reset(before)


def is_quiet() -> bool:
    """Return whether `quiet` holds."""
    return _QUIET.get()


def say(text: str) -> None:
    """Print what is done on standard output; where it is `quiet`, ``wrote ...`` alone, and warnings on standard error."""
    if not is_quiet():
        print(text, flush=True)
        return
    for line in text.splitlines():
        if "WARNING" in line:
            print(line, file=sys.stderr, flush=True)
        elif line.startswith("wrote "):
            print(line, flush=True)


_SILENT_S = 2.0
"""Work of less than this shows nothing."""
_LINE_S = 30.0
"""Seconds between lines where the output is no terminal."""

T = TypeVar("T")


def progress(parts: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Yield ``parts`` and show on standard error how many are done and how many a second.

    ``what`` is the work in a few words; ``total`` is how many parts there are, where they do not say it themselves.
    """
    total = len(parts) if total is None and hasattr(parts, "__len__") else total  # type: ignore[arg-type]
    if is_quiet():
        yield from parts
        return
    if sys.stderr.isatty():
        yield from tqdm(parts, what, total, leave=False, delay=_SILENT_S, unit="", dynamic_ncols=True, file=sys.stderr)
        return
    start = last = time.monotonic()
    for done, part in enumerate(parts):
        now = time.monotonic()
        if now - last > _LINE_S:
            last, rest = now, "" if total is None else f" of {total:,}"
            print(f"{what}: {done:,}{rest}, {done / (now - start):.3g} a second", file=sys.stderr, flush=True)
        yield part
