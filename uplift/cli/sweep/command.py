"""The command ``uplift fit`` with several values of settings: start or go on with a sweep, say how it goes and what it found."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from uplift.cli.kinds import Later
from uplift.cli.sweep.folder import Outcome, Sweep, check_values
from uplift.cli.sweep.processes import gpus, workers_of
from uplift.cli.sweep.table import best_of, lines_of, words_of, write_tables
from uplift.config.grid import Cell, split_grid
from uplift.config.loading import load_settings
from uplift.config.progress import say
from uplift.config.run import link
from uplift.config.settings import Settings, seconds_of
from uplift.config.trust import Trust, consent_of, consents, granted
from uplift.data.load import find_data, set_of
from uplift.errors import UserError

__all__ = ["resume_sweep", "start_sweep", "sweep"]


@consents
def sweep(task: str | None = None, *overrides: str, resume: str | Path | None = None, trust: Trust = None) -> Sweep:
    """Train a fit for each value of settings that have several, as ``uplift fit`` does, and return the sweep.

    Example::

        found = uplift.sweep("demo", "seed=0..3", "lifter.options.units=128,256", "trainer.max_steps=500")
        model = uplift.load(found.path / "best")

    ``overrides`` are ``key=value`` texts, some with lists or ranges (`uplift.config.grid.split_grid`). With ``resume`` a
    sweep that was interrupted goes on. ``trust`` is as for `uplift.fit`.

    Raises:
        UserError: settings that are wrong, none with several values, data that are missing, or an error that all fits have;
            what goes wrong in some of them is in their `Outcome`.
        KeyboardInterrupt: Ctrl-C; all that was under way is saved, and can be resumed.
    """
    if resume is not None:
        return resume_sweep(resume, overrides)
    if not split_grid(overrides)[1]:
        raise UserError(
            "a sweep needs a setting with several values, such as seed=0..3. For a single fit there is `fit`."
        )
    return start_sweep(task, overrides, f"uplift ({Path(sys.argv[0]).name})")


def start_sweep(task: str | None, overrides: Sequence[str], command: str) -> Sweep:
    """Train the grid of ``overrides``, some of which have several values, in a new folder."""
    words, axes = split_grid(overrides)
    fits, grid = (
        math.prod(len(axis.values) for axis in axes),
        " x ".join(f"{one.key} ({len(one.values):,})" for one in axes),
    )
    with granted(consent_of(f"{axis.key}={value}" for axis in axes for value in axis.values)):
        first = load_settings(task, [*words, *(f"{axis.key}={axis.values[0]}" for axis in axes)])
        _check(first, fits, grid)
        check_values(task, words, axes)
        if first.trainer.threads is None and _how(first, fits)[0] in ("processes", "slurm", "ray") and not gpus(first):
            words.append("trainer.threads=1")  # fits at the same time share the cores
        made = Sweep.create(first, task, words, axes, command)
        say(f"uplift fit: {made.task or 'own data'}, a sweep of {fits:,} fits: {grid}")
        return _go_on(made)


def resume_sweep(folder: str | Path, words: Sequence[str] = ()) -> Sweep:
    """Go on with a sweep: finished fits are kept, interrupted ones go on, failed ones begin again."""
    other = [word for word in words if not word.startswith("sweep.")]
    if other:
        raise UserError(
            f"resume=SWEEP goes on with the settings of the sweep: give it no others, found {other[0]}. sweep.how, sweep.workers "
            "and sweep.options may be new."
        )
    found = Sweep.open(folder)
    found.now = list(words)
    found.forget_failures()
    left, fits = len(found.left()), len(found.cells)
    say(f"uplift fit: {found.task or 'own data'}, a sweep with {left:,} of its {fits:,} fits left")
    return _go_on(found)


def _check(first: Settings, fits: int, grid: str) -> None:
    """Refuse what would go wrong in every fit, before there is a folder."""
    trainer, most = first.trainer, first.sweep.most
    if fits > most:
        raise UserError(f"{grid}: {fits:,} fits, more than sweep.most={most}. If you mean it, add sweep.most={fits}.")
    if (trainer.devices.isdigit() and int(trainer.devices) > 1) or trainer.flags.get("num_nodes", 1) != 1:
        raise UserError(
            "a fit of a sweep is one process on one device: leave out trainer.devices and trainer.num_nodes. sweep.workers is how "
            "many fits run at a time."
        )
    if any(os.environ.get(name, "1") != "1" for name in ("WORLD_SIZE", "SLURM_STEP_NUM_TASKS")):
        raise UserError(
            "a sweep starts its own processes, and this is one of several: run it without torchrun or srun."
        )
    for which in ("train", "test"):
        if getattr(first.data, which) and first.lifts == "keypoints" and set_of(first, which) is None:
            find_data(first, which)


# Running.

_HOW = {
    "here": Later("uplift.cli.sweep.processes:here"),
    "processes": Later("uplift.cli.sweep.processes:processes"),
    "stack": Later("uplift.cli.sweep.stacked:stacks"),
    "slurm": Later("uplift.cli.sweep.clusters:slurm_jobs"),
    "ray": Later("uplift.cli.sweep.clusters:ray_tasks"),
}


def _how(settings: Settings, fits: int) -> tuple[str, int]:
    """Return where so many fits run, one of `_HOW`, and how many at a time; 0 for as many as a cluster takes."""
    if settings.sweep.how in ("slurm", "ray", "stack"):
        return settings.sweep.how, settings.sweep.workers or 0
    if settings.sweep.how == "auto" and fits > 1 and gpus(settings):
        return "stack", settings.sweep.workers or 0
    workers = workers_of(settings, fits)
    return ("here" if workers == 1 and settings.sweep.how == "auto" else "processes"), workers


def _go_on(made: Sweep) -> Sweep:
    """Train what is left of a sweep, write its tables and say what it found."""
    settings, left = made.settings_of(made.cells[0]), made.left()
    how, workers = _how(settings, len(left))
    say("\n".join(_plan(made, settings, how, workers)))
    try:
        with _terminable(), granted() as consent:
            _run(made, left, _HOW[how](made, left, consent, workers), workers)
    except KeyboardInterrupt:
        write_tables(made)
        ended, words = len(made.cells) - len(made.left()), f"resume={os.path.relpath(made.path)}{made.trust_words()}"
        print(
            f"\nstopped and saved, {ended:,} of {len(made.cells):,} fits have ended. Go on with: uplift fit {words}",
            file=sys.stderr,
        )
        raise
    files = write_tables(made)
    errors = {outcome.error for _, outcome in made.failed()}
    if len(errors) == 1 and len(made.failed()) == len(made.cells):
        if not any(made.run_of(cell) for cell in made.cells):  # nothing to go on with
            shutil.rmtree(made.path)
        raise UserError(f"all fits failed: {errors.pop()}")
    _link(made)
    say("\n".join([*lines_of(made), "", *(f"wrote {os.path.relpath(file)}" for file in files)]))
    return made


def _plan(made: Sweep, settings: Settings, how: str, workers: int) -> list[str]:
    """Return how the fits that are left run, and where."""
    threads, left = settings.trainer.threads, len(made.left())
    ways = {
        "here": "one after another",
        "processes": f"{workers:,} at a time",
        "stack": "as stacked networks",
        "slurm": "jobs of a SLURM array",
        "ray": "tasks of Ray",
    }
    lines = [ways[how] + ("" if threads is None else f", each on {threads} thread{'s' * (threads > 1)}")]
    trainer = settings.trainer
    if (
        trainer.max_time is not None
        and trainer.max_steps is None
        and trainer.max_epochs is None
        and how in ("here", "processes")
    ):
        seconds = seconds_of(trainer.max_time) * -(-left // workers)
        lines.append(
            f"each trains for trainer.max_time={trainer.max_time}, about {_clock(seconds)} for all; fits that share a machine take "
            "fewer steps in their time than one alone: with trainer.max_steps they are the same"
        )
    return [*lines, f"sweep: {os.path.relpath(made.path)}"]


def _run(made: Sweep, left: Sequence[Cell], ending: Iterator[Cell], workers: int) -> None:
    """Say of each fit that ends what became of it, and how long the others may take."""
    start, fits = time.monotonic(), len(made.cells)
    with contextlib.closing(ending):  # type: ignore[type-var]
        for done, cell in enumerate(ending, 1):
            outcome, rest = made.outcome(cell), len(left) - done
            time_left = (time.monotonic() - start) / done * rest
            more = f", about {_clock(time_left)} left" if rest and done >= workers else ""
            say(f"[{fits - rest} of {fits}{more}] {_ended(cell, outcome or Outcome())}")


def _ended(cell: Cell, outcome: Outcome) -> str:
    """Return what became of a fit, in a line."""
    if outcome.error:
        return f"WARNING: {words_of(cell.values)} failed: {outcome.error}"
    score = f", score_2d {outcome.scores['score_2d']:.4f}" if "score_2d" in outcome.scores else ""
    return f"{words_of(cell.values)}: {outcome.steps:,} steps in {outcome.seconds:.3g} s{score}"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 3600}:{int(seconds) // 60 % 60:02d}:{int(seconds) % 60:02d}"


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM, with which clusters end jobs, stop a sweep as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():  # elsewhere signals are the caller's
        yield
        return

    def stop(*rest: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _link(made: Sweep) -> None:
    """Point ``best`` of the sweep, and ``last`` of its task, to the best fit; without scores ``last`` to the first finished."""
    best = best_of(made)
    finished = [cell for cell, _ in made.finished()]
    if best is not None:
        link(made.path / "best", best[0].name)
    if finished:
        link(made.path.with_name("last"), f"{made.path.name}/{(best or finished)[0].name}")
