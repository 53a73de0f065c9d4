"""The tables of cells.yaml: what each cell trains and is tested on, and where its result is kept."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.accuracy.rigs import RIGS
from benchmarks.machine import ROOT

__all__ = ["RESULTS", "Cell", "Fit", "Target", "cells_of", "place", "read_fit"]

RESULTS = ROOT / "benchmarks" / "results" / "accuracy"

_FIT_KEYS = {"fit", "run", "floor", "train", "test", "tests", "skeleton", "occlusion", "reference"}


@dataclass(frozen=True)
class Target:
    """A test file, with placeholders, and further words of `uplift evaluate`."""

    data: str
    words: str = ""


@dataclass(frozen=True)
class Fit:
    """What a cell trains, or which floor it computes."""

    name: str
    command: str = ""
    """Words of `uplift fit`, or with ``python`` those that follow `python`."""
    python: bool = False
    floor: str | None = None
    """Of `benchmarks.accuracy.floors`: nothing is trained, so there are no minutes and no seeds."""
    train: str = ""
    test: str | None = None
    """The file that `overall` is about; of a fit without one, its own test frames."""
    skeleton: str = ""
    tests: dict[str, Target] = field(default_factory=dict)
    occlusion: bool = False
    reference: str | None = None


@dataclass(frozen=True)
class Cell:
    """A fit with its minutes and its seed; None for a floor."""

    table: str
    fit: Fit
    minutes: float | None
    seed: int | None
    steps: int | None = None
    """In place of minutes: the same training on any machine, however crowded."""

    @property
    def path(self) -> Path:
        """Where the result is kept."""
        if self.seed is None:
            return RESULTS / self.table / f"{self.fit.name}.json"
        return RESULTS / self.table / f"{self.fit.name}_{self.spent}_seed{self.seed}.json"

    @property
    def spent(self) -> str:
        """How long it trains: minutes, or a number of steps."""
        if self.seed is None:
            return "-"
        return f"{self.minutes:g}min" if self.steps is None else f"{self.steps}steps"

    @property
    def budget(self) -> list[str]:
        """The words of `uplift fit` that say so."""
        if self.steps is not None:  # one thread: the figures of fits side by side are then those of each alone
            return ["trainer.max_time=null", f"trainer.max_steps={self.steps}", "trainer.threads=1"]
        seconds = round(60 * (self.minutes or 0))
        return [f"trainer.max_time={seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"]

    def result(self) -> dict[str, Any] | None:
        """Return what was found, None where the cell has not run."""
        return json.loads(self.path.read_text()) if self.path.is_file() else None


def read_fit(name: str, entry: str | dict[str, Any], table: dict[str, Any]) -> Fit:
    """Return a fit of cells.yaml; `test`, `tests`, `occlusion` and `reference` of its table are the defaults.

    Raises:
        ValueError: a key that is not known, or not exactly one of `fit`, `run` and `floor`.
    """
    entry = {"fit": entry} if isinstance(entry, str) else entry
    kinds = [key for key in ("fit", "run", "floor") if key in entry]
    if len(kinds) != 1 or set(entry) - _FIT_KEYS:
        raise ValueError(f"{name}: has {', '.join(entry)}; expected one of fit, run, floor, and of {sorted(_FIT_KEYS)}")
    floor = entry.get("floor")
    if floor and not all(entry.get(key) for key in ("train", "test", "skeleton")):
        raise ValueError(f"{name}: a floor needs train, test and skeleton")
    chosen = {key: entry.get(key, table.get(key)) for key in ("test", "tests", "occlusion", "reference")}
    return Fit(
        name=name,
        command=entry.get("fit") or entry.get("run") or "",
        python="run" in entry,
        floor=floor,
        train=entry.get("train", ""),
        test=place(chosen["test"]) if chosen["test"] else None,
        skeleton=entry.get("skeleton", ""),
        tests={} if floor else {key: _read_test(value) for key, value in (chosen["tests"] or {}).items()},
        occlusion=bool(chosen["occlusion"]) and not floor,
        reference=chosen["reference"],
    )


def _read_test(value: str | dict[str, str]) -> Target:
    return Target(place(value)) if isinstance(value, str) else Target(place(value["data"]), value.get("words", ""))


def place(data: str) -> str:
    """Return a file with its placeholder: that of a rig by its name, else one of the data folder."""
    if data in RIGS:
        return f"{{rigs}}/{data}/test.npz"
    return data if data.startswith("{") else f"{{data}}/{data}"


def cells_of(name: str, table: dict[str, Any], minutes: float | None = None) -> list[Cell]:
    """Return the cells of a table, at ``minutes`` in place of its own; a floor comes once."""
    cells = []
    by_steps = "steps" in table and not minutes
    for spent in [minutes] if minutes else table["steps" if by_steps else "minutes"]:
        for seed in table["seeds"]:
            for key, entry in table["fits"].items():
                fit = read_fit(key, entry, table)
                trained = Cell(name, fit, None, seed, spent) if by_steps else Cell(name, fit, spent, seed)
                cells.append(Cell(name, fit, None, None) if fit.floor else trained)
    return list({cell.path: cell for cell in cells}.values())
