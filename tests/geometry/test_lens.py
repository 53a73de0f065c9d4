"""Lenses: Brown's distortion as its formula has it, and undone to the last digit wherever a point is seen."""

from __future__ import annotations

import numpy as np
import pytest

from uplift.geometry.lens import Lens

LENS = Lens((1200.0, 1100.0), (630.0, 350.0), (-0.21, 0.25, -0.04), (0.012, -0.02))


def test_pixels_are_those_of_the_formula() -> None:
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 2], (30, 3))
    for point, pixel in zip(points, LENS.project(points), strict=True):
        x, y = point[0] / point[2], point[1] / point[2]
        r2 = x**2 + y**2
        factor = 1 - 0.21 * r2 + 0.25 * r2**2 - 0.04 * r2**3 + 0.012 * x - 0.02 * y
        expected = 1200 * (x * factor + 0.012 * r2) + 630, 1100 * (y * factor - 0.02 * r2) + 350
        np.testing.assert_allclose(pixel, expected, rtol=1e-12)
    straight = Lens(LENS.focal_px, LENS.centre_px)
    np.testing.assert_allclose(straight.project(points), points[:, :2] / points[:, 2:] * (1200, 1100) + (630, 350))


@pytest.mark.parametrize("lens", [LENS, Lens((1200.0, 1100.0), (630.0, 350.0))], ids=["bent", "straight"])
@pytest.mark.parametrize("axis", ["grid", "x", "y"])
def test_rays_undo_the_distortion(lens: Lens, axis: str) -> None:
    """Also where one of the two coordinates is 0 from the start, and so does not change."""
    line = np.linspace(-0.45, 0.45, 21)
    grid = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    rays = {"grid": grid, "x": np.stack([line, 0 * line], -1), "y": np.stack([0 * line, line], -1)}[axis]
    plain = Lens(lens.focal_px, lens.centre_px, lens.radial) if axis != "grid" else lens
    seen = plain.project(np.c_[rays, np.ones(len(rays))])
    np.testing.assert_allclose(plain.rays(seen), rays, atol=2e-8)
    np.testing.assert_allclose(plain.rays(seen.astype(np.float32).reshape(-1, 1, 2))[:, 0], rays, atol=2e-6)
    assert plain.bends == any((*plain.radial, *plain.tangential))
