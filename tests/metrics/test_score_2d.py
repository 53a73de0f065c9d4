"""The score without truth: a lifter that knows every body from all sides beats the same one made wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from torch import Tensor

from uplift.config.settings import LifterSettings
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import to_training_set, with_labels
from uplift.errors import UserError
from uplift.geometry.camera import build_camera
from uplift.geometry.normalise import renormalise
from uplift.geometry.rotation import random_rotations, turn, views_about_gravity
from uplift.metrics.score_2d import WEIGHTS, score_2d
from uplift.models.lifter import Lifted, Lifter
from uplift.models.model import Model
from uplift.skeleton import Skeleton, load_skeleton

HUMAN, HAND = load_skeleton("h36m17"), load_skeleton("hand21")
SETTINGS = LifterSettings(both_ways=False, options={"units": 16, "blocks": 1})
FIGURES = set(WEIGHTS)

Change = Callable[[Tensor, Tensor], Tensor]


class Oracle(Lifter):
    """A lifter that has seen the true poses from everywhere: it gives the depths of the view most like its keypoints.

    ``change`` makes depths (frames joints) of keypoints (frames joints 2) wrong.
    """

    def __init__(self, data: PoseData, skeleton: Skeleton, change: Change = lambda depth, keypoints: depth):
        super().__init__(skeleton, SETTINGS)
        self.change = change
        self.keypoints, self.depth, self.tilt = _memory(data, skeleton)

    def forward(self, keypoints: Tensor, confidence: Tensor, distance: Tensor) -> Lifted:
        seen = (confidence > 0).float()
        near = (self.keypoints.square().sum(-1) @ seen.mT).mT - 2 * (keypoints * seen[..., None]).flatten(1) @ (
            self.keypoints.flatten(1).mT
        )
        row = near.argmin(1)
        depth = self.change(self.depth[row], keypoints)
        filled = torch.where(seen[..., None] > 0, keypoints, self.keypoints[row])
        return Lifted(self.camera.unproject(filled, depth, distance), self.tilt[row], filled)


def _memory(data: PoseData, skeleton: Skeleton) -> tuple[Tensor, Tensor, Tensor]:
    """Return keypoints, depths and tilts of the true poses as they were seen and from many sides."""
    assert data.pose is not None
    frames = with_labels(
        to_training_set(data, skeleton, SETTINGS), replace(data, labelled=np.ones(len(data), dtype=bool))
    )
    assert frames.labels is not None and frames.label_tilt is not None
    tilt = frames.label_tilt if skeleton.gravity else torch.zeros(len(frames))
    generator = torch.Generator().manual_seed(5)
    keypoints, depth, tilts = [frames.keypoints], [frames.labels[..., 2]], [tilt]
    for _ in range(40):
        azimuth = 2 * torch.pi * torch.rand(len(frames), generator=generator)
        new = tilt[torch.randperm(len(frames), generator=generator)]
        with torch.random.fork_rng():
            torch.manual_seed(len(depth))
            views = views_about_gravity(tilt, azimuth, new) if skeleton.gravity else random_rotations(len(frames))
        pose = turn(frames.labels, views)
        seen = build_camera("perspective").project(pose, frames.distance)
        seen, radius = renormalise(seen, frames.confidence, skeleton.root_index, count_root=False)
        keypoints.append(seen)
        depth.append(pose[..., 2] / radius[:, None])
        tilts.append(new)
    return torch.cat(keypoints), torch.cat(depth), torch.cat(tilts)


@lru_cache
def bodies(skeleton: Skeleton = HUMAN, frames: int = 240) -> PoseData:
    return simulate(skeleton, frames, seed=4, clip_seconds=1.0)


def scored(change: Change | None = None, data: PoseData | None = None, skeleton: Skeleton = HUMAN, **more):
    known = bodies(skeleton)
    lifter = Oracle(known, skeleton) if change is None else Oracle(known, skeleton, change)
    return score_2d(Model(lifter, skeleton, SETTINGS), known if data is None else data, **more)  # type: ignore[arg-type]


def small_lifter(skeleton: Skeleton = HUMAN) -> Model:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Model(Lifter(skeleton, SETTINGS), skeleton, SETTINGS)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda depth, keypoints: torch.zeros_like(depth), id="flat"),
        pytest.param(lambda depth, keypoints: depth[:1].expand_as(depth), id="constant"),
        pytest.param(lambda depth, keypoints: -depth, id="flipped"),
        pytest.param(lambda depth, keypoints: 1.5 * depth, id="exaggerated"),
        pytest.param(lambda depth, keypoints: 0.5 * depth, id="shrunken"),
        pytest.param(lambda depth, keypoints: depth * torch.sin(99 * keypoints[:, 1, :1]).sign(), id="half flipped"),
        pytest.param(lambda depth, keypoints: depth + 0.3 * torch.sin(40 * keypoints[..., 0]), id="crumpled"),
    ],
)
@pytest.mark.parametrize("skeleton", [HUMAN, HAND], ids=["human", "hand"])
def test_wrong_lifters_score_worse(change: Change, skeleton: Skeleton) -> None:
    assert scored(change, skeleton=skeleton)["score_2d"] > scored(skeleton=skeleton)["score_2d"] + 0.03


def test_an_untrained_network_scores_worse() -> None:
    assert score_2d(small_lifter(), bodies())["score_2d"] > scored()["score_2d"] + 0.1


def test_the_score_is_the_weighted_sum_of_the_figures() -> None:
    found = scored()
    assert set(found) == FIGURES | {"score_2d"}
    assert found["score_2d"] == pytest.approx(sum(WEIGHTS[name] * found[name] for name in FIGURES))


def test_truth_is_not_used() -> None:
    data, model = bodies(), small_lifter()
    assert data.pose is not None and data.root is not None and data.tilt_deg is not None
    wrong = replace(data, pose=data.pose * np.nan, root=-data.root, tilt_deg=data.tilt_deg + 50)
    assert score_2d(model, wrong) == score_2d(model, data) == score_2d(model, data.without_truth())


def test_a_seed_gives_the_same_score_and_leaves_the_global_random_state() -> None:
    model = small_lifter()
    first = score_2d(model, bodies(), most=100)
    torch.manual_seed(77)
    before = torch.random.get_rng_state()
    assert score_2d(model, bodies(), most=100) == first
    assert torch.equal(before, torch.random.get_rng_state())
    assert score_2d(model, bodies(), most=100, seed=1) != first


def test_the_lifter_is_left_as_it_was() -> None:
    model = small_lifter()
    model.lifter.train()
    model.lifter.network.eval()  # a part that the caller has frozen
    score_2d(model, bodies())
    assert model.lifter.training and not model.lifter.network.training
    assert all(weight.grad is None for weight in model.lifter.parameters())


def test_the_scale_of_pixels_does_not_matter() -> None:
    data = replace(bodies(), focal_px=None)
    larger = replace(data, keypoints=3 * data.keypoints)
    model = small_lifter()
    assert score_2d(model, larger) == pytest.approx(score_2d(model, data), rel=1e-3)


def test_the_order_of_frames_does_not_matter_where_all_are_used() -> None:
    data, model = bodies(), small_lifter()
    turned = data.select(np.arange(len(data))[::-1])
    assert score_2d(model, turned)["bones"] == pytest.approx(score_2d(model, data)["bones"], rel=1e-4)


@pytest.mark.parametrize("skeleton", ["h36m17", "hand21", "chair10", "quadruped28"])
@pytest.mark.parametrize("case", ["few", "one film", "no identity", "missing joints", "known camera"])
def test_whatever_the_data_has(skeleton: str, case: str) -> None:
    shape = load_skeleton(skeleton)
    data = simulate(shape, 60, seed=1, missing=0.3 if case == "missing joints" else 0.0)
    if case == "few":
        data = data.select(np.arange(20))
    if case == "one film":
        data = replace(data, identity={"sequence": np.full(60, "a"), "frame": np.arange(60)})
    if case == "no identity":
        data = replace(data, identity={}, focal_px=None)
    found = score_2d(small_lifter(shape), data)
    assert all(np.isfinite(value) for value in found.values())
    assert {"score_2d", "unrealistic", "uncovered", "relift", "bones", "uneven"} <= set(found)


def test_figures_that_cannot_be_measured_are_left_out() -> None:
    plain = dataclasses.replace(HUMAN, facing={}, mirror=())
    assert "mirrored" not in score_2d(small_lifter(plain), bodies())
    assert "uneven" not in score_2d(small_lifter(), bodies(), azimuth_deg=(-60.0, 60.0))


def test_poses_that_are_not_finite_score_worst() -> None:
    assert scored(lambda depth, keypoints: depth / (keypoints[:, :1, 0] > 0)) == {"score_2d": float("inf")}


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(UserError, match="19 frames"):
        score_2d(small_lifter(), bodies().select(np.arange(19)))
