"""Bodies that can be posed: a human one, and those that skeleton files spell out; forward kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.geometry.rigid import rotation_about
from uplift.skeleton import Skeleton

__all__ = [
    "DEFAULT_LIMITS",
    "ROOT_ANGLES",
    "Body",
    "find_legs",
    "forward_kinematics",
    "human_body",
    "is_human",
    "leaders",
    "leg_phases",
    "own_body",
    "rest_positions",
]

DEFAULT_LIMITS = {"flexion": (-25.0, 25.0), "abduction": (-15.0, 15.0), "rotation": (-10.0, 10.0)}
"""Degrees, where a skeleton gives no limits."""

ROOT_ANGLES = {"turn": (0.0, -1.0, 0.0), "pitch": (1.0, 0.0, 0.0), "roll": (0.0, 0.0, 1.0)}
"""Axes of the root's rotation: turn to its left, pitch forward, roll to its left, in that order."""

_FRONT, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True)
class Body:
    """Points in tree order (parents first), the rotations at them, and how skeleton joints sit on them."""

    points: tuple[str, ...]
    parents: Int[np.ndarray, " points"]
    """-1 for the root."""
    offsets: Float[np.ndarray, "points 3"]
    """From the parent, rest frame, body heights."""
    groups: tuple[str, ...]
    """Points of one group share a between-body length factor."""
    spread: float
    """Standard deviation of that factor."""
    angles: tuple[str, ...]
    """Names such as ``left_knee flexion``."""
    low_deg: Float[np.ndarray, " angles"]
    high_deg: Float[np.ndarray, " angles"]
    steps: tuple[tuple[int, int, tuple[float, float, float]], ...]
    """Rotations in the order they are applied: (point, angle, axis)."""
    joints: Float[np.ndarray, "joints points"]
    """Weights: each skeleton joint is a point or a mean of points."""
    scaled_axes: Bool[np.ndarray, " 3"]
    """Axes along which entire bodies are stretched (rigid objects)."""
    height: tuple[float, float] = (1000.0, 0.0)
    """Mean and standard deviation of the body height, in ``unit``."""
    unit: str = "relative"

    def angle(self, point: str, name: str) -> int:
        """Return the place of one angle of one point."""
        return self.angles.index(f"{point} {name}")


def rest_positions(
    parents: Int[np.ndarray, " points"], offsets: Float[np.ndarray, "*bodies points 3"]
) -> Float[np.ndarray, "*bodies points 3"]:
    """Return the points of the rest pose, root at the origin."""
    positions = np.array(offsets, dtype=float)
    for point, parent in enumerate(parents):
        positions[..., point, :] = 0.0 if parent < 0 else positions[..., parent, :] + offsets[..., point, :]
    return positions


def _angle_axes(direction: Float[np.ndarray, " 3"], side: float) -> dict[str, tuple[float, float, float]]:
    """Return the axes of flexion, abduction and rotation of a bone along ``direction`` in the rest frame.

    ``side`` is +1 for the body's left and its midline, -1 for its right.
    """
    along = direction / np.linalg.norm(direction)
    left = np.array([side, 0.0, 0.0])
    flexion = np.cross(along, _FRONT if abs(along @ _FRONT) < 0.9 else _UP)
    abduction = np.cross(along, left) if abs(along @ left) < 0.9 else np.cross(along, _UP)
    axes = {name: axis / np.linalg.norm(axis) for name, axis in (("flexion", flexion), ("abduction", abduction))}
    axes["rotation"] = side * along * np.sign(along @ -_UP or 1.0)
    return {name: tuple(axis.tolist()) for name, axis in axes.items()}


def _joint_weights(
    skeleton: Skeleton, parts: dict[str, tuple[str, ...]], points: tuple[str, ...], place: str
) -> Float[np.ndarray, "joints points"]:
    """Return the weights that make each joint of the skeleton the mean of its body points.

    Raises UserError where a joint has none or names a point the body lacks.
    """
    weights = np.zeros((len(skeleton.joints), len(points)))
    for row, joint in enumerate(skeleton.joints):
        names = parts.get(joint)
        if not names:
            raise UserError(
                f"Skeleton '{skeleton.name}', {place}: found nothing for joint '{joint}'; expected a point of the "
                f"body or a list of points. Add for example '{joint}: {points[0]}'."
            )
        for name in names:
            if name not in points:
                raise UserError(
                    f"Skeleton '{skeleton.name}', {place}: the body has no point '{name}' (joint '{joint}')."
                    + did_you_mean(name, points)
                )
            weights[row, points.index(name)] += 1 / len(names)
    return weights


