"""Several processes that train together, the ranks of `torch.distributed`: what each does of a batch, of random numbers and of work.

A step of W ranks is that of one process: each lifts its part of one batch, random numbers are those of the whole batch,
and statistics are sums over all ranks. Sums carry gradients: every rank computes the loss of the whole batch, so its
gradient is W times its own part of the whole one, and the mean over ranks that `DistributedDataParallel` takes is the
whole. On one process nothing here does anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, distributed

from uplift.errors import UserError

__all__ = [
    "Share",
    "alone",
    "drawn",
    "filled",
    "gathered",
    "largest",
    "mean",
    "my_parts",
    "my_rows",
    "own_numbers",
    "rank",
    "rank_0_first",
    "shared",
    "sharing",
    "sum_of_parts",
    "total",
    "work_shared",
    "world",
]

T = TypeVar("T")


def world() -> int:
    """Return how many processes train together."""
    return distributed.get_world_size() if distributed.is_available() and distributed.is_initialized() else 1


def rank() -> int:
    """Return the number of this process among them, from 0."""
    return distributed.get_rank() if world() > 1 else 0


def largest(values: Sequence[float]) -> list[float]:
    """Return the largest of each value over all ranks, which call it together."""
    if world() == 1:
        return list(values)
    found = torch.tensor(values, dtype=torch.float64, device=_device())
    distributed.all_reduce(found, distributed.ReduceOp.MAX)
    return found.tolist()


def _device() -> torch.device:
    """Return the device of numbers that ranks exchange: the processor, unless they have no connection but that of GPUs."""
    return torch.device("cuda" if distributed.get_backend() == "nccl" else "cpu")


@contextmanager
def rank_0_first() -> Iterator[None]:
    """Let others do what is within after rank 0, as what it keeps in a cache serves them too."""
    if rank() > 0:
        distributed.barrier()
    try:
        yield
    finally:
        if world() > 1 and rank() == 0:
            distributed.barrier()


# One batch.


@dataclass(frozen=True)
class Share:
    """This rank's part of a batch."""

    rank: int
    ranks: int
    start: int
    """The first of its rows."""
    count: int
    batch: int
    """Rows of all ranks."""

    @classmethod
    def of(cls, batch: int, rank: int, ranks: int) -> Share:
        """Return the part of a batch of so many rows, pairs of neighbours undivided.

        Raises UserError: fewer than two rows each.
        """
        if batch < 2 * ranks:
            raise UserError(
                f"batch_size={batch} is that of all {ranks} processes together, expected at least {2 * ranks}: two for each."
            )
        start, stop = (2 * (batch // 2 * end // ranks) for end in (rank, rank + 1))
        return cls(rank, ranks, start, (batch if rank == ranks - 1 else stop) - start, batch)

    @classmethod
    def of_given(cls, count: int, rank: int, ranks: int) -> Share:
        """Return the part that rows are which this rank was given, by a loader of a user's own."""
        return cls(rank, ranks, rank * count, count, ranks * count)


_SHARE: ContextVar[Share | None] = ContextVar("share", default=None)


@contextmanager
def sharing(share: Share | None) -> Iterator[None]:
    """Compute within as one part of a batch; None: as one process."""
    before = _SHARE.set(share)
    try:
        yield
    finally:
        _SHARE.reset(before)


def alone():
    """Return a context in which a rank computes the whole batch."""
    return sharing(None)


def shared() -> bool:
    """Return whether a batch is shared out over ranks now."""
    return _SHARE.get() is not None


def my_rows() -> slice:
    """Return which rows of a whole batch are this rank's: all on one process."""
    share = _SHARE.get()
    return slice(None) if share is None else slice(share.start, share.start + share.count)


def drawn(count: int, draw: Callable[[int], Tensor], dim: int = 0) -> Tensor:
    """Return this rank's part of the random numbers that ``draw(number of rows)`` draws for the rows of all ranks.

    Args:
        count: rows of this rank, one batch or several.
        draw: returns a tensor with so many rows.
        dim: the axis of the rows.
    """
    share = _SHARE.get()
    if share is None:
        return draw(count)
    times, rest = divmod(count, share.count)
    if rest:  # of no batch: rows of its own
        return draw(share.ranks * count).narrow(dim, share.rank * count, count)
    whole = draw(times * share.batch)
    dim %= whole.ndim
    return whole.unflatten(dim, (times, share.batch)).narrow(dim + 1, share.start, share.count).flatten(dim, dim + 1)


@contextmanager
def own_numbers() -> Iterator[None]:
    """Draw within, where code knows nothing of ranks, numbers that other ranks do not draw; later ones are as before."""
    share = _SHARE.get()
    if share is None:
        yield
        return
    devices = [torch.cuda.current_device()] if torch.cuda.is_initialized() else []
    with torch.random.fork_rng(devices):
        torch.manual_seed(torch.initial_seed() + 1 + share.rank)
        yield


class _Sum(torch.autograd.Function):
    """The sum over ranks; every rank's result depends on every rank's value, so gradients are summed too."""

    @staticmethod
    def forward(ctx: object, value: Tensor) -> Tensor:
        value = value.clone()
        distributed.all_reduce(value)
        return value

    @staticmethod
    def backward(ctx: object, gradient: Tensor) -> Tensor:
        return _Sum.apply(gradient)  # type: ignore[return-value]


def total(*values: Tensor) -> tuple[Tensor, ...]:
    """Return each value summed over the parts of the batch, in one exchange; gradients reach all parts."""
    if _SHARE.get() is None:
        return values
    flat: Tensor = _Sum.apply(torch.cat([value.flatten() for value in values]))  # type: ignore[assignment]
    parts = flat.split([value.numel() for value in values])
    return tuple(part.view_as(value) for part, value in zip(parts, values, strict=True))


def mean(*values: Tensor) -> tuple[Tensor, ...]:
    """Return the mean over all rows of the batch of numbers () that are means over the rows of each part."""
    share = _SHARE.get()
    if share is None:
        return values
    count = values[0].new_full((), share.count)
    *sums, rows = total(*(value * count for value in values), count)
    return tuple(value / rows for value in sums)


def gathered(value: Float[Tensor, " batch"]) -> Float[Tensor, " whole"]:
    """Return the values of all rows of the batch; gradients reach all parts."""
    share = _SHARE.get()
    if share is None:
        return value
    behind = share.batch - share.start - share.count
    return total(torch.nn.functional.pad(value, (share.start, behind)))[0]


# Work that is shared out: its parts depend on nothing but what all ranks have.

_WORK: ContextVar[bool] = ContextVar("work", default=False)


@contextmanager
def work_shared() -> Iterator[None]:
    """Share out within the work of `my_parts`: all ranks call the same functions with the same data."""
    before = _WORK.set(world() > 1)
    try:
        yield
    finally:
        _WORK.reset(before)


def my_parts(parts: Sequence[T]) -> Sequence[T]:
    """Return the parts that this rank works on: all of them, except where `work_shared`."""
    return parts[rank() :: world()] if _WORK.get() else parts


def filled(values: Float[Tensor, "rows *rest"], parts: Sequence[Tensor]) -> Float[Tensor, "rows *rest"]:
    """Return ``values`` with the rows of each of ``parts`` as the rank left them that had it of `my_parts`, in place."""
    if _WORK.get() and parts:
        for other in range(world()):
            for rows in parts[other :: world()] if other != rank() else ():
                values[rows] = 0
        rows = torch.cat(list(parts))
        values[rows] = sum_of_parts(values[rows])[0]
    return values


def sum_of_parts(*sums: Tensor) -> tuple[Tensor, ...]:
    """Return sums over the parts of all ranks, in place, from those over `my_parts`."""
    if _WORK.get():
        for one in sums:
            distributed.all_reduce(one)
    return sums
