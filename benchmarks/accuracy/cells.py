"""The tables of cells.yaml: what each cell trains and is tested on, and where its result is stored."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.accuracy.rigs import MADE
from benchmarks.common import ROOT, max_time

__all__ = ["PROBES", "RESULTS", "Cell", "Fit", "Target", "cells_of", "place", "read_fit"]

RESULTS = ROOT / "benchmarks" / "results" / "accuracy"

PROBES = ("occlusion", "mended", "video")
"""Modules of this folder that measure more of a run; the key of the same name turns one on."""
_FIT_KEYS = {"fit", "run", "floor", "train", "test", "tests", "skeleton", "reference", *PROBES}


@dataclass(frozen=True)
class Target:
    """A test file, with placeholders, and further arguments of `uplift evaluate`."""

    data: str
    words: str = ""


@dataclass(frozen=True)
class Fit:
    """What a cell trains, or which baseline it computes."""

    name: str
    command: str = ""
    """Arguments of `uplift fit`, or with ``python`` those of `python`."""
    python: bool = False
    floor: str | None = None
    """A baseline of `benchmarks.accuracy.floors`: nothing is trained, so it has no minutes and no seeds."""
    train: str = ""
    test: str | None = None
    """The file on which `overall` is evaluated; default: the test frames of the fit."""
    skeleton: str = ""
    tests: dict[str, Target] = field(default_factory=dict)
    probes: tuple[str, ...] = ()
    """Those of `PROBES` that are wanted."""
    reference: str | None = None


@dataclass(frozen=True)
class Cell:
    """A fit with its minutes and its seed; both are None for a baseline."""

    table: str
    fit: Fit
    minutes: float | None
    seed: int | None
    steps: int | None = None
    """Instead of minutes: the same training on any machine, whatever its load."""

    @property
    def path(self) -> Path:
        """The file of the result."""
        if self.seed is None:
            return RESULTS / self.table / f"{self.fit.name}.json"
        return RESULTS / self.table / f"{self.fit.name}_{self.spent}_seed{self.seed}.json"

    @property
    def spent(self) -> str:
        """The training time: minutes, or a number of steps."""
        if self.seed is None:
            return "-"
        return f"{self.minutes:g}min" if self.steps is None else f"{self.steps}steps"

    @property
    def budget(self) -> list[str]:
        """The arguments of `uplift fit` that limit the training time."""
        if self.steps is not None:  # one thread, so that fits running in parallel do not affect each other
            return ["trainer.max_time=null", f"trainer.max_steps={self.steps}", "trainer.threads=1"]
        return [max_time(self.minutes or 0)]

    def result(self) -> dict[str, Any] | None:
        """Return the stored result, None if the cell has not run."""
        return json.loads(self.path.read_text()) if self.path.is_file() else None


def read_fit(name: str, entry: str | dict[str, Any], table: dict[str, Any]) -> Fit:
    """Return a fit of cells.yaml; `test`, `tests`, `reference` and probes default to those of its table.

    Raises:
        ValueError: an unknown key, or not exactly one of `fit`, `run` and `floor`.
    """
    entry = {"fit": entry} if isinstance(entry, str) else entry
    kinds = [key for key in ("fit", "run", "floor") if key in entry]
    if len(kinds) != 1 or set(entry) - _FIT_KEYS:
        raise ValueError(
            f"{name}: has {', '.join(entry)}; expected one of fit, run, floor, and keys of {sorted(_FIT_KEYS)}"
        )
    floor = entry.get("floor")
    if floor and not all(entry.get(key) for key in ("train", "test", "skeleton")):
        raise ValueError(f"{name}: a floor needs train, test and skeleton")
    chosen = {key: entry.get(key, table.get(key)) for key in ("test", "tests", "reference", *PROBES)}
    return Fit(
        name=name,
        command=entry.get("fit") or entry.get("run") or "",
        python="run" in entry,
        floor=floor,
        train=entry.get("train", ""),
        test=place(chosen["test"]) if chosen["test"] else None,
        skeleton=entry.get("skeleton", ""),
        tests={} if floor else {key: _read_test(value) for key, value in (chosen["tests"] or {}).items()},
        probes=() if floor else tuple(name for name in PROBES if chosen[name]),
        reference=chosen["reference"],
    )


def _read_test(value: str | dict[str, str]) -> Target:
    return Target(place(value)) if isinstance(value, str) else Target(place(value["data"]), value.get("words", ""))


def place(data: str) -> str:
    """Return a file with its placeholder: the rigs' folder for a rig (RIG or RIG/SPLIT), else the data folder."""
    rig, _, split = data.partition("/")
    if rig in MADE:
        return f"{{rigs}}/{rig}/{split or 'test'}.npz"
    return data if data.startswith("{") else f"{{data}}/{data}"


def cells_of(name: str, table: dict[str, Any], minutes: float | None = None) -> list[Cell]:
    """Return the cells of a table, with ``minutes`` instead of the table's if given; a baseline appears once."""
    cells = []
    by_steps = "steps" in table and not minutes
    for spent in [minutes] if minutes else table["steps" if by_steps else "minutes"]:
        for seed in table["seeds"]:
            for key, entry in table["fits"].items():
                fit = read_fit(key, entry, table)
                trained = Cell(name, fit, None, seed, spent) if by_steps else Cell(name, fit, spent, seed)
                cells.append(Cell(name, fit, None, None) if fit.floor else trained)
    return list({cell.path: cell for cell in cells}.values())
