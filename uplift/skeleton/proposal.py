"""Propose a skeleton for what a tracker file holds: names, partners and bones as far as the file tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton
from uplift.skeleton.proposal_bones import Bone, apart, joining_bones, seen_in
from uplift.skeleton.proposal_names import mirror_pairs

__all__ = ["Proposal", "propose"]

_SEEN_WELL = 0.8  # of the joint seen most
_SELDOM = 0.5  # of the frames
_NEAR = 0.5  # of the spread of the joints about their middle

Pair = tuple[str, str]


@runtime_checkable
class Tracked(Protocol):
    """What a tracker's file tells of its joints; `uplift.data.container.PoseData` does."""

    keypoints: np.ndarray
    """(frames joints 2); what is not seen is NaN, or has confidence 0."""
    confidence: np.ndarray
    """(frames joints)"""
    joint_names: tuple[str, ...]
    bones: tuple[tuple[str, str], ...]
    mirror: tuple[tuple[str, str], ...]
    source: str

    def __len__(self) -> int:
        """Return the number of frames."""
        ...


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


def propose(data: Tracked, name: str, root: str | None = None, gravity: bool = True) -> Proposal:
    """Return a skeleton called ``name`` for the joints of ``data``.

    Joints in the file's order. Partners from the file, else by name. Bones from the file; what those
    leave apart is joined by distance (`joining_bones`). The root is ``root``, else the joint on the
    midline nearest the middle of those that are seen well, or a midpoint of a pair that is far nearer.

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
    start = root or _best_root(names, pairs, data.keypoints[:, shown], visible[:, shown], score)
    plan = {**_joined(name, names, pairs, known, score, start), "gravity": gravity}
    skeleton, unmirrored = _checked(plan, pairs)
    return Proposal(
        skeleton,
        hidden=tuple(n for n, seen in zip(data.joint_names, share, strict=True) if not seen),
        seldom=tuple(n for n, seen in zip(data.joint_names, share, strict=True) if 0 < seen < _SELDOM),
        from_file=tuple(known),
        unmirrored=unmirrored,
    )


def _check_joints(data: Tracked, share: np.ndarray, where: str) -> None:
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


def _pairs(data: Tracked, names: list[str]) -> list[Pair]:
    """Return partners (right, left): the file's, and of the other joints those by name."""
    by_name = mirror_pairs(names)
    order = {frozenset(pair): pair for pair in by_name}
    found: list[Pair] = []
    used: set[str] = set()
    for one, other in (*data.mirror, *by_name):
        if one != other and {one, other} <= set(names) and not {one, other} & used:
            found.append(order.get(frozenset((one, other)), (one, other)))
            used |= {one, other}
    return sorted(found, key=lambda pair: min(map(names.index, pair)))


def _joined(
    name: str, names: list[str], pairs: list[Pair], known: list[Bone], score: np.ndarray, root: str | Pair
) -> dict[str, Any]:
    """Return the plain data of a skeleton: joints, root and the bones that join them."""
    plan: dict[str, Any] = {"name": name, "joints": list(names), "mirror": [list(pair) for pair in pairs]}
    made = root if isinstance(root, tuple) else None
    bridge = [made] if made and 2 * len(pairs) == len(names) else []
    bones = [*known, *bridge, *joining_bones(score, names, pairs, [*known, *bridge])]
    if made is None:
        plan["root"] = root
    else:
        plan["root"] = new = _new_name("middle", names)
        plan["joints"].append(new)
        plan["midpoints"] = {new: list(made)}
        bones = _through(new, made, bones, known)
    plan |= {"bones": [list(bone) for bone in bones], "loops": len(bones) > len(plan["joints"]) - 1}
    return plan


def _through(new: str, pair: Pair, bones: list[Bone], known: list[Bone]) -> list[Bone]:
    """Return the bones with those to the middle of a pair, in place of guessed ones that hold the pair together."""
    guessed = {frozenset(bone) for bone in bones} - {frozenset(bone) for bone in known}
    joints = {joint for bone in bones for joint in bone} - set(pair)
    between = [joint for joint in joints if all(frozenset((joint, end)) in guessed for end in pair)]
    away = {frozenset(pair)} | {frozenset((joint, end)) for joint in between[:1] for end in pair}
    kept = [bone for bone in bones if frozenset(bone) not in away]
    return [(new, pair[0]), (new, pair[1]), *((joint, new) for joint in between[:1]), *kept]


def _best_root(
    names: list[str], pairs: list[Pair], keypoints: np.ndarray, visible: np.ndarray, score: np.ndarray
) -> str | Pair:
    """Return the joint nearest the middle of the body of those seen well: on the midline, where there are pairs.

    A pair, for the point between its joints, where every joint has a partner, or where that point is nearer than
    any joint and the pair as good as stiff (hips, not elbows).
    """
    paired = {joint for pair in pairs for joint in pair}
    singles = [(joint,) for joint in names if joint not in paired]
    share = visible.mean(0)
    best: dict[int, tuple[float, tuple[str, ...]]] = {}
    for group in [*singles, *pairs]:
        places = [names.index(joint) for joint in group]
        well = visible[:, places].all(1).mean() >= _SEEN_WELL * share.max()
        far = _off_centre(keypoints, visible, places) + (0 if well else 10)
        far += 2 * min(float(score[places[0], places[1]]), 10) if len(places) == 2 else 0
        best[len(group)] = min(best.get(len(group), (np.inf, group)), (far, group), key=lambda found: found[0])
    if 1 in best and (2 not in best or best[1][0] < max(_NEAR, best[2][0])):
        return best[1][1][0]
    one, other = best[2][1]
    return one, other


def _off_centre(keypoints: np.ndarray, visible: np.ndarray, places: list[int]) -> float:
    """Return how far the mean of some joints is from that of all visible ones, in their spread."""
    rows = np.flatnonzero(visible[:, places].all(1))
    seen = visible[rows][..., None]
    points = np.where(seen, keypoints[rows].astype(np.float64), 0)
    centre = points.sum(1) / seen.sum(1)
    spread = np.sqrt((np.where(seen, points - centre[:, None], 0) ** 2).sum((1, 2)) / seen.sum((1, 2)))
    away = np.linalg.norm(points[:, places].mean(1) - centre, axis=-1)
    return float(np.mean(away / np.maximum(spread, 1e-9))) if len(rows) else 9.0


def _new_name(name: str, names: list[str]) -> str:
    while name in names:
        name += "_"
    return name


def _checked(plan: dict[str, Any], pairs: list[Pair]) -> tuple[Skeleton, tuple[Bone, ...]]:
    """Return the skeleton, without partners where the file's bones do not allow them."""
    try:
        return Skeleton.from_dict(plan), ()
    except UserError:
        if not pairs:
            raise
        return Skeleton.from_dict({**plan, "mirror": []}), tuple(pairs)
