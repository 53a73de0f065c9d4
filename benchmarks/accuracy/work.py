"""Run one cell: train or compute, evaluate, and store the result with its commands."""

from __future__ import annotations

import json
import re
import shlex
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.cells import Cell, Target, place
from benchmarks.accuracy.rigs import cached_rigs
from benchmarks.common import BenchmarkError, data_folder, facts, run_python, write_json

__all__ = ["fill_in", "run_cell"]

HERE = Path(__file__).resolve().parent

_SCORE = "import json, sys, uplift; print(json.dumps(uplift.evaluate_poses(*sys.argv[1:]).to_dict()))"


def fill_in(text: str, *, shown: bool = False) -> str:
    """Return ``text`` with its placeholders filled in; ``shown``: with variables instead of this machine's folders."""
    names = {"{data}": "$UPLIFT_DATA", "{rigs}": "$UPLIFT_BENCHMARK_CACHE", "{here}": "benchmarks/accuracy"}
    for placeholder, name in names.items():
        if placeholder in text:
            text = text.replace(placeholder, name if shown else str(_folder(placeholder)))
    return text


def _folder(placeholder: str) -> Path:
    if placeholder == "{here}":
        return HERE
    if placeholder == "{rigs}":
        return cached_rigs().resolve()
    return data_folder()


def run_cell(cell: Cell, cores: set[int]) -> None:
    """Run one cell on ``cores`` and store its result.

    Raises:
        BenchmarkError: one of its commands failed.
    """
    _check_words(cell)
    with tempfile.TemporaryDirectory() as folder:
        work = _Work(cell, Path(folder), cores)
        found = work.floor() if cell.fit.floor else work.fit()
    about = {"commands": work.commands, "seed": cell.seed, "minutes": cell.minutes, "steps": cell.steps, **facts()}
    write_json(cell.path, about | found)


def _check_words(cell: Cell) -> None:
    """Reject arguments that `uplift evaluate` does not know, before anything is trained."""
    from uplift.cli.verbs import EVALUATE

    for name, test in cell.fit.tests.items():
        unknown = [word for word in shlex.split(test.words) if word.partition("=")[0] not in EVALUATE]
        if unknown:
            raise BenchmarkError(f"test {name}: `uplift evaluate` does not accept {', '.join(unknown)}")


class _Work:
    """Runs the commands of one cell in a temporary folder, and records them as a reader would type them."""

    def __init__(self, cell: Cell, folder: Path, cores: set[int]):
        self.cell, self.folder, self.cores = cell, folder, cores
        self.commands: list[str] = []

    def fit(self) -> dict[str, Any]:
        """Train and evaluate; return the result."""
        cell, words = self.cell, shlex.split(self.cell.fit.command)
        words += [*cell.budget, f"seed={cell.seed}"]
        start = time.monotonic()
        self._run(words if cell.fit.python else ["-m", "uplift.cli.main", "fit", *words])
        wall = time.monotonic() - start
        run = next(iter(self.folder.glob("runs/*/last")), None)
        if run is None:
            raise BenchmarkError(f"{self.commands[-1]}: wrote no runs/*/last")
        run = run.resolve()
        if cell.fit.test:
            self._evaluate(run, Target(cell.fit.test))
        found = _evaluation_of(run)
        result: dict[str, Any] = {
            "lifter_bytes": (run / "lifter.pt").stat().st_size,
            "train_seconds": _trained(run),
            "wall_seconds": round(wall, 1),
            **{key: found[key] for key in ("overall", "calibration") if key in found},
        }
        if cell.fit.occlusion:  # before the other tests, since it uses the file of `overall`
            result["occlusion"] = self._occlusion(run, cell.fit.test)
        if cell.fit.tests:
            result["tests"] = {name: self._evaluate(run, test) for name, test in cell.fit.tests.items()}
        return result

    def floor(self) -> dict[str, Any]:
        """Compute and evaluate a baseline."""
        fit, poses = self.cell.fit, "OUT.npz"
        train, test = place(fit.train), str(fit.test)
        self._run(["-m", "benchmarks.accuracy.floors", str(fit.floor), train, test, poses, f"skeleton={fit.skeleton}"])
        text = self._run(["-c", _SCORE, poses, test, fit.skeleton], shown=False)
        self.commands.append(
            fill_in(f"uplift evaluate poses={poses} data.test={test} skeleton={fit.skeleton}", shown=True)
        )
        return {"overall": json.loads(text)["overall"]}

    def _evaluate(self, run: Path, test: Target) -> dict[str, float]:
        trust = [word for word in shlex.split(self.cell.fit.command) if word.startswith("trust=")]
        words = [f"data.test={test.data}", *shlex.split(test.words), *trust]
        self._run(["-m", "uplift.cli.main", "evaluate", f"run={run}", *words], run=run)
        return _evaluation_of(run)["overall"]

    def _occlusion(self, run: Path, test: str | None) -> dict[str, dict[str, float]]:
        from uplift.config.run import RunFolder
        from uplift.data.load import find_data

        file = test or str(find_data(RunFolder(run).settings(), "test"))
        shown = test or "TEST.npz"
        self._run(["-m", "benchmarks.accuracy.occlusion", str(run), file, "--json", "occlusion.json"], shown=False)
        self.commands.append(f"python -m benchmarks.accuracy.occlusion RUN {fill_in(shown, shown=True)}")
        return json.loads((self.folder / "occlusion.json").read_text())

    def _run(self, words: Sequence[str], *, run: Path | None = None, shown: bool = True) -> str:
        """Run python with ``words``, record the command if ``shown``, and return its output."""
        if shown:
            command = " ".join(map(_quoted, ["python", *words])).replace("python -m uplift.cli.main", "uplift")
            self.commands.append(fill_in(command.replace(str(run), "RUN") if run else command, shown=True))
        return run_python([*map(fill_in, words)], self.folder, self.cores)


def _quoted(word: str) -> str:
    return f'"{word}"' if re.search(r"[\s*()\[\]]", word) else word


def _evaluation_of(run: Path) -> dict[str, Any]:
    path = run / "evaluation.json"
    if not path.is_file():
        raise BenchmarkError(f"{run}: was not evaluated: the fit had no test frames with poses")
    return json.loads(path.read_text())


def _trained(run: Path) -> float | None:
    """Return the training seconds of all stages according to the run's report, None if it lists none."""
    report = run / "report.md"
    found = re.findall(r"^- \w+: (\d+) s of training$", report.read_text(), re.M) if report.is_file() else []
    return float(sum(map(int, found))) if found else None
