"""Silhouettes: coverage of known outlines, crops that are centred and full, and a truth that projects onto them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageDraw

from uplift.data.masks import FILL
from uplift.data.synthetic.masks import frame_mesh, make_shapes, render_masks
from uplift.geometry.mesh import Mesh
from uplift.geometry.rotation import random_rotations
from uplift.geometry.silhouette import cover, draw_mask, project

_SIDE = 64


def _views(count: int, seed: int) -> np.ndarray:
    torch.manual_seed(seed)
    return random_rotations(count).double().numpy()


def _square(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([(low, low), (high, low), (high, high), (low, high)], float)
    return corners, np.array([(0, 1, 2), (0, 2, 3)])


def test_whole_and_half_pixels_of_a_square() -> None:
    mask = draw_mask(*_square(2.0, 5.5), 8)
    assert (mask[2:5, 2:5] == 255).all()
    assert (mask[5, 2:5] == 128).all()
    assert mask[5, 5] == 64
    assert mask[:2].sum() == mask[6:].sum() == 0


def test_winding_and_order_do_not_matter_and_what_is_outside_is_cut_off() -> None:
    points, faces = _square(-4.0, 20.0)
    assert (draw_mask(points, faces, 8) == 255).all()
    points, faces = _square(1.3, 6.1)
    np.testing.assert_array_equal(draw_mask(points, faces, 8), draw_mask(points, faces[::-1, ::-1], 8))
    assert not draw_mask(points + 100, faces, 8).any()
    assert not draw_mask(points, faces[:0], 8).any()


def test_a_disc_has_the_area_of_a_disc() -> None:
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    points = np.concatenate([[(16.2, 15.7)], (16.2, 15.7) + 11.3 * np.stack([np.cos(angle), np.sin(angle)], 1)])
    around = np.arange(200)
    faces = np.stack([np.zeros(200, int), 1 + around, 1 + (around + 1) % 200], 1)
    assert draw_mask(points, faces, 32).sum() / 255 == pytest.approx(np.pi * 11.3**2, rel=5e-3)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_random_triangles_agree_with_another_drawer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, faces = rng.uniform(-5, 37, (12, 2)), rng.integers(0, 12, (9, 3))
    finer = 16
    image = Image.new("L", (32 * finer, 32 * finer))
    for face in faces:
        ImageDraw.Draw(image).polygon([tuple(point) for point in points[face] * finer - 0.5], fill=255)
    expected = np.asarray(image.resize((32, 32), Image.Resampling.BOX), float)
    # The other one draws its outline too, half a sample wide.
    assert np.abs(draw_mask(points, faces, 32) - expected).mean() < 4


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), distance=st.sampled_from([2.2, 4.0, 8.0, np.inf]))
def test_a_crop_is_centred_and_full(seed: int, distance: float) -> None:
    points = np.random.default_rng(seed).uniform(-0.9, 0.9, (30, 3)) * (1, 0.5, 1)
    scale, offset = frame_mesh(points, distance)
    placed = scale * points + (*offset, 0)
    seen = project(placed, scale * distance)
    np.testing.assert_allclose(seen.max(0) + seen.min(0), 0, atol=1e-9)
    assert np.isclose((seen.max(0) - seen.min(0)).max(), 2 * FILL)


@pytest.mark.parametrize("family", ["furniture", "animals", "vehicles"])
@pytest.mark.parametrize("far", [3.0, 6.0, np.inf])
def test_the_truth_projects_onto_the_mask(family: str, far: float) -> None:
    meshes = make_shapes(family, 4, 1)
    shape = np.array([0, 1, 2, 3, 3, 0])
    masks, truth = render_masks(meshes, shape, _views(6, 2), np.full(6, far), _SIDE)
    np.testing.assert_array_equal(truth.shape, shape)
    assert np.isinf(truth.distance).all() == np.isinf(far)
    for item in range(6):
        mesh = truth.meshes[truth.shape[item]]
        camera = truth.scale[item] * mesh.vertices @ truth.view[item].astype(float).T
        camera[:, :2] += truth.offset[item]
        pixel = (camera[:, :2] / (1 + camera[:, 2:] / truth.distance[item]) + 1) * _SIDE / 2
        covered = np.argwhere(masks[item] > 0)[:, ::-1]
        np.testing.assert_allclose(pixel.min(0), covered.min(0) + 0.5, atol=1.0)
        np.testing.assert_allclose(pixel.max(0), covered.max(0) + 0.5, atol=1.0)
        nearest = np.abs(pixel[:, None] - (covered + 0.5)[None]).max(2).min(1)
        assert nearest.max() < 1.5  # every vertex lies on the mask


def test_a_nearer_camera_sees_near_parts_larger() -> None:
    corners = np.array([(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    front, back = Mesh(corners[:4], np.array([(0, 1, 2)])), Mesh(corners[4:], np.array([(0, 1, 2)]))
    sizes = []
    for mesh in (front, back):
        placed = mesh.vertices
        sizes.append(float(np.ptp(project(placed, 2.0)[:, 0])))
    assert sizes == pytest.approx([4 / 3, 4 / 5])


def test_a_box_filling_its_crop() -> None:
    cube = make_shapes("storage", 1, 0)[0]
    masks, truth = render_masks([cube], np.array([0]), np.eye(3)[None], np.array([np.inf]), _SIDE)
    rows, columns = np.flatnonzero(masks[0].any(1)), np.flatnonzero(masks[0].any(0))
    longer = max(len(rows), len(columns))
    assert abs(longer - FILL * _SIDE) <= 2
    assert abs(rows.mean() - (_SIDE - 1) / 2) <= 0.5
    assert abs(columns.mean() - (_SIDE - 1) / 2) <= 0.5
    assert truth.scale[0] == pytest.approx(FILL / 0.9, rel=1e-6)


def test_triangles_are_taken_a_few_at_a_time_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a million of them do not fill the memory."""
    rng = np.random.default_rng(0)
    points, faces = rng.uniform(-4, 36, (60, 2)), rng.integers(0, 60, (40, 3))
    whole = cover(points, faces, 32)
    monkeypatch.setattr("uplift.geometry.silhouette._SPANS", 70)
    assert np.array_equal(cover(points, faces, 32), whole) and 0 < whole.sum() < whole.size
