"""BVH: what is read back is the pose, by the reader of motion capture and by a small forward kinematics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from writers_samples import chain, figure, prediction

from uplift.data.parsers.mocap import open_bvh
from uplift.errors import UserError
from uplift.export.bvh import euler_zxy, turn_onto, write_bvh
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton, load_skeleton


def made(skeleton: Skeleton, pose: np.ndarray, **more) -> Prediction:
    """Return a prediction of a pose with y up, in mm, at 25 frames a second."""
    frames, joints = pose.shape[:2]
    values = {"fps": 25.0, "axes": "opensim", **more}
    flat = np.zeros((frames, joints, 2))
    return Prediction(pose, pose, "mm", flat, np.ones((frames, joints)), skeleton.joints, skeleton, **values)


def jointed(skeleton: Skeleton, frames: int, seed: int) -> np.ndarray:
    """Return a smooth motion of bones of constant length, each joint turning as a whole."""
    random = np.random.default_rng(seed)
    pose = np.zeros((frames, len(skeleton.joints), 3))
    time = np.arange(frames)[:, None] / 20
    frame = {}
    for joint, parent in skeleton.parents.items():
        size, speed, phase = random.uniform(0.1, 0.6, 3), random.uniform(0.5, 3, 3), random.uniform(0, 6, 3)
        turn = Rotation.from_rotvec(size * np.sin(time * speed + phase))
        frame[joint] = turn if parent is None else frame[parent] * turn
        if parent is not None:
            step = random.normal(size=3)
            step *= random.uniform(50, 400) / np.linalg.norm(step)
            pose[:, skeleton.index(joint)] = pose[:, skeleton.index(parent)] + frame[parent].apply(step)
    return pose


def played(path: Path) -> tuple[dict[str, np.ndarray], float]:
    """Return where the joints of a BVH file are, and its frame time: another reading than the package's."""
    head, motion = path.read_text().split("MOTION\n")
    rows = motion.splitlines()
    values = np.array([[float(word) for word in row.split()] for row in rows[2:]])
    assert len(values) == int(rows[0].split()[1])
    places, frames, column, above = {}, {}, 0, []
    for words in map(str.split, head.splitlines()[1:]):
        if words[0] in ("ROOT", "JOINT"):
            above.append(words[1])
        elif words[0] == "End":
            above.append("")
        elif words[0] == "}":
            above.pop()
        elif words[0] == "OFFSET" and above[-1]:
            offset = np.array(words[1:], float)
        elif words[0] == "CHANNELS":
            name, start = above[-1], np.zeros(3)
            if len(above) == 1:
                start, column = values[:, :3], 3
            turn = Rotation.from_euler("ZXY", values[:, column : column + 3], degrees=True)
            column += 3
            up = above[-2] if len(above) > 1 else ""
            places[name] = places[up] + frames[up].apply(offset) if up else start + offset
            frames[name] = frames[up] * turn if up else turn
    assert column == values.shape[1]
    return places, float(rows[1].split()[2])


@pytest.mark.parametrize("skeleton", [figure(), chain(6), load_skeleton("h36m17"), load_skeleton("quadruped28")])
@pytest.mark.parametrize("seed", range(3))
def test_bones_of_constant_length_come_back_where_they_were(skeleton: Skeleton, seed: int, tmp_path: Path) -> None:
    pose = jointed(skeleton, 30, seed)
    root = np.cumsum(np.random.default_rng(seed).normal(size=(30, 3)) * 20, 0)
    sample = made(skeleton, pose, root=root)
    fit = write_bvh(sample, tmp_path / "a.bvh")
    bone = np.linalg.norm(np.diff(pose[:, skeleton.bone_indices], axis=2), axis=-1).min()
    places, time = played(tmp_path / "a.bvh")
    figures = open_bvh(tmp_path / "a.bvh").figure(0, 1)
    for joint, name in enumerate(skeleton.joints):
        assert np.abs(places[name] * 10 - sample.points[:, joint]).max() < 1e-3 * bone, name
        assert np.abs(figures.at(name) * 10 - sample.points[:, joint]).max() < 1e-3 * bone, name
    assert time == pytest.approx(1 / 25, abs=1e-7)
    assert fit.mean_error <= fit.largest_error < 1e-3 * bone


