"""Long inputs part by part: every row once, the poses of a single call, no seam where a clip is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifts import H36M, small_lifter

from uplift.config.settings import LifterSettings
from uplift.data.pieces import pieces_of
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.models.model import Model
from uplift.models.parts import can_be_lifted, pieces

FPS = 10.0


def clips(lengths: list[int], turns: int = 1) -> PoseData:
    """Return clips of random keypoints; ``turns`` bodies take turns row by row. Keypoints hold the number of the row."""
    frame = np.concatenate([np.repeat(np.arange(length), turns) for length in lengths])
    rows = len(frame)
    keypoints = np.random.default_rng(rows).uniform(0, 1000, (rows, 17, 2)).astype(np.float32)
    keypoints[:, 0, 0] = np.arange(rows)
    identity = {
        "sequence": np.repeat([f"clip {number}" for number in range(len(lengths))], np.multiply(lengths, turns)),
        "instance": np.tile(np.arange(turns).astype(str), rows // turns),
        "frame": frame,
    }
    return PoseData(keypoints, np.ones((rows, 17), np.float32), H36M.joints, identity=identity, fps=FPS)


@given(st.lists(st.integers(1, 400), min_size=1, max_size=8), st.integers(1, 3), st.integers(30, 300), st.booleans())
def test_every_row_is_lifted_once_in_order(lengths: list[int], turns: int, frames: int, cut: bool):
    data = clips(lengths, turns)
    found = list(pieces(pieces_of(data, frames), frames, cut=cut))
    rows = np.concatenate([piece.data.keypoints[piece.kept, 0, 0] for piece in found])
    np.testing.assert_array_equal(rows, np.arange(len(data)))
    assert [piece.frames for piece in found] == [len(piece.data.keypoints[piece.kept]) for piece in found]
    if cut:  # none is much larger than was asked for, what is lifted beside a cut apart
        assert max(piece.frames for piece in found) <= 1.25 * frames + turns
    for piece in found:
        whole = len(piece.data) == piece.frames
        names = set(piece.data.clips().tolist())
        assert whole or len(names) <= turns, "only a clip that is too long, or those that take turns with it, are cut"


def test_a_clip_is_cut_with_the_frames_on_both_sides():
    data = clips([1000])
    first, middle, last = list(pieces([data], 400))
    assert (first.kept.start, last.kept.stop) == (0, len(last.data))
    assert len(middle.data) == middle.frames + 240, "120 frames before, and 120 behind"


def test_a_clip_out_of_order_and_clips_that_may_not_be_cut_stay_whole():
    data = clips([1000])
    shuffled = data.select(np.random.default_rng(0).permutation(1000))
    assert len(list(pieces([shuffled], 400))) == len(list(pieces([data], 400, cut=False))) == 1


def model_of(**settings) -> Model:
    lifter = small_lifter(**settings).eval()
    return Model(lifter, H36M, LifterSettings(**settings))


@pytest.fixture(scope="module")
def film() -> PoseData:
    """Simulated people in many clips, seen exactly."""
    return simulate(H36M, 1500, seed=3, clip_seconds=10.0).without_truth()


def joined(model: Model, data: PoseData, frames: int, **how) -> np.ndarray:
    parts = list(model.predict_parts(pieces_of(data, frames), frames=frames, **how))
    assert len(parts) > 1
    return np.concatenate([part.pose for part in parts])


def test_frames_that_are_lifted_by_themselves_are_those_of_a_single_call(film: PoseData):
    model = model_of()
    whole = model.predict(film, refine=False)
    size = np.linalg.norm(whole.pose, axis=-1).mean()
    np.testing.assert_allclose(joined(model, film, 400, refine=False), whole.pose, atol=1e-5 * size)


def test_whole_clips_are_nearly_those_of_a_single_call(film: PoseData):
    """Each is refined by itself, but for the mean body of all clips, to which it is weakly drawn."""
    model = model_of()
    whole = model.predict(film)
    off = np.linalg.norm(joined(model, film, 400) - whole.pose, axis=-1)
    size = np.linalg.norm(whole.pose, axis=-1).mean()
    assert off.mean() < 0.01 * size


def test_no_seam_shows_where_a_clip_is_cut():
    model = model_of()
    film = simulate(H36M, 1200, seed=5, clip_seconds=120.0).without_truth()
    assert film.clips().max() == 0
    whole, cut = model.predict(film).pose, joined(model, film, 400)
    size = np.linalg.norm(whole, axis=-1).mean()
    seams = np.array([400, 800])
    assert len(whole) == 1200
    step, jump = (np.linalg.norm(pose[seams] - pose[seams - 1], axis=-1).mean(1) for pose in (whole, cut))
    near = np.linalg.norm(cut - whole, axis=-1)[(seams[:, None] + np.arange(-5, 5)).ravel()]
    assert (np.abs(jump - step) < 0.01 * size).all() and near.mean() < 0.01 * size


def test_parts_that_nobody_is_in_are_nan_as_in_a_single_call(film: PoseData):
    model = model_of()
    confidence = film.confidence.copy()
    confidence[:200] = confidence[700:1300] = 0
    empty = replace(film, confidence=confidence)
    assert not can_be_lifted(empty.select(slice(0, 200)), H36M)
    whole = model.predict(empty, refine=False).pose
    np.testing.assert_array_equal(np.isnan(joined(model, empty, 200, refine=False)), np.isnan(whole))
    with pytest.raises(UserError, match="no keypoint"):
        model.predict(empty.select(slice(700, 1300)))
