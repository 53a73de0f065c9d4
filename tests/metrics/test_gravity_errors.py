"""Errors of tilt and roll, by frame and by clip, and errors by the trunk's angle: worked out from how a scene was made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.data.poses import PoseData
from uplift.metrics.evaluate import evaluate
from uplift.metrics.gravity_errors import trunk_angle
from uplift.metrics.scores import GivenPoses
from uplift.skeleton import load_skeleton

HUMAN = load_skeleton("h36m17")
CLIPS, FRAMES = 6, 40


def camera(tilt_deg: float, roll_deg: float, azimuth_deg: float = 0.0) -> np.ndarray:
    """Return the rotation from a world with y down to a camera: turned about y, tilted down, then rolled."""
    a, t, r = np.radians([azimuth_deg, tilt_deg, roll_deg])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(t), -np.sin(t)], [0, np.sin(t), np.cos(t)]])
    about_z = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def leaning(angle_deg: float) -> np.ndarray:
    """Return a body whose thorax is straight above its hip (y down), turned by an angle about a level axis."""
    body = np.random.default_rng(5).normal(size=(17, 3)) * 300
    body -= body[0]
    body[HUMAN.index("thorax")] = (0, -500, 0)
    return body @ camera(angle_deg, 0).T


@settings(max_examples=40, deadline=None)
@given(lean=st.floats(0, 180), tilt=st.floats(-80, 80), roll=st.floats(-80, 80), azimuth=st.floats(0, 360))
def test_the_trunks_angle_is_that_in_the_world_whatever_the_camera(lean, tilt, roll, azimuth) -> None:
    turn = camera(tilt, roll, azimuth)
    pose, gravity = leaning(lean) @ turn.T, turn @ [0, 1.0, 0]
    assert trunk_angle(pose[None], gravity[None], HUMAN.upright)[0] == pytest.approx(lean, abs=1e-4)


def a_scene(rng: np.random.Generator) -> tuple[PoseData, np.ndarray, np.ndarray]:
    """Return clips of bodies that lean, each seen by one camera, with the tilt and roll of every clip."""
    tilt, roll = rng.uniform(-20, 50, CLIPS), rng.uniform(-25, 25, CLIPS)
    turns = np.stack([camera(*angles) for angles in zip(tilt, roll, strict=True)])
    clip = np.repeat(np.arange(CLIPS), FRAMES)
    pose = np.stack([leaning(angle) for angle in np.tile(LEANS, len(clip) // len(LEANS))])
    pose = np.einsum("fij,fkj->fki", turns[clip], pose)
    data = PoseData(
        keypoints=pose[..., :2].astype(np.float32),
        confidence=np.ones((len(clip), 17), np.float32),
        joint_names=HUMAN.joints,
        pose=pose.astype(np.float32),
        identity={"sequence": clip, "frame": np.tile(np.arange(FRAMES), CLIPS)},
        tilt_deg=tilt[clip].astype(np.float32),
        gravity=turns[clip][..., 1].astype(np.float32),
    )
    return data, tilt, roll


LEANS = (0, 10, 20, 45, 75, 85, 120, 170)


def test_frames_scatter_and_clips_average_it_out() -> None:
    rng = np.random.default_rng(0)
    truth, tilt, roll = a_scene(rng)
    off = 4.0  # every camera is said to be tilted 4 degrees more and rolled 4 less than it is, and frames scatter
    clip = truth.identity["sequence"]
    scatter = rng.uniform(-20, 20, (2, CLIPS, FRAMES // 2))
    scatter = np.concatenate([scatter, -scatter], 2).reshape(2, -1)
    said = np.stack([camera(t, r)[:, 1] for t, r in zip(tilt[clip] + off, roll[clip] - off, strict=True)])
    scattered = [
        camera(t + e, r + f)[:, 1] for t, r, e, f in zip(tilt[clip] + off, roll[clip] - off, *scatter, strict=True)
    ]
    steady, noisy = (
        evaluate(
            GivenPoses(truth.pose, HUMAN.joints, "mm", np.degrees(np.arcsin(one[:, 2])), gravity=one), truth, HUMAN
        ).overall
        for one in (said, np.stack(scattered))
    )
    for name in ("elevation_deg", "roll_deg", "elevation_deg_clip", "roll_deg_clip"):
        assert steady[name] == pytest.approx(off, abs=1e-3)
    for name in ("elevation_deg", "roll_deg"):
        assert noisy[name] > 7
        assert abs(noisy[f"{name}_clip"] - off) < 1


def test_roll_needs_the_truths_and_is_the_smaller_turn() -> None:
    truth, *_ = a_scene(np.random.default_rng(1))
    tilted = GivenPoses(truth.pose, HUMAN.joints, "mm", truth.tilt_deg)
    assert "roll_deg" not in evaluate(tilted, truth, HUMAN).overall
    with_gravity = replace(tilted, gravity=truth.gravity)
    assert "roll_deg" not in evaluate(with_gravity, replace(truth, gravity=None), HUMAN).overall
    over = np.tile(camera(0, 179)[:, 1], (len(truth.pose), 1)), np.tile(camera(0, -179)[:, 1], (len(truth.pose), 1))
    turned = evaluate(replace(tilted, gravity=over[0]), replace(truth, gravity=over[1], tilt_deg=None), HUMAN)
    assert turned.overall["roll_deg"] == turned.overall["roll_deg_clip"] == pytest.approx(2)


def test_bins_hold_the_frames_that_lean_so_far_and_their_errors() -> None:
    truth, *_ = a_scene(np.random.default_rng(2))
    lean = np.tile(LEANS, len(truth.pose) // len(LEANS))
    noise = np.random.default_rng(3).normal(size=truth.pose.shape)
    pose = truth.pose + noise * np.where(lean > 60, 60, 5)[:, None, None]
    pose[lean > 90] *= (1, 1, -1)
    found = evaluate(GivenPoses(pose, HUMAN.joints), truth, HUMAN)
    bins = found.by_trunk_angle
    assert list(bins) == ["0-15", "15-30", "30-60", "60-90", "90-180"]
    assert [of["frames"] for of in bins.values()] == [60, 30, 30, 60, 60]
    assert sum(of["share"] for of in bins.values()) == pytest.approx(1)
    assert found.overall["p_mpjpe"] == pytest.approx(sum(of["share"] * of["p_mpjpe"] for of in bins.values()))
    assert bins["60-90"]["p_mpjpe"] > 3 * bins["0-15"]["p_mpjpe"]
    assert (bins["0-15"]["flipped"], bins["90-180"]["flipped"]) == (0, 1)
    assert bins["0-15"]["wrong_signs"] < 0.02 and bins["90-180"]["wrong_signs"] > 0.8
    assert "trunk's angle" in found.table() and {"by_trunk_angle", "signs"} <= set(found.to_dict())


@pytest.mark.parametrize(
    ("skeleton", "changes", "note"),
    [
        (HUMAN, {"tilt_deg": None, "gravity": None}, "no by_trunk_angle: the truth has no tilt_deg and no gravity"),
        (replace(HUMAN, trunk=()), {}, "no by_trunk_angle: skeleton 'h36m17' gives no trunk, and no up in facing"),
        (replace(HUMAN, gravity=False), {}, ""),
    ],
)
def test_what_cannot_be_told_is_absent_and_a_note_says_why(skeleton, changes: dict, note: str) -> None:
    truth = replace(a_scene(np.random.default_rng(4))[0], **changes)
    found = evaluate(GivenPoses(truth.pose, HUMAN.joints), truth, skeleton)
    assert "by_trunk_angle" not in found.to_dict()
    assert [one for one in found.notes if "trunk" in one] == ([note] if note else [])


def test_people_are_mostly_upright_and_animals_too(benchmark_data) -> None:
    for name, body, upright in (("cmu", "h36m17", 0.6), ("quadruped", "quadruped28", 0.9), ("rat", "rat23", 0.3)):
        with np.load(benchmark_data(f"{name}/test.npz")) as file:
            if "tilt_deg" not in file.files:
                continue
            skeleton, tilt = load_skeleton(body), np.radians(file["tilt_deg"][::5].astype(float))
            order = [file["joint_names"].tolist().index(joint) for joint in skeleton.joints]
            pose = file["pose"][::5, order].astype(float)
        angle = trunk_angle(pose, np.stack([0 * tilt, np.cos(tilt), np.sin(tilt)], -1), skeleton.upright)
        assert (angle < 30).mean() > upright, name
