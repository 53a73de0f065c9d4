"""Run one cell: train or compute, evaluate, and store the result with its commands."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.cells import Cell, Target, place
from benchmarks.accuracy.rigs import cached_folder, cached_rigs
from benchmarks.common import BenchmarkError, data_folder, facts, run_python, write_json

__all__ = ["fill_in", "run_cell"]

HERE = Path(__file__).resolve().parent

_SECTIONS = ("by_trunk_angle", "signs", "hypotheses")
"""Of evaluation.json, beside `overall` and `calibration`."""
_TOOK = "took.json"
"""In a run that is kept: how long it took, and its command; written last."""

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
        run, wall = self._train(words if cell.fit.python else ["-m", "uplift.cli.main", "fit", *words])
        found = self._evaluate(run, Target(cell.fit.test)) if cell.fit.test else _evaluation_of(run)
        result: dict[str, Any] = {
            "lifter_bytes": (run / "lifter.pt").stat().st_size,
            "train_seconds": _trained(run),
            "wall_seconds": wall,
            **{key: found[key] for key in ("overall", "calibration", *_SECTIONS) if key in found},
        }
        for probe in cell.fit.probes:  # before the other tests, since it may use the file of `overall`
            result[probe] = self._probe(probe, run, cell.fit.test)
        others = {name: self._evaluate(run, test) for name, test in cell.fit.tests.items()}
        if others:
            result["tests"] = {name: of["overall"] for name, of in others.items()}
            sections = {name: {key: of[key] for key in _SECTIONS if key in of} for name, of in others.items()}
            result["sections"] = {name: of for name, of in sections.items() if of}
        return result

    def _train(self, words: list[str]) -> tuple[Path, float]:
        """Return the run of a fit, and the seconds that it took: that of another table, where it did the same fit.

        Such runs are kept in the cache under what they depend on: the command, the commit and the machine's cores.
        """
        about = [words, facts()["commit"], len(self.cores)]
        kept = cached_folder() / "runs" / hashlib.sha256(json.dumps(about).encode()).hexdigest()[:16]
        if not (kept / _TOOK).is_file():
            start = time.monotonic()
            self._run(words)
            wall = round(time.monotonic() - start, 1)
            run = next(iter(self.folder.glob("runs/*/last")), None)
            if run is None:
                raise BenchmarkError(f"{self.commands[-1]}: wrote no runs/*/last")
            if facts()["changed"]:  # nothing says what the code was
                return run.resolve(), wall
            shutil.copytree(run.resolve(), kept, dirs_exist_ok=True)
            write_json(kept / _TOOK, {"wall_seconds": wall, "command": self.commands[-1]})
        took = json.loads((kept / _TOOK).read_text())
        self.commands[:] = [took["command"]]
        own = shutil.copytree(kept, self.folder / "kept")  # evaluations write into it
        return own, took["wall_seconds"]

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

    def _evaluate(self, run: Path, test: Target) -> dict[str, Any]:
        trust = [word for word in shlex.split(self.cell.fit.command) if word.startswith("trust=")]
        words = [f"data.test={test.data}", *shlex.split(test.words), *trust]
        self._run(["-m", "uplift.cli.main", "evaluate", f"run={run}", *words], run=run)
        return _evaluation_of(run)

    def _probe(self, probe: str, run: Path, test: str | None) -> dict[str, Any]:
        """Run the module of this folder called ``probe`` on the run, and return what it found."""
        from uplift.config.run import RunFolder
        from uplift.data.load import find_data

        if probe == "video":
            file = shown = "{data}/beam"
        else:
            file, shown = test or str(find_data(RunFolder(run).settings(), "test")), test or "TEST.npz"
        self._run(["-m", f"benchmarks.accuracy.{probe}", str(run), file, "--json", f"{probe}.json"], shown=False)
        self.commands.append(f"python -m benchmarks.accuracy.{probe} RUN {fill_in(shown, shown=True)}")
        return json.loads((self.folder / f"{probe}.json").read_text())

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
