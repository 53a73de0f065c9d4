"""Print Tables 1 and 2 and the 3DHP figure of Kudo et al. 2018, with the published rows and fits of uplift.

Needs Human3.6M or MPI-INF-3DHP (docs/paper-tables.md). Fits go to ./runs; stored results are not computed again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.common import markdown, table_parser, text
from benchmarks.paper_tables import fits
from benchmarks.paper_tables.fits import TABLES, Recipe, fit_recipe, need_data, place_of, read_result, take_run
from benchmarks.paper_tables.show import notes_of, sheets_of
from uplift.errors import UserError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit what was asked for, or use existing runs, and print the tables; 2 if data is missing or an argument is invalid."""
    given = _parser().parse_intermixed_args(arguments)
    missing: dict[str, UserError] = {}
    try:
        chosen = _chosen(given.words)
        if given.print:
            shown = {table: sorted((fits.RESULTS / table).glob("*.json")) for table in chosen.tables or TABLES}
        elif chosen.runs:
            shown = _taken(chosen)
        else:
            recipes = _recipes(chosen, given.seeds)
            missing = _missing(recipes)
            shown = _fitted([recipe for recipe in recipes if recipe.table not in missing])
        show = markdown if given.markdown else text
        for table, places in shown.items():
            results = [read_result(place) for place in dict.fromkeys(places)]
            print("\n".join(show(sheet) for sheet in sheets_of(table, results)))
            print("\n" + "\n".join(f"- {note}" for note in notes_of(table)), flush=True)
    except UserError as error:
        print(f"paper_tables: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\npaper_tables: interrupted; repeat the command to continue", file=sys.stderr)
        return 130
    for number, (table, error) in enumerate(missing.items()):  # the first message in full, one line of the others
        message = str(error) if not number else str(error).splitlines()[0]
        print(f"paper_tables: no {table}: {message}", file=sys.stderr)
    return 2 if missing else 0


@dataclass
class _Words:
    """The arguments of the command line, by kind."""

    tables: list[str] = field(default_factory=list)
    tasks: list[str] = field(default_factory=list)
    runs: list[str] = field(default_factory=list)
    more: list[str] = field(default_factory=list)


def _chosen(words: Sequence[str]) -> _Words:
    found = _Words()
    for word in words:
        key, equals, value = word.partition("=")
        if word in TABLES:
            found.tables.append(word)
        elif not equals:
            raise UserError(f"no table '{word}'; expected any of {', '.join(TABLES)}.")
        elif key == "seed":
            raise UserError("seeds are set with --seeds.")
        elif key == "task":
            found.tasks.append(value)
        elif key == "run":
            found.runs.append(value)
        else:
            found.more.append(word)
    if found.runs and (found.tasks or found.more):
        raise UserError("run=RUN uses a run as it is: leave out task= and settings, or fit again without run=.")
    return found


def _taken(chosen: _Words) -> dict[str, list[Path]]:
    shown: dict[str, list[Path]] = {table: [] for table in chosen.tables}
    for run in chosen.runs:
        table, place = take_run(run)
        if chosen.tables and table not in chosen.tables:
            raise UserError(f"{run} belongs to {table}, not to {', '.join(chosen.tables)}.")
        shown.setdefault(table, []).append(place)
    return shown


def _recipes(chosen: _Words, seeds: Sequence[int]) -> list[Recipe]:
    return [
        Recipe.of(table, task, chosen.more, seed)
        for table in chosen.tables or TABLES
        for seed in seeds
        for task in chosen.tasks or TABLES[table].tasks
    ]


def _missing(recipes: Sequence[Recipe]) -> dict[str, UserError]:
    """Return the tables without data, with what is missing, before anything is trained."""
    found: dict[str, UserError] = {}
    for recipe in recipes:
        if recipe.table not in found and not place_of(recipe.table, recipe.settings()).is_file():
            try:
                need_data(recipe)
            except UserError as error:
                found[recipe.table] = error
    return found


def _fitted(recipes: Sequence[Recipe]) -> dict[str, list[Path]]:
    shown: dict[str, list[Path]] = {}
    for recipe in recipes:
        shown.setdefault(recipe.table, []).append(fit_recipe(recipe))
    return shown


def _seeds(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = table_parser("paper_tables", __doc__)
    parser.add_argument(
        "words", nargs="*", metavar="WORD",
        help=f"{', '.join(TABLES)} (default: all); task=NAME to fit instead of the table's tasks; run=RUN to use an existing "
        "run; settings of the fits, such as data.root=FOLDER or trainer.max_time=00:30:00",
    )  # fmt: skip
    parser.add_argument("--seeds", type=_seeds, default=[0, 1, 2], metavar="N,N,...", help="default 0,1,2")
    return parser


if __name__ == "__main__":
    sys.exit(main())
