"""A process that trains fits of a sweep, one after another: ``python -m uplift.cli.sweep.worker SWEEP``.

On its input it is told what code may run, and then the name of a fit on each line; it answers with that name when the
fit has ended, and with a point before it where it was interrupted. Where its input ends, as when the sweep is killed,
it stops as after Ctrl-C.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path
from queue import SimpleQueue


def main(folder: Path) -> None:
    """Train what the input names until it ends."""
    # The answers have the output to themselves: what fits say goes into their logs.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    consent = frozenset(json.loads(sys.stdin.readline()))
    from uplift.cli.sweep.cell import run_cell_apart

    names: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_listen, args=(names,), daemon=True).start()
    while name := names.get():
        done = run_cell_apart(folder, name, consent)
        print("" if done else ".", name, sep="", file=answers, flush=True)


def _listen(names: SimpleQueue[str]) -> None:
    """Pass on the lines of the input; at its end interrupt what is under way, and end."""
    for line in sys.stdin:
        names.put(line.strip())
    names.put("")
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(130)
