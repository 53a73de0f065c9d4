"""Use as many CPU threads as pay: all of them on a quiet machine, one on a crowded one."""

from __future__ import annotations

import time
from typing import Any

import lightning as L
import torch

__all__ = ["Threads"]

_PROBE_STEPS = 4
_EVERY_S = 20.0


class Threads(L.Callback):
    """Now and then times a few steps with all threads and a few with one, and goes on with the faster.

    Small products are split over threads that wait for each other: where another process holds a
    core, two threads can be ten times slower than one. Every probe is a step of the training, so
    nothing is lost by it; but the last digits depend on the number of threads, so fits that count
    steps and not time leave it alone.
    """

    def __init__(self) -> None:
        self.most = torch.get_num_threads()
        self._times: dict[int, list[float]] = {}
        self._queue: list[int] = []
        self._next = 0.0
        self._start = 0.0

    def on_train_batch_start(self, trainer: Any, module: Any, batch: Any, batch_idx: int) -> None:
        """Set the threads of this step where it is a probe."""
        now = time.perf_counter()
        if not self._queue and now >= self._next:
            self._times = {}
            self._queue = [self.most] * _PROBE_STEPS + [1] * _PROBE_STEPS
        if self._queue:
            torch.set_num_threads(self._queue[0])
        self._start = time.perf_counter()

    def on_train_batch_end(self, *rest: Any) -> None:
        """Note how long a probe took; after the last one keep the faster number."""
        if not self._queue:
            return
        threads = self._queue.pop(0)
        self._times.setdefault(threads, []).append(time.perf_counter() - self._start)
        if not self._queue:
            typical = {n: sorted(times)[len(times) // 2] for n, times in self._times.items()}
            torch.set_num_threads(min(typical, key=lambda n: typical[n]))
            self._next = time.perf_counter() + _EVERY_S

    def on_train_end(self, *rest: Any) -> None:
        """Give the rest of the program all threads again."""
        torch.set_num_threads(self.most)
