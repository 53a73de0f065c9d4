"""Training of a space of shapes: what learns, what may not move, what it is started from, and what priors judge."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import lightning as L
import numpy as np
import pytest
import torch
from shape_mixtures import chair, masks_of
from torch import Tensor

import uplift
from uplift.data.mask_tensors import to_mask_set
from uplift.data.masks import FILL, MaskData
from uplift.errors import UserError
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import ObjectPose
from uplift.models.view_hypotheses import ViewHypotheses
from uplift.priors.base import ShapeLift, ShapePrior
from uplift.training.mixture import MixtureModule
from uplift.training.shapes import MaskPoses, ShapeModule, cut_out

SHAPE: dict[str, Any] = {
    "coarse": 8, "detail": 12, "crop": 12, "pixels": 12, "code": 4, "hidden": 16, "parts": 1, "resolution": 12,
    "elevation_deg": (20.0, 4.0), "refine": 2,
}  # fmt: skip
QUIET: dict[str, Any] = {
    "logger": False, "enable_checkpointing": False, "enable_progress_bar": False, "enable_model_summary": False,
    "accelerator": "cpu",
}  # fmt: skip
LABELLED = np.arange(30) % 5 == 0


@lru_cache
def masks() -> MaskData:
    """Return masks of one chair, whose truth is known."""
    return masks_of(chair(), 30, side=32)


def views_of(data: MaskData, seed: int = 0) -> ViewHypotheses:
    """Return the true poses, each with the back and a side as two more hypotheses."""
    truth = data.truth
    assert truth is not None
    floats = [torch.from_numpy(np.asarray(part)).float() for part in (truth.view, truth.scale, truth.offset)]
    pose = ObjectPose.of(*floats)
    poses = [pose._replace(azimuth=pose.azimuth + turn) for turn in (0.0, torch.pi, torch.pi / 2)]
    joined = (torch.stack(part, 1) for part in zip(*poses, strict=True))
    return ViewHypotheses(*joined, torch.tensor([[0.9, 0.3, 0.01]]).expand(len(data), 3))


def module_of(data: MaskData | None = None, first: bool = True, **more: Any) -> ShapeModule:
    """Return a module with the poses of masks, ready for a step without a trainer."""
    data = masks() if data is None else data
    shape = {**SHAPE, **more.pop("shape", {})}
    module = ShapeModule(shape=shape, first=first, average=None, **more)
    module.frames = to_mask_set(data, module.shape_settings, module.shape_settings.detail)
    module.poses = MaskPoses(len(data))
    module.poses.set(views_of(data), module.frames)
    module.poses.roll.requires_grad_(module.lifter.rolls)
    return module


def told() -> MaskData:
    """Return the masks with some labels."""
    return replace(masks(), labelled=LABELLED)


def loss_of(module: ShapeModule, batch: int = 12, seed: int = 1) -> tuple[Tensor, dict[str, Any]]:
    """Return the objective of an odd step, which has all terms, halfway through the stage."""
    kind = type(module)
    module.__class__ = type(kind.__name__, (kind,), {"global_step": 1})
    module.done = 0.5
    torch.manual_seed(seed)
    return module.objective(batch)


@pytest.mark.parametrize("gravity", [True, False])
@pytest.mark.parametrize("labels", [True, False])
def test_gradients_reach_every_parameter(labels: bool, gravity: bool) -> None:
    module = module_of(told() if labels else None, shape={"gravity": gravity})
    loss, logged = loss_of(module, 40)
    loss.backward()
    assert {"silhouettes", "code", "cycle"} <= logged.keys()
    assert ("truth" in logged) == labels
    for name, parameter in module.lifter.named_parameters():
        assert parameter.grad is not None, name
        assert float(parameter.grad.abs().max()) > 0, name
    for name in ObjectPose._fields:
        slope = getattr(module.poses, name).grad
        if name == "roll" and gravity:
            assert slope is None
            continue
        assert slope is not None, name
        moved = slope.flatten(1).abs().sum(1) > 0
        assert float(moved[~LABELLED if labels else slice(None)].float().mean()) > 0.4, name
        assert not labels or not moved[LABELLED].any(), "a known pose stays"
    groups = {group["name"] for group in module.parameter_groups()}
    assert ("pose_roll" in groups) != gravity
    assert {"lifter", "pose_azimuth", "pose_scale", "pose_offset", "pose_elevation"} <= groups


def test_poses_wait_for_the_first_shapes() -> None:
    module = module_of()
    loss_of(module)  # sets its class
    module.done = 0.1
    module.objective(12)[0].backward()
    assert module.poses.azimuth.grad is None or not module.poses.azimuth.grad.any()
    later = module_of(first=False)
    loss_of(later)
    later.done = 0.0
    later.objective(12)[0].backward()
    assert later.poses.azimuth.grad is not None and later.poses.azimuth.grad.any(), "in later stages there are shapes"


def test_hypotheses_are_drawn_as_often_as_they_are_likely() -> None:
    module = module_of(told())
    poses = module.poses
    rows = torch.arange(30).repeat(400)
    torch.manual_seed(0)
    drawn = poses.drawn(rows).azimuth.detach().view(400, 30)
    share = torch.stack([(drawn == poses.azimuth[None, :, one]).float().mean(0) for one in range(3)], 1)
    assert torch.allclose(poses.weight.sum(1), torch.ones(30), atol=1e-5)
    assert torch.allclose(share[~LABELLED], poses.weight[~LABELLED], atol=0.12)
    assert bool((poses.weight.diff(dim=1) < 0).all())
    truth = masks().truth
    assert truth is not None
    known = torch.from_numpy(LABELLED)
    true = torch.from_numpy(truth.view).float()[known]
    assert torch.allclose(poses.drawn(torch.arange(30)).view[known], true, atol=1e-4), "of labelled masks, the truth"
    assert torch.allclose(poses.best.view[known], true, atol=1e-4)


class Fitted:
    """A small fit through Lightning."""

    def __init__(self, labelled: bool = False, priors: dict[str, Any] | None = None, **more: Any):
        part = told() if labelled else masks().without_truth()
        self.data = uplift.MaskDataModule(part, val=0, batch_size=8, shape=SHAPE)
        views = MixtureModule(shape=SHAPE)
        fit(views, self.data, 2)
        self.module = ShapeModule(views, shape=SHAPE, priors=priors, detail=8, **more)
        fit(self.module, self.data, 4)


def fit(module: L.LightningModule, data: uplift.MaskDataModule, steps: int, **more: Any) -> L.Trainer:
    """Return the trainer after so many steps."""
    trainer = L.Trainer(**{**QUIET, "max_steps": steps, **more})
    trainer.fit(module, data)
    return trainer


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    return Fitted(labelled=True)


def test_a_labelled_masks_pose_never_moves(fitted: Fitted) -> None:
    """Not in the first stage, nor where views are looked for again, nor at a finer grid."""
    truth = masks().truth
    assert truth is not None
    known = torch.from_numpy(LABELLED)
    module = fitted.module
    stages = [module]
    for detail in (None, 12):
        module = module.go_on(detail)
        fit(module, fitted.data, 2)
        stages.append(module)
    for stage in stages:
        best = stage.poses.best.pick(known)
        assert torch.allclose(best.view, torch.from_numpy(truth.view).float()[known], atol=1e-4)
        assert torch.allclose(best.scale, torch.from_numpy(truth.scale).float()[known], atol=1e-5)
        assert torch.allclose(best.offset, torch.from_numpy(truth.offset).float()[known], atol=1e-5)
        assert stage.poses.known.tolist() == LABELLED.tolist()
    assert not torch.equal(stages[0].poses.azimuth[~known], stages[1].poses.azimuth[~known]), "the others do"


def test_it_goes_on_at_a_finer_grid_with_what_it_knows(fitted: Fitted) -> None:
    before = {name: part.clone() for name, part in fitted.module.state_dict().items()}
    finer = fitted.module.go_on(detail=12, seed=3, decay_from=0.2)
    assert (finer.lifter.detail, finer.seed, finer.settings.decay_from, finer.first) == (12, 3, 0.2, False)
    assert finer.start is fitted.module.final
    code = torch.randn(2, 4)
    coarse = fitted.module.final.logits(code)[:, None]
    expected = torch.nn.functional.interpolate(coarse, (12,) * 3, mode="trilinear")[:, 0]
    assert torch.allclose(finer.lifter.logits(code), expected, atol=1e-4)
    fit(finer, fitted.data, 1)
    after = fitted.module.state_dict()
    assert all(torch.equal(part, after[name]) for name, part in before.items()), "the stage before stays as it was"
    assert finer.pixels == 12
    assert fitted.module.pixels == 8, "silhouettes are no finer than a grid that is still coarse"


def test_a_trained_space_finds_views_by_itself(fitted: Fitted) -> None:
    module = ShapeModule(fitted.module.final, shape=SHAPE, first=False)
    assert module.lifter is not fitted.module.final
    fit(module, uplift.MaskDataModule(masks().without_truth(), val=0, batch_size=8, shape=SHAPE), 1)
    assert float(module.poses.scale.min()) > 0
    assert not module.poses.known.any()
    with pytest.raises(UserError, match="starts from a trained uplift.MixtureModule"):
        fit(ShapeModule(shape=SHAPE), fitted.data, 1)


def test_scales_are_those_of_labelled_masks() -> None:
    found = views_of(masks())
    frames = to_mask_set(told(), module_of().shape_settings, 12)
    scaled = replace(found, scale=found.scale * 1.7).scaled_to(frames)
    assert torch.allclose(scaled.scale, found.scale, atol=1e-5)


class Listener(ShapePrior):
    """Keeps what it is shown."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[ShapeLift] = []

    def loss(self, lift: ShapeLift) -> Tensor:
        self.seen.append(lift)
        return lift.reprojected.mean() + lift.logits.mean() + lift.occupancy.mean()


