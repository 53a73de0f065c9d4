"""Training of mixtures: what the objective learns from, what it may not look at, and the priors in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from modules import mixture_module
from shape_mixtures import chair, masks_of, mixture_of, small
from torch import Tensor, nn

from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import MaskSet, to_mask_set
from uplift.data.masks import MaskData
from uplift.errors import UserError
from uplift.models.mixture import Drawn, ShapeMixture, temperature_at
from uplift.priors import build_priors
from uplift.priors.base import ShapeLift, ShapePrior
from uplift.training.mixture import EStepStatistics, MixtureModule


class Alone(MixtureModule):
    """Without Lightning, which counts the steps."""

    global_step = 0  # type: ignore[assignment]


def training(
    data: MaskData, settings: ShapeSettings, priors: dict[str, ShapePrior] | None = None, hot: bool = True, **more
) -> Alone:
    """Return the training of a fresh mixture."""
    torch.manual_seed(0)
    teacher = {"learning_rate": 0.05, "average": None, **more}
    return mixture_module(
        ShapeMixture(settings), to_mask_set(data, settings, settings.coarse), priors, hot=hot, kind=Alone, **teacher
    )


def run(module: Alone, steps: int, batch_size: int = 16) -> list[dict[str, float]]:
    """Take steps as Lightning would, without it; return what was logged."""
    optimizer = torch.optim.Adam(module.parameter_groups())
    logged = []
    for step in range(steps):
        torch.manual_seed(step)
        module.done, module.global_step = step / steps, step
        loss, numbers = module.objective(batch_size)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        logged.append({name: float(value) for name, value in numbers.items()})
    return logged


@pytest.fixture(scope="module")
def data() -> MaskData:
    return masks_of(chair(), 30)


def test_shapes_come_to_explain_the_masks(data: MaskData) -> None:
    module = training(data, small(temperature_start=0.05, temperature_end=0.05))
    before = module.lifter.logits.detach().clone()
    logged = run(module, 45)
    assert np.mean([row["energy"] for row in logged[-5:]]) < 0.8 * logged[0]["energy"]
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
            assert logged[-1]["truth"] < 0.8 * logged[0]["truth"]
        true = to_mask_set(replace(data, labelled=np.ones(len(data), bool)), settings, settings.coarse).shapes
        losses[labelled] = float(nn.functional.binary_cross_entropy(module.lifter.occupancy.detach(), true))
    assert losses[True] < 0.95 * losses[False]


def test_the_view_of_a_labelled_mask_is_the_true_one(data: MaskData) -> None:
    seen = []

    class Listener(ShapePrior):
        """Keeps what it is shown."""

        def loss(self, lift: ShapeLift) -> Tensor:
            seen.append(lift)
            return lift.occupancy.mean() * 0

    module = training(replace(data, labelled=np.ones(len(data), bool)), small(), {"listener": Listener()})
    run(module, 2)
    assert data.truth is not None
    views = module.lifter.grid.views
    nearest = set(
        torch.cdist(torch.from_numpy(data.truth.view).float().flatten(1), views.flatten(1)).argmin(1).tolist()
    )
    assert 3 < len(nearest) < 20
    for lift in seen:
        found = set(torch.nonzero(lift.used.sum(0) > 1e-6).flatten().tolist())
        assert found == nearest | {23 - view for view in nearest}, "the true views, and what sees their mirror images"


@pytest.mark.parametrize(("hot", "every"), [(True, 5), (False, 25)])
def test_all_masks_are_explained_once_in_many_steps(
    hot: bool, every: int, data: MaskData, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[int, float]] = []
    update = EStepStatistics.update

    def counting(explained: EStepStatistics, mixture: ShapeMixture, masks: MaskSet, temperature: float) -> None:
        assert len(masks) == len(data), "all masks, whatever the batch"
        made.append((module.global_step, temperature))
        update(explained, mixture, masks, temperature)

    monkeypatch.setattr(EStepStatistics, "update", counting)
    settings = small(temperature_start=0.1, temperature_end=0.03)
    module = training(data, settings, hot=hot)
    module.lifter.azimuth_bias[:, 3] += 1
    module.lifter.azimuth_bias -= module.lifter.azimuth_bias.mean()
    azimuths = module.lifter.azimuth_bias.clone()
    logged = run(module, 27, batch_size=4)
    assert [step for step, _ in made] == list(range(0, 27, every))
    expected = [temperature_at(step / 27, 0.1, 0.03) if hot else 0.03 for step, _ in made]
    assert [temperature for _, temperature in made] == pytest.approx(expected)
    energies = [row["energy"] for row in logged]
    assert all(len(set(energies[start : start + every])) == 1 for start in range(0, 27, every))
    assert len(set(energies)) == len(made)
    assert module.lifter.part_bias.any(), "shapes are kept alive in every stage"
    assert torch.allclose(module.lifter.azimuth_bias, azimuths, atol=1e-5) != hot, "views are known in later stages"


def test_a_step_draws_some_views_and_learns_from_other_ones_next(
    data: MaskData, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    cut_out = ShapeMixture.cut_out

    def noting(mixture: ShapeMixture, rows: Sequence[int] | None = None) -> Drawn:
        if rows is not None:
            drawn.append(sorted(rows))
        return cut_out(mixture, rows)

    monkeypatch.setattr(ShapeMixture, "cut_out", noting)
    run(training(data, small(elevation_deg=(20.0, 4.0))), 12)
    assert len(drawn) == 12
    assert all(len(set(rows)) == 12 for rows in drawn), "each of them once"
    assert {row for rows in drawn for row in rows} == set(range(36)), "all have their turn"
    few = training(data, small(), mirror=False)
    run(few, 1)
    assert len(few.lifter.grid.drawn) == 12
    assert drawn[-1] == list(range(12))


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
            return lift.reprojected.mean() + lift.logits.mean() + lift.occupancy.mean()

    run(training(data, small(), {"listener": Listener()}), 3)
    assert [lift.done for lift in seen] == pytest.approx([0, 1 / 3, 2 / 3])
    lift = seen[0]
    assert lift.logits.shape == lift.occupancy.shape == (2, 12, 12, 12)
    assert lift.reprojected.shape == (64, 16, 16)
    assert lift.masks.shape == (16, 16, 16)
    assert lift.used.shape == (2, 24)
    assert float(lift.used.sum()) == pytest.approx(1, abs=1e-5)
    assert torch.allclose(lift.used, lift.used.flip(1)), "these shapes are their own mirror images"
    assert lift.views.shape == (24, 3, 3)
    for name in ("logits", "occupancy", "reprojected"):
        assert getattr(lift, name).requires_grad, name
    assert not lift.used.requires_grad
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
    priors, weights, _ = build_priors({"mask_critic": {"weight": 0.5, "units": 4}})
    assert weights == {"mask_critic": 0.5}
    module = training(data, small(), priors)
    critic = priors["mask_critic"]
    before = [parameter.detach().clone() for parameter in critic.parameters()]
    torch.manual_seed(0)
    logged = module.objective(16)[1]
    assert {"energy", "mask_critic", "mask_critic_own"} <= logged.keys()
    assert all(parameter.requires_grad for parameter in critic.parameters())
    assert [group["name"] for group in module.parameter_groups()] == ["lifter", "mask_critic"]
    # The verdict on silhouettes trains shapes, what tells them from masks the critic: never the other way round.
    lift = ShapeLift(*[torch.rand(1, 12, 12, 12)] * 2, torch.rand(8, 16, 16), torch.rand(8, 16, 16),
                     torch.ones(1, 1), torch.eye(3)[None], 0.0)  # fmt: skip
    own = critic.critic_loss(lift.masks, lift.reprojected)
    assert own is not None
    own.backward()
    assert all(parameter.grad is not None for parameter in critic.parameters())
    run(module, 2)
    assert any(not torch.equal(a, b) for a, b in zip(before, critic.parameters(), strict=True))


def test_a_mixture_that_knows_its_shape_costs_less(data: MaskData) -> None:
    settings = small(coarse=16, crop=20, parts=1)
    energies = []
    for mixture in (ShapeMixture(settings), mixture_of((0,), settings)):
        module = mixture_module(mixture, to_mask_set(data, settings, settings.coarse), average=None)
        torch.manual_seed(0)
        module.done = 1.0
        energies.append(float(module.objective(30)[1]["energy"]))
    assert energies[1] < 0.8 * energies[0]
