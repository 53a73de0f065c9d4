"""Acclaim and Biovision files in CMU's exact layout, and their joint positions computed with scipy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

# name: parent, direction, length, axis in degrees, degrees of freedom. The build of CMU's skeletons; the lengths
# are one person's, rounded.
BONES = {
    "lhipjoint": ("root", (0.6736, -0.7161, 0.1829), 2.64, (0, 0, 0), ""),
    "lfemur": ("lhipjoint", (0.34202, -0.939693, 0), 7.41, (0, 0, 20), "rx ry rz"),
    "ltibia": ("lfemur", (0.34202, -0.939693, 0), 7.93, (0, 0, 20), "rx"),
    "lfoot": ("ltibia", (0.0787, -0.2162, 0.9732), 2.29, (-90, 0, 20), "rx rz"),
    "ltoes": ("lfoot", (0, 0, 1), 1.15, (-90, 0, 20), "rx"),
    "rhipjoint": ("root", (-0.6306, -0.752, 0.1921), 2.51, (0, 0, 0), ""),
    "rfemur": ("rhipjoint", (-0.34202, -0.939693, 0), 7.61, (0, 0, -20), "rx ry rz"),
    "rtibia": ("rfemur", (-0.34202, -0.939693, 0), 7.99, (0, 0, -20), "rx"),
    "rfoot": ("rtibia", (-0.1094, -0.3006, 0.9474), 2.34, (-90, 0, -20), "rx rz"),
    "rtoes": ("rfoot", (0, 0, 1), 1.16, (-90, 0, -20), "rx"),
    "lowerback": ("root", (0.0168, 0.9938, -0.1096), 2.03, (0, 0, 0), "rx ry rz"),
    "upperback": ("lowerback", (0.0171, 0.9998, 0.0046), 2.03, (0, 0, 0), "rx ry rz"),
    "thorax": ("upperback", (0.0081, 0.9984, 0.0556), 2.06, (0, 0, 0), "rx ry rz"),
    "lowerneck": ("thorax", (-0.0013, 0.9926, 0.1215), 1.72, (0, 0, 0), "rx ry rz"),
    "upperneck": ("lowerneck", (0.0145, 0.9917, -0.1276), 1.74, (0, 0, 0), "rx ry rz"),
    "head": ("upperneck", (0.0016, 0.9984, -0.0563), 1.74, (0, 0, 0), "rx ry rz"),
    "lclavicle": ("thorax", (0.9526, 0.2848, -0.1067), 3.53, (0, 0, 0), "ry rz"),
    "lhumerus": ("lclavicle", (1, 0, 0), 5.07, (180, -30, -90), "rx ry rz"),
    "lradius": ("lhumerus", (1, 0, 0), 3.6, (180, -30, -90), "rx"),
    "lwrist": ("lradius", (1, 0, 0), 1.8, (0, 90, 90), "ry"),
    "lhand": ("lwrist", (1, 0, 0), 0.45, (0, 90, 90), "rx rz"),
    "lfingers": ("lhand", (1, 0, 0), 0.36, (0, 90, 90), "rx"),
    "lthumb": ("lwrist", (0.7071, 0, 0.7071), 0.52, (-90, 45, 0), "rx rz"),
    "rclavicle": ("thorax", (-0.9559, 0.2194, -0.1953), 3.66, (0, 0, 0), "ry rz"),
    "rhumerus": ("rclavicle", (-1, 0, 0), 5.36, (180, 30, 90), "rx ry rz"),
    "rradius": ("rhumerus", (-1, 0, 0), 3.58, (180, 30, 90), "rx"),
    "rwrist": ("rradius", (-1, 0, 0), 1.79, (0, -90, -90), "ry"),
    "rhand": ("rwrist", (-1, 0, 0), 0.66, (0, -90, -90), "rx rz"),
    "rfingers": ("rhand", (-1, 0, 0), 0.54, (0, -90, -90), "rx"),
    "rthumb": ("rwrist", (-0.7071, 0, 0.7071), 0.77, (-90, -45, 0), "rx rz"),
}

# Our joint: the bone whose end it is.
ENDS = {
    "lhip": "lhipjoint", "lknee": "lfemur", "lankle": "ltibia", "rhip": "rhipjoint", "rknee": "rfemur",
    "rankle": "rtibia", "spine": "lowerback", "thorax": "thorax", "headtop": "head", "lshoulder": "lclavicle",
    "lelbow": "lhumerus", "lwrist": "lwrist", "rshoulder": "rclavicle", "relbow": "rhumerus", "rwrist": "rwrist",
}  # fmt: skip

MM = 25.4 / 0.45

# cgspeed's names for MotionBuilder: joint, parent, the Acclaim bone that it turns as, the bone that it sits at the
# end of ("" = at its parent's place). Two bones have no place: thorax and wrist.
BVH_JOINTS = [
    ("Hips", "", "root", ""),
    ("LHipJoint", "Hips", "lhipjoint", ""),
    ("LeftUpLeg", "LHipJoint", "lfemur", "lhipjoint"),
    ("LeftLeg", "LeftUpLeg", "ltibia", "lfemur"),
    ("LeftFoot", "LeftLeg", "lfoot", "ltibia"),
    ("LeftToeBase", "LeftFoot", "ltoes", "lfoot"),
    ("RHipJoint", "Hips", "rhipjoint", ""),
    ("RightUpLeg", "RHipJoint", "rfemur", "rhipjoint"),
    ("RightLeg", "RightUpLeg", "rtibia", "rfemur"),
    ("RightFoot", "RightLeg", "rfoot", "rtibia"),
    ("RightToeBase", "RightFoot", "rtoes", "rfoot"),
    ("LowerBack", "Hips", "lowerback", ""),
    ("Spine", "LowerBack", "upperback", "lowerback"),
    ("Spine1", "Spine", "thorax", "upperback"),
    ("Neck", "Spine1", "lowerneck", ""),
    ("Neck1", "Neck", "upperneck", "lowerneck"),
    ("Head", "Neck1", "head", "upperneck"),
    ("LeftShoulder", "Spine1", "lclavicle", ""),
    ("LeftArm", "LeftShoulder", "lhumerus", "lclavicle"),
    ("LeftForeArm", "LeftArm", "lradius", "lhumerus"),
    ("LeftHand", "LeftForeArm", "lwrist", "lradius"),
    ("LeftFingerBase", "LeftHand", "lhand", ""),
    ("LeftHandIndex1", "LeftFingerBase", "lfingers", "lhand"),
    ("LThumb", "LeftHand", "lthumb", ""),
    ("RightShoulder", "Spine1", "rclavicle", ""),
    ("RightArm", "RightShoulder", "rhumerus", "rclavicle"),
    ("RightForeArm", "RightArm", "rradius", "rhumerus"),
    ("RightHand", "RightForeArm", "rwrist", "rradius"),
    ("RightFingerBase", "RightHand", "rhand", ""),
    ("RightHandIndex1", "RightFingerBase", "rfingers", "rhand"),
    ("RThumb", "RightHand", "rthumb", ""),
]


def motion(frames: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Return the values of each bone for a smooth synthetic motion: (frames, degrees of freedom), degrees."""
    random = np.random.default_rng(seed)
    time = np.arange(frames)[:, None] / 40
    values = {}
    for name, count in [("root", 6), *((name, len(bone[4].split())) for name, bone in BONES.items() if bone[4])]:
        size, phase = random.uniform(5, 35, count), random.uniform(0, 7, count)
        values[name] = size * np.sin(time * random.uniform(0.5, 2, count) + phase)
    values["root"][:, :3] = np.array([0, 16.5, 0]) + values["root"][:, :3] / 10
    return values


