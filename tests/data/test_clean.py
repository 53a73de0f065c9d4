"""Cleaning: what is missing counts as missing, the root is always there, unusable frames are counted out."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import body_arrays
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.data.clean import clean, joint_neighbours
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

BODY = load_skeleton("h36m17")
ROOT = BODY.root_index


def body(frames: int = 6, confidence: np.ndarray | None = None, **identity: np.ndarray) -> PoseData:
    keypoints = body_arrays(frames)["keypoints"]
    sure = np.ones(keypoints.shape[:2], np.float32) if confidence is None else confidence
    return PoseData(keypoints, sure, BODY.joints, identity=identity, source="a.npz")


def test_whole_frames_stay_as_they_are() -> None:
    data = body()
    cleaned, report = clean(data, BODY)
    np.testing.assert_array_equal(cleaned.keypoints, data.keypoints)
    np.testing.assert_array_equal(cleaned.confidence, data.confidence)
    assert not cleaned.root_filled.any()
    assert report.lines() == []


@pytest.mark.parametrize("absent", [np.nan, np.inf, -np.inf, 1e9])
def test_what_is_no_place_in_an_image_is_missing(absent: float) -> None:
    data = body()
    data.keypoints[2, 5, 1] = absent
    cleaned, report = clean(data, BODY)
    assert cleaned.confidence[2, 5] == 0
    assert (cleaned.keypoints[2, 5] == 0).all()
    assert cleaned.confidence.sum() == 6 * 17 - 1
    assert report.lines() == ["1 joints are missing (NaN or confidence 0)"]


def test_confidence_is_brought_to_0_1_and_nan_means_missing() -> None:
    data = body()
    data.confidence[0, 1:5] = [1.5, -1, np.nan, 0.3]
    cleaned, _ = clean(data, BODY)
    np.testing.assert_allclose(cleaned.confidence[0, 1:5], [1, 0, 0, 0.3])
    assert (cleaned.keypoints[0, 2:4] == 0).all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0, 1))
def test_every_frame_that_stays_can_be_lifted(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    data = body(8)
    hidden = rng.random((8, 17)) < share
    data.keypoints[hidden] = np.nan
    data.keypoints[0] = 7.0
    before = data.keypoints.copy()
    usable = ((~hidden).sum(1) >= 3) & (np.arange(8) > 0)
    if not usable.any():
        with pytest.raises(UserError):
            clean(data, BODY)
        return
    cleaned, report = clean(data, BODY)
    assert np.isfinite(cleaned.keypoints).all()
    assert np.isfinite(cleaned.confidence).all()
    missing = cleaned.confidence == 0
    missing[:, ROOT] = False  # where the root would be is known even where it is not seen
    assert (cleaned.keypoints[missing] == 0).all()
    np.testing.assert_array_equal(cleaned.confidence[:, ROOT] == 0, hidden[usable, ROOT])
    np.testing.assert_array_equal(cleaned.root_filled, hidden[usable, ROOT])
    assert (len(cleaned), report.frames) == (usable.sum(), 8)
    assert report.too_few + report.all_equal == 8 - usable.sum()
    assert report.roots_filled == hidden[usable, ROOT].sum()
    np.testing.assert_array_equal(data.keypoints, before)
    kept, _ = clean(data, BODY, drop=False)
    assert len(kept) == 8
    assert (kept.confidence[~usable] == 0).all()
    np.testing.assert_array_equal(kept.keypoints[usable], cleaned.keypoints)


def test_cleaning_twice_changes_nothing_but_the_flag() -> None:
    data = body()
    data.keypoints[1, ROOT] = np.nan
    once, _ = clean(data, BODY)
    twice, _ = clean(once, BODY)
    np.testing.assert_array_equal(twice.keypoints, once.keypoints)
    np.testing.assert_array_equal(twice.confidence, once.confidence)


def test_frames_that_cannot_be_lifted_are_dropped_with_a_count() -> None:
    data = body(6, sequence=np.array(list("abcdef")))
    data.confidence[0, 2:] = 0
    data.keypoints[3] = 250.0
    cleaned, report = clean(data, BODY)
    assert list(cleaned.identity["sequence"]) == list("bcef")
    assert report.lines() == [
        "1 of 6 frames dropped: fewer than 3 visible joints",
        "1 of 6 frames dropped: all visible joints in one point",
    ]


def test_a_missing_root_comes_from_its_nearest_visible_neighbours() -> None:
    data = body(3)
    near = list(joint_neighbours(BODY)[0])
    data.confidence[:, near] = 0.5
    data.confidence[1:, ROOT] = 0
    data.confidence[1, near[0]] = 0.2
    data.confidence[2, near] = 0
    cleaned, report = clean(data, BODY)
    np.testing.assert_array_equal(cleaned.root_filled, [False, True, True])
    assert report.roots_filled == 2
    np.testing.assert_allclose(cleaned.keypoints[1, ROOT], data.keypoints[1, near].mean(0), rtol=1e-6)
    assert (cleaned.confidence[1:, ROOT] == 0).all()
    further = list(joint_neighbours(BODY)[1])
    np.testing.assert_allclose(cleaned.keypoints[2, ROOT], data.keypoints[2, further].mean(0), rtol=1e-6)


def test_neighbours_reach_every_joint_once() -> None:
    rings = [joint for ring in joint_neighbours(BODY) for joint in ring]
    assert sorted([*rings, ROOT]) == list(range(17))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.keypoints.fill(np.nan), "no keypoint in 6 frames is visible"),
        (lambda d: d.confidence.fill(0), "no keypoint in 6 frames is visible"),
        (lambda d: d.confidence[:, 2:].fill(0), "none of 6 frames can be used: 6 have fewer than 3 visible joints"),
        (lambda d: d.keypoints.fill(3), "0 have fewer than 3 visible joints, 6 have all joints in one point"),
    ],
)
def test_a_file_with_nothing_left_is_an_error(change, says: str) -> None:
    data = body()
    change(data)
    with pytest.raises(UserError) as caught:
        clean(data, BODY)
    assert says in str(caught.value)
    assert str(caught.value).startswith("a.npz: ")


def test_no_frames_at_all() -> None:
    empty = PoseData(np.zeros((0, 17, 2), np.float32), np.zeros((0, 17), np.float32), BODY.joints)
    with pytest.raises(UserError, match="no frames"):
        clean(empty, BODY)
