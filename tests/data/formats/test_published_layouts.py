"""Orders of keypoints against the documentation of those who write them, in its own words."""

from __future__ import annotations

import re

import pytest

from uplift.config.files import shipped_names
from uplift.data.formats import layouts
from uplift.data.formats.jabs import JOINTS as JABS
from uplift.skeleton import load_skeleton

COCO = "nose Leye Reye Lear Rear Lshoulder Rshoulder Lelbow Relbow Lwrist Rwrist Lhip Rhip Lknee Rknee Lankle Rankle"
FEET = "Lbigtoe Lsmalltoe Lheel Rbigtoe Rsmalltoe Rheel"
ARMS = "Rshoulder Relbow Rwrist Lshoulder Lelbow Lwrist"
LEGS = "Rhip Rknee Rankle Lhip Lknee Lankle"
HEAD = "Reye Leye Rear Lear"
DOCUMENTED = {
    "COCO_JOINTS": COCO,
    "HALPE26": f"{COCO} head neck hip Lbigtoe Rbigtoe Lsmalltoe Rsmalltoe Lheel Rheel",
    "OPENPOSE25": f"nose neck {ARMS} midhip {LEGS} {HEAD} {FEET}",
    "OPENPOSE18": f"nose neck {ARMS} {LEGS} {HEAD}",
    "OPENPOSE15": f"head neck {ARMS} {LEGS} chest",
    "OPENPOSE25B": f"{COCO} upperneck headtop {FEET}",
    "MPII16": (
        "Rankle Rknee Rhip Lhip Lknee Lankle hip thorax upperneck headtop Rwrist Relbow Rshoulder Lshoulder Lelbow Lwrist"
    ),
}
MEDIAPIPE = (
    "nose Leyeinner Leye Leyeouter Reyeinner Reye Reyeouter Lear Rear mouthL mouthR Lshoulder Rshoulder Lelbow Relbow "
    "Lwrist Rwrist Lpinky Rpinky Lindex Rindex Lthumb Rthumb Lhip Rhip Lknee Rknee Lankle Rankle Lheel Rheel "
    "Lfootindex Rfootindex"
)
MOUSE = "nose Lear Rear baseneck Lfrontpaw Rfrontpaw centerspine Lrearpaw Rrearpaw basetail midtail tiptail"


def spelt(names: tuple[str, ...]) -> str:
    """Return names as one line without underscores, with L or R for the side."""
    return " ".join(
        name.replace("left", "L").replace("right", "R").replace("_", "").lower() for name in names
    )  # fmt: skip


@pytest.mark.parametrize("name", DOCUMENTED)
def test_body_layouts_are_those_of_their_documentation(name: str) -> None:
    assert spelt(getattr(layouts, name)) == DOCUMENTED[name].lower()


def test_whole_bodies_are_a_body_feet_a_face_and_two_hands_the_left_one_first() -> None:
    """COCO-WholeBody: 17 body, 6 feet, 68 face, 21 and 21 hands; Halpe: 26, 68, 21, 21; BODY_135: no roots of hands."""
    for names, body, face, hands in (
        (layouts.WHOLEBODY133, f"{COCO} {FEET}", 23, 91),
        (layouts.HALPE136, DOCUMENTED["HALPE26"], 26, 94),
        (layouts.HALPE68, DOCUMENTED["HALPE26"], None, 26),
    ):
        assert spelt(names[: len(body.split())]) == body.lower()
        assert face is None or [name[:5] for name in names[face : face + 68]] == ["face-"] * 68
        left, right = names[hands : hands + 21], names[hands + 21 : hands + 42]
        assert left == layouts.HANDS["left"] and right == layouts.HANDS["right"]
    fingers = [name.rstrip("1234").removeprefix("left_") for name in layouts.HANDS["left"][1::4]]
    assert fingers == ["thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger"]
    assert [name.split("_")[0] for name in layouts.HAND21[1::4]] == ["thumb", "index", "middle", "ring", "little"]
    assert spelt(layouts.BODY135[:25]) == DOCUMENTED["OPENPOSE25B"].lower()
    assert layouts.BODY135[25:45] == layouts.HANDS["left"][1:] and layouts.BODY135[65] == "face-0"


def test_shipped_skeletons_list_joints_as_the_trackers_do() -> None:
    wholes = {
        "coco17": COCO, "halpe26": DOCUMENTED["HALPE26"], "openpose25": DOCUMENTED["OPENPOSE25"],
        "openpose25b": DOCUMENTED["OPENPOSE25B"], "mediapipe33": MEDIAPIPE,
    }  # fmt: skip
    for name, documented in wholes.items():
        skeleton = load_skeleton(name)
        listed = tuple(joint for joint in skeleton.joints if joint not in skeleton.midpoints)
        assert spelt(listed) == documented.lower(), name
    assert spelt(JABS) == MOUSE.lower()


@pytest.mark.parametrize("name", shipped_names("skeletons"))
def test_partners_are_named_alike_but_for_their_side(name: str) -> None:
    for right, left in load_skeleton(name).mirror:
        if right.startswith("face-"):  # numbered: the jaw from ear to ear
            assert int(left[5:]) + int(right[5:]) == 16 or int(right[5:]) > 16
            continue
        words = (("right", "left"), ("Right", "Left"), ("R", "L"), ("r", "l"))
        names = {re.sub(f"^(.{{{at}}}){one}", rf"\1{other}", right) for one, other in words for at in range(len(right))}
        assert left in names - {right}, (right, left)
