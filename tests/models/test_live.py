"""Lifting as frames come: the filter against its formula, and live poses beside those of frames alone."""

import numpy as np
import pytest

from tests.helpers.lifts import small_lifter
from uplift.config.settings import LifterSettings
from uplift.data.synthetic.simulate import simulate
from uplift.models.live import LiveLifter, OneEuro
from uplift.models.model import Model
from uplift.skeleton import load_skeleton

H36M = load_skeleton("h36m17")


def test_the_filter_is_that_of_the_paper():
    """Casiez et al. 2012, the algorithm of its appendix, number by number."""
    values = np.cumsum(np.random.default_rng(0).normal(size=50)) / 10
    smooth, rate, before, speed = OneEuro(1.0, 0.5, 2.0), 30.0, None, 0.0
    for value in values:
        found = smooth(np.array([value]), 1 / rate)
        if before is None:
            before = value
        else:
            alpha = 1 / (1 + rate / (2 * np.pi * 2.0))
            speed = alpha * (value - before) * rate + (1 - alpha) * speed
            alpha = 1 / (1 + rate / (2 * np.pi * (1.0 + 0.5 * abs(speed))))
            before = alpha * value + (1 - alpha) * before
        assert found[0] == pytest.approx(before, abs=1e-12)


def test_the_filter_keeps_what_is_constant_and_does_not_overtake():
    smooth = OneEuro()
    assert all(smooth(np.full(3, 2.0), 0.05) == pytest.approx(2.0) for _ in range(5))
    found = [smooth(np.full(3, 3.0), 0.05)[0] for _ in range(60)]
    assert np.all(np.diff(found) >= 0) and 2 < found[0] < 3 and found[-1] == pytest.approx(3.0, abs=1e-2)
    assert np.isfinite(smooth(np.full(3, np.nan), 0.05)).all()


def test_live_poses_are_those_of_frames_alone_smoothed():
    model, data = Model(small_lifter(), H36M, LifterSettings()), simulate(H36M, 4, seed=0)
    live = LiveLifter(model, model.skeleton.joints, data.image_size, data.focal_px)
    joints = len(model.skeleton.joints)
    points, sure = data.keypoints[:1], data.confidence[:1]
    for step in range(20):  # standing still, it comes to the pose of the frame alone
        (one,) = live.lift(points, sure, np.array([7]), step / 20)
    alone = model.predict(data.select(slice(0, 1)), refine=False)
    level = alone.level_pose[0]
    level = level / np.linalg.norm(level[:, :2] - level[:, :2].mean(0), axis=-1).mean()
    np.testing.assert_allclose(one.pose, level, atol=0.02)
    assert one.number == 7 and one.pose.shape == (joints, 3)
    two = live.lift(np.repeat(points, 2, 0) + [[[0, 0]], [[50, 0]]], np.repeat(sure, 2, 0), np.array([7, 8]), 1.0)
    assert [person.number for person in two] == [7, 8]
    assert live.lift(points[:0], sure[:0], np.zeros(0, int), 1.1) == []
    assert live.lift(points, np.zeros_like(sure), np.array([7]), 1.2) == []
