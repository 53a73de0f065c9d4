"""Evaluations of lifted shapes: the truth scores best, nothing depends on order, nothing crashes."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from shape_scenes import SIDE, box, chair, grids, masks_of, placed, prediction_of, union

from uplift.errors import UserError
from uplift.metrics import evaluate_shapes as shape_evaluator
from uplift.metrics.protocols import SHAPE_METRICS
from uplift.metrics.report import ShapeEvaluation
from uplift.metrics.shape_metrics import predicted
from uplift.models.prediction import ShapePrediction

evaluate_all = partial(shape_evaluator.evaluate_all, resolution=SIDE)
evaluate_shapes = partial(shape_evaluator.evaluate_shapes, resolution=SIDE)
SHARES = ("volume_iou", "silhouette_iou_seen", "silhouette_iou_unseen", "f_score", "normal_consistency")
AZIMUTHS = [25.0, 100.0, 215.0]
TRUTH = placed([chair(), chair(0.6, 1.3)], [0, 1, 0], AZIMUTHS)


@pytest.fixture(scope="module")
def masks() -> np.ndarray:
    return masks_of(TRUTH).masks


@pytest.fixture(scope="module")
def exact(masks) -> ShapePrediction:
    return prediction_of(TRUTH, masks)


@pytest.fixture(scope="module")
def scored(exact, masks) -> dict[str, ShapeEvaluation]:
    """Return the truth itself, and what is done to it, scored."""
    coarse = prediction_of(TRUTH, masks, grids(TRUTH, 24))
    small = replace(exact, scale=exact.scale * 0.8)
    nothing = replace(exact, occupancy=np.zeros_like(exact.occupancy))
    one_empty = replace(exact, occupancy=exact.occupancy * np.array([1, 0, 1], np.float32)[:, None, None, None])
    made = {"exact": exact, "coarse": coarse, "small": small, "nothing": nothing, "one_empty": one_empty}
    made["mirror"] = mirrored(exact)
    return evaluate_all(made, TRUTH, masks, "boxes")


def mirrored(exact: ShapePrediction) -> ShapePrediction:
    """Return shapes mirrored in depth: in the own frame (x), with the view that stands it so in the camera's."""
    view = np.diag([1, 1, -1]) @ exact.view @ np.diag([-1, 1, 1])
    return replace(exact, occupancy=exact.occupancy[..., ::-1].copy(), view=view)


def test_the_truth_itself_scores_one(scored):
    overall = scored["exact"].overall
    assert overall["volume_iou"] == pytest.approx(1) and overall["handedness"] == 1
    # New views are compared with the mesh itself, of which the grid cuts the corners.
    assert overall["silhouette_iou_seen"] == pytest.approx(1) and overall["silhouette_iou_unseen"] > 0.95
    assert overall["chamfer"] < 0.015 and overall["f_score"] > 0.9 and overall["normal_consistency"] > 0.9
    assert overall["azimuth_deg"] < 0.51 and overall["elevation_deg"] == pytest.approx(0, abs=1e-6)
    assert list(overall) == [name for name in SHAPE_METRICS if name not in ("rotation_deg", "train_views_within_20")]
    assert overall["views_within_20"] == 1 and overall["volume_iou_aligned"] == pytest.approx(1)


def test_a_coarser_grid_costs_little(scored):
    overall = scored["coarse"].overall
    assert overall["volume_iou"] > 0.8 and overall["silhouette_iou_unseen"] > 0.85 and overall["handedness"] == 1


def test_a_smaller_shape_scores_less(scored):
    for name in SHARES[:4]:
        assert scored["small"].overall[name] < scored["exact"].overall[name] - 0.1
    assert scored["small"].overall["chamfer"] > scored["exact"].overall["chamfer"]


def test_a_shape_mirrored_in_depth_has_no_handedness_though_it_looks_the_same(scored):
    overall = scored["mirror"].overall
    assert overall["handedness"] == 0
    assert overall["silhouette_iou_seen"] > 0.97
    assert overall["volume_iou"] < 0.7 and overall["silhouette_iou_unseen"] < 0.9


def test_empty_shapes_score_nothing_and_are_told(scored):
    overall = scored["nothing"].overall
    assert all(overall[name] == 0 for name in (*SHARES, "handedness")) and overall["chamfer"] == 1
    assert any("3 of 3 predicted shapes are empty" in note for note in scored["nothing"].notes)
    assert not any("empty" in note for note in scored["exact"].notes)
    third = scored["one_empty"].overall["volume_iou"]
    assert third == pytest.approx(2 / 3) and any("1 of 3" in note for note in scored["one_empty"].notes)