def forward_kinematics(
    body: Body, offsets: Float[np.ndarray, "frames points 3"], angles_deg: Float[np.ndarray, "frames angles"]
) -> Float[np.ndarray, "frames points 3"]:
    """Return the points of a posed body in its rest frame, root at the origin."""
    angles = np.radians(angles_deg)
    steps: dict[int, list] = {}
    for point, angle, axis in body.steps:
        steps.setdefault(point, []).append((angle, axis))
    positions = np.zeros_like(offsets)
    rotations: dict[int, np.ndarray] = {}
    for point, parent in enumerate(body.parents):
        rotation = rotations.get(int(parent))
        if parent >= 0:
            offset = offsets[:, point]
            offset = offset if rotation is None else np.einsum("fij,fj->fi", rotation, offset)
            positions[:, point] = positions[:, parent] + offset
        for angle, axis in steps.get(point, ()):
            local = rotation_about(axis, angles[:, angle])
            rotation = local if rotation is None else rotation @ local
        if rotation is not None:
            rotations[point] = rotation
    return positions


def find_legs(body: Body) -> list[list[int]]:
    """Return legs as chains of points from hip to foot: limbs whose ends rest near the floor."""
    rest = rest_positions(body.parents, body.offsets)
    height = np.ptp(rest[:, 1]) or 1.0
    legs = []
    for point in range(len(body.points)):
        if (body.parents == point).any() or rest[point, 1] < rest[:, 1].max() - 0.15 * height:
            continue
        leg = [point]
        while (parent := int(body.parents[leg[0]])) > 0 and abs(rest[parent, 0]) > 1e-6:
            leg.insert(0, parent)
        if len(leg) > 1 and rest[point, 1] - rest[leg[0], 1] > 0.2 * height:
            legs.append(leg)
    return legs


def leg_phases(body: Body, legs: list[list[int]], gait: str) -> Float[np.ndarray, " legs"]:
    """Return each leg's place in the cycle: left and right opposed, rows opposed (trot, tripod) or a quarter behind.

    Walk is the lateral sequence, hind foot before fore foot of one side; trot moves diagonal pairs
    (Hildebrand 1965, Science 150); alternating rows give insects their tripod gait.
    """
    rest = rest_positions(body.parents, body.offsets)
    hips = np.array([rest[leg[0]] for leg in legs])
    rows = np.unique(np.round(hips[:, 2] / (np.ptp(rest, 0).max() * 0.1 + 1e-9)), return_inverse=True)[1]
    lag = 0.25 if gait == "walk" and rows.max() == 1 else 0.5
    return 0.5 * (hips[:, 0] < 0) + lag * (rows.max() - rows)


# The body that a skeleton's YAML describes by proportions, rest directions and limits.


def own_body(skeleton: Skeleton) -> Body:
    """Return the body of ``proportions``, ``rest`` and ``limits``; raises UserError saying what to add."""
    _check_complete(skeleton)
    order = _tree_order(skeleton)
    parents = np.array([order.index(p) if (p := skeleton.parents[joint]) is not None else -1 for joint in order])
    offsets = np.array([_offset(skeleton, joint) for joint in order])
    # Mirror partners vary together; in a rigid object so do all bones of one length.
    if skeleton.rigid:
        groups = tuple(f"{np.linalg.norm(offset):.4f}" for offset in offsets)
        angles, steps = {}, []
    else:
        groups = tuple(min(joint, _partners(skeleton).get(joint, joint)) for joint in order)
        angles, steps = _free_angles(skeleton, order, parents, offsets)
    places = {joint: skeleton.midpoints.get(joint, (joint,)) for joint in skeleton.joints}
    return Body(
        points=order,
        parents=parents,
        offsets=offsets,
        groups=groups,
        spread=0.08 if skeleton.rigid else 0.06,
        **_with_root(order, angles, steps),
        joints=_joint_weights(skeleton, places, order, "midpoints"),
        scaled_axes=np.full(3, skeleton.rigid),
    )


def _free_angles(skeleton: Skeleton, order: tuple[str, ...], parents: np.ndarray, offsets: np.ndarray) -> tuple:
    """Return the limits of each angle, and steps (angle, point, axis), of joints that have bones to move."""
    angles, steps = {}, []
    limits, partner, rest = _all_limits(skeleton), _partners(skeleton), rest_positions(parents, offsets)
    for point, joint in enumerate(order):
        direction = _beyond(point, parents, offsets)
        if direction is None:
            continue
        is_right = joint in partner and rest[point, 0] < rest[order.index(partner[joint]), 0]
        axes = _angle_axes(direction, -1.0 if is_right else 1.0)
        for name, (low, high) in limits[joint].items():
            if (low, high) != (0, 0):
                angles[f"{joint} {name}"] = (low, high)
                steps.append((f"{joint} {name}", point, axes[name]))
    return angles, steps


