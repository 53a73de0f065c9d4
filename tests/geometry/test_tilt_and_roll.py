"""Tilt and roll of gravity: worked out by hand, and a round trip."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.geometry.gravity import angle_deg, gravity_at, roll_of, tilt_of

HALF = np.sqrt(0.5)


@pytest.mark.parametrize(
    ("gravity", "tilt", "roll"),
    [
        ((0, 1, 0), 0, 0),
        ((0, HALF, HALF), 45, 0),  # gravity points away from the camera: it looks down
        ((0, 0.5, -np.sqrt(0.75)), -60, 0),
        ((-HALF, HALF, 0), 0, 45),  # gravity points to the lower left: up leans to the upper right
        ((1, 0, 0), 0, -90),
        ((0, -1, 0), 0, 180),
    ],
)
def test_angles_are_those_seen_in_the_image(gravity: tuple, tilt: float, roll: float) -> None:
    vectors = np.array([gravity], float)
    assert tilt_of(vectors)[0] == pytest.approx(tilt)
    assert roll_of(vectors)[0] == pytest.approx(roll)


@given(tilt=st.floats(-89, 89), roll=st.floats(-179, 179), turn=st.floats(1e-4, 80))
def test_angles_come_back_and_a_further_tilt_is_the_angle_between(tilt: float, roll: float, turn: float) -> None:
    gravity = gravity_at(np.array([tilt]), np.array([roll]))
    assert np.linalg.norm(gravity) == pytest.approx(1)
    np.testing.assert_allclose([tilt_of(gravity)[0], roll_of(gravity)[0]], [tilt, roll], atol=1e-6)
    upright = gravity_at(np.array([0.0])), gravity_at(np.array([turn]))
    np.testing.assert_allclose(angle_deg(*upright), turn, rtol=1e-6)