def test_bones_that_change_keep_their_directions_and_the_error_is_told(tmp_path: Path) -> None:
    sample = prediction(frames=40)
    fit = write_bvh(sample, tmp_path / "a.bvh")
    places, _ = played(tmp_path / "a.bvh")
    gaps = []
    for parent, child in sample.skeleton.bones:
        a, b = (sample.joint_names.index(name) for name in (parent, child))
        want = sample.pose[:, b] - sample.pose[:, a]
        got = places[child] - places[parent]
        cosine = (want * got).sum(1) / np.linalg.norm(want, axis=1) / np.linalg.norm(got, axis=1)
        assert cosine.min() > np.cos(2e-3)
        assert np.linalg.norm(got, axis=1) * 10 == pytest.approx(np.median(np.linalg.norm(want, axis=1)), rel=1e-4)
        gaps.append(np.linalg.norm(places[child] * 10 - sample.points[:, b], axis=1))
    assert fit.largest_error == pytest.approx(np.max(gaps), rel=1e-3)
    assert fit.added and all(name in places for name in fit.added)
    assert f"{fit.largest_error:.3g} mm" in str(fit)


def test_a_rest_pose_faces_the_viewer_with_y_up(tmp_path: Path) -> None:
    skeleton = load_skeleton("hand21")
    write_bvh(made(skeleton, jointed(skeleton, 5, 0)), tmp_path / "a.bvh")
    tree = open_bvh(tmp_path / "a.bvh").tree
    for joint, way in skeleton.body["rest"].items():
        offset = tree.offsets[tree.names.index(joint)]
        way = np.array(way, float) * [1, -1, -1]
        assert np.allclose(offset / np.linalg.norm(offset), way / np.linalg.norm(way), atol=1e-4), joint


def test_without_a_rest_pose_the_mean_shape_faces_the_viewer(tmp_path: Path) -> None:
    skeleton = load_skeleton("h36m17")
    assert "rest" not in skeleton.body
    still = np.zeros((1, 17, 3))
    up = {"spine": 250, "thorax": 500, "nose": 600, "headtop": 700, "rknee": -430, "lknee": -430}
    up |= {"rankle": -850, "lankle": -850, "lshoulder": 480, "rshoulder": 480, "lelbow": 200, "relbow": 200}
    for name, height in (up | {"lwrist": 0, "rwrist": 0}).items():
        still[0, skeleton.index(name), 1] = height
    for name in skeleton.joints:
        side = {"l": 1, "r": -1}.get(name[0], 0)
        still[0, skeleton.index(name), 0] = side * 130
    still[0, [skeleton.index("rknee"), skeleton.index("lknee"), skeleton.index("nose")], 2] = 60  # its front
    turn = Rotation.from_euler("y", np.linspace(40, 300, 20)[:, None], degrees=True)
    pose = np.stack([one.apply(still[0]) for one in turn])
    write_bvh(made(skeleton, pose), tmp_path / "a.bvh")
    tree = open_bvh(tmp_path / "a.bvh").tree
    rest = {skeleton.root: np.zeros(3)}
    for joint, parent in skeleton.parents.items():
        if parent:
            rest[joint] = rest[parent] + tree.offsets[tree.names.index(joint)] * 10
    for joint, name in enumerate(skeleton.joints):
        assert np.abs(rest[name] - still[0, joint]).max() < 1, name


def test_what_is_missing_holds_its_last_turn(tmp_path: Path) -> None:
    sample = prediction(frames=12)
    whole, holed = sample.pose.copy(), sample.pose.copy()
    head, hand = sample.joint_names.index("head"), sample.joint_names.index("rhand")
    holed[5:8, head] = np.nan
    holed[:3, hand] = np.nan
    holed[10] = np.nan
    sample.pose = holed
    write_bvh(sample, tmp_path / "a.bvh")
    places, _ = played(tmp_path / "a.bvh")
    assert all(np.isfinite(where).all() for where in places.values())
    step = (whole[:, head] - whole[:, sample.joint_names.index("neck")])[4]
    for joint in places:
        assert np.allclose(places[joint][10], places[joint][9], atol=1e-4), joint
    found = (places["head"] - places["neck"])[4]
    assert (found / np.linalg.norm(found)) @ (step / np.linalg.norm(step)) > 1 - 1e-6
    values = np.array(
        [line.split() for line in (tmp_path / "a.bvh").read_text().split("Frame Time")[1].splitlines()[1:]]
    )
    names = open_bvh(tmp_path / "a.bvh")
    turned = [name for name in names.tree.names if "head" in name]
    assert turned  # the neck has three children: the head turns on its own joint
    column = 3 + 3 * names.tree.names.index(turned[0])
    assert (values[5:8, column : column + 3] == values[4, column : column + 3]).mean() > 0.6


