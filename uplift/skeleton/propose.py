"""Propose a skeleton file for the joints of a tracker: partners, bones and root, guessed from names and 2D."""

from __future__ import annotations

import difflib
import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Shaped

from uplift.config.files import without_folders
from uplift.errors import UserError, did_you_mean, listed
from uplift.skeleton.core import Skeleton
from uplift.skeleton.schema import MAX_JOINTS

__all__ = [
    "TOO_LONG", "apart", "facing_guess", "guess_parts", "joining_bones", "mirror_pairs", "proposal_text", "propose",
    "quoted", "seen_in", "skeleton_template", "stretch_of", "stretched",
]  # fmt: skip

Bone = tuple[str, str]
Pair = tuple[str, str]
Ends = tuple[tuple[str, ...], tuple[str, ...]]

_SEEN_WELL = 0.8  # of the joint seen most
_SELDOM = 0.5  # of the frames
_NEAR = 0.5  # of the spread of the joints about their middle


@runtime_checkable
class Tracked(Protocol):
    """The joints of a tracker's file, as `uplift.data.poses.PoseData` has them."""

    keypoints: np.ndarray
    """(frames joints 2); what is not seen is NaN, or has confidence 0."""
    confidence: np.ndarray
    """(frames joints)"""
    joint_names: tuple[str, ...]
    bones: tuple[tuple[str, str], ...]
    mirror: tuple[tuple[str, str], ...]
    source: str

    def __len__(self) -> int: ...


@dataclass(frozen=True)
class _Proposal:
    """A skeleton made of a file, and where each part of it comes from."""

    skeleton: Skeleton
    hidden: tuple[str, ...]
    """Joints of the file that no frame shows; left out."""
    seldom: tuple[str, ...]
    """Joints that less than half of the frames show."""
    from_file: tuple[Bone, ...]
    """Bones given by the file; the others are guesses by distance."""
    unmirrored: tuple[Bone, ...] = ()
    """Partners left out, as the bones of the file are not the same on both sides."""


def propose(data: Tracked, name: str, root: str | None = None, gravity: bool = True) -> _Proposal:
    """Return a skeleton called ``name`` for the joints of ``data``.

    Joints in the file's order. Partners from the file, else by name. Bones from the file; what those
    leave apart is joined by distance (`joining_bones`). The root is ``root``, else the joint on the
    midline nearest the middle of those that are seen well, or a midpoint of a pair that is far nearer.

    Raises UserError: fewer than three joints that are ever visible, invalid joint names, no such root.
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
    hidden = tuple(n for n, seen in zip(data.joint_names, share, strict=True) if not seen)
    seldom = tuple(n for n, seen in zip(data.joint_names, share, strict=True) if 0 < seen < _SELDOM)
    try:
        return _Proposal(Skeleton.from_dict(plan), hidden, seldom, tuple(known))
    except UserError:  # the file's bones do not allow the partners
        if not pairs:
            raise
        return _Proposal(Skeleton.from_dict({**plan, "mirror": []}), hidden, seldom, tuple(known), tuple(pairs))


def _check_joints(data: Tracked, share: np.ndarray, where: str) -> None:
    joints = len(data.joint_names)
    if joints > MAX_JOINTS:
        raise UserError(f"{where}found {joints:,} joints; a skeleton has {MAX_JOINTS:,} at most.")
    if joints < 3:
        shown = f" ({', '.join(data.joint_names)})" if joints else ""
        raise UserError(f"{where}found {joints} joints{shown}; a skeleton needs 3 or more.")
    if not len(data):
        raise UserError(f"{where}no frames: where the joints are is not known, so no bones can be proposed.")
    if (share > 0).sum() < 3:
        seen = listed(n for n, s in zip(data.joint_names, share, strict=True) if s) or "none"
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
    """Return the file's bones between ``names``, each once."""
    found: dict[frozenset[str], Bone] = {}
    for bone in bones:
        if bone[0] != bone[1] and set(bone) <= set(names):
            found.setdefault(frozenset(bone), bone)
    return list(found.values())


