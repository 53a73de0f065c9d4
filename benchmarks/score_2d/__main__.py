"""How well `score_2d` and other figures without truth order lifters as their errors against the truth do.

Families of short fits (fits.yaml) and distorted lifters are measured on held-out frames. `cmu` is the family that the
score was chosen on, the others confirm it. Needs UPLIFT_DATA; fits are kept in UPLIFT_BENCHMARK_CACHE or
~/.cache/uplift, and results stored in benchmarks/results/score_2d.json are not computed again.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from benchmarks.common import BenchmarkError, markdown, stored, table_parser, text
from benchmarks.score_2d import lifters
from benchmarks.score_2d.lifters import families, run_family
from benchmarks.score_2d.show import lifter_sheet, rank_sheet
from uplift.errors import UserError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the tables; 1 if something failed."""
    known = families()
    parser = table_parser("score_2d", __doc__)
    parser.add_argument("families", nargs="*", help=f"any of {', '.join(known)}; default: all")
    parser.add_argument("--lifters", action="store_true", help="print every lifter, too")
    given = parser.parse_args(arguments)
    unknown = set(given.families) - set(known)
    if unknown:
        parser.error(f"no family {', '.join(sorted(unknown))}; expected any of {', '.join(known)}")
    torch.set_num_threads(1)
    failed = 0
    for name in given.families or known:
        failed += not given.print and _failed(name)
        if any(key.startswith(f"{name}/") for key in stored(lifters.RESULTS)):
            _show(name, given.markdown, given.lifters)
    return 1 if failed else 0


def _failed(name: str) -> bool:
    try:
        run_family(families()[name], _cache())
    except (BenchmarkError, UserError) as error:
        print(f"\n{name}: {error}\n", file=sys.stderr, flush=True)
        return True
    return False


def _show(name: str, as_markdown: bool, every: bool) -> None:
    results, show = stored(lifters.RESULTS), markdown if as_markdown else text
    sheets = [rank_sheet(name, results), *([lifter_sheet(name, results)] if every else [])]
    print("\n".join(show(sheet) for sheet in sheets), flush=True)


def _cache() -> Path:
    return Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift").expanduser() / "score_2d"


if __name__ == "__main__":
    sys.exit(main())
