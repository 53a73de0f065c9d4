"""The benchmark of the score without truth: its families, its tables, and a small run."""

from __future__ import annotations

import contextlib
import shlex
from pathlib import Path

import numpy as np
import pytest
from bodies import QUICK, status_of, write_body

from benchmarks.score_2d import __main__ as runner
from benchmarks.score_2d import lifters
from benchmarks.score_2d.distorted import CHANGES
from benchmarks.score_2d.lifters import ERRORS, Family, families, run_family
from benchmarks.score_2d.show import lifter_sheet, rank_sheet, spearman
from uplift.config.loading import load_settings
from uplift.metrics.score_2d import WEIGHTS


@pytest.mark.parametrize("name", families())
def test_the_words_of_every_fit_are_settings(name: str) -> None:
    family = families()[name]
    for words in family.fits.values():
        task, *rest = shlex.split(f"{family.common} {words}")
        load_settings(task.removeprefix("task="), rest)
    assert family.distort in family.fits


def test_spearman_shares_the_ranks_of_ties() -> None:
    assert spearman(np.array([1.0, 2.0, 3.0]), np.array([10.0, 20.0, 21.0])) == pytest.approx(1)
    assert spearman(np.array([1.0, 1.0, 2.0, 3.0]), np.array([4.0, 3.0, 2.0, 1.0])) == pytest.approx(-0.9486833)


def result(error: float, figure: float) -> dict[str, dict[str, float]]:
    score = {"score_2d": figure, **dict.fromkeys(WEIGHTS, figure)}
    return {"errors": dict.fromkeys(ERRORS, error), "score": score, "candidates": {"MMD": -figure}}


def test_tables_rank_figures_and_name_the_regret() -> None:
    stored = {
        "a/good": result(50, 0.1),
        "a/bad": result(75, 0.2),
        "a/good, flat": result(100, 0.0),
        "a/worst": result(90, 0.3),
        "b/other": result(1, 1),
    }
    sheet = rank_sheet("a", stored)
    rows = {row[0]: row[1:] for row in sheet.rows}
    assert rows["score_2d"][0] == "1.00" and rows["MMD"][0] == "-1.00"
    assert rows["score_2d"][-2:] == ["0%", "100%"] and len(rows["score_2d"]) == 5 * len(ERRORS)
    assert [row[0] for row in lifter_sheet("a", stored).rows] == ["good", "bad", "worst", "good, flat"]


def _in_this_process(verb: str, words: list[str], folder: Path, cores: set[int]) -> None:
    """Run a command in this process, which is faster."""
    with contextlib.chdir(folder):
        assert status_of(verb, *words) == 0


def test_a_run_stores_every_lifter_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(lifters, "RESULTS", tmp_path / "score_2d.json")
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    monkeypatch.setenv("UPLIFT_BENCHMARK_CACHE", str(tmp_path / "cache"))
    file = write_body(tmp_path / "body.npz")
    words = f"skeleton=h36m17 data.train={file} {shlex.join(QUICK)}"
    family = Family("tiny", "body.npz", words, {"only": "seed=3"}, "only", frames=60)
    monkeypatch.setattr(runner, "families", lambda: {"tiny": family})
    monkeypatch.setattr(lifters, "run_uplift", _in_this_process)
    assert runner.main(["--lifters"]) == 0
    assert "score_2d" in capsys.readouterr().out
    assert len(lifters.stored(lifters.RESULTS)) == 2 + len(CHANGES)
    monkeypatch.setattr(lifters, "_run_of", None)  # nothing is fitted again
    run_family(family, tmp_path / "cache")
