"""A human body of rigid segments and joints for OpenSim, as large as the predicted one: bodies, coordinates, markers."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import shipped_names
from uplift.data.synthetic.body import human_body, is_human, rest_positions
from uplift.errors import UserError, listed
from uplift.geometry.rigid import nearest_rotation, rotation_about
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["Coordinate", "HumanModel", "human_model", "model_xml"]

# What the model is made of. Points are those of the simulator's human body, which skeleton files name.


class _Turn(NamedTuple):
    """A coordinate that turns a body: its name, its axis on the right side, its range in degrees."""

    name: str
    axis: tuple[float, float, float]
    low: float
    high: float
    needs: tuple[str, ...] = ()
    """Points of which one must be seen; without any, nothing shows this coordinate, and the model has none."""


class _Part(NamedTuple):
    """A body, and the joint that holds it; ``{side}`` is left or right, ``{s}`` l or r."""

    body: str
    parent: str
    joint: str
    centre: str
    """The point of the joint's centre."""
    holds: tuple[str, ...]
    """Points that are rigid with it."""
    needs: tuple[tuple[str, ...], ...]
    """Of each of these groups one must be seen; else the model has no such body."""
    turns: tuple[_Turn, ...]
    mass: float
    """Share of the body's mass: de Leva 1996 (J Biomech 29), table 4, mean of women and men."""
    end: tuple[str, float]
    """Where the ellipsoid that stands for it ends: a point, and the place of its centre of mass on the way there."""
    radii: tuple[float, float]
    """Half of its thickness to the front and to the side, body heights."""


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_FACE = ("nose", "chin", *(f"{side}_{part}" for side in ("left", "right")
         for part in ("eye", "eye_inner", "eye_outer", "ear", "mouth")))  # fmt: skip
