"""`Sweep`, the folder of a sweep: its grid, the settings that all fits share, a run for each, and what became of them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

from uplift.config.files import Existing, building, data_root, replacing
from uplift.config.grid import Axis, Cell, cells_of
from uplift.config.loading import classes_of, load_settings, plain_task, put_override, task_path
from uplift.config.run import SWEEP, RunFolder, new_name, runs_of
from uplift.config.settings import Settings
from uplift.config.trust import trust_words
from uplift.config.yaml_file import read_yaml
from uplift.errors import UserError

__all__ = ["Outcome", "Sweep", "check_values"]


@dataclass(frozen=True)
class Outcome:
    """What became of one fit of a sweep."""

    error: str = ""
    """In one line; empty for a fit that is finished."""
    steps: int = 0
    seconds: float = 0.0
    """Of training."""
    scores: Mapping[str, float] = field(default_factory=dict)
    """`uplift.metrics.score_2d.score_2d` and its parts, lower is better; nothing where there is none."""
    scored_on: str = ""
    """The frames of the score, or why there is none."""


class Sweep:
    """A sweep on disk. `create` makes a new one, `open` finds one that is there.

    The folder has ``sweep.yaml`` with the grid and the command, ``task.yaml`` with the settings that all fits share, a
    run folder for each fit, in ``cells/`` what became of it and what it said, and at the end the tables.
    """

    def __init__(self, path: Path, task: str, words: Sequence[str], axes: Sequence[Axis]):
        self.path, self.task, self.words, self.axes = path, task, list(words), list(axes)
        self.cells = cells_of(axes)
        self.now: list[str] = []
        """Settings ``sweep.NAME`` as words that hold for this time alone."""

    @classmethod
    def create(
        cls, first: Settings, task: str | None, words: Sequence[str], axes: Sequence[Axis], command: str
    ) -> Sweep:
        """Make ``runs/<task>/sweep_<time>/`` in the current folder for the grid, whose ``first`` settings are given."""
        shared = _shared(task, words)
        base, stamp, number = runs_of(first.task, first.skeleton), f"sweep_{new_name()}", 1
        grid = {axis.key: [_absolute(axis.key, value) for value in axis.values] for axis in axes}
        named = [f"task={task}"] if task else []
        facts = {"command": command, "task": first.task, "words": [*named, *words], "grid": grid}
        while True:
            path = base / (stamp if number == 1 else f"{stamp}_{number}")
            with suppress(Existing), building(path) as made:
                for name, content in ((SWEEP, facts), ("task.yaml", shared)):
                    (made / name).write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), "utf-8")
                (made / "cells").mkdir()
                break
            number += 1
        return cls.open(path)

    @classmethod
    def open(cls, path: str | Path) -> Sweep:
        """Return the sweep in the folder ``path``; raises UserError where there is none."""
        path = Path(path).resolve()
        if not (path / SWEEP).is_file():
            raise UserError(f"{path} is not a sweep: it has no {SWEEP}.")
        found, _ = read_yaml(path / SWEEP, "sweep")
        grid = found.get("grid") if isinstance(found, dict) else None
        if not isinstance(grid, dict) or not all(isinstance(values, list) for values in grid.values()):
            raise UserError(
                f"{path / SWEEP} is not what a sweep writes: 'grid' has no list of values for each setting."
            )
        axes = [Axis(str(key), tuple(map(str, values))) for key, values in grid.items()]
        words = found.get("words")
        return cls(path, str(found.get("task", "")), words if isinstance(words, list) else [], axes)

    def settings_of(self, cell: Cell) -> Settings:
        """Return the settings of a fit of the grid."""
        settings = load_settings(str(self.path / "task.yaml"), [*cell.words, *self.now])
        settings.task = self.task
        return settings

    def run_of(self, cell: Cell) -> RunFolder | None:
        """Return the run of a fit; None where it has not begun."""
        run = RunFolder(self.path / cell.name)
        return run if run.config.is_file() else None

    def command_of(self, cell: Cell) -> str:
        """Return the command of the fit alone."""
        fixed = [str(word) for word in self.words if not str(word).startswith("sweep.")]
        return shlex.join(["uplift", "fit", *fixed, *cell.words])

    def outcome(self, cell: Cell) -> Outcome | None:
        """Return what became of a fit; None where it has not ended."""
        path = self._outcome_path(cell)
        try:
            found = json.loads(path.read_bytes())
            return Outcome(**found)
        except FileNotFoundError:
            return None
        except (ValueError, TypeError, OSError) as error:
            raise UserError(f"{path} is not what a sweep writes: remove it, and the fit runs again.") from error

    def put_outcome(self, cell: Cell, outcome: Outcome) -> None:
        """Write what became of a fit."""
        with replacing(self._outcome_path(cell)) as file:
            file.write(json.dumps(asdict(outcome), indent=1).encode())

    def _outcome_path(self, cell: Cell) -> Path:
        return self.path / "cells" / f"{cell.name}.json"

    def log_of(self, cell: Cell) -> Path:
        """Return the file of what a fit said."""
        return self.path / "cells" / f"{cell.name}.txt"

    def forget_failures(self) -> None:
        """Let fits that failed run again."""
        for cell, _ in self.failed():
            self._outcome_path(cell).unlink()

    def finished(self) -> list[tuple[Cell, Outcome]]:
        """Return the fits that are finished, each with its outcome."""
        return [(cell, one) for cell in self.cells if (one := self.outcome(cell)) is not None and not one.error]

    def failed(self) -> list[tuple[Cell, Outcome]]:
        """Return the fits that failed, each with its outcome."""
        return [(cell, one) for cell in self.cells if (one := self.outcome(cell)) is not None and one.error]

    def left(self) -> list[Cell]:
        """Return the fits that have not ended."""
        return [cell for cell in self.cells if self.outcome(cell) is None]

    def trust_words(self) -> str:
        """Return the words that a command on the sweep needs, `` trust=...``; empty where it runs no other code."""
        uses = [use for cell in self.cells[:1] for use in classes_of(asdict(self.settings_of(cell))).values()]
        uses += [value for axis in self.axes for value in axis.values if ":" in value and axis.key.endswith("use")]
        words = trust_words(uses)
        return f" {words}" if words else ""


def check_values(task: str | None, words: Sequence[str], axes: Sequence[Axis]) -> None:
    """Raise UserError for a value of the grid that a fit would refuse; each is tried with the first of the others."""
    first = {axis.key: axis.values[0] for axis in axes}
    for axis in axes:
        # Of many numbers the ends are checked, which is where a range ends.
        for value in axis.values[1:] if len(axis.values) <= _CHECKED else _ends(axis.values):
            load_settings(task, [*words, *(f"{key}={one}" for key, one in (first | {axis.key: value}).items())])


_CHECKED = 16


def _ends(values: Sequence[str]) -> list[str]:
    """Return the values that are no numbers, and the least and the greatest of the others."""
    numbers: list[str] = []
    others: list[str] = []
    for value in values:
        try:
            float(value)
            numbers.append(value)
        except ValueError:
            others.append(value)
    return others + ([min(numbers, key=float), max(numbers, key=float)] if numbers else [])


def _shared(task: str | None, words: Sequence[str]) -> dict[str, Any]:
    """Return the plain settings that all fits share, with the paths that they have from here."""
    plain = plain_task(task, words)
    data = plain.setdefault("data", {})
    if not data.get("root"):  # the fits find their data from any folder, whatever UPLIFT_DATA is then
        named = str(data.get("name") or "")
        if named:
            data["root"] = str(data_root(named, None).absolute())
        elif task:
            data["root"] = str(task_path(task).parent.absolute())
    return plain


def _absolute(key: str, value: str) -> str:
    """Return a value with its paths, relative to the current folder, absolute."""
    plain: Any = {}
    put_override(plain, f"{key}={value}")
    for part in key.split("."):
        plain = plain.get(part) if isinstance(plain, dict) else None
    return plain if isinstance(plain, str) and ("/" in plain or "\\" in plain) else value
