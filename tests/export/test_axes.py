"""Output frames: rigid, never mirrored, gravity on the right axis, one rotation for a clip."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from writers_samples import prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.scene import AXES, in_axes, rotations_to
from uplift.models.prediction import Prediction

LEVEL = ("level", "blender", "opensim", "unity")
DOWN = {"camera": None, "opencv": None, "level": (0, 1, 0), "blender": (0, 0, -1), "opensim": (0, -1, 0), "unity": (0, -1, 0)}  # fmt: skip
AWAY = {"level": (0, 0, 1), "blender": (0, 1, 0), "opensim": (0, 0, -1), "unity": (0, 0, 1)}
HAND = dict.fromkeys(AXES, 1) | {"unity": -1}


def seen_with(gravity: np.ndarray, frames: int = 4, tilt: bool = False, **more) -> Prediction:
    """Return a prediction whose camera sees ``gravity`` (frames 3) or (3), with a walking root."""
    gravity = np.broadcast_to(gravity / np.linalg.norm(gravity, axis=-1, keepdims=True), (frames, 3))
    sample = prediction(frames, tilt=False)
    level = sample.level_pose
    back = np.stack([_least(one) for one in gravity])  # camera to level
    pose = np.einsum("fki,fjk->fji", back, level)
    root = np.random.default_rng(5).normal(size=(frames, 3)) * 500 + [0, 0, 4000]
    degrees = np.degrees(np.arctan2(gravity[:, 2], gravity[:, 1])) if tilt else None
    return replace(sample, pose=pose, root=root, tilt_deg=degrees, **more)


def _least(gravity: np.ndarray) -> np.ndarray:
    axis = np.cross(gravity, [0, 1, 0])
    size = np.linalg.norm(axis)
    angle = np.arctan2(size, gravity[1])
    return Rotation.from_rotvec(axis / size * angle if size > 0 else np.zeros(3)).as_matrix()


@pytest.mark.parametrize("name", AXES)
@given(
    gravity=st.tuples(*[st.floats(-1, 1)] * 3).filter(
        lambda g: np.linalg.norm(g) > 0.1 and g[1] > -0.9 * np.linalg.norm(g)
    ),
    frames=st.integers(1, 4),
)
def test_axes_keep_bodies_and_put_gravity_where_they_say(name: str, gravity: tuple, frames: int) -> None:
    sample = seen_with(np.array(gravity), frames)
    before = deepcopy(sample)
    turned = in_axes(sample, name)
    assert turned.axes == name and turned.unit == sample.unit
    distances = [np.linalg.norm(p.points[:, :, None] - p.points[:, None], axis=-1) for p in (sample, turned)]
    np.testing.assert_allclose(*distances, atol=1e-8)
    assert turned.root is not None and sample.root is not None
    np.testing.assert_allclose(np.linalg.norm(turned.root, axis=-1), np.linalg.norm(sample.root, axis=-1))
    rotation = rotations_to(sample, name)
    np.testing.assert_allclose(np.linalg.det(rotation), HAND[name])
    np.testing.assert_allclose(np.einsum("fki,fjk->fji", rotation, turned.points), sample.points, atol=1e-8)
    if DOWN[name] is not None:
        unit = np.array(gravity) / np.linalg.norm(gravity)
        np.testing.assert_allclose(rotation @ unit, [DOWN[name]] * frames, atol=1e-9)
    for key, value in vars(before).items():  # nothing happened in place, and the rest is handed on
        np.testing.assert_equal(getattr(sample, key), value)
        if key not in ("pose", "root", "axes"):
            np.testing.assert_equal(getattr(turned, key), value)


@pytest.mark.parametrize("name", LEVEL)
def test_what_is_away_stays_away_and_left_stays_left(name: str) -> None:
    sample = seen_with(np.array([0.0, 1.0, 0.0]))
    rotation = rotations_to(sample, name)
    np.testing.assert_allclose(rotation @ [0, 0, 1], [AWAY[name]] * 4, atol=1e-12)
    np.testing.assert_allclose(rotation @ [1, 0, 0], [[1, 0, 0]] * 4, atol=1e-12)
    points, names = in_axes(sample, name).pose, sample.joint_names
    up = points[:, names.index("neck")]
    left = points[:, names.index("lhand")] - points[:, names.index("rhand")]
    before = sample.pose[:, names.index("lhand")] - sample.pose[:, names.index("rhand")]
    facing = rotation @ [0, 0, -1]  # towards the camera
    signs = HAND[name] * np.sign((np.cross(up, facing) * left).sum(-1))  # the cross product turns with the hand
    np.testing.assert_array_equal(signs, np.sign((np.cross(sample.pose[:, 1], [0, 0, -1]) * before).sum(-1)))


def test_unity_shows_the_body_that_its_importer_makes_of_a_glb(tmp_path: Path) -> None:
    """UnityGLTF negates x of what a glTF holds: with the turn of an importer about y, these are our axes, and no mirror image."""
    sample = prediction(frames=3, tilt=False, rooted=True)
    unity = in_axes(sample, "unity").points
    write(sample, tmp_path / "a.glb")
    scene = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    nodes = {node.name: node.translation for node in scene.nodes if node.translation}
    imported = np.array([nodes[joint] for joint in sample.joint_names]) * 1000 * [-1, 1, 1]
    middle = imported.mean(0), unity[0].mean(0)
    turn, off = Rotation.align_vectors(unity[0] - middle[1], imported - middle[0])  # proper rotations alone
    assert off < 1 and turn.magnitude() == pytest.approx(np.pi) and abs(turn.as_rotvec()[1]) == pytest.approx(np.pi)
    assert Rotation.align_vectors((unity[0] - middle[1]) * [-1, 1, 1], imported - middle[0])[1] > 50
    # Seen by Unity's camera, which looks along +z with y up, joints are where the image has them.
    level = sample.level_pose[0]
    np.testing.assert_allclose(
        in_axes(sample, "unity").pose[0], np.stack([level[:, 0], -level[:, 1], level[:, 2]], 1), atol=1e-9
    )


@pytest.mark.parametrize("ending", [".glb", ".bvh"])
def test_right_handed_formats_refuse_unity(tmp_path: Path, ending: str) -> None:
    with pytest.raises(UserError, match=f"a {ending} is right-handed wherever it is read.*Leave axes= out"):
        write(prediction(frames=3), tmp_path / f"a{ending}", axes="unity")
    for other in (".trc", ".csv", ".json", ".npz", ".gif"):
        write(prediction(frames=3), tmp_path / f"a{other}", axes="unity")


def test_a_single_frame_comes_out_as_its_level_pose() -> None:
    for gravity in ([0.1, 0.9, 0.3], [-0.5, 0.2, -0.6]):
        sample = seen_with(np.array(gravity), frames=1)
        np.testing.assert_allclose(in_axes(sample, "level").pose, sample.level_pose, atol=1e-8)


def test_frames_of_unrelated_images_are_levelled_one_by_one() -> None:
    sample = replace(prediction(frames=20), fps=None)
    np.testing.assert_allclose(in_axes(sample, "level").pose, sample.level_pose, atol=1e-8)


def test_a_clip_has_one_rotation_and_a_straight_walk_stays_straight() -> None:
    sample = prediction(frames=30, individuals=2)
    sample.root = np.linspace([0, 0, 3000], [1000, 50, 5000], 60)
    assert sample.tilt_deg is not None and np.ptp(sample.tilt_deg) > 3
    rotation = rotations_to(sample, "opensim")
    assert np.ptp(rotation, axis=0).max() == 0
    path = in_axes(sample, "opensim").root
    assert path is not None
    np.testing.assert_allclose(np.diff(path, n=2, axis=0), 0, atol=1e-8)
    tilt = np.degrees(np.arctan2(rotation[0, 1, 2], rotation[0, 1, 1]))
    assert abs(abs(180 - abs(tilt)) - np.median(sample.tilt_deg)) < 0.2


def test_clips_of_two_cameras_have_two_rotations() -> None:
    gravity = np.array([[0, 1, 0]] * 3 + [[0, 1, 0.5]] * 3, float)
    sample = seen_with(gravity, 6, tilt=True, identity={"camera": np.array(list("aaabbb"))})
    np.testing.assert_allclose(in_axes(sample, "level").pose, sample.level_pose, atol=1e-8)


def test_the_level_pose_wins_over_a_tilt_that_says_something_else() -> None:
    sample = seen_with(np.array([0.3, 1.0, 0.2]), frames=2)
    sample = replace(sample, tilt_deg=np.array([11.3, np.nan]))
    np.testing.assert_allclose(in_axes(sample, "level").pose, sample.level_pose, atol=1e-8)


@pytest.mark.parametrize("tilt", [True, False])
def test_missing_joints_stay_missing_and_spoil_nothing(tilt: bool) -> None:
    sample = seen_with(np.array([0.0, 0.9, 0.4]), frames=5, tilt=tilt)
    whole = in_axes(sample, "blender").pose
    pose, level = sample.pose.copy(), sample.level_pose.copy()
    pose[1], level[1] = np.nan, np.nan
    pose[2, 3], level[2, 3] = np.nan, np.nan
    found = in_axes(replace(sample, pose=pose, level_pose=level), "blender").pose
    np.testing.assert_array_equal(np.isnan(found), np.isnan(pose))
    seen = np.isfinite(found)
    np.testing.assert_allclose(found[seen], whole[seen], atol=1e-6)


def test_nothing_known_is_taken_as_level() -> None:
    sample = prediction(frames=3, tilt=False)
    blank = replace(sample, pose=sample.pose * np.nan, level_pose=sample.pose * np.nan, root=np.ones((3, 3)))
    np.testing.assert_array_equal(in_axes(blank, "level").root, blank.root)
    empty = sample.select(np.zeros(3, bool))
    assert len(in_axes(empty, "opensim")) == 0


def test_a_camera_upside_down_is_turned_in_the_image() -> None:
    sample = prediction(frames=2, tilt=False)
    sample = replace(sample, pose=sample.level_pose * [-1, -1, 1])
    np.testing.assert_allclose(in_axes(sample, "level").pose, sample.level_pose, atol=1e-8)


def test_without_gravity_level_is_the_camera() -> None:
    sample = prediction(frames=3, joints=5)
    for name, expected in {"level": sample.pose, "opensim": sample.pose * [1, -1, -1]}.items():
        np.testing.assert_array_equal(in_axes(sample, name).pose, expected)


def test_dtype_is_kept() -> None:
    sample = prediction(frames=3)
    sample = replace(sample, pose=np.float32(sample.pose), level_pose=np.float32(sample.level_pose))
    assert in_axes(sample, "blender").pose.dtype == np.float32
    np.testing.assert_allclose(rotations_to(sample, "level") @ [1, 0, 0], [[1, 0, 0]] * 3, atol=1e-6)


def test_turning_twice_is_refused() -> None:
    sample = prediction(frames=2)
    with pytest.raises(ValueError, match="in the axes 'level'"):
        in_axes(in_axes(sample, "level"), "opensim")
    np.testing.assert_array_equal(in_axes(in_axes(sample, "opencv"), "camera").pose, sample.pose)


def test_unknown_axes_name_the_nearest() -> None:
    with pytest.raises(UserError, match="Did you mean 'opensim'"):
        in_axes(prediction(frames=1), "open_sim")
