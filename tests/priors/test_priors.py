"""Every prior: what it rewards, where its gradient goes, and that missing joints do not count."""

from __future__ import annotations

import inspect
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import H36M, bodies, doubles, lift_of, lift_of_pose, permuted, small_lifter, training_set, true_pose
from modules import lifting_module
from torch import Tensor, nn

from uplift.config.files import shipped_names
from uplift.config.loading import load_settings
from uplift.config.plugins import find_class
from uplift.errors import UserError
from uplift.geometry.rotation import turn
from uplift.models.lifter import Lifted
from uplift.priors import PRIORS, build_priors
from uplift.priors.base import Lift, Prior
from uplift.priors.bones import Bones
from uplift.priors.consistency import Consistency
from uplift.priors.critic import Critic
from uplift.priors.fill import Fill
from uplift.priors.labelled import Labelled
from uplift.priors.symmetry import Symmetry
from uplift.skeleton import load_skeleton
from uplift.skeleton.core import mirrored_bones
from uplift.training.lifting import LiftingModule

pytestmark = pytest.mark.usefixtures("trusting")

SEEDS = st.integers(0, 2**31 - 1)
SHAPES = ("compactness", "mask_critic", "shape_symmetry", "smoothness")  # those: test_shape_priors.py
ON_KEYPOINTS = [name for name in PRIORS if name != "mask" and name not in SHAPES]  # that one: test_mask.py


@pytest.fixture(autouse=True)
def _double():
    with doubles():
        yield


def _prior(name: str, **options) -> Prior:
    torch.manual_seed(5)
    small = {"critic": {"units": 16, "blocks": 1}, "flow": {"units": 8, "steps": 3}}.get(name, {})
    prior = build_priors({name: {**small, **options}}, H36M)[0][name]
    if name == "flow":
        prior.prepare(training_set(60))
    return prior


def _lift(missing: float = 0.0, seed: int = 0) -> Lift:
    data = training_set(14, seed, missing=missing)
    return lift_of(small_lifter(), replace(data, labels=torch.randn(14, 17, 3)), hide=0.3)


@pytest.mark.parametrize("name", ON_KEYPOINTS)
def test_gradient_reaches_the_lifter(name):
    lift = _lift(missing=0.2)
    loss = _prior(name).loss(lift).mean()
    loss.backward()
    assert loss.isfinite() and float(loss.detach()) != 0
    gradients = [p.grad for p in lift.lifter.parameters() if p.grad is not None]
    assert all(g.isfinite().all() for g in gradients)
    assert any(g.abs().max() > 0 for g in gradients)


