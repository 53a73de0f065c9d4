"""What `refine_clips` minimises and how, number by number: the terms of its cost in plain loops, and Adam's steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, doubles, seen_bodies

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.geometry.camera import Perspective
from uplift.models.refine import _blocks, _Problem, refine_clips

SETTINGS = RefineSettings(bones=0.7, near=1.3, seen=0.6, smooth=2.0, iterations=3, rate=0.05)
CLIPS = (5, 3)
ROOT = H36M.root_index
TERMS = ("depth", "size", "shape", "shift")


@pytest.fixture
def problem() -> _Problem:
    with doubles():
        frames, depth = small_clips()
        made = _Problem(frames, torch.arange(8), frames.keypoints, depth, Perspective(), SETTINGS)
        with torch.no_grad():
            for name in TERMS:
                value = getattr(made, name)
                value.add_(0.3 * torch.randn(value.shape, generator=torch.Generator().manual_seed(len(name))))
        return made


def small_clips() -> tuple[TrainingSet, torch.Tensor]:
    """Return two clips seen by a known camera, some joints sure, some doubtful, some missing, and random depths."""
    rng = np.random.default_rng(3)
    data = seen_bodies().select(slice(0, 8))
    confidence = rng.choice([0.0, 0.4, 0.9995, 1.0], (8, 17))
    confidence[:, ROOT] = 1
    identity = {"sequence": np.repeat(["a", "b"], CLIPS), "frame": np.concatenate([np.arange(n) for n in CLIPS])}
    keypoints = data.keypoints.astype(float)
    data = replace(data, keypoints=keypoints, confidence=confidence, identity=identity)
    depth = torch.from_numpy(rng.normal(0, 0.5, (8, 17)))
    return to_training_set(data, H36M, LifterSettings()), depth


def huber(value: float, delta: float) -> float:
    return value * value / 2 if abs(value) <= delta else delta * (abs(value) - delta / 2)


def cost_by_hand(frames: TrainingSet, lifted: np.ndarray, depth, size, shape, shift) -> dict[str, float]:
    """Return each term: bones, near, seen, alike sides, alike clips, size, smooth; frame by frame."""
    clip, confidence, far = frames.clip.numpy(), frames.confidence.numpy(), frames.distance.numpy()
    bones, partner = H36M.bone_indices, H36M.bone_mirror_permutation
    seen = np.where(confidence > 0, 1, 0.1)
    keypoints = frames.keypoints.numpy()

    def pose_of(points, z):
        return np.concatenate([points * (1 + z / far[:, None])[..., None], z[..., None]], -1)

    def logs(pose):
        return np.log(np.linalg.norm(pose[:, bones[:, 1]] - pose[:, bones[:, 0]], axis=-1))

    weight = seen[:, bones[:, 0]] * seen[:, bones[:, 1]]
    first = logs(pose_of(keypoints, lifted))
    start = -np.log((np.exp(first) * weight).sum(1) / weight.sum(1))
    scaled = first + start[:, None]
    mean = np.array([np.average(scaled[clip == c], 0, weight[clip == c]) for c in (0, 1)])
    common = np.average(scaled, 0, weight)
    common = (common + common[partner]) / 2
    spread = ((mean - common) ** 2).mean(0) + 0.02**2

    loose = confidence < 0.999
    z = np.where(np.arange(17) == ROOT, 0, depth)
    pose = pose_of(keypoints + shift * loose[..., None], z)
    cost = dict.fromkeys(("bones", "near", "seen", "sides", "clips", "size", "smooth"), 0.0)
    for f in range(8):
        off = (logs(pose)[f] + size[f] - shape[clip[f]]) * weight[f]
        cost["bones"] += sum(huber(one, 0.1) for one in off) / 8
        cost["near"] += sum(huber(one, 0.2) * w for one, w in zip(depth[f] - lifted[f], seen[f], strict=True)) / 8
        for joint, c in enumerate(confidence[f]):
            hold = c * c if c > 0 else SETTINGS.near / SETTINGS.seen
            cost["seen"] += sum(huber(one, 0.05) for one in shift[f, joint]) * hold / 8
        cost["size"] += (size[f] - start[f]) ** 2 / 8
    cost["sides"] = ((shape - shape[:, partner]) ** 2).sum(1).mean()
    cost["clips"] = ((shape - common) ** 2 / spread).mean()
    place = (pose + np.stack([0 * far, 0 * far, far], -1)[:, None]) * np.exp(size)[:, None, None]
    place = np.einsum("fba,fjb->fja", frames.rotation.numpy(), place)
    middles = [1, 2, 3, 6]
    for f in middles:
        second = place[f - 1] - 2 * place[f] + place[f + 1]
        cost["smooth"] += sum(huber(one, 0.1) for one in second.ravel()) / len(middles)
    return cost


def test_the_cost_is_the_sum_of_its_terms(problem: _Problem) -> None:
    with doubles():
        frames, depth = small_clips()
        values = {name: getattr(problem, name).detach().numpy() for name in TERMS}
        cost = cost_by_hand(frames, depth.numpy(), **values)
        weights = {"bones": 7.0, "near": 1.3, "seen": 0.6, "sides": 1.0, "clips": 0.03, "size": 1.0, "smooth": 2.0}
        expected = sum(weights[name] * value for name, value in cost.items())
        assert all(weights[name] * value > 1e-3 * expected for name, value in cost.items()), cost
        assert float(problem.loss()) == pytest.approx(expected, rel=1e-6)
        problem.settings = replace(SETTINGS, smooth=0.0)
        assert float(problem.loss()) == pytest.approx(expected - 2 * cost["smooth"], rel=1e-6)


def test_it_is_minimised_by_adam_at_a_falling_rate_of_each_kind() -> None:
    """Three steps by hand: the rate falls to a tenth, and depths move twice as fast as sizes and shifts, four times as shapes."""
    with doubles():
        frames, depth = small_clips()
        made = _Problem(frames, torch.arange(8), frames.keypoints, depth, Perspective(), SETTINGS)
        share = {"depth": 1.0, "size": 0.5, "shape": 0.25, "shift": 0.5}
        moments = {name: [torch.zeros_like(getattr(made, name)) for _ in range(2)] for name in TERMS}
        for step in range(3):
            gradients = torch.autograd.grad(made.loss(), [getattr(made, name) for name in TERMS])
            for name, gradient in zip(TERMS, gradients, strict=True):
                first, second = moments[name]
                first.mul_(0.8).add_(0.2 * gradient)
                second.mul_(0.9).add_(0.1 * gradient.square())
                rate = 0.05 * share[name] * (1 - 0.9 * step / 3)
                moved = first / (1 - 0.8 ** (step + 1)) / ((second / (1 - 0.9 ** (step + 1))).sqrt() + 1e-8)
                with torch.no_grad():
                    getattr(made, name).sub_(rate * moved)
        expected = made.pose().detach()
        found = refine_clips(frames, frames.keypoints, depth, Perspective(), SETTINGS)
        torch.testing.assert_close(found, expected - expected[:, [ROOT]], rtol=1e-7, atol=1e-9)


def test_blocks_are_whole_clips_of_twenty_thousand_frames() -> None:
    edges = torch.tensor([0, 9000, 20_000, 20_001, 60_000, 60_010])
    assert _blocks(edges) == [(0, 2), (2, 3), (3, 4), (4, 5)]
    assert _blocks(torch.tensor([0, 5, 9])) == [(0, 2)]


def test_clips_are_solved_alike_in_any_order_of_their_rows() -> None:
    """Rows of two clips that alternate: each is put together, solved, and put back."""
    with doubles():
        frames, depth = small_clips()
        straight = refine_clips(frames, frames.keypoints, depth, Perspective(), replace(SETTINGS, smooth=0.0))
        order = torch.tensor([5, 0, 6, 1, 2, 7, 3, 4])
        mixed = frames.select(order)
        found = refine_clips(mixed, mixed.keypoints, depth[order], Perspective(), replace(SETTINGS, smooth=0.0))
        torch.testing.assert_close(found, straight[order], rtol=1e-9, atol=1e-12)
