"""`Stream`: a file that grows part by part, in memory that does not depend on how many parts there are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import ClassVar

import numpy as np

from uplift.config.files import replacing
from uplift.data.samples import Samples
from uplift.errors import UserError, listed
from uplift.export.scene import AS_SEEN, in_axes
from uplift.models.prediction import Prediction

__all__ = ["Stream"]


class Stream(ABC):
    """Base of the formats that can append: predictions go in one after the other, and the file appears with `close`.

    A context manager that closes at the end. Whatever goes wrong before (in `append`, too) removes what was written and
    leaves what was at ``path`` untouched. All parts have the same joints, unit, axes and frame rate, and whole clips where
    `of_clips` says so; an array that a prediction may have is in all parts or in none. The file is the one that
    `uplift.export.write` makes of one prediction with the rows of all parts. ``axes`` are what every part is turned to
    (a clip as a whole, by its gravity); unset, a part stays as it is.
    """

    alike: ClassVar[tuple[str, ...]] = ("joint_names", "unit", "axes", "fps")
    """What is the same in all parts."""
    of_clips: bool = False
    """Whether what is written of a frame depends on its whole clip: then no clip may be cut into several parts."""

    def __init__(self, path: str | Path, axes: str | None = None):
        self.path, self.remark = path, ""
        self._axes = axes
        self.of_clips |= axes not in (None, *AS_SEEN)
        self._parts, self._complete = 0, False
        self._expected: dict[str, object] = {}
        self._stack = ExitStack()
        self._handle = self._stack.enter_context(replacing(path))

    @abstractmethod
    def write_part(self, prediction: Prediction, first: bool) -> None:
        """Write what a part adds to ``self._handle``, before the ``first`` what goes before all."""

    def finish(self) -> str:
        """Write what goes behind all parts; return a remark on the file."""
        return ""

    def append(self, prediction: Prediction) -> None:
        """Add a part, whose arrays are not to be changed before the next part is added or the file closed.

        Raises:
            UserError: other joints, another unit, other axes, another frame rate or other arrays than in the parts before.
            OSError: a full disk, for example.
        """
        if self._handle.closed:
            raise ValueError(f"{self.path} is closed: nothing can be appended")
        try:
            turned = self._axes not in (None, prediction.axes)
            prediction = in_axes(prediction, str(self._axes)) if turned else prediction
            self._check(prediction)
            self.write_part(prediction, not self._parts)
            self._parts += 1
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise

    def close(self) -> str:
        """Complete the file, put it in its place and return a remark on it; once more does nothing.

        Raises UserError where no part was added.
        """
        with self._stack.pop_all():
            if self._handle.closed and not self._complete:
                raise ValueError(f"{self.path} was given up: a part could not be appended")
            if not self._parts:
                raise UserError(f"cannot write {self.path}: there are no poses. Check the input.")
            if not self._complete:
                self.remark, self._complete = self.finish(), True
        return self.remark

    def _check(self, prediction: Prediction) -> None:
        """Raise UserError where a part does not go with the first."""
        found = {name: getattr(prediction, name) for name in self.alike} | _arrays(prediction)
        self._expected = self._expected or found
        for name in {**self._expected, **found}:
            if name in found and name in self._expected and repr(found[name]) == repr(self._expected[name]):
                continue
            now, before = (_shown(values.get(name)) for values in (found, self._expected))
            raise UserError(
                f"{self.path}: part {self._parts + 1} has {now} as '{name}', those before it {before}. Expected the same in "
                "all parts of a file: write another file for it."
            )

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._stack.__exit__(kind, error, trace)


def _arrays(prediction: Prediction) -> dict[str, object]:
    """Return the name of every array that a prediction has, with the size of one row; the truth is in no file."""
    found: dict[str, object] = {}
    for field in fields(prediction):
        value = getattr(prediction, field.name)
        if isinstance(value, np.ndarray) and field.name != "truth":
            found[field.name] = value.shape[1:]
        elif isinstance(value, dict):
            found |= {f"{field.name}.{key}": np.shape(rows)[1:] for key, rows in value.items()}
        elif isinstance(value, Samples):
            found[field.name] = ()
    return found


def _shown(value: object) -> str:
    """Return a fact of a part for a message."""
    if value is None:
        return "nothing"
    if value == ():
        return "values"
    return listed(value, 3) if isinstance(value, tuple) and isinstance(value[0], str) else str(value)
