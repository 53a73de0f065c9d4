"""Motion capture files: Acclaim (``.asf`` and ``.amc``) and Biovision (``.bvh``), as joints in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import compress
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.data.parsers.files import read_bytes
from uplift.errors import UserError, listed
from uplift.geometry.rigid import rotation_about

__all__ = ["AsfSkeleton", "Figure", "Tree", "open_bvh", "read_amc", "read_asf", "read_lines"]

_MOST = 1e9
"""No length or angle of a motion is as large."""


def read_lines(path: Path, what: str) -> list[str]:
    """Return the lines of a text file without their ends, up to the last that is not empty.

    Raises:
        UserError: not text, or a file that cannot be read.
    """
    content = read_bytes(path)
    if b"\0" in content:
        raise UserError(f"{path}: this is not text, expected {what}.")
    if not content.strip():
        raise UserError(f"{path}: empty, expected {what}.")
    return content.decode("utf-8", "replace").rstrip().replace("\r\n", "\n").replace("\r", "\n").split("\n")


class _File:
    """The lines of a motion capture file, and errors that name the line (the first is 1)."""

    def __init__(self, path: Path, what: str) -> None:
        self.path, self.lines = path, read_lines(path, what)

    def fault(self, line: int, message: str) -> UserError:
        """Return the error for a line."""
        return UserError(f"{self.path}, line {line}: {message}")

    def numbers(self, line: int, words: list[str], count: int, what: str) -> list[float]:
        """Return the first ``count`` words as finite numbers; raises UserError where they are not."""
        try:
            found = [float(word) for word in words[:count]]
        except ValueError:
            found = []
        if len(found) != count or not all(abs(number) < _MOST for number in found):
            raise self.fault(line, f"{what} is {_shown(words)}, expected {_count(count)}.")
        return found


def _shown(words: str | list[str]) -> str:
    """Return what is in a line, short and printable, in quotes."""
    text = words.strip() if isinstance(words, str) else " ".join(words)
    return repr(text if len(text) <= 40 else text[:40] + "...")


def _count(numbers: int) -> str:
    return f"{numbers} number{'s' * (numbers > 1)}"


# A tree of joints, and where they are in each frame.


@dataclass(frozen=True)
class Tree:
    """Joints, parents first: each sits at ``offset`` in its parent's frame and turns about itself."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """-1 for the root."""
    offsets: Float[np.ndarray, "joints 3"]
    """From the parent joint, in the parent's frame, in the file's unit."""
    tips: Float[np.ndarray, "joints 3"]
    """Where the bone ends, in the joint's own frame; NaN where the file does not say."""

    def length(self, name: str) -> float:
        """Return the distance from the joint's parent."""
        return float(np.linalg.norm(self.offsets[self.names.index(name)]))


@dataclass(frozen=True)
class Figure:
    """Positions and frames of a tree's joints in the world (y up), in the file's unit."""

    tree: Tree
    positions: Float[np.ndarray, "joints frames 3"]
    rotations: Float[np.ndarray, "joints frames 3 3"]

    @classmethod
    def posed(
        cls, tree: Tree, root: Float[np.ndarray, "frames 3"], turns: Sequence[Float[np.ndarray, "frames 3 3"] | None]
    ) -> Figure:
        """Return ``tree`` with its root at ``root`` and joint i turned by ``turns[i]`` in its parent's frame, if at all."""
        positions = np.empty((len(tree.names), len(root), 3))
        rotations = np.empty((len(tree.names), len(root), 3, 3))
        for joint, (parent, turn) in enumerate(zip(tree.parents, turns, strict=True)):
            if parent < 0:
                positions[joint] = root
                rotations[joint] = np.eye(3) if turn is None else turn
                continue
            positions[joint] = positions[parent] + rotations[parent] @ tree.offsets[joint]
            rotations[joint] = rotations[parent] if turn is None else rotations[parent] @ turn
        return cls(tree, positions, rotations)

    def at(self, name: str) -> Float[np.ndarray, "frames 3"]:
        """Return where the joint ``name`` is."""
        return self.positions[self.tree.names.index(name)]

    def beyond(self, name: str, step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "frames 3"]:
        """Return the point ``step`` away from the joint, in the joint's own frame."""
        joint = self.tree.names.index(name)
        return self.positions[joint] + self.rotations[joint] @ step


