"""`DataSet`: what a published set is called, which of its files are wanted, and how they become `PoseData`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from uplift.data.container import PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["DataSet", "WantedFile"]


@dataclass(frozen=True)
class WantedFile:
    """A file that a split is read from."""

    path: Path
    what: str
    """What it holds and where it comes from, in a few words."""

    @property
    def present(self) -> bool:
        """Whether it is there."""
        return self.path.is_file()


class DataSet:
    """Subclass this, write `files` and `read`, and name the class in a task: ``data.use=my_set.py:MySet``.

    Options are keyword arguments of ``__init__`` with defaults, set as ``data.options``.
    """

    title: ClassVar[str] = ""
    """As people call it."""
    about: ClassVar[str] = ""
    """A few lines: where it comes from, what it may be used for, which files go where."""
    splits: ClassVar[tuple[str, ...]] = ("train", "test")
    version: ClassVar[int] = 1
    """Raised when the same files come out otherwise: what was cached before is then read anew."""
    cached: ClassVar[bool] = True
    """Whether reading takes long enough to keep the result."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    def files(self, split: str) -> list[WantedFile]:
        """Return the files that `read` opens for ``split``, whether they are there or not."""
        raise NotImplementedError(f"{type(self).__name__} has no files(self, split)")

    def read(self, split: str) -> PoseData:
        """Return the frames of ``split`` in the set's own joints, by name; every file of `files` is there.

        Raises:
            UserError: a file that is damaged, or another one than it should be.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read(self, split)")

    def check_split(self, split: str) -> None:
        """Refuse a split that the set does not have."""
        if split not in self.splits:
            raise UserError(f"{self.title} has no split '{split}'.{did_you_mean(split, self.splits)}")

    def missing(self, split: str) -> list[WantedFile]:
        """Return the files of ``split`` that are not there."""
        return [file for file in self.files(split) if not file.present]