def test_what_a_prior_is_given() -> None:
    listener = Listener()
    module = module_of(priors={"listener": listener}, detail=8)
    loss, logged = loss_of(module)
    loss.backward()
    (lift,) = listener.seen
    assert "listener" in logged
    assert lift.logits.shape == lift.occupancy.shape == (12, 8, 8, 8)
    assert lift.reprojected.shape == lift.masks.shape == (12, 8, 8)
    assert torch.allclose(lift.used, torch.eye(12) / 12)
    assert torch.allclose(lift.views @ lift.views.mT, torch.eye(3).expand(12, 3, 3), atol=1e-5)
    assert all(getattr(lift, name).requires_grad for name in ShapeLift.differentiable)
    assert not lift.masks.requires_grad and not lift.views.requires_grad
    assert float(lift.reprojected.min()) >= 0 and float(lift.reprojected.max()) <= 1
    module.__class__ = type("Even", (type(module),), {"global_step": 2})
    assert "listener" not in module.objective(4)[1], "every other step"


def test_a_critic_is_held_still_while_it_judges() -> None:
    module = module_of(priors={"mask_critic": {"weight": 0.5, "units": 4}}, detail=8)
    critic = module.priors["mask_critic"]
    loss, logged = loss_of(module)
    assert {"mask_critic", "mask_critic_own"} <= logged.keys()
    loss.backward()
    assert all(parameter.grad is not None for parameter in critic.parameters())
    assert {"lifter", "mask_critic"} <= {group["name"] for group in module.parameter_groups()}


