"""What is fitted: one `Cell` for each command, family and seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["COMMANDS", "FAMILIES", "TASK", "Cell", "cells_of"]

TASK = "masks_demo"
FAMILIES = ("chairs", "furniture", "vehicles", "animals")
COMMANDS = ("demo", "families", "twin", "semi", "animals")
"""Commands that fit; `cost` measures steps."""


@dataclass(frozen=True)
class Cell:
    """One fit: a task with words over it."""

    name: str
    """Of the row it belongs to; its seeds are one row."""
    seed: int
    task: str = TASK
    words: tuple[str, ...] = ()
    minutes: float | None = None
    """Of training; None: as long as the task says."""
    animals: bool = False
    """Whether the masks are those of `benchmarks.shapes.animals`."""

    @property
    def spent(self) -> str:
        """The budget, as tables show it."""
        return "task's" if self.minutes is None else f"{self.minutes:g}min"

    @property
    def key(self) -> str:
        """What the result is kept under."""
        budget = "" if self.minutes is None else f"_{self.spent}"
        return f"{self.name}{budget}_seed{self.seed}"

    @property
    def overrides(self) -> list[str]:
        """The words of `uplift fit` behind the task."""
        words = [*self.words, f"seed={self.seed}"]
        if self.minutes is not None:
            seconds = round(60 * self.minutes)
            words.append(f"trainer.max_time={seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}")
        return words


def cells_of(command: str, seeds: Sequence[int], minutes: float | None = None) -> list[Cell]:
    """Return the fits of a command, seed by seed, so that every row has its first figures early."""
    rows = {
        "demo": [("demo", TASK, ())],
        "families": [(f"family_{family}", TASK, (f"data.family={family}",)) for family in FAMILIES],
        "twin": [("twin", TASK, ("data.labelled.fraction=1", "data.labelled.only=true"))],
        "semi": [("semi", "masks_semi", ())],
        "animals": [("animals", "masks_animals", ())],
    }[command]
    return [
        Cell(name, seed, task, words, minutes, animals=command == "animals")
        for seed in seeds
        for name, task, words in rows
    ]
