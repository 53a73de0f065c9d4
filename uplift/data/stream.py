"""Training on shards that memory does not hold: random blocks of frames, of which some are resident and change as training goes on.

Which blocks are resident in a step depends on the seed and the step alone, so that a fit that was stopped goes on with
those it had. All ranks hold the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from uplift.config.settings import Settings
from uplift.data.clean import clean
from uplift.data.formats import KEYPOINT_FORMATS, with_options
from uplift.data.formats.base import Peek, ReadOptions
from uplift.data.formats.shards import Outline, Shards
from uplift.data.individuals import by_individuals
from uplift.data.joints import in_joints_of
from uplift.data.load import (
    Loaded,
    cleaned,
    find_data,
    load_data,
    load_split,
    named_set,
    not_simulated,
    read_options,
    with_labels_of,
    with_test,
)
from uplift.data.pieces import cuts
from uplift.data.poses import PoseData
from uplift.data.select import choice_of
from uplift.data.tensors import Batch, TrainingSet
from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["Resident", "Stream", "Streamed", "load_training"]

_BLOCK = 8192
"""Frames of a block at most: what is read at once."""
_LEAST_BLOCKS = 32
"""That are resident, where that leaves blocks of `_LEAST` frames or more."""
_LEAST = 64
_AHEAD = 2
"""Blocks that are read before they are needed."""
_MOST_HELD_OUT = 100_000
"""Frames that validation holds in memory."""

Rows = slice | Int[np.ndarray, " rows"]


@dataclass(frozen=True)
class Stream:
    """The frames of shards that training draws from, a buffer of them at a time."""

    shards: Shards
    skeleton: Skeleton
    options: ReadOptions
    seed: int
    blocks: tuple[tuple[int, Rows], ...]
    """The shard of each block, and its rows there; whole clips, where they are no longer than a block."""
    size: int
    """Frames of a block at most."""
    frames: int
    """Of all blocks."""
    resident: int
    """Blocks in memory at a time."""
    stills: bool = False
    """Whether neighbours in a sequence are no neighbours in time, which is told from the first blocks."""

    @classmethod
    def of(
        cls,
        shards: Shards,
        skeleton: Skeleton,
        options: ReadOptions,
        seed: int,
        buffer: int,
        chosen: Bool[np.ndarray, " frames"] | None = None,
    ) -> Stream:
        """Return the stream of the ``chosen`` frames (None: all) with about ``buffer`` of them in memory."""
        size = max(_LEAST, min(_BLOCK, buffer // _LEAST_BLOCKS))
        blocks = tuple(_blocks(shards, size, chosen))
        frames = len(shards) if chosen is None else int(chosen.sum())
        mean = frames / len(blocks)
        return cls(
            shards, skeleton, options, seed, blocks, size, frames, min(len(blocks), max(2, round(buffer / mean)))
        )

    def number(self, place: int) -> int:
        """Return the block that is the ``place``-th to be read: all of them in random order, then all in another."""
        epoch, place = divmod(place, len(self.blocks))
        return int(_order(self.seed, epoch, len(self.blocks))[place])

    def read(self, number: int) -> PoseData:
        """Return the frames of a block in the skeleton's joints, not cleaned."""
        shard, rows = self.blocks[number]
        found = self.shards.shard(shard, rows) if isinstance(rows, slice) else self.shards.shard(shard).select(rows)
        found = replace(found, masks=None, mask_box=None)  # priors measure them frame by frame before training
        return _in_joints(found, self.skeleton, self.options)

    def sample(self) -> PoseData:
        """Return the blocks that are resident first, which are a random sample of all frames, in their order; not cleaned."""
        numbers = sorted(self.number(place) for place in range(self.resident))
        return PoseData.concat([self.read(number) for number in numbers])

    def usable(self, place: int) -> PoseData:
        """Return the ``place``-th block, cleaned; one after it where none of its frames can be lifted."""
        number, count = self.number(place), len(self.blocks)
        for other in range(number, number + count - 1):
            found = self.read(other % count)
            with suppress(UserError):  # no frame of it can be lifted
                return self._cleaned(found)
        return self._cleaned(self.read((number - 1) % count))

    def _cleaned(self, found: PoseData) -> PoseData:
        return clean(replace(found, stills=self.stills), self.skeleton, jumps=False)[0]

    def held_out(self, share: float) -> tuple[Stream, PoseData]:
        """Return the stream without some blocks, and their frames in the skeleton's joints: a ``share`` of all, but not too many."""
        count = max(1, round(min(share * self.frames, _MOST_HELD_OUT) * len(self.blocks) / self.frames))
        order = np.random.default_rng([self.seed, 1]).permutation(len(self.blocks))
        rest = tuple(self.blocks[number] for number in sorted(order[count:]))
        held = PoseData.concat([self.read(int(number)) for number in sorted(order[:count])])
        frames = self.frames - len(held)
        return replace(self, blocks=rest, frames=frames, resident=min(self.resident, len(rest))), held


