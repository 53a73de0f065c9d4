"""Work in parts on all threads that PyTorch computes with: small operations gain little from being split up themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TYPE_CHECKING, TypeVar

from uplift.config.progress import progress

if TYPE_CHECKING:
    import torch

__all__ = ["in_threads"]

PartT = TypeVar("PartT")
FoundT = TypeVar("FoundT")


def in_threads(
    function: Callable[[PartT], FoundT], parts: Sequence[PartT], device: torch.device, what: str
) -> list[FoundT]:
    """Return ``function`` of each part, several parts at a time on the processor, each on one thread.

    ``what`` is the work in a few words, for `progress`. Operations of ``function`` release Python's lock, and what it
    writes is its part's own. It computes no gradients, whatever holds outside.
    """
    import torch

    run = torch.no_grad()(function)
    threads = torch.get_num_threads()
    if device.type != "cpu" or min(threads, len(parts)) < 2:
        return [run(part) for part in (progress(parts, what) if len(parts) > 1 else parts)]
    pool = ThreadPoolExecutor(min(threads, len(parts)), initializer=torch.set_num_threads, initargs=(1,))
    try:
        waiting = [pool.submit(copy_context().run, run, part) for part in parts]
        return [one.result() for one in progress(waiting, what)]
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(threads)  # a worker's number is that of every thread that comes later