_TOES = ("{side}_big_toe", "{side}_small_toe", "{side}_foot")
_PARTS = (
    _Part("pelvis", "", "ground_pelvis", "pelvis", ("left_hip", "right_hip", "lumbar"), (), (
        _Turn("pelvis_rotation", _Y, -180, 180), _Turn("pelvis_list", _X, -90, 90), _Turn("pelvis_tilt", _Z, -180, 180),
    ), 0.1182, ("trunk", 0.5), (0.06, 0.09)),
    _Part("torso", "pelvis", "back", "trunk",
          ("spine", "thorax", "neck", "left_clavicle", "right_clavicle", "left_shoulder", "right_shoulder"), (), (
        _Turn("lumbar_extension", _Z, -100, 60, ("lumbar", "spine")), _Turn("lumbar_bending", _X, -60, 60),
        _Turn("lumbar_rotation", _Y, -90, 90),
    ), 0.3120, ("thorax", 0.5), (0.06, 0.095)),
    _Part("head", "torso", "neck", "thorax", ("head", "headtop", *_FACE), (("head", "headtop", *_FACE),), (
        _Turn("neck_extension", _Z, -80, 80), _Turn("neck_bending", _X, -60, 60),
        _Turn("neck_rotation", _Y, -100, 100, _FACE),
    ), 0.0681, ("headtop", 0.6), (0.05, 0.04)),
    _Part("femur_{s}", "pelvis", "hip_{s}", "{side}_hip", ("{side}_knee",), (("{side}_knee",),), (
        _Turn("hip_flexion_{s}", _Z, -40, 150), _Turn("hip_adduction_{s}", _X, -70, 50),
        _Turn("hip_rotation_{s}", _Y, -70, 70, ("{side}_ankle",)),
    ), 0.1447, ("{side}_knee", 0.385), (0.045, 0.045)),
    _Part("tibia_{s}", "femur_{s}", "knee_{s}", "{side}_knee", ("{side}_ankle",), (("{side}_ankle",),), (
        _Turn("knee_angle_{s}", (0.0, 0.0, -1.0), -10, 165),
    ), 0.0457, ("{side}_ankle", 0.44), (0.03, 0.03)),
    _Part("calcn_{s}", "tibia_{s}", "ankle_{s}", "{side}_ankle", ("{side}_heel", *_TOES), (("{side}_heel", *_TOES),), (
        _Turn("ankle_angle_{s}", _Z, -70, 50),
        _Turn("subtalar_angle_{s}", (0.787, 0.605, -0.121), -40, 40, ("{side}_heel",)),
    ), 0.0133, ("{side}_foot", 0.5), (0.075, 0.025)),
    _Part("humerus_{s}", "torso", "shoulder_{s}", "{side}_shoulder", ("{side}_elbow",), (("{side}_elbow",),), (
        _Turn("arm_flex_{s}", _Z, -90, 180), _Turn("arm_add_{s}", _X, -180, 90),
        _Turn("arm_rot_{s}", _Y, -120, 120, ("{side}_wrist",)),
    ), 0.0263, ("{side}_elbow", 0.576), (0.025, 0.025)),
    _Part("forearm_{s}", "humerus_{s}", "elbow_{s}", "{side}_elbow", ("{side}_wrist",), (("{side}_wrist",),), (
        _Turn("elbow_flex_{s}", _Z, -10, 165),
    ), 0.0150, ("{side}_wrist", 0.457), (0.02, 0.02)),
    _Part("hand_{s}", "forearm_{s}", "wrist_{s}", "{side}_wrist",
          ("{side}_hand", "{side}_thumb", "{side}_index", "{side}_pinky", "{side}_fingertip"),
          (("{side}_index",), ("{side}_pinky",)), (
        _Turn("pro_sup_{s}", _Y, -20, 180), _Turn("wrist_flex_{s}", _Z, -90, 90), _Turn("wrist_dev_{s}", _X, -40, 50),
    ), 0.0059, ("{side}_fingertip", 0.5), (0.012, 0.022)),
)  # fmt: skip
"""The axes of a body are x to the front, y up, z to the right, in every joint's neutral position.

Names, signs and orders of the coordinates are those of Rajagopal et al. 2016 (IEEE TBME 63), but for the pelvis, which
is turned, listed and tilted in that order (Baker 2001, Gait & Posture 13): people in front of a camera face any way.
The axis of the subtalar joint is that of Delp et al. 1990 (IEEE TBME 37).
"""
_NEEDED = ("left_hip", "right_hip", "left_knee", "right_knee", "left_shoulder", "right_shoulder")
_MOST_FRAMES = 2000  # that lengths are taken from


def _parts() -> list[tuple[_Part, float]]:
    """Return all parts, parents first, and -1 for those of the left, 1 for the others."""
    found: list[tuple[_Part, float]] = []
    for part in _PARTS:
        sides = (("right", "r", 1.0), ("left", "l", -1.0)) if "{s}" in part.body else (("", "", 1.0),)
        found += [(_of_side(part, side, letter), sign) for side, letter, sign in sides]
    return found


def _of_side(part, side: str, letter: str):
    """Return nested tuples with the side in their texts."""
    if isinstance(part, str):
        return part.format(side=side, s=letter)
    if not isinstance(part, tuple):
        return part
    inner = [_of_side(one, side, letter) for one in part]
    return type(part)(*inner) if hasattr(part, "_fields") else tuple(inner)


# Where the points of the body are in the poses.

_FROM_REST = np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0]], float)
"""From the simulator's axes (x left, y down, z behind) to those of OpenSim's bodies."""


