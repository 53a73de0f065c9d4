"""Motion capture files: Acclaim (``.asf`` and ``.amc``) and Biovision (``.bvh``), as joints in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.geometry.rigid import rotation_about

__all__ = ["AsfSkeleton", "Figure", "Tree", "open_bvh", "read_amc", "read_asf", "read_lines"]

# Lines of a motion capture file, and errors that say in which of them something is wrong.

_MOST = 1e9
"""No length or angle of a motion is as large."""


def read_lines(path: Path, what: str) -> list[bytes]:
    """Return the lines of a text file without their ends.

    Raises:
        UserError: no text, or a file that cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}).") from error
    if b"\0" in content:
        raise UserError(f"{path}: this is not text, expected {what}.")
    if not content.strip():
        raise UserError(f"{path}: empty, expected {what}.")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")


def _fault(path: Path, line: int, message: str) -> UserError:
    """Return the error for line ``line`` (the first is 1) of ``path``."""
    return UserError(f"{path}, line {line}: {message}")


def _shown(line: bytes, most: int = 40) -> str:
    """Return what is in a line, short and printable, in quotes."""
    text = line.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= most else text[:most] + "...")


def _numbers(path: Path, line: int, words: list[bytes], count: int, what: str) -> list[float]:
    """Return the first ``count`` words as finite numbers; raises UserError where they are not."""
    try:
        found = [float(word) for word in words[:count]]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(number) < _MOST for number in found):
        raise _fault(path, line, f"{what} is {_shown(b' '.join(words))}, expected {count} number{'s' * (count > 1)}.")
    return found


# A tree of joints as a motion capture file describes it, and where its joints are in each frame.


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
        cls,
        tree: Tree,
        root: Float[np.ndarray, "frames 3"],
        turned: Sequence[Float[np.ndarray, "frames 3 3"] | None],
    ) -> Figure:
        """Return ``tree`` with its root at ``root`` and joint i turned by ``turned[i]`` in its parent's frame.

        ``None`` is a joint that does not turn.
        """
        frames = len(root)
        positions = np.empty((len(tree.names), frames, 3))
        rotations = np.empty((len(tree.names), frames, 3, 3))
        for joint, (parent, turn) in enumerate(zip(tree.parents, turned, strict=True)):
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


def _turns(degrees: Float[np.ndarray, "frames angles"], axes: str) -> Float[np.ndarray, "frames 3 3"]:
    """Return the rotations about the axes of ``axes`` (such as ``zyx``), each about the axes turned before it."""
    result: np.ndarray | None = None
    for angle, axis in zip(np.deg2rad(degrees).T, axes, strict=True):
        turn = rotation_about(axis, angle)
        result = turn if result is None else result @ turn
    return np.tile(np.eye(3), (len(degrees), 1, 1)) if result is None else result


# A bone of an Acclaim skeleton and how it turns.


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

    @property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """The bone's own axes in the rest pose."""
        return _turned_in(np.array([self.axis]), self.order)[0]

    def turned(self, degrees: Float[np.ndarray, "frames angles"]) -> Float[np.ndarray, "frames 3 3"]:
        """Return the rotations of the bone in its parent's frame for angles in the order of `dof`."""
        full = np.zeros((len(degrees), 3))
        for column, name in enumerate(self.dof):
            full[:, self.order.index(name[1])] = degrees[:, column]
        return self.frame @ _turned_in(full, self.order) @ self.frame.T


def _turned_in(degrees: np.ndarray, order: str) -> np.ndarray:
    # "XYZ" is first about X, then about the world's Y, then its Z: about the turned axes that is Z, Y, X.
    return _turns(degrees[:, ::-1], order[::-1])


# Acclaim skeletons (``.asf``): bones with direction, length, axes and degrees of freedom.

_INCH_MM = 25.4
_ANGLES = ("rx", "ry", "rz")
_ROOT = ["tx", "ty", "tz", *_ANGLES]


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
            raise _fault(
                path, number, f"found {_shown(line)}, expected an Acclaim skeleton (:version, :units, :root ...)."
            )
        if words:
            rows.append((number, words))
    return sections