def _rotations(degrees: Float[np.ndarray, "frames angles"], axes: str) -> Float[np.ndarray, "frames 3 3"]:
    """Return the rotations about the axes of ``axes`` (such as ``zyx``), each about the axes turned before it."""
    return reduce(np.matmul, map(rotation_about, axes, np.deg2rad(degrees).T))


# Acclaim skeletons (``.asf``): bones with direction, length, axes and degrees of freedom.

_INCH_MM = 25.4
_ANGLES = ["rx", "ry", "rz"]
_ROOT = ["tx", "ty", "tz", *_ANGLES]
_Rows = list[tuple[int, list[str]]]
"""Lines of a section: their numbers and words."""


@dataclass
class _Bone:
    """A bone of an ASF file, angles in degrees, lengths in the file's unit."""

    name: str = ""
    line: int = 0
    direction: list[float] = field(default_factory=list)
    length: float = float("nan")
    axis: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    order: str = "xyz"
    dof: list[str] = field(default_factory=list)

    def turned(self, degrees: Float[np.ndarray, "frames angles"]) -> Float[np.ndarray, "frames 3 3"]:
        """Return the rotations of the bone in its parent's frame for angles in the order of `dof`."""
        angles = np.zeros((len(degrees), 3))
        for column, name in enumerate(self.dof):
            angles[:, self.order.index(name[1])] = degrees[:, column]
        # "XYZ" is first about X, then about the world's Y, then its Z: about the turned axes that is Z, Y, X.
        order = self.order[::-1]
        frame = _rotations(np.array([self.axis[::-1]]), order)[0]
        return frame @ _rotations(angles[:, ::-1], order) @ frame.T


@dataclass(frozen=True)
class AsfSkeleton:
    """The bones of an ASF file, parents first, and how the root moves."""

    path: Path
    bones: list[_Bone]
    tree: Tree
    """``root`` first, then the bones: the joint named as a bone is where that bone starts."""
    unit_mm: float
    """Millimetres in the file's unit of length."""
    degrees: bool
    root: _Bone
    """`Bone.dof` is the order of the root's six values."""
    position: list[float]


def read_asf(path: Path) -> AsfSkeleton:
    """Read an Acclaim skeleton.

    Raises:
        UserError: another format, a truncated file, a bone without direction, a broken hierarchy.
    """
    file = _File(path, "an Acclaim skeleton (.asf)")
    sections = _sections(file)
    for needed in (":root", ":bonedata", ":hierarchy"):
        if needed not in sections:
            found = listed(sections) or "no sections"
            raise UserError(f"{path}: no section {needed} (found: {found}). Truncated, or not an Acclaim skeleton?")
    unit_mm, degrees = _units(file, sections.get(":units", []))
    root, position = _root(file, sections[":root"])
    bones = _bones(file, sections[":bonedata"])
    if not degrees:
        for bone in bones.values():
            bone.axis = np.rad2deg(bone.axis).tolist()
    tree = _hierarchy(file, sections[":hierarchy"], bones)
    return AsfSkeleton(path, [bones[name] for name in tree.names[1:]], tree, unit_mm, degrees, root, position)


