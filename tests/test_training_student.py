"""What the student is shown, and what it is asked for."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from uplift.config import LifterSettings, StudentSettings, ViewSettings
from uplift.data.clean import clean
from uplift.data.tensors import TrainingSet
from uplift.model import build_lifter
from uplift.pose import mean_radius
from uplift.simulator import simulate
from uplift.skeleton import load_skeleton
from uplift.training.student import PseudoPoses, StudentTraining

SKELETON = load_skeleton("h36m17")


@pytest.fixture(scope="module")
def poses() -> PseudoPoses:
    data, _ = clean(simulate(SKELETON, 300, seed=6), SKELETON)
    training_set = TrainingSet.of(data, SKELETON, count_root=False)
    pose = torch.from_numpy(data.pose) / 300
    return PseudoPoses(SKELETON, pose, torch.full((300,), 0.1), training_set.distance, training_set.confidence)


def training(poses: PseudoPoses, **settings: float) -> StudentTraining:
    torch.manual_seed(0)
    lifter = build_lifter(LifterSettings(options={"units": 16}), SKELETON)
    module = StudentTraining(lifter, poses, StudentSettings(**settings), ViewSettings(count_root=False), 0)
    module.on_fit_start()
    return module


def test_views_are_projections_of_their_targets(poses):
    views = training(poses, hide=0.2)._make(200)
    z = views.pose[..., 2:]
    projected = views.pose[..., :2] / (1 + z / views.distance[:, None, None])
    torch.testing.assert_close(views.keypoints, projected, atol=1e-5, rtol=1e-5)


def test_the_radius_is_that_of_the_joints_that_are_shown(poses):
    views = training(poses, hide=0.3)._make(200)
    assert (views.shown == 0).any()
    radius = mean_radius(views.keypoints, views.shown, SKELETON.root_index, count_root=False)
    torch.testing.assert_close(radius, torch.ones(200), atol=1e-5, rtol=1e-5)


def test_the_share_of_hidden_joints(poses):
    views = training(poses, hide=0.15)._make(4000)
    assert (views.shown[:, 1:] == 0).float().mean() == pytest.approx(0.15, abs=0.01)
    assert (views.shown[:, SKELETON.root_index] > 0).all()
    assert (training(poses, hide=0.0)._make(50).shown == 1).all()


def test_confidence_reaches_the_network_as_it_is(poses):
    doubtful = replace(poses, confidence=torch.full_like(poses.confidence, 0.4))
    assert (training(doubtful, hide=0.0)._make(50).shown == 0.4).all()


def test_frames_with_too_few_joints_teach_nothing_and_stay_finite(poses):
    confidence = torch.zeros_like(poses.confidence)
    confidence[:, :2] = 1
    module = training(replace(poses, confidence=confidence), hide=0.1)
    views = module._make(100)
    assert (views.confidence == 0).all()
    assert views.pose.isfinite().all()
    assert views.pose.abs().max() < 50


def test_missing_joints_have_no_say_in_the_loss(poses):
    wrist = SKELETON.index("lwrist")
    confidence = poses.confidence.clone()
    confidence[:, wrist] = 0
    losses = []
    for wrong in (0.0, 9.0):
        pose = poses.pose.clone()
        pose[:, wrist] += wrong
        module = training(replace(poses, pose=pose, confidence=confidence), hide=0.0, mix=0.0)
        module.mixer = None
        torch.manual_seed(3)
        views = module._make(64)
        lifted = module.lifter(views.keypoints, views.shown, views.distance)
        error = (lifted.pose[..., 2] - views.pose[..., 2]).abs() * views.confidence
        losses.append(error.sum() / views.confidence.sum())
    torch.testing.assert_close(losses[0], losses[1])