def _pairs(data: Tracked, names: list[str]) -> list[Bone]:
    by_name = mirror_pairs(names)
    order = {frozenset(pair): pair for pair in by_name}
    found: list[Bone] = []
    used: set[str] = set()
    for one, other in (*data.mirror, *by_name):
        if one != other and {one, other} <= set(names) and not {one, other} & used:
            found.append(order.get(frozenset((one, other)), (one, other)))
            used |= {one, other}
    return sorted(found, key=lambda pair: min(map(names.index, pair)))


def _joined(
    name: str, names: list[str], pairs: list[Bone], known: list[Bone], score: np.ndarray, root: str | Bone
) -> dict[str, Any]:
    """Return the plain data of a skeleton: joints, root and the bones that join them."""
    plan: dict[str, Any] = {"name": name, "joints": list(names), "mirror": [list(pair) for pair in pairs]}
    made = root if isinstance(root, tuple) else None
    bridge = [made] if made and 2 * len(pairs) == len(names) else []
    bones = [*known, *bridge, *joining_bones(score, names, pairs, [*known, *bridge])]
    if made is None:
        plan["root"] = root
    else:
        new = "middle"
        while new in names:
            new += "_"
        plan["root"] = new
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
    names: list[str], pairs: list[Bone], keypoints: np.ndarray, visible: np.ndarray, score: np.ndarray
) -> str | Bone:
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
    """Return how far the mean of some joints is from that of all visible ones, in units of their spread."""
    rows = np.flatnonzero(visible[:, places].all(1))
    seen = visible[rows][..., None]
    points = np.where(seen, keypoints[rows].astype(np.float64), 0)
    centre = points.sum(1) / seen.sum(1)
    spread = np.sqrt((np.where(seen, points - centre[:, None], 0) ** 2).sum((1, 2)) / seen.sum((1, 2)))
    away = np.linalg.norm(points[:, places].mean(1) - centre, axis=-1)
    return float(np.mean(away / np.maximum(spread, 1e-9))) if len(rows) else 9.0


# Which joints a bone may join, by 2D alone: those that stay close and keep their distance.

TOO_LONG = 1.9
"""`stretched` from which on joints seem to have the names of others."""

_MOST_NUMBERS = 2_000_000  # frames x joints x joints at once
_SMOOTHING = 0.05  # of the mean distance, so that few frames are judged by their distances, not by luck
_IN_A_ROW = 0.5  # how far apart tail_1 and tail_2 count


def seen_in(
    keypoints: Shaped[np.ndarray, "frames joints 2"], confidence: Shaped[np.ndarray, "frames joints"]
) -> Bool[np.ndarray, "frames joints"]:
    """Return which joints are visible: confidence above 0 and a finite place."""
    return (confidence > 0) & np.isfinite(keypoints).all(-1)


def apart(
    keypoints: Shaped[np.ndarray, "frames joints 2"], visible: Bool[np.ndarray, "frames joints"], names: Sequence[str]
) -> Float[np.ndarray, "joints joints"]:
    """Return how unlikely a bone is between two joints; names in a row (tail_1, tail_2) count as closer.

    The geometric mean of their mean distance and of how much it varies over the frames, in sizes of the body;
    infinite where no frame shows both.
    """
    distance = _distances(*_some_rows(keypoints, visible))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # pairs that no frame shows
        mean, varies = np.nanmean(distance, axis=0), np.nanstd(distance, axis=0)
    score = np.sqrt(mean * (varies + _SMOOTHING * mean))
    score[np.isnan(score)] = np.inf
    rows = np.array([[_in_a_row(one, other) for other in names] for one in names])
    return np.where(rows, _IN_A_ROW * score, score)


