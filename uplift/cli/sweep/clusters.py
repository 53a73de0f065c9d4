"""The fits of a sweep on clusters: jobs of a SLURM array by submitit, or tasks of Ray. All need the folder of the sweep."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from uplift.cli.sweep.cell import run_cell_apart
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.cli.sweep.processes import gpus
from uplift.config.grid import Cell
from uplift.config.progress import say
from uplift.config.trust import Consent
from uplift.errors import UserError

__all__ = ["ray_tasks", "slurm_jobs"]

_LOOK_S = 2.0
"""Seconds between looks at jobs; submitit asks SLURM about all of them at once, and less often."""
_HOURS = 24
"""Of a job, where ``timeout_min`` is not given."""


class _Job:
    """One fit, as submitit sends it to SLURM; one that is cut short goes on from its checkpoint in the next job."""

    def __call__(self, folder: Path, name: str, consent: Consent) -> bool:
        """Train the fit; returns whether it has ended."""
        return run_cell_apart(folder, name, consent) is not None

    def checkpoint(self, *given: Any) -> Any:
        """Return what to submit again where the time of the job is over, or it must make room."""
        from submitit.helpers import DelayedSubmission  # pyright: ignore[reportMissingImports]

        return DelayedSubmission(self, *given)


def slurm_jobs(sweep: Sweep, cells: Sequence[Cell], consent: Consent, workers: int) -> Iterator[Cell]:
    """Train the fits as jobs of one SLURM array, ``workers`` at a time; yield each when it has ended.

    Ctrl-C cancels the jobs. Where the process that waits is killed they go on, and ``resume=`` waits for them again.

    Raises UserError: submitit is not installed, a parameter that it does not have, no SLURM on this machine.
    """
    try:
        import submitit  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise UserError("sweep.how=slurm needs submitit: pip install 'uplift3d[cluster]'.") from None
    names = sweep.path / "cells" / "jobs.txt"
    executor = _executor(sweep, workers)
    jobs = _earlier_jobs(names, submitit, sweep)
    new = [cell for cell in cells if cell.name not in jobs]
    if new:
        count = len(new)
        sent = executor.map_array(_Job(), [sweep.path] * count, [cell.name for cell in new], [consent] * count)
        jobs |= {cell.name: job for cell, job in zip(new, sent, strict=True)}
    names.write_text("".join(f"{name} {job.job_id}\n" for name, job in jobs.items()))
    say(f"jobs: {', '.join(dict.fromkeys(str(job.job_id).partition('_')[0] for job in jobs.values()))}")
    try:
        yield from _as_they_end(sweep, [cell for cell in cells if cell.name in jobs], jobs)
    except BaseException:
        for job in jobs.values():
            with suppress(Exception):  # one that has ended meanwhile
                job.cancel(check=False)
        _wait(jobs.values())
        raise
    names.unlink(missing_ok=True)


def _executor(sweep: Sweep, workers: int) -> Any:
    """Return submitit's executor with the parameters of ``sweep.options``; raises UserError for what it refuses."""
    from submitit import AutoExecutor  # pyright: ignore[reportMissingImports]

    settings = sweep.settings_of(sweep.cells[0])
    given = dict(settings.sweep.options)
    cluster = given.pop("cluster", "slurm")  # "local" tries out on this machine what SLURM would run
    ours: dict[str, Any] = {
        "timeout_min": 60 * _HOURS,
        "cpus_per_task": settings.trainer.threads or 1,
        "name": "uplift",
    }
    if workers and cluster == "slurm":
        ours["slurm_array_parallelism"] = workers
    try:
        executor = AutoExecutor(folder=sweep.path / "cells" / "slurm", cluster=cluster)
        executor.update_parameters(**ours | given)
    except Exception as error:  # of any kind, from submitit
        where = " ".join(f"sweep.options.{name}={value}" for name, value in given.items())
        raise UserError(f"sweep.how=slurm {where}: submitit says: {' '.join(str(error).split())}") from error
    return executor


def _earlier_jobs(names: Path, submitit: Any, sweep: Sweep) -> dict[str, Any]:
    """Return the jobs of this sweep that an earlier process has sent and that have not ended, by the names of their fits."""
    lines = [line.split() for line in names.read_text().splitlines()] if names.is_file() else []
    if not lines or sweep.settings_of(sweep.cells[0]).sweep.options.get("cluster", "slurm") != "slurm":
        return {}
    found = {name: submitit.SlurmJob(sweep.path / "cells" / "slurm", number, [0]) for name, number in lines}
    return {name: job for name, job in found.items() if not job.done()}


def _as_they_end(sweep: Sweep, cells: Sequence[Cell], jobs: dict[str, Any]) -> Iterator[Cell]:
    waiting = list(cells)
    while waiting:
        for cell in list(waiting):
            ended = jobs[cell.name].done()
            outcome = sweep.outcome(cell)
            if ended and outcome is None:
                error = jobs[cell.name].exception()
                last = str(error or "the job ended early").strip().splitlines()[-1]
                sweep.put_outcome(cell, Outcome(error=f"job {jobs[cell.name].job_id}: {last}"))
            if ended or outcome is not None:
                waiting.remove(cell)
                yield cell
        if waiting:
            time.sleep(_LOOK_S)


_SAVING_S = 60
"""Seconds that cancelled jobs have for saving what they do."""


def _wait(jobs: Any) -> None:
    end = time.monotonic() + _SAVING_S
    while time.monotonic() < end and not all(job.done() for job in jobs):
        time.sleep(_LOOK_S / 4)


def ray_tasks(sweep: Sweep, cells: Sequence[Cell], consent: Consent, workers: int) -> Iterator[Cell]:
    """Train the fits as tasks of Ray, ``workers`` at a time; yield each when it has ended.

    A cluster is found as Ray finds it (RAY_ADDRESS, or ``ray start`` on this machine); without one this machine is one.

    Raises UserError: Ray is not installed, or an option of a task that it does not have.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise UserError("sweep.how=ray needs Ray: pip install ray.") from None
    settings = sweep.settings_of(sweep.cells[0])
    ours = {"num_cpus": settings.trainer.threads or 1, "num_gpus": 1 if gpus(settings) else 0, "max_retries": 3}
    try:
        task = ray.remote(run_cell_apart).options(**ours | settings.sweep.options)
    except (ValueError, TypeError) as error:
        raise UserError(f"sweep.options: Ray says: {error}") from error
    if not ray.is_initialized():
        ray.init(log_to_driver=False, configure_logging=False)
    waiting, running = list(cells), {}
    try:
        while waiting or running:
            while waiting and (not workers or len(running) < workers):
                cell = waiting.pop(0)
                running[task.remote(sweep.path, cell.name, consent)] = cell
            (done,), _ = ray.wait(list(running))
            yield _of_task(ray, sweep, done, running.pop(done))
    except BaseException:
        for one in running:
            ray.cancel(one)
        ray.wait(list(running), num_returns=len(running), timeout=_SAVING_S) if running else None
        raise


def _of_task(ray: Any, sweep: Sweep, done: Any, cell: Cell) -> Cell:
    """Return the fit of a task that has ended; raises KeyboardInterrupt where it was interrupted."""
    try:
        if ray.get(done) is None:
            raise KeyboardInterrupt
    except ray.exceptions.RayError as error:
        sweep.put_outcome(cell, Outcome(error=f"Ray: {str(error).strip().splitlines()[-1]}"))
    return cell
