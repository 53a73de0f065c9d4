"""Surfaces of occupancy grids: where they lie, that they close, what is cleaned away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import KDTree

from uplift.errors import UserError
from uplift.export.meshes import in_camera, surfaces
from uplift.geometry.mesh import Mesh
from uplift.geometry.simplify import thinned
from uplift.geometry.surface import surface_of
from uplift.models.prediction import ShapePrediction

_TURN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def _centres(resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y, z of the centres of voxels, each [z, y, x]."""
    line = (2 * np.arange(resolution) + 1) / resolution - 1
    z, y, x = np.meshgrid(line, line, line, indexing="ij")
    return x, y, z


def _ball(resolution: int, centre: tuple[float, float, float], radius: float, hard: bool = False) -> np.ndarray:
    x, y, z = _centres(resolution)
    inside = (radius - np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)) * resolution / 2
    return (inside > 0).astype(np.float32) if hard else np.clip(inside + 0.5, 0, 1).astype(np.float32)


def _solid(mesh: Mesh | None) -> trimesh.Trimesh:
    assert mesh is not None
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@given(
    st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.floats(0.3, 0.6), st.sampled_from([24, 33]), st.sampled_from([0, 4]),
    st.sampled_from([1, 2]),
)  # fmt: skip
@settings(max_examples=10)
def test_a_ball_comes_back_to_a_tenth_of_a_voxel(
    centre: tuple[float, float, float], radius: float, resolution: int, smooth: int, finer: int
) -> None:
    found = surface_of(_ball(resolution, centre, radius), smooth=smooth, finer=finer, joined=True)
    solid, voxel = _solid(found.mesh), 2 / resolution
    assert found.watertight and found.pieces == 1 and found.summary() == ""
    np.testing.assert_allclose(solid.center_mass, centre, atol=0.1 * voxel)
    away = np.linalg.norm(solid.vertices - centre, axis=1)
    assert abs(away.mean() - radius) < 0.1 * voxel
    assert abs((solid.volume * 3 / (4 * np.pi)) ** (1 / 3) - radius) < 0.1 * voxel
    outwards = ((solid.triangles_center - centre) * solid.face_normals).sum(1)
    assert (outwards > 0).all()


def test_a_full_grid_is_the_whole_cube() -> None:
    found = surface_of(np.ones((8, 8, 8), np.float32))
    solid = _solid(found.mesh)
    np.testing.assert_allclose(solid.bounds, [[-1, -1, -1], [1, 1, 1]], atol=1e-3)
    assert found.watertight and 7.7 < solid.volume < 8  # its edges are cut off by half a voxel at most


def test_indices_run_along_z_y_x() -> None:
    x, y, z = _centres(16)
    grid = ((x > 0.5) & (y < -0.25) & (z > -0.5)).astype(np.float32)
    low, high = _solid(surface_of(grid).mesh).bounds
    np.testing.assert_allclose(low, [0.5, -1, -0.5], atol=0.01)
    np.testing.assert_allclose(high, [1, -0.25, 1], atol=0.01)


@given(
    arrays(np.float32, (5, 5, 5), elements=st.sampled_from([0.0, 0.3, 0.5, 0.7, 1.0])),
    st.sampled_from([1, 2]), st.sampled_from([0, 3]), st.booleans(),
)  # fmt: skip
@settings(max_examples=60)
def test_any_grid_gives_a_closed_surface_or_a_reason(grid: np.ndarray, finer: int, smooth: int, joined: bool) -> None:
    found = surface_of(grid, least_share=0, cavity_share=0, finer=finer, smooth=smooth, joined=joined)
    if (grid > 0.5).any():
        solid = _solid(found.mesh)
        assert found.watertight and solid.is_winding_consistent and solid.volume > 0
        assert solid.area_faces.min() > 0
    else:
        assert found.mesh is None and "empty" in found.reason


def test_specks_go_and_second_parts_stay() -> None:
    grid = np.maximum(_ball(40, (-0.4, 0, 0), 0.4), _ball(40, (0.5, 0, 0), 0.3))
    grid[2, 2, 2] = 1
    found = surface_of(grid)
    assert (found.specks, found.pieces) == (1, 2) and "1 speck removed" in found.summary()
    assert _solid(found.mesh).bounds[0, 1] > -0.5
    assert surface_of(grid, least_share=0).pieces == 3
    assert surface_of(grid, least_share=1).pieces == 1  # the largest is never too small


def _table(gap: float, share: float = 1.0) -> np.ndarray:
    """Return a table whose legs, a voxel or two thick, have the occupancy ``gap`` half way down; one leg has ``share`` of it."""
    x, y, z = _centres(32)
    grid = ((np.abs(x) < 0.7) & (np.abs(y + 0.4) < 0.08) & (np.abs(z) < 0.7)).astype(np.float32)
    leg = (np.abs(np.abs(x) - 0.6) < 0.05) & (np.abs(np.abs(z) - 0.6) < 0.05) & (y > -0.4) & (y < 0.8)
    grid[leg] = 0.9
    middle = leg & (np.abs(y - 0.1) < 0.15)
    grid[middle] = gap
    grid[middle & (x > 0) & (z > 0)] *= share
    return grid


