"""What names of joints tell: which are partners, which side they are on, which mean the same. All of it guesses."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence

from uplift.skeleton import Skeleton

__all__ = ["guess_parts", "mirror_pairs", "name_words"]

# From the surest sign of a side to the weakest: a word, a letter by itself, a capital, a letter at either end.
_SIGNS = (
    re.compile(r"left|right", re.IGNORECASE),
    re.compile(r"(?<![A-Za-z])[lr](?![A-Za-z])", re.IGNORECASE),
    re.compile(r"[LR]"),
    re.compile(r"(?<![A-Za-z])[lr]|[lr](?![A-Za-z])"),
)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

# Words that name the same place; a joint on the midline and the middle of a pair are told apart by the side.
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


def name_words(name: str) -> list[str]:
    """Return the words of a name in small letters: split at capitals, digits and anything that is no letter."""
    return [word.lower() for word in _WORD.findall(name)]


def guess_parts(skeleton: Skeleton, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return which of ``names`` each joint of the skeleton may be, by what the words mean; never to be applied unseen.

    A joint on the midline may be the mean of a pair. Joints that nothing is like are absent.
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
    """Yield the name with a sign of a side turned into the other, and whether that sign says left."""
    for match in sign.finditer(name):
        yield _turned(name, match), match[0][0].lower() == "l"


def _turned(name: str, match: re.Match[str]) -> str:
    old = match[0]
    new = _OTHER[old.lower()]
    new = new.upper() if old.isupper() else new.capitalize() if old[0].isupper() else new
    return name[: match.start()] + new + name[match.end() :]


def _meanings(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return for each name its side ("l", "r" or none) and what is left of it, words put in one form."""
    side: dict[str, str] = {}
    for right, left in mirror_pairs(names):
        side[right], side[left] = "r", "l"
    rest = {name: [word for word in name_words(name) if word not in _OTHER] for name in names}
    for right, left in mirror_pairs(names):
        if rest[right] != rest[left]:  # lhip, rhip: the side is a part of a word
            rest[right] = rest[left] = _without_side(right, left)
    for name in names:
        if name not in side:
            side[name] = next((word[0] for word in name_words(name) if word in _OTHER), "")
    return {name: (side[name], _one_form(rest[name], bool(side[name]))) for name in names}


def _without_side(right: str, left: str) -> list[str]:
    """Return the words that two partners share: without the sign of the side, and without digits, which may differ."""
    one, other = (re.sub(r"\d+", "", name) for name in (right, left))
    for sign in _SIGNS:
        for match in sign.finditer(one):
            if _turned(one, match) == other:
                return name_words(f"{one[: match.start()]} {one[match.end() :]}")
    return name_words(one)


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
