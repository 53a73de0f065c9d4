"""Priors of shapes: each has its least where it should, and names and options that are wrong are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from uplift.errors import UserError
from uplift.priors import build_priors
from uplift.priors.base import ShapeLift, ShapePrior
from uplift.priors.mask_critic import MaskCritic
from uplift.priors.shape_grids import Compactness, ShapeSymmetry, Smoothness

pytestmark = pytest.mark.usefixtures("trusting")


def lift_of(occupancy: Tensor, done: float = 1.0) -> ShapeLift:
    """Return what a prior sees of these grids."""
    logits = torch.logit(occupancy, 1e-4)
    side = torch.rand(6, 16, 16)
    used = torch.full((len(occupancy), 1), 1 / len(occupancy))
    return ShapeLift(logits, occupancy, side, side, used, torch.eye(3)[None], done)


def ball() -> Tensor:
    """Return a ball of 16 voxels' width."""
    at = (2 * torch.arange(16) + 1) / 16 - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    return ((x**2 + y**2 + z**2).sqrt() < 0.6).float()[None]


def test_smoothness_is_least_for_what_has_little_surface() -> None:
    torch.manual_seed(0)
    whole = ball()
    scattered = whole.flatten()[torch.randperm(16**3)].view_as(whole)
    prior = Smoothness()
    assert float(prior.loss(lift_of(torch.full((1, 8, 8, 8), 0.7)))) == 0
    assert 0 < float(prior.loss(lift_of(whole))) < 0.3 * float(prior.loss(lift_of(scattered)))
    cube = torch.zeros(1, 8, 8, 8)
    cube[:, 2:6, 2:6, 2:6] = 1
    # Twice 16 faces along each axis, a mean over 7 x 8 x 8 pairs.
    assert float(prior.loss(lift_of(cube))) == pytest.approx(3 * 32 / (7 * 64))


def test_compactness_is_least_for_full_and_empty_voxels_and_grows() -> None:
    prior = Compactness()
    assert float(prior.loss(lift_of(ball()))) == 0
    haze = torch.full((1, 8, 8, 8), 0.5)
    assert float(prior.loss(lift_of(haze))) == pytest.approx(0.25)
    assert float(prior.loss(lift_of(haze, 0.4))) == pytest.approx(0.1)
    assert float(prior.loss(lift_of(haze, 0.0))) == 0


def test_symmetry_is_least_for_mirror_images() -> None:
    prior = ShapeSymmetry()
    assert float(prior.loss(lift_of(ball()))) == 0
    upside_down = ball()
    upside_down[:, :, :8] = 0
    assert float(prior.loss(lift_of(upside_down))) == 0, "x is left and right, not up and down"
    lopsided = ball()
    lopsided[..., :8] = 0
    assert float(prior.loss(lift_of(lopsided))) > 0.05


@pytest.mark.parametrize("name", ["compactness", "mask_critic", "shape_symmetry", "smoothness"])
def test_gradients_reach_the_shapes(name: str) -> None:
    torch.manual_seed(0)
    prior = build_priors({name: {}})[0][name]
    occupancy = torch.rand(2, 8, 8, 8, requires_grad=True)
    seen = torch.rand(6, 16, 16, requires_grad=True)
    value = prior.loss(replace(lift_of(occupancy), reprojected=seen))
    assert value.shape == ()
    value.backward()
    slope = seen.grad if name == "mask_critic" else occupancy.grad
    assert slope is not None
    assert float((slope != 0).float().mean()) > 0.9


def test_the_critic_learns_to_tell_silhouettes_from_masks() -> None:
    torch.manual_seed(0)
    critic = MaskCritic(units=4)
    at = (2 * torch.arange(16) + 1) / 16 - 1
    disc = ((at[None] ** 2 + at[:, None] ** 2).sqrt() < 0.6).float()
    bar = ((at[None].abs() < 0.2) & (at[:, None].abs() < 2)).float()
    real, seen = (shape.expand(8, -1, -1) for shape in (disc, bar))
    optimizer = torch.optim.Adam(critic.parameters(), 3e-3)
    losses = []
    for _ in range(30):
        loss = critic.critic_loss(real, seen)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
    assert float(critic(real).detach().mean()) > float(critic(seen).detach().mean())
    like_real, unlike = (replace(lift_of(ball()), reprojected=shape) for shape in (real, seen))
    assert float(critic.loss(like_real).detach()) < float(critic.loss(unlike).detach())


def test_weights_and_names_of_ones_own() -> None:
    priors, weights, _ = build_priors(
        {"smoothness": {"weight": 0}, "second": {"use": "compactness", "weight": 2}, "mask_critic": {"units": 4}}
    )
    assert list(priors) == ["second", "mask_critic"]
    assert weights == {"second": 2.0, "mask_critic": 1.0}
    assert isinstance(priors["second"], Compactness)


MINE = '''
from uplift import ShapePrior

class Mine(ShapePrior):
    """Shapes are small."""
    def __init__(self, share=0.1):
        super().__init__()
        self.share = share

    def loss(self, lift):
        return (lift.occupancy.mean() - self.share).clamp_min(0)

class Other:
    pass
'''


def test_a_prior_in_a_file(here: Path) -> None:
    Path("my.py").write_text(MINE)
    priors, *_ = build_priors({"mine": {"use": "my.py:Mine", "share": 0.3}})
    assert float(priors["mine"].loss(lift_of(torch.full((1, 4, 4, 4), 0.5)))) == pytest.approx(0.2)
    with pytest.raises(UserError, match="not a subclass of .*ShapePrior"):
        build_priors({"mine": {"use": "my.py:Other"}})
    with pytest.raises(UserError, match="Did you mean 'share'"):
        build_priors({"mine": {"use": "my.py:Mine", "shar": 0.3}})


@pytest.mark.parametrize(
    ("specs", "says"),
    [
        ({"smothness": {}}, "Did you mean 'smoothness'"),
        ({"bones": {}}, "priors.bones: 'bones' judges poses, and this task lifts masks to shapes"),
        ({"bone": {}}, "no such built-in"),
        ({"smoothness": {"weight": "much"}}, "expected a number"),
        ({"smoothness": {"weight": -1}}, "at least 0"),
        ({"smoothness": {"weight": True}}, "expected a number"),
        ({"type": {"use": "smoothness"}}, "cannot be a prior's name"),
        ({"mask_critic": {"unit": 4}}, "Did you mean 'units'"),
        ({"mask_critic": {"units": "many"}}, "expected a number"),
        ({"mine": {"use": "nowhere.py:Mine"}}, "no file"),
    ],
)
def test_what_is_wrong_is_refused(specs: dict, says: str) -> None:
    with pytest.raises(UserError, match=says):
        build_priors(specs)


def test_a_prior_without_a_loss() -> None:
    with pytest.raises(NotImplementedError, match="has no loss"):
        ShapePrior().loss(lift_of(ball()))
