"""Priors number by number: what they say of a few frames, in plain loops over frames, joints and bones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, doubles, lift_of, small_lifter, training_set
from torch import nn

from uplift.models.networks import CouplingFlow, build_network
from uplift.priors.base import Lift
from uplift.priors.bones import Bones
from uplift.priors.consistency import Consistency
from uplift.priors.flow import Flow
from uplift.priors.handedness import Handedness
from uplift.priors.imputation import _draw, impute_gaussian
from uplift.priors.labelled import Labelled
from uplift.priors.symmetry import Symmetry

BONES = H36M.bone_indices
ROOT = H36M.root_index


@pytest.fixture(autouse=True)
def _double() -> Iterator[None]:
    with doubles():
        yield


def a_lift(frames: int = 6, **more) -> Lift:
    return lift_of(small_lifter(), training_set(frames, missing=0.3), **more)


def lengths_of(pose: torch.Tensor) -> np.ndarray:
    points = pose.detach().numpy()
    return np.linalg.norm(points[:, BONES[:, 1]] - points[:, BONES[:, 0]], axis=-1)


def both_seen(lift: Lift) -> np.ndarray:
    seen = (lift.confidence > 0).numpy()
    return seen[:, BONES[:, 0]] & seen[:, BONES[:, 1]]


@pytest.mark.parametrize("labelled", [False, True])
@pytest.mark.parametrize("slack", [0.0, 0.2])
def test_bones_are_the_variance_of_their_shares_of_a_frames_size(labelled: bool, slack: float) -> None:
    lift, prior = a_lift(), Bones(H36M, slack=slack)
    labels = torch.randn(4, 17, 3)
    labels[2, 5] = torch.nan  # a frame without all joints does not count
    if labelled:
        prior.prepare(replace(training_set(4), labels=labels))
    lengths, seen = lengths_of(lift.pose), both_seen(lift)
    usual = np.array([lengths[seen[:, b], b].mean() if seen[:, b].any() else 0 for b in range(16)])
    size = [lengths[f][seen[f]].sum() / usual[seen[f]].sum() for f in range(6)]
    true = lengths_of(labels[[0, 1, 3]])
    terms = []
    for bone in range(16):
        share = [lengths[f, bone] / (size[f] * usual.mean()) for f in range(6) if seen[f, bone]]
        mean, variance = (np.mean(share), np.var(share)) if share else (0.0, 0.0)
        variance = max(variance - (slack * mean) ** 2, 0)
        target = (true[:, bone] / true.mean(1)).mean()
        terms.append(variance + (max(abs(mean - target) - 0.05 * target, 0) ** 2 if labelled else 0))
    assert float(prior.loss(lift).detach()) == pytest.approx(np.mean(terms), rel=1e-6)
    off = Bones(H36M, labels=False)
    off.prepare(replace(training_set(4), labels=labels))
    assert off.true_share is None


def test_symmetry_is_the_difference_of_sides_over_the_mean_of_what_is_seen() -> None:
    lift = a_lift()
    lengths, seen, found = lengths_of(lift.pose), both_seen(lift), []
    names = [tuple(H36M.joints[j] for j in bone) for bone in BONES]
    pairs = [(i, j) for i, one in enumerate(names) for j, other in enumerate(names)
             if one[1][0] == "l" and other[1] == "r" + one[1][1:] and "shoulder" not in one[1] and "hip" not in one[1]]  # fmt: skip
    pairs += [(i, j) for i, one in enumerate(names) for j, other in enumerate(names)
              if one[1] in ("lhip", "lshoulder") and other[1] == "r" + one[1][1:]]  # fmt: skip
    assert len(pairs) == 6
    for f in range(6):
        known = [(lengths[f, i], lengths[f, j]) for i, j in pairs if seen[f, i] and seen[f, j]]
        size = np.mean(known) if known else 1
        found += [abs(left - right) / size for left, right in known]
    assert float(Symmetry(H36M).loss(lift).detach()) == pytest.approx(np.mean(found), rel=1e-6)


@pytest.mark.parametrize("planar", [False, True])
def test_handedness_is_of_the_means_of_the_visible_joints_of_each_end(planar: bool) -> None:
    lift, expected = a_lift(12), []
    pose, seen = lift.level_pose.detach().numpy(), lift.confidence.numpy() > 0
    for f in range(12):
        ends = {
            name: [[H36M.index(joint) for joint in end if seen[f, H36M.index(joint)]] for end in H36M.facing[name]]
            for name in ("front", "left")
        }
        if not all(all(sides) for sides in ends.values()):
            continue
        front, left = (pose[f, to].mean(0) - pose[f, start].mean(0) for start, to in ends.values())
        sine = np.cross([0, -1, 0], front) @ left
        flat = np.array([1, 0, 1]) if planar else 1
        sine /= np.linalg.norm(front * flat) * np.linalg.norm(left * flat)
        expected.append(max(0.3 - sine, 0))
    assert len(expected) > 2
    found = Handedness(H36M, planar=planar, margin=0.3).loss(lift).detach()
    assert float(found) == pytest.approx(np.mean(expected), rel=1e-6)


def test_labels_count_in_their_own_unit_over_the_usual_one_and_the_tilt_in_radians() -> None:
    data = training_set(6)
    labels = torch.randn(6, 17, 3)
    labels[0, 4], labels[5] = torch.nan, torch.nan
    unit = torch.tensor([200.0, 300, 400, 500, 600, torch.nan])
    tilt = torch.tensor([0.1, -0.2, torch.nan, 0.4, 0.0, torch.nan])
    data = replace(data, labels=labels, label_unit=unit, label_tilt=tilt)
    prior, bare = Labelled(H36M, elevation=2.0), Labelled(H36M, elevation=0.0)
    for one in (prior, bare):
        one.prepare(data)
    lift = lift_of(small_lifter(tilt="predicted"), data)
    pose, expected, errors = lift.pose.detach(), [], []
    for f in range(6):
        distances = [
            float((pose[f, j] - labels[f, j]).norm()) * float(unit[f])
            for j in range(17)
            if labels[f, j, 0] == labels[f, j, 0]
        ]
        errors += distances
        expected.append(np.mean(distances) / 400 if distances else 0)
    torch.testing.assert_close(bare.loss(lift).detach(), torch.tensor(expected))
    off = [2 * abs(float(lift.tilt[f].detach() - tilt[f])) if tilt[f] == tilt[f] else 0 for f in range(6)]
    torch.testing.assert_close(prior.loss(lift).detach(), torch.tensor(expected) + torch.tensor(off))
    assert prior.metrics(lift)["labelled_error"] == pytest.approx(np.mean(errors))


@pytest.mark.parametrize("root_free", [False, True])
@pytest.mark.parametrize("back", [0.0, 0.5])
def test_consistency_is_the_error_of_the_second_lift_and_of_the_way_back(back: float, root_free: bool) -> None:
    lift = lift_of(small_lifter(root_free=root_free), training_set(6, missing=0.3))
    seen, view = lift.confidence.numpy() > 0, lift.view.detach().numpy()
    scale = lift.reprojected_scale.detach().numpy()[:, None, None]
    rotated = np.einsum("fij,fnj->fni", view, lift.pose.detach().numpy())
    again = lift.relifted.pose.detach().numpy()
    first = (again - again[:, [ROOT]]) - (rotated - rotated[:, [ROOT]]) / scale
    returned = np.einsum("fji,fnj->fni", view, again * scale)
    far = lift.distance.numpy()[:, None, None]
    flat = returned[..., :2] / np.maximum(1 + returned[..., 2:] / far, 0.1)
    second = flat - flat[:, [ROOT]] - lift.keypoints.numpy()
    expected = np.linalg.norm(first, axis=-1)[seen].mean() + back * np.linalg.norm(second, axis=-1)[seen].mean()
    assert float(Consistency(H36M, back=back).loss(lift).detach()) == pytest.approx(expected, rel=1e-6)


def test_missing_values_are_drawn_from_the_gaussian_given_the_others() -> None:
    """Mean and spread of the fourth coordinate given the other three, by the textbook's formulas."""
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(4, 4, generator=generator)
    covariance, mean = root @ root.mT + 0.1 * torch.eye(4), torch.tensor([1.0, -2, 0.5, 3])
    known = torch.tensor([0.3, -1.0, 2.0])
    flat = torch.cat([known, torch.zeros(1)]).repeat(20_000, 1)
    seen = torch.tensor([True, True, True, False]).expand(20_000, 4)
    torch.manual_seed(1)
    drawn = _draw(flat, seen, mean, covariance)
    assert torch.equal(drawn[:, :3], flat[:, :3])
    weights = torch.linalg.solve(covariance[:3, :3], covariance[:3, 3])
    expected = float(mean[3] + weights @ (known - mean[:3]))
    spread = float((covariance[3, 3] - weights @ covariance[:3, 3]).sqrt())
    assert float(drawn[:, 3].mean()) == pytest.approx(expected, abs=4 * spread / 141)
    assert float(drawn[:, 3].std()) == pytest.approx(spread, rel=0.03)


