"""The metrics of one lifted shape: properties that hold whatever the shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from shape_scenes import box, chair, placed, union

from uplift.metrics.evaluate_shapes import filled_truths
from uplift.metrics.protocols import SHAPE_METRICS, metric_meaning, metric_order, metric_unit
from uplift.metrics.shape_metrics import (
    SIDE,
    Silhouette,
    Standing,
    TrueItem,
    compare_surfaces,
    grid_surface,
    handedness,
    mesh_surface,
    of_mask,
    overlap,
    silhouette,
    true,
    volume_iou,
    volume_iou_aligned,
)

BOX = union(box((-1, -0.5, -0.25), (1, 0.5, 0.25)))


def standing(
    mesh=None, azimuth_deg: float = 30.0, tilt_deg: float = 20.0, distance: float = np.inf, side: int = 64
) -> Standing:
    truth = placed([mesh or chair()], [0], [azimuth_deg], tilt_deg, distance)
    return true(truth, 0, next(filled_truths(truth, np.arange(1), side))[1])


def shrunk(shape: Standing, by: float) -> Standing:
    return replace(shape, matrix=shape.matrix * by)


def test_a_shape_shares_all_its_volume_with_itself_and_less_the_more_it_shrinks():
    truth = standing()
    ious = [volume_iou(shrunk(truth, by), truth) for by in (1.0, 0.9, 0.7, 0.4)]
    assert ious[0] == pytest.approx(1)
    assert ious == sorted(ious, reverse=True) and ious[-1] < 0.1


def test_volume_iou_of_boxes_is_what_geometry_says():
    truth = standing(BOX, 0, 0)
    assert volume_iou(shrunk(truth, 0.55), truth) == pytest.approx(0.55**3, rel=0.12)
    aside = replace(truth, origin=truth.origin + [truth.matrix[0, 0] * 0.9, 0, 0])  # by half of its width
    assert volume_iou(aside, truth) == pytest.approx(1 / 3, abs=0.02)


def test_volume_outside_the_grid_of_the_truth_counts():
    truth = standing(BOX, 0, 0)
    large = shrunk(truth, 3.0)
    assert large.volume > 8 * (2 * truth.matrix[0, 0]) ** 3 / 8  # it leaves the truth's cube
    assert volume_iou(large, truth) == pytest.approx(1 / 27, abs=0.004)


@pytest.mark.parametrize("step", [-3.0, 0.4, 10.0])
def test_a_shape_moved_in_depth_shares_the_same(step):
    truth = standing()
    assert volume_iou(shrunk(truth, 0.9).moved(step), truth) == pytest.approx(
        volume_iou(shrunk(truth, 0.9), truth), abs=2e-3
    )


def changed(shape: Standing, turn_deg=0.0, lean_deg=(0.0, 0.0), scale=1.0, shift=(0.0, 0.0, 0.0)) -> Standing:
    """Return the shape after a similarity of its own frame about its centroid; the shift in its longest side, 1.8."""
    own = Rotation.from_rotvec(np.radians([lean_deg[0], turn_deg, lean_deg[1]])).as_matrix()
    turn = scale * shape.matrix @ own @ np.linalg.inv(shape.matrix)
    middle = shape.occupied.mean(0)
    origin = middle + turn @ (shape.origin - middle) + shape.matrix @ (1.8 * np.array(shift))
    return replace(shape, matrix=turn @ shape.matrix, origin=origin)


SMALL = {
    "a turn": {"turn_deg": 5.0},
    "a large turn": {"turn_deg": -14.0},
    "a tilt": {"lean_deg": (9.0, -4.0)},
    "a size": {"scale": 1.12},
    "a smaller one": {"scale": 0.9},
    "a shift": {"shift": (0.08, -0.05, 0.0)},
    "all": {"turn_deg": 8.0, "lean_deg": (5.0, 4.0), "scale": 0.93, "shift": (-0.04, 0.03, 0.02)},
}


@pytest.fixture(scope="module")
def chairs() -> dict[str, Standing]:
    """Return a thick chair, and one of four thin legs and a back of thin boards."""
    legs = [box((x, 0, z), (x + 0.1, 1, z + 0.1)) for x in (-0.5, 0.4) for z in (-0.5, 0.4)]
    boards = [box((-0.5, -at, 0.42), (0.5, -at + 0.12, 0.5)) for at in (0.95, 0.6, 0.3)]
    return {"thick": standing(), "thin": standing(union(*legs, box((-0.5, 0, -0.5), (0.5, 0.06, 0.5)), *boards))}


@pytest.mark.parametrize("change", SMALL.values(), ids=SMALL)
def test_a_small_error_of_the_pose_costs_no_aligned_volume(change: dict, chairs: dict[str, Standing]) -> None:
    for truth in chairs.values():
        moved = changed(truth, **change)
        assert volume_iou(moved, truth) < 0.9
        with torch.inference_mode():
            assert volume_iou_aligned(moved, truth) > 0.95


def test_an_aligned_shape_of_another_kind_scores_as_its_own_shape_does() -> None:
    # The same wrong shape, its pose right and a little wrong: what is left is the error of the shape.
    truth, other = standing(side=40), standing(chair(0.85, 1.15), side=40)
    straight = volume_iou_aligned(other, truth)
    assert straight >= volume_iou(other, truth)
    slanted = volume_iou_aligned(changed(other, 4.0, (2.0, -3.0), 1.04, (0.02, 0.03, -0.02)), truth)
    assert straight < 0.9 and slanted == pytest.approx(straight, abs=0.02)


@pytest.mark.parametrize("change", [{"turn_deg": 60.0}, {"scale": 0.6}, {"shift": (0.4, 0.0, 0.0)}])
def test_large_errors_of_the_pose_are_not_undone(change: dict, chairs: dict[str, Standing]) -> None:
    truth = chairs["thick"]
    moved = changed(truth, **change)
    assert volume_iou(moved, truth) - 1e-9 <= volume_iou_aligned(moved, truth) < 0.75


def test_aligned_volume_of_nothing_is_none(chairs: dict[str, Standing]) -> None:
    truth = chairs["thin"]
    assert volume_iou_aligned(replace(truth, occupancy=truth.occupancy * 0), truth) == 0
    assert volume_iou_aligned(truth, truth) == pytest.approx(1)


def test_mirroring_twice_is_nothing_and_once_keeps_silhouette_and_depth():
    truth = standing()
    mirror = truth.mirrored()
    assert mirror.depth == pytest.approx(truth.depth)
    assert overlap(silhouette(mirror, 2 / SIDE), silhouette(truth, 2 / SIDE)) > 0.97
    assert volume_iou(mirror, truth) < 0.7
    assert volume_iou(mirror.mirrored(), truth) == pytest.approx(1)


def test_handedness_tells_a_shape_from_its_mirror_image():
    truth = standing()
    assert handedness(truth, truth, 1.0) == 1
    mirror = truth.mirrored()
    assert handedness(mirror, truth, volume_iou(mirror, truth)) == 0
    assert handedness(shrunk(truth, 0.8), truth, volume_iou(shrunk(truth, 0.8), truth)) == 1


def test_a_truth_that_is_its_own_mirror_has_no_handedness():
    truth = standing(BOX, 0, 0)
    assert np.isnan(handedness(truth, truth, 1.0))


def test_the_silhouette_of_a_box_is_its_rectangle():
    truth = standing(BOX, 0, 0)
    seen = silhouette(truth, 2 / SIDE)
    assert seen.covered.sum(1).max() == pytest.approx(0.85 * SIDE, abs=2)
    assert seen.covered.sum(0).max() == pytest.approx(0.425 * SIDE, abs=2)
    rows = np.flatnonzero(seen.covered.any(1)) + seen.row
    assert abs(rows.mean() + 0.5) <= 0.5  # centred


def test_silhouettes_of_the_truth_show_what_no_voxel_holds():
    mesh = union(box((-1, 0.9, -1), (1, 1, 1)), box((-0.035, -1, -0.035), (0.035, 0.95, 0.035)))
    truth = placed([mesh], [0], [30.0], 0.0)
    [(row, filled)] = filled_truths(truth, np.arange(1), 24)
    assert not filled[:, :10].any()  # the pole stands between the voxels' centres
    item = TrueItem(truth, row, filled)
    for seen in item.silhouettes:
        assert seen.covered[1 : len(seen.covered) // 2].any(1).all()


def test_a_nearer_camera_sees_the_near_side_larger():
    cube = union(box((-1, -1, -1), (1, 1, 1)))
    wide = [silhouette(standing(cube, 0, 0, distance), 2 / SIDE).covered.any(0).sum() for distance in (np.inf, 8, 3)]
    assert wide[0] < wide[1] < wide[2]
    assert wide[2] == pytest.approx(0.85 * SIDE / (1 - 0.85 / 3), abs=2)


def test_a_silhouette_follows_its_shape_across_the_image():
    truth = standing()
    seen = silhouette(truth, 2 / SIDE)
    aside = silhouette(replace(truth, origin=truth.origin + np.array([5, -3, 0]) * 2 / SIDE), 2 / SIDE)
    assert (aside.column - seen.column, aside.row - seen.row) == (5, -3)
    assert (aside.covered == seen.covered).mean() > 0.98


def test_overlap_of_pixels():
    whole = Silhouette(0, 0, np.ones((4, 4), bool))
    assert overlap(whole, whole) == 1
    assert overlap(whole, Silhouette(2, 0, np.ones((4, 4), bool))) == pytest.approx(8 / 24)
    assert overlap(whole, Silhouette(9, 9, np.ones((2, 2), bool))) == 0
    assert overlap(whole, Silhouette(0, 0, np.zeros((0, 0), bool))) == 0
    assert overlap(Silhouette(0, 0, np.zeros((0, 0), bool)), Silhouette(3, 3, np.zeros((0, 0), bool))) == 0


@pytest.mark.parametrize("side", [32, 64, 100, 128])
def test_masks_of_any_side_cover_the_same_pixels(side):
    at = (2 * np.arange(side) + 1) / side - 1
    mask = np.where((np.abs(at)[:, None] < 0.5) & (np.abs(at) < 0.25), 255, 0).astype(np.uint8)
    found = of_mask(mask).covered
    assert found.shape == (SIDE, SIDE)
    assert found.sum() == pytest.approx(SIDE * SIDE / 8, rel=0.13)


def test_surfaces_of_mesh_and_grid_are_the_same_surface():
    mesh, truth = chair(), standing(side=64)
    longest = 1.8 * np.linalg.norm(truth.matrix[0])
    of_mesh = mesh_surface(mesh, truth)
    of_grid = grid_surface(truth)
    assert of_grid is not None
    found = compare_surfaces(of_grid, of_mesh, longest)
    assert found["chamfer"] < 0.012 and found["f_score"] > 0.95 and found["normal_consistency"] > 0.93


def test_points_inside_a_union_are_no_surface():
    inner = union(box((-1, -1, -1), (1, 1, 1)), box((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4)))
    truth = standing(inner, 0, 0)
    found = (mesh_surface(inner, truth).points - truth.origin) @ truth.inverse.T
    assert np.abs(found).max(1).min() == pytest.approx(0.9, abs=1e-6)


def test_chamfer_is_in_the_longest_side():
    truth = standing(BOX, 0, 0)
    surface = mesh_surface(BOX, truth)
    longest = float(1.8 * truth.matrix[0, 0])
    moved = replace(surface, points=surface.points + [0, 0, 10 * longest])
    assert compare_surfaces(moved, surface, longest)["chamfer"] == pytest.approx(10, rel=0.05)
    assert compare_surfaces(None, surface, longest) == {"chamfer": 1.0, "f_score": 0.0, "normal_consistency": 0.0}
    # Farther apart than the threshold, no point counts; nearer, all do.
    for share, expected in ((0.03, 0.0), (0.015, 1.0)):
        plane = replace(surface, points=surface.points * [1, 1, 0])
        apart = replace(plane, points=plane.points + [0, 0, share * longest])
        assert compare_surfaces(apart, plane, longest)["f_score"] == pytest.approx(expected, abs=1e-3)


def test_every_metric_has_a_meaning_a_unit_and_a_better_way():
    assert [metric_unit(name) for name in ("chamfer", "f_score", "azimuth_deg")] == ["longest side", "", "deg"]
    lower = [name for name, of in SHAPE_METRICS.items() if of.better == "lower"]
    assert lower == ["chamfer", "azimuth_deg", "rotation_deg", "elevation_deg"]
    assert list(SHAPE_METRICS)[:4] == ["silhouette_iou_unseen", "f_score", "chamfer", "volume_iou"]
    assert metric_meaning("best_floor_volume_iou") == "the best baseline's: " + metric_meaning("volume_iou")
    names = ["best_floor_volume_iou", "chamfer", "volume_iou"]
    assert sorted(names, key=metric_order) == ["chamfer", "volume_iou", "best_floor_volume_iou"]
