"""What the benchmarks share: facts about the machine, fresh processes, stored results, tables."""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from uplift.config.files import replacing
from uplift.metrics.report import Sheet

__all__ = [
    "ROOT", "BenchmarkError", "Sheet", "data_folder", "facts", "markdown", "max_time", "mean_and_range", "measure_apart",
    "run_missing", "run_python", "run_uplift", "store", "stored", "table_parser", "text", "write_json",
]  # fmt: skip

ROOT = Path(__file__).resolve().parent.parent

_LAST_LINES = 12


class BenchmarkError(Exception):
    """Data is missing, or a command failed; the message ends with the last lines of its output."""


def facts() -> dict[str, object]:
    """Return commit, whether the working tree was changed, versions and cores."""
    import torch

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True).stdout.strip()

    return {
        "commit": git("rev-parse", "--short", "HEAD"),
        "changed": bool(git("status", "--porcelain", "--untracked-files=no", "--", "uplift", "tasks", "skeletons")),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "cores": os.cpu_count(),
        "processor": _processor(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")


def data_folder() -> Path:
    """Return the folder that UPLIFT_DATA names; raises BenchmarkError if it is not set."""
    if not os.environ.get("UPLIFT_DATA"):
        raise BenchmarkError("UPLIFT_DATA is not set: it names the folder of the data sets")
    return Path(os.environ["UPLIFT_DATA"]).resolve()


def max_time(minutes: float) -> str:
    """Return the setting that limits a fit to so many minutes."""
    seconds = round(60 * minutes)
    return f"trainer.max_time={seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


# Fresh processes


def run_python(
    words: Sequence[str],
    folder: Path | None = None,
    cores: set[int] | None = None,
    env: Mapping[str, str] | None = None,
) -> str:
    """Run python with ``words``, in ``folder`` and on ``cores`` if given, and return its standard output.

    Raises:
        BenchmarkError: it failed.
    """
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    threads = {"OMP_NUM_THREADS": str(len(cores))} if cores else {}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env={**os.environ, "PYTHONPATH": path, **threads, **(env or {})},
        capture_output=True, text=True, preexec_fn=(lambda: os.sched_setaffinity(0, cores)) if cores else None,
    )  # fmt: skip
    if done.returncode:
        command = shlex.join(words).replace("-m uplift.cli.main", "uplift")
        output = "\n".join((done.stdout + done.stderr).strip().splitlines()[-_LAST_LINES:])
        raise BenchmarkError(f"{command} ended with status {done.returncode}:\n{output}")
    return done.stdout


def run_uplift(verb: str, words: Sequence[str], folder: Path, cores: set[int]) -> None:
    """Run an `uplift` command in ``folder`` on ``cores``; raises BenchmarkError if it fails."""
    run_python(["-m", "uplift.cli.main", verb, *words], folder, cores)


def measure_apart(module: str, *words: object, env: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run ``module`` in a fresh process and return the JSON on the last line of its output."""
    return json.loads(run_python(["-m", module, *map(str, words)], env=env).splitlines()[-1])


# Stored results: one JSON file per benchmark, a result per key


def stored(path: Path) -> dict[str, dict[str, Any]]:
    """Return the stored results by key."""
    return json.loads(path.read_text()) if path.is_file() else {}


def store(path: Path, key: str, result: Mapping[str, Any]) -> None:
    """Add a result to those stored."""
    write_json(path, dict(sorted({**stored(path), key: result}.items())))


def write_json(path: Path, value: object) -> None:
    """Write a JSON file, and its folder if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write((json.dumps(value, indent=1) + "\n").encode())


def run_missing(path: Path, jobs: Mapping[str, Callable[[], object]]) -> int:
    """Run the jobs whose keys have no stored result, report failures, and return their number."""
    failed = 0
    for key, job in jobs.items():
        if key in stored(path):
            continue
        print(f"run {key}", flush=True)
        try:
            job()
        except BenchmarkError as error:
            print(f"\n{key}: {error}\n", file=sys.stderr, flush=True)
            failed += 1
    return failed


# Tables

text, markdown = Sheet.text, Sheet.markdown


def mean_and_range(values: Sequence[float | None], form: str = ".3f") -> str:
    """Return the mean of the known values, with minimum and maximum if there are several; "-" if there are none."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    spread = f" ({min(known):{form}} to {max(known):{form}})" if len(known) > 1 else ""
    return f"{sum(known) / len(known):{form}}{spread}"


def table_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return the parser of a benchmark that prints tables of stored results."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=description)
    parser.add_argument("--print", action="store_true", help="print stored results, run nothing")
    parser.add_argument("--markdown", action="store_true", help="print Markdown tables")
    return parser
