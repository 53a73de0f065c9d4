"""Both 2018 presets against the published formulas, worked out here in plain numpy."""

from __future__ import annotations

import itertools

import lightning as L
import numpy as np
import pytest
import torch
from lifts import H36M, bodies, doubles
from modules import lifting_module

from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.data.tensors import TrainingSet
from uplift.models.lifter import Lifter
from uplift.priors import build_priors
from uplift.training.base import plain_settings
from uplift.training.lifting import LiftingModule

PRESETS = ("kudo2018_code", "kudo2018_paper")
NOSE, NECK, LEFT, RIGHT = (H36M.index(name) for name in ("nose", "thorax", "lshoulder", "rshoulder"))
N = len(H36M.joints)
SLOPE = 0.2


@pytest.fixture(autouse=True)
def _double():
    with doubles():
        yield


class Net:
    """Four linear layers, leaky ReLU, h3 = act(l3(h2) + h1), trained by Adam with L2 in the gradient."""

    def __init__(self, module: torch.nn.Module, *, rate: float, beta1: float, beta2: float, decay: float):
        self.p = [q.detach().numpy().copy() for q in module.parameters()]
        self.rate, self.beta1, self.beta2, self.decay = rate, beta1, beta2, decay
        self.m, self.v = [np.zeros_like(q) for q in self.p], [np.zeros_like(q) for q in self.p]
        self.t = 0

    def forward(self, x: np.ndarray) -> tuple[np.ndarray, tuple]:
        w1, b1, w2, b2, w3, b3, w4, b4 = self.p
        a1 = x @ w1.T + b1
        h1 = act(a1)
        a2 = h1 @ w2.T + b2
        h2 = act(a2)
        a3 = h2 @ w3.T + b3 + h1
        h3 = act(a3)
        return h3 @ w4.T + b4, (x, a1, h1, a2, h2, a3, h3)

    def backward(self, out: np.ndarray, kept: tuple) -> tuple[list[np.ndarray], np.ndarray]:
        """Return the gradients of the parameters and of the input, given that of the output."""
        x, a1, h1, a2, h2, a3, h3 = kept
        w1, _, w2, _, w3, _, w4, _ = self.p
        d3 = (out @ w4) * slope(a3)
        d2 = (d3 @ w3) * slope(a2)
        d1 = (d2 @ w2 + d3) * slope(a1)
        pairs = ((d1, x), (d2, h1), (d3, h2), (out, h3))
        return [g for d, h in pairs for g in (d.T @ h, d.sum(0))], d1 @ w1

    def step(self, gradients: list[np.ndarray]) -> None:
        self.t += 1
        for i, gradient in enumerate(gradients):
            g = gradient + self.decay * self.p[i]
            self.m[i] = self.beta1 * self.m[i] + (1 - self.beta1) * g
            self.v[i] = self.beta2 * self.v[i] + (1 - self.beta2) * g**2
            mean, spread = self.m[i] / (1 - self.beta1**self.t), self.v[i] / (1 - self.beta2**self.t)
            self.p[i] = self.p[i] - self.rate * mean / (np.sqrt(spread) + 1e-8)


def act(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, SLOPE * x)


def slope(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, 1.0, SLOPE)


def softplus(x: np.ndarray) -> np.ndarray:
    return np.logaddexp(0, x)


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-x))


def normalised(keypoints: np.ndarray, *, without_root: bool) -> np.ndarray:
    """Return keypoints about the hip, divided by the mean distance of the joints to it."""
    centred = keypoints - keypoints[:, [H36M.root_index]]
    distances = np.sqrt((centred**2).sum(-1))
    count = N - 1 if without_root else N
    return centred / (distances.sum(1) / count)[:, None, None]


