"""Gait: of an exact walk, of simulated walkers whose cadence is known, of a body that stands, of contacts that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from walks import FEET, FPS, HIP, SKELETON, STRIDE, TILT, walk

from uplift.biomechanics.gait import Gait, _measure, _Walk, feet_of, gait_of
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import load_skeleton


def level_walk(frames: int = 150, heading_deg: float = 60.0) -> np.ndarray:
    """Return an exact walk in level axes, relative to the root: strides of 1.2 s and 1.4 m, feet down for 0.6 of them."""
    points = walk(frames, heading_deg).points
    level = Rotation.from_euler("x", -TILT).apply(points.reshape(-1, 3)).reshape(points.shape)
    return level - level[:, [HIP]]


def measured(gait: Gait, name: str) -> np.ndarray:
    values = np.array([stride.measures[name] for stride in gait.strides])
    return values[np.isfinite(values)]


@pytest.mark.parametrize("heading", [0, 60, 200])
def test_a_walk_has_its_cadence_length_and_speed(heading: float) -> None:
    gait = gait_of(level_walk(heading_deg=heading), np.arange(150) / FPS, SKELETON)
    assert not gait.why_not and {stride.foot for stride in gait.strides} == {"rankle", "lankle"}
    expected = {"stride_time_s": (1.2, 0.01), "step_time_s": (0.6, 0.01), "cadence_steps_per_min": (100, 1)}
    expected |= {"stride_length": (STRIDE, 30), "speed_per_s": (STRIDE / 1.2, 25), "step_length": (STRIDE / 2, 50)}
    for name, (value, most) in expected.items():
        assert np.abs(measured(gait, name) - value).max() < most, name
    # Where a foot is farthest ahead and behind comes a little before and after it stands: these feet move slowly there.
    assert np.all((measured(gait, "stance_percent") > 60) & (measured(gait, "stance_percent") < 68))
    assert np.allclose(measured(gait, "stance_percent") + measured(gait, "swing_percent"), 100)
    assert max(next(iter(gait.asymmetry.values())).values()) < 1


@pytest.mark.parametrize(("name", "gaits"), [("openpose25", ["walk", "run"]), ("quadruped28", ["walk", "trot"])])
def test_simulated_walkers_have_their_cadence(name: str, gaits: list[str]) -> None:
    skeleton = load_skeleton(name)
    data = simulate(skeleton, 1200, seed=1, clip_seconds=4.0, fps=50.0, mode=gaits)
    assert data.pose is not None and data.tilt_deg is not None
    level = np.einsum(
        "fij,fkj->fki",
        Rotation.from_rotvec(np.radians(data.tilt_deg)[:, None] * [-1.0, 0.0, 0.0]).as_matrix(),
        data.pose,
    )
    for clip in np.unique(data.clips()):
        pose = level[data.clips() == clip]
        found = gait_of(pose, np.arange(len(pose)) / 50, skeleton)
        # How far apart two feet of a pair are goes up and down twice a stride.
        one, other = (pose[:, skeleton.index(joint)] for joint in skeleton.contacts[:2])
        apart = np.linalg.norm(one - other, axis=-1)
        same = np.correlate(apart - apart.mean(), apart - apart.mean(), "full")[len(apart) - 1 :]
        peaks = 1 + np.flatnonzero((same[1:-1] > same[:-2]) & (same[1:-1] > same[2:]))
        assert np.median(measured(found, "stride_time_s")) == pytest.approx(
            peaks[1] / 50, rel=0.06
        )  # a short clip tells it less exactly than it is
        assert len({stride.foot for stride in found.strides}) == len(found.feet)
        assert 40 < np.median(measured(found, "stance_percent")) < 70


def test_contacts_that_are_known_are_the_events() -> None:
    walked = walk(150)
    contact = np.zeros(walked.points.shape[:2], bool)
    contact[:, FEET] = walked.stands
    gait = gait_of(level_walk(), np.arange(150) / FPS, SKELETON, contact)
    assert np.abs(measured(gait, "stance_percent") - 60).max() < 4
    assert np.abs(measured(gait, "double_support_percent") - 20).max() < 7


def test_a_body_that_stands_or_sways_does_not_walk() -> None:
    still = np.repeat(level_walk(1), 60, 0)
    assert "no walking" in gait_of(still, np.arange(60) / FPS, SKELETON).why_not
    sway = still + 20 * np.sin(np.arange(60) / 5)[:, None, None] * np.random.default_rng(0).normal(size=still.shape[1:])
    assert "no walking" in gait_of(sway, np.arange(60) / FPS, SKELETON).why_not
    assert "fewer than" in gait_of(still[:5], np.arange(5) / FPS, SKELETON).why_not


def test_frames_and_joints_that_are_missing_do_not_stop_it() -> None:
    pose = level_walk()
    pose[[20, 21, 70]] = np.nan
    pose[:, SKELETON.index("nose")] = np.nan
    time = np.arange(150) / FPS
    found = gait_of(pose, time, SKELETON)
    assert np.abs(measured(found, "stride_time_s") - 1.2).max() < 0.05
    time[75:] += 60  # it left the picture for a minute
    apart = gait_of(pose, time, SKELETON)
    assert np.abs(measured(apart, "stride_time_s") - 1.2).max() < 0.05 and len(apart.strides) >= 4
    assert sorted(one.number for one in apart.strides if one.foot == "rankle") == list(
        range(1, 1 + sum(one.foot == "rankle" for one in apart.strides))
    )


def test_feet_are_the_limbs_that_stand() -> None:
    feet = feet_of(load_skeleton("openpose25"))
    assert [foot.name for foot in feet] == ["RAnkle", "LAnkle"] and [len(foot.contacts) for foot in feet] == [3, 3]
    animal = feet_of(load_skeleton("quadruped28"))
    assert [(foot.name, animal[foot.partner].name) for foot in animal[:2]] == [
        ("L_front_toe", "R_front_toe"),
        ("R_front_toe", "L_front_toe"),
    ]
    with pytest.raises(UserError, match="'hand21' has none: gravity is false"):
        feet_of(load_skeleton("hand21"))


def test_feet_that_strike_as_one_take_no_step() -> None:
    time = np.arange(0, 3, 0.01)
    still = np.zeros((2, len(time)))
    walk = _Walk(time, still, still, still, np.ones(2))
    for lag, step in ((0.01, None), (0.5, 0.5), (0.99, None)):
        events = [(np.array([1.0, 2.0]), np.array([1.6])), (np.array([2.0 - lag]), np.array([1.3]))]
        found = _measure(walk, still, 0, 1, events, (1.0, 1.6, 2.0))
        for name in ("step_time_s", "cadence_steps_per_min", "step_length"):
            assert np.isnan(found[name]) == (step is None), (lag, name)
