"""The body that a skeleton's own YAML spells out in proportions, rest directions and limits."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError, did_you_mean
from uplift.simulator.body import DEFAULT_LIMITS, ROOT_ANGLES, Body, angle_axes, joint_weights, rest_positions
from uplift.skeleton import Skeleton

__all__ = ["leaders", "own_body"]

_SPREAD = 0.06


def own_body(skeleton: Skeleton) -> Body:
    """Return the body of ``proportions``, ``rest`` and ``limits``; raises UserError saying what to add."""
    _check_complete(skeleton)
    order = _tree_order(skeleton)
    parents = np.array([order.index(p) if (p := skeleton.parents[joint]) is not None else -1 for joint in order])
    offsets = np.array([_offset(skeleton, joint) for joint in order])
    angles = {f"{order[0]} {name}": (-np.inf, np.inf) for name in ROOT_ANGLES}
    steps = [(f"{order[0]} {name}", 0, axis) for name, axis in ROOT_ANGLES.items()]
    if not skeleton.rigid:
        limits = _all_limits(skeleton)
        for point, joint in enumerate(order):
            direction = _beyond(point, parents, offsets)
            if direction is None:
                continue
            axes = angle_axes(direction, _side(skeleton, joint, order, parents, offsets))
            for name, (low, high) in limits[joint].items():
                if (low, high) != (0, 0):
                    angles[f"{joint} {name}"] = (low, high)
                    steps.append((f"{joint} {name}", point, axes[name]))
    names = tuple(angles)
    bounds = np.array(list(angles.values()), dtype=float)
    return Body(
        points=order,
        parents=parents,
        offsets=offsets,
        groups=_groups(skeleton, order, offsets),
        spread=0.08 if skeleton.rigid else _SPREAD,
        angles=names,
        low_deg=bounds[:, 0],
        high_deg=bounds[:, 1],
        steps=tuple((point, names.index(name), axis) for name, point, axis in steps),
        joints=joint_weights(skeleton, _parts(skeleton), order, "midpoints"),
        scaled_axes=np.full(3, skeleton.rigid),
    )


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
    for key, example in (("proportions", "0.2"), ("rest", "[0.3, 1, 0]")):
        given = skeleton.body.get(key, {})
        missing = [j for j in skeleton.joints if j != skeleton.root and j not in given and j not in skeleton.midpoints]
        missing = [joint for joint in missing if _partners(skeleton).get(joint) not in given]
        if not missing:
            continue
        meaning = (
            "length of the bone to its parent, in body heights"
            if key == "proportions"
            else ("direction from its parent in the rest pose: x the body's left, y down, z behind")
        )
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


def _parts(skeleton: Skeleton) -> dict[str, tuple[str, ...]]:
    return {joint: skeleton.midpoints.get(joint, (joint,)) for joint in skeleton.joints}


def _beyond(point: int, parents: np.ndarray, offsets: np.ndarray) -> np.ndarray | None:
    """Return the mean of the bones that a joint moves; None for an end. Falls back to the bone before it."""
    children = np.flatnonzero(parents == point)
    if not len(children):
        return None
    mean = offsets[children].mean(0)
    if np.linalg.norm(mean) < 1e-6:
        mean = offsets[children[0]]
    return mean if np.linalg.norm(mean) > 1e-6 else np.array([0.0, 1.0, 0.0])


def _side(skeleton: Skeleton, joint: str, order: tuple[str, ...], parents: np.ndarray, offsets: np.ndarray) -> float:
    """Return -1 for a joint of a mirror pair that lies to the right of its partner, else +1."""
    partner = _partners(skeleton).get(joint)
    if partner is None:
        return 1.0
    rest = rest_positions(parents, offsets)
    return -1.0 if rest[order.index(joint), 0] < rest[order.index(partner), 0] else 1.0


def _groups(skeleton: Skeleton, order: tuple[str, ...], offsets: np.ndarray) -> tuple[str, ...]:
    """Mirror partners vary together; in a rigid object so do all bones of one length."""
    partner = _partners(skeleton)
    if skeleton.rigid:
        return tuple(f"{np.linalg.norm(offset):.4f}" for offset in offsets)
    return tuple(min(joint, partner.get(joint, joint)) for joint in order)


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
