"""What the header of a plain csv says: joints side by side (wide), or one row a joint (long)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

__all__ = ["Columns", "Joint", "columns_of", "is_nameless"]

_IDENTITY = {
    "subject": ("subject", "subject_id", "participant"),
    "action": ("action", "activity"),
    "sequence": ("sequence", "sequence_id", "seq", "video", "video_name", "video_id", "clip", "clip_id", "trial"),
    "camera": ("camera", "camera_id", "cam", "cam_id", "view"),
    "instance": (
        "instance", "instance_id", "individual", "individual_id", "individuals", "id", "index", "track", "track_id", "track_name",
        "person", "person_id", "person_idx", "animal", "animal_id", "body", "body_id", "pose_id", "pose_index",
    ),
    "image": ("image", "image_name", "image_path", "image_file", "img", "img_name", "file", "file_name", "filename"),
    "category": ("category", "category_name", "class", "class_name", "species"),
}  # fmt: skip
_FRAME = (
    "frame", "frames", "frame_number", "frame_no", "frame_nr", "frame_num", "frame_id", "frame_idx", "frame_index",
    "framenumber", "frameindex", "frameid", "fnum",
)  # fmt: skip
_TIME = re.compile(
    r"(time|times|timestamp|timestamps|t|seconds|sec|milliseconds)(_?(s|sec|seconds|ms|milliseconds|us))?"
)
_JOINT = (
    "joint", "joint_name", "keypoint", "keypoint_name", "bodypart", "bodyparts", "body_part", "landmark",
    "landmark_name", "node", "node_name", "marker", "marker_name", "part", "part_name", "point", "name",
    "joint_id", "joint_index", "joint_idx", "keypoint_id", "keypoint_index", "keypoint_idx",
    "landmark_id", "landmark_index", "landmark_idx", "landmark_number", "node_id",
)  # fmt: skip
_FACTS = {
    "image_width": "width", "image_height": "height", "frame_width": "width", "frame_height": "height",
    "fps": "fps", "frame_rate": "fps",
}  # fmt: skip
_SCORE = "confidence|conf|c|likelihood|score|prob|probability|p|visibility|vis|v"
_WORD = rf"(?P<what>x|y|z|{_SCORE})(?:_?(?:px|pixels?|coord|coordinate|pos))?"
_SUFFIX = re.compile(rf"(?P<name>.*\S)\s*[-_./:(\[ ]\s*{_WORD}\s*[)\]]?", re.IGNORECASE)
_PREFIX = re.compile(rf"{_WORD}\s*(?:[-_./:(\[ ]\s*(?P<name>\S.*?)|(?P<number>\d+))\s*[)\]]?", re.IGNORECASE)
_ALONE = re.compile(rf"(?:(?:pos|coord|px|pixel)_?)?{_WORD}", re.IGNORECASE)
_NUMBERED = re.compile(r"(?:(?:keypoint|kpt|kp|joint|landmark|point|marker|part|node|p|j)[_ ]?)?\d+", re.IGNORECASE)
_SEEN = {"_u_px": "_x", "_v_px": "_y"}
_PREDICTED = re.compile(r"_u_px$|_v_px$|(?<!_)_[xyz]$")
_BOX = ("bbox", "box", "bounding_box", "bb")


@dataclass
class Joint:
    """The columns of one joint, or, in a long table, of whichever joint the row is of."""

    x: int
    y: int
    z: int | None = None
    score: int | None = None
    visibility: bool = False
    """The score is called visibility: COCO's numbers have that name, too."""


@dataclass
class Columns:
    """Where a csv has what."""

    joints: dict[str, Joint]
    """Of a wide table, by name; of a long one under no name."""
    name: int | None = None
    """The column of a long table that says which joint a row is of; None: a wide table."""
    identity: dict[str, int] = field(default_factory=dict)
    frame: int | None = None
    time: int | None = None
    facts: dict[str, int] = field(default_factory=dict)
    """``width`` and ``height`` of the image, and ``fps``."""
    twice: list[str] = field(default_factory=list)
    """Names of columns that another one of the same joint has already."""
    others: tuple[str, ...] = ()
    """Names of the columns that are left out."""


