"""The shipped skeletons, what is derived from them, and how one is found by name or path."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped

from uplift.config.files import shipped_names
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.propose import skeleton_template

SHIPPED = {
    "h36m17": (17, "hip"), "mpii16": (16, "hip"), "coco17": (17 + 2, "pelvis"), "openpose25": (25, "MidHip"), "openpose25b": (25 + 2, "MidHip"),
    "halpe26": (26, "hip"), "mediapipe33": (33 + 2, "pelvis"), "mpi_inf_3dhp28": (28, "pelvis"),
    "mpi_inf_3dhp17": (17, "pelvis"), "hand21": (21, "wrist"), "quadruped28": (28, "croup"),
    "rat23": (23, "SpineL"), "chair10": (10, "back_top_R"),
    "ap10k17": (17, "neck"), "animal3d26": (26, "neck"), "coco_wholebody133": (133 + 2, "pelvis"),
    "freihand21": (21, "wrist"), "interhand21": (21, "wrist"), "face68": (68, "face-30"),
    "fly38": (38 + 1, "thorax"), "fly32": (32, "thorax"), "fly13": (13, "thorax"),
    "car12": (12 + 1, "roof"), "pascal_chair10": (10 + 1, "seat"),
}  # fmt: skip

DATA = {"cmu": "h36m17", "quadruped": "quadruped28", "rat": "rat23", "hand": "hand21", "chair": "chair10"}


@pytest.fixture(params=SHIPPED)
def skeleton(request: pytest.FixtureRequest) -> Skeleton:
    return load_skeleton(request.param)


def test_all_are_shipped():
    assert set(SHIPPED) == set(shipped_names("skeletons"))


def test_size_and_root(skeleton):
    assert (len(skeleton.joints), skeleton.root) == SHIPPED[skeleton.name]
    assert skeleton.joints[skeleton.root_index] == skeleton.root


def test_plain_data_comes_back_the_same(skeleton):
    plain = skeleton.to_dict()
    assert Skeleton.from_dict(plain) == skeleton
    assert Skeleton.from_dict(yaml.safe_load(yaml.safe_dump(plain))) == skeleton
    assert hash(Skeleton.from_dict(plain)) == hash(skeleton)


def test_parents_lead_to_the_root(skeleton):
    assert set(skeleton.parents) == set(skeleton.joints)
    tree = {(parent, joint) for joint, parent in skeleton.parents.items() if parent}
    assert tree <= set(skeleton.bones)
    for joint in skeleton.joints:
        steps = 0
        while joint != skeleton.root:
            joint, steps = skeleton.parents[joint], steps + 1
            assert steps <= len(skeleton.joints)


def test_mirror_is_its_own_inverse_and_keeps_bones(skeleton):
    across = skeleton.mirror_permutation
    assert (across[across] == np.arange(len(skeleton.joints))).all()
    assert (across != np.arange(len(across))).sum() == 2 * len(skeleton.mirror)
    bones = {frozenset(bone) for bone in skeleton.bone_indices.tolist()}
    assert {frozenset(across[list(bone)].tolist()) for bone in bones} == bones
    image = skeleton.bone_indices[skeleton.bone_mirror_permutation]
    assert (np.sort(across[skeleton.bone_indices], 1) == np.sort(image, 1)).all()


def test_facing_ignores_where_a_pose_stands(skeleton):
    for direction in skeleton.facing:
        weights = skeleton.facing_matrix(direction)
        assert abs(weights.sum()) < 1e-12
        assert np.isclose(np.abs(weights).sum(), 2)


def test_shapes_as_annotated():
    beartype = pytest.importorskip("beartype").beartype
    skeleton = load_skeleton("rat23")
    for name in ("bone_indices", "bone_mirror_permutation", "mirror_permutation"):
        getter = jaxtyped(typechecker=beartype)(Skeleton.__dict__[name].func)
        assert len(getter(skeleton))
    assert jaxtyped(typechecker=beartype)(Skeleton.facing_matrix)(skeleton, "up").shape == (23,)


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(28)), st.integers(0, 2**32 - 1))
def test_order_of_joints_changes_nothing(order, seed):
    one = load_skeleton("quadruped28")
    data = one.to_dict()
    other = Skeleton.from_dict(data | {"joints": [one.joints[place] for place in order]})
    pose = np.random.default_rng(seed).normal(size=(28, 3))
    for direction in one.facing:
        there = other.facing_matrix(direction) @ pose[list(order)]
        assert np.allclose(one.facing_matrix(direction) @ pose, there)
    assert one.parents == other.parents


def test_bones_are_turned_away_from_the_root():
    data = load_skeleton("h36m17").to_dict()
    turned = Skeleton.from_dict(data | {"bones": [bone[::-1] for bone in data["bones"]]})
    assert turned.bones == load_skeleton("h36m17").bones


def test_arrays_cannot_be_changed(skeleton):
    with pytest.raises(ValueError, match="read-only"):
        skeleton.bone_indices[0] = 0


def test_unknown_joint_and_direction_say_the_nearest():
    skeleton = load_skeleton("h36m17")
    with pytest.raises(UserError, match=r"no joint 'rkne'.*'rknee'"):
        skeleton.index("rkne")
    with pytest.raises(UserError, match="no facing direction 'up'"):
        skeleton.facing_matrix("up")


def handedness(skeleton: Skeleton, pose: np.ndarray) -> np.ndarray:
    """Return (up x front) . left of poses in the skeleton's order."""
    front, left = (skeleton.facing_matrix(name) @ pose for name in ("front", "left"))
    given_up = "up" in skeleton.facing
    up = skeleton.facing_matrix("up") @ pose if given_up else np.array([0.0, -1.0, 0.0])
    return (np.cross(np.broadcast_to(up, front.shape), front) * left).sum(-1)


