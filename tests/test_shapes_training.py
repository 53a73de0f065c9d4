"""Training of mixtures: what the objective learns from, what it may not look at, and the priors in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from shape_mixtures import chair, masks_of, mixture_of, small
from torch import Tensor, nn

from uplift.config import ShapeSettings, TeacherSettings
from uplift.errors import UserError
from uplift.masks.container import MaskData
from uplift.priors.of_shapes import build_shape_priors
from uplift.priors.shape_base import ShapePrior
from uplift.shapes.lift import ShapeLift
from uplift.shapes.mask_set import mask_set
from uplift.shapes.mixture import ShapeMixture
from uplift.shapes.training import MixtureTraining


def training(
    data: MaskData, settings: ShapeSettings, priors: dict[str, ShapePrior] | None = None, **more
) -> MixtureTraining:
    """Return the training of a fresh mixture."""
    torch.manual_seed(0)
    teacher = TeacherSettings(**{"batch_size": 16, "learning_rate": 0.05, "average": None, **more})
    given = priors or {}
    weights = dict.fromkeys(given, 1.0)
    return MixtureTraining(ShapeMixture(settings), mask_set(data, settings), teacher, given, weights, 0)


def run(module: MixtureTraining, steps: int) -> list[dict[str, float]]:
    """Take steps as Lightning would, without it; return what was logged."""
    optimizer = torch.optim.Adam(module.parameter_groups())
    logged = []
    for step in range(steps):
        torch.manual_seed(step)
        module.done = step / steps
        loss, numbers = module.objective()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        logged.append({name: float(value) for name, value in numbers.items()})
    return logged


@pytest.fixture(scope="module")
def data() -> MaskData:
    return masks_of(chair(), 30)


def test_shapes_come_to_explain_the_masks(data: MaskData) -> None:
    module = training(data, small(hot=0.05, cold=0.05))
    before = module.lifter.logits.detach().clone()
    logged = run(module, 25)
    assert np.mean([row["energy"] for row in logged[-5:]]) < 0.9 * logged[0]["energy"]
    assert not torch.allclose(module.lifter.logits, before, atol=0.1)


def test_labels_pull_shapes_to_the_truth(data: MaskData) -> None:
    settings = small(parts=1)
    losses = {}
    for labelled in (False, True):
        told = replace(data, labelled=np.full(len(data), labelled))
        module = training(told if labelled else data.without_truth(), settings)
        logged = run(module, 25)
        assert ("truth" in logged[0]) == labelled
        if labelled:
            assert logged[-1]["truth"] < 0.6 * logged[0]["truth"]
        true = mask_set(replace(data, labelled=np.ones(len(data), bool)), settings).shapes
        losses[labelled] = float(nn.functional.binary_cross_entropy(module.lifter.occupancy.detach(), true))
    assert losses[True] < 0.95 * losses[False]


def test_the_view_of_a_labelled_mask_is_the_true_one(data: MaskData) -> None:
    seen = []

    class Listener(ShapePrior):
        """Keeps what it is shown."""

        def loss(self, lift: ShapeLift) -> Tensor:
            seen.append(lift)
            return lift.occupancy.mean() * 0

    labelled = np.ones(len(data), bool)
    module = training(replace(data, labelled=labelled), small(), {"listener": Listener()})
    run(module, 2)
    for lift in seen:
        assert int((lift.responsibility.sum(1) > 1e-6).sum(1).max()) == 1
    both = {lift.responsibility.sum(1).argmax(1).unique().numel() for lift in seen}
    assert min(both) > 3


def test_masks_are_mirrored_only_where_shapes_are_their_own_mirror_image(data: MaskData) -> None:
    assert training(data, small()).mirrors
    assert not training(data, small(), mirror=False).mirrors
    assert not training(data, small(symmetric=False)).mirrors


def test_what_a_prior_of_shapes_is_given(data: MaskData) -> None:
    seen = []

    class Listener(ShapePrior):
        """Keeps what it is shown."""

        def loss(self, lift: ShapeLift) -> Tensor:
            seen.append(lift)
            return lift.seen.mean() + lift.logits.mean() + lift.occupancy.mean()

    run(training(data, small(), {"listener": Listener()}), 3)
    assert [lift.done for lift in seen] == pytest.approx([0, 1 / 3, 2 / 3])
    lift = seen[0]
    assert lift.logits.shape == lift.occupancy.shape == (2, 12, 12, 12)
    assert lift.seen.shape == (64, 16, 16)
    assert lift.masks.shape == (16, 16, 16)
    assert lift.responsibility.shape == (16, 2, 24)
    assert torch.allclose(lift.responsibility.sum((1, 2)), torch.ones(16), atol=1e-4)
    assert lift.views.shape == (24, 3, 3)
    for name in ("logits", "occupancy", "seen"):
        assert getattr(lift, name).requires_grad, name
    assert not lift.responsibility.requires_grad
    assert torch.allclose(lift.occupancy, torch.sigmoid(lift.logits))


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (torch.zeros(3), r"returned shape \(3,\)"),
        (torch.tensor(float("nan")), "nan"),
        (0.5, "float"),
        (None, "NoneType"),
    ],
)
def test_a_loss_that_is_no_number_is_refused(value, says: str, data: MaskData) -> None:
    class Wrong(ShapePrior):
        """Returns what was given."""

        def loss(self, lift: ShapeLift):
            return value

    with pytest.raises(UserError, match=f"priors.wrong: .*{says}"):
        run(training(data, small(), {"wrong": Wrong()}), 1)


def test_a_critic_is_held_still_while_it_judges(data: MaskData) -> None:
    priors, weights = build_shape_priors({"mask_critic": {"weight": 0.5, "units": 4}})
    assert weights == {"mask_critic": 0.5}
    module = training(data, small(), priors)
    critic = priors["mask_critic"]
    before = [parameter.detach().clone() for parameter in critic.parameters()]
    torch.manual_seed(0)
    logged = module.objective()[1]
    assert {"energy", "mask_critic", "mask_critic_own"} <= logged.keys()
    assert all(parameter.requires_grad for parameter in critic.parameters())
    assert [group["name"] for group in module.parameter_groups()] == ["shapes", "priors"]
    # The verdict on silhouettes trains shapes, what tells them from masks the critic: never the other way round.
    lift = ShapeLift(*[torch.rand(1, 12, 12, 12)] * 2, torch.rand(8, 16, 16), torch.rand(8, 16, 16),
                     torch.ones(8, 1, 1), torch.eye(3)[None], 0.0)  # fmt: skip
    own = critic.own_loss(lift.masks, lift.seen)
    assert own is not None
    own.backward()
    assert all(parameter.grad is not None for parameter in critic.parameters())
    run(module, 2)
    assert any(not torch.equal(a, b) for a, b in zip(before, critic.parameters(), strict=True))


def test_a_mixture_that_knows_its_shape_costs_less(data: MaskData) -> None:
    settings = small(detail=16, crop=20, parts=1)
    energies = []
    for mixture in (ShapeMixture(settings), mixture_of((0,), settings)):
        teacher = TeacherSettings(batch_size=30, average=None)
        module = MixtureTraining(mixture, mask_set(data, settings), teacher, {}, {}, 0)
        torch.manual_seed(0)
        module.done = 1.0
        energies.append(float(module.objective()[1]["energy"]))
    assert energies[1] < 0.8 * energies[0]
