"""Shipped skeletons among each other: the maps between them, and their directions on true poses of other layouts."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from uplift.config.files import shipped_names
from uplift.errors import UserError
from uplift.models.metric_scale import KnownLength, size_from
from uplift.skeleton import Skeleton
from uplift.skeleton import load_skeleton as load
from uplift.skeleton.draw import rest_pose
from uplift.skeleton.match import build_pose, match_joints

load_skeleton = cache(load)
NAMES = shipped_names("skeletons")
MAPS = [(name, layout) for name in NAMES for layout in load_skeleton(name).sources if layout in NAMES]
BODIES = ("coco17", "halpe26", "openpose25", "openpose25b", "mediapipe33", "coco_wholebody133")
PEOPLE = (*BODIES, "h36m17", "mpii16")
HANDS = ("hand21", "freihand21", "interhand21")


def in_file(skeleton: Skeleton) -> list[str]:
    """Return the names that a file of this layout holds."""
    return [joint for joint in skeleton.joints if joint not in skeleton.midpoints]


def handedness(skeleton: Skeleton, pose: np.ndarray) -> np.ndarray:
    """Return (up x front) . left of poses, with joints that no direction uses left out."""
    pose = np.nan_to_num(pose)
    front, left = (skeleton.facing_matrix(name) @ pose for name in ("front", "left"))
    up = skeleton.facing_matrix("up") @ pose if "up" in skeleton.facing else np.array([0.0, -1.0, 0.0])
    return (np.cross(np.broadcast_to(up, front.shape), front) * left).sum(-1)


@pytest.mark.parametrize(("name", "layout"), MAPS)
def test_a_map_uses_names_of_that_layout(name, layout):
    used = {part for parts in load_skeleton(name).sources[layout].values() for part in parts}
    assert used <= set(load_skeleton(layout).joints)


@pytest.mark.parametrize(("name", "layout"), MAPS)
def test_a_map_keeps_left_and_right(name, layout):
    ours, theirs = load_skeleton(name), load_skeleton(layout)
    across = {joint: ours.joints[ours.mirror_permutation[ours.index(joint)]] for joint in ours.joints}
    theirs_across = {joint: theirs.joints[theirs.mirror_permutation[theirs.index(joint)]] for joint in theirs.joints}
    if not ours.mirror:
        pytest.skip("a hand has no two sides")
    for joint, parts in ours.sources[layout].items():
        assert {theirs_across[part] for part in parts} == set(ours.sources[layout][across[joint]]), joint


@pytest.mark.parametrize(("name", "layout"), MAPS)
def test_no_map_makes_two_joints_of_one(name, layout):
    singles = [parts for parts in load_skeleton(name).sources[layout].values() if len(parts) == 1]
    assert len(set(singles)) == len(singles)


@pytest.mark.parametrize("layout", PEOPLE)
@pytest.mark.parametrize("name", BODIES)
def test_people_of_every_layout_fit_every_other(name, layout):
    if name in ("coco_wholebody133", "openpose25b") and layout in ("h36m17", "mpii16"):
        pytest.skip("no map: few joints of many")
    skeleton = load_skeleton(name)
    how = match_joints(in_file(load_skeleton(layout)), skeleton)
    for limb in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"):
        made = [joint for joint in how.parts if joint.casefold().endswith(limb)]
        assert len([joint for joint in made if joint not in ("hip", "MidHip")]) == 2, limb
    assert skeleton.root in how.parts


@pytest.mark.parametrize("name", BODIES)
def test_a_file_of_openpose_is_never_taken_for_another_of_its_models(name):
    body_25 = load_skeleton("openpose25").joints
    expected = {"openpose25": None, "openpose25b": "openpose25"}.get(name, "openpose25")
    assert match_joints(body_25, load_skeleton(name)).layout == expected
    coco_model = [joint for joint in body_25[:19] if joint != "MidHip"]
    if name in ("coco17", "halpe26", "openpose25", "mediapipe33"):
        how = match_joints(coco_model, load_skeleton(name))
        assert how.layout == "openpose18" and load_skeleton(name).root in how.parts


@pytest.mark.parametrize("parts", ["body", "hands", "face"])
def test_hands_and_face_of_openpose_make_a_whole_body(parts):
    whole = load_skeleton("coco_wholebody133")
    more = [joint for joint in whole.joints if joint not in load_skeleton("openpose25").sources["coco_wholebody133"]]
    hands = [j for j in more if j.endswith(("hand_root", "1", "2", "3", "4")) and j.startswith(("left_", "right_"))]
    face = [f"face-{number}" for number in range(70)]
    names = [
        *load_skeleton("openpose25").joints,
        *(hands if parts != "body" else ()),
        *(face if parts == "face" else ()),
    ]
    made = {"body": 25, "hands": 25 + 42, "face": 25 + 42 + 68}[parts]
    assert len(match_joints(names, whole).parts) == made


@pytest.mark.parametrize("layout", HANDS)
@pytest.mark.parametrize("name", HANDS)
def test_hands_of_every_layout_fit_every_other(name, layout):
    assert not match_joints(load_skeleton(layout).joints, load_skeleton(name)).missing


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_of_a_whole_body_hangs_from_its_own_root(name):
    how = match_joints(load_skeleton("coco_wholebody133").joints, load_skeleton(name))
    assert how.parts["wrist"] == ("right_hand_root",)


def test_other_bodies_do_not_fit():
    """Animals and people share names of joints, not their limbs."""
    animals = ("ap10k17", "animal3d26", "quadruped28", "rat23", "fly32")
    for animal in animals:
        for person in PEOPLE:
            for one, other in ((animal, person), (person, animal)):
                with pytest.raises(UserError, match="do not fit"):
                    match_joints(in_file(load_skeleton(one)), load_skeleton(other))


@pytest.mark.parametrize("name", NAMES)
def test_the_rest_pose_has_its_left_on_the_left(name):
    skeleton = load_skeleton(name)
    pose = rest_pose(skeleton)
    if pose is None or not skeleton.facing:
        pytest.skip("no rest pose")
    assert handedness(skeleton, pose) > 0


@pytest.mark.parametrize(
    ("folder", "name", "share"),
    [("hand", name, 0.99) for name in HANDS]
    + [("quadruped", "ap10k17", 0.99)]
    + [("cmu", name, 0.99) for name in BODIES if name not in ("coco_wholebody133", "openpose25b")],
)
def test_directions_hold_in_true_poses_of_other_layouts(folder, name, share, benchmark_data):
    skeleton = load_skeleton(name)
    with np.load(benchmark_data(f"{folder}/test.npz")) as data:
        pose = build_pose(data["pose"][::3].astype(float), data["joint_names"].tolist(), skeleton)
    assert (handedness(skeleton, pose) > 0).mean() >= share
    assert (handedness(skeleton, pose * [1, 1, -1]) > 0).mean() <= 1 - share


LEG = ("hip", "knee", "ankle")
OF_PEOPLE = [name for name in NAMES if all(part in " ".join(load_skeleton(name).joints).lower() for part in LEG)]
OF_PEOPLE.remove("rat23")


@pytest.mark.parametrize("name", OF_PEOPLE)
def test_the_height_of_a_person_gives_the_length_of_a_leg(name):
    """Hip 0.530 and ankle 0.039 of the stature above the ground: Winter, Biomechanics and Motor Control, fig. 4.1."""
    assert {*PEOPLE, "mpi_inf_3dhp28"} <= set(OF_PEOPLE)
    found = size_from(load_skeleton(name), height_mm=1750.0)
    assert isinstance(found, KnownLength) and found.mm == pytest.approx((0.530 - 0.039) * 1750)
    assert [joint.lower().endswith(part) for joint, part in zip(found.along[::-1], LEG, strict=True)] == [True] * 3
