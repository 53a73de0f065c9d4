"""People in poses that are known by the angles of their joints, posed with scipy's rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from uplift.data.synthetic.body import human_body, rest_positions
from uplift.models.prediction import Prediction
from uplift.skeleton import load_skeleton

__all__ = ["angles_of", "person", "read_table", "turned"]

# Coordinates of each joint in the order in which they turn, as axes of the right side in OpenSim's body axes.
JOINTS = {
    "pelvis": ("", [("pelvis_rotation", (0, 1, 0)), ("pelvis_list", (1, 0, 0)), ("pelvis_tilt", (0, 0, 1))]),
    "trunk": ("pelvis", [("lumbar_extension", (0, 0, 1)), ("lumbar_bending", (1, 0, 0)), ("lumbar_rotation", (0, 1, 0))]),
    "thorax": ("trunk", [("neck_extension", (0, 0, 1)), ("neck_bending", (1, 0, 0)), ("neck_rotation", (0, 1, 0))]),
    "right_hip": ("pelvis", [("hip_flexion_r", (0, 0, 1)), ("hip_adduction_r", (1, 0, 0)), ("hip_rotation_r", (0, 1, 0))]),
    "right_knee": ("right_hip", [("knee_angle_r", (0, 0, -1))]),
    "right_ankle": ("right_knee", [("ankle_angle_r", (0, 0, 1)), ("subtalar_angle_r", (0.787, 0.605, -0.121))]),
    "right_shoulder": ("trunk", [("arm_flex_r", (0, 0, 1)), ("arm_add_r", (1, 0, 0)), ("arm_rot_r", (0, 1, 0))]),
    "right_elbow": ("right_shoulder", [("elbow_flex_r", (0, 0, 1))]),
    "right_wrist": ("right_elbow", [("pro_sup_r", (0, 1, 0)), ("wrist_flex_r", (0, 0, 1)), ("wrist_dev_r", (1, 0, 0))]),
}  # fmt: skip
# Middle and half of the span that each angle moves over, degrees; what is not named: 0 and 15.
SPANS = {
    "pelvis_rotation": (-80, 60), "pelvis_list": (0, 8), "pelvis_tilt": (-5, 8), "hip_flexion": (30, 35),
    "knee_angle": (60, 40), "elbow_flex": (70, 45), "arm_flex": (20, 30), "arm_add": (-35, 20), "arm_rot": (0, 25),
    "pro_sup": (70, 40), "lumbar_extension": (-15, 15), "subtalar_angle": (0, 12),
}  # fmt: skip


def _joints() -> dict[str, tuple[str, list]]:
    """Return the joints of both sides."""
    found = dict(JOINTS)
    for name, (parent, turns) in JOINTS.items():
        if name.startswith("right_"):
            mirrored = [(f"{turn[:-2]}_l", (-axis[0], -axis[1], axis[2])) for turn, axis in turns]
            found[name.replace("right", "left")] = (parent.replace("right", "left"), mirrored)
    return found


def angles_of(frames: int, seed: int) -> dict[str, np.ndarray]:
    """Return every coordinate over time, degrees, each at a rhythm of its own."""
    random = np.random.default_rng(seed)
    found = {}
    for _, turns in _joints().values():
        for name, _ in turns:
            middle, half = SPANS.get(name, SPANS.get(name[:-2], (0, 15)))
            time = np.arange(frames) / 30
            found[name] = middle + half * np.sin(2 * np.pi * random.uniform(0.3, 0.9) * time + random.uniform(0, 6))
    return found


def turned(turns: list, angles: dict[str, np.ndarray], frames: int) -> Rotation:
    """Return the rotations of one joint; an angle that is not there is 0."""
    whole = Rotation.identity(frames)
    for name, axis in turns:
        unit = np.array(axis) / np.linalg.norm(axis)
        whole = whole * Rotation.from_rotvec(np.radians(angles.get(name, np.zeros(frames)))[:, None] * unit)
    return whole


def person(
    skeleton: str, angles: dict[str, np.ndarray], place_mm: np.ndarray, stature_mm: float = 1700.0, **more
) -> Prediction:
    """Return a prediction of a person in poses, seen by a level camera; bends at the ``spine`` where the skeleton has it."""
    made = load_skeleton(skeleton)
    body, frames = human_body(made), len(place_mm)
    rest = dict(zip(body.points, rest_positions(body.parents, body.offsets) * stature_mm * [-1, -1, -1], strict=True))
    rest = {name: place[[2, 1, 0]] for name, place in rest.items()}
    spine = body.joints[:, body.points.index("spine")].max() == 1
    rest["trunk"] = rest["spine" if spine else "lumbar"]
    places, turns = {"pelvis": np.asarray(place_mm, float)}, {}
    for joint, (parent, own) in _joints().items():
        if parent:
            places[joint] = places[parent] + turns[parent].apply(rest[joint] - rest[parent])
        turns[joint] = (turns[parent] if parent else Rotation.identity(frames)) * turned(own, angles, frames)
    points = np.stack([_point(name, rest, places, turns) for name in body.points], 1)
    pose = np.einsum("jp,fpc->fjc", body.joints, points) * [1, -1, -1]
    root = pose[:, made.index(made.root)]
    pose = pose - root[:, None]
    keypoints = pose[..., :2] * 0.2 + 500
    facts = {"fps": 30.0, "root": root, "tilt_deg": np.zeros(frames), **more}
    return Prediction(pose, pose.copy(), "mm", keypoints, np.ones(pose.shape[:2]), made.joints, made, **facts)


_HEAD = ("head", "nose", "chin")


def _point(name: str, rest: dict, places: dict, turns: dict) -> np.ndarray:
    """Return where a point goes: with the joint that it hangs on."""
    side, _, part = name.partition("_")
    if name in places:
        return places[name]
    if name.startswith(_HEAD) or part.startswith(("eye", "ear", "mouth")):
        on = "thorax"
    elif part in ("heel", "foot", "big_toe", "small_toe"):
        on = f"{side}_ankle"
    elif part in ("hand", "thumb", "index", "pinky", "fingertip"):
        on = f"{side}_wrist"
    else:
        on = "pelvis" if name == "lumbar" else "trunk"
    return places[on] + turns[on].apply(rest[name] - rest[on])


def read_table(path) -> dict[str, np.ndarray]:
    """Return the columns of OpenSim's ``.mot`` or ``.sto``."""
    lines = path.read_text().splitlines()
    start = lines.index("endheader") + 1
    table = np.array([line.split() for line in lines[start + 1 :]], float)
    return dict(zip(lines[start].split(), table.T, strict=True))
