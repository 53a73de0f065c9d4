"""Run hostile inputs by seed, each in a process of its own with limits on time and memory, and count what came of them.

Every case must be done, or refused with exit status 2 and one line, within ten seconds and a gigabyte. Cases are
made of small valid files of every kind, damaged, and of commands with wrong words; a case is known by seed and number.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.common import ROOT, facts, write_json
from benchmarks.hostile.cases import Outcome, import_all, run_case
from benchmarks.hostile.samples import make_samples, word_lists

__all__ = ["main"]

RESULT = ROOT / "benchmarks" / "results" / "hostile.json"
_HELD = ("done", "refused")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases, print faults as they come, and store the counts."""
    given = _parser().parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = (given.folder or Path(temporary)).resolve()
        outcomes = _outcomes(given, folder)
    verdicts = Counter(one.verdict for one in outcomes)
    for verdict, count in verdicts.most_common():
        print(f"{count:6,}  {verdict}")
    if given.out:
        write_json(given.out, _summary(given, outcomes, verdicts))
    return int(any(verdict not in _HELD for verdict in verdicts))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hostile", description=__doc__)
    parser.add_argument("--cases", type=int, default=5000, help="how many, default 5,000")
    parser.add_argument("--start", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="only samples whose name contains this; words: commands alone")
    parser.add_argument("--quick", action="store_true", help="without runs and data sets: only what needs no training")
    parser.add_argument("--folder", type=Path, help="keep the samples, and the cases that fail, here")
    parser.add_argument("--out", type=Path, help=f"JSON file for the counts, such as {RESULT.relative_to(ROOT)}")
    return parser


def _outcomes(given: argparse.Namespace, folder: Path) -> list[Outcome]:
    (folder / "samples").mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    import_all()
    samples = [one for one in make_samples(folder / "samples", not given.quick) if given.only in one.name]
    commands = word_lists(folder / "samples", not given.quick)
    found = []
    with contextlib.suppress(KeyboardInterrupt):  # what was found until then counts
        for number in range(given.start, given.start + given.cases):
            found.append(run_case(given.seed, number, samples, commands, folder / "cases"))
            if found[-1].verdict not in _HELD:
                _show(found[-1])
    return found


def _show(one: Outcome) -> None:
    last = next((line for line in reversed(one.said.splitlines()) if line.strip()), "")
    words = " ".join(one.words)
    print(f"case {one.number}: {one.verdict} | {one.sample}: {one.done} | {words[:300]!r} | {last[:200]}", flush=True)


def _summary(given: argparse.Namespace, outcomes: Sequence[Outcome], verdicts: Counter[str]) -> dict:
    samples: dict[str, Counter[str]] = {}
    for one in outcomes:
        samples.setdefault(one.sample, Counter())[one.verdict] += 1
    return {
        "command": f"python -m benchmarks.hostile --cases {len(outcomes)} --start {given.start} --seed {given.seed}",
        **facts(),
        "cases": len(outcomes),
        "verdicts": dict(verdicts.most_common()),
        "most_seconds": max(one.seconds for one in outcomes),
        "most_megabytes": max(one.megabytes for one in outcomes),
        "samples": {name: dict(counts.most_common()) for name, counts in sorted(samples.items())},
        "faults": [asdict(one) for one in outcomes if one.verdict not in _HELD],
    }


if __name__ == "__main__":
    sys.exit(main())
