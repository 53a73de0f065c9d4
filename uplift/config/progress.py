"""`progress`, how far long work is: a bar in a terminal, plain lines elsewhere, nothing for short work."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tqdm import tqdm

__all__ = ["progress"]

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