def write_asf(path: Path, scale: float = 1.0, unit: float = 0.45) -> Path:
    """Write the skeleton; ``scale`` changes the size of the person."""
    lines = ["# AST/ASF file generated using VICON BodyLanguage", ":version 1.10", ":name VICON", ":units"]
    lines += ["  mass 1.0", f"  length {unit}", "  angle deg", ":documentation", "   made up: by a test", ":root"]
    lines += ["   order TX TY TZ RX RY RZ", "   axis XYZ", "   position 0 0 0  ", "   orientation 0 0 0 ", ":bonedata"]
    for number, (name, (_, direction, length, axis, dof)) in enumerate(BONES.items(), 1):
        lines += ["  begin", f"     id {number} ", f"     name {name}"]
        lines += [f"     direction {' '.join(map(str, direction))} ", f"     length {length * scale} "]
        lines += [f"     axis {' '.join(map(str, axis))}  XYZ"]
        if dof:
            lines += [f"    dof {dof}", "    limits (-160.0 20.0)"]
            lines += ["           (-70.0 70.0)"] * (len(dof.split()) - 1)
        lines += ["  end"]
    lines += [":hierarchy", "  begin"]
    for parent in ("root", *BONES):
        children = [name for name, bone in BONES.items() if bone[0] == parent]
        if children:
            lines.append(f"    {parent} {' '.join(children)}")
    path.write_text("\n".join([*lines, "  end", ""]))
    return path


