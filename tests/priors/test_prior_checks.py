"""Priors of poses and of shapes pass the same checks: shape, NaN, gradient, failing hooks, the wrong kind of prior."""

from __future__ import annotations

import importlib
import warnings
from pathlib import Path

import pytest
import torch
from lifts import H36M, lift_of, small_lifter, training_set

import uplift
from uplift.errors import UserError
from uplift.priors import PRIORS, build_priors
from uplift.priors.base import Lift, Prior, ShapeLift
from uplift.training.objective import Objective, prepare_priors

pytestmark = pytest.mark.usefixtures("trusting")

KINDS = ["poses", "shapes"]
HEADS = {
    "poses": "class Mine(uplift.Prior):\n    def __init__(self, skeleton, *, share=0.5):\n        super().__init__(skeleton)\n",
    "shapes": "class Mine(uplift.ShapePrior):\n    def __init__(self, *, share=0.5):\n        super().__init__()\n",
}
FIELD = {"poses": "pose", "shapes": "occupancy"}


def lift_for(kind: str) -> Lift | ShapeLift:
    """Return what a prior of this kind is given, with gradients."""
    torch.manual_seed(0)
    if kind == "poses":
        return lift_of(small_lifter(), training_set(6))
    logits = torch.randn(2, 6, 6, 6, requires_grad=True)
    seen, masks = torch.rand(4, 8, 8, requires_grad=True), torch.rand(4, 8, 8)
    return ShapeLift(logits, logits.sigmoid(), seen, masks, torch.full((2, 1), 0.5), torch.eye(3)[None], 0.5)


def mine(kind: str, body: str, here: Path, **options: object) -> Prior:
    """Return a user's prior with this body, built as a task builds it."""
    path = here / f"mine_{len(list(here.iterdir()))}.py"
    path.write_text(f"import torch\nimport uplift\n\n\n{HEADS[kind]}\n{body}")
    skeleton = H36M if kind == "poses" else None
    return build_priors({"mine": {"use": f"{path}:Mine", **options}}, skeleton)[0]["mine"]


def loss_of(kind: str, line: str) -> str:
    return f"    def loss(self, lift):\n        value = lift.{FIELD[kind]}\n        {line}\n"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("return value.detach().mean()", "depends on nothing that can be trained"),
        ("return torch.tensor(1.0)", "depends on nothing that can be trained"),
        ("return (value > 0).float().mean()", "depends on nothing that can be trained"),
        ("return value.mean() * float('nan')", "loss is nan at step 3"),
        ("return torch.tensor(float('inf'))", "loss is inf at step 3"),
        ("return value", r"returned shape \(.*, expected one number \(shape \(\)\)"),
        ("return 0.5", "returned float, expected one number"),
        ("pass", "returned NoneType, expected one number"),
        ("return value.sum().to(torch.complex64)", "complex"),
        ("return value.colour", r"loss failed in .*mine_0.py, line 11: AttributeError"),
        ("return 1 / 0", r"loss failed in .*mine_0.py, line 11: ZeroDivisionError"),
    ],
)
def test_a_wrong_loss_is_refused(kind: str, line: str, says: str, tmp_path: Path) -> None:
    prior = mine(kind, loss_of(kind, line), tmp_path)
    with pytest.raises(UserError, match=f"priors.mine: .*{says}"):
        Objective({"mine": prior}, {"mine": 1.0}).loss("mine", lift_for(kind), 3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_loss_that_never_carries_a_gradient_is_refused_after_twenty_steps(kind: str, tmp_path: Path) -> None:
    checks = Objective({"mine": mine(kind, loss_of(kind, "return torch.zeros(())"), tmp_path)}, {"mine": 1.0})
    lift = lift_for(kind)
    for step in range(19):
        assert float(checks.loss("mine", lift, step)) == 0
    names = {
        "poses": "lift.pose, lift.level_pose, lift.rotated or lift.reprojected",
        "shapes": "lift.logits, lift.occupancy or",
    }
    with pytest.raises(UserError, match=f"no gradient reaches.*{names[kind]}"):
        checks.loss("mine", lift, 19)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hinge_that_was_once_connected_may_be_satisfied(kind: str, tmp_path: Path) -> None:
    prior = mine(kind, loss_of(kind, "return value.mean() if lift.on else value.new_zeros(())"), tmp_path)
    checks = Objective({"mine": prior}, {"mine": 1.0})
    lift = lift_for(kind)
    for step in range(40):
        object.__setattr__(lift, "on", step == 3)
        checks.loss("mine", lift, step)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("line", "steps"),
    [
        ("return value.sum() * 0", 150),
        ("return value.square().mean()", None),
        ("self.calls = getattr(self, 'calls', 0) + 1; return value.mean() * (self.calls > 60)", None),
    ],
)
def test_priors_that_never_had_a_gradient_are_named(kind: str, line: str, steps: int | None, tmp_path: Path) -> None:
    lift = lift_for(kind)
    kept = Objective({"mine": mine(kind, loss_of(kind, line), tmp_path)}, {"mine": 1.0})
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for step in range(150):
            kept.judge(lift, step)
    assert kept.idle == ({} if steps is None else {"mine": steps})
    texts = [str(w.message) for w in said if "gradient" in str(w.message)]
    assert [text[:47] for text in texts] == ["priors.mine had no gradient in any of 100 steps"] * (steps is not None)


