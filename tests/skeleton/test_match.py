"""Joints are found by name, whatever their order, or built from another layout's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped

from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import build_joints, build_pose, match_joints

COCO = load_skeleton("coco17").joints[:17]
MPII_17_SLOTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "thorax", "upper_neck", "head_middle",
    "headtop", "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip


def random_joints(names, frames=5, seed=0):
    rng = np.random.default_rng(seed)
    keypoints = rng.normal(100, 30, (frames, len(names), 2)).astype(np.float32)
    return keypoints, rng.uniform(0.1, 1, keypoints.shape[:2]).astype(np.float32)


@settings(max_examples=25, deadline=None)
@given(st.permutations(range(17)), st.booleans())
def test_order_and_capitals_change_nothing(order, capitals):
    skeleton = load_skeleton("h36m17")
    keypoints, confidence = random_joints(skeleton.joints)
    names = [skeleton.joints[place] for place in order]
    names = [name.upper() for name in names] if capitals else names
    built, sure, how = build_joints(keypoints[:, order], confidence[:, order], names, skeleton)
    assert np.array_equal(built, keypoints)
    assert np.array_equal(sure, confidence)
    assert how.layout is None and not how.missing and not how.unused


def test_midpoints_are_made_where_the_file_lacks_them():
    skeleton = load_skeleton("coco17")
    keypoints, confidence = random_joints(COCO)
    built, sure, how = build_joints(keypoints, confidence, COCO, skeleton)
    hips = [COCO.index("left_hip"), COCO.index("right_hip")]
    pelvis = skeleton.index("pelvis")
    assert np.allclose(built[:, pelvis], keypoints[:, hips].mean(1))
    assert np.array_equal(sure[:, pelvis], confidence[:, hips].min(1))
    assert how.parts["pelvis"] == ("left_hip", "right_hip")
    whole, _, how = build_joints(built, sure, skeleton.joints, skeleton)
    assert np.array_equal(whole, built)
    assert how.parts["pelvis"] == ("pelvis",)


def test_a_layout_is_built_by_its_map():
    skeleton = load_skeleton("h36m17")
    keypoints, confidence = random_joints(COCO)
    built, sure, how = build_joints(keypoints, confidence, COCO, skeleton)
    assert how.missing == ("headtop",)
    assert (built[:, skeleton.index("headtop")] == 0).all()
    assert (sure[:, skeleton.index("headtop")] == 0).all()
    assert np.array_equal(built[:, skeleton.index("rknee")], keypoints[:, COCO.index("right_knee")])
    torso = [COCO.index(name) for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")]
    assert np.allclose(built[:, skeleton.index("spine")], keypoints[:, torso].mean(1))
    assert "missing: headtop" in str(how)


@pytest.mark.parametrize("missing", ["nan", "confidence"])
def test_a_mean_with_a_missing_part_is_missing(missing):
    skeleton = load_skeleton("coco17")
    keypoints, confidence = random_joints(COCO)
    if missing == "nan":
        keypoints[2, COCO.index("left_hip"), 1] = np.nan
    else:
        confidence[2, COCO.index("left_hip")] = 0
    built, sure, _ = build_joints(keypoints, confidence, COCO, skeleton)
    for joint in ("pelvis", "left_hip"):
        assert sure[2, skeleton.index(joint)] == 0
        assert (built[2, skeleton.index(joint)] == 0).all()
    assert np.isfinite(built).all()
    assert (np.delete(sure, 2, axis=0) > 0).all()


def test_confidence_may_be_absent():
    keypoints, _ = random_joints(COCO)
    _, sure, _ = build_joints(keypoints, None, COCO, load_skeleton("coco17"))
    assert (sure == 1).all()


def test_the_17_slots_of_mpii_train_mpii16():
    how = match_joints(MPII_17_SLOTS, load_skeleton("mpii16"))
    assert how.layout is None and how.unused == ("head_middle",)
    how = match_joints(MPII_17_SLOTS, load_skeleton("h36m17"))
    assert how.layout == "mpii16" and how.missing == ("nose",)


def test_mpii_data_fits(benchmark_data):
    with np.load(benchmark_data("mpii/mpii.npz")) as data:
        keypoints, names = data["keypoints"][:100], data["joint_names"].tolist()
    assert names == list(MPII_17_SLOTS)
    built, _, _ = build_joints(keypoints, None, names, load_skeleton("mpii16"))
    assert built.shape == (100, 16, 2)
    middle = (keypoints[:, names.index("upper_neck")] + keypoints[:, names.index("headtop")]) / 2
    assert np.allclose(keypoints[:, names.index("head_middle")], middle, atol=1.0)


@pytest.mark.parametrize("layout", ["coco17", "openpose25", "halpe26", "mediapipe33", "mpii16", "mpi_inf_3dhp28"])
def test_layouts_of_h36m17_name_joints_that_exist(layout):
    """Every name a `from:` map uses is a joint of the shipped skeleton of that name."""
    used = {part for parts in load_skeleton("h36m17").sources[layout].values() for part in parts}
    assert used <= set(load_skeleton(layout).joints)
    how = match_joints(load_skeleton(layout).joints, load_skeleton("h36m17"))
    assert set(how.parts) == set(load_skeleton("h36m17").sources[layout])


@pytest.mark.parametrize("layout", ["coco17", "openpose25", "halpe26", "mediapipe33", "mpii16", "mpi_inf_3dhp28"])
def test_left_stays_left(layout):
    """Mirroring before or after a `from:` map comes to the same."""
    ours, theirs = load_skeleton("h36m17"), load_skeleton(layout)
    keypoints, confidence = random_joints(theirs.joints)
    across = theirs.mirror_permutation
    one, _, _ = build_joints(keypoints, confidence, theirs.joints, ours)
    other, _, _ = build_joints(keypoints[:, across], confidence[:, across], theirs.joints, ours)
    assert np.allclose(one[:, ours.mirror_permutation], other, atol=1e-4)


def test_tracker_names_fit():
    media_pipe = [joint.upper() for joint in load_skeleton("mediapipe33").joints[:33]]
    assert match_joints(media_pipe, load_skeleton("mediapipe33")).missing == ()
    assert match_joints(load_skeleton("halpe26").joints, load_skeleton("coco17")).layout is None
    assert match_joints(load_skeleton("mpi_inf_3dhp28").joints, load_skeleton("mpi_inf_3dhp17")).layout is None


def test_pose_is_built_alike_with_nan_for_what_cannot_be():
    skeleton = load_skeleton("h36m17")
    pose = np.random.default_rng(0).normal(size=(4, 17, 3)).astype(np.float32)
    built = build_pose(pose, COCO, skeleton)
    assert np.isnan(built[:, skeleton.index("headtop")]).all()
    assert np.isfinite(np.delete(built, skeleton.index("headtop"), axis=1)).all()
    assert np.array_equal(build_pose(built, skeleton.joints, skeleton), built, equal_nan=True)


def test_a_midpoint_of_means_weighs_its_parts_alike():
    data = {"joints": ["a", "b", "m"], "root": "m", "bones": [["m", "a"], ["m", "b"]]}
    data |= {"midpoints": {"m": ["a", "b"]}, "from": {"other": {"a": ["x", "y"], "b": "z"}}}
    pose = np.array([[[0.0, 0, 0], [4, 0, 0], [10, 0, 0]]])
    assert build_pose(pose, ["x", "y", "z"], Skeleton.from_dict(data))[0, 2, 0] == 6


def test_refusal_lists_what_to_mend():
    names = ["hip", "rhip", "rkne", "rankle", "lhip"]
    with pytest.raises(UserError) as caught:
        match_joints(names, load_skeleton("h36m17"))
    message = str(caught.value)
    assert "'rknee' Did you mean 'rkne'?" in message
    assert "Found: hip, rhip, rkne" in message
    assert "coco17" in message and "openpose25" in message


def test_double_names_and_wrong_counts_are_refused():
    skeleton = load_skeleton("h36m17")
    with pytest.raises(UserError, match="'hip' 2 times"):
        match_joints([*skeleton.joints, "hip"], skeleton)
    with pytest.raises(UserError, match=r"shape \(2, 3, 2\) for 17"):
        build_joints(np.zeros((2, 3, 2)), None, skeleton.joints, skeleton)


def test_exact_names_go_before_capitals():
    data = {"joints": ["a", "b", "c"], "root": "a", "bones": [["a", "b"], ["b", "c"]]}
    skeleton = Skeleton.from_dict(data)
    how = match_joints(["A", "a", "b", "c"], skeleton)
    assert how.parts["a"] == ("a",)
    assert match_joints(["a", "B", "c"], skeleton).parts["b"] == ("B",)


def test_capitals_that_leave_a_choice_are_refused():
    data = {"joints": ["ab", "b", "c"], "root": "b", "bones": [["ab", "b"], ["b", "c"]]}
    with pytest.raises(UserError, match="missing 'ab'"):
        match_joints(["AB", "Ab", "b", "c"], Skeleton.from_dict(data))


@pytest.mark.parametrize("sign", [" ", "-", "", "_ "])
def test_blanks_and_dashes_are_ignored_last(sign):
    names = [joint.replace("_", sign).title() for joint in COCO]
    how = match_joints(names, load_skeleton("coco17"))
    assert how.parts["left_eye"] == (names[1],) and not how.missing
    assert match_joints(names, load_skeleton("h36m17")).layout == "coco17"


def test_blanks_that_leave_a_choice_are_refused():
    data = {"joints": ["a_11", "b", "c"], "root": "b", "bones": [["a_11", "b"], ["b", "c"]]}
    with pytest.raises(UserError, match="missing 'a_11'"):
        match_joints(["a1_1", "a 11", "b", "c"], Skeleton.from_dict(data))
    two = {"joints": ["a", "b", "c"], "root": "b", "bones": [["a", "b"], ["b", "c"]]}
    two |= {"from": {"x": {"a": "p_11", "b": "p_1_1", "c": "q"}}}
    with pytest.raises(UserError, match="do not fit"):
        match_joints(["p-11", "q"], Skeleton.from_dict(two))


def test_no_two_joints_are_made_of_one_name_alone():
    data = {"joints": ["a", "b", "c"], "root": "b", "bones": [["a", "b"], ["b", "c"]]}
    with pytest.raises(UserError, match="both 'a' and 'c' are made of 'x' alone"):
        match_joints(["x", "y"], Skeleton.from_dict(data | {"from": {"t": {"a": "x", "b": "y", "c": "x"}}}))
    shared = Skeleton.from_dict(data | {"from": {"t": {"a": "x", "b": ["x", "y"], "c": "y"}}})
    assert match_joints(["x", "y"], shared).layout == "t"


def test_shapes_as_annotated():
    beartype = pytest.importorskip("beartype").beartype
    keypoints, confidence = random_joints(COCO)
    typed = jaxtyped(typechecker=beartype)(build_joints)
    assert typed(keypoints, confidence, COCO, load_skeleton("h36m17"))[0].shape == (5, 17, 2)


def test_names_without_a_use_are_told_up_to_ten() -> None:
    body = "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    body += "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"
    whole = body.split() + [f"face-{n}" for n in range(116)]
    match = match_joints(whole, load_skeleton("coco17"))
    first = ", ".join(f"face-{n}" for n in range(10))
    assert str(match).endswith(f"; unused: {first} and 106 more")
    with pytest.raises(UserError, match=r"Found: j0, j1, j2, j3, j4, j5, j6, j7, j8, j9 and 123 more\."):
        match_joints([f"j{n}" for n in range(133)], load_skeleton("coco17"))