def _in_joints(found: PoseData, skeleton: Skeleton, options: ReadOptions) -> PoseData:
    """Return frames of shards in the skeleton's joints; keypoints that are far outside were left out of the shards."""
    return in_joints_of(by_individuals(with_options(found, options), skeleton), skeleton)


def _blocks(shards: Shards, size: int, chosen: np.ndarray | None) -> Iterator[tuple[int, Rows]]:
    """Yield shards and rows of blocks of whole clips, or of pieces of those that are longer than a block."""
    for number, (start, end) in enumerate(pairwise(shards.starts.tolist())):
        rows = np.arange(end - start) if chosen is None else np.flatnonzero(chosen[start:end])
        if not len(rows):
            continue
        clips = shards.clip_starts(number)
        runs = np.unique(np.searchsorted(rows, clips))
        runs = runs[runs < len(rows)]
        ends = cuts(runs, np.arange(len(runs)), len(rows), size) if len(runs) else [0, len(rows)]
        for first, last in pairwise(ends):
            pieces = -(-(last - first) // size)
            for piece in np.array_split(rows[first:last], pieces):
                whole = piece[-1] - piece[0] == len(piece) - 1
                yield number, slice(int(piece[0]), int(piece[-1]) + 1) if whole else piece


@lru_cache(maxsize=4)
def _order(seed: int, epoch: int, blocks: int) -> np.ndarray:
    return np.random.default_rng([seed, 0, epoch]).permutation(blocks)


# The buffer that a module draws from.


@dataclass(frozen=True)
class _Drawn(TrainingSet):
    """Frames that change: what a prior has measured of the rows of the training set is not of these."""

    def draw(self, rows: Int[Tensor, " batch"]) -> Batch:
        """Return the frames of ``rows``, which are those of no training set."""
        return replace(super().draw(rows), row=None)


class Resident:
    """The frames in memory, on one device, in a lifter's units: `frames`, some of which each `advance` replaces.

    Each block has as many rows as the largest, some of its frames twice, so that nothing changes its size.
    """

    def __init__(
        self,
        stream: Stream,
        convert: Callable[[PoseData], TrainingSet],
        *,
        more: TrainingSet | None,
        device: torch.device,
        batch: int,
        step: int,
    ):
        """Read what is resident in ``step``, where ``batch`` frames are drawn in a step; ``more`` frames always stay.

        ``convert`` makes a training set of cleaned frames.
        """
        self.stream, self.convert, self.device = stream, convert, device
        self.every = max(1, stream.size // batch)
        """Steps after which a block is replaced, so that each of its frames was drawn about once for each block's time."""
        self.replaced = step // self.every
        self.pool = ThreadPoolExecutor(1, "uplift-shards")
        self.ahead: deque[Future[TrainingSet]] = deque()
        count = stream.resident
        newest = count - 1 + self.replaced
        first = newest - (newest - np.arange(count)) % count
        parts = [self.block(int(place)) for place in first]
        whole = TrainingSet.concat(parts if more is None else [*parts, more]).to(device)
        self.frames: TrainingSet = _Drawn(**{one.name: getattr(whole, one.name) for one in fields(whole)})
        self._ask()

    def block(self, place: int) -> TrainingSet:
        """Return the ``place``-th block as it is copied into `frames`."""
        found = self.convert(self.stream.usable(place))
        rows = np.arange(self.stream.size)
        if len(found) < len(rows):
            again = np.random.default_rng([self.stream.seed, 2, place]).choice(len(found), len(rows) - len(found))
            rows = np.concatenate([rows[: len(found)], again])
        found = found.select(torch.from_numpy(rows))
        if self.device.type != "cuda":
            return found
        return replace(found, **{name: value.pin_memory() for name, value in _tensors(found)})

    def _ask(self) -> None:
        while len(self.ahead) < _AHEAD:
            place = self.stream.resident + self.replaced + len(self.ahead)
            self.ahead.append(self.pool.submit(self.block, place))

    def advance(self, step: int) -> None:
        """Replace the blocks that are due before ``step``, in place."""
        while self.replaced < step // self.every:
            block = self.ahead.popleft().result()
            first = (self.replaced % self.stream.resident) * self.stream.size
            for name, value in _tensors(block):
                getattr(self.frames, name)[first : first + self.stream.size].copy_(value, non_blocking=True)
            self.replaced += 1
            self._ask()

    def close(self) -> None:
        """Read no more."""
        self.pool.shutdown(wait=False, cancel_futures=True)


def _tensors(frames: TrainingSet) -> Iterator[tuple[str, Tensor]]:
    for one in fields(frames):
        value = getattr(frames, one.name)
        if isinstance(value, Tensor):
            yield one.name, value


# What a fit trains on: what fits into the buffer as any file is, the rest as a stream.


@dataclass(frozen=True)
class Streamed(Loaded):
    """What a fit trains on, where `train` is only what is resident first, a random sample."""

    stream: Stream | None = None

    def with_held_out(self, share: float) -> tuple[Streamed, PoseData]:
        """Return what is left to train on without a ``share`` of the frames, and these, cleaned."""
        assert self.stream is not None
        stream, held = self.stream.held_out(share)
        train, _ = clean(stream.sample(), stream.skeleton)
        return replace(self, train=train, stream=stream), clean(held, stream.skeleton)[0]


def load_training(settings: Settings, skeleton: Skeleton) -> Loaded:
    """Return what `uplift.data.load.load_data` does, of shards of more frames than ``data.buffer`` a `Streamed`.

    Raises:
        UserError: as `load_data`, and more labelled frames than fit into the buffer.
    """
    shards = _large_shards(settings)
    return load_data(settings, skeleton) if shards is None else _Choice(settings, skeleton, shards).loaded()


def _large_shards(settings: Settings) -> Shards | None:
    """Return the shards to train on, if they are more than the buffer."""
    if settings.data.simulate or named_set(settings, "train") is not None:
        return None
    path = find_data(settings, "train")
    if not path.exists() or KEYPOINT_FORMATS.chosen(Peek(path), read_options(settings.data, path)).name != "shards":
        return None
    shards = Shards(path)
    return shards if len(shards) > settings.data.buffer else None


@dataclass(frozen=True)
class _Choice:
    """Which frames of shards a fit trains on, tests on and may learn from."""

    settings: Settings
    skeleton: Skeleton
    shards: Shards

    def loaded(self) -> Loaded:
        """Return the frames, all of them or as a stream."""
        settings, notes = self.settings, not_simulated(self.settings)
        data = settings.data
        outline = self.shards.outline(named=any(map(choice_of, (data.select, data.hold_out, data.labelled))))

        def load(asked: Settings, which: str) -> PoseData:
            own = which == "train" and asked.data.train == settings.data.train
            return outline if own else load_split(asked, which, self.skeleton)

        train, test = with_test(settings, load)
        train, more = with_labels_of(settings, train, load)
        assert isinstance(train, Outline)
        stream, buffer, labelled = None, settings.data.buffer, train.labelled
        if len(train) > buffer:
            if labelled is not None:
                self._refuse_many(int(labelled.sum()), all=bool(labelled.all()))
                train, more = train.select(~labelled), train.select(labelled)
            train, stream = self._stream(train.rows, notes)
        else:
            train = cleaned("train", self._read(train), self.skeleton, notes)
            if labelled is not None:
                notes.append(f"labelled: {int(labelled.sum()):,} of these frames, in 3D")
        more = None if more is None else cleaned("labelled", self._read(more), self.skeleton, notes)
        test = None if test is None else cleaned("test", self._read(test), self.skeleton, notes)
        return Loaded(train, test, notes, more) if stream is None else Streamed(train, test, notes, more, stream)

    def _read(self, frames: PoseData) -> PoseData:
        """Return frames with their keypoints, in the skeleton's joints."""
        if not isinstance(frames, Outline):
            return frames
        found = _in_joints(self.shards.take(frames.rows), self.skeleton, read_options(self.settings.data))
        unit = self.settings.data.unit or found.unit
        return replace(found, labelled=frames.labelled, unit=unit)

    def _stream(self, rows: np.ndarray, notes: list[str]) -> tuple[PoseData, Stream]:
        """Return the frames that are resident first, and the stream of all ``rows``; adds notes on them."""
        settings, chosen = self.settings, None
        if len(rows) < len(self.shards):
            chosen = np.zeros(len(self.shards), bool)
            chosen[rows] = True
        options = read_options(settings.data)
        stream = Stream.of(self.shards, self.skeleton, options, settings.seed, settings.data.buffer, chosen)
        data, report = clean(stream.sample(), self.skeleton)
        part = f"about {len(data):,} of them in memory at a time (data.buffer)"
        notes.append(f"train: {len(rows):,} frames from {data.source}, {part}; notes are on the first of these")
        if any("masks" in shard.arrays for shard in self.shards.shards):
            notes.append("train: masks are not used: priors measure them before the training, and these frames change")
        notes += [*(f"train: {note}" for note in data.notes), *report.lines()]
        return data, replace(stream, stills=data.stills)

    def _refuse_many(self, labelled: int, *, all: bool) -> None:
        """Raise UserError for more labelled frames than memory is meant to hold."""
        buffer = self.settings.data.buffer
        if labelled > buffer or all:
            raise UserError(
                f"{self.shards.path}: {labelled:,} labelled frames, which stay in memory, are more than data.buffer={buffer:,}: "
                "label fewer (data.labelled.fraction), or set a larger data.buffer."
            )
