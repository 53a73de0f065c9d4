"""Rotations of numpy arrays against scipy and roma."""

from __future__ import annotations

import numpy as np
import pytest
import roma
import torch
from scipy.spatial.transform import Rotation, Slerp

from uplift.geometry import rotation
from uplift.geometry.rigid import (
    least_turn,
    nearest_rotation,
    nearest_rotations,
    quaternion_matrix,
    quaternion_product,
    rotation_about,
    slerp,
)

RNG = np.random.default_rng(3)
TURNS = Rotation.random(40, rng=RNG)


@pytest.mark.parametrize("axis", "xyz")
def test_about_an_axis(axis: str) -> None:
    angle = RNG.uniform(-7, 7, (4, 5))
    expected = Rotation.from_euler(axis, angle.reshape(-1, 1)).as_matrix().reshape(4, 5, 3, 3)
    assert np.allclose(rotation_about(axis, angle), expected, atol=1e-14)
    vector = np.eye(3)["xyz".index(axis)]
    assert np.allclose(rotation_about(vector, angle), expected, atol=1e-14)


def test_about_any_axis() -> None:
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, RNG.uniform(-3, 3, 9)
    assert np.allclose(rotation_about(axis, angle), Rotation.from_rotvec(angle[:, None] * axis).as_matrix(), atol=1e-14)


def test_quaternions() -> None:
    one, other = TURNS.as_quat(), TURNS[::-1].as_quat()
    assert np.allclose(quaternion_matrix(one), TURNS.as_matrix(), atol=1e-14)
    assert np.allclose(quaternion_matrix(one[0]), TURNS[0].as_matrix(), atol=1e-14)
    product = quaternion_matrix(quaternion_product(one, other))
    assert np.allclose(product, (TURNS * TURNS[::-1]).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_slerp(share: float) -> None:
    for first, second in zip(range(0, 38), range(2, 40), strict=True):
        between = Slerp([0, 1], TURNS[[first, second]])(share).as_matrix()
        for sign in (1, -1):
            found = slerp(TURNS[first].as_quat(), sign * TURNS[second].as_quat(), share)
            assert np.allclose(quaternion_matrix(found / np.linalg.norm(found)), between, atol=1e-9)


def test_the_least_turn() -> None:
    start, end = (unit / np.linalg.norm(unit, axis=-1, keepdims=True) for unit in RNG.normal(size=(2, 50, 3)))
    turn = least_turn(start, end)
    assert np.allclose(np.einsum("nij,nj->ni", quaternion_matrix(turn), start), end, atol=1e-12)
    angle = Rotation.from_quat(turn).magnitude()
    assert np.allclose(angle, np.arccos((start * end).sum(-1)), atol=1e-9)
    for vector in (*np.eye(3), start[0]):
        for opposite in (-vector, -vector + 1e-7 * np.roll(vector, 1)):
            opposite = opposite / np.linalg.norm(opposite)
            assert np.allclose(quaternion_matrix(least_turn(vector, opposite)) @ vector, opposite, atol=1e-7)


@pytest.mark.parametrize("reflect", [False, True])
def test_the_nearest_rotation(reflect: bool) -> None:
    x, y = RNG.normal(size=(2, 30, 6, 3))
    matrix = np.einsum("njk,njl->nkl", y, x)
    found, trace = nearest_rotation(matrix, reflect=reflect)
    solver = roma.procrustes if reflect else roma.special_procrustes
    expected = solver(torch.as_tensor(matrix)).numpy()
    assert np.allclose(found, expected, atol=1e-12)
    assert np.allclose(trace, np.einsum("nij,nij->n", found, matrix), atol=1e-12)
    if not reflect:
        assert np.allclose(rotation.nearest_rotation(torch.as_tensor(matrix)).numpy(), expected, atol=1e-12)
        assert np.allclose(np.linalg.det(found), 1)


def test_many_nearest_rotations() -> None:
    """Known by construction: R stretched along any axes by amounts of which only the least may be negative."""
    turn, along = (Rotation.random(400, rng=RNG).as_matrix() for _ in range(2))
    stretch = np.sort(10 ** RNG.uniform(-5, 3, (400, 3)))[:, ::-1].copy()
    stretch[::3, 2] *= -0.9
    stretch[1::3, 2] = 0  # two directions
    stretch[2::30, 1:] = 1e-5 * stretch[2::30, :1]  # nearly one
    matrices = turn @ along @ (stretch[..., None] * along.transpose(0, 2, 1))
    clear = (stretch[:, 1] + stretch[:, 2]) / stretch[:, 0]
    error = Rotation.from_matrix(nearest_rotations(matrices)).inv() * Rotation.from_matrix(turn)
    assert (error.magnitude() < 1e-11 / np.minimum(clear, 1)).all()
    assert nearest_rotations(matrices[:0]).shape == (0, 3, 3)
    blank = nearest_rotations(np.zeros((2, 3, 3)))
    assert np.allclose(blank @ blank.transpose(0, 2, 1), np.eye(3))
