"""The commented YAML of a proposed skeleton, ready to be corrected by hand."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.proposal import Proposal
from uplift.skeleton.proposal_names import mirror_pairs, name_words
from uplift.skeleton.template import quoted

__all__ = ["facing_guess", "proposal_text"]

Ends = tuple[tuple[str, ...], tuple[str, ...]]

_WIDTH = 108
_FRONT = ("nose", "snout", "beak", "muzzle", "head", "neck")
_REAR = ("tailbase", "tail", "rump", "croup", "sacrum", "abdomen", "stinger", "body", "thorax")
_ACROSS = ("wing", "antenna")  # they may lie on the other side
_FEET = ("toe", "paw", "foot", "claw", "hoof", "tarsus", "tip", "ankle", "leg")


def proposal_text(proposal: Proposal, file: str, source: str) -> str:
    """Return the YAML of a proposal as the file called ``file``; what is not known is in comments."""
    skeleton = proposal.skeleton
    told = _comment(
        f"A skeleton proposed from {source}. The names are the file's; everything else is a guess: read it through "
        "and correct it. Then"
    )
    parts = [
        f"{told}\n#   uplift skeleton check {file}\n# tells what is wrong and draws it, and\n"
        f"#   uplift fit skeleton={file} data.train={source}\n# learns to lift it. docs/skeletons.md has every key.",
        f"name: {quoted(skeleton.name)}\ndescription: proposed from a file, to be corrected",
        _joints(proposal),
        _root(skeleton),
        _bones(proposal),
        _mirror(proposal),
        _facing(skeleton),
        _rest(skeleton),
    ]
    return "\n\n".join(parts) + "\n"


def facing_guess(skeleton: Skeleton) -> dict[str, Ends]:
    """Return the directions that the joints' names suggest; nothing where they say too little.

    Directions that a skeleton file would refuse are left out.
    """
    sided = [pair for pair in mirror_pairs(skeleton.joints) if set(pair) in map(set, skeleton.mirror)]
    near = {joint: place for place, joint in enumerate(skeleton.parents)}
    sided = sorted(sided, key=lambda pair: (any(word in pair[0].lower() for word in _ACROSS), near[pair[0]]))
    if not sided:
        return {}
    found: dict[str, Ends] = {}
    legs = {word: [joint for pair in sided for joint in pair if word in name_words(joint) or joint[1:].lower() == word]
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
    needed = {"front", "left"} if skeleton.gravity else {"front", "left", "up"}
    if not needed <= set(facing):
        return {}
    try:
        Skeleton.from_dict(
            skeleton.to_dict() | {"facing": {name: [list(e) for e in ends] for name, ends in facing.items()}}
        )
    except UserError:
        return {}
    return facing


def _first(skeleton: Skeleton, words: Sequence[str]) -> str | None:
    """Return the first joint on the midline whose name holds one of the words, by the order of the words."""
    paired = {joint for pair in skeleton.mirror for joint in pair}
    for word in words:
        for joint in skeleton.joints:
            if joint not in paired and word in joint.lower().replace("_", ""):
                return joint
    return None


def _joints(proposal: Proposal) -> str:
    skeleton = proposal.skeleton
    lines = ["# Names and order of the file."]
    if proposal.hidden:
        lines.append(_comment(f"Left out, as no frame shows them: {', '.join(proposal.hidden)}"))
    if proposal.seldom:
        lines.append(_comment(f"Visible in less than half of the frames: {', '.join(proposal.seldom)}"))
    lines.append(_list("joints: ", map(quoted, skeleton.joints)))
    return "\n".join(lines)


def _root(skeleton: Skeleton) -> str:
    if skeleton.root not in skeleton.midpoints:
        text = "# Poses are measured from the root: a joint near the middle that is nearly always seen."
        return f"{text}\nroot: {quoted(skeleton.root)}"
    parts = ", ".join(map(quoted, skeleton.midpoints[skeleton.root]))
    return (
        f"# Poses are measured from the root. No joint is near the middle, so it is made: the middle of a pair.\n"
        f"root: {skeleton.root}\nmidpoints:\n  {skeleton.root}: [{parts}]"
    )


def _bones(proposal: Proposal) -> str:
    skeleton = proposal.skeleton
    own = {frozenset(bone) for bone in proposal.from_file}
    guessed = [bone for bone in skeleton.bones if frozenset(bone) not in own]
    if not own:
        how = "Guessed: joints that stay close and keep their distance over the frames. Check these first."
    elif guessed:
        how = f"From the file; by distance: {', '.join(f'{one} - {other}' for one, other in guessed)}."
    else:
        how = "From the file."
    text = _comment(f"[parent, child]; together they reach every joint from the root. {how}")
    text += "\n" + _pairs("bones: ", skeleton.bones)
    return text + ("\nloops: true      # bones close on themselves" if skeleton.loops else "")


def _mirror(proposal: Proposal) -> str:
    if proposal.skeleton.mirror:
        text = "# [right, left] partners, by name or by the file. Joints on the midline are in no pair.\n"
        return text + _pairs("mirror: ", proposal.skeleton.mirror)
    if proposal.unmirrored:
        text = "These pairs are left out: the bones above are not the same on both sides of the body. Make them so."
        commented = _pairs("mirror: ", proposal.unmirrored).replace("\n", "\n# ")
        return f"{_comment(text)}\n# {commented}"
    return (
        "# [right, left] partners. TODO: the names show none; leave it out where nothing is symmetric.\n"
        "# mirror: [[right_joint, left_joint]]"
    )


def _facing(skeleton: Skeleton) -> str:
    lines = [
        _comment(
            "TODO. What tells a pose from its mirror image, which fits the same 2D: three directions [from, to] of the "
            "thing itself. Each end is a joint, or a list of joints (their mean). Choose what holds in nearly every "
            "pose, then take the # away. Without it a fit cannot tell the two apart."
        )
    ]
    guess = facing_guess(skeleton)
    if not guess:
        return "\n".join([*lines, "# facing:", "#   front: [a joint behind, a joint in front]",
                          "#   left: [a joint on the right, its partner on the left]",
                          "#   up: [a joint below, a joint above]"])  # fmt: skip
    lines.append("# By the names:\n# facing:")
    for direction, ends in guess.items():
        shown = ", ".join(quoted(end[0]) if len(end) == 1 else "[" + ", ".join(map(quoted, end)) + "]" for end in ends)
        lines.append(f"#   {direction}: [{shown}]")
    return "\n".join(lines)


def _rest(skeleton: Skeleton) -> str:
    one, other = skeleton.bones[0]
    return "\n".join(
        [
            "# true: it stands or walks on the ground, and the camera is more or less level.",
            "# false: it may be seen from any side (a hand, a thing that floats); then facing needs `up`.",
            f"gravity: {str(skeleton.gravity).lower()}",
            "# rigid: true    # one shape that does not bend (a chair)",
            "",
            "# The true length of one bone, for poses in mm.",
            f"# size: {{along: [{quoted(one)}, {quoted(other)}], mm: 10}}",
        ]
    )


def _comment(text: str) -> str:
    return "\n".join(textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# "))


def _list(key: str, items: Iterable[str]) -> str:
    """Return a flow list in lines of bounded width, items whole."""
    lines, line = [], f"{key}["
    for place, item in enumerate(items):
        piece = item if not place else f", {item}"
        if place and len(line) + len(piece) > _WIDTH:
            lines.append(f"{line},")
            line = " " * (len(key) + 1) + item
        else:
            line += piece
    return "\n".join([*lines, f"{line}]"])


def _pairs(key: str, pairs: Iterable[Sequence[str]]) -> str:
    return _list(key, (f"[{quoted(one)}, {quoted(other)}]" for one, other in pairs))