def _units(path: Path, rows: list[tuple[int, list[bytes]]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for number, (key, *words) in rows:
        if key.lower() == b"length":
            (found["length"],) = _numbers(path, number, words, 1, "length")
            if found["length"] <= 0:
                raise _fault(path, number, f"length is {found['length']:g}, expected a number above 0 (CMU: 0.45).")
        elif key.lower() == b"angle":
            if not words or words[0].lower()[:3] not in (b"deg", b"rad"):
                raise _fault(path, number, f"angle is {_shown(b' '.join(words))}, expected deg or rad.")
            found["degrees"] = float(words[0].lower().startswith(b"deg"))
    return found


def _root(path: Path, rows: list[tuple[int, list[bytes]]]) -> tuple[_Bone, list[float]]:
    root, position = _Bone("root", dof=_ROOT), [0.0, 0.0, 0.0]
    for number, (key, *words) in rows:
        if key.lower() == b"order":
            root.dof = [word.decode("ascii", "replace").lower() for word in words]
            if sorted(root.dof) != sorted(_ROOT):
                raise _fault(
                    path, number, f"order is {_shown(b' '.join(words))}, expected TX TY TZ RX RY RZ in any order."
                )
        elif key.lower() == b"axis":
            root.order = _order(path, number, words[:1])
        elif key.lower() == b"position":
            position = _numbers(path, number, words, 3, "position")
        elif key.lower() == b"orientation" and any(_numbers(path, number, words, 3, "orientation")):
            raise _fault(path, number, "the root has an orientation of its own, expected 0 0 0 as in CMU's files.")
    return root, position


def _order(path: Path, line: int, words: list[bytes]) -> str:
    order = b"".join(words).decode("ascii", "replace").lower()
    if sorted(order) != list("xyz"):
        raise _fault(path, line, f"the order of axes is {_shown(b' '.join(words))}, expected XYZ in any order.")
    return order


def _bones(path: Path, rows: list[tuple[int, list[bytes]]]) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    bone: _Bone | None = None
    for number, (key, *words) in rows:
        word = key.lower()
        if word == b"begin":
            bone = _Bone(line=number)
        elif bone is None:
            raise _fault(path, number, f"found {_shown(key)} outside of a bone, expected begin.")
        elif word == b"end":
            _check_bone(path, bone, bones)
            bones[bone.name] = bone
            bone = None
        elif word == b"name":
            bone.name = b" ".join(words).decode("utf-8", "replace")
        elif word == b"direction":
            bone.direction = _numbers(path, number, words, 3, "direction")
        elif word == b"length":
            (bone.length,) = _numbers(path, number, words, 1, "length")
        elif word == b"axis":
            bone.axis = _numbers(path, number, words, 3, "axis")
            bone.order = _order(path, number, words[3:4])
        elif word == b"dof":
            bone.dof = [w.decode("ascii", "replace").lower() for w in words]
            if not set(bone.dof) <= set(_ANGLES) or len(set(bone.dof)) != len(bone.dof):
                raise _fault(path, number, f"dof is {_shown(b' '.join(words))}, expected rx ry rz or some of them.")
    if bone is not None:
        raise _fault(path, bone.line, "a bone begins here and does not end: the file is truncated.")
    if not bones:
        raise UserError(f"{path}: no bones in :bonedata.")
    return bones


def _check_bone(path: Path, bone: _Bone, others: dict[str, _Bone]) -> None:
    if not bone.name or bone.name in others or bone.name == "root":
        raise _fault(path, bone.line, f"a bone is called {bone.name!r}, expected a name of its own.")
    size = float(np.linalg.norm(bone.direction)) if bone.direction else 0.0
    if not np.isfinite(bone.length) or bone.length < 0 or not 0.9 < size < 1.1:
        raise _fault(path, bone.line, f"bone '{bone.name}' needs a direction of length 1 and a length of 0 or more.")


def _hierarchy(
    path: Path, rows: list[tuple[int, list[bytes]]], bones: dict[str, _Bone]
) -> tuple[list[_Bone], dict[str, str]]:
    """Return the bones, parents first, and the parent of each."""
    parents: dict[str, str] = {}
    ordered: list[_Bone] = []
    names = [(number, [word.decode("utf-8", "replace") for word in words]) for number, words in rows]
    if not names or names[-1][1] != ["end"]:
        raise UserError(f"{path}: the section :hierarchy does not end: the file is truncated.")
    for number, (parent, *children) in names:
        if parent in ("begin", "end"):
            continue
        if parent != "root" and parent not in parents:
            raise _fault(path, number, f"'{parent}' has bones below it, but hangs on nothing named before.")
        for child in children:
            if child not in bones or child in parents:
                what = "is named a second time" if child in parents else "is not in :bonedata"
                raise _fault(path, number, f"bone '{child}' {what}.")
            parents[child] = parent
            ordered.append(bones[child])
    lost = [name for name in bones if name not in parents]
    if lost:
        raise UserError(f"{path}: bones that hang on nothing in :hierarchy: {', '.join(lost[:10])}.")
    return ordered, parents


def _tree(bones: list[_Bone], parents: dict[str, str]) -> Tree:
    names = ["root", *(bone.name for bone in bones)]
    tips = np.array([[0.0, 0.0, 0.0], *(np.multiply(bone.direction, bone.length) for bone in bones)])
    place = [-1, *(names.index(parents[bone.name]) for bone in bones)]
    # A bone starts where its parent ends.
    offsets = np.array([np.zeros(3), *(tips[parent] for parent in place[1:])])
    return Tree(tuple(names), tuple(place), offsets, tips)


# Acclaim motion (``.amc``): for each frame a number, then a line of values for the root and each bone.


def read_amc(path: Path, skeleton: AsfSkeleton, step: int = 1) -> Figure:
    """Return every ``step``-th frame of a motion of ``skeleton``, the first included.

    Raises:
        UserError: other bones or numbers of values than the skeleton's, a truncated file, no numbers.
    """
    lines = read_lines(path, "an Acclaim motion (.amc)")
    start, degrees = _header(path, lines, skeleton.degrees)
    widths = {"root": 6, **{bone.name: len(bone.dof) for bone in skeleton.bones if bone.dof}}
    while not lines[-1].strip():
        lines.pop()
    block = _Block(path, skeleton, lines[start:], range(start + 1, len(lines) + 1), widths)
    if not block.regular():
        block = block.bared()
        block.walk()
    values, names = block.values(step)
    return _posed(skeleton, values, names, widths, degrees)


def _header(path: Path, lines: list[bytes], degrees: bool) -> tuple[int, bool]:
    """Return where the first frame starts and whether angles are in degrees."""
    for place, line in enumerate(lines):
        words = line.split()
        if not words or words[0].startswith(b"#"):
            continue
        if words[0].startswith(b":"):
            if words[0].upper() in (b":DEGREES", b":RADIANS"):
                degrees = words[0].upper() == b":DEGREES"
            continue
        if len(words) == 1 and words[0].isdigit():
            return place, degrees
        raise _fault(path, place + 1, f"found {_shown(line)}, expected the number of the first frame.")
    raise _fault(path, len(lines), "the file ends before the first frame.")


@dataclass(frozen=True)
class _Block:
    """The lines of the frames, and which lines of the file they are."""

    path: Path
    skeleton: AsfSkeleton
    lines: list[bytes]
    places: Sequence[int]
    widths: dict[str, int]
    """How many values each bone has."""

    def regular(self) -> bool:
        """Return whether the frame numbers stand where they must when no line is missing or too many."""
        size = len(self.widths) + 1
        try:
            found = np.array([int(number) for number in self.lines[::size]])
        except ValueError:
            return False
        return len(self.lines) % size == 0 and bool((np.diff(found) == 1).all())

    def bared(self) -> _Block:
        """Return the block without empty lines and comments."""
        kept = [place for place, line in enumerate(self.lines) if line.strip() and not line.lstrip().startswith(b"#")]
        return replace(self, lines=[self.lines[k] for k in kept], places=[self.places[k] for k in kept])

    def walk(self) -> None:
        """Raise the error of the first line that is not as it should be, if any."""
        last, missing = None, set()
        for number, line in zip(self.places, self.lines, strict=True):
            words = line.split()
            if len(words) == 1 and words[0].isdigit():
                if missing:
                    raise _fault(self.path, number, f"frame {last} ends without {_listed(missing)}.")
                if last is not None and int(words[0]) != last + 1:
                    raise _fault(self.path, number, f"frame {int(words[0])} follows frame {last}: frames are missing.")
                last, missing = int(words[0]), set(self.widths)
                continue
            name = words[0].decode("utf-8", "replace")
            if name not in missing:
                what = "a second time" if name in self.widths else f"which moves nothing in {self.skeleton.path.name}"
                raise _fault(self.path, number, f"found {_shown(line)} in frame {last}, {what}.")
            missing.discard(name)
        if missing:
            last_line = self.places[-1]
            raise _fault(self.path, last_line, f"frame {last} ends without {_listed(missing)}: the file is truncated.")

    def values(self, step: int) -> tuple[Float[np.ndarray, "frames values"], list[str]]:
        """Return the numbers of every ``step``-th frame, and the bones in the order of the file."""
        size = len(self.widths) + 1
        names = [(line.split() or [b""])[0].decode("utf-8", "replace") for line in self.lines[1:size]]
        if sorted(names) != sorted(self.widths):
            self.walk()
        text, number, place = [], [], 0
        for name in names:
            text.append(place)
            number += range(place + 1, place + 1 + self.widths[name])
            place += 1 + self.widths[name]
        texts, take = itemgetter(*text), itemgetter(*number)
        expected = tuple(name.encode() for name in names) if len(names) > 1 else names[0].encode()
        frames = len(self.lines) // size
        values = np.empty((-(-frames // step), len(number)))
        # The last frame is looked at even where it is not kept: that is where a file is cut off.
        for frame in sorted({*range(0, frames, step), frames - 1}):
            words = b" ".join(self.lines[frame * size + 1 : (frame + 1) * size]).split()
            try:
                if len(words) != place or texts(words) != expected:
                    raise ValueError
                row = np.array(list(map(float, take(words))))
                if not (np.abs(row) < _MOST).all():
                    raise ValueError
            except ValueError:
                raise self._bad_line(frame * size + 1, names) from None
            if frame % step == 0:
                values[frame // step] = row
        return values, names

    def _bad_line(self, start: int, names: list[str]) -> UserError:
        for place, name in enumerate(names, start):
            words, width = self.lines[place].split(), self.widths[name]
            try:
                right = words[0] == name.encode() and len(words) == width + 1
                right = right and all(abs(float(word)) < _MOST for word in words[1:])
            except (ValueError, IndexError):
                right = False
            if not right:
                wanted = f"expected '{name}' and {width} number{'s' * (width > 1)} ({self.skeleton.path.name})."
                return _fault(self.path, self.places[place], f"found {_shown(self.lines[place])}, {wanted}")
        return _fault(self.path, self.places[start], "this frame does not fit the skeleton.")


def _listed(names: set[str]) -> str:
    found = sorted(names)
    return ", ".join(found[:6]) + (f" and {len(found) - 6} more" if len(found) > 6 else "")


def _posed(
    skeleton: AsfSkeleton, values: np.ndarray, names: list[str], widths: dict[str, int], degrees: bool
) -> Figure:
    if not degrees:
        moved = np.isin(np.arange(values.shape[1]), _translations(skeleton, names, widths))
        values = np.where(moved, values, np.rad2deg(values))
    starts = dict(zip(names, np.cumsum([0, *(widths[name] for name in names)]), strict=False))
    columns = {key: starts["root"] + place for place, key in enumerate(skeleton.root.dof)}
    root = values[:, [columns["tx"], columns["ty"], columns["tz"]]] + skeleton.position
    spin = _Bone(order=skeleton.root.order, dof=["rx", "ry", "rz"])
    turned: list[np.ndarray | None] = [spin.turned(values[:, [columns[name] for name in spin.dof]])]
    for bone in skeleton.bones:
        start = starts.get(bone.name)
        turned.append(None if start is None else bone.turned(values[:, start : start + len(bone.dof)]))
    return Figure.posed(skeleton.tree, root, turned)


def _translations(skeleton: AsfSkeleton, names: list[str], widths: dict[str, int]) -> list[int]:
    start = sum(widths[name] for name in names[: names.index("root")])
    return [start + place for place, key in enumerate(skeleton.root.dof) if key[0] == "t"]


# Biovision hierarchies (``.bvh``): a tree of joints with channels, then a line of values for each frame.

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
_DEEPEST = 500


@dataclass
class _BvhFile:
    """A BVH file whose hierarchy is read and whose frames are counted."""

    path: Path
    tree: Tree
    channels: list[list[str]]
    """Of each joint, in the order of the values, such as ``zrotation``."""
    rate: float
    """Frames a second."""
    lines: list[bytes]
    start: int
    """The first frame's place in `lines`."""
    frames: int

    def figure(self, first: int, step: int, tree: Tree | None = None) -> Figure:
        """Return every ``step``-th frame from frame ``first`` on, of ``tree`` in place of the file's own.

        The root is where its position channels say; positions of other joints, which some programs
        write beside the offsets, are not used.

        Raises:
            UserError: a frame with too few or too many values, or with something that is not a number.
        """
        values = self._values(first, step)
        tree = tree or self.tree
        root, turned, column = np.tile(tree.offsets[0], (len(values), 1)), [], 0
        for joint, channels in enumerate(self.channels):
            angles, axes = [], ""
            for channel in channels:
                if channel.endswith("rotation"):
                    angles.append(values[:, column])
                    axes += channel[0]
                elif joint == 0:
                    root[:, "xyz".index(channel[0])] = values[:, column]
                column += 1
            turned.append(_turns(np.stack(angles, 1), axes) if axes else None)
        return Figure.posed(tree, root, turned)

    def row(self, frame: int) -> list[float]:
        """Return the values of one frame."""
        wanted = sum(map(len, self.channels))
        line = self.start + frame
        words = self.lines[line].split()
        if len(words) != wanted:
            raise _fault(self.path, line + 1, f"{len(words)} values, expected {wanted} as the hierarchy has channels.")
        return _numbers(self.path, line + 1, words, wanted, "the frame")

    def _values(self, first: int, step: int) -> Float[np.ndarray, "frames values"]:
        kept = range(first, self.frames, step)
        self.row(self.frames - 1)  # where a file is cut off
        values = np.empty((len(kept), sum(map(len, self.channels))))
        for place, frame in enumerate(kept):
            values[place] = self.row(frame)
        return values


def open_bvh(path: Path) -> _BvhFile:
    """Read the hierarchy of a BVH file and count its frames.

    Raises:
        UserError: another format, a broken hierarchy, a truncated file, no frame time.
    """
    lines = read_lines(path, "a Biovision hierarchy (.bvh)")
    first = next(place for place, line in enumerate(lines) if line.strip())
    if lines[first].split()[0].upper() != b"HIERARCHY":
        raise _fault(path, first + 1, f"found {_shown(lines[first])}, expected HIERARCHY.")
    tree, channels, place = _Hierarchy(path, lines).read(first + 1)
    frames, rate, start = _motion(path, lines, place)
    while not lines[-1].strip():
        lines.pop()
    found = len(lines) - start
    if found != frames:
        why = "the file is truncated" if found < frames else "there are lines too many"
        raise _fault(path, len(lines), f"{found} frames, but the header says {frames}: {why}.")
    return _BvhFile(path, tree, channels, rate, lines, start, frames)


def _motion(path: Path, lines: list[bytes], place: int) -> tuple[int, float, int]:
    """Return the number of frames, the rate, and where the first frame is."""
    found: dict[bytes, float] = {}
    for key in (b"frames:", b"frame time:"):
        while place < len(lines) and not lines[place].strip():
            place += 1
        line = b" ".join(lines[place].lower().split()) if place < len(lines) else b""
        if not line.startswith(key):
            raise _fault(path, place + 1, f"found {_shown(line)}, expected '{key.decode().capitalize()}' and a number.")
        (found[key],) = _numbers(path, place + 1, line[len(key) :].split(), 1, key.decode().rstrip(":"))
        if found[key] <= 0:
            raise _fault(path, place + 1, f"{_shown(line)}, expected a number above 0.")
        place += 1
    while place < len(lines) and not lines[place].strip():
        place += 1
    return int(found[b"frames:"]), 1 / found[b"frame time:"], place


class _Hierarchy:
    """The joints above MOTION, read line by line."""

    def __init__(self, path: Path, lines: list[bytes]):
        self.path, self.lines = path, lines
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.tips: list[list[float]] = []
        self.channels: list[list[str]] = []

    def read(self, start: int) -> tuple[Tree, list[list[str]], int]:
        """Return the tree, its channels, and the place after MOTION."""
        open_joints: list[int | None] = []  # None is an end site
        for place in range(start, len(self.lines)):
            words = self.lines[place].split()
            if not words:
                continue
            if words[0].upper() == b"MOTION":
                if open_joints or not self.names:
                    raise _fault(self.path, place + 1, "MOTION begins before the hierarchy is closed.")
                tree = Tree(tuple(self.names), tuple(self.parents), np.array(self.offsets), np.array(self.tips))
                self._check()
                return tree, self.channels, place + 1
            self._line(place + 1, words, open_joints)
        raise UserError(f"{self.path}: no MOTION: the file is truncated, or no motion.")

    def _line(self, line: int, words: list[bytes], open_joints: list[int | None]) -> None:
        key = words[0].upper()
        joint = open_joints[-1] if open_joints else None
        above = next((place for place in reversed(open_joints) if place is not None), -1)
        if key in (b"ROOT", b"JOINT") and len(words) > 1:
            if (key == b"ROOT") != (not self.names) or (above < 0 and self.names) or len(open_joints) > _DEEPEST:
                raise _fault(
                    self.path, line, f"found {_shown(b' '.join(words))}, expected one ROOT with joints inside."
                )
            self._add(line, b" ".join(words[1:]).decode("utf-8", "replace").rstrip("{ "), above)
            open_joints.append(len(self.names) - 1)
        elif key == b"END":
            if joint is None:
                raise _fault(self.path, line, "an end site outside of a joint.")
            open_joints.append(None)
        elif key == b"OFFSET" and open_joints:
            offset = _numbers(self.path, line, words[1:], 3, "OFFSET")
            if joint is not None:
                self.offsets[joint] = offset
            elif np.isnan(self.tips[above]).any():
                self.tips[above] = offset
        elif key == b"CHANNELS" and joint is not None:
            self.channels[joint] = self._channels(line, words[1:])
        elif key == b"}" and open_joints:
            open_joints.pop()
        elif key != b"{":
            raise _fault(
                self.path, line, f"found {_shown(b' '.join(words))}, expected JOINT, OFFSET, CHANNELS or End Site."
            )

    def _add(self, line: int, name: str, parent: int) -> None:
        if name in self.names:
            raise _fault(self.path, line, f"a second joint is called '{name}'.")
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append([float("nan")] * 3)
        self.tips.append([float("nan")] * 3)
        self.channels.append([])

    def _channels(self, line: int, words: list[bytes]) -> list[str]:
        names = [word.decode("ascii", "replace").lower() for word in words[1:]]
        if not words or words[0] != str(len(names)).encode() or not set(names) <= _CHANNELS:
            raise _fault(
                self.path, line, f"CHANNELS {_shown(b' '.join(words))}, expected a count and as many channels."
            )
        return names

    def _check(self) -> None:
        for name, offset in zip(self.names, self.offsets, strict=True):
            if np.isnan(offset).any():
                raise UserError(f"{self.path}: joint '{name}' has no OFFSET.")
