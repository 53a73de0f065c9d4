"""Who is who from frame to frame."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uplift.readers.tracks import link_bodies

BODY = np.array([[x, y] for x in (0, 10) for y in (0, 20, 40, 60)], np.float32)


def scene(frames: int, places: list[float], seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return keypoints, confidence, frame and who of bodies that walk side by side, in random order in each frame."""
    rng = np.random.default_rng(seed)
    rows = [(t, who) for t in range(frames) for who in rng.permutation(len(places))]
    keypoints = np.array([BODY + [places[who] + 3 * t, 0] + rng.normal(0, 1, (8, 2)) for t, who in rows])
    who = np.array([who for _, who in rows])
    return keypoints.astype(np.float32), np.ones(keypoints.shape[:2], np.float32), np.array([t for t, _ in rows]), who


def agree(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two numberings are the same but for the numbers."""
    pairs = set(zip(one.tolist(), other.tolist(), strict=True))
    return len(pairs) == len(set(one.tolist())) == len(set(other.tolist()))


@given(st.integers(0, 50))
def test_bodies_keep_their_number_whatever_their_order(seed: int):
    keypoints, sure, frame, who = scene(12, [0, 80, 170], seed)
    assert agree(link_bodies(keypoints, sure, frame), who)


def test_the_order_of_rows_does_not_matter():
    keypoints, sure, frame, who = scene(12, [0, 80])
    order = np.random.default_rng(1).permutation(len(frame))
    assert agree(link_bodies(keypoints[order], sure[order], frame[order]), who[order])


def test_a_body_that_is_gone_for_a_while_comes_back_and_after_long_is_another():
    keypoints, sure, frame, who = scene(40, [0, 200])
    short = (who == 1) & (frame > 5) & (frame < 12)
    assert agree(link_bodies(keypoints[~short], sure[~short], frame[~short]), who[~short])
    long = (who == 1) & (frame > 5) & (frame < 30)
    assert len(set(link_bodies(keypoints[~long], sure[~long], frame[~long])[who[~long] == 1])) == 2


def test_a_body_far_away_is_another():
    keypoints = np.stack([BODY, BODY + 500])
    assert link_bodies(keypoints, np.ones((2, 8)), np.array([0, 1])).tolist() == [0, 1]


def test_joints_that_are_missing_do_not_count():
    keypoints, sure, frame, who = scene(12, [0, 80, 170])
    gone = np.random.default_rng(2).random(sure.shape) < 0.15
    keypoints[gone], sure[gone] = 0, 0
    assert agree(link_bodies(keypoints, sure, frame), who)


def test_nothing_is_nobody():
    assert link_bodies(np.zeros((0, 4, 2)), np.zeros((0, 4)), np.zeros(0, int)).tolist() == []