def _with_root(points: tuple[str, ...], angles: dict[str, tuple], steps: list) -> dict[str, Any]:
    """Return the fields of a `Body` made of its angles and of ``steps`` (angle, point, axis), the root's own first."""
    root = {f"{points[0]} {name}": axis for name, axis in ROOT_ANGLES.items()}
    angles = {**dict.fromkeys(root, (-np.inf, np.inf)), **angles}
    names, bounds = tuple(angles), np.array(list(angles.values()), dtype=float)
    steps = [*((name, 0, axis) for name, axis in root.items()), *steps]
    return {
        "angles": names,
        "low_deg": bounds[:, 0],
        "high_deg": bounds[:, 1],
        "steps": tuple((point, names.index(name), axis) for name, point, axis in steps),
    }


def leaders(skeleton: Skeleton) -> dict[str, str]:
    """Return which joint follows which, from ``follows`` in the limits, mirror partners included."""
    given = skeleton.body.get("limits", {})
    partner = _partners(skeleton)
    found = {}
    for joint, entry in given.items():
        if isinstance(entry, dict) and "follows" in entry:
            found[joint] = entry["follows"]
            if joint in partner and partner[joint] not in given:
                found[partner[joint]] = partner.get(entry["follows"], entry["follows"])
    return found


def _partners(skeleton: Skeleton) -> dict[str, str]:
    return {a: b for pair in skeleton.mirror for a, b in (pair, pair[::-1])}


def _check_complete(skeleton: Skeleton) -> None:
    partner = _partners(skeleton)
    for key, example, meaning in (
        ("proportions", "0.2", "length of the bone to its parent, in body heights"),
        ("rest", "[0.3, 1, 0]", "direction from its parent in the rest pose: x the body's left, y down, z behind"),
    ):
        given = skeleton.body.get(key, {})
        placed = {skeleton.root, *skeleton.midpoints, *given, *(partner.get(joint) for joint in given)}
        missing = [joint for joint in skeleton.joints if joint not in placed]
        if not missing:
            continue
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise UserError(
            f"Skeleton '{skeleton.name}' cannot be simulated: '{key}' lacks {shown}. Add to its YAML "
            f"'{key}: {{{missing[0]}: {example}, ...}}' ({meaning}), or for a person 'limits: "
            f"{{{skeleton.root}: {{human: pelvis}}, ...}}'."
        )


def _tree_order(skeleton: Skeleton) -> tuple[str, ...]:
    order = [skeleton.root]
    for joint in order:
        order += [j for j in skeleton.joints if skeleton.parents.get(j) == joint]
    return tuple(order)


def _offset(skeleton: Skeleton, joint: str) -> Float[np.ndarray, " 3"]:
    """Return the bone to the parent in the rest pose; a side that is not given is the mirror of the other."""
    if joint == skeleton.root:
        return np.zeros(3)
    proportions, rest = skeleton.body.get("proportions", {}), skeleton.body.get("rest", {})
    partner = _partners(skeleton).get(joint, joint)
    if joint not in rest and partner not in rest:
        return np.zeros(3)
    direction = np.array(rest[joint] if joint in rest else np.multiply(rest[partner], [-1, 1, 1]), dtype=float)
    length = proportions.get(joint, proportions.get(partner, 0.0))
    return length * direction / np.linalg.norm(direction)


def _beyond(point: int, parents: np.ndarray, offsets: np.ndarray) -> np.ndarray | None:
    """Return the mean of the bones that a joint moves; None for an end. Falls back to the bone before it."""
    children = np.flatnonzero(parents == point)
    if not len(children):
        return None
    mean = offsets[children].mean(0)
    if np.linalg.norm(mean) < 1e-6:
        mean = offsets[children[0]]
    return mean if np.linalg.norm(mean) > 1e-6 else np.array([0.0, 1.0, 0.0])


def _all_limits(skeleton: Skeleton) -> dict[str, dict[str, tuple[float, float]]]:
    given = skeleton.body.get("limits", {})
    partner = _partners(skeleton)
    read = {joint: _read_limits(skeleton, joint, entry) for joint, entry in given.items()}
    default = dict.fromkeys(skeleton.joints, DEFAULT_LIMITS) | {skeleton.root: {}}
    return {j: read.get(j, read.get(partner.get(j, j), default[j])) for j in skeleton.joints}


