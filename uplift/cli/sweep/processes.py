"""The fits of a sweep in processes of this machine: several at a time on the cores or GPUs, or one after another in this one."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from uplift.cli.sweep.cell import run_cell
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.config.grid import Cell
from uplift.config.progress import say
from uplift.config.settings import Settings
from uplift.config.trust import Consent

__all__ = ["gpus", "here", "processes", "workers_of"]


def workers_of(settings: Settings, fits: int) -> int:
    """Return how many of so many fits run at a time on this machine: as ``sweep.workers`` says, else one for each GPU, or
    for each of its cores that the threads of a fit leave."""
    count = settings.sweep.workers or len(gpus(settings)) or _cores() // (settings.trainer.threads or 1)
    return max(1, min(count, fits))


def _cores() -> int:
    """Return the cores that this process may use: on a cluster those of its job."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def gpus(settings: Settings) -> list[str]:
    """Return the GPUs that fits of these settings may use, as CUDA_VISIBLE_DEVICES names them; none for the processor."""
    # Importing torch takes seconds, and without a driver there is nothing to find.
    if settings.trainer.accelerator == "cpu" or not any(
        map(os.path.exists, ("/dev/nvidiactl", "/dev/dxg", "/dev/kfd"))
    ):
        return []
    import torch

    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    count = torch.cuda.device_count()
    return visible.split(",")[:count] if visible else [str(number) for number in range(count)]


def here(sweep: Sweep, cells: Sequence[Cell], consent: Consent, workers: int) -> Iterator[Cell]:
    """Train the fits one after another in this process; yield each when it has ended."""
    for cell in cells:
        say(f"\n{cell.name}")
        if run_cell(sweep, cell) is None:
            raise KeyboardInterrupt
        yield cell


def processes(sweep: Sweep, cells: Sequence[Cell], consent: Consent, workers: int) -> Iterator[Cell]:
    """Train the fits in ``workers`` processes; yield each when it has ended.

    However this ends, the processes have ended by then, their fits saved as after Ctrl-C.
    """
    devices, waiting, running = gpus(sweep.settings_of(sweep.cells[0])), list(cells), selectors.DefaultSelector()
    pool: list[_Worker] = []
    try:
        for number in range(min(workers, len(waiting))):
            pool.append(_Worker(sweep.path, consent, devices[number % len(devices)] if devices else None))
            running.register(pool[-1].answers, selectors.EVENT_READ, pool[-1])
            pool[-1].start(waiting.pop(0))
        while running.get_map():
            for key, _ in running.select():
                worker: _Worker = key.data
                cell = _ended(sweep, worker)
                if not worker.alive or not waiting:
                    running.unregister(worker.answers)
                    worker.close()
                if not worker.alive and waiting:  # another in its place
                    pool.append(_Worker(sweep.path, consent, worker.device))
                    running.register(pool[-1].answers, selectors.EVENT_READ, pool[-1])
                    worker = pool[-1]
                if worker.alive and waiting:
                    worker.start(waiting.pop(0))
                yield cell
    finally:
        _stop(pool)


_OF_RANKS = (
    "RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "GROUP_RANK", "MASTER_ADDR", "MASTER_PORT",
    "SLURM_NTASKS", "SLURM_NPROCS", "SLURM_PROCID", "SLURM_LOCALID", "SLURM_NTASKS_PER_NODE",
)  # fmt: skip
"""Variables by which torchrun and srun tell processes of one fit apart."""


@dataclass
class _Worker:
    """A process of `uplift.cli.sweep.worker`."""

    folder: Path
    consent: Consent
    device: str | None
    cell: Cell | None = None
    alive: bool = True
    process: subprocess.Popen[str] = field(init=False)

    def __post_init__(self) -> None:
        path = os.pathsep.join(part or os.getcwd() for part in sys.path)
        # A fit is one process, whatever the job is that its sweep runs in.
        environment = {name: value for name, value in os.environ.items() if name not in _OF_RANKS}
        environment["PYTHONPATH"] = path
        if self.device is not None:
            environment["CUDA_VISIBLE_DEVICES"] = self.device
        else:  # before any library starts threads; a fit sets its own number
            environment |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with open(self.folder / "cells" / "workers.txt", "ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "uplift.cli.sweep.worker", str(self.folder)], env=environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
                start_new_session=True,  # Ctrl-C is for the sweep, which passes it on
            )  # fmt: skip
        self._tell(json.dumps(sorted(self.consent)))

    @property
    def answers(self):
        """Where it says which fit has ended."""
        assert self.process.stdout is not None
        return self.process.stdout

    def start(self, cell: Cell) -> None:
        """Let it train a fit."""
        self.cell = cell
        self._tell(cell.name)

    def close(self) -> None:
        """Let it end; the fit that it trains is saved first."""
        if self.process.stdin is not None:
            with suppress(OSError):
                self.process.stdin.close()

    def _tell(self, line: str) -> None:
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):  # it has ended: so do its answers
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()


def _ended(sweep: Sweep, worker: _Worker) -> Cell:
    """Return the fit that a worker had when it answered, or when it ended without an answer, which is an error of the fit."""
    cell, answer = worker.cell, worker.answers.readline().strip()
    assert cell is not None
    if answer.startswith("."):  # someone interrupted the worker alone
        raise KeyboardInterrupt
    if not answer:
        worker.alive = False
        status = worker.process.wait()
        why = f"signal {signal.Signals(-status).name}" if status < 0 else f"status {status}"
        hint = ": out of memory? Let fewer run at a time (sweep.workers)" if status == -signal.SIGKILL else ""
        sweep.put_outcome(cell, Outcome(error=f"its process ended with {why}{hint}. What it said is in cells/."))
    return cell


def _stop(pool: Sequence[_Worker]) -> None:
    """End all workers, their fits saved; a second Ctrl-C ends them at once."""
    for worker in pool:
        worker.close()
    try:
        for worker in pool:
            worker.process.wait()
    except BaseException:
        for worker in pool:
            worker.process.kill()
        raise
    finally:
        for worker in pool:
            worker.answers.close()
