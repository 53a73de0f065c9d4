"""What a network is shown, in training and after it: confidences as settings say, distances as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, bodies, seen_bodies, small_lifter
from modules import lifting_module, student_module
from torch import Tensor

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.priors.bones import Bones
from uplift.training.pseudo_labels import PseudoPoses, lift_all

DISTANCES = np.random.default_rng(0).uniform(4000, 12_000, 40)


@pytest.fixture(scope="module")
def frames() -> TrainingSet:
    """Return bodies at many distances, every joint of confidence 0.4."""
    data = replace(seen_bodies(), confidence=np.full((40, 17), 0.4, np.float32))
    points = data.pose + np.stack([np.zeros(40), np.zeros(40), DISTANCES], -1)[:, None]
    seen = points[..., :2] / points[..., 2:] * 1145 + 500
    return to_training_set(replace(data, keypoints=seen.astype(np.float32)), H36M, LifterSettings())


def teacher_of(lifter: Lifter, frames: TrainingSet) -> Callable[[], object]:
    return lambda: lifting_module(lifter, frames, {"bones": Bones(H36M)}).objective(16)


def student_of(lifter: Lifter, frames: TrainingSet) -> Callable[[], object]:
    poses = lift_all(small_lifter(), frames, RefineSettings(iterations=0))
    return lambda: student_module(lifter, poses, occlude=0.0).objective(16)


def prediction_of(lifter: Lifter, frames: TrainingSet) -> Callable[[], object]:
    data = replace(bodies(40), confidence=np.full((40, 17), 0.4, np.float32))
    settings = LifterSettings(confidence="calibrated" if lifter.calibrated else "given")
    return lambda: Model(lifter, H36M, settings).predict(data)


@pytest.mark.parametrize(("confidence", "expected"), [("given", 0.4), ("calibrated", 1.0)])
@pytest.mark.parametrize("use", [teacher_of, student_of, prediction_of])
def test_the_network_is_given_the_confidence(
    frames: TrainingSet, use: Callable, confidence: str, expected: float
) -> None:
    lifter, seen = small_lifter(confidence=confidence), []
    run = use(lifter, frames)
    lifter.network.register_forward_pre_hook(lambda module, given: seen.append(given[0][:, 2 * 17 :]))
    run()
    assert seen and all(torch.equal(shown, torch.full_like(shown, expected)) for shown in seen)


def reach(pose: Tensor, distance: Tensor) -> Tensor:
    """Return the length of all bones over the distance: no view, mirror image or unit changes it."""
    start, end = torch.tensor(H36M.bone_indices.copy()).T
    return (pose[:, end] - pose[:, start]).norm(dim=-1).sum(1) / distance


def distances_in(lifter: Lifter, run: Callable[[], object]) -> Tensor:
    """Return the distances that the lifter is called with."""
    given: list[Tensor] = []
    hook = lifter.register_forward_pre_hook(lambda module, arguments: given.append(arguments[2]))
    run()
    hook.remove()
    return torch.cat(given)


def test_the_teacher_lifts_each_frame_at_its_own_distance(frames: TrainingSet) -> None:
    np.testing.assert_allclose(frames.distance * frames.scale, 1145, rtol=1e-5)  # focal length over the body's radius
    lifter = small_lifter(tilt="level")
    module = lifting_module(lifter, frames, {"bones": Bones(H36M)})
    given = distances_in(lifter, lambda: module.objective(16))
    assert torch.equal(given[:16], frames.distance[module.last_lift.row])
    assert torch.equal(given[:16], module.last_lift.distance)
    poses = lift_all(lifter, replace(frames, rotation=None), RefineSettings(iterations=0))
    torch.testing.assert_close(lifter.camera.project(poses.pose, frames.distance), frames.keypoints)
    assert torch.equal(poses.distance, frames.distance)


def test_the_student_is_shown_each_body_at_the_distance_it_was_seen_from(frames: TrainingSet) -> None:
    poses: PseudoPoses = lift_all(small_lifter(), frames, RefineSettings(iterations=0))
    lifter = small_lifter()
    module = student_module(lifter, poses, mix=0.0, stretch=0.0)
    views = module.maker(64)
    known, found = reach(poses.pose, poses.distance), reach(views.pose, views.distance)
    assert known.max() / known.min() > 2
    assert (found[:, None] / known - 1).abs().min(1).values.max() < 1e-4
    assert torch.equal(distances_in(lifter, lambda: module.objective(views)), views.distance)
