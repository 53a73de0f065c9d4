"""The calibration curve: whether errors lie in the intervals that the spread gives as often as they should."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.metrics.evaluate import NOMINAL, coverage_of, evaluate, rank_correlation
from uplift.metrics.report import Evaluation
from uplift.metrics.scores import GivenPoses
from uplift.skeleton import load_skeleton

HUMAN = load_skeleton("h36m17")
FRAMES = 3000


def a_truth(seed: int = 0) -> PoseData:
    """Return random bodies in mm."""
    pose = np.random.default_rng(seed).normal(size=(FRAMES, 17, 3)) * 300
    pose -= pose[:, HUMAN.root_index, None]
    ones = np.ones((FRAMES, 17), np.float32)
    return PoseData(pose[..., :2].astype(np.float32), ones, HUMAN.joints, pose=pose.astype(np.float32))


def a_guess(truth: PoseData, factor: float = 1.0, unit: str = "mm") -> GivenPoses:
    """Return the truth with Laplace noise on its depth, whose scale is the spread over ``factor``."""
    rng = np.random.default_rng(7)
    assert truth.pose is not None
    scale = rng.uniform(5, 60, size=(FRAMES, 17))
    pose = truth.pose.astype(np.float64)
    pose[..., 2] += rng.laplace(scale=scale)
    pose[:, HUMAN.root_index] = 0
    size = 1.0 if unit == "mm" else 0.004
    return GivenPoses(pose * size, truth.joint_names, unit, uncertainty=scale * factor * size)


def found_of(result: Evaluation, group: str = "visible") -> np.ndarray:
    assert result.calibration is not None
    assert [float(name) for name in result.calibration[group]] == list(NOMINAL)
    return np.array(list(result.calibration[group].values()))


@pytest.mark.parametrize("unit", ["mm", "relative", "px"])
def test_laplace_errors_give_the_nominal_shares(unit: str) -> None:
    truth = a_truth()
    result = evaluate(a_guess(truth, unit=unit), truth, HUMAN)
    assert found_of(result) == pytest.approx(NOMINAL, abs=0.01)
    assert result.calibration is not None
    assert result.calibration["uncertainty_error"] < 0.008
    assert result.calibration["rank_correlation"] > 0.4
    assert "missing" not in result.calibration


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_spread_of_the_wrong_size_is_seen(factor: float) -> None:
    truth = a_truth()
    right, wrong = (evaluate(a_guess(truth, f), truth, HUMAN) for f in (1.0, factor))
    # A Laplace error lies within f times the interval of q with probability 1 - (1 - q)^f.
    expected = 1 - (1 - np.array(NOMINAL)) ** factor
    assert found_of(wrong) == pytest.approx(expected, abs=0.01)
    assert (found_of(wrong) < NOMINAL).all() == (factor < 1)
    assert right.calibration is not None
    assert wrong.calibration is not None
    assert wrong.calibration["uncertainty_error"] == pytest.approx(np.abs(expected - NOMINAL).mean(), abs=0.01)
    assert wrong.calibration["rank_correlation"] == pytest.approx(right.calibration["rank_correlation"])


def test_missing_joints_are_told_apart_and_the_root_has_no_part() -> None:
    truth, wrist = a_truth(), HUMAN.index("rwrist")
    guess = a_guess(truth)
    assert guess.uncertainty is not None
    guess.uncertainty[:, wrist] /= 2
    guess.uncertainty[:, HUMAN.root_index] = 1e-9
    truth.confidence[:, wrist] = 0
    result = evaluate(guess, truth, HUMAN)
    assert found_of(result) == pytest.approx(NOMINAL, abs=0.01)
    assert found_of(result, "missing") == pytest.approx(1 - np.sqrt(1 - np.array(NOMINAL)), abs=0.03)
    assert result.calibration is not None
    assert result.calibration["uncertainty_error_missing"] > 5 * result.calibration["uncertainty_error"]


def test_no_spread_no_entry() -> None:
    truth = a_truth()
    result = evaluate(replace(a_guess(truth), uncertainty=None), truth, HUMAN)
    assert result.calibration is None
    assert "calibration" not in result.to_dict()
    assert "uncertainty_error" not in result.table()
    blank = evaluate(replace(a_guess(truth), uncertainty=np.full((FRAMES, 17), np.nan)), truth, HUMAN)
    assert blank.calibration is None


def test_what_is_not_asked_for_is_the_same_with_a_spread() -> None:
    truth = a_truth()
    with_it, without = a_guess(truth), replace(a_guess(truth), uncertainty=None)
    assert evaluate(with_it, truth, HUMAN).overall == evaluate(without, truth, HUMAN).overall


def test_joints_are_matched_by_name_and_frames_left_out_with_their_spread() -> None:
    truth, guess = a_truth(), a_guess(a_truth())
    assert guess.uncertainty is not None
    truth.confidence[:100, 2:] = 0
    order = np.random.default_rng(1).permutation(17)
    names = tuple(HUMAN.joints[joint] for joint in order)
    turned = replace(guess, pose=guess.pose[:, order], joint_names=names, uncertainty=guess.uncertainty[:, order])
    assert evaluate(turned, truth, HUMAN).calibration == evaluate(guess, truth, HUMAN).calibration


def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = a_truth()
    whole = evaluate(a_guess(truth, unit="px"), truth, HUMAN)
    monkeypatch.setattr("uplift.metrics.evaluate._CHUNK", 7)
    assert evaluate(a_guess(truth, unit="px"), truth, HUMAN).calibration == whole.calibration


def test_it_is_written_and_printed(tmp_path) -> None:
    truth = a_truth()
    truth.confidence[:, 3] = 0
    result = evaluate(a_guess(truth), truth, HUMAN)
    assert result.calibration is not None
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["calibration"] == result.calibration
    lines = result.table().splitlines()
    head = next(place for place, line in enumerate(lines) if "uncertainty_error" in line)
    assert lines[head].split()[-7:-2] == [f"{q:g}" for q in NOMINAL]
    assert lines[head + 1].split()[:2] == ["joints", "visible"]
    assert float(lines[head + 2].split()[-2]) == pytest.approx(
        result.calibration["uncertainty_error_missing"], abs=5e-4
    )
    result.write_csv(tmp_path / "evaluation.csv")
    with (tmp_path / "evaluation.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["group"] == "calibration"]
    told = {(row["name"], row["protocol"]): float(row["value"]) for row in rows}
    assert told["missing", "0.9"] == result.calibration["missing"]["0.9"]
    assert told["", "uncertainty_error"] == result.calibration["uncertainty_error"]
    assert len(told) == 14


def test_impossible_spreads_are_refused_in_words() -> None:
    truth = a_truth()
    guess = replace(a_guess(truth), source="mine.npz")
    assert guess.uncertainty is not None
    with pytest.raises(UserError, match=r"mine.npz: 'uncertainty' has shape \(3000, 16\), expected \(3000, 17\)"):
        evaluate(replace(guess, uncertainty=guess.uncertainty[:, :16]), truth, HUMAN)
    with pytest.raises(UserError, match=r"'uncertainty' goes down to -"):
        evaluate(replace(guess, uncertainty=-guess.uncertainty), truth, HUMAN)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=2, max_size=30))
def test_rank_correlation_is_spearmans(pairs: list[tuple[int, int]]) -> None:
    stats = pytest.importorskip("scipy.stats")
    one, other = np.array(pairs, np.float64).T
    found = rank_correlation(one, other)
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        assert found is None
    else:
        assert found == pytest.approx(stats.spearmanr(one, other).statistic, abs=1e-9)


def test_an_error_on_the_border_is_inside() -> None:
    assert coverage_of(np.zeros(3), np.zeros(3)) == {f"{q:g}": 1.0 for q in NOMINAL}
    assert coverage_of(np.ones(4), np.zeros(4))["0.95"] == 0