def write_amc(path: Path, values: dict[str, np.ndarray], first: int = 1) -> Path:
    """Write the motion, frames counted from ``first``."""
    lines = ["#!OML:ASF F:\\VICON\\USERDATA\\rory3.ASF", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(len(values["root"])):
        lines.append(str(first + frame))
        lines += [f"{name} {' '.join(f'{v:.9g}' for v in rows[frame])}" for name, rows in values.items()]
    path.write_text("\n".join([*lines, ""]))
    return path


def write_bvh(path: Path, values: dict[str, np.ndarray], scale: float = 1.0, rest: bool = True) -> Path:
    """Write the motion as cgspeed's conversion does: bones dropped, a rest pose first, channels Z Y X."""
    local = _local(values)
    frames = len(values["root"])
    lines = ["HIERARCHY", *_bvh_joint("Hips", 0, scale), "MOTION\r", f"Frames: {frames + rest}", "Frame Time: .0083333"]
    order = [name for name, *_ in _bvh_depth_first("Hips")]
    bone_of = {name: bone for name, _, bone, _ in BVH_JOINTS}
    angles = [local[bone_of[name]].as_euler("ZYX", degrees=True) for name in order]
    rows = np.concatenate([values["root"][:, :3], *angles], 1)
    if rest:
        still = np.zeros((1, rows.shape[1]))
        still[:, :3] = rows[:1, :3]
        rows = np.concatenate([still, rows])
    lines += [" ".join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join([*lines, ""]))
    return path


def _bvh_depth_first(name: str):
    yield next(joint for joint in BVH_JOINTS if joint[0] == name)
    for child in (joint[0] for joint in BVH_JOINTS if joint[1] == name):
        yield from _bvh_depth_first(child)


def _bvh_joint(name: str, depth: int, scale: float) -> list[str]:
    _, parent, bone, at = next(joint for joint in BVH_JOINTS if joint[0] == name)
    pad = "\t" * depth
    offset = np.multiply(BONES[at][1], BONES[at][2] * scale) if at else np.zeros(3)
    place = "Xposition Yposition Zposition " if not parent else ""
    lines = [f"{pad}{'JOINT' if parent else 'ROOT'} {name}", pad + "{", f"{pad}\tOFFSET {' '.join(map(str, offset))}"]
    lines.append(f"{pad}\tCHANNELS {3 + len(place.split())} {place}Zrotation Yrotation Xrotation ")
    children = [joint[0] for joint in BVH_JOINTS if joint[1] == name]
    for child in children:
        lines += _bvh_joint(child, depth + 1, scale)
    if not children:
        tip = np.multiply(BONES[bone][1], BONES[bone][2] * scale)
        lines += [f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\tOFFSET {' '.join(map(str, tip))}", pad + "\t}"]
    return [*lines, pad + "}"]


def _local(values: dict[str, np.ndarray]) -> dict[str, Rotation]:
    """Return each bone's rotation in its parent's frame."""
    found = {"root": Rotation.from_euler("xyz", values["root"][:, 3:], degrees=True)}
    for name, (_, _, _, axis, dof) in BONES.items():
        own = Rotation.from_euler("xyz", axis, degrees=True)
        full = np.zeros((len(values["root"]), 3))
        for column, letter in enumerate(word[1] for word in dof.split()):
            full[:, "xyz".index(letter)] = values[name][:, column]
        found[name] = own * Rotation.from_euler("xyz", full, degrees=True) * own.inv()
    return found


def expected(values: dict[str, np.ndarray], scale: float = 1.0, as_bvh: bool = False) -> dict[str, np.ndarray]:
    """Return our joint positions, mm: forward kinematics with scipy, with bones as lines.

    ``as_bvh``: with what a conversion without thorax and wrist is mended with.
    """
    local = _local(values)
    turned, ends = {"root": local["root"]}, {"root": values["root"][:, :3]}
    for name, (parent, direction, length, _, _) in BONES.items():
        vector = np.multiply(direction, length * scale)
        if as_bvh and name == "thorax":
            upper = BONES["upperback"]
            vector = np.array([0, np.linalg.norm(upper[1]) * upper[2] * scale, 0])
        turned[name] = turned[parent] * local[name]
        if as_bvh and name.endswith("wrist"):  # half a forearm further the same way
            forearm = BONES[parent]
            vector = np.multiply(forearm[1], forearm[2] * scale / 2)
            ends[name] = ends[parent] + turned[parent].apply(vector)
            continue
        ends[name] = ends[parent] + turned[name].apply(vector)
    joints = {joint: ends[bone] for joint, bone in ENDS.items()}
    joints["hip"] = (joints["lhip"] + joints["rhip"]) / 2
    head = float(np.linalg.norm(BONES["head"][1]) * BONES["head"][2] * scale)
    joints["nose"] = ends["upperneck"] + turned["head"].apply([0, 0, head])
    return {name: points * MM for name, points in joints.items()}
