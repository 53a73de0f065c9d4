"""Run fits that are interrupted, each in a separate process; `tests/training/test_resume.py` examines the results.

Reads scenarios as JSON from standard input: folder, command line, and the stage and step at which an event happens.
Writes the exit statuses as JSON. Torch is imported once, and forked before any work.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import sys
import traceback
from pathlib import Path
from typing import Any

import torch
from bodies import last_words

import uplift.cli.fit
import uplift.cli.report  # noqa: F401
from uplift.cli.main import main
from uplift.training import callbacks as progress

SMALL_DISK_BYTES = 20_000


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)


def fill_disk() -> None:
    """Copy the current checkpoint, and limit files to a few kilobytes."""
    for saved in Path("runs").glob("*/*/checkpoints/*.ckpt"):
        shutil.copy(saved, f"good_{saved.name}")
    resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_DISK_BYTES, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def kill_while_saving() -> None:
    save = torch.save

    def half(state: Any, file: Any) -> None:
        save(state, file)
        file.truncate(file.tell() // 2)
        file.flush()
        kill()

    torch.save = half


EVENTS = {f.__name__: f for f in (kill, interrupt, terminate, fill_disk, kill_while_saving)}


def run(scenario: dict[str, Any]) -> None:
    os.chdir(scenario["folder"])
    log = os.open("log.txt", os.O_WRONLY | os.O_CREAT)
    os.dup2(log, 1)
    os.dup2(log, 2)
    write_rows = progress.MetricsFile.on_train_batch_end

    def rows_then_event(self: Any, trainer: Any, module: Any, *rest: Any) -> None:
        write_rows(self, trainer, module, *rest)
        if (self.stage, trainer.global_step) == (scenario["stage"], scenario["step"]):
            EVENTS[scenario["event"]]()

    progress.MetricsFile.on_train_batch_end = rows_then_event
    os._exit(main(last_words(*scenario["words"])))


if __name__ == "__main__":
    torch.set_num_threads(1)
    statuses = []
    for scenario in json.load(sys.stdin):
        child = os.fork()
        if not child:
            try:
                run(scenario)
            except BaseException:
                traceback.print_exc()
                os._exit(70)
        statuses.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    print(json.dumps(statuses))
