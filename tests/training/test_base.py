"""What all training shares: random streams, the schedule, gates that leave no trace, averaged weights."""

from __future__ import annotations

import itertools
import math

import lightning as L
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import H36M, small_lifter, training_set
from modules import lifting_module

from uplift.config.settings import TeacherSettings
from uplift.priors.base import Prior
from uplift.priors.bones import Bones
from uplift.priors.critic import Critic
from uplift.training.base import TrainingModule, stream_seed
from uplift.training.lifting import LiftingModule

NUMBERS = st.integers(0, 2**31 - 1)


@given(seed=NUMBERS, step=NUMBERS)
@settings(max_examples=50, deadline=None)
def test_a_stream_is_a_function_of_seed_and_step(seed, step):
    found = stream_seed(seed, step)
    assert found == stream_seed(seed, step) and 0 <= found < 2**63
    torch.manual_seed(found)
    assert len({stream_seed(seed + 1, step), stream_seed(seed, step + 1), found}) == 3


def test_no_two_streams_are_the_same():
    seeds = [stream_seed(*key) for key in itertools.product(range(20), range(3200))]
    assert len(set(seeds)) == len(seeds)
    first = []
    for seed in seeds[:300]:
        torch.manual_seed(seed)
        first.append(float(torch.rand(())))
    assert len(set(first)) > 295
    assert sum(first) / len(first) == pytest.approx(0.5, abs=0.06)


def _module(seed: int = 0, priors=None, **given) -> LiftingModule:
    torch.manual_seed(seed)
    priors = {"bones": Bones(H36M), "critic": Critic(H36M, units=8, blocks=1)} if priors is None else priors
    chosen = {"learning_rate": 1e-2, "decay_from": 1.0, "average": None, **given}
    return lifting_module(small_lifter(), training_set(40), priors, **chosen)


def _fit(module: TrainingModule, steps: int, *callbacks: L.Callback) -> None:
    L.Trainer(
        max_steps=steps, accelerator="cpu", logger=False, enable_checkpointing=False, enable_progress_bar=False,
        enable_model_summary=False, callbacks=list(callbacks),
    ).fit(module, itertools.repeat(8))  # fmt: skip


class Seen(L.Callback):
    """Remember what each step drew, the learning rates, weights and optimiser states."""

    def __init__(self, before=None):
        self.before = before
        self.keypoints, self.views, self.rates, self.states = [], [], [], []

    def on_train_batch_start(self, trainer, module, batch, batch_idx):
        if self.before:
            self.before(module, batch_idx)

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx):
        self.keypoints.append(module.last_lift.keypoints)
        self.views.append(module.last_lift.view.detach())
        self.rates.append([g["lr"] for g in module.optimizers().param_groups])
        self.states.append(_state(module))


def _state(module) -> dict[str, list[torch.Tensor]]:
    adam = module.optimizers().state
    parts = {"lifter": module.lifter, **dict(module.priors.items())}
    return {
        name: [v.detach().clone() for p in part.parameters() for v in (p, *adam.get(p, {}).values())]
        for name, part in parts.items()
    }


def _same(first: list[torch.Tensor], second: list[torch.Tensor]) -> bool:
    return len(first) == len(second) and all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_the_same_seed_draws_the_same_and_a_fit_does_not_depend_on_what_was_drawn_before():
    runs = []
    for noise in (1, 2):
        seen = Seen(before=lambda module, step, noise=noise: torch.rand(noise * 3))
        _fit(_module(), 4, seen)
        runs.append(seen)
    for one, other in zip(*(r.keypoints + r.views for r in runs), strict=True):
        assert torch.equal(one, other)
    assert _same(runs[0].states[-1]["lifter"], runs[1].states[-1]["lifter"])
    assert not torch.equal(runs[0].keypoints[0], runs[0].keypoints[1])
    assert not torch.equal(runs[0].views[0], runs[0].views[1])