@pytest.mark.parametrize("name", [name for name in ON_KEYPOINTS if name not in ("labelled", "flow")])
def test_missing_joints_have_no_influence(name):
    """Their keypoints, and what the lifter makes of them, change neither the loss nor its gradient.

    A flow knows whole frames only: it judges joints that were filled in with the others.
    """
    prior, lift = _prior(name), _lift(missing=0.35)
    gone = (lift.confidence == 0)[..., None]
    results = []
    for shift in (0.0, 7.0):
        pose = (lift.pose.detach() + shift * gone).requires_grad_()
        moved = replace(
            lift,
            pose=pose,
            tilt=lift.tilt.detach(),
            view=lift.view.detach(),
            keypoints=lift.keypoints + shift * gone,
            lifted_keypoints=pose[..., :2] + (lift.lifted_keypoints - lift.pose[..., :2]).detach(),
        )
        loss = prior.loss(moved).mean()
        loss.backward()
        assert pose.grad is not None
        results.append((loss.detach(), pose.grad))
        assert not (pose.grad * gone).any(), "no gradient at missing joints"
    torch.testing.assert_close(results[0], results[1], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", ON_KEYPOINTS)
@pytest.mark.parametrize("place", [0.0, 0.3])
def test_coincident_joints_are_finite(name, place):
    pose = torch.full((4, 17, 3), place, requires_grad=True)
    lift = replace(
        lift_of_pose(pose),
        labels=pose.detach(),
        lifted_keypoints=pose[..., :2],
        hidden=torch.ones(4, 17, dtype=torch.bool),
    )
    prior = _prior(name)
    loss = prior.loss(lift).mean()
    loss.backward()
    assert loss.isfinite()
    assert pose.grad is not None and pose.grad.isfinite().all()


@pytest.mark.parametrize("name", ON_KEYPOINTS)
def test_a_batch_of_two_and_one_joint_set(name):
    data = replace(training_set(2, missing=0.5), labels=torch.randn(2, 17, 3))
    assert _prior(name).loss(lift_of(small_lifter(), data)).mean().isfinite()


class Reordered(nn.Module):
    """A network for one joint order, fed with another."""

    def __init__(self, inner: nn.Module, order: np.ndarray, inputs: int, outputs: int):
        super().__init__()
        self.inner = inner
        where = torch.as_tensor(np.argsort(order))
        joints = len(order)
        pairs = (2 * where[:, None] + torch.arange(2)).flatten()
        self.inputs = torch.cat([pairs, 2 * joints + where])[:inputs]
        back = torch.as_tensor(order)
        out = torch.cat([back, joints + (2 * back[:, None] + torch.arange(2)).flatten(), torch.tensor([3 * joints])])
        self.outputs = out if outputs > 1 else torch.tensor([0])

    def forward(self, features: Tensor) -> Tensor:
        return self.inner(features[:, self.inputs])[:, self.outputs]


@pytest.mark.parametrize("name", ON_KEYPOINTS)
def test_the_order_of_joints_does_not_matter(name):
    order = np.random.default_rng(4).permutation(17)
    other = permuted(H36M, order)
    lift = _lift(missing=0.2)
    prior = _prior(name)
    expected = prior.loss(lift).mean()

    lifter = small_lifter(other)
    lifter.network = Reordered(lift.lifter.network, order, 3 * 17, 3 * 17 + 1)
    rows = torch.as_tensor(order.copy())
    moved = replace(
        lift, skeleton=other, lifter=lifter, keypoints=lift.keypoints[:, rows], confidence=lift.confidence[:, rows],
        hidden=lift.hidden[:, rows], pose=lift.pose[:, rows], lifted_keypoints=lift.lifted_keypoints[:, rows],
        labels=None if lift.labels is None else lift.labels[:, rows],
    )  # fmt: skip
    # A flow's coordinates are those of its joints in the order that they are named in.
    small = {"critic": {"units": 16, "blocks": 1}, "flow": {"units": 8, "joints": H36M.joints}}.get(name, {})
    same = build_priors({name: small}, other)[0][name]
    if name == "flow":
        same.load_state_dict(prior.state_dict())
    if isinstance(prior, Critic) and isinstance(same, Critic):
        same.network = Reordered(prior.network, order, 2 * 17, 1)
    torch.testing.assert_close(same.loss(moved).mean(), expected, rtol=1e-10, atol=1e-12)


@given(seed=SEEDS, missing=st.floats(0, 0.5))
@settings(max_examples=15, deadline=None)
def test_bones_is_0_for_one_body_in_any_pose(seed, missing):
    """Random poses of one tree of bones: only their directions differ."""
    with doubles():
        confidence = torch.from_numpy(bodies(10, seed % 1000, missing=missing).confidence)
        pose = true_pose(bodies(10, seed % 1000))
        bones = torch.as_tensor(H36M.bone_indices.copy())
        one_size = pose / (pose[:, bones[:, 0]] - pose[:, bones[:, 1]]).norm(dim=-1).mean(1)[:, None, None]
        assert float(Bones(H36M).loss(lift_of_pose(one_size, confidence=confidence))) < 1e-7
        scaled = one_size * torch.linspace(0.5, 2, 10)[:, None, None]
        if missing == 0:
            assert float(Bones(H36M).loss(lift_of_pose(scaled))) < 1e-6


def test_bones_is_the_variance_of_shares():
    pose = torch.randn(8, 17, 3)
    lengths = np.linalg.norm(
        pose.numpy()[:, H36M.bone_indices[:, 0]] - pose.numpy()[:, H36M.bone_indices[:, 1]], axis=-1
    )
    share = lengths / lengths.mean(1, keepdims=True)
    found = Bones(H36M).loss(lift_of_pose(pose))
    assert float(found) == pytest.approx(share.var(0).mean(), rel=1e-5)
    slack = 0.2
    expected = np.maximum(share.var(0) - (slack * share.mean(0)) ** 2, 0).mean()
    assert float(Bones(H36M, slack=slack).loss(lift_of_pose(pose))) == pytest.approx(expected, rel=1e-5)


def test_symmetry_compares_mirrored_bones():
    assert len(mirrored_bones(H36M)) == 6
    pose = true_pose(bodies())
    assert float(Symmetry(H36M).loss(lift_of_pose(pose.clone()))) > 0.05
    swap = torch.as_tensor(H36M.mirror_permutation.copy())
    even = (pose + pose[:, swap] * torch.tensor([-1.0, 1, 1])) / 2
    assert float(Symmetry(H36M).loss(lift_of_pose(even))) < 1e-9
    longer = even.clone()
    wrist, elbow = H36M.index("rwrist"), H36M.index("relbow")
    longer[:, wrist] += longer[:, wrist] - longer[:, elbow]
    assert float(Symmetry(H36M).loss(lift_of_pose(longer))) > 0.01


def test_symmetry_without_mirrored_bones_is_refused():
    with pytest.raises(UserError, match="has no mirrored bones"):
        Symmetry(load_skeleton("hand21"))


def _oracle(lift: Lift) -> Lift:
    """Return the lift with a lifter that knows the turned pose."""
    target = turn(lift.pose, lift.view) / lift.reprojected_scale[:, None, None]

    def lifter(keypoints: Tensor, confidence: Tensor, distance: Tensor) -> Lifted:
        there = confidence[..., None] > 0
        torch.testing.assert_close(keypoints * there, lift.lifter.camera.project(target, distance) * there)
        pose = lift.lifter.camera.unproject(lift.lifter.camera.project(target, distance), target[..., 2], distance)
        return Lifted(pose, lift.tilt, keypoints)

    fake = SimpleNamespace(camera=lift.lifter.camera)
    call = type("Oracle", (), {"__call__": staticmethod(lifter), "camera": fake.camera})()
    return _swap_lifter(lift, call)


def _swap_lifter(lift: Lift, lifter: object) -> Lift:
    other = object.__new__(Lift)
    other.__dict__.update({**lift.__dict__, "lifter": lifter})
    return other


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_consistency_is_0_for_an_oracle(missing):
    lift = lift_of(small_lifter(), training_set(missing=missing))
    assert float(Consistency(H36M).loss(_oracle(lift)).detach()) < 1e-5
    assert float(Consistency(H36M).loss(lift).detach()) > 0.1


def test_consistency_detached_moves_the_second_lift_only():
    lift = lift_of(small_lifter(), training_set(), elevation="same")
    lift = replace(lift, view=lift.view.detach(), tilt=lift.tilt.detach())
    gradients, values = [], []
    for detach in (False, True):
        pose = lift.pose.detach().requires_grad_()
        loss = Consistency(H36M, detach=detach, back=0.0).loss(replace(lift, pose=pose))
        loss.backward()
        assert pose.grad is not None
        gradients.append(pose.grad)
        values.append(loss.detach())
    assert torch.equal(*values) and (gradients[0] - gradients[1]).abs().max() > 0.01


def test_fill_is_the_distance_to_what_was_hidden():
    lift = lift_of(small_lifter(), training_set(20, missing=0.2), hide=0.4)
    distance = (lift.lifted_keypoints - lift.keypoints).norm(dim=-1)[lift.hidden]
    torch.testing.assert_close(Fill(H36M).loss(lift), distance.mean())
    assert float(Fill(H36M).loss(lift_of(small_lifter(), training_set())).detach()) == 0


def test_labelled_is_the_distance_to_the_labels():
    lift = _lift()
    assert lift.labels is not None
    labels = lift.labels.clone()
    labels[3:] = torch.nan
    expected = (lift.pose - labels).norm(dim=-1).mean(1).nan_to_num()
    torch.testing.assert_close(Labelled(H36M).loss(replace(lift, labels=labels)), expected)
    with pytest.raises(UserError, match=r"priors\.labelled\.weight=0"):
        Labelled(H36M).loss(replace(lift, labels=None))


# The critic


def test_critic_losses_are_the_formulas():
    critic, lift = _prior("critic"), _lift(missing=0.2)
    assert isinstance(critic, Critic)
    with torch.no_grad():
        fake = critic.network((lift.reprojected * lift.visible[..., None]).flatten(1))[:, 0].sigmoid()
        real = critic.network(lift.keypoints.flatten(1))[:, 0].sigmoid()
    torch.testing.assert_close(critic.loss(lift), -fake.log())
    minimax = _prior("critic", objective="minimax")
    torch.testing.assert_close(minimax.loss(lift), (1 - fake).log())
    own = critic.critic_loss(lift.keypoints, lift.reprojected.detach() * lift.visible[..., None])
    torch.testing.assert_close(own, -(real.log() + (1 - fake).log()).mean())
    accuracy = (float((real > 0.5).double().mean()) + float((fake < 0.5).double().mean())) / 2
    assert critic.metrics(lift)["accuracy"] == pytest.approx(accuracy)


def test_own_loss_reaches_only_the_critic_and_loss_only_the_lifter():
    module = _training(H36M, {"critic": {"units": 8, "blocks": 1}})
    module.settings.same_real = True
    module.settings.mirror = False
    critic = module.priors["critic"]
    torch.manual_seed(0)
    module.objective(16)
    lift = module.last_lift
    terms = {"loss": None, "own": None}
    for parameter in critic.parameters():
        parameter.requires_grad_(False)
    critic.loss(lift).mean().backward(retain_graph=True)
    terms["loss"] = {id(p): p.grad.clone() for p in module.lifter.parameters()}
    for parameter in critic.parameters():
        assert parameter.grad is None
        parameter.requires_grad_(True)
    module.zero_grad()
    critic.critic_loss(lift.keypoints, lift.reprojected.detach() * lift.visible[..., None]).backward()
    assert all(p.grad is None for p in module.lifter.parameters())
    terms["own"] = {id(p): p.grad.clone() for p in critic.parameters()}
    module.zero_grad()
    torch.manual_seed(0)
    module.objective(16)[0].backward()
    for parameter in module.lifter.parameters():
        torch.testing.assert_close(parameter.grad, terms["loss"][id(parameter)])
    for parameter in critic.parameters():
        torch.testing.assert_close(parameter.grad, terms["own"][id(parameter)])


@pytest.mark.parametrize(
    ("real", "seen", "accuracy", "gates"),
    [(1, -1, 1.0, (False, True)), (-1, 1, 0.0, (True, False)), (1, 1, 0.5, (False, False))],
)
def test_gates(real, seen, accuracy, gates):
    critic = _prior("critic", gate=[0.1, 0.9])
    critic.network = nn.Linear(34, 1, bias=False)
    nn.init.ones_(critic.network.weight)
    critic.critic_loss(torch.full((6, 17, 2), float(real)), torch.full((6, 17, 2), float(seen)))
    assert critic.accuracy == accuracy
    assert (critic.gate_lifter, critic.gate_itself) == gates


def test_both_gates_keep_still_at_their_very_bounds():
    """Above 0.9 and below 0.1, not at them."""
    critic = _prior("critic", gate=[0.1, 0.9])
    critic.network = nn.Linear(34, 1, bias=False)
    nn.init.ones_(critic.network.weight)
    for wrong, accuracy in ((2, 0.9), (18, 0.1)):
        seen = -torch.ones(10, 17, 2)
        seen[: min(wrong, 10)] = 1
        real = torch.ones(10, 17, 2)
        real[: max(0, wrong - 10)] = -1
        critic.critic_loss(real, seen)
        assert critic.accuracy == accuracy
        assert not critic.gate_itself and not critic.gate_lifter


@pytest.mark.parametrize("gate", [0.9, [0.9], [0.9, 0.1], ["low", "high"], [0.1, 1.1], "0.1,0.9"])
def test_wrong_gates_are_refused(gate):
    with pytest.raises(UserError, match=r"priors\.critic\.gate="):
        _prior("critic", gate=gate)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"critics": {}}, "no such built-in.*Did you mean 'critic'"),
        ({"critic": {"objective": "minmax"}}, "Did you mean 'minimax'"),
        ({"critic": {"unit": 4}}, r"priors\.critic\.unit: .*Did you mean 'units'"),
        ({"critic": {"network": "residul"}}, r"priors\.critic\.network='residul'"),
        ({"bones": {"slak": 1}}, r"priors\.bones\.slak: .*Did you mean 'slack'"),
        ({"bones": {"slack": "much"}}, r"priors\.bones\.slack='much': expected a number"),
        ({"consistency": {"detach": 3}}, r"priors\.consistency\.detach=3: expected true or false"),
        ({"bones": {"weight": "heavy"}}, r"priors\.bones\.weight='heavy': expected a number"),
        ({"bones": {"weight": -1}}, "at least 0"),
        ({"bones": {"weight": float("nan")}}, "at least 0"),
        ({"bones": {"weight": True}}, "expected a number"),
        ({"x": {"use": "uplift.errors:UserError"}}, r"not a subclass of uplift\.Prior"),
    ],
)
def test_wrong_settings_are_named(spec, message):
    with pytest.raises(UserError, match=message):
        build_priors(spec, H36M)


