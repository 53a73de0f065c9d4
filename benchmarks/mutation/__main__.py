"""``python -m benchmarks.mutation``: which share of small bugs the tests notice, module by module.

Mutants are drawn by seed among the lines that tests reach, each is put into a fork of a process that has collected the
tests, and those that reach its line are run until one fails. Mutants that change nothing anyone could notice are listed
by hand in ``equivalent.txt`` beside this file, with the reason, and counted apart. mutmut was still
rewriting the package after two minutes, and cosmic-ray, which was not run, starts Python and torch anew for each mutant.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutation.mutants import Mutant, mutants_of
from benchmarks.mutation.session import ROOT, Budget, Coverage, Judge

GROUPS = {
    "geometry": ["camera", "rigid", "rotation", "normalise", "lens", "mesh", "silhouette", "surface", "voxels"],
    "data": ["tensors", "select", "clean", "turned", "far", "upright", "human", "poses", "sampler", "concat", "samples"],
    "models": ["lifter", "predict", "refine", "metric_scale", "likely_size", "networks"],
    "priors": [
        "base", "bones", "consistency", "critic", "flow", "handedness", "imputation", "labelled", "mask", "pairwise",
        "symmetry",
    ],
    "metrics": ["pose_metrics", "alignment", "scores", "evaluate", "protocols"],
}  # fmt: skip
TESTS = ["tests/geometry", "tests/data", "tests/models", "tests/priors", "tests/metrics", "tests/training"]
EQUIVALENT = Path(__file__).with_name("equivalent.txt")


def main() -> None:
    """Run the mutants and say what the tests noticed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__.splitlines()[0])
    parser.add_argument(
        "modules", nargs="*", default=list(GROUPS), help="of these groups or files: geometry models/refine"
    )
    parser.add_argument("--count", type=int, default=40, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="*", default=TESTS)
    parser.add_argument("--again", type=Path, help="a file of results: judge its survivors alone, again")
    parser.add_argument("--out", type=Path, help="where to write the results, JSON")
    parser.add_argument("--traced", type=Path, help="which test reaches which line: written here, read if it is there")
    given = parser.parse_args()
    files = _files(given.modules)
    run = _Run(given, files)
    with tempfile.TemporaryDirectory() as folder:
        judge = Judge(files, run.work, Budget(), given.traced or Path(folder) / "traced.jsonl")
        options = ["-p", "no:cacheprovider", "-p", "no:xdist", "-q", "--no-header", "--basetemp", f"{folder}/pytest"]
        status = pytest.main([*options, *given.tests], plugins=[judge])
    sys.exit(status)


def _files(words: list[str]) -> list[str]:
    found = []
    for word in words:
        folder, _, name = word.partition("/")
        found += [f"uplift/{folder}/{one}.py" for one in ([name] if name else GROUPS[folder])]
    return found


class _Run:
    """Draws the mutants, has them judged, and writes down what came out."""

    def __init__(self, given: argparse.Namespace, files: list[str]):
        self.given, self.files, self.found = given, files, []
        self.equivalent = _equivalent()

    def work(self, judge: Judge, coverage: Coverage) -> None:
        """Judge the chosen mutants of every file."""
        share = {}
        for file in self.files:
            mutants = list(mutants_of(ROOT / file, ROOT))
            reached = [mutant for mutant in mutants if coverage.of(mutant)]
            share[file] = len(reached) / max(1, len(mutants))
            for mutant in self._chosen(reached, file):
                self._judge(judge, coverage, mutant)
            judge.say(f"{file}: {_scores(one for one in self.found if one['path'] == file)}")
            if self.given.out:
                command = f"python -m benchmarks.mutation {' '.join(sys.argv[1:])}".strip()
                self.given.out.write_text(json.dumps(self._results(share, command), indent=1) + "\n")

    def _chosen(self, mutants: list[Mutant], file: str) -> list[Mutant]:
        if self.given.again:
            before = json.loads(self.given.again.read_text())["mutants"]
            wanted = {(one["path"], one["function"], one["change"]) for one in before if one["outcome"] == "survived"}
            return [m for m in mutants if (m.path, m.function, m.change) in wanted]
        rng = random.Random(f"{self.given.seed} {file}")
        drawn = rng.sample(range(len(mutants)), min(self.given.count, len(mutants)))
        return [mutants[place] for place in sorted(drawn)]

    def _judge(self, judge: Judge, coverage: Coverage, mutant: Mutant) -> None:
        tests, start = judge.tests_for(mutant, coverage), time.perf_counter()
        outcome = judge.outcome(mutant, tests) if tests else "survived"
        if outcome == "survived" and _key(mutant) in self.equivalent:
            outcome = "equivalent"
        seconds = round(time.perf_counter() - start, 1)
        self.found.append({
            "path": mutant.path, "line": mutant.line, "function": mutant.function, "change": mutant.change,
            "outcome": outcome, "by": judge.killer, "tests": len(tests), "seconds": seconds,
        })  # fmt: skip
        if outcome == "survived":
            judge.say(f"{mutant.path}:{mutant.line} {mutant.function}: {mutant.change} ({len(tests)} tests)")

    def _results(self, share: dict[str, float], command: str) -> dict[str, Any]:
        # It imports the package, whose shapes are checked only if pytest imports that first.
        from benchmarks.common import facts

        by_file, by_group = defaultdict(list), defaultdict(list)
        for one in self.found:
            by_file[one["path"]].append(one)
            by_group[one["path"].split("/")[1]].append(one)
        return {
            "command": command, "seed": self.given.seed, **facts(), "all": _scores(self.found),
            "groups": {name: _scores(ones) for name, ones in by_group.items()},
            "modules": {name: {**_scores(ones), "reached": round(share[name], 3)} for name, ones in by_file.items()},
            "mutants": self.found,
        }  # fmt: skip


def _key(mutant: Mutant) -> str:
    return f"{mutant.path} {mutant.function}: {mutant.change}"


def _equivalent() -> set[str]:
    """Return the mutants that were judged by hand: lines that are no reasons."""
    lines = EQUIVALENT.read_text().splitlines() if EQUIVALENT.exists() else []
    return {line for line in lines if line and not line.startswith("#")}


def _scores(found: Any) -> dict[str, Any]:
    """Return counts, the score without equivalent and invalid mutants, and its 95 % interval (Wilson 1927)."""
    counts = Counter(one["outcome"] for one in found)
    killed, total = counts["killed"] + counts["timeout"], counts["killed"] + counts["timeout"] + counts["survived"]
    if not total:
        return dict(counts)
    z, share = 1.96, killed / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * math.sqrt(share * (1 - share) / total + z * z / (4 * total * total)) / (1 + z * z / total)
    interval = [round(middle - half, 3), round(middle + half, 3)]
    return {"score": round(share, 3), "interval": interval, **counts}


if __name__ == "__main__":
    main()
