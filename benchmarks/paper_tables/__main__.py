"""Print Tables 1 and 2 and the 3DHP figure of Kudo et al. 2018 with the published rows beside what is fitted here.

Needs Human3.6M or MPI-INF-3DHP (docs/paper-tables.md). Fits go to ./runs, results are kept and not computed twice.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.accuracy.show import markdown, text
from benchmarks.paper_tables.recipes import RESULTS, TABLES, Recipe, place_of
from benchmarks.paper_tables.show import notes_of, sheets_of
from benchmarks.paper_tables.work import fit_recipe, need_data, read_result, take_run
from uplift.errors import UserError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit or take what was asked for and print the tables; 2 where data is missing or a word is wrong."""
    given = _parser().parse_intermixed_args(arguments)
    missing: dict[str, UserError] = {}
    try:
        chosen = _chosen(given.words)
        if given.print:
            shown = {table: sorted((RESULTS / table).glob("*.json")) for table in chosen.tables or TABLES}
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
        print("\npaper_tables: interrupted; the same command goes on with the next fit", file=sys.stderr)
        return 130
    for number, (table, error) in enumerate(missing.items()):  # one whole message, of the others what is not there
        told = str(error) if not number else str(error).splitlines()[0]
        print(f"paper_tables: no {table}: {told}", file=sys.stderr)
    return 2 if missing else 0


class _Words:
    """What the command line named."""

    def __init__(self) -> None:
        self.tables: list[str] = []
        self.tasks: list[str] = []
        self.runs: list[str] = []
        self.more: list[str] = []


def _chosen(words: Sequence[str]) -> _Words:
    found = _Words()
    for word in words:
        key, equals, value = word.partition("=")
        if word in TABLES:
            found.tables.append(word)
        elif not equals:
            raise UserError(f"no table '{word}'; there are {', '.join(TABLES)}.")
        elif key == "seed":
            raise UserError("seeds are set with --seeds.")
        else:
            {"task": found.tasks, "run": found.runs}.get(key, found.more).append(
                value if key in ("task", "run") else word
            )
    if found.runs and (found.tasks or found.more):
        raise UserError("run=RUN takes a run as it is: leave out task= and settings, or fit anew without run=.")
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
    """Return the tables whose data is not there, and what is missing; before anything is trained."""
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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper_tables", description=__doc__)
    parser.add_argument(
        "words", nargs="*", metavar="WORD",
        help=f"{', '.join(TABLES)} (all without a name); task=NAME to fit in place of the table's own; run=RUN, fitted "
        "already; settings of the fits, such as data.root=FOLDER or trainer.max_time=00:30:00",
    )  # fmt: skip
    parser.add_argument("--seeds", type=_seeds, default=[0, 1, 2], metavar="N,N,...", help="0,1,2 without it")
    parser.add_argument("--print", action="store_true", help="print all that is kept and run nothing")
    parser.add_argument("--markdown", action="store_true", help="print tables for a document")
    return parser


if __name__ == "__main__":
    sys.exit(main())
