"""Tables: how each figure orders the lifters of a family, and every lifter with its errors and score."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.common import Sheet
from benchmarks.score_2d.lifters import ERRORS

__all__ = ["lifter_sheet", "rank_sheet", "spearman"]

Results = Mapping[str, Mapping[str, Any]]

_SHOWN = ("score_2d", "unrealistic", "uncovered", "relift", "uneven", "bones", "mirrored")


def spearman(one: np.ndarray, other: np.ndarray) -> float:
    """Return the correlation of the ranks, ties sharing theirs; NaN for fewer than three."""
    if len(one) < 3:
        return float("nan")
    ranks = [_ranks(values) for values in (one, other)]
    return float(np.corrcoef(*ranks)[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    _, code, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[code]


def rank_sheet(family: str, results: Results) -> Sheet:
    """Return Spearman's correlation of each figure with each error, and regrets.

    Of all fits, of the half of them with the least `p_mpjpe`, and of fits and distorted lifters together. A regret is
    how much larger the error of the lifter with the least figure is than the least error.
    """
    mine = {key.partition("/")[2]: result for key, result in results.items() if key.startswith(f"{family}/")}
    kinds = _kinds(mine)
    ranked = [(error, kind) for error in ERRORS for kind in kinds]
    chosen = [(error, kind) for error, kind in ranked if kind != "better half"]
    found = []
    for figure in _figures(mine):
        measured = {kind: _column(mine, names, figure) for kind, names in kinds.items()}
        true = {(error, kind): _errors(mine, kinds[kind], error) for error, kind in ranked}
        ranks = [spearman(measured[kind], true[error, kind]) for error, kind in ranked]
        found.append((figure, ranks, [_regret(measured[kind], true[error, kind]) for error, kind in chosen]))
    found.sort(key=lambda row: -np.nan_to_num(np.mean(row[1])))
    head = ["figure", *(f"{error}, {kind}" for error, kind in ranked)]
    head += [f"regret {error}, {kind}" for error, kind in chosen]
    rows = [
        [name, *(f"{rank:.2f}" for rank in ranks), *(f"{one:.0%}" for one in regrets)] for name, ranks, regrets in found
    ]
    count = f"{len(kinds['fits'])} fits, {len(mine) - len(kinds['fits'])} distorted"
    return Sheet(f"{family}: {count}", head, rows)


def _kinds(mine: Results) -> dict[str, list[str]]:
    """Return the names of the lifters that are ranked together."""
    fits = [name for name in mine if ", " not in name]
    best = sorted(fits, key=lambda name: mine[name]["errors"]["p_mpjpe"])
    return {"fits": fits, "better half": best[: (len(best) + 1) // 2], "all": list(mine)}


def _figures(mine: Results) -> list[str]:
    first = next(iter(mine.values()))
    return [*first["score"], *first["candidates"]]


def _column(mine: Results, names: list[str], figure: str) -> np.ndarray:
    found = [{**mine[name]["score"], **mine[name]["candidates"]}.get(figure, np.nan) for name in names]
    return np.array(found, np.float64)


def _errors(mine: Results, names: list[str], error: str) -> np.ndarray:
    return np.array([mine[name]["errors"][error] for name in names])


def _regret(figure: np.ndarray, error: np.ndarray) -> float:
    return float(error[np.nanargmin(figure)] / error.min() - 1)


def lifter_sheet(family: str, results: Results) -> Sheet:
    """Return every lifter of a family, the best first."""
    mine = {key.partition("/")[2]: result for key, result in results.items() if key.startswith(f"{family}/")}
    order = sorted(mine, key=lambda name: mine[name]["errors"]["p_mpjpe"])
    rows = []
    for name in order:
        errors = [f"{mine[name]['errors'][error]:.1f}" for error in ERRORS]
        figures = [f"{mine[name]['score'][figure]:.3f}" if figure in mine[name]["score"] else "-" for figure in _SHOWN]
        rows.append([name, *errors, *figures])
    return Sheet(family, ["lifter", *ERRORS, *_SHOWN], rows)
