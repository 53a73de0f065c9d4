"""Causal lifting: a frame's pose does not depend on what comes more than the lag after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.lifts import small_lifter
from uplift.config.settings import LifterSettings
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.models.model import Model
from uplift.models.predict import causal_windows
from uplift.skeleton import load_skeleton

H36M = load_skeleton("h36m17")


@pytest.fixture(scope="module")
def data():
    return simulate(H36M, frames=120, seed=1, clip_seconds=6.0)


def test_every_frame_is_taken_once_from_a_clip_that_ends_within_the_lag(data) -> None:
    windows, rows = causal_windows(data)
    np.testing.assert_array_equal(windows.keypoints[rows], data.keypoints)
    for row in range(len(data)):
        clip = windows.identity["sequence"] == windows.identity["sequence"][rows[row]]
        frames = windows.identity["frame"][clip]
        assert frames.max() <= data.identity["frame"][row] + 5  # half a second at 10 frames/s
    assert len(np.unique(rows)) == len(data)


def test_what_comes_after_the_lag_changes_nothing(data) -> None:
    settings = LifterSettings(signs=8)
    model = Model(small_lifter(signs=8), H36M, settings)
    cut = 40
    shaken = data.keypoints.copy()
    shaken[cut:60] += np.random.default_rng(0).normal(0, 30, shaken[cut:60].shape).astype(np.float32)
    first = model.predict(data, refine="causal")
    second = model.predict(replace(data, keypoints=shaken), refine="causal")
    change = np.linalg.norm(first.pose - second.pose, axis=-1).mean(1)
    assert change[: cut - 5].mean() < 0.01 * change[cut:60].mean()  # the mean body of all clips changes a little
    assert change[60:].mean() < 0.01 * change[cut:60].mean()
    assert list(first.identity["sequence"]) == list(data.identity["sequence"])
    with pytest.raises(UserError, match="ground"):
        model.predict(data, refine="causal", ground=True)
