"""Individuals that are told apart by the names of their joints, and what never is one."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from uplift.cli.data_check import keypoint_file
from uplift.config.settings import LifterSettings, Settings
from uplift.data.individuals import by_individuals
from uplift.data.load import load_file
from uplift.data.module import KeypointData
from uplift.data.poses import PoseData
from uplift.skeleton import Skeleton

# As in the files of DeepOF (two mice of one DeepLabCut model), and the first frame of its test file.
MOUSE = (
    "Nose", "Left_ear", "Right_ear", "Spine_1", "Center", "Spine_2", "Tail_base", "Tail_1", "Tail_2", "Tail_tip",
    "Left_bhip", "Right_bhip", "Left_fhip", "Right_fhip",
)  # fmt: skip
BLACK = [
    (261.8, 215.6), (272.1, 233.4), (281.2, 222.2), (286.8, 234.0), (300.0, 243.8), (314.5, 254.4), (325.5, 267.0),
    (332.9, 281.0), (333.5, 297.0), (323.0, 310.9), (305.4, 269.4), (321.9, 241.5), (277.1, 241.6), (292.3, 223.5),
]  # fmt: skip
WHITE = [
    (166.2, 121.0), (144.6, 114.0), (145.6, 129.0), (134.2, 121.2), (116.4, 122.6), (100.6, 125.2), (85.1, 129.1),
    (65.3, 138.4), (49.3, 153.1), (36.9, 173.1), (98.6, 108.6), (106.6, 142.2), (135.6, 110.3), (136.4, 135.1),
]  # fmt: skip
SKELETON = Skeleton("mouse", MOUSE, "Center", tuple(("Center", joint) for joint in MOUSE if joint != "Center"))


def tracked(names, points, frames: int = 20) -> PoseData:
    """Return joints that move about their places, together."""
    walk = np.random.default_rng(0).normal(0, 3, (frames, 1, 2)).cumsum(0)
    keypoints = (np.array(points) + walk).astype(np.float32)
    identity = {"sequence": np.full(frames, "cage"), "frame": np.arange(frames)}
    return PoseData(keypoints, np.ones(keypoints.shape[:2], np.float32), tuple(names), identity=identity)


def named(form: str, who: tuple[str, ...] = ("B", "W"), joints=MOUSE) -> list[str]:
    return [form.format(who=one, joint=joint) for one, joint in product(who, joints)]


MICE = tracked(named("{who}_{joint}"), [*BLACK, *WHITE])


@pytest.mark.parametrize("skeleton", [None, SKELETON], ids=["no skeleton", "skeleton"])
@pytest.mark.parametrize(
    ("form", "who"),
    [
        ("{who}_{joint}", ("B", "W")),
        ("{who}_{joint}", ("mouse1", "mouse2")),
        ("{who}-{joint}", ("resident mouse", "intruder mouse")),
        ("{joint}_{who}", ("1", "2")),
        ("{joint}_{who}", ("mice1", "mice2")),
    ],
)
def test_two_mice_of_one_model_become_two_bodies(skeleton, form, who):
    data = by_individuals(replace(MICE, joint_names=tuple(named(form, who))), skeleton)
    assert data.joint_names == MOUSE and len(data) == 40
    for mouse, first in zip(who, (BLACK, WHITE), strict=True):
        rows = data.identity["instance"] == mouse
        assert data.identity["frame"][rows].tolist() == list(range(20))
        np.testing.assert_allclose(
            data.keypoints[rows][0] - data.keypoints[rows][0, 0], np.array(first) - first[0], atol=1e-3
        )
    assert f"2 individuals told apart by the names of their joints ({', '.join(who)})" in data.notes


def test_a_mouse_that_is_not_seen_has_no_row():
    data = replace(MICE, confidence=MICE.confidence.copy(), bones=(("B_Nose", "B_Center"), ("W_Nose", "W_Center")))
    data.confidence[5:, len(MOUSE) :] = 0
    found = by_individuals(data)
    assert np.unique(found.identity["instance"], return_counts=True)[1].tolist() == [20, 5]
    assert found.bones == (("Nose", "Center"),)


HALF = (("shoulder", 0, 0), ("elbow", 30, 40), ("wrist", 60, 80), ("hip", 5, 100), ("knee", 8, 150))


@pytest.mark.parametrize(
    ("form", "who"),
    [
        ("{who}_{joint}", ("left", "right")),
        ("{who}_{joint}", ("L", "R")),
        ("{joint}_{who}", ("l", "r")),
        ("{joint} {who}", ("Left", "Right")),
        ("{who}.{joint}", ("LHand", "RHand")),
        ("{who}_{joint}", ("L1", "R1")),
        ("{who}_{joint}", ("cam1", "cam2")),
        ("{joint}_{who}", ("top", "bot")),
        ("{who}_{joint}", ("front", "hind")),
        ("{who}{joint}", ("leg1_", "leg2_")),
    ],
)
def test_sides_cameras_and_limbs_are_no_individuals(form, who):
    joints, places = [one[0] for one in HALF], np.array([one[1:] for one in HALF])
    half = Skeleton("half", tuple(joints), "hip", tuple(("hip", joint) for joint in joints if joint != "hip"))
    data = tracked(named(form, who, joints), [*places, *(places + 500)])
    for skeleton in (None, half):
        assert by_individuals(data, skeleton) is data


def test_what_is_one_body_stays_one():
    numbered = tracked(
        named("{joint}{who}", ("1", "2"), ("eye", "paw", "ear")), [(0, 0), (9, 80), (4, 9), (8, 0), (20, 80), (12, 9)]
    )
    assert by_individuals(numbered) is numbered  # both sides of one animal, never apart
    other = tracked(named("{who}_{joint}", ("tail", "spine"), ("1", "2", "3")), np.arange(12).reshape(6, 2) * 100)
    assert by_individuals(other) is other
    both = Skeleton("pair", MICE.joint_names, "B_Nose", tuple(("B_Nose", joint) for joint in MICE.joint_names[1:]))
    assert by_individuals(MICE, both) is MICE  # a skeleton of both mice is what the user made of them
    for held in (
        {"pose": np.zeros((20, 28, 3), np.float32)},
        {"identity": MICE.identity | {"instance": np.full(20, "a")}},
    ):
        data = replace(MICE, **held)
        assert by_individuals(data, SKELETON) is data


def test_corners_of_the_cage_are_left_out_where_a_skeleton_says_what_an_animal_is(tmp_path):
    corners = ["Box_TL", "Box_TR", "Box_BR", "Box_BL"]
    places = [*BLACK, *WHITE, (0, 0), (600, 0), (600, 400), (0, 400)]
    data = tracked([*MICE.joint_names, *corners], places)
    assert by_individuals(data) is data
    header = ",".join(f"{name}_{what}" for name in data.joint_names for what in "xy")
    table = data.keypoints.reshape(20, -1)
    np.savetxt(tmp_path / "cage.csv", table, delimiter=",", header=header, comments="")
    found = load_file(tmp_path / "cage.csv", SKELETON)
    assert len(found) == 40 and set(found.identity["instance"]) == {"B", "W"}
    assert any("4 other joints left out" in note for note in found.notes)
    assert found.clips().max() == 1
    settings = Settings()
    assert "20 frames of 32 joints" in keypoint_file(tmp_path / "cage.csv", settings, SKELETON)
    for given in (str(tmp_path / "cage.csv"), data):
        module = KeypointData(given, skeleton=SKELETON, val=0)
        module.setup("fit")
        assert len(module.frames(LifterSettings())) == 40
