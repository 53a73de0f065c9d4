"""Tables: how each figure orders the lifters of a family, and every lifter with its errors and score."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.common import Sheet
from benchmarks.score_2d.lifters import ERRORS

__all__ = ["lifter_sheet", "rank_sheet", "spearman"]

Results = Mapping[str, Mapping[str, Any]]

_SHOWN = ("score_2d", "strange", "unreached", "relift", "uneven", "bones", "mirrored")


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
    """Return Spearman's correlation of each figure with each error, of fits alone and with distorted ones, and regrets.

    A regret is how much larger the error of the lifter with the least figure is than the least error.
    """
    mine = {key.partition("/")[2]: result for key, result in results.items() if key.startswith(f"{family}/")}
    kinds = {"fits": [name for name in mine if ", " not in name], "all": list(mine)}
    pairs = [(error, kind) for error in ERRORS for kind in kinds]
    found = []
    for figure in _figures(mine):
        measured = {kind: _column(mine, names, figure) for kind, names in kinds.items()}
        true = {(error, kind): _errors(mine, kinds[kind], error) for error, kind in pairs}
        ranks = [spearman(measured[kind], true[error, kind]) for error, kind in pairs]
        found.append((figure, ranks, [_regret(measured[kind], true[error, kind]) for error, kind in pairs]))
    found.sort(key=lambda row: -np.nan_to_num(np.mean(row[1])))
    head = [
        "figure",
        *(f"{error}, {kind}" for error, kind in pairs),
        *(f"regret {error}, {kind}" for error, kind in pairs),
    ]
    rows = [
        [figure, *(f"{rank:.2f}" for rank in ranks), *(f"{one:.0%}" for one in regrets)]
        for figure, ranks, regrets in found
    ]
    count = f"{len(kinds['fits'])} fits, {len(mine) - len(kinds['fits'])} distorted"
    return Sheet(f"{family}: {count}", head, rows)


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