def test_a_prior_of_weight_zero_may_be_idle(tmp_path: Path) -> None:
    prior = mine("poses", loss_of("poses", "return value.sum() * 0"), tmp_path)
    assert Objective({"mine": prior}, {"mine": 0.0}).idle == {}


def test_a_prior_of_the_lifters_own_weights_is_not_idle(tmp_path: Path) -> None:
    decay = "return sum(p.square().sum() for p in lift.lifter.parameters())"
    kept = Objective({"mine": mine("poses", loss_of("poses", decay), tmp_path)}, {"mine": 1.0})
    kept.judge(lift_for("poses"), 0)
    assert kept.idle == {}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("body", "hook", "says"),
    [
        ("    def prepare(self, data):\n        data.nothing\n", "prepare", "prepare failed in .*, line 10: Attr"),
        (
            "    def critic_loss(self, real, seen):\n        return 3\n",
            "critic_loss",
            "critic_loss.* must return one number",
        ),
        ("    def critic_loss(self, real, seen):\n        1 / 0\n", "critic_loss", "critic_loss failed in .*, line 10"),
        ("    def critic_loss(self, real):\n        return 3\n", "critic_loss", "critic_loss failed in .*TypeError"),
        ("    def metrics(self, lift):\n        return {'a': 'b'}\n", "metrics", "metrics failed in .*ValueError"),
    ],
)
def test_a_wrong_hook_is_refused(kind: str, body: str, hook: str, says: str, tmp_path: Path) -> None:
    priors, lift = {"mine": mine(kind, body, tmp_path)}, lift_for(kind)
    objective = Objective(priors, {"mine": 1.0})
    call = {
        "prepare": lambda: prepare_priors(priors, object()),
        "critic_loss": lambda: objective.train_adversaries(lift.reprojected.detach(), lift.reprojected.detach()),
        "metrics": lambda: objective.metrics(lift),
    }[hook]
    with pytest.raises(UserError, match=f"priors.mine: .*{says}"):
        call()


@pytest.mark.parametrize("kind", KINDS)
def test_an_adversary_is_frozen_while_it_judges_and_may_gate(kind: str, tmp_path: Path) -> None:
    body = (
        "        self.factor = torch.nn.Parameter(torch.ones(()))\n"
        "        self.fixed = torch.nn.Parameter(torch.ones(()), requires_grad=False)\n"
        "    def loss(self, lift):\n        self.frozen = not self.factor.requires_grad\n"
        "        return self.factor * lift.reprojected.mean()\n"
        "    def critic_loss(self, real, seen):\n        self.gate_lifter = True\n"
        "        return self.factor * (real.mean() - seen.mean())\n"
        "    def metrics(self, lift):\n        return {'frozen': float(self.frozen)}\n"
    )
    prior, lift = mine(kind, body, tmp_path), lift_for(kind)
    objective, lifter = Objective({"mine": prior}, {"mine": 2.0}), torch.nn.Linear(1, 1)
    assert list(objective.gated_parameters(lifter)) == []
    total, losses = objective.judge(lift, 0)
    own, critic_losses = objective.train_adversaries(lift.reprojected.detach() + 1, lift.reprojected.detach())
    assert float(total.detach()) == pytest.approx(2 * float(losses["mine"]))
    assert float(own.detach()) == pytest.approx(float(critic_losses["mine_own"])) == pytest.approx(1)
    assert objective.metrics(lift) == {"mine_frozen": 1.0}
    assert [p.requires_grad for p in prior.parameters()] == [True, False], "what was frozen before stays so"
    assert list(objective.gated_parameters(lifter)) == list(lifter.parameters())


@pytest.mark.parametrize("kind", KINDS)
def test_options_are_checked(kind: str, tmp_path: Path) -> None:
    body = loss_of(kind, "return value.mean()")
    assert mine(kind, body, tmp_path, share=1).judges == kind
    for options, says in (({"shar": 1}, "Did you mean 'share'"), ({"share": "much"}, "expected a number")):
        with pytest.raises(UserError, match=says):
            mine(kind, body, tmp_path, **options)
    unready = HEADS[kind].splitlines()[0] + "\n    def __init__(self, skeleton=None):\n        self.share = 1\n"
    (tmp_path / "unready.py").write_text(f"import uplift\n\n{unready}")
    with pytest.raises(UserError, match=r"must call super\(\).__init__\((skeleton)?\) first"):
        build_priors({"mine": {"use": f"{tmp_path}/unready.py:Mine"}}, H36M if kind == "poses" else None)


def test_a_prior_of_the_other_kind_is_refused(tmp_path: Path) -> None:
    for name in PRIORS:
        module, _, cls = PRIORS[name].partition(":")
        judges = getattr(importlib.import_module(module), cls).judges
        skeleton = None if judges == "poses" else H36M
        with pytest.raises(UserError, match=f"priors.{name}: '{name}' judges {judges}, and this task lifts"):
            build_priors({name: {}}, skeleton)
    (tmp_path / "own.py").write_text(
        "import uplift\n\nclass A(uplift.Prior): pass\n\nclass B(uplift.ShapePrior): pass\n"
    )
    with pytest.raises(UserError, match="judges poses, and this task lifts masks to shapes"):
        build_priors({"a": {"use": f"{tmp_path}/own.py:A"}})
    with pytest.raises(UserError, match="judges shapes, and this task lifts keypoints to poses"):
        build_priors({"b": {"use": f"{tmp_path}/own.py:B"}}, H36M)
    assert issubclass(uplift.ShapePrior, uplift.Prior)
