"""Hypotheses: the best of them, their expected error, and calibrated, overconfident and shuffled weights told apart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import write_body

from uplift import evaluate_poses
from uplift.data.formats import read
from uplift.data.poses import PoseData
from uplift.metrics.evaluate import evaluate
from uplift.metrics.pose_metrics import joint_errors
from uplift.metrics.scores import GivenPoses
from uplift.skeleton import load_skeleton

HUMAN = load_skeleton("h36m17")
FRAMES, COUNT = 3000, 4


def some_truth(rng: np.random.Generator) -> PoseData:
    pose = rng.normal(size=(FRAMES, 17, 3)) * 300
    pose -= pose[:, :1]
    return PoseData(pose[..., :2].astype(np.float32), np.ones((FRAMES, 17), np.float32), HUMAN.joints, pose=pose)


def guesses(truth: PoseData, rng: np.random.Generator) -> GivenPoses:
    """Return hypotheses of which one, drawn by the weights, is near the truth, and the others are not."""
    weights = -np.sort(-rng.dirichlet([1.5] * COUNT, FRAMES))
    right = (weights.cumsum(1) < rng.random(FRAMES)[:, None]).sum(1)
    noise = rng.normal(size=(FRAMES, COUNT, 17, 3))
    noise *= np.where(np.arange(COUNT) == right[:, None], 20, 100)[..., None, None]
    hypotheses = truth.pose[:, None] + noise
    return GivenPoses(hypotheses[:, 0], HUMAN.joints, hypotheses=hypotheses, weights=weights)


def test_figures_are_those_of_the_single_hypotheses() -> None:
    rng = np.random.default_rng(0)
    truth = some_truth(rng)
    given = guesses(truth, rng)
    assert given.hypotheses is not None and given.weights is not None
    found = evaluate(given, truth, HUMAN)
    errors = np.stack(
        [joint_errors("p_mpjpe", one, truth.pose, 0).mean(1) for one in np.moveaxis(given.hypotheses, 1, 0)], 1
    )
    worth = found.hypotheses
    assert worth is not None and worth["count"] == COUNT
    assert worth["best_of"] == pytest.approx(errors.min(1).mean())
    assert worth["likeliest"] == pytest.approx(errors[:, 0].mean()) == pytest.approx(found.overall["p_mpjpe"])
    assert worth["expected"] == pytest.approx((errors * given.weights).sum(1).mean())
    assert worth["best_of"] < worth["expected"]
    assert sum(of["hypotheses"] for of in worth["calibration"].values()) == FRAMES * COUNT
    assert f"{COUNT} hypotheses" in found.table() and json.dumps(found.to_dict())


def test_weights_are_right_as_often_as_they_say_or_it_shows() -> None:
    rng = np.random.default_rng(1)
    truth = some_truth(rng)
    given = guesses(truth, rng)
    assert given.weights is not None
    sharper = given.weights**4 / (given.weights**4).sum(1, keepdims=True)
    good, bold, blind = (
        evaluate(replace(given, weights=weights), truth, HUMAN).hypotheses or {}
        for weights in (given.weights, sharper, given.weights[:, ::-1])
    )
    assert good["weight_error"] < 0.02
    for of in good["calibration"].values():
        assert abs(of["said"] - of["found"]) < 0.03 + 2 / np.sqrt(of["hypotheses"])
    assert bold["weight_error"] > 0.1 and bold["calibration"]["0.9-1"]["found"] < 0.8
    assert blind["weight_error"] > 0.2


def test_missing_hypotheses_and_reordered_joints_change_nothing() -> None:
    rng = np.random.default_rng(2)
    truth = some_truth(rng)
    given = guesses(truth, rng)
    assert given.hypotheses is not None and given.weights is not None
    order = rng.permutation(17)
    names = tuple(HUMAN.joints[joint] for joint in order)
    turned = GivenPoses(given.pose[:, order], names, hypotheses=given.hypotheses[:, :, order], weights=given.weights)
    one, other = (evaluate(of, truth, HUMAN).hypotheses or {} for of in (given, turned))
    assert {**one, "calibration": 0} == pytest.approx({**other, "calibration": 0})
    nothing = np.full_like(given.hypotheses[:, :1], np.nan)
    padded = replace(
        given,
        hypotheses=np.concatenate([given.hypotheses, nothing], 1),
        weights=np.concatenate([given.weights, np.zeros((FRAMES, 1))], 1),
    )
    one, other = (evaluate(of, truth, HUMAN).hypotheses or {} for of in (given, padded))
    assert {name: one[name] for name in ("best_of", "expected", "likeliest")} == pytest.approx(
        {name: other[name] for name in ("best_of", "expected", "likeliest")}
    )


def test_a_file_of_poses_may_hold_hypotheses(tmp_path: Path) -> None:
    truth = read(write_body(tmp_path / "truth.npz"))
    assert truth.pose is not None
    hypotheses = np.stack([truth.pose * (1, 1, -1), truth.pose], 1)
    more = {"hypotheses": hypotheses, "weights": np.tile([0.7, 0.3], (len(truth), 1))}
    write_body(tmp_path / "poses.npz", **more)
    found = evaluate_poses(tmp_path / "poses.npz", tmp_path / "truth.npz", "h36m17").hypotheses
    assert found is not None and found["best_of"] == pytest.approx(0, abs=1e-3)
    assert found["expected"] == pytest.approx(0.7 * found["likeliest"], rel=1e-3)
    assert found["calibration"]["0.7-0.8"]["found"] == 0 and found["calibration"]["0.3-0.4"]["found"] == 1
