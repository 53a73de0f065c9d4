"""Propose a skeleton for what a tracker file holds: names, partners and bones as far as the file tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton
from uplift.skeleton.proposal_bones import Bone, apart, joining_bones, seen_in
from uplift.skeleton.proposal_names import mirror_pairs

__all__ = ["Proposal", "propose"]

_SEEN_WELL = 0.8  # of the joint seen most
_SELDOM = 0.5  # of the frames


@dataclass(frozen=True)
class Proposal:
    """A skeleton made of a file, and where each part of it comes from."""

    skeleton: Skeleton
    hidden: tuple[str, ...]
    """Joints of the file that no frame shows; left out."""
    seldom: tuple[str, ...]
    """Joints that less than half of the frames show."""
    from_file: tuple[Bone, ...]
    """Bones of the file's own; the others are guesses by distance."""
    unmirrored: tuple[Bone, ...] = ()
    """Partners left out, as the bones of the file are not the same on both sides."""


def propose(data: PoseData, name: str, root: str | None = None, gravity: bool = True) -> Proposal:
    """Return a skeleton called ``name`` for the joints of ``data``.

    Joints in the file's order. Partners from the file, else by name. Bones from the file; what those
    leave apart is joined by distance (`joining_bones`). The root is ``root``, else the most central of
    the joints on the midline that are seen well; where all joints are paired, the middle of the most
    central pair.

    Raises:
        UserError: fewer than three joints that are ever visible, names that are no joint names, no such root.
    """
    where = f"{data.source}: " if data.source else ""
    visible = seen_in(data.keypoints, data.confidence)
    share = visible.mean(0) if len(data) else np.zeros(len(data.joint_names))
    _check_joints(data, share, where)
    shown = np.flatnonzero(share > 0)
    names = [data.joint_names[place] for place in shown]
    if root is not None and root not in names:
        raise UserError(f"root={root}: no such joint in the file.{did_you_mean(root, names)}")
    score = apart(data.keypoints[:, shown], visible[:, shown], names)
    known = _known_bones(data.bones, names)
    pairs = _pairs(data, names)
    plan = _joined(name, names, pairs, known, score, share[shown], root, gravity)
    skeleton, unmirrored = _checked(plan, pairs)
    return Proposal(
        skeleton,
        hidden=tuple(n for n, seen in zip(data.joint_names, share, strict=True) if not seen),
        seldom=tuple(n for n, seen in zip(data.joint_names, share, strict=True) if 0 < seen < _SELDOM),
        from_file=tuple(known),
        unmirrored=unmirrored,
    )


def _check_joints(data: PoseData, share: np.ndarray, where: str) -> None:
    joints = len(data.joint_names)
    if joints < 3:
        shown = f" ({', '.join(data.joint_names)})" if joints else ""
        raise UserError(f"{where}found {joints} joints{shown}; a skeleton needs 3 or more.")
    if not len(data):
        raise UserError(f"{where}no frames: where the joints are is not known, so no bones can be proposed.")
    if (share > 0).sum() < 3:
        seen = ", ".join(n for n, s in zip(data.joint_names, share, strict=True) if s) or "none"
        raise UserError(
            f"{where}only {int((share > 0).sum())} of {joints} joints are visible in any of {len(data):,} frames "
            f"({seen}); a skeleton needs 3 or more. Visible is: confidence above 0 and finite coordinates."
        )
    for name in data.joint_names:
        if not name or name != name.strip() or not name.isprintable():
            raise UserError(f"{where}found the joint name {name!r}; expected text with no blanks around it. Rename it.")
    twice = [name for name in data.joint_names if data.joint_names.count(name) > 1]
    if twice:
        raise UserError(f"{where}found joint '{twice[0]}' {len(twice)} times; names must differ. Rename them.")


def _known_bones(bones: tuple[Bone, ...], names: list[str]) -> list[Bone]:
    """Return the file's bones between joints that are there, each once."""
    found: dict[frozenset[str], Bone] = {}
    for bone in bones:
        if bone[0] != bone[1] and set(bone) <= set(names):
            found.setdefault(frozenset(bone), bone)
    return list(found.values())


def _pairs(data: PoseData, names: list[str]) -> list[tuple[str, str]]:
    """Return partners (right, left): the file's, and of the other joints those by name."""
    by_name = mirror_pairs(names)
    order = {frozenset(pair): pair for pair in by_name}
    found: list[tuple[str, str]] = []
    used: set[str] = set()
    for one, other in (*data.mirror, *by_name):
        if one != other and {one, other} <= set(names) and not {one, other} & used:
            found.append(order.get(frozenset((one, other)), (one, other)))
            used |= {one, other}
    return sorted(found, key=lambda pair: min(map(names.index, pair)))


def _joined(
    name: str,
    names: list[str],
    pairs: list[tuple[str, str]],
    known: list[Bone],
    score: np.ndarray,
    share: np.ndarray,
    root: str | None,
    gravity: bool,
) -> dict[str, Any]:
    """Return the plain data of a skeleton: joints, root and the bones that join them."""
    central = np.minimum(score, score.max(where=np.isfinite(score), initial=1.0)).mean(1)
    paired = {joint for pair in pairs for joint in pair}
    middle = [place for place, joint in enumerate(names) if joint not in paired]
    bridge = None
    if not middle:  # nothing but pairs: the sides hang together at the most central one
        bridge = min(pairs, key=lambda pair: sum(central[names.index(joint)] for joint in pair))
    bones = [*known, *joining_bones(score, names, pairs, [*known, *([bridge] if bridge else [])])]
    plan: dict[str, Any] = {"name": name, "joints": list(names), "gravity": gravity}
    plan["mirror"] = [list(pair) for pair in pairs]
    if root is None and bridge:
        plan["root"] = new = _new_name("middle", names)
        plan["joints"].append(new)
        plan["midpoints"] = {new: list(bridge)}
        bones = [(new, bridge[0]), (new, bridge[1]), *(bone for bone in bones if set(bone) != set(bridge))]
    else:
        bones += [bridge] if bridge and set(bridge) not in map(set, bones) else []
        good = [place for place in middle if share[place] >= _SEEN_WELL * share.max()]
        best = min(good, key=lambda place: central[place]) if good else max(middle, default=0, key=lambda p: share[p])
        plan["root"] = root or names[best]
    plan |= {"bones": [list(bone) for bone in bones], "loops": len(bones) > len(plan["joints"]) - 1}
    return plan


def _new_name(name: str, names: list[str]) -> str:
    while name in names:
        name += "_"
    return name


def _checked(plan: dict[str, Any], pairs: list[tuple[str, str]]) -> tuple[Skeleton, tuple[Bone, ...]]:
    """Return the skeleton, without partners where the file's bones do not allow them."""
    try:
        return Skeleton.from_dict(plan), ()
    except UserError:
        if not pairs:
            raise
        return Skeleton.from_dict({**plan, "mirror": []}), tuple(pairs)
