"""Acclaim skeletons (``.asf``): bones with direction, length, axes and degrees of freedom.

Format: Acclaim Corp.'s ASF/AMC as CMU's Vicon software writes it. A bone's angles turn about axes of
its own, which ``axis`` gives in the world's frame of the rest pose; directions are in that frame, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.mocap.bone import Bone
from uplift.mocap.figure import Tree
from uplift.mocap.text import fault, numbers, read_lines, shown

__all__ = ["AsfSkeleton", "read_asf"]

_INCH_MM = 25.4
_ANGLES = ("rx", "ry", "rz")
_ROOT = ["tx", "ty", "tz", *_ANGLES]


@dataclass(frozen=True)
class AsfSkeleton:
    """The bones of an ASF file, parents first, and how the root moves."""

    path: Path
    bones: list[Bone]
    tree: Tree
    """``root`` first, then the bones: the joint named as a bone is where that bone starts."""
    unit_mm: float
    """Millimetres in the file's unit of length."""
    degrees: bool
    root: Bone
    """`Bone.dof` is the order of the root's six values."""
    position: list[float]


def read_asf(path: Path) -> AsfSkeleton:
    """Read an Acclaim skeleton.

    Raises:
        UserError: another format, a truncated file, a bone without direction, a broken hierarchy.
    """
    lines = read_lines(path, "an Acclaim skeleton (.asf)")
    sections = _sections(path, lines)
    for needed in (":root", ":bonedata", ":hierarchy"):
        if needed not in sections:
            found = ", ".join(sections) or "no sections"
            raise UserError(f"{path}: no section {needed} (found: {found}). Truncated, or not an Acclaim skeleton?")
    units = _units(path, sections.get(":units", []))
    root, position = _root(path, sections[":root"])
    bones = _bones(path, sections[":bonedata"])
    ordered, parents = _hierarchy(path, sections[":hierarchy"], bones)
    if not units.get("degrees", 1):
        for bone in ordered:
            bone.axis = np.rad2deg(bone.axis).tolist()
    degrees = bool(units.get("degrees", 1))
    unit_mm = _INCH_MM / units.get("length", 1.0)
    return AsfSkeleton(path, ordered, _tree(ordered, parents), unit_mm, degrees, root, position)