@dataclass(frozen=True)
class _Seen:
    """The joints of poses, metres, as points of the human body."""

    skeleton: Skeleton
    joints: tuple[str, ...]
    points: Float[np.ndarray, "frames joints 3"]
    names: tuple[str, ...]
    weights: Float[np.ndarray, "joints points"]
    """Each joint as a mean of points; zeros for one that is not on the body."""
    rest: Float[np.ndarray, "points 3"]
    """Of the neutral body, body heights, in OpenSim's axes."""

    def has(self, *points: str) -> bool:
        """Return whether one of the points is a joint by itself."""
        return any(self._exact(self._row(point)) is not None for point in points if point in self.names)

    def made_of(self, joint: str) -> tuple[str, ...]:
        """Return the points that a joint is the mean of."""
        return tuple(self.names[place] for place in np.flatnonzero(self.weights[self.joints.index(joint)]))

    def track(self, key: str) -> Float[np.ndarray, "frames 3"]:
        """Return where a joint, or ``@`` and a point, is in each frame."""
        if not key.startswith("@"):
            return self.points[:, self.joints.index(key)]
        exact = self._exact(self._row(key[1:]))
        if exact is not None:
            return self.points[:, exact]
        made = {"pelvis": ("@left_hip", "@right_hip"), "thorax": ("@left_shoulder", "@right_shoulder")}
        if key != "@trunk":
            return np.mean([self.track(one) for one in made[key[1:]]], 0)
        return (1 - self._loins) * self.track("@pelvis") + self._loins * self.track("@thorax")

    def place(self, key: str) -> Float[np.ndarray, " 3"]:
        """Return where a joint or point is on the neutral body."""
        if key == "@trunk" and not self.has(self.trunk):  # where `track` has it
            return (1 - self._loins) * self.place("@pelvis") + self._loins * self.place("@thorax")
        row = self._row(key[1:]) if key.startswith("@") else self.weights[self.joints.index(key)]
        return row @ self.rest

    @cached_property
    def trunk(self) -> str:
        """The point that pelvis and trunk turn about: where there is no joint between them, at the loins."""
        return "spine" if self.has("spine") and not self.has("lumbar") else "lumbar"

    @property
    def _loins(self) -> float:
        """How far up the line from the hips to the shoulders the trunk bends."""
        return self.rest[self.names.index("lumbar"), 1] / self.rest[self.names.index("thorax"), 1]

    def _row(self, point: str) -> Float[np.ndarray, " points"]:
        return np.eye(len(self.names))[self.names.index(self.trunk if point == "trunk" else point)]

    def _exact(self, row: np.ndarray) -> int | None:
        """Return the joint that is these points: the middle of the hips is the pelvis, that of the shoulders the thorax."""
        rows = [row]
        for middle, pair in (("pelvis", "hip"), ("thorax", "shoulder")):
            if row[self.names.index(middle)] == 1:
                rows.append((self._row(f"left_{pair}") + self._row(f"right_{pair}")) / 2)
        found = [place for one in rows for place in np.flatnonzero((self.weights == one).all(1))]
        return int(found[0]) if found else None


def _seen(skeleton: Skeleton, joints: Sequence[str], points_mm: Float[np.ndarray, "frames joints 3"]) -> _Seen:
    """Return the joints on the human body; raises UserError for a skeleton that is no person's."""
    like = skeleton if is_human(skeleton) else _human_of(skeleton)
    body = human_body(like)
    rows = {joint: body.joints[place] for place, joint in enumerate(like.joints)}
    weights = np.array([rows.get(joint, np.zeros(len(body.points))) for joint in joints])
    rest = rest_positions(body.parents, body.offsets) @ _FROM_REST.T
    seen = _Seen(skeleton, tuple(joints), points_mm / 1000, body.points, weights, rest)
    missing = [point for point in _NEEDED if not seen.has(point)]
    if missing:
        raise UserError(
            f"OpenSim's model is of a person, and skeleton '{skeleton.name}' has no {listed(missing, 3)}. For a person with "
            "joints of other names, say in its YAML which they are: limits: {JOINT: {human: POINT}} (docs/opensim.md)."
        )
    return seen


def _human_of(skeleton: Skeleton) -> Skeleton:
    """Return the shipped human skeleton that shares most names of joints with this one, which says no places on the body."""
    people = [one for name in shipped_names("skeletons") if is_human(one := load_skeleton(name))]
    return max(people, key=lambda one: len(set(one.joints) & set(skeleton.joints)))


