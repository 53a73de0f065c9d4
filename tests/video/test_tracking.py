"""Who is who from frame to frame: simulated walkers whose names are known."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.video.tracking import Tracker, chosen_tracks, sizes_of, swapped_sides

FPS = 30.0
BODY = np.random.default_rng(0).uniform(-50, 50, (8, 2)) * [0.5, 2]
SURE = np.ones(len(BODY), np.float32)


def walkers(seed: int, people: int, frames: int) -> np.ndarray:
    """Return (frames people joints 2) bodies on straight ways that cross, at walking speed for their size, a lane apart."""
    draw = np.random.default_rng(seed)
    speed = draw.uniform(2, 5, people) * draw.choice([-1, 1], people)
    start = 600 - speed * frames / 2 + draw.uniform(-100, 100, people)  # all pass the middle
    x = start + speed * np.arange(frames)[:, None]
    y = np.broadcast_to(300 + 70.0 * np.arange(people), x.shape)
    sway = draw.normal(0, 1.5, (frames, people, len(BODY), 2))
    return np.stack([x, y], -1)[:, :, None] + BODY * np.linspace(1, 1.5, people)[:, None, None] + sway


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10_000), people=st.integers(1, 4), gone=st.floats(0, 0.3))
def test_people_who_cross_keep_their_numbers_in_any_order(seed, people, gone):
    true, draw, tracker = walkers(seed, people, 90), np.random.default_rng(seed), Tracker(FPS)
    numbers = np.full((90, people), -1)
    for frame, bodies in enumerate(true):
        order = draw.permutation(people)
        order = order[(draw.random(people) >= gone)[order] | (frame == 0)]  # some are not found
        confidence = np.tile(SURE, (len(order), 1))
        numbers[frame, order] = tracker.follow(bodies[order].astype(np.float32), confidence, frame)
    for person in range(people):
        assert set(numbers[:, person]) - {-1} == {numbers[0, person]}
    assert len(set(numbers[0])) == people


def test_someone_who_comes_back_within_a_second_is_the_same_and_later_someone_else():
    for gap, same in ((25, True), (35, False)):
        tracker = Tracker(FPS)
        first = tracker.follow(BODY[None] + 300, SURE[None], 0)
        assert (tracker.follow(BODY[None] + 303, SURE[None], gap) == first).all() == same


def test_a_body_of_another_size_or_place_is_someone_else():
    tracker = Tracker(FPS)
    first = tracker.follow(BODY[None] + 300, SURE[None], 0)
    assert tracker.follow(3 * BODY[None] + 300, SURE[None], 1) != first
    assert tracker.follow(BODY[None] + 600, SURE[None], 2) != first


def test_those_who_last_are_chosen_the_largest_and_longest_first():
    track = np.repeat([7, 3, 9, 4], [10, 60, 40, 60])
    size = np.repeat([500.0, 100.0, 200.0, 90.0], [10, 60, 40, 60])
    assert chosen_tracks(track, size, FPS, 60) == [9, 3, 4]  # 7 is there for a third of a second
    assert chosen_tracks(track, size, FPS, 60, people=1) == [9]
    assert chosen_tracks(track[:10], size[:10], FPS, 12) == [7]  # a video of less than a second


def test_the_size_of_a_body_is_that_of_what_is_seen():
    keypoints = np.array([[[0, 0], [30, 40], [900, 900], [np.nan, 5]]])
    assert sizes_of(keypoints, np.array([[1, 1, 0, 1.0]])) == [40]


# Left and right.

SIDED = ("nose", "left_hand", "right_hand", "left_foot", "right_foot", "left_hip", "right_hip")
MIRRORED = [0, 2, 1, 4, 3, 6, 5]
SIDED_BODY = np.array([[0, -60], [40, -20], [-40, -10], [25, 80], [-25, 75], [12, 10], [-12, 10]], float)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0, 0.45))
def test_sides_that_are_swapped_for_some_frames_are_found_and_no_others(seed, share):
    draw = np.random.default_rng(seed)
    frames = 80
    angle = np.linspace(0, draw.uniform(-1.1, 1.1), frames)  # turns about the vertical
    points = SIDED_BODY * np.stack([np.cos(angle), np.ones(frames)], -1)[:, None] + draw.normal(0, 0.8, (frames, 7, 2))
    points += 300 + 2 * np.arange(frames)[:, None, None]
    wrong = np.zeros(frames, bool)
    start = draw.integers(0, 40)
    wrong[start : start + int(share * frames)] = True
    given = np.where(wrong[:, None, None], points[:, MIRRORED], points)
    np.testing.assert_array_equal(swapped_sides(given, np.ones((frames, 7)), np.arange(frames), SIDED, FPS), wrong)


def test_after_a_gap_or_without_sides_nothing_is_swapped():
    points = np.repeat(SIDED_BODY[None] + 300, 40, 0)
    points[20:] = points[20:, MIRRORED]  # has turned round while nobody looked
    sure = np.ones((40, 7))
    frame = np.arange(40) + np.where(np.arange(40) < 20, 0, 15)
    assert not swapped_sides(points, sure, frame, SIDED, FPS).any()
    assert swapped_sides(points, sure, np.arange(40), SIDED, FPS).sum() == 20
    assert not swapped_sides(points, sure, np.arange(40), tuple("abcdefg"), FPS).any()
    assert not swapped_sides(points, sure, np.arange(40), SIDED, 3.0).any()  # a third of a second between frames
