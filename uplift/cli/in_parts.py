"""Long inputs: one part is read, another lifted and a third written at the same time, in memory that does not grow with the input."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from uplift import __version__
from uplift.cli.inputs import LongInput
from uplift.cli.outputs import can_grow, open_output, write_outputs
from uplift.cli.part_store import PartStore, digest_of, stamps_of
from uplift.cli.pose_summary import Summary
from uplift.cli.request import Request
from uplift.config.files import files_of
from uplift.config.progress import progress
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.export.stream import Stream
from uplift.models.ground import Ground
from uplift.models.model import Model
from uplift.models.parts import Piece, can_be_lifted, lift_piece, pieces
from uplift.models.prediction import Prediction

__all__ = ["lift_in_parts"]

T = TypeVar("T")


def lift_in_parts(
    request: Request,
    model: Model,
    source: LongInput,
    check: Callable[[PoseData], list[str]],
    how: Mapping[str, Any],
) -> tuple[Summary, dict[Path, str]]:
    """Lift an input part by part and write it; return what is said of the poses, and the files with a remark on each.

    Formats that can grow take each part as it comes; others need all poses in memory, and are written at the end.

    Args:
        request, model: what is to be done, and what lifts.
        source: the input.
        check: warnings about the first frames; may raise UserError.
        how: arguments of `Model.predict`.
    """
    growing = [output for output in request.outputs if can_grow(output, request.page)]
    others = [output for output in request.outputs if output not in growing]
    files: dict[Path, str] = {}
    with ExitStack() as stack:
        streams = {
            one: stack.enter_context(open_output(one, request.page, request.axes, request.options)) for one in growing
        }
        cut = not request.ground and not any(stream.of_clips for stream in streams.values())
        made_of = _made_of(request, {"cut": cut, "truth": bool(others)})
        store = stack.enter_context(PartStore(request.outputs[0], made_of, model.skeleton))
        work = _Work(model, source, store, list(streams.values()), check, how, cut, keep_truth=bool(others))
        work.do()
        files |= {Path(output): stream.close() for output, stream in streams.items()}
        if others:
            parts = [store.load(number) for number in range(len(work.summaries))]
            whole = Prediction.concat(parts, notes=work.summary().notes)
            files |= write_outputs(whole, others, request.page, request.axes, request.options)
    return work.summary(), files


@dataclass
class _Work:
    """The parts of one input on their way to its outputs."""

    model: Model
    source: LongInput
    store: PartStore
    streams: list[Stream]
    check: Callable[[PoseData], list[str]]
    how: Mapping[str, Any]
    cut: bool
    """Whether long clips may be: grounds, angles and level axes are those of whole clips."""
    keep_truth: bool
    """Whether an output shows it."""
    summaries: list[Summary] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    _checked: bool = False

    def do(self) -> None:
        """Read, lift and write all parts; raises UserError where none has a frame that can be lifted."""
        cut = not self.how.get("ground") and not any(stream.of_clips for stream in self.streams)
        read = _ahead(pieces(self.source.parts, self.source.at_a_time, cut=cut))
        about = -(-self.source.frames // self.source.at_a_time)
        written: Future[None] | None = None
        with ThreadPoolExecutor(1) as pool:
            for number, piece in enumerate(
                progress(read, f"lifting, {self.source.at_a_time:,} frames at a time", about)
            ):
                self._look_at(piece.data)
                found = None if number in self.store else self._lift(piece)
                if written is not None:
                    written.result()
                written = pool.submit(copy_context().run, self._write, number, found)
            if written is not None:
                written.result()
        if not self._checked:
            self.store.clear()
            raise UserError(
                f"none of {self.source.frames:,} frames can be lifted: all have fewer than 3 visible joints, or these in "
                "one point."
            )

    def summary(self) -> Summary:
        """Return what is said of all parts."""
        note = f"lifted in {len(self.summaries):,} parts of about {self.source.at_a_time:,} frames (docs/output.md)"
        return Summary.joined(self.summaries, [note, *self.warnings])

    def _look_at(self, data: PoseData) -> None:
        """Check the first part that somebody is in."""
        if not self._checked and can_be_lifted(data, self.model.skeleton):
            self.warnings += self.check(data)
            self._checked = True

    def _lift(self, piece: Piece) -> Prediction:
        if not self.keep_truth:
            piece = piece._replace(data=piece.data.without_truth())
        found = lift_piece(partial(self.model.predict, **self.how), piece, self.model.skeleton)
        if not self.how.get("ground") or found.ground is not None or found.root is None or found.gravity is None:
            return found
        nowhere = np.full((len(found), 3), np.nan, np.float32)  # other parts may have clips with a ground
        return replace(found, ground=Ground(nowhere, nowhere.copy(), np.zeros(found.confidence.shape, bool)))

    def _write(self, number: int, found: Prediction | None) -> None:
        """Keep a part, or take one that was kept, and put it into the outputs that grow."""
        if found is None:
            found = self.store.load(number)
        else:
            self.store.save(number, found)
        self.summaries.append(Summary.of(found))
        for stream in self.streams:
            stream.append(found)


def _ahead(items: Iterable[T]) -> Iterator[T]:
    """Yield items; each is made in a thread while the one before is used."""
    rest, end, context = iter(items), object(), copy_context()
    with ThreadPoolExecutor(1) as pool:
        coming: Future[Any] = pool.submit(context.run, next, rest, end)
        while (item := coming.result()) is not end:
            coming = pool.submit(context.run, next, rest, end)
            yield item


_NO_MATTER = ("weights", "input", "output", "axes", "page", "options", "check", "keypoints", "accelerator")
"""Of a request: what parts do not depend on, beside what is told of the input and the lifter by themselves."""


def _made_of(request: Request, more: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the parts of a request are made of, by the names of a message."""
    how = {name: repr(value) for name, value in vars(request).items() if name not in _NO_MATTER}
    paths = files_of(request.input) if _is_there(request.input) else []
    return {
        "input": [str(request.input), stamps_of(paths)],
        "lifter": digest_of(request.weights.path),
        "version of uplift": __version__,
        "options": how | dict(more),
    }


def _is_there(input: str | Path) -> bool:
    """Return whether an input is files, and not a split of a data set."""
    try:
        return bool(files_of(input))
    except UserError:
        return False
