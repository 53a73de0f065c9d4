"""Which frame follows which: one rule for refinement, interpolation and metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uplift.data.poses import PoseData, clips_of, previous_frames
from uplift.data.tensors import TrainingSet
from uplift.metrics.scores import previous_rows
from uplift.models.predict import gap_joints
from uplift.models.refine import has_clips
from uplift.skeleton import load_skeleton

SKELETON = load_skeleton("h36m17")
STEPS = {"slow": 5, "fast": 1}


def two_clips(frames: int = 6) -> PoseData:
    """Return clips whose frame numbers go up by 5 and by 1, the longer one by 1."""
    rng = np.random.default_rng(0)
    counts = {"slow": frames, "fast": 2 * frames}
    total = sum(counts.values())
    return PoseData(
        rng.normal(size=(total, 17, 2)).astype(np.float32) * 100,
        np.ones((total, 17), np.float32),
        SKELETON.joints,
        identity={
            "sequence": np.repeat(list(counts), list(counts.values())),
            "frame": np.concatenate([np.arange(count) * STEPS[name] for name, count in counts.items()]),
        },
    )


def test_each_clip_has_the_step_that_is_usual_in_it():
    data = two_clips()
    assert (~data.follows()).nonzero()[0].tolist() == [0, 6]
    assert data.previous().tolist() == [-1, *range(5), -1, *range(6, 17)]


def test_a_larger_step_than_usual_is_a_gap():
    data = two_clips()
    kept = np.delete(np.arange(18), [3, 9])  # a frame of each clip is gone
    assert (~data.select(kept).follows()).nonzero()[0].tolist() == [0, 3, 5, 8]


def test_two_frames_alone_have_the_step_of_the_file():
    assert previous_frames(np.array([0, 0, 0, 1, 1]), np.array([0, 1, 2, 0, 7])).tolist() == [-1, 0, 1, -1, -1]
    assert previous_frames(np.array([0, 0]), np.array([0, 7])).tolist() == [-1, 0]


def test_times_in_seconds_need_not_be_exact():
    time = np.arange(50) / 30
    assert (previous_frames(np.zeros(50, int), time.astype(np.float32)) >= 0).sum() == 49


def test_rows_without_frame_numbers_are_neighbours():
    data = replace(two_clips(2), identity={"sequence": np.array(list("aabbab"))})
    assert data.previous().tolist() == [-1, 0, -1, 2, 1, 3]
    assert data.follows().tolist() == [False, True, False, True, False, False]


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_rows_changes_nothing(seed: int):
    data = two_clips()
    order = np.random.default_rng(seed).permutation(len(data))
    mixed, place = data.select(order), np.argsort(order)
    back = np.append(place, -1)[data.previous()]
    assert np.array_equal(mixed.previous(), back[order])
    assert mixed.select(mixed.in_order()).follows().sum() == data.follows().sum()


def test_metrics_refinement_and_interpolation_go_by_the_same_rule():
    data = two_clips()
    previous = previous_rows(data.identity)
    assert previous is not None and np.array_equal(previous, data.previous())
    assert np.array_equal(previous, previous_frames(clips_of(data.identity), data.identity["frame"]))
    frames = TrainingSet.of(data, SKELETON)
    assert has_clips(frames) and frames.follows.tolist() == (previous >= 0).tolist()
    confidence = frames.confidence.clone()
    confidence[[2, 10], 4] = 0  # one joint of each clip is hidden for a frame
    assert np.argwhere(gap_joints(replace(frames, confidence=confidence)).numpy()).tolist() == [[2, 4], [10, 4]]


def test_columns_may_be_lists_or_one_value_for_all_frames() -> None:
    data = PoseData(np.zeros((3, 2, 2)), np.ones((3, 2)), ("a", "b"))
    data.identity = {"sequence": ["x", "y", "y"], "camera": 7}  # as users give them, whose types nobody checks
    data.__post_init__()
    assert data.identity["sequence"].tolist() == ["x", "y", "y"] and data.identity["camera"].tolist() == [7, 7, 7]
    assert data.select([2]).identity["camera"].tolist() == [7]