@pytest.mark.parametrize("part", ["train", "test"])
@pytest.mark.parametrize("folder", DATA)
def test_facing_tells_true_poses_from_mirrored_ones(folder, part, benchmark_data):
    skeleton = load_skeleton(DATA[folder])
    with np.load(benchmark_data(f"{folder}/{part}.npz")) as data:
        names, pose = data["joint_names"].tolist(), data["pose"][::3]
    assert set(names) == set(skeleton.joints)
    pose = pose[:, [names.index(joint) for joint in skeleton.joints]].astype(float)
    assert (handedness(skeleton, pose) > 0).mean() >= 0.99
    assert (handedness(skeleton, pose * [1, 1, -1]) > 0).mean() <= 0.01


@pytest.mark.parametrize("folder", DATA)
def test_bones_and_root_are_those_of_the_data(folder, benchmark_data):
    skeleton = load_skeleton(DATA[folder])
    with np.load(benchmark_data(f"{folder}/test.npz")) as data:
        names, pose = data["joint_names"].tolist(), data["pose"]
        bones = data.get("bones")
    assert tuple(names) == skeleton.joints
    assert np.allclose(pose[:, skeleton.root_index], 0)
    if bones is not None:
        assert {frozenset(bone) for bone in bones.tolist()} == {
            frozenset(bone) for bone in skeleton.bone_indices.tolist()
        }


def test_path_and_name_find_the_same(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(load_skeleton("chair10").to_dict()))
    assert load_skeleton(file) == load_skeleton(str(file)) == load_skeleton("chair10")


def test_name_defaults_to_the_files(tmp_path):
    file = tmp_path / "stick.yaml"
    file.write_text("joints: [a, b, c]\nroot: b\nbones: [[a, b], [c, b]]\n")
    skeleton = load_skeleton(file)
    assert skeleton.name == "stick"
    assert skeleton.bones == (("b", "a"), ("b", "c"))


def test_unknown_names_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"'h36m71'.*Did you mean 'h36m17'"):
        load_skeleton("h36m71")
    with pytest.raises(UserError, match=r"no such file"):
        load_skeleton("beetle.yaml")
    (tmp_path / "beetle.yaml").write_text(skeleton_template("beetle"))
    with pytest.raises(UserError, match=r"skeleton=beetle\.yaml"):
        load_skeleton("beetle")
    assert load_skeleton("beetle.yaml").name == "beetle"


@pytest.mark.parametrize("name", ["beetle", "on", "12", "it's: odd", "null"])
def test_template_passes_its_own_check(name, tmp_path):
    file = tmp_path / "new.yaml"
    file.write_text(skeleton_template(name))
    skeleton = load_skeleton(file)
    assert skeleton.name == name
    assert set(skeleton.facing) == {"front", "left", "up"}


@pytest.mark.parametrize("data", [None, 3, [], {"joints": ["a"]}, {"name": "x", "root": "a"}])
def test_plain_data_from_elsewhere_is_checked(data):
    with pytest.raises(UserError, match="skeleton"):
        Skeleton.from_dict(data)
