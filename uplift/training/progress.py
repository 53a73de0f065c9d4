"""Tell how a fit is going: one line on a terminal, rows in metrics.csv."""

from __future__ import annotations

import csv
import sys
import time
from pathlib import Path
from typing import Any

import lightning as L
from torch import Tensor

from uplift.training.base import LifterTraining
from uplift.training.budget import Budget

__all__ = ["MetricsFile", "Progress"]


class Progress(L.Callback):
    """One line that is rewritten on a terminal; elsewhere a line at every tenth of the stage."""

    def __init__(self, stage: str, budget: Budget, stream: Any = None):
        self.stage, self.budget = stage, budget
        self.stream = stream or sys.stderr
        self._tenth, self._shown = -1, 0.0
        self._smooth: dict[str, float] = {}

    def on_train_batch_end(self, trainer: L.Trainer, module: LifterTraining, *rest: Any) -> None:  # type: ignore[override]
        """Show the line when it is time to."""
        if not trainer.is_global_zero:
            return
        live = self.stream.isatty()
        tenth = int(module.done * 10)
        now = time.monotonic()
        if (live and now - self._shown < 0.5 and not trainer.should_stop) or (not live and tenth == self._tenth):
            return
        self._tenth, self._shown = tenth, now
        for name, value in module.logged.items():
            before = self._smooth.get(name, float(value))
            self._smooth[name] = 0.6 * before + 0.4 * float(value)
        text = self._line(trainer, module)
        self.stream.write(f"\r\033[K{text}" if live else f"{text}\n")
        if live and trainer.should_stop:
            self.stream.write("\n")
        self.stream.flush()

    def _line(self, trainer: L.Trainer, module: LifterTraining) -> str:
        done = module.done
        left = self.budget.spent * (1 - done) / done if done > 0.01 else float("nan")
        clock = f"{int(left) // 60}:{int(left) % 60:02d} left" if left == left else "..."
        losses = "  ".join(f"{name} {value:.3f}" for name, value in list(self._smooth.items())[:8])
        return f"{self.stage:8s} {100 * done:3.0f} %  step {trainer.global_step:,}  {clock}  {losses}"


class MetricsFile(L.Callback):
    """Append a row of losses and prior metrics to ``metrics.csv`` every ``every`` steps.

    The file is long: stage, step, name, value. Rows after the step that a fit resumes from are
    taken out first, so that an unbroken and a resumed fit leave the same file.
    """

    def __init__(self, path: Path, stage: str, every: int):
        self.path, self.stage, self.every = path, stage, every

    def on_train_start(self, trainer: L.Trainer, module: Any) -> None:
        """Take out what a killed process wrote after its last checkpoint."""
        if not trainer.is_global_zero:
            return
        rows = read_metrics(self.path)
        kept = [r for r in rows if r[0] != self.stage or int(r[1]) <= trainer.global_step]
        with open(self.path, "w", newline="") as file:
            csv.writer(file).writerows([["stage", "step", "name", "value"], *kept])

    def on_train_batch_end(self, trainer: L.Trainer, module: LifterTraining, *rest: Any) -> None:  # type: ignore[override]
        """Append rows when it is time to."""
        if not trainer.is_global_zero or trainer.global_step % self.every:
            return
        values: dict[str, float | Tensor] = dict(module.logged)
        values |= module.more_metrics()
        with open(self.path, "a", newline="") as file:
            writer = csv.writer(file)
            for name, value in values.items():
                writer.writerow([self.stage, trainer.global_step, name, f"{float(value):.6g}"])
        for logger in trainer.loggers:
            logger.log_metrics({f"{self.stage}/{k}": float(v) for k, v in values.items()}, trainer.global_step)


def read_metrics(path: Path) -> list[list[str]]:
    """Return the rows of a metrics.csv without its header; a line cut short by a kill is left out."""
    if not path.is_file():
        return []
    with open(path, newline="") as file:
        return [row for row in csv.reader(file) if len(row) == 4 and row[1].isdigit()]