def _read_limits(skeleton: Skeleton, joint: str, entry: Any) -> dict[str, tuple[float, float]]:
    place = f"Skeleton '{skeleton.name}', limits of '{joint}'"
    form = "expected {flexion: [low, high], abduction: ..., rotation: ...} in degrees."
    if not isinstance(entry, dict):
        raise UserError(f"{place}: found {entry!r}; {form}")
    limits = {}
    for name, value in entry.items():
        if name == "follows":
            if value not in skeleton.joints:
                raise UserError(f"{place}: it follows '{value}', not a joint.{did_you_mean(value, skeleton.joints)}")
            continue
        if name not in DEFAULT_LIMITS:
            raise UserError(f"{place}: found the unknown angle '{name}'.{did_you_mean(name, DEFAULT_LIMITS)}")
        numbers = isinstance(value, list) and len(value) == 2 and all(isinstance(v, (int, float)) for v in value)
        if not numbers or not -360 <= value[0] <= value[1] <= 360:
            raise UserError(f"{place}: found {name}: {value!r}; {form}")
        limits[name] = (float(value[0]), float(value[1]))
    return {name: limits[name] for name in DEFAULT_LIMITS if name in limits}


# The simulator's human body: joint centres and landmarks, segment lengths and ranges of motion.

_KEY = "human"
"""The key of a joint's limits that puts it on this body."""

# point: (parent, group of lengths, x left, y down, z behind); "left_" points have a right twin.
_POINTS = {
    "pelvis": ("", "", 0, 0, 0),
    "left_hip": ("pelvis", "hip width", 0.050, 0, 0),
    "left_knee": ("left_hip", "thigh", 0, 0.2425, 0),
    "left_ankle": ("left_knee", "shank", 0, 0.2493, 0),
    "left_heel": ("left_ankle", "foot", 0, 0.034, 0.036),
    "left_foot": ("left_ankle", "foot", -0.002, 0.034, -0.075),
    "left_big_toe": ("left_ankle", "foot", -0.012, 0.034, -0.112),
    "left_small_toe": ("left_ankle", "foot", 0.024, 0.034, -0.088),
    "lumbar": ("pelvis", "trunk", 0, -0.050, 0.012),
    "spine": ("lumbar", "trunk", 0, -0.095, 0.004),
    "thorax": ("spine", "trunk", 0, -0.155, -0.012),
    "left_clavicle": ("thorax", "trunk", 0.012, 0.012, -0.030),
    "left_shoulder": ("left_clavicle", "shoulder width", 0.090, -0.008, 0.030),
    "left_elbow": ("left_shoulder", "upper arm", 0, 0.162, 0),
    "left_wrist": ("left_elbow", "forearm", 0, 0.154, 0),
    "left_hand": ("left_wrist", "hand", 0, 0.050, 0),
    "left_thumb": ("left_wrist", "hand", 0.024, 0.028, -0.010),
    "left_index": ("left_wrist", "hand", 0.014, 0.050, 0),
    "left_pinky": ("left_wrist", "hand", -0.024, 0.044, 0),
    "left_fingertip": ("left_wrist", "hand", 0, 0.106, 0),
    "neck": ("thorax", "neck", 0, -0.030, 0.010),
    "head": ("neck", "neck", 0, -0.068, -0.014),
    "headtop": ("head", "head", 0, -0.088, -0.004),
    "nose": ("head", "head", 0, -0.003, -0.070),
    "chin": ("head", "head", 0, 0.042, -0.052),
    "left_mouth": ("head", "head", 0.014, 0.016, -0.058),
    "left_eye": ("head", "head", 0.018, -0.022, -0.054),
    "left_eye_inner": ("head", "head", 0.009, -0.022, -0.056),
    "left_eye_outer": ("head", "head", 0.026, -0.022, -0.050),
    "left_ear": ("head", "head", 0.043, -0.013, 0),
}