def test_gaps_between_frames_are_held(tmp_path: Path) -> None:
    sample = prediction(frames=6)
    sample.identity["frame"] = np.array([10, 12, 14, 20, 22, 24])
    write_bvh(sample, tmp_path / "a.bvh")
    places, _ = played(tmp_path / "a.bvh")
    rows = [0, 1, 2, 2, 2, 3, 4, 5]
    write_bvh(sample.select(np.array(rows)), tmp_path / "b.bvh", fps=30)
    assert len(places["head"]) == 8
    for row, moment in ((0, 0), (2, 2), (2, 4), (3, 5), (5, 7)):
        assert np.allclose(places["neck"][moment], played(tmp_path / "b.bvh")[0]["neck"][rows.index(row)], atol=2)
    sample.identity["frame"] = np.array([1, 2, 3, 5000, 5001, 5002])
    with pytest.raises(UserError, match="frames 1 to 5002 hold only 6 poses"):
        write_bvh(sample, tmp_path / "c.bvh")
    assert not (tmp_path / "c.bvh").exists()


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(0, 3))
def test_angles_are_continuous_and_the_same_rotation(seed: int, pitch: float) -> None:
    random = np.random.default_rng(seed)
    axis = random.normal(size=3)
    spin = Rotation.from_rotvec(np.linspace(0, 4 * np.pi, 300)[:, None] * axis / np.linalg.norm(axis))
    rotation = Rotation.from_euler("x", pitch) * spin
    angles = euler_zxy(rotation.as_matrix())
    again = Rotation.from_euler("ZXY", angles, degrees=True)
    assert (again.inv() * rotation).magnitude().max() < 1e-5
    level = np.abs(np.cos(np.radians(angles[:, 1]))) > 0.2
    change = np.abs(np.diff(angles, axis=0)).max(1)
    assert change[level[1:] & level[:-1]].max(initial=0) < 40


# Frame by frame, as the definitions say it: what the package does for all frames at once.


def angles_by_frame(rotation: np.ndarray) -> np.ndarray:
    """Return degrees about z, x, y of each rotation, the nearest to those before."""
    x = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    z = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    y = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    angles = np.stack([z, x, y], 1)
    locked = np.hypot(rotation[:, 0, 1], rotation[:, 1, 1]) < 1e-6
    sum_or_gap = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    for now in range(len(angles)):
        if locked[now]:
            angles[now, 0] = angles[now - 1, 0] if now else 0.0
            angles[now, 2] = np.sign(angles[now, 1]) * (sum_or_gap[now] - angles[now, 0])
        if now:
            z, x, y = angles[now]
            triples = np.array([[z, x, y], [z + np.pi, np.pi - x, y + np.pi]])
            triples += 2 * np.pi * np.round((angles[now - 1] - triples) / (2 * np.pi))
            angles[now] = triples[np.abs(triples - angles[now - 1]).sum(1).argmin()]
    return np.degrees(angles)