def test_a_joint_that_is_never_seen_is_imputed_too() -> None:
    data = training_set(20, missing=0.2)
    never = data.confidence * (torch.arange(17) != 6)
    filled = impute_gaussian(data.keypoints * (never > 0)[..., None], never)
    assert filled.isfinite().all() and filled[:, 6].abs().max() < 1  # about the origin, with hardly any spread


def test_a_flow_acts_on_whitened_axes_and_costs_a_logarithm_above_the_usual() -> None:
    """An untrained flow is a rotation: the surprise is half the squared distance in whitened axes."""
    data = training_set(300)
    prior = Flow(H36M, axes=5, units=4, steps=0, noise=0.1)
    prior.prepare(data)
    keypoints = data.keypoints[:, [j for j in range(17) if j != ROOT]].flatten(1).numpy()
    other = data.keypoints[:, torch.tensor(H36M.mirror_permutation)] * torch.tensor([-1.0, 1])
    both = np.concatenate([keypoints, other[:, [j for j in range(17) if j != ROOT]].flatten(1).numpy()])
    variance, axes = np.linalg.eigh(np.cov(both.T, bias=True))
    white = (both - both.mean(0)) @ axes[:, -5:] / np.sqrt(variance[-5:] + 0.01)
    surprise = (white**2).sum(1) / 2
    assert float(prior.usual) == pytest.approx(np.sort(surprise)[(len(both) - 1) // 2])
    lift = lift_of(small_lifter(), data)
    views = lift.reprojected[:, prior.places].flatten(1).detach().numpy()
    above = (((views - both.mean(0)) @ axes[:, -5:] / np.sqrt(variance[-5:] + 0.01)) ** 2).sum(1) / 2 - float(
        prior.usual
    )
    expected = [5 * math.log1p(one / 5) if one > 0 else one for one in above]
    assert min(above) < 0 < max(above)
    np.testing.assert_allclose(prior.loss(lift).detach(), expected, rtol=1e-6, atol=1e-9)


def test_a_block_of_a_flow_scales_and_shifts_half_of_a_vector_by_a_bounded_amount() -> None:
    flow = CouplingFlow(5, blocks=1, units=3)
    log_scale, shift = torch.tensor([0.5, -1.0, 9.0]), torch.tensor([0.1, 0.2, 0.3])
    flow.nets[0][2].bias.data = torch.cat([log_scale, shift])  # type: ignore[index]
    vector, rotation = torch.randn(4, 5), flow.rotations[0]
    bounded = 2 * torch.tanh(log_scale / 2)
    expected = torch.cat([vector[:, :2], vector[:, 2:] * bounded.exp() + shift], 1) @ rotation
    latent, volume = flow(vector)
    torch.testing.assert_close(latent, expected)
    torch.testing.assert_close(volume, bounded.sum().expand(4))
    torch.testing.assert_close(flow.surprise(vector), expected.square().sum(1) / 2 - bounded.sum())
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(5), atol=1e-6, rtol=0)


def test_a_flow_is_fitted_at_a_rate_that_falls_along_a_cosine_to_a_fiftieth(monkeypatch: pytest.MonkeyPatch) -> None:
    rates: list[float] = []
    step = torch.optim.Adam.step
    monkeypatch.setattr(torch.optim.Adam, "step", lambda self: (rates.append(self.param_groups[0]["lr"]), step(self)))
    Flow(H36M, axes=5, units=4, steps=4, batch_size=8, learning_rate=0.01).prepare(training_set(20))
    shares = [0.02 + 0.98 * (1 + math.cos(math.pi * place / 4)) / 2 for place in range(4)]
    assert rates == pytest.approx([0.01 * share for share in shares])


@pytest.mark.parametrize("norm", [False, True])
def test_the_residual_network_is_pairs_of_layers_beside_a_straight_way(norm: bool) -> None:
    torch.manual_seed(0)
    network = build_network("residual", 6, 3, {"units": 10, "blocks": 2, "slope": 0.3, "norm": norm})
    assert network.leave.weight.abs().max() <= 0.1 / math.sqrt(10) < network.enter.weight.abs().max()
    if norm:
        nn.init.normal_(network.norms[1].weight)
    x = np.random.default_rng(0).normal(size=(5, 6))

    def layer(one: nn.Module, values: np.ndarray) -> np.ndarray:
        return values @ one.weight.detach().numpy().T + one.bias.detach().numpy()  # type: ignore[operator, union-attr]

    def leaky(values: np.ndarray) -> np.ndarray:
        return np.where(values > 0, values, 0.3 * values)

    hidden = leaky(layer(network.enter, x))
    for part, (first, second) in zip(network.norms, network.blocks, strict=True):
        inner = hidden
        if norm:
            inner = (hidden - hidden.mean(1, keepdims=True)) / np.sqrt(hidden.var(1, keepdims=True) + 1e-5)
            inner = inner * part.weight.detach().numpy() + part.bias.detach().numpy()
        hidden = hidden + leaky(layer(second, leaky(layer(first, inner))))
    np.testing.assert_allclose(network(torch.from_numpy(x)).detach(), layer(network.leave, hidden), atol=1e-10)