@given(done=st.floats(0, 1), start=st.floats(0, 0.95), warm=st.floats(0.01, 0.5))
@settings(max_examples=40, deadline=None)
def test_schedule(done, start, warm):
    """Constant, then half a cosine down to 2 %; at the beginning a rise over ``warm_up``."""
    module = _SCHEDULED
    module.settings = TeacherSettings(decay_from=start, warm_up=0.0)
    expected = 1.0 if done <= start else 0.51 + 0.49 * math.cos(math.pi * (done - start) / (1 - start))
    assert module.schedule(done) == pytest.approx(expected)
    assert module.schedule(1.0) == pytest.approx(0.02)
    module.settings = TeacherSettings(decay_from=1.0, warm_up=0.0)
    assert module.schedule(done) == 1
    module.settings = TeacherSettings(decay_from=1.0, warm_up=warm)
    assert 0 < module.schedule(0.0) <= 0.11
    assert module.schedule(done) == pytest.approx(min(1.0, (done + 1e-3) / warm))


_SCHEDULED = _module()


def test_the_schedule_scales_every_groups_own_rate():
    module = _module(learning_rate=1e-2, prior_learning_rate=3e-3, decay_from=0.0)
    seen = Seen()
    _fit(module, 5, seen)
    for step, rates in enumerate(seen.rates):
        factor = module.schedule(step / 5)
        assert rates == pytest.approx([1e-2 * factor, 3e-3 * factor])


class Gated(Prior):
    """Gates one side at given steps."""

    def __init__(self, skeleton, itself: set[int], lifter: set[int]):
        super().__init__(skeleton)
        self.weight = torch.nn.Parameter(torch.ones(()))
        self.itself, self.lifter_steps, self.step = itself, lifter, -1

    def loss(self, lift):
        self.step += 1
        self.gate_itself, self.gate_lifter = self.step in self.itself, self.step in self.lifter_steps
        return (self.weight - 3).square() + lift.pose.square().mean()


def test_a_gate_leaves_weights_and_adam_state_bit_identical():
    """Momentum and weight decay included; the others go on, and so does the gated one afterwards."""
    priors = {"gated": Gated(H36M, {2, 3}, {5}), "critic": Critic(H36M, units=8, blocks=1)}
    seen = Seen()
    _fit(_module(priors=priors, weight_decay=0.1), 8, seen)
    for step, (before, after) in enumerate(itertools.pairwise(seen.states), start=1):
        assert _same(before["gated"], after["gated"]) == (step in {2, 3}), step
        assert _same(before["lifter"], after["lifter"]) == (step == 5), step
        assert not _same(before["critic"], after["critic"]), step
    steps = [float(s["gated"][1]) for s in seen.states], [float(s["lifter"][1]) for s in seen.states]
    assert steps == ([1, 2, 2, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 5, 6, 7])


class Weights(L.Callback):
    """Remember the lifter's weights after every step."""

    def __init__(self):
        self.kept = []

    def on_train_batch_end(self, trainer, module, *rest):
        self.kept.append([p.detach().clone() for p in module.lifter.parameters()])


def test_averaged_weights():
    """An exponential average whose memory is shorter over the first steps; it is what `final` gives."""
    module, weights = _module(average=0.9), Weights()
    _fit(module, 30, weights)
    expected = weights.kept[0]
    for count, now in enumerate(weights.kept[1:], start=1):
        decay = min(0.9, (1 + count) / (10 + count))
        expected = [decay * a + (1 - decay) * b for a, b in zip(expected, now, strict=True)]
    assert module.final is not module.lifter
    for found, value in zip(module.final.parameters(), expected, strict=True):
        torch.testing.assert_close(found.detach(), value, rtol=1e-4, atol=1e-6)
    plain = _module()
    assert plain.final is plain.lifter


def test_averaging_does_not_change_the_training():
    runs = []
    for average in (None, 0.9):
        seen = Seen()
        _fit(_module(average=average), 5, seen)
        runs.append(seen.states[-1]["lifter"])
    assert _same(*runs)