def columns_of(header: Sequence[str]) -> Columns | None:
    """Return what the columns hold; None where they hold no keypoints."""
    found = Columns({})
    if any(head.endswith("_u_px") for head in header):  # our own predictions: beside the poses, what was seen
        header = [_PREDICTED.sub(lambda end: _SEEN.get(end[0], ""), head) for head in header]
    free: list[int] = []
    joint: dict[str, int] = {}
    for place, head in enumerate(header):
        key = re.sub(r"[\s-]+", "_", head.strip().casefold())
        role = next((role for role, words in _IDENTITY.items() if key in words), None)
        if role and role not in found.identity:
            found.identity[role] = place
        elif key in _FRAME and found.frame is None:
            found.frame = place
        elif _TIME.fullmatch(key) and found.time is None:
            found.time = place
        elif key in _FACTS:
            found.facts[_FACTS[key]] = place
        elif key in _JOINT:
            joint[key] = place
        else:
            free.append(place)
    alone = _alone(header, free)
    if alone and not joint and "instance" in found.identity:
        place = found.identity["instance"]  # with x and y and no name, a bare number is that of a landmark
        if header[place].strip().casefold() in ("id", "index"):
            joint = {_JOINT[0]: found.identity.pop("instance")}
    if joint and alone:
        found.name = joint[min(joint, key=_JOINT.index)]
        found.joints = {"": alone}
    else:
        free = sorted([*free, *joint.values()])
        wide = [_wide(header, free, pattern) for pattern in (_SUFFIX, _PREFIX)]
        found.twice, found.joints = max(wide, key=lambda one: len(one[1]))
    if not found.joints:
        return None
    if found.frame is None and header[0].strip() in ("", "Unnamed: 0"):
        found.frame = 0
    used = {place for one in found.joints.values() for place in (one.x, one.y, one.z, one.score)}
    used |= {found.name, found.frame, found.time, *found.identity.values(), *found.facts.values()}
    found.others = tuple(head for place, head in enumerate(header) if place not in used and head)
    return found


def is_nameless(names: Sequence[str]) -> bool:
    """Return whether the names are numbers and no more."""
    return all(_NUMBERED.fullmatch(name) for name in names)


def _alone(header: Sequence[str], free: Sequence[int]) -> Joint | None:
    """Return the columns x, y, z and score of a long table; None without x and y."""
    places: dict[str, int] = {}
    visibility = False
    for place in free:
        match = _ALONE.fullmatch(header[place])
        if match:
            what = match["what"].casefold()
            kind = what if what in "xyz" else "score"
            visibility |= kind == "score" and what.startswith("v") and kind not in places
            places.setdefault(kind, place)
    if "x" not in places or "y" not in places:
        return None
    return Joint(places["x"], places["y"], places.get("z"), places.get("score"), visibility)


def _wide(header: Sequence[str], free: Sequence[int], pattern: re.Pattern[str]) -> tuple[list[str], dict[str, Joint]]:
    """Return the columns that are there twice, and the joints that have x and y, in the order of the file."""
    twice: list[str] = []
    places: dict[str, dict[str, int]] = {}
    visible = set()
    for place in free:
        match = pattern.fullmatch(header[place])
        if not match:
            continue
        what = match["what"].casefold()
        name = match["name"] or match["number"]
        if name.casefold() in _BOX:
            continue
        kind = what if what in "xyz" else "score"
        if kind == "score" and what.startswith("v"):
            visible.add(name)
        if places.setdefault(name, {}).setdefault(kind, place) != place and kind in "xyz":
            twice.append(header[place])
    return twice, {
        name: Joint(at["x"], at["y"], at.get("z"), at.get("score"), name in visible)
        for name, at in places.items()
        if "x" in at and "y" in at
    }
