"""Train the files of docs/examples.md on the real sets, and say what share of flat depth's error is left.

Needs UPLIFT_DATA with the folders quadruped, rat, hand and chair. Each fit has one core; what is
kept in benchmarks/results/examples.json is not computed twice.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.accuracy.show import Sheet, markdown, text
from benchmarks.accuracy.work import CellFailed
from benchmarks.examples.files import EXAMPLES
from benchmarks.examples.work import kept_results, key_of, run_example

__all__ = ["main"]

_HEAD = ["example", "trained", "seeds", "n_mpjpe", "flat depth", "ratio", "p_mpjpe", "facing"]
_FIGURES = ("n_mpjpe", "flat_n_mpjpe", "ratio", "p_mpjpe", "facing")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not kept yet and print the table; 1 where a fit failed."""
    given = _parser().parse_args(arguments)
    core = {min(os.sched_getaffinity(0))}
    failed = 0
    for seed in given.seeds:
        for name in given.only or EXAMPLES:
            key = key_of(name, given.minutes, seed)
            if given.print or key in kept_results():
                continue
            print(f"run {key}", flush=True)
            try:
                run_example(name, given.minutes, seed, core)
            except CellFailed as error:
                print(f"\n{key}: {error}\n", file=sys.stderr, flush=True)
                failed += 1
    results = kept_results()
    rows = [row for name in given.only or EXAMPLES if (row := _row(name, given.minutes, given.seeds, results))]
    show = markdown if given.markdown else text
    print(show(Sheet("examples", _HEAD, rows)), flush=True)
    return 1 if failed else 0


def _row(name: str, minutes: float, seeds: Sequence[int], results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a row of the table, means over the seeds that are there; nothing where none is."""
    found = [results[key] for seed in seeds if (key := key_of(name, minutes, seed)) in results]
    if not found:
        return []
    means = [sum(float(result[figure]) for result in found) / len(found) for figure in _FIGURES]
    return [name, f"{minutes:g}min", str(len(found)), *(f"{mean:.3f}" for mean in means)]


def _seeds(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.examples", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=EXAMPLES, metavar="NAME", help=f"of {', '.join(EXAMPLES)}")
    parser.add_argument("--minutes", type=float, default=2.0, help="of training, 2 without it")
    parser.add_argument("--seeds", type=_seeds, default=[0], metavar="N,N,...", help="0 without it")
    parser.add_argument("--print", action="store_true", help="print what is kept and run nothing")
    parser.add_argument("--markdown", action="store_true", help="print the table for a document")
    return parser


if __name__ == "__main__":
    sys.exit(main())