def test_ridges_below_the_level_join_what_they_lead_to() -> None:
    apart, whole = surface_of(_table(0.2)), surface_of(_table(0.2), joined=True, finer=2, smooth=4)
    assert (apart.pieces, apart.specks) == (1, 4)
    assert (whole.pieces, whole.specks, whole.watertight) == (1, 0, True)
    assert _solid(whole.mesh).euler_number == 2
    np.testing.assert_allclose(_solid(whole.mesh).bounds[1, 1], 0.8, atol=0.05)
    corners = np.asarray(_solid(whole.mesh).vertices)
    assert (
        KDTree(corners).query(corners * [-1, 1, 1])[0].max() < 0.02
    )  # of one side's ridges the other has the mirror images
    # One leg has no ridge: what is below hangs in the air, and goes.
    assert surface_of(_table(0.2, 0.1), joined=True).specks == 1


def test_small_cavities_are_filled_and_large_ones_kept() -> None:
    shell = _ball(40, (0, 0, 0), 0.8)
    small = surface_of(shell - _ball(40, (0.1, 0, 0), 0.2))
    assert small.cavities == 1 and small.watertight
    assert _solid(small.mesh).volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.01)
    large = surface_of(shell - _ball(40, (0, 0, 0), 0.6))
    assert large.cavities == 0
    assert _solid(large.mesh).volume == pytest.approx(4 / 3 * np.pi * (0.8**3 - 0.6**3), rel=0.02)


def test_smoothing_takes_the_steps_of_hard_voxels_away_without_shrinking() -> None:
    grid = _ball(32, (0, 0, 0), 0.7, hard=True)
    rough, even = _solid(surface_of(grid).mesh), _solid(surface_of(grid, smooth=6).mesh)
    assert even.volume == pytest.approx(rough.volume, rel=1e-6)
    spread = [np.linalg.norm(one.vertices, axis=1).std() for one in (rough, even)]
    assert spread[1] < 0.6 * spread[0]


@pytest.mark.parametrize("level", [0.0, 1.0, -2.0])
def test_a_level_outside_is_refused(level: float) -> None:
    with pytest.raises(UserError, match="between 0 and 1"):
        surface_of(np.ones((4, 4, 4), np.float32), level=level)


def test_broken_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        surface_of(np.full((4, 4, 4), np.nan, np.float32))
    with pytest.raises(ValueError, match="cube"):
        surface_of(np.ones((4, 4, 5), np.float32))


def _prediction() -> ShapePrediction:
    grids = np.stack([_ball(24, (0.3, 0, -0.2), 0.4), np.zeros((24, 24, 24), np.float32)])
    return ShapePrediction(
        grids, np.stack([_TURN, np.eye(3)]), np.array([0.9, 1.0]), np.array([[0.1, -0.2], [0, 0]]),
        np.array([np.inf, 4.0]), np.zeros((2, 8, 8), np.uint8), ["ball", "nothing"], np.zeros((2, 2)), np.ones(2),
    )  # fmt: skip


def test_surfaces_of_a_prediction_stand_where_the_camera_sees_them() -> None:
    own, nothing = surfaces(_prediction())
    seen, _ = surfaces(_prediction(), frame="camera")
    assert nothing is None and own is not None and seen is not None and own.name == "ball"
    np.testing.assert_allclose(_solid(own).center_mass, [0.3, 0, -0.2], atol=0.01)
    np.testing.assert_allclose(_solid(seen).center_mass, [0.9 * -0.2 + 0.1, -0.2, 0.9 * -0.3], atol=0.01)
    assert _solid(seen).volume == pytest.approx(_solid(own).volume * 0.9**3)
    np.testing.assert_allclose(in_camera(np.zeros((1, 3)), _TURN, 2.0, np.array([3.0, 4.0])), [[3, 4, 0]])
    with pytest.raises(ValueError, match="own or camera"):
        surfaces(_prediction(), frame="world")


@pytest.mark.parametrize("faces", [300, 1200])
def test_thinned_meshes_are_small_and_lie_on_the_same_surface(faces: int) -> None:
    x, y, z = _centres(48)
    box = ((np.abs(x) < 0.5) & (np.abs(y) < 0.7) & (np.abs(z) < 0.3)).astype(np.float32)
    for grid in (_ball(48, (0.1, 0, 0), 0.7), box):
        whole = surface_of(grid).mesh
        assert whole is not None
        small = thinned(whole, faces)
        assert faces / 4 < len(small.faces) <= faces and len(np.unique(small.faces)) == len(small.vertices)
        assert abs(_solid(small).volume / _solid(whole).volume - 1) < (0.04 if faces < 1000 else 0.015)
        np.testing.assert_allclose(_solid(small).bounds, _solid(whole).bounds, atol=0.04)
    assert thinned(small, 10**6) is small
    tiny = thinned(replace(whole, vertices=whole.vertices / 1024), faces)
    np.testing.assert_array_equal(tiny.faces, small.faces)  # whatever the mesh's unit
    np.testing.assert_allclose(tiny.vertices * 1024, small.vertices, atol=1e-6)
    assert thinned(small, len(small.faces)) is small


@given(arrays(np.float32, (5, 5, 5), elements=st.sampled_from([0.0, 0.4, 0.6, 1.0])), st.sampled_from([20, 100, 400]))
@settings(max_examples=15)
def test_closed_meshes_stay_closed_with_as_many_holes_and_parts(grid: np.ndarray, faces: int) -> None:
    found = surface_of(grid, least_share=0, cavity_share=0, finer=2)
    if found.mesh is not None:
        whole, small = _solid(found.mesh), _solid(thinned(found.mesh, faces))
        assert small.is_watertight and small.is_winding_consistent and len(small.faces) <= len(whole.faces)
        assert small.euler_number == whole.euler_number and small.body_count == whole.body_count
        assert small.volume > 0