def angle_term(p: np.ndarray, z: np.ndarray, *, planar: bool) -> tuple[float, np.ndarray]:
    """Return the mean of max(0, -sin beta), with the sign of our frame, and its gradient to z.

    v = nose - neck, w = left - right shoulder; with x right, y down, z away a true pose has
    v_x w_z - v_z w_x > 0.
    """
    pose = np.concatenate([p, z[..., None]], -1)
    v, w = pose[:, NOSE] - pose[:, NECK], pose[:, LEFT] - pose[:, RIGHT]
    cross = v[:, 0] * w[:, 2] - v[:, 2] * w[:, 0]
    axes = [0, 2] if planar else [0, 1, 2]
    nv, nw = np.sqrt((v[:, axes] ** 2).sum(1)), np.sqrt((w[:, axes] ** 2).sum(1))
    sine = cross / (nv * nw)
    on = (sine < 0) / len(p)
    # d sine / d v_z and d w_z, by the quotient rule
    dv = -w[:, 0] / (nv * nw) - sine * v[:, 2] / nv**2
    dw = v[:, 0] / (nv * nw) - sine * w[:, 2] / nw**2
    gradient = np.zeros_like(z)
    gradient[:, NOSE] -= on * dv
    gradient[:, NECK] += on * dv
    gradient[:, LEFT] -= on * dw
    gradient[:, RIGHT] += on * dw
    return float(np.maximum(0, -sine).mean()), gradient


class Paper:
    """Generator and discriminator as published, one `step` at a time."""

    def __init__(self, preset: str, module: LiftingModule, settings: Settings):
        self.code = preset == "kudo2018_code"
        if self.code:
            adam = {"rate": 2e-4, "beta1": 0.5, "beta2": 0.999, "decay": 1e-5}
        else:  # "Adam" is all that the paper says
            s = settings.teacher
            adam = {"rate": s.learning_rate, "beta1": s.beta1, "beta2": s.beta2, "decay": s.weight_decay}
        self.g, self.d = Net(module.lifter.network, **adam), Net(module.priors["critic"].network, **adam)

    def step(self, p: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> dict[str, float]:
        count = len(p)
        z, g_kept = self.g.forward(p.reshape(count, -1))
        if not self.code:
            z = z - z[:, [H36M.root_index]]
        fake = np.stack([p[..., 0] * cos[:, None] + z * sin[:, None], p[..., 1]], -1)
        on_real, real_kept = self.d.forward(p.reshape(count, -1))
        on_fake, fake_kept = self.d.forward(fake.reshape(count, -1))
        accuracy = ((on_real > 0).mean() + (on_fake < 0).mean()) / 2

        if self.code:  # softplus(-D(fake))
            loss, d_logit = softplus(-on_fake).mean(), -sigmoid(-on_fake) / count
        else:  # log(1 - D(fake)), D the sigmoid
            loss, d_logit = np.log(1 - sigmoid(on_fake)).mean(), -sigmoid(on_fake) / count
        _, d_fake = self.d.backward(d_logit, fake_kept)
        angle, d_z = angle_term(p, z, planar=self.code)
        d_z = d_z + d_fake.reshape(count, N, 2)[..., 0] * sin[:, None]
        if not self.code:
            d_z[:, H36M.root_index] -= d_z.sum(1)
        g_gradients, _ = self.g.backward(d_z, g_kept)

        own = -(np.log(sigmoid(on_real)) + np.log(1 - sigmoid(on_fake))).mean()
        on_real_part, _ = self.d.backward(-sigmoid(-on_real) / count, real_kept)
        on_fake_part, _ = self.d.backward(sigmoid(on_fake) / count, fake_kept)
        if accuracy >= 0.1:
            self.g.step(g_gradients)
        if accuracy <= 0.9:
            self.d.step([a + b for a, b in zip(on_real_part, on_fake_part, strict=True)])
        return {"critic": loss, "handedness": angle, "critic_own": own, "accuracy": accuracy}


def build(preset: str, *more: str) -> tuple[LiftingModule, Settings, np.ndarray]:
    """Return a preset's training on random bodies, its settings and the keypoints in pixels."""
    settings = load_settings(preset, ["lifter.options.units=24", "priors.critic.units=20", *more])
    data = bodies(40)
    torch.manual_seed(1)
    priors, weights, _ = build_priors(settings.priors, H36M)
    lifter = Lifter(H36M, settings.lifter)
    with torch.no_grad():  # far enough from 0 that every term has a say
        for net in (lifter.network, priors["critic"].network):
            for p in net.parameters():
                p.copy_(torch.randn_like(p) * 0.25)
    count_root = settings.lifter.radius == "all"
    frames = TrainingSet.of(data, H36M, count_root=count_root)
    plain = plain_settings(settings.teacher)
    module = lifting_module(lifter, frames, priors, weights, views=settings.views, seed=3, **plain)
    return module, settings, data.keypoints


class Beside(L.Callback):
    """Run the formulas beside the training and compare after every step."""

    def __init__(self, paper: Paper, keypoints: np.ndarray, spoil: dict[int, int]):
        self.paper, self.spoil = paper, spoil
        self.real = normalised(keypoints, without_root=paper.code)
        self.accuracies: list[float] = []

    def on_train_batch_start(self, trainer, module, batch, batch_idx):
        self.before = snapshot(module)
        if (sign := self.spoil.get(batch_idx)) is not None:
            separate(module, self.paper, sign)
            self.before = snapshot(module)

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx):
        lift = module.last_lift
        p = lift.keypoints.numpy()
        distance = np.abs(p[:, None] - self.real[None]).max((2, 3)).min(1)
        assert distance.max() < 1e-9, "the network sees the normalised keypoints"
        view = lift.view.detach().numpy()
        cos, sin = view[:, 0, 0], view[:, 0, 2]
        np.testing.assert_allclose(view[:, 1], np.tile([0.0, 1, 0], (len(p), 1)), atol=1e-12)
        assert np.abs(cos**2 + sin**2 - 1).max() < 1e-12 and sin.std() > 0.4
        expected = self.paper.step(p, cos, sin)
        self.accuracies.append(expected["accuracy"])
        assert module.priors["critic"].accuracy == pytest.approx(expected["accuracy"])
        for name in ("critic", "handedness", "critic_own"):
            assert float(module.logged[name]) == pytest.approx(expected[name], rel=1e-9, abs=1e-12), name
        assert expected["handedness"] > 0
        for net, formula in ((module.lifter.network, self.paper.g), (module.priors["critic"].network, self.paper.d)):
            for parameter, value in zip(net.parameters(), formula.p, strict=True):
                np.testing.assert_allclose(parameter.detach().numpy(), value, rtol=0, atol=1e-10)
        after = snapshot(module)
        assert same(self.before["critic"], after["critic"]) == (expected["accuracy"] > 0.9)
        assert same(self.before["lifter"], after["lifter"]) == (expected["accuracy"] < 0.1)


