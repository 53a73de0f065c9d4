"""A mixture of shapes: how well shapes and views explain masks, and what must not change that."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shape_mixtures import chair, crops_of, masks_of, mixture_of, small

from uplift.models.mixture import Drawn, ShapeMixture, temperature_at, view_grid


@pytest.fixture(scope="module")
def known() -> ShapeMixture:
    """Return a mixture whose one shape is a chair."""
    return mixture_of((0,), small(parts=1, coarse=24, crop=32))


@pytest.mark.parametrize("symmetric", [True, False])
def test_gradients_reach_every_voxel(symmetric: bool) -> None:
    torch.manual_seed(0)
    mixture = ShapeMixture(small(symmetric=symmetric))
    masks, spread = crops_of(masks_of(chair(), 12), mixture)
    drawn = mixture.crops()
    evidence = mixture.evidence(masks, spread, drawn, 0.1)
    (-evidence.flatten(1).logsumexp(1).mean() + mixture.size_loss(drawn)).backward()
    slope = mixture.logits.grad
    assert slope is not None
    assert slope.shape[-1] == (6 if symmetric else 12)
    assert bool(torch.isfinite(slope).all())
    # All but the corners of the cube, which no pixel of some crop looks at.
    assert float((slope != 0).float().mean()) > 0.97


@given(st.integers(0, 1000))
@settings(max_examples=3)
def test_a_mirrored_mask_has_mirrored_evidence(seed: int) -> None:
    torch.manual_seed(seed)
    mixture = ShapeMixture(small(elevation_deg=(15.0, 10.0)))
    masks, spread = crops_of(masks_of(chair(), 6, seed), mixture)
    with torch.no_grad():
        drawn = mixture.crops()
        evidence = mixture.evidence(masks, spread, drawn, 0.1)
        mirrored = mixture.evidence(masks.flip(-1), spread, drawn, 0.1)
    grid = mixture.grid
    steps = len(grid.views) // grid.azimuths
    opposite = torch.arange(len(grid.views)).view(grid.azimuths, steps).flip(0).flatten()
    assert torch.allclose(mirrored, evidence[:, :, opposite], atol=2e-3)
    assert not torch.allclose(mirrored, evidence, atol=0.1)


def test_each_item_is_judged_for_itself() -> None:
    mixture = ShapeMixture(small())
    masks, spread = crops_of(masks_of(chair(), 9), mixture)
    order = torch.randperm(9)
    with torch.no_grad():
        drawn = mixture.crops()
        evidence = mixture.evidence(masks, spread, drawn, 0.05)
        assert torch.allclose(mixture.evidence(masks[order], spread[order], drawn, 0.05), evidence[order], atol=1e-4)
        assert torch.allclose(mixture.evidence(masks[:1], spread[:1], drawn, 0.05), evidence[:1], atol=1e-4)


def test_the_true_shape_finds_the_view_of_most_masks(known: ShapeMixture) -> None:
    data = masks_of(chair(), 60)
    masks, spread = crops_of(data, known)
    with torch.no_grad():
        found = known.grid.views[known.evidence(masks, spread, known.crops(), 0.03).flatten(1).argmax(1)].numpy()
    assert data.truth is not None
    # How far apart the two have the front, on the ground; a bin is 15 degrees wide.
    front = (np.swapaxes(data.truth.view, 1, 2) @ found)[..., 2]
    angles = np.abs(np.degrees(np.arctan2(front[:, 0], front[:, 2])))
    assert np.median(angles) < 10
    assert np.mean(angles <= 22.5) > 0.75


def test_the_right_shape_of_two_explains_most_masks() -> None:
    mixture = mixture_of((0, 4), small(coarse=20, crop=24))
    for part, seed in enumerate((0, 4)):
        masks, spread = crops_of(masks_of(chair(seed), 30), mixture)
        with torch.no_grad():
            evidence = mixture.evidence(masks, spread, mixture.crops(), 0.03)
        assert float((evidence.amax(2).argmax(1) == part).float().mean()) > 0.7


def test_the_size_loss_wants_shapes_that_fill_their_grids() -> None:
    mixture = mixture_of((0,), small(parts=1))
    whole = mixture.logits.data.clone()
    as_it_is = float(mixture.size_loss(mixture.crops()).detach())
    shrunk = torch.full_like(whole, -5)
    shrunk[:, 3:9, 3:9, :3] = whole[:, ::2, ::2, ::2]
    moved = torch.nn.functional.pad(whole[:, :, 3:], (0, 0, 0, 3), value=-5.0)
    for logits in (shrunk, moved):
        mixture.logits.data = logits
        assert float(mixture.size_loss(mixture.crops()).detach()) > 1.2 * as_it_is


def test_balance_charges_what_is_used_most() -> None:
    mixture = ShapeMixture(small(parts=3))
    used = torch.full((3, 24), 1e-3)
    used[0, 5] = 1.0
    used /= used.sum()
    mixture.balance(used, 0.3, 0.0)
    assert int(mixture.azimuth_bias[0].argmax()) == 5
    assert torch.allclose(mixture.azimuth_bias.mean(1), torch.zeros(3), atol=1e-6)
    assert not mixture.azimuth_bias[1:].abs().gt(1e-6).any(), "these are seen from all round"
    assert not mixture.part_bias.any(), "its rate is 0"
    azimuths = mixture.azimuth_bias.clone()
    mixture.balance(used, 0.0, 0.1)
    assert torch.allclose(mixture.azimuth_bias, azimuths, atol=1e-6)
    assert mixture.part_bias.tolist() == pytest.approx(
        [0.1 * math.log(3 * 1.023 / 1.071), *[0.1 * math.log(0.0672)] * 2], rel=1e-2
    )
    for _ in range(500):
        mixture.balance(used, 0.3, 0.1)
    assert bool(torch.isfinite(mixture.azimuth_bias).all())
    assert float(mixture.azimuth_bias.abs().max()) <= 10
    assert mixture.part_bias.tolist() == pytest.approx([3, -3, -3])


def test_elevations_of_an_azimuth_are_charged_together() -> None:
    mixture = ShapeMixture(small(parts=1, elevation_deg=(15.0, 10.0)))
    used = torch.full((1, 72), 1 / 72)
    used[0, 6:9] += torch.tensor([0.3, 0.0, -0.01])
    mixture.balance(used / used.sum(), 0.3, 0.1)
    assert int(mixture.azimuth_bias[0].argmax()) == 2
    assert int((mixture.azimuth_bias[0] > 0).sum()) == 1


@given(st.integers(0, 1000), st.sampled_from([8, 24]))
@settings(max_examples=3)
def test_mirrored_views_are_as_if_they_were_drawn(seed: int, azimuths: int) -> None:
    torch.manual_seed(seed)
    half = ShapeMixture(small(elevation_deg=(15.0, 10.0)), azimuths=azimuths)
    whole = ShapeMixture(small(elevation_deg=(15.0, 10.0), symmetric=False), azimuths=azimuths)
    half.logits.data += 0.5 * torch.randn_like(half.logits)
    whole.logits.data = half.full_logits.detach().clone()
    assert torch.equal(half.grid.views, whole.grid.views)
    assert 2 * len(half.grid.drawn) == len(whole.grid.drawn) == 3 * azimuths
    with torch.no_grad():
        filled, drawn = half.crops(), whole.crops()
    for name in Drawn._fields:
        found, expected = (getattr(part, name) for part in (filled, drawn))
        assert torch.allclose(found, expected, atol=5e-4), name
    mirrored, seen = (filled.cut[:, rows] for rows in (half.grid.mirrored, half.grid.drawn))
    assert not torch.allclose(mirrored, seen, atol=0.1), "shapes look other than their mirror images"


@pytest.mark.parametrize("more", [{}, {"symmetric": False}, {"gravity": False}])
def test_some_views_are_drawn_as_all_are(more: dict[str, bool]) -> None:
    torch.manual_seed(0)
    mixture = ShapeMixture(small(elevation_deg=(15.0, 10.0), **more))
    rows = [7, 0, 31]
    with torch.no_grad():
        some, every = mixture.cut_out(rows), mixture.cut_out()
        crops = mixture.crops()
    for name in Drawn._fields:
        assert torch.allclose(getattr(some, name), getattr(every, name)[:, rows], atol=1e-5), name
        assert torch.equal(getattr(every, name), getattr(crops, name)[:, mixture.grid.drawn]), name
    assert crops.cut.shape[:2] == (2, len(mixture.grid.views))


def test_the_temperature_falls_and_stays() -> None:
    falling = [temperature_at(done, 0.1, 0.03) for done in np.linspace(0, 1, 21)]
    assert falling[0] == pytest.approx(0.1)
    assert falling[-1] == pytest.approx(0.03)
    assert falling[16] == pytest.approx(0.03)
    assert falling == sorted(falling, reverse=True)
    assert temperature_at(0.4, 0.1, 0.025) == pytest.approx(0.05)


def test_views_about_gravity() -> None:
    grid = view_grid(small(elevation_deg=(15.0, 10.0)))
    assert grid.azimuths == 24
    assert len(grid.views) == 72
    tilt = torch.atan2(grid.views[:, 2, 1], grid.views[:, 1, 1]).rad2deg()
    # The own down-axis stays in the camera's y-z plane: shapes stand upright.
    assert torch.allclose(grid.views[:, 0, 1], torch.zeros(72), atol=1e-6)
    assert tilt.view(24, 3).tolist() == [pytest.approx([2.5, 15, 27.5], abs=1e-3)] * 24
    assert bool((grid.log_prior.view(24, 3).argmax(1) == 1).all())
    assert torch.equal(grid.azimuth, torch.arange(72) // 3)
    turns = torch.atan2(grid.views[:, 0, 2], grid.views[:, 0, 0]).unique(dim=0)
    assert len(view_grid(small()).views) == 24
    assert float(turns.min()) == pytest.approx(-math.pi * 23 / 24, abs=1e-4)
    assert len(view_grid(small(), 48).views) == 48


@pytest.mark.parametrize("azimuths", [24, 48])
def test_half_the_views_are_drawn_and_the_others_see_their_mirror_images(azimuths: int) -> None:
    grid = view_grid(small(elevation_deg=(15.0, 10.0)), azimuths)
    assert grid.mirrored is not None
    assert torch.cat([grid.drawn, grid.mirrored]).sort().values.tolist() == list(range(3 * azimuths))
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    assert torch.allclose(grid.views[grid.mirrored], flip @ grid.views[grid.drawn] @ flip, atol=1e-6)
    assert torch.equal(grid.log_prior[grid.mirrored], grid.log_prior[grid.drawn])
    drawn = torch.rand(2, len(grid.drawn), 3)
    whole, other = grid.for_all_views(drawn), grid.for_all_views(drawn, -drawn)
    assert torch.equal(whole[:, grid.drawn], drawn)
    assert torch.equal(whole[:, grid.mirrored], drawn)
    assert torch.equal(other[:, grid.drawn], drawn)
    assert torch.equal(other[:, grid.mirrored], -drawn)


@pytest.mark.parametrize(("more", "azimuths"), [({"symmetric": False}, 24), ({"gravity": False}, 24), ({}, 7)])
def test_grids_all_of_whose_views_are_drawn(more: dict[str, bool], azimuths: int) -> None:
    grid = view_grid(small(**more), azimuths)
    assert grid.mirrored is None
    assert torch.equal(grid.drawn, torch.arange(len(grid.views)))
    assert len(grid.views) == (192 if "gravity" in more else azimuths)
    drawn = torch.rand(2, len(grid.views))
    assert grid.for_all_views(drawn) is drawn


def test_views_from_anywhere_are_rotations_far_from_each_other() -> None:
    state = torch.get_rng_state()
    grid = view_grid(small(gravity=False))
    assert torch.equal(state, torch.get_rng_state())
    assert torch.equal(grid.views, view_grid(small(gravity=False)).views)
    count = len(grid.views)
    assert torch.allclose(grid.views @ grid.views.mT, torch.eye(3).expand(count, 3, 3), atol=1e-5)
    cosine = ((grid.views.flatten(1) @ grid.views.flatten(1).T - 1) / 2).fill_diagonal_(-1)
    nearest = torch.rad2deg(cosine.clamp(-1, 1).amax(1).arccos())
    assert float(nearest.min()) > 15
