"""A space of shapes: finer grids of the same shapes, their own mirror images, views with and without gravity, one file."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shape_spaces import tiny_space
from torch.nn.functional import avg_pool2d, interpolate

import uplift
from uplift.config.settings import ShapeSettings
from uplift.models.mixture import view_grid
from uplift.models.model import ShapeModel
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import ObjectPose


@given(st.booleans(), st.sampled_from([10, 12, 16, 24]), st.integers(0, 99))
@settings(max_examples=6)
def test_a_finer_grid_has_the_same_shapes(symmetric: bool, detail: int, seed: int) -> None:
    space = tiny_space(seed, symmetric=symmetric)
    code = torch.randn(3, 3)
    coarse = space.logits(code)
    assert coarse.shape == (3, 8, 8, 8)
    assert float(coarse.std(0).mean()) > 0.3, "codes are of different shapes"
    space.refine_grid(detail)
    assert space.detail == detail
    finer = space.logits(code)
    expected = interpolate(coarse[:, None], (detail,) * 3, mode="trilinear")[:, 0]
    assert torch.allclose(finer, expected, atol=1e-4)
    assert all(part.requires_grad for part in space.last.parameters())
    kept = space.last
    space.refine_grid(detail)
    assert space.last is kept, "a grid of that resolution is left as it is"


def test_symmetric_shapes_are_their_own_mirror_images() -> None:
    code = torch.randn(2, 3)
    grid = tiny_space().logits(code)
    assert torch.equal(grid, grid.flip(-1))
    free = tiny_space(symmetric=False).logits(code)
    assert not torch.allclose(free, free.flip(-1), atol=0.1)


def test_a_first_shape_is_a_ball_in_the_middle() -> None:
    torch.manual_seed(0)
    grid = ShapeSpace(ShapeSettings(detail=12, code=3, hidden=8)).logits(torch.randn(2, 3)).detach()
    at = (2 * torch.arange(12) + 1) / 12 - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    inside, far = grid.mean(0) > 0, (x**2 + y**2 + z**2).sqrt()
    assert 0.15 < float(far[inside].max()) < 0.5 < float(far[~inside].max())


def test_views_with_gravity_have_one_elevation() -> None:
    space = tiny_space(elevation_deg=(20.0, 4.0))
    assert space.views.shape == (24, 3)
    assert not space.rolls
    assert torch.allclose(space.views[:, 1], torch.tensor(math.radians(20)), atol=1e-5)
    assert not space.views[:, 2].abs().gt(1e-5).any()
    spacing = space.views[:, 0].sort().values.diff()
    assert torch.allclose(spacing, torch.tensor(space.view_spacing), atol=1e-4)
    cost = space.elevation_cost(torch.deg2rad(torch.tensor([20.0, 24.0, 12.0])))
    assert cost.tolist() == pytest.approx([0, 0.5, 2], abs=1e-4)
    assert space.usual_elevation(torch.rand(2)).tolist() == pytest.approx([math.radians(20)] * 2)
    features = torch.randn(24, 256)
    pose = space.placed(features, *space.views.unbind(1))
    assert torch.equal(pose.azimuth, space.views[:, 0])
    assert torch.equal(pose.roll, space.views[:, 2])
    assert not torch.equal(pose.elevation, space.views[:, 1]), "the elevation is corrected"
    assert float(pose.scale.min()) > 0


def test_views_without_gravity_are_all_rotations_and_lean() -> None:
    space = tiny_space(gravity=False)
    assert space.rolls
    assert torch.allclose(space.view_matrices, view_grid(space.settings).views, atol=1e-4)
    assert float(space.views[:, 2].abs().max()) > 1
    assert not space.elevation_cost(torch.randn(5)).any()
    flat = space.view_matrices.flatten(1)
    nearest = ((flat @ flat.T - 1) / 2).fill_diagonal_(-1).amax(1).clamp(-1, 1).arccos()
    assert space.view_spacing < float(nearest.median()) < 2 * space.view_spacing
    elevation = torch.randn(5)
    assert torch.equal(space.usual_elevation(elevation), elevation)
    logits, one = space.logits(torch.randn(1, 3)), torch.ones(1)
    leaning = [
        space.seen(logits, ObjectPose(one * 0.3, one * 0.2, one * roll, one * 0.5, torch.zeros(1, 2)), 16)
        for roll in (0.0, math.pi / 2, math.pi)
    ]
    assert torch.allclose(leaning[1], leaning[0].rot90(-1, (1, 2)), atol=1e-4)
    assert torch.allclose(leaning[2], leaning[0].rot90(2, (1, 2)), atol=1e-4)
    assert not torch.allclose(leaning[1], leaning[0], atol=0.05)


def test_masks_of_any_size_are_seen_alike() -> None:
    space = tiny_space()
    large = (torch.rand(2, 128, 128) > 0.5).float()
    assert torch.allclose(space.features(large), space.features(avg_pool2d(large, 2)), atol=1e-5)
    small = torch.rand(2, 32, 32)
    repeated = small.repeat_interleave(2, 1).repeat_interleave(2, 2)
    assert torch.allclose(space.features(small), space.features(repeated), atol=1e-5)


def test_codes_depend_on_the_view_and_views_do_not() -> None:
    space = tiny_space()
    features = space.features(torch.rand(2, 64, 64))
    one = torch.ones(2)
    poses = [ObjectPose(one * angle, one * 0, one * 0, one, torch.zeros(2, 2)) for angle in (0.0, 1.0)]
    (mean, spread), (other, _) = (space.encode(features, pose) for pose in poses)
    assert mean.shape == spread.shape == (2, 3)
    assert not torch.allclose(mean, other, atol=1e-4)
    again, _ = space.encode(features, poses[0]._replace(scale=one * 3, offset=torch.ones(2, 2)))
    assert torch.equal(again, mean), "only where it is seen from is told"
    assert space.view_logits(features).shape == (2, 24)


@pytest.mark.parametrize("more", [{}, {"symmetric": False}, {"gravity": False}])
@pytest.mark.parametrize("detail", [None, 12])
def test_a_saved_space_is_the_same_bit_for_bit(more: dict[str, bool], detail: int | None, tmp_path: Path) -> None:
    space = tiny_space(detail=detail, **more)
    space.level.fill_(0.17)
    model = ShapeModel(space, space.settings)
    model.save(tmp_path / "lifter.pt")
    again = uplift.load(tmp_path / "lifter.pt")
    assert isinstance(again, ShapeModel)
    assert again.settings == model.settings
    assert again.lifter.detail == (detail or 8)
    state = again.lifter.state_dict()
    assert state.keys() == space.state_dict().keys()
    assert all(torch.equal(state[name], part) for name, part in space.state_dict().items())
    assert not any(part.requires_grad for part in again.lifter.parameters())
    code = torch.randn(2, 3)
    assert torch.equal(again.lifter.logits(code), space.logits(code))