def joining_bones(
    score: Float[np.ndarray, "joints joints"],
    names: Sequence[str],
    mirror: Sequence[tuple[str, str]] = (),
    known: Sequence[Bone] = (),
) -> list[Bone]:
    """Return the bones that join all joints with the least sum of scores, beside those that are ``known``.

    The same on both sides: joints on the midline are joined first, then pairs to them and to each
    other (a minimum spanning tree of the halves).
    """
    at = {name: place for place, name in enumerate(names)}
    across = np.arange(len(names))
    for one, other in mirror:
        across[[at[one], at[other]]] = at[other], at[one]
    score = np.minimum(score, score.max(where=np.isfinite(score), initial=1.0) * 10)
    score = (score + score[across][:, across]) / 2
    group = np.arange(len(names))  # equal where bones join two places so far
    for one, other in known:
        _join(group, at[one], at[other])
    middle = np.flatnonzero(across == np.arange(len(names))).tolist()
    found: list[tuple[int, int]] = []
    if not middle:  # nothing but pairs: one of them holds the sides together
        held = np.flatnonzero(group == group[across]).tolist()
        first = min(held or range(len(names)), key=lambda place: float(score[place, across[place]]))
        middle = [first]
        found += _join(group, first, int(across[first]))
    found += _grown(score, middle, across, group)
    found += _grown(score, range(len(names)), across, group)
    return [(names[one], names[other]) for one, other in found]


def stretched(
    keypoints: Shaped[np.ndarray, "frames joints 2"],
    visible: Bool[np.ndarray, "frames joints"],
    bones: Sequence[Sequence[int]],
) -> float:
    """Return the mean length of the bones over that of the shortest lines that join the joints; NaN where none is seen.

    1 to 1.6 where the names are right, 2 or more where joints have the names of others.
    """
    seen = np.flatnonzero(visible.any(0))
    at = {int(place): number for number, place in enumerate(seen)}
    ends = [(at[one], at[other]) for one, other in bones if one in at and other in at]
    if len(seen) < 3 or not ends:
        return float("nan")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        mean = np.nanmean(_distances(*_some_rows(keypoints[:, seen], visible[:, seen])), axis=0)
    ours = np.array([mean[bone] for bone in ends])
    score = np.where(np.isfinite(mean), mean, np.inf)
    least = [mean[int(one), int(other)] for one, other in joining_bones(score, [str(n) for n in range(len(seen))])]
    ours = ours[np.isfinite(ours)]
    return float(np.mean(ours) / max(np.nanmean(least), 1e-9)) if len(ours) else float("nan")


def stretch_of(
    keypoints: Shaped[np.ndarray, "frames joints 2"],
    confidence: Shaped[np.ndarray, "frames joints"],
    skeleton: Skeleton,
) -> float:
    """Return how far the bones of ``skeleton`` are stretched in keypoints of its joints; 0 where nothing is seen."""
    visible = seen_in(keypoints, confidence)
    return float(np.nan_to_num(stretched(keypoints, visible, skeleton.bone_indices.tolist())))


def _grown(
    score: np.ndarray, places: Sequence[int], across: np.ndarray, group: np.ndarray
) -> Iterator[tuple[int, int]]:
    """Join what ``places`` holds to the group of its first joint, the nearest first, each bone with its mirror image."""
    start = next((place for place in places if across[place] == place), places[0])
    while True:
        inside = np.flatnonzero(group == group[start]).tolist()
        outside = [place for place in places if group[place] != group[start]]
        if not outside:
            return
        between = score[np.ix_(inside, outside)]
        one, other = np.unravel_index(int(between.argmin()), between.shape)
        bone = inside[int(one)], outside[int(other)]
        yield from _join(group, *bone)
        yield from _join(group, int(across[bone[0]]), int(across[bone[1]]))


def _join(group: np.ndarray, one: int, other: int) -> list[tuple[int, int]]:
    """Join two places in ``group``; return the bone, or nothing where they were joined before."""
    if group[one] == group[other]:
        return []
    group[group == group[other]] = group[one]
    return [(one, other)]


