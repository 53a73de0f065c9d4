"""Occupancy grids: analytic volumes, overlapping and inverted parts, holes, sheets, other programs' answers."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.data.synthetic.masks import make_shapes
from uplift.geometry.mesh import Mesh
from uplift.geometry.voxels import _NUDGE, coverage, fill


def _mesh(*made: trimesh.Trimesh) -> Mesh:
    starts = np.cumsum([0] + [len(part.vertices) for part in made])
    faces = [part.faces + start for part, start in zip(made, starts[:-1], strict=True)]
    return Mesh(np.concatenate([np.array(part.vertices, float) for part in made]), np.concatenate(faces))


def _box(low: tuple, high: tuple) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def _ball(radius: float = 0.8) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=radius)


def _volume(solid: np.ndarray) -> float:
    return float(solid.sum()) * (2 / solid.shape[0]) ** 3


def _centres(resolution: int) -> np.ndarray:
    at = (2 * np.arange(resolution) + 1) / resolution - 1
    z, y, x = np.meshgrid(at, at, at, indexing="ij")
    return np.stack([x, y, z], -1)


def test_a_box_is_filled_where_it_is() -> None:
    solid = fill(_mesh(_box((-0.5, -0.25, 0.0), (0.75, 0.5, 0.25))), 16)
    at = _centres(16)
    expected = ((at > (-0.5, -0.25, 0.0)) & (at < (0.75, 0.5, 0.25))).all(-1)
    np.testing.assert_array_equal(solid, expected)


@pytest.mark.parametrize("resolution", [24, 33, 64])
def test_a_ball_has_its_volume(resolution: int) -> None:
    ball = _ball()
    assert _volume(fill(_mesh(ball), resolution)) == pytest.approx(ball.volume, rel=0.02)


def test_coverage_is_nearer_to_the_volume_than_samples_are() -> None:
    ball = _ball(0.5)
    covered = coverage(_mesh(ball), 16, finer=4)
    assert covered.dtype == np.float32
    assert _volume(covered) == pytest.approx(ball.volume, rel=0.01)
    assert ((covered > 0) & (covered < 1)).any()


def test_edges_on_voxel_centres_are_no_trouble() -> None:
    at = _centres(16)[0, 0, :, 0]
    low, high = (float(at[3]),) * 3, (float(at[12]),) * 3
    assert fill(_mesh(_box(low, high)), 16).sum() in {n for m in range(9, 11) for n in (m * m * 9, m * m * 10)}


def test_a_ray_along_the_wall_between_two_boxes_is_in_one_of_them() -> None:
    at = _centres(16)[0, 0, :, 0]
    wall = tuple(float(at[8]) - nudge for nudge in _NUDGE)  # where the samples lie, to the last digit
    first, second = _box((-0.6, -0.6, -0.6), (wall[0], 0.6, 0.6)), _box((wall[0], -0.6, -0.6), (0.6, 0.6, 0.6))
    whole = fill(_mesh(_box((-0.6,) * 3, (0.6,) * 3)), 16)
    np.testing.assert_array_equal(fill(_mesh(first, second), 16), whole)
    apart = [fill(_mesh(one), 16)[:, :, 8].sum() for one in (first, second)]
    assert sorted(apart) == [0, whole[:, :, 8].sum()]


@pytest.mark.parametrize(("share", "sheet"), [(0.9, True), (1.15, False)])
@pytest.mark.parametrize("side", [0.6, 1.8])
def test_a_box_without_lid_is_a_sheet_below_a_thousandth_of_its_area_to_the_power_of_three_halves(
    side: float, share: float, sheet: bool
) -> None:
    """Between two layers of samples: as a solid it holds none of them, as a sheet it is about a voxel thick."""
    high = share * 1e-3 * (2 * side**2) ** 1.5 / side**2
    box = _box((-side / 2, -side / 2, 0), (side / 2, side / 2, high))
    open_ones = box.triangles_center[:, 2] < 0.99 * high
    mesh = Mesh(np.array(box.vertices, float), np.array(box.faces)[open_ones])
    assert fill(mesh, 16).any() == sheet


def test_overlapping_boxes_are_one_solid() -> None:
    first, second = _box((-0.6, -0.6, -0.6), (0.2, 0.2, 0.2)), _box((-0.2, -0.2, -0.2), (0.6, 0.6, 0.6))
    both = fill(_mesh(first, second), 40)
    np.testing.assert_array_equal(both, fill(_mesh(first), 40) | fill(_mesh(second), 40))
    assert _volume(both) == pytest.approx(2 * 0.8**3 - 0.4**3, rel=1e-6)


def test_windings_do_not_matter() -> None:
    first, second = _box((-0.6, -0.6, -0.6), (0.2, 0.2, 0.2)), _box((-0.2, -0.2, -0.2), (0.6, 0.6, 0.6))
    expected = fill(_mesh(first, second), 32)
    second.invert()
    np.testing.assert_array_equal(fill(_mesh(first, second), 32), expected)
    mesh = _mesh(_ball())
    mixed = mesh.faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    np.testing.assert_array_equal(fill(Mesh(mesh.vertices, mixed), 32), fill(mesh, 32))


def test_triangles_that_are_there_from_both_sides_count_once() -> None:
    shape = make_shapes("chairs", 1, 0)[0]
    both = np.random.default_rng(0).permutation(np.concatenate([shape.faces, shape.faces[:, ::-1]]))
    np.testing.assert_array_equal(fill(Mesh(shape.vertices, both), 32), fill(shape, 32))


def test_vertices_split_at_seams_are_joined() -> None:
    mesh = _mesh(_ball())
    loose = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    np.testing.assert_array_equal(fill(loose, 32), fill(mesh, 32))


@pytest.mark.parametrize("mixed", [False, True])
def test_holes_are_capped(mixed: bool) -> None:
    mesh = _mesh(_ball())
    whole = fill(mesh, 48)
    keep = mesh.vertices[mesh.faces].mean(1)[:, 1] > -0.74
    keep &= mesh.vertices[mesh.faces].mean(1)[:, 0] < 0.74
    faces = mesh.faces[keep].copy()
    assert 10 < (~keep).sum() < 300
    if mixed:
        faces[::4] = faces[::4, ::-1]
    holed = fill(Mesh(mesh.vertices, faces), 48)
    assert (holed != whole).mean() < 0.01
    assert holed[24, 24, 24]


def test_a_sheet_is_about_a_voxel_thick() -> None:
    corners = np.array([(-0.7, 0.01, -0.7), (0.7, 0.01, -0.7), (0.7, 0.01, 0.7), (-0.7, 0.01, 0.7)])
    solid = fill(Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)])), 32)
    assert solid.any(1).mean() == pytest.approx(0.49, abs=0.05)
    assert solid.sum(1).max() <= 2


def test_what_nobody_can_wind_is_flooded_from_outside() -> None:
    # Three walls meet at each seam, so that no choice of windings makes the triangles agree.
    box, wall = _box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)), np.array([(0, 1, 7), (0, 7, 6)])
    mesh = Mesh(np.array(box.vertices, float), np.concatenate([np.array(box.faces), wall[:1]]))
    solid = fill(mesh, 32)
    assert solid[16, 16, 16]
    assert _volume(solid) == pytest.approx(1.0, rel=0.15)


def test_parts_outside_the_cube_are_cut_off() -> None:
    assert fill(_mesh(_box((-3, -3, -3), (3, 3, 3))), 8).all()
    assert not fill(_mesh(_box((2, 2, 2), (3, 3, 3))), 8).any()


@settings(max_examples=5)
@given(seed=st.integers(0, 1000), family=st.sampled_from(["furniture", "vehicles", "animals"]))
def test_made_up_shapes_agree_with_each_parts_own_solid_angle(seed: int, family: str) -> None:
    mesh = make_shapes(family, 1, seed)[0]
    at = _centres(16).reshape(-1, 3)[np.random.default_rng(seed).permutation(16**3)[:200]]
    corners = mesh.vertices[mesh.faces][None] - at[:, None, None]
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    winding = np.arctan2((a * np.cross(b, c)).sum(2), below).sum(1) / (2 * np.pi)
    index = np.round((at + 1) * 8 - 0.5).astype(int)
    found = fill(mesh, 16)[index[:, 2], index[:, 1], index[:, 0]]
    sure = np.abs(winding - np.round(winding)) < 1e-3
    np.testing.assert_array_equal(found[sure], np.round(winding[sure]) >= 1)