# Segments of one shape, from the distances between what is on them.


def _shape(seen: _Seen, keys: Sequence[str]) -> Float[np.ndarray, "keys 3"]:
    """Return where joints and points of one rigid segment are, metres, relative to the first, turned as in the neutral body.

    The shape has the median distances of the poses, of both sides (classical scaling: Torgerson 1952).
    """
    twins = [_mirrored(seen, key) for key in keys]
    squared = ((_distances(seen, keys) + _distances(seen, twins)) / 2) ** 2
    middle = np.eye(len(keys)) - 1 / len(keys)
    values, vectors = np.linalg.eigh(-middle @ squared @ middle / 2)
    found = (vectors * np.sqrt(np.maximum(values, 0)))[:, ::-1][:, :3]
    found = np.pad(found, ((0, 0), (0, 3 - found.shape[1])))
    rest = np.array([seen.place(key) for key in keys])
    # Distances do not tell a shape from its mirror image, the neutral body does.
    turn, _ = nearest_rotation((rest - rest.mean(0)).T @ found, reflect=True)
    found = found @ turn.T
    return found - found[0]


def _distances(seen: _Seen, keys: Sequence[str]) -> Float[np.ndarray, "keys keys"]:
    every = -(-len(seen.points) // _MOST_FRAMES)
    tracks = np.stack([seen.track(key)[::every] for key in keys], 1)
    known = np.isfinite(tracks).all((1, 2))
    return np.median(np.linalg.norm(tracks[known, :, None] - tracks[known, None], axis=-1), axis=0)


def _mirrored(seen: _Seen, key: str) -> str:
    """Return the joint or point of the other side, itself on the midline."""
    if not key.startswith("@"):
        pairs = {one: other for pair in seen.skeleton.mirror for one, other in (pair, pair[::-1])}
        return pairs.get(key, key)
    swap = {"left": "right", "right": "left"}
    side, _, rest = key[1:].partition("_")
    return f"@{swap[side]}_{rest}" if side in swap else key


# The model.


class Coordinate(NamedTuple):
    """A coordinate of the model: degrees, or metres along an axis."""

    name: str
    axis: tuple[float, float, float]
    low: float
    high: float
    start: Float[np.ndarray, " frames"]
    """What the directions of the segments say it is, NaN where they are not known: where to look for the solution."""

    @property
    def metres(self) -> bool:
        """Whether it moves the body, rather than turns it."""
        return self.name.startswith(("pelvis_tx", "pelvis_ty", "pelvis_tz"))

    @property
    def first(self) -> float:
        """The first known of ``start``, which the model stands in; 0 without any."""
        known = self.start[np.isfinite(self.start)]
        return float(known[0]) if len(known) else 0.0


class Segment(NamedTuple):
    """A rigid body, metres and kilograms, in its own axes with the joint to its parent at 0."""

    name: str
    parent: str
    joint: str
    at: Float[np.ndarray, " 3"]
    """Of the joint, on the parent."""
    turns: tuple[Coordinate | None, ...]
    """Three at most; None for one that nothing shows."""
    mass: float
    centre: Float[np.ndarray, " 3"]
    """Of mass."""
    middle: Float[np.ndarray, " 3"]
    """Of the ellipsoid that stands for it."""
    radii: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class HumanModel:
    """A scaled human body and its markers, which are the joints of a skeleton by their names."""

    segments: tuple[Segment, ...]
    shifts: tuple[Coordinate, ...]
    """The place of the pelvis, metres."""
    markers: dict[str, tuple[str, Float[np.ndarray, " 3"]]]
    """The body and the place on it, metres, of each joint that is on one."""
    unseen: tuple[str, ...]
    """Coordinates that the joints do not show, and the model does not have."""


def human_model(
    skeleton: Skeleton,
    joints: Sequence[str],
    points: Float[np.ndarray, "frames joints 3"],
    mass_kg: float = 70.0,
) -> HumanModel:
    """Return a human body with the proportions of poses, ``points`` in mm with y up, that starts as the first of them stands.

    The lengths are medians over the frames, and the same on both sides. Segments and coordinates that the joints do
    not show are left out: without toes there is no ankle, without a joint between hips and shoulders the loins do
    not bend to the front. The mass is shared out as in de Leva 1996; a segment that is left out counts to its parent.

    Raises:
        UserError: a skeleton without hips, knees or shoulders of a human body, or no frame in which they are known.
    """
    seen = _seen(skeleton, joints, points)
    if not np.isfinite(np.stack([seen.track(f"@{point}") for point in _NEEDED], 1)).all((1, 2)).any():
        raise UserError("OpenSim: no frame has hips, knees and shoulders. Check the input file.")
    parts = [(part, sign) for part, sign in _parts()]
    kept: dict[str, tuple[_Part, float]] = {}
    for part, sign in parts:
        if part.parent in ("", *kept) and all(seen.has(*group) for group in part.needs):
            kept[part.body] = (part, sign)
    masses, stature = _masses(parts, kept), _stature(seen)
    segments, markers, places = [], {}, {}
    turned = {"": np.broadcast_to(np.eye(3), (len(points), 3, 3))}
    for name, (part, sign) in kept.items():
        held, keys = _held(seen, part, kept)
        shape = dict(zip(keys, _shape(seen, keys), strict=True))
        places |= {(name, key): place for key, place in shape.items()}
        markers |= {joint: (name, shape[joint]) for joint in held if joint not in markers}
        at = places.get((part.parent, f"@{part.centre}"), np.zeros(3))
        turns, turned[name] = _turns(seen, part, sign, shape, turned[part.parent])
        segments.append(_segment(part, at, turns, shape, mass_kg * masses[name], stature, seen))
    shifts = [
        Coordinate(f"pelvis_t{letter}", axis, -1000.0, 1000.0, place)
        for letter, axis, place in zip("xyz", (_X, _Y, _Z), seen.track("@pelvis").T, strict=True)
    ]
    there = {turn.name for segment in segments for turn in segment.turns if turn}
    unseen = [turn.name for part, _ in parts for turn in part.turns if turn.name not in there]
    return HumanModel(tuple(segments), tuple(shifts), markers, tuple(unseen))


def _held(seen: _Seen, part: _Part, kept: dict[str, tuple[_Part, float]]) -> tuple[list[str], list[str]]:
    """Return the joints on a part, and the keys of its shape: its centre, these joints, its end, the centres of its children."""
    there = {part.centre, *part.holds} | ({seen.trunk} if "trunk" in part.centre or part.end[0] == "trunk" else set())
    held = [joint for joint in seen.joints if seen.made_of(joint) and set(seen.made_of(joint)) <= there]
    children = [f"@{child.centre}" for child, _ in kept.values() if child.parent == part.body]
    end = [f"@{part.end[0]}"] if part.end[0] in part.holds and seen.has(part.end[0]) else []
    return held, list(dict.fromkeys([f"@{part.centre}", *held, *end, *children]))


def _masses(parts: Sequence[tuple[_Part, float]], kept: dict[str, tuple[_Part, float]]) -> dict[str, float]:
    """Return shares of the mass; what is left out counts to its parent."""
    shares = {part.body: part.mass for part, _ in parts}
    total = sum(shares.values())
    for part, _ in reversed(parts):
        if part.body not in kept:
            shares[part.parent] += shares[part.body]
    return {name: shares[name] / total for name in kept}


def _stature(seen: _Seen) -> float:
    """Return the height of the body, metres, by its thighs."""
    keys = ("@right_hip", "@right_knee")
    rest = np.linalg.norm(seen.place(keys[0]) - seen.place(keys[1]))
    return float(np.linalg.norm(_shape(seen, keys)[1]) / rest)


def _segment(
    part: _Part, at: np.ndarray, turns: Sequence, shape: dict, mass: float, stature: float, seen: _Seen
) -> Segment:
    """Return the body; the ellipsoid that stands for it goes from its joint to its end."""
    end = shape.get(f"@{part.end[0]}")
    if end is None:
        end = stature * (seen.place(f"@{part.end[0]}") - seen.place(f"@{part.centre}"))
    front, side = (stature * radius for radius in part.radii)
    radii = np.array([front, max(float(np.linalg.norm(end)) / 2, 0.02), side])
    return Segment(part.body, part.parent, part.joint, at, tuple(turns), mass, part.end[1] * end, end / 2, radii)


# How the segments are turned, by the directions of what is on them.

_STRAIGHT = 0.1  # sine below which the bend of a limb says less of its turn about itself than its neutral position


def _turns(
    seen: _Seen, part: _Part, sign: float, shape: dict[str, np.ndarray], parent: Float[np.ndarray, "frames 3 3"]
) -> tuple[list[Coordinate | None], Float[np.ndarray, "frames 3 3"]]:
    """Return the coordinates of a part, and how it is turned in each frame, NaN where that is not known."""
    shown = [not turn.needs or seen.has(*turn.needs) for turn in part.turns]
    # To the left, what is not in the sagittal plane is mirrored.
    axes = [(sign * turn.axis[0], sign * turn.axis[1], turn.axis[2]) for turn in part.turns]
    relative = parent.transpose(0, 2, 1) @ _turned(seen, part, shape, parent, shown)
    if len(part.turns) == 3:
        angles = _angles(relative, np.array(axes))
        if not part.parent:  # a body turns on and on
            angles = [_unwrapped(angle) for angle in angles]
    else:
        angles = [np.degrees(np.arctan2(relative[:, 1, 0], relative[:, 0, 0])) * axes[0][2], np.zeros(len(parent))]
        if len(part.turns) == 1:
            relative = rotation_about(_Z, np.radians(angles[0] * axes[0][2]))
    found = [
        Coordinate(turn.name, axis, turn.low, turn.high, angle) if show else None
        for turn, axis, angle, show in zip(part.turns, axes, angles, shown, strict=False)
    ]
    return found, parent @ relative


def _turned(
    seen: _Seen, part: _Part, shape: dict[str, np.ndarray], parent: np.ndarray, shown: Sequence[bool]
) -> Float[np.ndarray, "frames 3 3"]:
    """Return how a part is turned: onto all that is on it, or along its limb with the plane in which that bends."""
    tracks = np.stack([seen.track(key) for key in shape], 1)
    tracks = tracks - tracks[:, :1]
    body = np.stack(list(shape.values()))
    limb = f"@{part.end[0]}"
    if np.linalg.svd(body)[1][1] > 0.1 * np.linalg.norm(body) and all(shown[2:]):
        return _onto(tracks, body)
    tip = seen.track(limb) - seen.track(f"@{part.centre}") if limb in shape else tracks[:, -1]
    side = parent[:, :, 2]
    beyond = part.turns[-1].needs if len(part.turns) == 3 and shown[2] and limb in shape else ()
    if beyond:
        lower = _unit(seen.track(f"@{beyond[0]}") - seen.track(limb))
        bend = np.cross(_unit(tip), lower) * (-1.0 if "hip" in part.joint else 1.0)
        side = bend + _STRAIGHT * side
    # The limb lies along its own direction, and its side as near that of the bend as that allows.
    farthest = body[np.linalg.norm(body, axis=1).argmax()]
    return _onto(
        np.stack([_unit(tip), 0.01 * _unit(side)], 1), np.stack([farthest / np.linalg.norm(farthest), [0, 0, 0.01]])
    )


def _onto(
    tracks: Float[np.ndarray, "frames points 3"], body: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "frames 3 3"]:
    """Return the rotations of a body's points onto tracks, NaN where one is not known."""
    known = np.asarray(np.isfinite(tracks).all((1, 2)))
    turn, _ = nearest_rotation(np.einsum("fpi,pj->fij", np.where(known[:, None, None], tracks, body), body))
    turn[~known] = np.nan
    return turn


def _unwrapped(degrees: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
    found, known = degrees.copy(), np.isfinite(degrees)
    found[known] = np.unwrap(degrees[known], period=360)
    return found


def _unit(vectors: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _angles(turn: Float[np.ndarray, "frames 3 3"], axes: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 frames"]:
    """Return degrees about three axes, one after another, each about the axes turned before it.

    Of the two triples for a rotation, those that change little over time, and otherwise the nearer to the neutral
    position: an arm that is raised sideways goes on being raised beyond the horizontal.
    """
    second = axes[1] * np.linalg.det(np.stack([axes[1], axes[2], axes[0]]))
    base = np.stack([second, axes[2], axes[0]])
    turn = base @ turn @ base.T  # about z, then x, then y
    z, y = np.arctan2(-turn[:, 0, 1], turn[:, 1, 1]), np.arctan2(-turn[:, 2, 0], turn[:, 2, 2])
    x = np.arcsin(np.clip(turn[:, 2, 1], -1, 1))
    triples = np.degrees(np.array([[z, x, y], [z + np.pi, np.pi - x, y + np.pi]]))
    triples -= 360 * np.round(triples / 360)
    chosen = _steadiest(np.nan_to_num(triples))
    return np.where(chosen == 0, *triples) * np.array([1.0, second @ axes[1], 1.0])[:, None]


_NEUTRAL = 0.02  # what it costs to be far from the neutral position in a frame, against a jump as far


def _steadiest(triples: Float[np.ndarray, "2 3 frames"]) -> Int[np.ndarray, " frames"]:
    """Return which of two triples to take in each frame, so that jumps and distances from 0 cost least (Viterbi)."""
    far = _NEUTRAL * np.square(triples).sum(1)
    gap = triples[:, None, :, 1:] - triples[None, :, :, :-1]
    jumps = np.square(gap - 360 * np.round(gap / 360)).sum(2)
    cost, back = far[:, 0], []
    for frame in range(jumps.shape[-1]):
        total = cost + jumps[:, :, frame]
        back.append(total.argmin(1))
        cost = total.min(1) + far[:, frame + 1]
    chosen = [int(cost.argmin())]
    for step in reversed(back):
        chosen.append(int(step[chosen[-1]]))
    return np.array(chosen[::-1])


# The model's file: OpenSim's XML, version 4.


def model_xml(model: HumanModel, name: str, about: str) -> bytes:
    """Return the ``.osim`` of a model; ``about`` goes into its credits."""
    root = ET.Element("OpenSimDocument", Version="40000")
    top = _add(root, "Model", name=name)
    _add(top, "gravity", "0 -9.80665 0")
    _add(top, "credits", about)
    _add(top, "length_units", "meters")
    _add(top, "force_units", "N")
    bodies = _set(top, "BodySet", "bodyset")
    for segment in model.segments:
        _body_xml(bodies, segment)
    joints = _set(top, "JointSet", "jointset")
    for segment in model.segments:
        _joint_xml(joints, segment, () if segment.parent else model.shifts)
    markers = _set(top, "MarkerSet", "markerset")
    for marker, (body, place) in model.markers.items():
        entry = _add(markers, "Marker", name=marker)
        _add(entry, "socket_parent_frame", f"/bodyset/{body}")
        _add(entry, "location", _text(place))
        _add(entry, "fixed", "true")
    ET.indent(root, "\t")
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _add(parent: ET.Element, tag: str, text: str = "", **attributes: str) -> ET.Element:
    found = ET.SubElement(parent, tag, attributes)
    found.text = text or None
    return found


def _set(top: ET.Element, tag: str, name: str) -> ET.Element:
    return _add(_add(top, tag, name=name), "objects")


def _text(values) -> str:
    return " ".join(f"{value + 0.0:.8g}" for value in values)


def _body_xml(bodies: ET.Element, segment: Segment) -> None:
    """Add a body with the inertia of an ellipsoid, and the ellipsoid to look at."""
    entry = _add(bodies, "Body", name=segment.name)
    frame = _add(_add(entry, "components"), "PhysicalOffsetFrame", name=f"{segment.name}_shape")
    shape = _add(_add(frame, "attached_geometry"), "Ellipsoid", name=f"{segment.name}_ellipsoid")
    _add(shape, "socket_frame", "..")
    look = _add(shape, "Appearance")
    _add(look, "opacity", "0.6")
    _add(look, "color", "0.85 0.78 0.68")
    _add(shape, "radii", _text(segment.radii))
    _add(frame, "socket_parent", "..")
    _add(frame, "translation", _text(segment.middle))
    _add(frame, "orientation", "0 0 0")
    _add(entry, "mass", f"{segment.mass:.6g}")
    _add(entry, "mass_center", _text(segment.centre))
    squares = segment.radii**2
    _add(entry, "inertia", _text([*(segment.mass / 5 * (squares.sum() - squares)), 0, 0, 0]))


def _joint_xml(joints: ET.Element, segment: Segment, shifts: Sequence[Coordinate]) -> None:
    """Add the joint that a body hangs on; the pelvis's also moves along ``shifts``."""
    entry = _add(joints, "CustomJoint", name=segment.joint)
    parent = segment.parent or "ground"
    ends = {f"{parent}_offset": segment.at, f"{segment.name}_offset": np.zeros(3)}
    for socket, frame in zip(("parent", "child"), ends, strict=True):
        _add(entry, f"socket_{socket}_frame", frame)
    turns = [turn for turn in segment.turns if turn is not None]
    coordinates = _add(entry, "coordinates")
    for one in turns:
        _coordinate_xml(coordinates, one, np.pi / 180)
    for one in shifts:
        _coordinate_xml(coordinates, one, 1.0)
    frames = _add(entry, "frames")
    for (frame, place), body in zip(ends.items(), (parent, segment.name), strict=True):
        offset = _add(frames, "PhysicalOffsetFrame", name=frame)
        _add(offset, "socket_parent", "/ground" if body == "ground" else f"/bodyset/{body}")
        _add(offset, "translation", _text(place))
        _add(offset, "orientation", "0 0 0")
    transform = _add(entry, "SpatialTransform")
    for kind, found in (("rotation", _three(turns)), ("translation", _three(shifts))):
        for number, (name, axis) in enumerate(found, 1):
            _axis_xml(transform, f"{kind}{number}", name, axis)


def _coordinate_xml(coordinates: ET.Element, one: Coordinate, unit: float) -> None:
    entry = _add(coordinates, "Coordinate", name=one.name)
    _add(entry, "default_value", f"{one.first * unit:.8g}")
    _add(entry, "range", _text([one.low * unit, one.high * unit]))
    # Within bounds OpenSim optimises by another method, which stops up to 2 degrees early. See `uplift.export.osim`.
    _add(entry, "clamped", "false")


def _three(coordinates: Sequence[Coordinate]) -> list[tuple[str, tuple[float, ...]]]:
    """Return names and axes of three coordinates, the axes in the place of those that are not there any that are left."""
    found: list[tuple[str, tuple[float, ...]]] = [(one.name, one.axis) for one in coordinates]
    for axis in (_X, _Y, _Z):
        if len(found) < 3 and all(np.abs(np.cross(axis, other)).max() > 0.1 for _, other in found):
            found.append(("", axis))
    return found


def _axis_xml(transform: ET.Element, kind: str, name: str, axis: Sequence[float]) -> None:
    entry = _add(transform, "TransformAxis", name=kind)
    _add(entry, "coordinates", name)
    _add(entry, "axis", _text(axis))
    if name:
        _add(_add(entry, "LinearFunction", name="function"), "coefficients", "1 0")
    else:
        _add(_add(entry, "Constant", name="function"), "value", "0")
