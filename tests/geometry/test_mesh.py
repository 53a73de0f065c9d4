"""Meshes in their unit: centred, the longest side of the box 1.8, wherever and however large they were."""

from __future__ import annotations

import numpy as np
import pytest

from uplift.geometry.mesh import Mesh


@pytest.mark.parametrize("size", [0.01, 300.0])
def test_a_box_is_centred_and_its_longest_side_is_nine_tenths_of_the_grids(size: float) -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 4) for z in (0, 2)], float) * size + [7, -3, 50]
    unit = Mesh(corners, np.zeros((1, 3), int), "a", "b").in_unit()
    np.testing.assert_allclose(unit.vertices.min(0), [-0.225, -0.9, -0.45], atol=1e-9)
    np.testing.assert_allclose(unit.vertices.max(0), [0.225, 0.9, 0.45], atol=1e-9)
    assert (unit.name, unit.category) == ("a", "b")