def _sections(path: Path, lines: list[bytes]) -> dict[str, list[tuple[int, list[bytes]]]]:
    sections: dict[str, list[tuple[int, list[bytes]]]] = {}
    rows: list[tuple[int, list[bytes]]] | None = None
    for number, line in enumerate(lines, 1):
        words = line.split(b"#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(b":"):
            rows = sections.setdefault(words[0].decode("ascii", "replace").lower(), [])
            words = words[1:]
        elif rows is None:
            raise fault(
                path, number, f"found {shown(line)}, expected an Acclaim skeleton (:version, :units, :root ...)."
            )
        if words:
            rows.append((number, words))
    return sections


def _units(path: Path, rows: list[tuple[int, list[bytes]]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for number, (key, *words) in rows:
        if key.lower() == b"length":
            (found["length"],) = numbers(path, number, words, 1, "length")
            if found["length"] <= 0:
                raise fault(path, number, f"length is {found['length']:g}, expected a number above 0 (CMU: 0.45).")
        elif key.lower() == b"angle":
            if not words or words[0].lower()[:3] not in (b"deg", b"rad"):
                raise fault(path, number, f"angle is {shown(b' '.join(words))}, expected deg or rad.")
            found["degrees"] = float(words[0].lower().startswith(b"deg"))
    return found


def _root(path: Path, rows: list[tuple[int, list[bytes]]]) -> tuple[Bone, list[float]]:
    root, position = Bone("root", dof=_ROOT), [0.0, 0.0, 0.0]
    for number, (key, *words) in rows:
        if key.lower() == b"order":
            root.dof = [word.decode("ascii", "replace").lower() for word in words]
            if sorted(root.dof) != sorted(_ROOT):
                raise fault(
                    path, number, f"order is {shown(b' '.join(words))}, expected TX TY TZ RX RY RZ in any order."
                )
        elif key.lower() == b"axis":
            root.order = _order(path, number, words[:1])
        elif key.lower() == b"position":
            position = numbers(path, number, words, 3, "position")
        elif key.lower() == b"orientation" and any(numbers(path, number, words, 3, "orientation")):
            raise fault(path, number, "the root has an orientation of its own, expected 0 0 0 as in CMU's files.")
    return root, position


def _order(path: Path, line: int, words: list[bytes]) -> str:
    order = b"".join(words).decode("ascii", "replace").lower()
    if sorted(order) != list("xyz"):
        raise fault(path, line, f"the order of axes is {shown(b' '.join(words))}, expected XYZ in any order.")
    return order


def _bones(path: Path, rows: list[tuple[int, list[bytes]]]) -> dict[str, Bone]:
    bones: dict[str, Bone] = {}
    bone: Bone | None = None
    for number, (key, *words) in rows:
        word = key.lower()
        if word == b"begin":
            bone = Bone(line=number)
        elif bone is None:
            raise fault(path, number, f"found {shown(key)} outside of a bone, expected begin.")
        elif word == b"end":
            _check_bone(path, bone, bones)
            bones[bone.name] = bone
            bone = None
        elif word == b"name":
            bone.name = b" ".join(words).decode("utf-8", "replace")
        elif word == b"direction":
            bone.direction = numbers(path, number, words, 3, "direction")
        elif word == b"length":
            (bone.length,) = numbers(path, number, words, 1, "length")
        elif word == b"axis":
            bone.axis = numbers(path, number, words, 3, "axis")
            bone.order = _order(path, number, words[3:4])
        elif word == b"dof":
            bone.dof = [w.decode("ascii", "replace").lower() for w in words]
            if not set(bone.dof) <= set(_ANGLES) or len(set(bone.dof)) != len(bone.dof):
                raise fault(path, number, f"dof is {shown(b' '.join(words))}, expected rx ry rz or some of them.")
    if bone is not None:
        raise fault(path, bone.line, "a bone begins here and does not end: the file is truncated.")
    if not bones:
        raise UserError(f"{path}: no bones in :bonedata.")
    return bones


def _check_bone(path: Path, bone: Bone, others: dict[str, Bone]) -> None:
    if not bone.name or bone.name in others or bone.name == "root":
        raise fault(path, bone.line, f"a bone is called {bone.name!r}, expected a name of its own.")
    size = float(np.linalg.norm(bone.direction)) if bone.direction else 0.0
    if not np.isfinite(bone.length) or bone.length < 0 or not 0.9 < size < 1.1:
        raise fault(path, bone.line, f"bone '{bone.name}' needs a direction of length 1 and a length of 0 or more.")


def _hierarchy(
    path: Path, rows: list[tuple[int, list[bytes]]], bones: dict[str, Bone]
) -> tuple[list[Bone], dict[str, str]]:
    """Return the bones, parents first, and the parent of each."""
    parents: dict[str, str] = {}
    ordered: list[Bone] = []
    names = [(number, [word.decode("utf-8", "replace") for word in words]) for number, words in rows]
    if not names or names[-1][1] != ["end"]:
        raise UserError(f"{path}: the section :hierarchy does not end: the file is truncated.")
    for number, (parent, *children) in names:
        if parent in ("begin", "end"):
            continue
        if parent != "root" and parent not in parents:
            raise fault(path, number, f"'{parent}' has bones below it, but hangs on nothing named before.")
        for child in children:
            if child not in bones or child in parents:
                what = "is named a second time" if child in parents else "is not in :bonedata"
                raise fault(path, number, f"bone '{child}' {what}.")
            parents[child] = parent
            ordered.append(bones[child])
    lost = [name for name in bones if name not in parents]
    if lost:
        raise UserError(f"{path}: bones that hang on nothing in :hierarchy: {', '.join(lost[:10])}.")
    return ordered, parents


def _tree(bones: list[Bone], parents: dict[str, str]) -> Tree:
    names = ["root", *(bone.name for bone in bones)]
    tips = np.array([[0.0, 0.0, 0.0], *(np.multiply(bone.direction, bone.length) for bone in bones)])
    place = [-1, *(names.index(parents[bone.name]) for bone in bones)]
    # A bone starts where its parent ends.
    offsets = np.array([np.zeros(3), *(tips[parent] for parent in place[1:])])
    return Tree(tuple(names), tuple(place), offsets, tips)