def test_depth_of_the_own_origin_is_no_error(exact, masks, scored):
    # The same shape in a grid whose origin is elsewhere in depth: shifted in own frame along the camera's axis.
    low = placed([chair()], [0], [0.0], 0.0)
    once = masks_of(low).masks
    straight = prediction_of(low, once)
    behind = replace(straight, occupancy=np.roll(straight.occupancy, 3, axis=1) * 1.0)  # own z is the camera's
    here, there = (evaluate_shapes(shape, low, once, "").overall for shape in (straight, behind))
    assert here["volume_iou"] == pytest.approx(1, abs=1e-3) and there["volume_iou"] == pytest.approx(1, abs=1e-3)
    assert there["silhouette_iou_unseen"] == pytest.approx(here["silhouette_iou_unseen"], abs=1e-3)
    aside = replace(straight, offset=straight.offset + 0.2)
    assert evaluate_shapes(aside, low, once, "").overall["volume_iou"] < 0.7


def test_the_order_of_items_changes_nothing(exact, masks, scored):
    small = replace(exact, scale=exact.scale * 0.8)
    order = np.array([2, 0, 1])
    again = evaluate_all({"small": small.select(order)}, TRUTH.select(order), masks[order], "boxes")["small"]
    assert again.overall == pytest.approx(scored["small"].overall)
    for name, values in again.per_item.items():
        np.testing.assert_allclose(values, scored["small"].per_item[name][order])


def test_categories_are_means_of_their_items(exact, masks):
    small = replace(exact, scale=exact.scale * np.array([1, 0.8, 0.6]))
    result = evaluate_shapes(small, TRUTH, masks, "boxes", np.array(["stool", "bench", "stool"]))
    volume = result.per_item["volume_iou"]
    assert result.per_category["bench"]["volume_iou"] == volume[1]
    assert result.per_category["stool"]["volume_iou"] == pytest.approx(volume[[0, 2]].mean())
    assert result.category_items == {"bench": 1, "stool": 2}
    assert list(evaluate_shapes(small, TRUTH, masks, "boxes").per_category) == ["chair"]  # from the meshes


def test_truths_that_are_their_own_mirror_image_have_no_handedness():
    truth = placed([union(box((-1, -1, -0.3), (1, 1, 0.3))), chair()], [0, 1], [0.0, 20.0], 0.0)
    once = masks_of(truth).masks
    result = evaluate_shapes(prediction_of(truth, once), truth, once, "")
    assert np.isnan(result.per_item["handedness"][0]) and result.overall["handedness"] == 1
    assert any("1 of 2 true shapes are their own mirror image" in note for note in result.notes)


def test_an_evaluation_is_told_as_data_csv_and_table(scored, tmp_path):
    result = replace(scored["small"], baselines={"hull": scored["coarse"].overall})
    told = json.loads(json.dumps(result.to_dict()))
    assert told["data"] == "boxes" and told["overall"]["volume_iou"] == result.overall["volume_iou"]
    assert told["floors"]["hull"]["f_score"] == scored["coarse"].overall["f_score"]
    result.write_csv(tmp_path / "figures.csv")
    with (tmp_path / "figures.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["group"] for row in rows} == {"overall", "category", "floor", "item"}
    item = [row for row in rows if row["group"] == "item" and row["protocol"] == "chamfer"]
    assert [float(row["value"]) for row in item] == result.per_item["chamfer"].tolist()
    assert {row["unit"] for row in item} == {"longest side"}
    table = result.table()
    assert "boxes: 3 shapes" in table and "hull" in table and "per category" in table
    assert all(name in table for name in result.overall)


def test_grids_of_half_precision_are_read(exact, masks, scored):
    half = replace(exact, occupancy=exact.occupancy.astype(np.float16))
    assert evaluate_shapes(half, TRUTH, masks, "").overall["volume_iou"] == pytest.approx(1)


def test_views_of_rolled_cameras_are_compared_over_all_rotations(exact, masks):
    roll = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    rolled = replace(TRUTH, view=roll @ TRUTH.view)
    overall = evaluate_shapes(replace(exact, view=rolled.view), rolled, masks, "").overall
    assert overall["rotation_deg"] == pytest.approx(0, abs=1e-3) and overall["views_within_20"] == 1
    assert "azimuth_deg" not in overall and "elevation_deg" not in overall


def test_a_full_grid_is_a_cube(exact):
    full = predicted(replace(exact, occupancy=np.ones_like(exact.occupancy)), 0)
    assert full.volume == pytest.approx((2 * exact.scale[0]) ** 3)


def test_what_cannot_be_compared_is_told(exact, masks):
    with pytest.raises(UserError, match=r"2 shapes, the truth 3, and there are 3 masks"):
        evaluate_shapes(exact.select(np.arange(2)), TRUTH, masks, "")
    nowhere = replace(exact, scale=np.array([1.0, 0.0, 1.0]))
    with pytest.raises(UserError, match=r"'scale' of 1 shapes .* item 1"):
        evaluate_shapes(nowhere, TRUTH, masks, "")
    large = replace(chair(), vertices=chair().vertices * 3)
    with pytest.raises(UserError, match="its own unit"):
        evaluate_shapes(exact, replace(TRUTH, meshes=[large, large]), masks, "")
    none = np.arange(0)
    with pytest.raises(UserError, match="no shapes"):
        evaluate_shapes(exact.select(none), TRUTH.select(none), masks[:0], "")
