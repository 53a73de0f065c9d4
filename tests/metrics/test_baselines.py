"""The baselines of shapes: each finds what it is to find, and sees no truth of the test items."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from shape_scenes import SIDE, box, chair, masks_of, placed, prediction_of, union

from uplift.data.masks import MaskData
from uplift.errors import UserError
from uplift.metrics import baselines
from uplift.metrics import evaluate_shapes as shape_evaluator
from uplift.metrics.baselines import (
    best_thickness,
    extrusion,
    hull_occupancy,
    mask_half,
    mean_shape,
    nearest_masks,
    score_with_baselines,
    training_truth,
)

evaluate_all = partial(shape_evaluator.evaluate_all, resolution=SIDE)
evaluate_shapes = partial(shape_evaluator.evaluate_shapes, resolution=SIDE)
shape_baselines = partial(baselines.shape_baselines, resolution=SIDE)


def slabs(thickness: float, count: int = 3, distance: float = np.inf) -> MaskData:
    """Return boxes of several widths that face the camera, as deep as ``thickness`` of their height."""
    meshes = [union(box((-w, -1, -thickness), (w, 1, thickness))) for w in np.linspace(0.3, 0.9, count)]
    return masks_of(placed(meshes, list(range(count)), [0.0] * count, 0.0, distance))


@pytest.fixture(scope="module")
def chairs() -> MaskData:
    meshes = [chair(width, back) for width, back in ((1.0, 1.0), (0.6, 1.3), (0.8, 0.6))]
    return masks_of(placed(meshes, [0, 1, 2, 0, 1, 2], [20.0, 70.0, 130.0, 200.0, 250.0, 310.0]))


@pytest.mark.parametrize("thickness", [0.2, 0.5])
def test_the_hull_finds_the_thickness_of_slabs(thickness):
    train = slabs(thickness)
    known = training_truth(train, train.truth, 10, SIDE, 0)
    assert best_thickness(known) == pytest.approx(thickness, abs=0.05)
    hull = shape_baselines(train, train)["hull"]
    overall = evaluate_shapes(hull, train.truth, train.masks, "").overall
    assert overall["volume_iou"] > 0.9 and overall["silhouette_iou_seen"] > 0.97


def test_no_other_thickness_is_better_when_evaluated(chairs):
    chairs = chairs.select(np.arange(3))
    found = shape_baselines(chairs, chairs)["hull"]
    best = best_thickness(training_truth(chairs, chairs.truth, 10, SIDE, 0))
    others = {
        str(share): replace(
            found,
            occupancy=np.stack([hull_occupancy(mask, np.inf, best * share, SIDE) for mask in chairs.masks]),
        )
        for share in (0.7, 1.4)
    }
    scored = evaluate_all({"best": found, **others}, chairs.truth, chairs.masks, "")
    volume = {title: result.overall["volume_iou"] for title, result in scored.items()}
    assert volume["best"] == max(volume.values())


def test_a_mask_extruded_has_the_mask_for_silhouette_in_perspective():
    data = slabs(0.4, distance=3.0)
    found = evaluate_shapes(shape_baselines(data, data)["hull"], data.truth, data.masks, "").overall
    assert found["silhouette_iou_seen"] > 0.95
    near, far = (extrusion(data.masks[0], 3.0, SIDE)[layer].sum() for layer in (3, SIDE - 4))
    assert far > 1.5 * near


def test_what_knows_no_depth_has_no_handedness_however_near_the_camera():
    meshes = [chair(width, back) for width, back in ((1.0, 1.0), (0.6, 1.3), (0.8, 0.6), (1.2, 0.8))]
    data = masks_of(placed(meshes, [0, 1, 2, 3] * 2, [20.0 + 40 * item for item in range(8)], distance=3.0))
    assert data.truth is not None
    found = shape_baselines(data, data)["hull"]
    signs = evaluate_shapes(found, data.truth, data.masks, "").per_item["handedness"]
    assert 0.2 < np.nanmean(signs) < 0.8


def test_the_mean_of_equal_shapes_is_the_shape():
    mesh = chair()
    data = masks_of(placed([mesh], [0] * 3, [40.0] * 3))
    found = evaluate_shapes(shape_baselines(data, data)["mean_shape"], data.truth, data.masks, "").overall
    assert found["volume_iou"] > 0.85 and found["handedness"] == 1


def test_the_mean_is_cut_by_the_mask_where_that_is_better():
    data = slabs(0.3, 6)
    known = training_truth(data, data.truth, 10, SIDE, 0)
    assert mean_shape(known).in_mask
    everything = replace(known, extruded=np.ones_like(known.extruded))
    assert not mean_shape(everything).in_mask  # masks that cut nothing: no better, the first of equals


def test_nearest_finds_an_identical_item_and_a_mirrored_one(chairs):
    order = np.array([3, 0, 5])
    rows, mirrored = nearest_masks(chairs.masks[order], chairs.masks)
    assert rows.tolist() == [3, 0, 5] and not mirrored.any()
    rows, mirrored = nearest_masks(chairs.masks[order][:, :, ::-1].copy(), chairs.masks[order])
    assert rows.tolist() == [0, 1, 2] and mirrored.all()


def test_nearest_of_the_training_set_itself_is_the_truth(chairs):
    chairs = chairs.select(np.array([1, 3, 5]))
    found = shape_baselines(chairs, chairs)["nearest"]
    overall = evaluate_shapes(found, chairs.truth, chairs.masks, "").overall
    assert overall["volume_iou"] == pytest.approx(1) and overall["handedness"] == 1


def test_a_mirrored_item_is_a_shape_mirrored_left_to_right():
    mesh = union(box((-1, -1, -0.5), (1, 0, 0.5)), box((0, -0.1, -0.5), (1, 1, 0.2)))  # nothing is symmetric
    train = masks_of(placed([mesh], [0], [35.0]))
    test = replace(train, masks=train.masks[:, :, ::-1].copy())
    nearest = shape_baselines(train, test)["nearest"]
    assert np.linalg.det(nearest.view[0]) == pytest.approx(1)
    assert evaluate_shapes(nearest, train.truth, test.masks, "").overall["silhouette_iou_seen"] > 0.97
    other = replace(mesh, vertices=mesh.vertices * [-1, 1, 1], faces=mesh.faces[:, ::-1])
    truth = placed([other], [0], [-35.0])
    assert evaluate_shapes(nearest, truth, test.masks, "").overall["volume_iou"] == pytest.approx(1, abs=1e-3)


def test_floors_see_no_truth_of_the_test_items(chairs):
    known = shape_baselines(chairs, chairs)
    blind = shape_baselines(chairs, chairs.without_truth())
    for title in known:
        np.testing.assert_array_equal(known[title].occupancy, blind[title].occupancy)
        np.testing.assert_array_equal(known[title].view, blind[title].view)


def test_a_part_of_a_large_training_set_is_always_the_same(chairs):
    one, two = (training_truth(chairs, chairs.truth, 3, 24, seed=7) for _ in range(2))
    assert len(one.half) == 3
    np.testing.assert_array_equal(one.inside, two.inside)


def test_the_best_baseline_stands_beside_the_run(chairs):
    train, test = chairs.select(np.arange(4)), chairs.select(np.array([4, 5]))
    result = score_with_baselines(prediction_of(test.truth, test.masks), train, test, "chairs", resolution=SIDE)
    assert list(result.baselines) == ["hull", "mean_shape", "nearest"]
    for metric in ("silhouette_iou_unseen", "f_score", "volume_iou", "volume_iou_aligned"):
        best = max(values[metric] for values in result.baselines.values())
        assert result.overall["best_floor_" + metric] == best < result.overall[metric]
    nearest = min(values["chamfer"] for values in result.baselines.values())
    assert result.overall["best_floor_chamfer"] == nearest > result.overall["chamfer"]
    assert list(result.overall)[:4] == [
        "silhouette_iou_unseen",
        "best_floor_silhouette_iou_unseen",
        "f_score",
        "best_floor_f_score",
    ]
    table = result.table()
    assert "mean_shape" in table and "best_floor" not in table
    assert sum(note.startswith("baseline ") for note in result.notes) == 3
    assert result.to_dict()["floors"] == result.baselines


def test_masks_of_real_life_have_no_baselines(chairs):
    with pytest.raises(UserError, match="no true shapes, and every baseline"):
        shape_baselines(chairs.without_truth(), chairs)
    with pytest.raises(UserError, match="no true shapes to compare with"):
        score_with_baselines(prediction_of(chairs.truth, chairs.masks), chairs, chairs.without_truth(), "photos")


def test_an_empty_mask_has_no_size_and_an_empty_hull(chairs):
    empty = np.zeros((64, 64), np.uint8)
    assert mask_half(empty) == 0
    assert not (hull_occupancy(empty, np.inf, 0.5, 16) > 0.5).any()