def test_weight_0_leaves_a_prior_out():
    priors, weights, _ = build_priors({"bones": {"weight": 0}, "symmetry": {"weight": 2}}, H36M)
    assert list(priors) == ["symmetry"] and weights == {"symmetry": 2.0}


# All shipped skeletons


def _training(skeleton, specs, frames: int = 16) -> LiftingModule:
    torch.manual_seed(0)
    priors, weights, _ = build_priors(specs, skeleton)
    return lifting_module(small_lifter(skeleton), training_set(frames, skeleton=skeleton, missing=0.1), priors, weights)


@pytest.mark.parametrize("name", shipped_names("skeletons"))
def test_every_shipped_skeleton_trains(name):
    """The default recipe, two steps: finite losses, and a gradient at every parameter."""
    skeleton = load_skeleton(name)
    specs = {
        **load_settings().priors,
        "consistency": {"weight": 0.1},
        "fill": {"weight": 0.1},
        "labelled": {"weight": 0},
    }
    specs |= {"critic": {"units": 8, "blocks": 1}, "flow": {"units": 8, "steps": 3}}
    module = _training(skeleton, specs)
    module.priors["flow"].prepare(module.frames)
    module.settings.hide = 0.2
    optimiser = torch.optim.Adam(module.parameter_groups(), lr=1e-3)
    reached: set[str] = set()
    for step in range(2):
        torch.manual_seed(step)
        optimiser.zero_grad()
        total, logged = module.objective(16)
        assert total.isfinite() and all(torch.as_tensor(v).isfinite() for v in logged.values())
        total.backward()
        for key, parameter in module.named_parameters():
            if parameter.grad is not None:
                assert parameter.grad.isfinite().all(), key
                if parameter.grad.abs().sum() > 0:
                    reached.add(key)
        optimiser.step()
    fixed = ("averaged", "priors.flow")
    trained = {key for key, _ in module.named_parameters() if not key.startswith(fixed)}
    assert reached == trained


@pytest.mark.parametrize("name", PRIORS)
def test_every_whole_number_of_a_prior_has_a_range(name: str) -> None:
    """A prior of a million blocks costs hours before the first step."""
    found = find_class(name, PRIORS, "priors")
    whole = {key: one.default for key, one in inspect.signature(found).parameters.items() if type(one.default) is int}
    ranges = getattr(found, "ranges", {})
    assert set(whole) <= set(ranges)
    for key, (low, high) in ranges.items():
        assert low <= whole[key] <= high
        for wrong in (low - 1, high + 1, float(low), True):
            with pytest.raises(UserError, match=rf"priors\.{name}\.{key}={wrong}: expected"):
                build_priors({name: {key: wrong}}, None if found.judges == "shapes" else load_skeleton("h36m17"))