def snapshot(module) -> dict[str, list[torch.Tensor]]:
    """Return copies of both networks' parameters and their Adam states."""
    state = module.optimizers().state
    return {
        name: [t.detach().clone() for p in net.parameters() for t in (p, *state.get(p, {}).values())]
        for name, net in (("lifter", module.lifter), ("critic", module.priors["critic"]))
    }


def same(first: list[torch.Tensor], second: list[torch.Tensor]) -> bool:
    return len(first) == len(second) and all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def separate(module, paper: Paper, sign: int) -> None:
    """Make the depths huge and the critic's logit ``sign`` (2 - mean |x|), in both computations."""
    with torch.no_grad():
        for p in list(module.lifter.network.parameters())[-2:]:
            p.mul_(15)
        w1, b1, w2, b2, w3, b3, w4, b4 = module.priors["critic"].network.parameters()
        for p in (w1, b1, w2, b2, w3, b3, w4, b4):
            p.zero_()
        for i in range(10):  # |x| of ten joints: leaky(x) + leaky(-x)
            w1[i, 2 * (i + 1)], w1[10 + i, 2 * (i + 1)] = 1.0, -1.0
        w4 -= sign / 10
        b4 += 2.0 * sign
    for net, formula in ((module.lifter.network, paper.g), (module.priors["critic"].network, paper.d)):
        formula.p = [q.detach().numpy().copy() for q in net.parameters()]


def run(preset: str, spoil: dict[int, int], steps: int) -> list[float]:
    module, settings, keypoints = build(preset)
    beside = Beside(Paper(preset, module, settings), keypoints, spoil)
    trainer = L.Trainer(
        max_steps=steps, accelerator="cpu", logger=False, enable_checkpointing=False, enable_progress_bar=False,
        enable_model_summary=False, callbacks=[beside],
    )  # fmt: skip
    trainer.fit(module, itertools.repeat(settings.teacher.batch_size))
    assert len(beside.accuracies) == steps
    return beside.accuracies