# point: angle: (axis of a left or midline point in the rest frame, low, high). A name after "-" undoes
# an angle: raising the arm in its plane does not twist it, the clavicle moves the shoulder but does
# not turn the arm (elevation is counted from the thorax, as in the published ranges).
_ANGLES = {
    "lumbar": {"flexion": ((1, 0, 0), -15, 50), "lateral": ((0, 0, 1), -18, 18), "rotation": ((0, -1, 0), -10, 10)},
    "spine": {"flexion": ((1, 0, 0), -15, 35), "lateral": ((0, 0, 1), -20, 20), "rotation": ((0, -1, 0), -35, 35)},
    "neck": {"flexion": ((1, 0, 0), -30, 25), "lateral": ((0, 0, 1), -22, 22), "rotation": ((0, -1, 0), -35, 35)},
    "head": {"flexion": ((1, 0, 0), -25, 20), "lateral": ((0, 0, 1), -18, 18), "rotation": ((0, -1, 0), -40, 40)},
    "left_clavicle": {"elevation": ((0, 0, -1), -5, 32), "protraction": ((0, 1, 0), -20, 25)},
    "left_shoulder": {
        "-clavicle protraction": ((0, -1, 0), 0, 0), "-clavicle elevation": ((0, 0, 1), 0, 0),
        "plane": ((0, 1, 0), -95, 130), "elevation": ((0, 0, -1), 0, 175), "-plane": ((0, -1, 0), 0, 0),
        "rotation": ((0, 1, 0), -80, 80),
    },
    "left_elbow": {"flexion": ((-1, 0, 0), 2, 148), "pronation": ((0, 1, 0), -5, 150)},
    "left_wrist": {"flexion": ((-1, 0, 0), -60, 70), "deviation": ((0, 0, 1), -20, 30)},
    "left_hip": {"flexion": ((-1, 0, 0), -25, 140), "abduction": ((0, 0, -1), -28, 60), "rotation": ((0, 1, 0), -50, 42)},
    "left_knee": {"flexion": ((1, 0, 0), 3, 146)},
    "left_ankle": {"flexion": ((-1, 0, 0), -50, 28)},
}  # fmt: skip


def is_human(skeleton: Skeleton) -> bool:
    """Return whether the skeleton puts its joints on the human body."""
    return any(isinstance(entry, dict) and _KEY in entry for entry in skeleton.body.get("limits", {}).values())


def human_body(skeleton: Skeleton) -> Body:
    """Return the human body with the joints of ``skeleton`` on it; raises UserError where one has no place."""
    table = dict(_both_sides(_POINTS))
    points = tuple(table)
    angles: dict[str, tuple[float, float]] = {}
    steps = []
    for point, entries in _both_sides(_ANGLES):
        side = point.partition("_")[0]
        sign = -1.0 if side == "right" else 1.0
        for name, (axis, low, high) in entries.items():
            of = f"{side}_{name[1:]}" if name.startswith("-clavicle") else f"{point} {name.lstrip('-')}"
            steps.append((of, points.index(point), (float(axis[0]), sign * axis[1], sign * axis[2])))
            if not name.startswith("-"):
                angles[of] = (low, high)
    offsets = np.array([entry[2:] for entry in table.values()], dtype=float)
    offsets[[point.startswith("right_") for point in points], 0] *= -1
    return Body(
        points=points,
        parents=np.array([points.index(entry[0]) if entry[0] else -1 for entry in table.values()]),
        offsets=offsets,
        groups=tuple(entry[1] for entry in table.values()),
        spread=0.035,
        **_with_root(points, angles, steps),
        joints=_joint_weights(skeleton, _places(skeleton), points, "limits"),
        scaled_axes=np.zeros(3, bool),
        height=(1692.0, 92.0),
        unit="mm",
    )


def _places(skeleton: Skeleton) -> dict[str, tuple[str, ...]]:
    """Return the points of the body that each joint is the mean of."""
    places: dict[str, tuple[str, ...]] = {}
    for joint, entry in skeleton.body["limits"].items():
        point = entry.get(_KEY) if isinstance(entry, dict) else None
        names = tuple(str(name) for name in point) if isinstance(point, list) else (str(point),)
        if point is None or set(entry) != {_KEY}:
            raise UserError(
                f"Skeleton '{skeleton.name}', limits of '{joint}': found {entry!r}; other joints are on the human "
                f"body, so expected {{{_KEY}: a point of it, or a list of points}}."
            )
        places[joint] = names
    unused = [key for key in ("proportions", "rest") if skeleton.body.get(key)]
    if unused:
        raise UserError(
            f"Skeleton '{skeleton.name}': found '{unused[0]}' beside limits that put joints on the human body, which "
            f"brings its own. Remove '{unused[0]}', or the '{_KEY}:' places."
        )
    return places


def _both_sides(table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the entries of a table, each left point followed by its right twin."""
    for point, entry in table.items():
        yield point, entry
        if point.startswith("left_"):
            twin = entry if isinstance(entry, dict) else (entry[0].replace("left_", "right_"), *entry[1:])
            yield point.replace("left_", "right_"), twin