def _sections(file: _File) -> dict[str, _Rows]:
    sections: dict[str, _Rows] = {}
    rows: _Rows | None = None
    for number, line in enumerate(file.lines, 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            rows = sections.setdefault(words[0].lower(), [])
            words = words[1:]
        elif rows is None:
            expected = "expected an Acclaim skeleton (:version, :units, :root ...)."
            raise file.fault(number, f"found {_shown(line)}, {expected}")
        if words:
            rows.append((number, words))
    return sections


def _units(file: _File, rows: _Rows) -> tuple[float, bool]:
    """Return the millimetres in the unit of length, and whether angles are in degrees."""
    unit_mm, degrees = _INCH_MM, True
    for number, (key, *words) in rows:
        if key.lower() == "length":
            (length,) = file.numbers(number, words, 1, "length")
            if length <= 0:
                raise file.fault(number, f"length is {length:g}, expected a number above 0 (CMU: 0.45).")
            unit_mm = _INCH_MM / length
        elif key.lower() == "angle":
            angle = words[0].lower()[:3] if words else ""
            if angle not in ("deg", "rad"):
                raise file.fault(number, f"angle is {_shown(words)}, expected deg or rad.")
            degrees = angle == "deg"
    return unit_mm, degrees


def _root(file: _File, rows: _Rows) -> tuple[_Bone, list[float]]:
    root, position = _Bone("root", dof=_ROOT), [0.0, 0.0, 0.0]
    for number, (key, *words) in rows:
        key = key.lower()
        if key == "order":
            root.dof = [word.lower() for word in words]
            if sorted(root.dof) != sorted(_ROOT):
                raise file.fault(number, f"order is {_shown(words)}, expected TX TY TZ RX RY RZ in any order.")
        elif key == "axis":
            root.order = _order(file, number, words[:1])
        elif key == "position":
            position = file.numbers(number, words, 3, "position")
        elif key == "orientation" and any(file.numbers(number, words, 3, "orientation")):
            raise file.fault(number, "the root has an orientation, expected 0 0 0 as in CMU's files.")
    return root, position


def _order(file: _File, line: int, words: list[str]) -> str:
    order = "".join(words).lower()
    if sorted(order) != list("xyz"):
        raise file.fault(line, f"the order of axes is {_shown(words)}, expected XYZ in any order.")
    return order


def _bones(file: _File, rows: _Rows) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    bone: _Bone | None = None
    for number, (key, *words) in rows:
        word = key.lower()
        if word == "begin":
            bone = _Bone(line=number)
        elif bone is None:
            raise file.fault(number, f"found {_shown(key)} outside of a bone, expected begin.")
        elif word == "end":
            _check_bone(file, bone, bones)
            bones[bone.name] = bone
            bone = None
        elif word == "name":
            bone.name = " ".join(words)
        elif word == "direction":
            bone.direction = file.numbers(number, words, 3, "direction")
        elif word == "length":
            (bone.length,) = file.numbers(number, words, 1, "length")
        elif word == "axis":
            bone.axis = file.numbers(number, words, 3, "axis")
            bone.order = _order(file, number, words[3:4])
        elif word == "dof":
            bone.dof = [word.lower() for word in words]
            if not set(bone.dof) <= set(_ANGLES) or len(set(bone.dof)) != len(bone.dof):
                raise file.fault(number, f"dof is {_shown(words)}, expected rx ry rz or some of them.")
    if bone is not None:
        raise file.fault(bone.line, "a bone begins here and does not end: the file is truncated.")
    if not bones:
        raise UserError(f"{file.path}: no bones in :bonedata.")
    return bones


def _check_bone(file: _File, bone: _Bone, others: dict[str, _Bone]) -> None:
    if not bone.name or bone.name in others or bone.name == "root":
        raise file.fault(bone.line, f"a bone is called {bone.name!r}, expected a unique name.")
    size = float(np.linalg.norm(bone.direction)) if bone.direction else 0.0
    if not np.isfinite(bone.length) or bone.length < 0 or not 0.9 < size < 1.1:
        raise file.fault(bone.line, f"bone '{bone.name}' needs a direction of length 1 and a length of 0 or more.")


def _hierarchy(file: _File, rows: _Rows, bones: dict[str, _Bone]) -> Tree:
    if not rows or rows[-1][1] != ["end"]:
        raise UserError(f"{file.path}: the section :hierarchy does not end: the file is truncated.")
    places, parents = {"root": 0}, [-1]
    for number, (parent, *children) in rows:
        if parent in ("begin", "end"):
            continue
        if parent not in places:
            raise file.fault(number, f"'{parent}' has bones below it, but no parent in the lines before.")
        for child in children:
            if child not in bones or child in places:
                what = "is named a second time" if child in places else "is not in :bonedata"
                raise file.fault(number, f"bone '{child}' {what}.")
            places[child] = len(places)
            parents.append(places[parent])
    lost = [name for name in bones if name not in places]
    if lost:
        raise UserError(f"{file.path}: bones without a parent in :hierarchy: {listed(lost)}.")
    ordered = [bones[name] for name in places if name != "root"]
    tips = np.array([[0.0, 0.0, 0.0], *(np.multiply(bone.direction, bone.length) for bone in ordered)])
    # A bone starts where its parent ends.
    offsets = np.array([np.zeros(3), *(tips[parent] for parent in parents[1:])])
    return Tree(tuple(places), tuple(parents), offsets, tips)


# Acclaim motion (``.amc``): for each frame a number, then a line of values for the root and each bone.


def read_amc(path: Path, skeleton: AsfSkeleton, step: int = 1) -> Figure:
    """Return every ``step``-th frame of a motion of ``skeleton``, the first included.

    Raises:
        UserError: other bones or numbers of values than the skeleton's, a truncated file, no numbers.
    """
    file = _AmcFile(path, skeleton)
    parts = file.values(step)
    column = skeleton.root.dof.index
    root = parts["root"][:, [column(key) for key in ("tx", "ty", "tz")]] + skeleton.position
    parts["root"] = parts["root"][:, [column(key) for key in _ANGLES]]
    if not file.degrees:
        parts = {name: np.rad2deg(angles) for name, angles in parts.items()}
    bones = [replace(skeleton.root, dof=_ANGLES), *skeleton.bones]
    turns = [bone.turned(parts[bone.name]) if bone.name in parts else None for bone in bones]
    return Figure.posed(skeleton.tree, root, turns)


class _AmcFile(_File):
    """The lines of the frames, which lines of the file they are, and how many values each bone has."""

    def __init__(self, path: Path, skeleton: AsfSkeleton) -> None:
        super().__init__(path, "an Acclaim motion (.amc)")
        self.degrees, self._skeleton = skeleton.degrees, skeleton.path.name
        self._widths = {"root": 6, **{bone.name: len(bone.dof) for bone in skeleton.bones if bone.dof}}
        start = self._first_frame()
        self._frames, self._places = self.lines[start:], range(start + 1, len(self.lines) + 1)
        if not self._regular():
            kept = [bool(line.strip()) and not line.lstrip().startswith("#") for line in self._frames]
            self._frames, self._places = list(compress(self._frames, kept)), list(compress(self._places, kept))
            self._check_all()

    def _first_frame(self) -> int:
        for place, line in enumerate(self.lines):
            words = line.upper().split()
            if not words or words[0].startswith("#"):
                continue
            if words[0] in (":DEGREES", ":RADIANS"):
                self.degrees = words[0] == ":DEGREES"
            elif len(words) == 1 and words[0].isdecimal():
                return place
            elif not words[0].startswith(":"):
                raise self.fault(place + 1, f"found {_shown(line)}, expected the number of the first frame.")
        raise self.fault(len(self.lines), "the file ends before the first frame.")

    def _regular(self) -> bool:
        """Return whether the frame numbers are where they must be when no line is missing or too many."""
        size = len(self._widths) + 1
        try:
            found = np.array([int(number) for number in self._frames[::size]])
        except ValueError:
            return False
        return len(self._frames) % size == 0 and bool((np.diff(found) == 1).all())

    def _check_all(self) -> None:
        """Raise the error of the first line that is not as it should be, if any."""
        last, missing = None, set()
        for number, line in zip(self._places, self._frames, strict=True):
            words = line.split()
            if len(words) == 1 and words[0].isdecimal() and len(words[0]) < 19:
                if missing:
                    raise self.fault(number, f"frame {last} ends without {listed(sorted(missing))}.")
                if last is not None and int(words[0]) != last + 1:
                    raise self.fault(number, f"frame {int(words[0])} follows frame {last}: frames are missing.")
                last, missing = int(words[0]), set(self._widths)
            elif words[0] in missing:
                missing.discard(words[0])
            else:
                what = "a second time" if words[0] in self._widths else f"which moves nothing in {self._skeleton}"
                raise self.fault(number, f"found {_shown(line)} in frame {last}, {what}.")
        if missing:
            what = f"frame {last} ends without {listed(sorted(missing))}: the file is truncated."
            raise self.fault(self._places[-1], what)

    def values(self, step: int) -> dict[str, Float[np.ndarray, "frames values"]]:
        """Return the numbers of each bone in every ``step``-th frame."""
        size = len(self._widths) + 1
        names = [(line.split() or [""])[0] for line in self._frames[1:size]]
        if sorted(names) != sorted(self._widths):
            self._check_all()
        is_name = [is_name for name in names for is_name in (True, *[False] * self._widths[name])]
        is_value = [not one for one in is_name]
        frames = len(self._frames) // size
        values = np.empty((-(-frames // step), sum(is_value)))
        # The last frame is looked at even where it is not kept: that is where a file is cut off.
        for frame in sorted({*range(0, frames, step), frames - 1}):
            words = " ".join(self._frames[frame * size + 1 : (frame + 1) * size]).split()
            try:
                if len(words) != len(is_name) or list(compress(words, is_name)) != names:
                    raise ValueError
                row = np.array(list(map(float, compress(words, is_value))))
                if not (np.abs(row) < _MOST).all():
                    raise ValueError
            except ValueError:
                raise self._bad_line(frame * size + 1, names) from None
            if frame % step == 0:
                values[frame // step] = row
        ends = np.cumsum([self._widths[name] for name in names])
        return dict(zip(names, np.split(values, ends[:-1], axis=1), strict=True))

    def _bad_line(self, start: int, names: list[str]) -> UserError:
        for place, name in enumerate(names, start):
            words, width = self._frames[place].split(), self._widths[name]
            try:
                right = words[0] == name and len(words) == width + 1
                right = right and all(abs(float(word)) < _MOST for word in words[1:])
            except (ValueError, IndexError):
                right = False
            if not right:
                expected = f"expected '{name}' and {_count(width)} ({self._skeleton})."
                return self.fault(self._places[place], f"found {_shown(self._frames[place])}, {expected}")
        return self.fault(self._places[start], "this frame does not fit the skeleton.")


# Biovision hierarchies (``.bvh``): a tree of joints with channels, then a line of values for each frame.

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
_DEEPEST = 500


def open_bvh(path: Path) -> _BvhFile:
    """Read the hierarchy of a BVH file and count its frames.

    Raises:
        UserError: another format, a broken hierarchy, a truncated file, no frame time.
    """
    return _BvhFile(path)


class _BvhFile(_File):
    """A BVH file whose hierarchy is read and whose frames are counted."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "a Biovision hierarchy (.bvh)")
        first = self._next_line(0)
        if self.lines[first].split()[0].upper() != "HIERARCHY":
            raise self.fault(first + 1, f"found {_shown(self.lines[first])}, expected HIERARCHY.")
        hierarchy = _Hierarchy(self, first + 1)
        self.tree = hierarchy.tree()
        self.channels = hierarchy.channels
        """Of each joint, in the order of the values, such as ``zrotation``."""
        frames, place = self._header(hierarchy.end, "Frames")
        frame_time, place = self._header(place, "Frame time")
        self.frames, self.rate = int(frames), 1 / frame_time
        """How many, and how many a second."""
        self._start = self._next_line(place)
        found = len(self.lines) - self._start
        if found != self.frames:
            why = "the file is truncated" if found < self.frames else "there are too many lines"
            raise self.fault(len(self.lines), f"{found} frames, but the header says {self.frames}: {why}.")

    def _next_line(self, place: int) -> int:
        while place < len(self.lines) and not self.lines[place].strip():
            place += 1
        return place

    def _header(self, place: int, key: str) -> tuple[float, int]:
        """Return the number that follows a key, and the place of the line after it."""
        place = self._next_line(place)
        line = " ".join(self.lines[place].lower().split()) if place < len(self.lines) else ""
        if not line.startswith(f"{key.lower()}:"):
            raise self.fault(place + 1, f"found {_shown(line)}, expected '{key}:' and a number.")
        (found,) = self.numbers(place + 1, line[len(key) + 1 :].split(), 1, key.lower())
        if found <= 0:
            raise self.fault(place + 1, f"{_shown(line)}, expected a number above 0.")
        return found, place + 1

    def figure(self, first: int, step: int, tree: Tree | None = None) -> Figure:
        """Return every ``step``-th frame from frame ``first`` on, of ``tree`` in place of the file's own.

        The root is where its position channels say; positions of other joints, which some programs
        write beside the offsets, are not used.

        Raises:
            UserError: a frame with too few or too many values, or with something that is not a number.
        """
        self.row(self.frames - 1)  # where a file is cut off
        values = np.stack([np.array(self.row(frame)) for frame in range(first, self.frames, step)])
        tree, columns = tree or self.tree, iter(values.T)
        root, turns = np.tile(tree.offsets[0], (len(values), 1)), []
        for joint, channels in enumerate(self.channels):
            angles, axes = [], ""
            for channel in channels:
                value = next(columns)
                if channel.endswith("rotation"):
                    angles.append(value)
                    axes += channel[0]
                elif joint == 0:
                    root[:, "xyz".index(channel[0])] = value
            turns.append(_rotations(np.stack(angles, 1), axes) if axes else None)
        return Figure.posed(tree, root, turns)

    def row(self, frame: int) -> list[float]:
        """Return the values of one frame."""
        wanted = sum(map(len, self.channels))
        line = self._start + frame
        words = self.lines[line].split()
        if len(words) != wanted:
            raise self.fault(line + 1, f"{len(words)} values, expected {wanted} as the hierarchy has channels.")
        return self.numbers(line + 1, words, wanted, "the frame")


class _Hierarchy:
    """The joints above MOTION, read line by line."""

    def __init__(self, file: _File, start: int) -> None:
        self.file = file
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.tips: list[list[float]] = []
        self.channels: list[list[str]] = []
        self._open: list[int | None] = []
        """The joints whose brackets are not closed yet; None is an end site."""
        for self.end, line in enumerate(file.lines[start:], start + 1):
            words = line.split()
            if words and words[0].upper() == "MOTION":
                break
            if words:
                self._read(self.end, words)
        else:
            raise UserError(f"{file.path}: no MOTION: the file is truncated, or not a motion.")

    def tree(self) -> Tree:
        """Return the joints as a tree; raises UserError where the hierarchy is not complete."""
        if self._open or not self.names:
            raise self.file.fault(self.end, "MOTION begins before the hierarchy is closed.")
        for name, offset in zip(self.names, self.offsets, strict=True):
            if np.isnan(offset).any():
                raise UserError(f"{self.file.path}: joint '{name}' has no OFFSET.")
        return Tree(tuple(self.names), tuple(self.parents), np.array(self.offsets), np.array(self.tips))

    def _read(self, line: int, words: list[str]) -> None:
        key = words[0].upper()
        joint = self._open[-1] if self._open else None
        above = next((place for place in reversed(self._open) if place is not None), -1)
        if key in ("ROOT", "JOINT") and len(words) > 1:
            if (key == "ROOT") != (not self.names) or (above < 0 and self.names) or len(self._open) > _DEEPEST:
                raise self.file.fault(line, f"found {_shown(words)}, expected one ROOT with joints inside.")
            self._add(line, " ".join(words[1:]).rstrip("{ "), above)
        elif key == "END":
            if joint is None:
                raise self.file.fault(line, "an end site outside of a joint.")
            self._open.append(None)
        elif key == "OFFSET" and self._open:
            offset = self.file.numbers(line, words[1:], 3, "OFFSET")
            if joint is not None:
                self.offsets[joint] = offset
            elif np.isnan(self.tips[above]).any():
                self.tips[above] = offset
        elif key == "CHANNELS" and joint is not None:
            self.channels[joint] = channels = [word.lower() for word in words[2:]]
            if words[1:2] != [str(len(channels))] or not set(channels) <= _CHANNELS:
                what = f"CHANNELS {_shown(words[1:])}, expected a count and as many channels."
                raise self.file.fault(line, what)
        elif key == "}" and self._open:
            self._open.pop()
        elif key != "{":
            what = f"found {_shown(words)}, expected JOINT, OFFSET, CHANNELS or End Site."
            raise self.file.fault(line, what)

    def _add(self, line: int, name: str, parent: int) -> None:
        if name in self.names:
            raise self.file.fault(line, f"a second joint is called '{name}'.")
        self._open.append(len(self.names))
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append([float("nan")] * 3)
        self.tips.append([float("nan")] * 3)
        self.channels.append([])
