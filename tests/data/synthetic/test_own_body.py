"""A user's own animal: what it must say, what it moves like, what a wrong file is told."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from uplift.data.synthetic.body import DEFAULT_LIMITS, find_legs, forward_kinematics, leg_phases
from uplift.data.synthetic.simulate import build_body, level_feet, simulate
from uplift.errors import UserError
from uplift.skeleton import Skeleton


def beetle(**changes) -> Skeleton:
    """Return a six-legged body that gives its left side only."""
    legs = ("front", "mid", "hind")
    pairs = [(f"{leg}_{part}_r", f"{leg}_{part}_l") for leg in legs for part in ("hip", "knee", "claw")]
    data = {
        "name": "beetle",
        "joints": ["thorax", "head", "tail", *[joint for pair in pairs for joint in pair]],
        "root": "thorax",
        "bones": [["thorax", "head"], ["thorax", "tail"]]
        + [["thorax", f"{leg}_hip_{side}"] for leg in legs for side in "lr"]
        + [[f"{leg}_hip_{side}", f"{leg}_knee_{side}"] for leg in legs for side in "lr"]
        + [[f"{leg}_knee_{side}", f"{leg}_claw_{side}"] for leg in legs for side in "lr"],
        "mirror": [list(pair) for pair in pairs],
        "proportions": {"head": 0.5, "tail": 1.0},
        "rest": {"head": [0, 0, -1], "tail": [0, 0, 1]},
    }
    for leg, z in zip(legs, (-1, 0, 1), strict=True):
        data["proportions"] |= {f"{leg}_hip_l": 0.4, f"{leg}_knee_l": 0.4, f"{leg}_claw_l": 0.6}
        data["rest"] |= {
            f"{leg}_hip_l": [0.5, 0.1, z], f"{leg}_knee_l": [1, -0.3, z / 2], f"{leg}_claw_l": [0.4, 1, 0]
        }  # fmt: skip
    return Skeleton.from_dict(copy.deepcopy(data | changes))


def test_a_body_without_limits_moves_within_the_defaults():
    skeleton = beetle()
    body = build_body(skeleton)
    knee = body.angle("mid_knee_l", "flexion")
    assert (body.low_deg[knee], body.high_deg[knee]) == DEFAULT_LIMITS["flexion"]
    data = simulate(skeleton, 300, seed=0)
    assert data.unit == "relative"
    assert np.std(data.pose, axis=0).max() > 10


def test_the_other_side_is_the_mirror_of_the_given_one():
    body = build_body(beetle())
    one, other = (body.offsets[body.points.index(f"mid_knee_{side}")] for side in "lr")
    np.testing.assert_allclose(one, other * [-1, 1, 1])


def test_mirrored_angles_give_the_mirrored_pose():
    body = build_body(beetle())
    rng = np.random.default_rng(0)
    angles = np.zeros((5, len(body.angles)))
    for place, name in enumerate(body.angles):
        if "_l " in name:
            partner = body.angles.index(name.replace("_l ", "_r "))
            angles[:, place] = angles[:, partner] = rng.uniform(-30, 30, 5)
    points = forward_kinematics(body, np.repeat(body.offsets[None], 5, 0), angles)
    swapped = [
        body.points.index(p[:-1] + {"l": "r", "r": "l"}[p[-1]] if p[-2:] in ("_l", "_r") else p) for p in body.points
    ]
    np.testing.assert_allclose(points, points[:, swapped] * [-1, 1, 1], atol=1e-9)


def test_flexion_swings_forward_and_abduction_out():
    body = build_body(beetle())
    rest = forward_kinematics(body, body.offsets[None], np.zeros((1, len(body.angles))))[0]
    for side, out in (("l", 1), ("r", -1)):
        claw = body.points.index(f"mid_claw_{side}")
        for name, axis, sign in (("flexion", 2, -1), ("abduction", 0, out)):
            angles = np.zeros((1, len(body.angles)))
            angles[0, body.angle(f"mid_knee_{side}", name)] = 20
            moved = forward_kinematics(body, body.offsets[None], angles)[0, claw] - rest[claw]
            assert moved[axis] * sign > 0.05


def test_six_legs_step_as_a_tripod():
    body = build_body(beetle())
    legs = find_legs(body)
    assert sorted(body.points[leg[-1]] for leg in legs) == sorted(
        f"{leg}_claw_{side}" for leg in ("front", "mid", "hind") for side in "lr"
    )
    phase = dict(zip([body.points[leg[-1]] for leg in legs], leg_phases(body, legs, "trot") % 1, strict=True))
    assert phase["front_claw_l"] == phase["mid_claw_r"] == phase["hind_claw_l"]
    assert phase["front_claw_r"] == phase["mid_claw_l"] == phase["hind_claw_r"] != phase["front_claw_l"]


def test_fore_and_hind_feet_are_levelled():
    body = build_body(beetle())
    tilted = forward_kinematics(body, body.offsets[None], np.zeros((1, len(body.angles))))[None]
    slope = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    level = level_feet(body, tilted @ slope.T)
    np.testing.assert_allclose(level[..., 1], tilted[..., 1], atol=0.02)


def test_a_follower_bends_with_its_leader():
    limits = {"mid_hip_l": {"flexion": [-40, 40]}, "mid_knee_l": {"flexion": [-80, 80], "follows": "mid_hip_l"}}
    data = simulate(beetle(limits=limits, gravity=False), 3000, seed=0)
    at = {name: data.pose[:, place].astype(float) for place, name in enumerate(data.joint_names)}
    back = at["tail"] / np.linalg.norm(at["tail"], axis=-1, keepdims=True)

    def swing(start: str, end: str) -> np.ndarray:
        return ((at[end] - at[start]) * back).sum(-1)

    assert np.corrcoef(swing("mid_hip_l", "mid_knee_l"), swing("mid_knee_l", "mid_claw_l"))[0, 1] > 0.6
    assert abs(np.corrcoef(swing("front_hip_l", "front_knee_l"), swing("mid_knee_l", "mid_claw_l"))[0, 1]) < 0.6


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"proportions": {}, "rest": {}}, "'proportions' lacks head, tail.*Add to its YAML 'proportions: {head: 0.2"),
        ({"rest": {"head": [0, 0, -1]}}, "'rest' lacks tail.*x the body's left, y down, z behind"),
        ({"limits": {"head": {"flexon": [0, 1]}}}, "unknown angle 'flexon'. Did you mean 'flexion'"),
        ({"limits": {"head": {"flexion": [5, 1]}}}, r"found flexion: \[5, 1\]; expected"),
        ({"limits": {"head": {"flexion": 5}}}, "limits of 'head': found flexion: 5"),
        ({"limits": {"head": [0, 1]}}, "limits of 'head'"),
        ({"limits": {"tail": {"flexion": [0, 9], "follows": "haed"}}}, "follows 'haed'.*Did you mean 'head'"),
        ({"limits": {"head": {"human": "nose"}}}, "found nothing for joint|found 'proportions' beside"),
    ],
)
def test_a_wrong_body_is_told_what_to_do(changes, words):
    with pytest.raises(UserError, match=words):
        simulate(beetle(**changes), 30)


def test_a_wrong_place_on_the_human_body():
    data = {"name": "two", "joints": ["a", "b", "c"], "root": "a", "bones": [["a", "b"], ["b", "c"]]}
    with pytest.raises(UserError, match=r"no point 'left_nee'.*Did you mean 'left_knee'"):
        build_body(
            Skeleton.from_dict(
                data | {"limits": {j: {"human": p} for j, p in zip("abc", ("pelvis", "nose", "left_nee"), strict=True)}}
            )
        )
    with pytest.raises(UserError, match="found nothing for joint 'b'"):
        build_body(Skeleton.from_dict(data | {"limits": {"a": {"human": "pelvis"}}}))