def _some_rows(keypoints: np.ndarray, visible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frames that show three joints or more, as many as the memory holds, spread evenly."""
    rows = np.flatnonzero(visible.sum(1) >= 3)
    most = max(2, _MOST_NUMBERS // keypoints.shape[1] ** 2)
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).astype(int)]
    return keypoints[rows].astype(np.float64), visible[rows]


def _distances(keypoints: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return (frames joints joints) distances in sizes of the body in that frame; NaN where a joint is hidden.

    The size is that of the visible joints' spread, then what makes the distances most alike over the
    frames: hidden joints do not shrink the body.
    """
    points = np.where(visible[..., None], keypoints, np.nan)
    found = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        spread = np.sqrt(np.nanmean(found**2, axis=(1, 2)))
        found /= np.where(spread > 0, spread, np.nan)[:, None, None]
        usual = np.nanmedian(found, axis=0)
        size = np.nanmedian(found / np.where(usual > 0, usual, np.nan), axis=(1, 2))
    return found / np.where(size > 0, size, np.nan)[:, None, None]


def _in_a_row(one: str, other: str) -> bool:
    """Return whether two names differ in one number alone, by one."""
    first, second = (re.split(r"(\d+)", name) for name in (one, other))
    if len(first) != len(second):
        return False
    differ = [(a, b) for a, b in zip(first, second, strict=True) if a != b]
    return len(differ) == 1 and all(map(str.isdigit, differ[0])) and abs(int(differ[0][0]) - int(differ[0][1])) == 1


# Guesses from the names of joints: partners, sides, and names that mean the same.

# From the clearest sign of a side to the weakest: a word, a letter by itself, a capital, a letter at either end.
_SIGNS = (
    re.compile(r"left|right", re.IGNORECASE),
    re.compile(r"(?<![A-Za-z])[lr](?![A-Za-z])", re.IGNORECASE),
    re.compile(r"[LR]"),
    re.compile(r"(?<![A-Za-z])[lr]|[lr](?![A-Za-z])"),
)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

# Words that name the same place; a joint on the midline and the middle of a pair differ by the side.
_SAME = (
    {"pelvis", "midhip", "hips", "hipcenter", "hipcentre", "hipmid", "sacrum", "croup"},
    {"neck", "thorax", "neckbase", "chest", "sternum", "uppertorso"},
    {"headtop", "topofhead", "vertex", "headtip"},
    {"nose", "snout", "muzzle"},
    {"tailbase", "rootoftail", "tailroot", "tailstart", "tail1", "rump"},
    {"tailtip", "tailend"},
    {"belly", "abdomen"},
    {"spine", "torso", "spinemid", "midspine", "body"},
    {"bigtoe", "hallux", "footindex"},
    {"hand", "palm"},
    {"hock", "ankle"},
    {"stifle", "knee"},
    {"carpus", "wrist"},
)
_WORDS = {
    "fore": "front", "forefinger": "index", "pinky": "little", "hind": "back", "rear": "back",
    "middle": "mid", "lower": "low", "center": "mid", "centre": "mid", "finger": "", "joint": "",
    "paw": "foot", "hoof": "foot", "claw": "foot",
}  # fmt: skip
_ALIKE = 0.75


def mirror_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs (right, left) of names that differ by a side alone, in the order of ``names``.

    Only where a name has one possible partner. Numbers that differ are looked over (paw1LH, paw4RH)
    where the names without them are still different.
    """
    found: dict[str, tuple[str, str]] = {}
    for stripped in (False, True):
        for sign in _SIGNS:
            left_over = [name for name in names if name not in found]
            keys = {name: re.sub(r"\d+", "", name) if stripped else name for name in left_over}
            by_key = {key: name for name, key in keys.items()}
            if stripped:
                by_key = {key: name for key, name in by_key.items() if list(keys.values()).count(key) == 1}
            for key, name in by_key.items():
                partners = {other: is_left for other, is_left in _swapped(key, sign) if other in by_key}
                if len(partners) != 1:
                    continue
                (other, is_left), *_ = partners.items()
                if {back for back, _ in _swapped(other, sign) if back in by_key} == {key}:
                    pair = (by_key[other], name) if is_left else (name, by_key[other])
                    found[name] = found[by_key[other]] = pair
    return list(dict.fromkeys(found[name] for name in names if name in found))


def _name_words(name: str) -> list[str]:
    """Return the words and numbers of a name in lower case."""
    return [word.lower() for word in _WORD.findall(name)]


def guess_parts(skeleton: Skeleton, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return which of ``names`` each joint of the skeleton may be, by what the words mean; for a person to check.

    A joint on the midline may be the mean of a pair. Joints without a similar name are absent.
    """
    theirs, ours = _meanings(names), _meanings(skeleton.joints)
    likeness = [
        (score, -place, -other, joint, name)
        for place, joint in enumerate(skeleton.joints)
        for other, name in enumerate(names)
        if (score := _likeness(ours[joint], theirs[name])) >= _ALIKE
    ]
    found: dict[str, tuple[str, ...]] = {}
    taken: set[str] = set()
    for _, _, _, joint, name in sorted(likeness, reverse=True):
        if joint not in found and name not in taken:
            found[joint] = (name,)
            taken.add(name)
    for joint in skeleton.joints:  # what a midpoint is made of, or a pelvis of two hips
        if joint in found or ours[joint][0]:
            continue
        parts = skeleton.midpoints.get(joint) or _middle_of(joint, ours)
        if parts and all(part in found for part in parts):
            found[joint] = tuple(name for part in parts for name in found[part])
    return {joint: found[joint] for joint in skeleton.joints if joint in found}


def _swapped(name: str, sign: re.Pattern[str]) -> Iterator[tuple[str, bool]]:
    """Yield the name with a sign of a side turned into the other, and whether that sign means left."""
    for match in sign.finditer(name):
        yield _turned(name, match), match[0][0].lower() == "l"


def _turned(name: str, match: re.Match[str]) -> str:
    new = _OTHER[match[0].lower()]
    new = new.upper() if match[0].isupper() else new.capitalize() if match[0][0].isupper() else new
    return name[: match.start()] + new + name[match.end() :]


def _meanings(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return for each name its side ("l", "r" or none) and what is left of it, words put in one form."""
    side: dict[str, str] = {}
    for right, left in mirror_pairs(names):
        side[right], side[left] = "r", "l"
    rest = {name: [word for word in _name_words(name) if word not in _OTHER] for name in names}
    for right, left in mirror_pairs(names):
        if rest[right] != rest[left]:  # lhip, rhip: the side is a part of a word
            rest[right] = rest[left] = _without_side(right, left)
    for name in names:
        if name not in side:
            side[name] = next((word[0] for word in _name_words(name) if word in _OTHER), "")
    return {name: (side[name], _one_form(rest[name], bool(side[name]))) for name in names}


def _without_side(right: str, left: str) -> list[str]:
    """Return the words that two partners share: without the sign of the side, and without digits, which may differ."""
    one, other = (re.sub(r"\d+", "", name) for name in (right, left))
    for sign in _SIGNS:
        for match in sign.finditer(one):
            if _turned(one, match) == other:
                return _name_words(f"{one[: match.start()]} {one[match.end() :]}")
    return _name_words(one)


def _one_form(words: list[str], sided: bool) -> str:
    """Return one spelling for what means the same; a hip on neither side is a pelvis."""
    text = "".join(_WORDS.get(word, word) for word in words)
    if not sided and text in ("hip", "root"):
        return min(_SAME[0])
    for group in _SAME:
        if text in group or "".join(words) in group:
            return min(group)
    return text


def _likeness(ours: tuple[str, str], theirs: tuple[str, str]) -> float:
    if ours[0] != theirs[0] or not ours[1] or not theirs[1]:
        return 0.0
    if ours[1] == theirs[1]:
        return 1.0
    if re.sub(r"\D", "", ours[1]) != re.sub(r"\D", "", theirs[1]):  # spine1 is not spine2
        return 0.0
    return 0.99 * difflib.SequenceMatcher(None, ours[1], theirs[1]).ratio()


def _middle_of(joint: str, ours: dict[str, tuple[str, str]]) -> tuple[str, ...]:
    """Return the pair that a joint on the midline lies between: the hips of a pelvis, the shoulders of a neck."""
    pair_of = {"hip": "hip", min(_SAME[0]): "hip", min(_SAME[1]): "shoulder"}.get(ours[joint][1])
    return tuple(name for name, (side, what) in ours.items() if side and what == pair_of) if pair_of else ()


# The commented YAML of a proposed skeleton, ready to be corrected by hand.

_WIDTH = 108
_FRONT = ("nose", "snout", "beak", "muzzle", "head", "neck")
_REAR = ("tailbase", "tail", "rump", "croup", "sacrum", "abdomen", "stinger", "body", "thorax")
_ACROSS = ("wing", "antenna")  # they may lie on the other side
_FEET = ("toe", "paw", "foot", "claw", "hoof", "tarsus", "tip", "ankle", "leg")


_PROPOSAL = """\
{head}
#   uplift skeleton check {file}
# tells what is wrong and draws it, and
#   uplift fit skeleton={file} data.train={source}
# learns to lift it. docs/skeletons.md has every key.

name: {name}
description: proposed from a file, to be corrected

{joints}

{root}

{bones}

{mirror}

{facing}

# true: it stands or walks on the ground, and the camera is more or less level.
# false: it may be seen from any side (a hand, a thing that floats); then facing needs `up`.
gravity: {gravity}
# rigid: true    # one shape that does not bend (a chair)

# The true length of one bone, for poses in mm.
# size: {{along: [{one}, {other}], mm: 10}}
"""


def proposal_text(proposal: _Proposal, file: str, source: str) -> str:
    """Return the YAML of a proposal as the file called ``file``; what is not known is in comments."""
    skeleton = proposal.skeleton
    one, other = map(quoted, skeleton.bones[0])
    head = _comment(
        f"A skeleton proposed from {without_folders(source)}. The names are the file's; everything else is a guess: read it through "
        "and correct it. Then"
    )
    return _PROPOSAL.format(
        head=head, file=file, source=source, name=quoted(skeleton.name), joints=_joints(proposal),
        root=_root(skeleton), bones=_bones(proposal), mirror=_mirror(proposal), facing=_facing(skeleton),
        gravity=str(skeleton.gravity).lower(), one=one, other=other,
    )  # fmt: skip


def facing_guess(skeleton: Skeleton) -> dict[str, Ends]:
    """Return the directions that the joints' names suggest; empty where that is too little, or a file would refuse them."""
    sided = [pair for pair in mirror_pairs(skeleton.joints) if set(pair) in map(set, skeleton.mirror)]
    near = {joint: place for place, joint in enumerate(skeleton.parents)}
    sided = sorted(sided, key=lambda pair: (any(word in pair[0].lower() for word in _ACROSS), near[pair[0]]))
    if not sided:
        return {}
    found: dict[str, Ends] = {}
    legs = {word: [joint for pair in sided for joint in pair if word in _name_words(joint) or joint[1:].lower() == word]
            for word in ("hip", "knee", "ankle")}  # fmt: skip
    upright = all(len(joints) == 2 for joints in legs.values()) and not _first(skeleton, ("tail", "paw", "hoof"))
    head, rear = _first(skeleton, _FRONT), _first(skeleton, _REAR)
    if upright:
        found["front"] = (tuple(legs["hip"] + legs["ankle"]), tuple(legs["knee"]))
        sided = [(legs["hip"][0], legs["hip"][1])]
    elif head and head != (rear or skeleton.root):
        found["front"] = ((rear or skeleton.root,), (head,))
    found["left"] = (tuple(right for right, _ in sided[:2]), tuple(left for _, left in sided[:2]))
    feet = [pair for pair in sided if any(word in pair[0].lower() for word in _FEET)]
    ends = [joint for pair in feet for joint in pair if joint not in skeleton.parents.values()]
    if (not upright or not skeleton.gravity) and ends:
        found["up"] = (tuple(ends), (skeleton.root,))
    return _valid(found, skeleton)


def _valid(facing: dict[str, Ends], skeleton: Skeleton) -> dict[str, Ends]:
    plain = {name: [list(end) for end in ends] for name, ends in facing.items()}
    try:
        Skeleton.from_dict(skeleton.to_dict() | {"facing": plain})
    except UserError:
        return {}
    return facing


def _first(skeleton: Skeleton, words: Sequence[str]) -> str | None:
    paired = {joint for pair in skeleton.mirror for joint in pair}
    single = [joint for joint in skeleton.joints if joint not in paired]
    return next((j for word in words for j in single if word in j.lower().replace("_", "")), None)


def _joints(proposal: _Proposal) -> str:
    lines = ["# Names and order of the file."]
    if proposal.hidden:
        lines.append(_comment(f"Left out, as no frame shows them: {', '.join(proposal.hidden)}"))
    if proposal.seldom:
        lines.append(_comment(f"Visible in less than half of the frames: {', '.join(proposal.seldom)}"))
    return "\n".join([*lines, _list("joints: ", map(quoted, proposal.skeleton.joints))])


def _root(skeleton: Skeleton) -> str:
    if skeleton.root not in skeleton.midpoints:
        text = "# Poses are measured from the root: a joint near the middle that is nearly always seen."
        return f"{text}\nroot: {quoted(skeleton.root)}"
    parts = ", ".join(map(quoted, skeleton.midpoints[skeleton.root]))
    return (
        f"# Poses are measured from the root. No joint is near the middle, so it is made: the middle of a pair.\n"
        f"root: {skeleton.root}\nmidpoints:\n  {skeleton.root}: [{parts}]"
    )


def _bones(proposal: _Proposal) -> str:
    skeleton = proposal.skeleton
    given = {frozenset(bone) for bone in proposal.from_file}
    guessed = [bone for bone in skeleton.bones if frozenset(bone) not in given]
    if not given:
        how = "Guessed: joints that stay close and keep their distance over the frames. Check these first."
    elif guessed:
        how = f"From the file; by distance: {', '.join(f'{one} - {other}' for one, other in guessed)}."
    else:
        how = "From the file."
    text = _comment(f"[parent, child]; together they reach every joint from the root. {how}")
    text += "\n" + _pair_lists("bones: ", skeleton.bones)
    return text + ("\nloops: true      # bones close on themselves" if skeleton.loops else "")


def _mirror(proposal: _Proposal) -> str:
    if proposal.skeleton.mirror:
        text = "# [right, left] partners, by name or by the file. Joints on the midline are in no pair.\n"
        return text + _pair_lists("mirror: ", proposal.skeleton.mirror)
    if proposal.unmirrored:
        text = "These pairs are left out: the bones above are not the same on both sides of the body. Make them so."
        commented = _pair_lists("mirror: ", proposal.unmirrored).replace("\n", "\n# ")
        return f"{_comment(text)}\n# {commented}"
    return (
        "# [right, left] partners. TODO: the names show none; leave it out where nothing is symmetric.\n"
        "# mirror: [[right_joint, left_joint]]"
    )


def _facing(skeleton: Skeleton) -> str:
    head = _comment(
        "TODO. What tells a pose from its mirror image, which fits the same 2D: three directions [from, to] of the "
        "thing itself. Each end is a joint, or a list of joints (their mean). Choose what holds in nearly every "
        "pose, then take the # away. Without it a fit cannot tell the two apart."
    )
    guess = facing_guess(skeleton)
    if not guess:
        return "\n".join([head, "# facing:", "#   front: [a joint behind, a joint in front]",
                          "#   left: [a joint on the right, its partner on the left]",
                          "#   up: [a joint below, a joint above]"])  # fmt: skip
    lines = [head, "# By the names:\n# facing:"]
    for direction, ends in guess.items():
        shown = ", ".join(quoted(end[0]) if len(end) == 1 else "[" + ", ".join(map(quoted, end)) + "]" for end in ends)
        lines.append(f"#   {direction}: [{shown}]")
    return "\n".join(lines)


def _comment(text: str) -> str:
    return "\n".join(textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# "))


def _list(key: str, items: Iterable[str]) -> str:
    """Return a flow list in lines of bounded width, broken between items."""
    lines, line = [], f"{key}["
    for place, item in enumerate(items):
        piece = item if not place else f", {item}"
        if place and len(line) + len(piece) > _WIDTH:
            lines.append(f"{line},")
            line = " " * (len(key) + 1) + item
        else:
            line += piece
    return "\n".join([*lines, f"{line}]"])


def _pair_lists(key: str, pairs: Iterable[Sequence[str]]) -> str:
    return _list(key, (f"[{quoted(one)}, {quoted(other)}]" for one, other in pairs))


_TEMPLATE = """\
# A skeleton: the joints of what you track, and what is known about them.
# This one is complete, a beetle seen by a tracker with 15 keypoints: replace it with yours, then
#   uplift skeleton check {file}
# tells what is wrong and draws it, and
#   uplift fit skeleton={file} data.train=your_keypoints.npz
# learns to lift it. Everything goes by joint name; the order in your files does not matter.
name: {name}
description: a six-legged insect, 15 keypoints and one made of them

# Names as in your files. Joints listed under midpoints (below) need not be in the files.
joints: [head, thorax, abdomen_tip,
         front_knee_l, front_claw_l, middle_knee_l, middle_claw_l, hind_knee_l, hind_claw_l,
         front_knee_r, front_claw_r, middle_knee_r, middle_claw_r, hind_knee_r, hind_claw_r,
         body]

# Poses are measured from the root. Take a joint that is seen well, near the middle.
root: thorax

# [parent, child]; together they reach every joint from the root.
bones: [[thorax, head], [thorax, body], [body, abdomen_tip],
        [thorax, front_knee_l], [front_knee_l, front_claw_l],
        [thorax, middle_knee_l], [middle_knee_l, middle_claw_l],
        [body, hind_knee_l], [hind_knee_l, hind_claw_l],
        [thorax, front_knee_r], [front_knee_r, front_claw_r],
        [thorax, middle_knee_r], [middle_knee_r, middle_claw_r],
        [body, hind_knee_r], [hind_knee_r, hind_claw_r]]
# loops: true    # if bones close on themselves, as the seat of a chair does; otherwise a cycle is an error

# [right, left] partners. Joints on the midline are in no pair. Leave out where nothing is symmetric.
mirror: [[front_knee_r, front_knee_l], [front_claw_r, front_claw_l],
         [middle_knee_r, middle_knee_l], [middle_claw_r, middle_claw_l],
         [hind_knee_r, hind_knee_l], [hind_claw_r, hind_claw_l]]

# What tells a pose from its mirror image, which fits the same 2D: three directions [from, to] of the
# thing itself. Each end is a joint, or a list of joints (their mean). Choose what holds in nearly
# every pose. `up` may be left out where gravity is true and the thing stays upright.
facing:
  front: [abdomen_tip, head]
  left: [[front_knee_r, middle_knee_r, hind_knee_r], [front_knee_l, middle_knee_l, hind_knee_l]]
  up: [[front_claw_l, middle_claw_l, hind_claw_l, front_claw_r, middle_claw_r, hind_claw_r],
       [front_knee_l, middle_knee_l, hind_knee_l, front_knee_r, middle_knee_r, hind_knee_r]]

# true: it stands or walks on the ground, and the camera is more or less level.
# false: it may be seen from any side (a hand, a thing that floats); then facing needs `up`.
gravity: true
# rigid: true    # one shape that does not bend (a chair)

# Joints that no file holds, made of others: handy for a root in the middle.
midpoints:
  body: [thorax, abdomen_tip]

# Other layouts these joints can be built from, by their names; a list is a mean, and a joint left
# out counts as missing.
# from:
#   my_other_tracker: {{head: Head, thorax: [WingL, WingR], abdomen_tip: Tail}}

# For `uplift simulate`: a body to rehearse with before there is data. Seen facing the camera, x is
# the body's left, y down, z behind it. rest: the direction of the bone from the parent to the joint.
# proportions: its length, in any unit.
# rest: {{head: [0, 0, -1], front_knee_l: [1, -0.5, -0.5], front_claw_l: [0.5, 1, -0.2], ...}}
# proportions: {{head: 0.2, front_knee_l: 0.3, front_claw_l: 0.4, ...}}
# limits: {{front_knee_l: {{flexion: [-40, 40]}}, ...}}
"""


def skeleton_template(name: str) -> str:
    """Return the text of a complete, commented skeleton called ``name``, for the user to rewrite."""
    return _TEMPLATE.format(name=quoted(name), file=f"{name}.yaml")


def quoted(name: str) -> str:
    """Return a name as YAML text that cannot be read as anything else, inside a list too."""
    plain = re.fullmatch(r"[A-Za-z_](?:[\w.+ -]*[\w.+-])?", name, re.ASCII)
    reserved = name.casefold() in ("true", "false", "yes", "no", "on", "off", "null", "y", "n")
    return name if plain and not reserved else "'" + name.replace("'", "''") + "'"