@pytest.mark.parametrize("preset", PRESETS)
def test_steps_are_those_of_the_formulas(preset):
    """Losses, accuracy and both networks' weights after each of four steps, none of them gated."""
    accuracies = run(preset, {}, 4)
    assert all(0.1 <= a <= 0.9 for a in accuracies)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("sign", "gated"), [(1, "critic"), (-1, "lifter")])
def test_gated_steps_are_those_of_the_formulas(preset, sign, gated):
    """A gated network and its Adam state stay bit-identical, the other one moves, and both go on after."""
    accuracies = run(preset, {2: sign}, 3)
    assert (accuracies[2] > 0.9) if gated == "critic" else (accuracies[2] < 0.1)


@pytest.mark.parametrize("preset", PRESETS)
def test_settings_are_the_published_ones(preset):
    code = preset == "kudo2018_code"
    s = load_settings(preset)
    assert (s.teacher.batch_size, s.priors["critic"]["gate"], s.views.azimuth_deg) == (16, [0.1, 0.9], (-180.0, 180.0))
    assert (s.lifter.options["units"], s.priors["critic"]["units"]) == (1024, 1024)
    assert (s.lifter.camera, s.lifter.tilt, s.views.renormalise) == ("orthographic", "level", False)
    assert (s.teacher.average, s.teacher.mirror, s.teacher.hide, s.student.share) == (None, False, 0.0, 0.0)
    assert s.teacher.decay_from == 1 and s.teacher.warm_up == 0 and s.lifter.both_ways is False
    assert set(s.priors) == {"critic", "handedness"}
    assert all(spec.get("weight", 1.0) == 1 for spec in s.priors.values())
    assert s.trainer.max_epochs == (20 if code else 50)
    assert s.views.count_root is (not code) and s.lifter.root_free is code
    if code:
        t = s.teacher
        assert (t.learning_rate, t.beta1, t.beta2, t.weight_decay) == (2e-4, 0.5, 0.999, 1e-5)


@pytest.mark.parametrize(
    ("preset", "std"), [("kudo2018_code", 0.02), ("kudo2018_paper", 0.02), ("kudo2018_printed", 0.14)]
)
def test_initial_weights(preset, std):
    settings = load_settings(preset)
    torch.manual_seed(0)
    lifter = Lifter(H36M, settings.lifter)
    critic = build_priors(settings.priors, H36M)[0]["critic"]
    for net, outputs in ((lifter.network, N), (critic.network, 1)):
        weights = [p for p in net.parameters() if p.ndim == 2]
        assert [tuple(w.shape) for w in weights] == [(1024, 2 * N), (1024, 1024), (1024, 1024), (outputs, 1024)]
        for w in weights:
            assert float(w.detach().std()) == pytest.approx(std, rel=0.08)
        assert all(not p.any() for p in net.parameters() if p.ndim == 1)


def test_the_weights_of_the_printed_paper_start_far_outside_of_any_body():
    """Mean size of the first depths in mean 2D radii, of random keypoints: a body is about 1 deep."""
    depths = {}
    for preset in ("kudo2018_code", "kudo2018_paper", "kudo2018_printed"):
        torch.manual_seed(0)
        lifter = Lifter(H36M, load_settings(preset).lifter)
        depths[preset] = float(lifter.network(torch.randn(200, 2 * N)).detach().abs().mean())
    assert max(depths["kudo2018_code"], depths["kudo2018_paper"]) < 0.1 and depths["kudo2018_printed"] > 10


def test_the_turned_pose_is_not_normalised_again():
    """The scale leak of the original stays in the presets: seen = (x cos + z sin, y), at any radius."""
    module, settings, _ = build("kudo2018_code")
    module.objective(settings.teacher.batch_size)
    lift = module.last_lift
    pose, view = lift.pose.detach().numpy(), lift.view.numpy()
    expected = np.einsum("bij,bnj->bni", view, pose)[..., :2]
    np.testing.assert_allclose(lift.reprojected.detach().numpy(), expected, atol=1e-12)
    radius = np.sqrt((expected**2).sum(-1)).sum(1) / (N - 1)
    assert np.abs(radius - 1).max() > 0.01
    assert np.abs(pose[:, H36M.root_index, 2]).min() > 1e-6, "the root's depth is the network's own"
