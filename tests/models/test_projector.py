"""Silhouettes of grids: they agree with what is known of boxes and balls, and with grids sampled ray by ray."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from uplift.geometry.rotation import about_y, level, random_rotations
from uplift.models.projector import BASE, Projector

N, SIDE, DEEP = 16, 24, 1.45


def voxels(n: int = N) -> Tensor:
    """Return the centres (n n n 3) of the voxels of -1..1 as x, y, z, indexed [z, y, x]."""
    at = (2 * torch.arange(n) + 1) / n - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    return torch.stack([x, y, z], -1)


def ball(centre: tuple[float, float, float], radius: float) -> Tensor:
    """Return a soft-edged ball."""
    return torch.sigmoid((radius - (voxels() - torch.tensor(centre)).norm(dim=-1)) * 2 * N)[None]


def middle(image: Tensor) -> Tensor:
    """Return the centroid (x, y) of an image, in half sides."""
    at = (2 * torch.arange(image.shape[-1]) + 1) / image.shape[-1] - 1
    return torch.stack([image.sum(0) @ at, image.sum(1) @ at]) / image.sum()


def seen_from(tilt_deg: float, azimuth_deg: float) -> Tensor:
    """Return one view, from own to camera."""
    tilt, azimuth = (torch.tensor([math.radians(angle)]) for angle in (tilt_deg, azimuth_deg))
    return level(tilt).mT @ about_y(azimuth)


def test_silhouettes_are_those_of_sampling_along_the_rays() -> None:
    torch.manual_seed(0)
    views = random_rotations(5)
    density = torch.rand(2, N, N, N)
    drawn = Projector(views, resolution=N, side=SIDE, distance=5.0)(density)
    at = (2 * torch.arange(SIDE) + 1) / SIDE - 1
    depth = ((2 * torch.arange(SIDE) + 1) / SIDE - 1) * DEEP
    for number, view in enumerate(views):
        y, x, z = torch.meshgrid(at / BASE, at / BASE, depth, indexing="ij")
        camera = torch.stack([x * (1 + z / 5), y * (1 + z / 5), z], -1)
        points = (view.mT @ camera[..., None])[..., 0].expand(2, -1, -1, -1, -1)
        sampled = torch.nn.functional.grid_sample(density.square()[:, None], points, align_corners=False)[:, 0]
        expected = 1 - torch.exp(-(sampled.sum(-1) * (2 * DEEP / SIDE) * N / 2).sqrt())
        assert torch.allclose(drawn[:, number], expected, atol=0.05)  # weights under a thousandth are left out


@given(st.tuples(*[st.floats(-0.45, 0.45)] * 3), st.floats(0.25, 0.45), st.floats(-180, 180), st.floats(-30, 60))
@settings(max_examples=12)
def test_a_ball_is_a_disc_where_the_camera_sees_its_centre(centre, radius, azimuth, tilt) -> None:
    view, distance = seen_from(tilt, azimuth), 6.0
    drawn = Projector(view, resolution=N, side=SIDE, distance=distance)(3 * ball(centre, radius))[0, 0]
    x, y, z = (view[0] @ torch.tensor(centre)).tolist()
    nearer = 1 + z / distance
    assert middle(drawn).tolist() == pytest.approx([x / nearer * BASE, y / nearer * BASE], abs=0.04)
    area = float(drawn.sum()) * 4 / SIDE**2
    assert math.sqrt(area / math.pi) == pytest.approx(radius / nearer * BASE, abs=0.09)


def test_a_box_from_known_views() -> None:
    # Wide in x, thin in z; its top half is missing at its left.
    x, y, z = voxels().unbind(-1)
    box = ((x.abs() < 0.75) & (y.abs() < 0.4) & (z.abs() < 0.2) & ~((x > 0) & (y < 0))).float()[None]
    front, right, back = (seen_from(0, angle) for angle in (0, 90, 180))
    drawn = Projector(torch.cat([front, right, back]), resolution=N, side=SIDE, distance=1e6)(20 * box)[0] > 0.5
    at = ((2 * torch.arange(SIDE) + 1) / SIDE - 1) / BASE
    pixel = 2 / SIDE / BASE
    for image, (low, high) in zip(drawn, ((-0.75, 0.75), (-0.2, 0.2), (-0.75, 0.75)), strict=True):
        columns, rows = at[image.any(0)], at[image.any(1)]
        assert (float(columns.min()), float(columns.max())) == pytest.approx((low, high), abs=1.3 * pixel)
        assert (float(rows.min()), float(rows.max())) == pytest.approx((-0.4, 0.4), abs=1.3 * pixel)
    top, left_of_it = at < -0.1, at < -0.1
    assert drawn[0][top][:, left_of_it].any(), "from in front the object's right is the image's left"
    assert not drawn[0][top][:, at > 0.1].any()
    assert not drawn[2][top][:, left_of_it].any()
    assert drawn[2][top][:, at > 0.1].any()


def test_what_is_near_looks_larger() -> None:
    drawn = Projector(seen_from(0, 0), resolution=N, side=SIDE, distance=4.0)(
        20 * torch.cat([ball((0, 0, -0.5), 0.35), ball((0, 0, 0.5), 0.35)])
    )
    near, far = drawn[:, 0].sum((1, 2)).tolist()
    assert near / far == pytest.approx((4.5 / 3.5) ** 2, rel=0.12)


def test_some_views_are_those_of_all() -> None:
    torch.manual_seed(0)
    projector = Projector(random_rotations(5), resolution=8, side=10, distance=5.0)
    assert len(projector) == 5
    density = torch.rand(3, 8, 8, 8)
    every = projector(density)
    assert every.shape == (3, 5, 10, 10)
    for rows in ([3], [4, 0, 2], [1, 1]):
        assert torch.equal(projector(density, rows), every[:, rows])
    assert torch.allclose(projector(density[1:2]), every[1:2], atol=1e-6), "shapes are drawn each for itself"


def test_the_gradient_is_that_of_the_sum() -> None:
    torch.manual_seed(0)
    projector = Projector(random_rotations(3), resolution=6, side=8, distance=6.0)
    density = torch.rand(2, 6, 6, 6, requires_grad=True)
    drawn = projector(density)
    weight = torch.randn_like(drawn)
    (drawn * weight).sum().backward()
    with torch.no_grad():
        for place in ((0, 2, 3, 3), (1, 5, 1, 4)):
            step = torch.zeros_like(density)
            step[place] = 1e-2
            slope = ((projector(density + step) - projector(density - step)) * weight).sum() / 2e-2
            assert float(density.grad[place]) == pytest.approx(float(slope), rel=0.02, abs=1e-3)  # type: ignore[index]