def turned_by_frame(rest: np.ndarray, directions: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return rotations onto directions by singular values, each frame that is not trusted after the one before it."""

    def nearest(matrix: np.ndarray) -> np.ndarray:
        u, _, v = np.linalg.svd(matrix)
        u[..., 2] *= np.sign(np.linalg.det(u @ v))[..., None]
        return u @ v

    known = np.isfinite(directions.sum(-1))
    wanted = np.einsum("fki,kj->fij", np.where(known[..., None], directions, 0), rest)
    trust = known.all(1).astype(float)
    if len(rest) == 1:
        unfolded = np.einsum("fi,fij,j->f", np.nan_to_num(directions[:, 0]), frame, rest[0])
        trust *= np.clip((1 + unfolded) / 0.5, 0, 1)
    turned = nearest(wanted + 1e-5 * frame)
    trusted = np.flatnonzero(trust == 1)
    before = frame[trusted[0]].T @ turned[trusted[0]] if len(trusted) else np.eye(3)
    for now in np.flatnonzero(trust < 1):
        before = frame[now - 1].T @ turned[now - 1] if now else before
        leave = frame[now] @ (trust[now] * np.eye(3) + (1 - trust[now]) * before)
        turned[now] = nearest(wanted[now] + 1e-5 * leave)
    return turned


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), locks=st.sampled_from([0, 0.1, 1]), speed=st.sampled_from([0.02, 0.3, 3]))
def test_angles_are_those_frame_by_frame(seed: int, locks: float, speed: float) -> None:
    random = np.random.default_rng(seed)
    angles = np.cumsum(random.normal(size=(200, 3)) * speed, 0)
    angles[random.random(200) < locks, 1] = random.choice([-np.pi / 2, np.pi / 2])
    rotation = Rotation.from_euler("ZXY", angles).as_matrix()
    np.testing.assert_allclose(euler_zxy(rotation), angles_by_frame(rotation), atol=1e-6)


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), children=st.integers(1, 3), missing=st.sampled_from([0, 0.05, 0.6, 1]))
def test_joints_turn_as_they_do_frame_by_frame(seed: int, children: int, missing: float) -> None:
    random = np.random.default_rng(seed)
    frame = Rotation.from_rotvec(np.cumsum(random.normal(size=(120, 3)) * 0.2, 0)).as_matrix()
    ways = random.normal(size=(children, 3)) + np.cumsum(random.normal(size=(120, children, 3)), 0) * 0.4
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    ways[random.random((120, children)) < missing] = np.nan
    rest = random.normal(size=(children, 3))
    rest /= np.linalg.norm(rest, axis=-1, keepdims=True)
    np.testing.assert_allclose(turn_onto(rest, ways, frame), turned_by_frame(rest, ways, frame), atol=1e-7)


def test_locked_angles_are_the_same_rotation() -> None:
    angles = np.stack([np.linspace(0, 300, 20), np.full(20, 90.0), np.linspace(0, 40, 20)], 1)
    rotation = Rotation.from_euler("ZXY", np.concatenate([angles, angles * [1, -1, 1]]), degrees=True)
    again = Rotation.from_euler("ZXY", euler_zxy(rotation.as_matrix()), degrees=True)
    assert (again.inv() * rotation).magnitude().max() < 1e-6


def test_a_bone_that_folds_back_turns_without_a_jump() -> None:
    """Round the whole sphere of a bone, past the direction opposite to rest."""
    angle = np.linspace(0, 2 * np.pi, 400)
    way = np.stack([np.sin(angle), np.cos(angle), 0.02 * np.sin(5 * angle)], 1)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    turned = turn_onto(np.array([[0.0, 1.0, 0.0]]), way[:, None], np.tile(np.eye(3), (400, 1, 1)))
    assert np.abs(turned[:, :, 1] - way).max() < 1e-4
    jump = Rotation.from_matrix(np.einsum("fji,fjk->fik", turned[:-1], turned[1:])).magnitude()
    assert jump.max() < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": None}, "frames a second.*Add fps=30"),
        ({"identity": {"camera": np.repeat([0, 1], 4)}}, "one clip, found 2: 0, 1"),
        ({"identity": {"instance": np.repeat(["a", "b"], 4), "frame": np.tile(np.arange(4), 2)}}, "one individual"),
    ],
)
def test_what_a_file_cannot_hold_is_one_message(tmp_path: Path, change: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        write_bvh(prediction(frames=8, **change), tmp_path / "a.bvh")
    assert not list(tmp_path.iterdir())


def test_empty_rates_and_joints_that_are_nowhere(tmp_path: Path) -> None:
    sample = prediction(frames=3)
    with pytest.raises(UserError, match="empty"):
        write_bvh(sample.select(np.zeros(3, bool)), tmp_path / "a.bvh")
    with pytest.raises(UserError, match="fps=-1"):
        write_bvh(sample, tmp_path / "a.bvh", fps=-1)
    sample.pose[:, sample.joint_names.index("head")] = np.nan
    with pytest.raises(UserError, match="bone from 'neck' to 'head' is in no frame"):
        write_bvh(sample, tmp_path / "a.bvh")


def test_joints_are_matched_by_name_and_names_have_no_spaces(tmp_path: Path) -> None:
    skeleton = Skeleton("arm", ("a b", "c", "a_b"), "a b", (("a b", "c"), ("c", "a_b")), gravity=False)
    sample = made(skeleton, jointed(skeleton, 4, 1))
    order = [2, 0, 1]
    turned = Prediction(
        **{**vars(sample), "joint_names": tuple(skeleton.joints[k] for k in order), "pose": sample.pose[:, order]}
    )
    write_bvh(turned, tmp_path / "a.bvh")
    places, _ = played(tmp_path / "a.bvh")
    assert list(places) == ["a_b", "c", "a_b_2"]
    assert np.allclose(places["a_b_2"] * 10, sample.pose[:, 2], atol=0.1)


def test_loops_are_written_as_their_tree(tmp_path: Path) -> None:
    skeleton = load_skeleton("chair10")
    assert len(skeleton.bones) >= len(skeleton.joints)
    write_bvh(made(skeleton, jointed(skeleton, 4, 1)), tmp_path / "a.bvh")
    assert set(skeleton.joints) <= set(played(tmp_path / "a.bvh")[0])


def test_real_motion_comes_back(benchmark_data, tmp_path: Path) -> None:
    with np.load(benchmark_data("cmu/world.npz")) as file:
        joints = file["joints"][file["sequence"] == "09_03"].astype(float) * 1000
    skeleton = load_skeleton("h36m17")
    sample = made(skeleton, joints - joints[:, :1], root=joints[:, 0], fps=30.0)
    fit = write_bvh(sample, tmp_path / "a.bvh")
    assert fit.largest_error < 60 and fit.mean_error < 10
    file = open_bvh(tmp_path / "a.bvh")
    ankle = np.linalg.norm(file.figure(0, 1).at("rankle") * 10 - sample.points[:, skeleton.index("rankle")], axis=1)
    assert ankle.max() < 1  # limbs are rigid in these data
    values = np.array([file.row(frame) for frame in range(file.frames)])
    assert np.abs(np.diff(values[:, 3:], axis=0)).max() < 60