def test_cut_outs_have_their_box_in_the_middle() -> None:
    image = torch.zeros(3, 48, 48)
    image[0, 10:30, 20:28], image[1, 5:15, 5:45] = 1, 1
    cut = cut_out(image)
    for one, (height, width) in zip(cut[:2], ((20, 8), (10, 40)), strict=True):
        rows, columns = ((one > 0.4).any(axis).nonzero()[:, 0] for axis in (1, 0))
        size = [int(at[-1] - at[0]) + 1 for at in (rows, columns)]
        assert max(size) == pytest.approx(FILL * 48, abs=3)
        assert size[0] / size[1] == pytest.approx(height / width, rel=0.2)
        assert [float(at[0] + at[-1]) / 2 for at in (rows, columns)] == pytest.approx([23.5, 23.5], abs=1.5)
    assert not cut[2].any()


def test_only_masks_of_symmetric_shapes_are_mirrored() -> None:
    assert module_of().mirrors
    assert not module_of(mirror=False).mirrors
    asymmetric = module_of(shape={"symmetric": False})
    assert not asymmetric.mirrors
    assert isinstance(asymmetric.lifter, ShapeSpace)
    with pytest.raises(UserError, match="trains on a uplift.MaskDataModule"):
        asymmetric.prepare(3)
