"""Who is who from frame to frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.formats import rows as tracks
from uplift.data.formats.rows import link_bodies

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


@given(st.integers(0, 10**6))
def test_what_is_obvious_is_what_an_assignment_finds(seed: int):
    keypoints, sure, frame = crowd(np.random.default_rng(seed))
    quick = link_bodies(keypoints, sure, frame)
    assigned = []
    with pytest.MonkeyPatch.context() as patch:
        nothing = np.zeros(len(np.unique(frame)), bool), np.zeros(len(frame), np.int64)
        patch.setattr(tracks._Bodies, "obvious", lambda *_: nothing)
        paired = tracks._Bodies.paired
        patch.setattr(tracks._Bodies, "paired", lambda *words: assigned.append(1) or paired(*words))
        assert link_bodies(keypoints, sure, frame).tolist() == quick.tolist()
    assert len(assigned) in (0, len(np.unique(frame)))  # none where each frame has one body


def crowd(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return keypoints, confidence and frame of bodies that cross, come and go."""
    bodies, joints, frames = rng.integers(1, 6), rng.integers(1, 9), rng.integers(2, 60)
    base, start = rng.uniform(0, 60, (joints, 2)), rng.uniform(0, 400, (bodies, 2))
    pace, gone, pause = (
        rng.normal(0, rng.choice([1, 5, 20]), (bodies, 2)),
        rng.choice([0, 0.02, 0.3]),
        rng.choice([1, 12]),
    )
    times = np.cumsum(rng.integers(1, pause + 1, frames))
    rows = [(t, who) for t in range(frames) for who in rng.permutation(bodies) if t == 0 or rng.random() > gone]
    keypoints = np.array([base + start[who] + pace[who] * t + rng.normal(0, 1, (joints, 2)) for t, who in rows])
    sure = (rng.random(keypoints.shape[:2]) > rng.choice([0, 0.1, 0.6])).astype(np.float32)
    order = rng.permutation(len(rows))
    return keypoints[order].astype(np.float32), sure[order], times[[t for t, _ in rows]][order]


def test_most_frames_need_no_assignment(monkeypatch):
    assigned = []
    paired = tracks._Bodies.paired
    monkeypatch.setattr(tracks._Bodies, "paired", lambda *words: assigned.append(1) or paired(*words))
    keypoints, sure, frame, who = scene(200, [0, 80, 170])
    lost = (who == 1) & (frame == 50)
    assert agree(link_bodies(keypoints[~lost], sure[~lost], frame[~lost]), who[~lost])
    assert len(assigned) == 3  # the first, that without the lost one, that in which it is back
