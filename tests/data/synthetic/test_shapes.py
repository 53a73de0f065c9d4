"""Made-up shapes: closed, upright, in their frame, different from each other, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from uplift.data.synthetic.masks import FAMILIES, make_shape, make_shapes
from uplift.errors import UserError
from uplift.geometry.mesh import UNIT_HALF, Mesh
from uplift.geometry.voxels import fill


def _parts(mesh: Mesh) -> list[trimesh.Trimesh]:
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return list(whole.split(only_watertight=False))


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_every_part_is_closed_and_wound_outwards(family: str) -> None:
    for mesh in make_shapes(family, 4, seed=1):
        for part in _parts(mesh):
            assert part.is_watertight
            assert part.is_winding_consistent
            assert part.volume > 0


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_shapes_are_in_their_own_unit_and_of_moderate_size(family: str) -> None:
    for mesh in make_shapes(family, 30, seed=2):
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        np.testing.assert_allclose(low + high, 0, atol=1e-9)
        assert np.isclose((high - low).max(), 2 * UNIT_HALF)
        assert (high - low).min() > 0.05
        assert 20 <= len(mesh.faces) <= 2500
        assert mesh.category
        assert np.isfinite(mesh.vertices).all()


@pytest.mark.parametrize("family", ["furniture", "vehicles", "animals"])
def test_shapes_repeat_for_a_seed_and_differ_otherwise(family: str) -> None:
    first, again, longer = make_shapes(family, 12, 3), make_shapes(family, 12, 3), make_shapes(family, 14, 3)
    for one, other, more in zip(first, again, longer, strict=False):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.vertices, more.vertices)
        np.testing.assert_array_equal(one.faces, other.faces)
    seen = {mesh.vertices.tobytes() for mesh in first + make_shapes(family, 12, 4)}
    assert len(seen) == 24
    assert len({mesh.name for mesh in first}) == 12


def test_families_show_all_their_kinds() -> None:
    assert {mesh.category for mesh in make_shapes("furniture", 120, 0)} == {
        "chair", "armchair", "sofa", "bench", "stool", "table", "desk", "bed", "shelf", "cabinet",
    }  # fmt: skip
    assert {mesh.category for mesh in make_shapes("vehicles", 120, 0)} == {
        "hatchback", "saloon", "estate", "coupe", "suv", "van", "pickup", "bus", "lorry", "tractor",
    }  # fmt: skip
    assert {mesh.category for mesh in make_shapes("chairs", 20, 0)} == {"chair"}
    assert len({mesh.category for mesh in make_shapes("animals", 130, 0)}) == 21


def _share_above_behind(mesh: Mesh) -> float:
    """Return how much of the upper third of a shape lies in its rear half (z > 0, y < 0)."""
    solid = fill(mesh, 32)
    rows = np.flatnonzero(solid.any((0, 2)))
    upper = solid[:, rows[0] : rows[0] + max(1, len(rows) // 3)]
    return float(upper[16:].sum() / upper.sum())


@pytest.mark.parametrize("family", ["chairs", "sofas", "beds"])
def test_backs_are_above_and_behind(family: str) -> None:
    shares = [_share_above_behind(mesh) for mesh in make_shapes(family, 25, 5)]
    assert np.mean(shares) > 0.75


def test_animals_look_forward_and_stand_on_their_feet() -> None:
    for mesh in make_shapes("animals", 25, 6):
        solid = fill(mesh, 48)
        rows = np.flatnonzero(solid.any((0, 2)))
        foot = solid[:, rows[-1] - 2 : rows[-1] + 1].any(1)
        z = np.flatnonzero(foot.any(1))
        assert z.max() - z.min() > 6  # fore and hind feet


def test_long_necks_reach_forward_and_up() -> None:
    necked = ("horse", "giraffe", "deer", "camel", "antelope")
    shares = [_share_above_behind(mesh) for mesh in make_shapes("animals", 80, 6) if mesh.category in necked]
    assert len(shares) > 8
    assert np.mean(shares) < 0.35  # a few graze


def test_wheels_carry_vehicles() -> None:
    for mesh in make_shapes("cars", 20, 7):
        solid = fill(mesh, 48)
        extent = [np.ptp(np.flatnonzero(solid.any(axes))) for axes in ((0, 1), (0, 2), (1, 2))]
        assert extent[2] > extent[0] > 0.5 * extent[1]  # longest along z, and wider than half its height
        lowest = np.flatnonzero(solid.any((0, 2)))[-1]
        assert 0.005 < solid[:, lowest].mean() < 0.1  # it stands on wheels, not on its floor


@pytest.mark.parametrize("family", ["chairs", "vehicles", "tables"])
def test_most_shapes_are_alike_on_both_sides(family: str) -> None:
    alike = []
    for mesh in make_shapes(family, 20, 8):
        solid = fill(mesh, 32)
        turned = solid[..., ::-1]
        alike.append((solid & turned).sum() / (solid | turned).sum())
    assert np.median(alike) > 0.9


def test_a_wrong_family_and_count_are_told() -> None:
    with pytest.raises(UserError, match=r"No family of shapes 'chair'.*Did you mean 'chairs'"):
        make_shape("chair", np.random.default_rng(0))
    with pytest.raises(UserError, match="0 shapes of 'chairs' asked for, expected 1 or more"):
        make_shapes("chairs", 0, 0)
