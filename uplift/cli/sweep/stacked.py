"""The fits of a sweep as stacked networks, which train together: those that differ in nothing else than a stack can."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout

from uplift.cli.failures import RUN_VARIABLE
from uplift.cli.sweep.cell import outcome_of
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.cli.sweep.processes import processes, workers_of
from uplift.config.grid import Cell
from uplift.config.loading import load_settings
from uplift.config.progress import say
from uplift.config.run import RunFolder
from uplift.config.trust import Consent
from uplift.errors import UserError

__all__ = ["stacks", "stacks_of"]

_MOST = 64
"""Networks of a stack, where ``sweep.workers`` does not say how many: more take more memory, and are hardly faster."""


def stacks(sweep: Sweep, cells: Sequence[Cell], consent: Consent, workers: int) -> Iterator[Cell]:
    """Train the fits in stacks of at most ``workers`` networks, and those that no stack can have in processes.

    Yield each when it has ended.
    """
    left, alone = {cell.name for cell in cells}, list[Cell]()
    groups, reason = stacks_of(sweep, workers or _MOST)
    if reason:
        say(f"not in one stack: {reason}")
    for number, group in enumerate(groups):
        # A stack that was interrupted goes on as it was; fits that are left of one go on alone.
        if len(group) > 1 and all(cell.name in left for cell in group):
            try:
                yield from _stack(sweep, group, f"stack_{workers or _MOST}_{number}")
                continue
            except UserError as error:
                say(f"not in a stack, so one by one: {error}")
        alone += [cell for cell in group if cell.name in left and sweep.outcome(cell) is None]
    if alone:
        yield from processes(sweep, alone, consent, workers_of(sweep.settings_of(alone[0]), len(alone)))


def stacks_of(sweep: Sweep, most: int) -> tuple[list[list[Cell]], str]:
    """Return the fits of the grid that can be stacks, at most so many in each, and a reason why not all are one."""
    from uplift.training.stack import stackable

    first, apart, reason = sweep.settings_of(sweep.cells[0]), [], ""
    for axis in sweep.axes:
        others = [sweep.cells[0].values | {axis.key: value} for value in axis.values[1:]]
        words = [[f"{key}={value}" for key, value in one.items()] for one in others]
        task = str(sweep.path / "task.yaml")
        why = stackable([first, *(load_settings(task, one) for one in words)])
        if axis.key == "init" or first.init:
            why = "a fit that starts from a lifter (init=) has its network"
        if why is not None:
            apart.append(axis.key)
            reason = reason or why
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for cell in sweep.cells:
        groups.setdefault(tuple(cell.values[key] for key in apart), []).append(cell)
    return [group[at : at + most] for group in groups.values() for at in range(0, len(group), most)], reason


def _stack(sweep: Sweep, group: Sequence[Cell], name: str) -> Iterator[Cell]:
    """Train fits as one stack and write what became of each; raises UserError for fits that cannot be one."""
    from uplift.cli.fit import fit_stack
    from uplift.training.callbacks import Interrupted

    runs = [_run_of(sweep, cell) for cell in group]
    os.environ[RUN_VARIABLE] = str(sweep.path / "cells")
    settings = [run.settings() for run in runs]
    say(f"a stack of {len(group):,} networks")
    trained = fit_stack(settings, runs, sweep.path / "cells" / name)
    try:
        for cell, run in zip(group, runs, strict=True):
            # The report of each is for its log; how training goes is shown, on standard error.
            with open(sweep.log_of(cell), "a", encoding="utf-8") as log, redirect_stdout(log):
                error = next(trained)
                outcome = Outcome(error=str(error)) if error else outcome_of(sweep, cell, run)
            sweep.put_outcome(cell, outcome)
            yield cell
    except Interrupted:
        raise KeyboardInterrupt from None
    finally:
        for run in runs:
            run.discard_if_empty()


def _run_of(sweep: Sweep, cell: Cell) -> RunFolder:
    run = sweep.run_of(cell)
    return run or RunFolder.create(sweep.settings_of(cell), sweep.command_of(cell), sweep.path / cell.name)
