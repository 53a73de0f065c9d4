"""Biovision hierarchies (``.bvh``): a tree of joints with channels, then a line of values for each frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.figure import Figure, Tree, turns
from uplift.mocap.text import fault, numbers, read_lines, shown

__all__ = ["BvhFile", "open_bvh"]

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
_DEEPEST = 500


@dataclass
class BvhFile:
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
            UserError: a frame with too few or too many values, or with something that is no number.
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
            turned.append(turns(np.stack(angles, 1), axes) if axes else None)
        return Figure.posed(tree, root, turned)

    def row(self, frame: int) -> list[float]:
        """Return the values of one frame."""
        wanted = sum(map(len, self.channels))
        line = self.start + frame
        words = self.lines[line].split()
        if len(words) != wanted:
            raise fault(self.path, line + 1, f"{len(words)} values, expected {wanted} as the hierarchy has channels.")
        return numbers(self.path, line + 1, words, wanted, "the frame")

    def _values(self, first: int, step: int) -> Float[np.ndarray, "frames values"]:
        kept = range(first, self.frames, step)
        self.row(self.frames - 1)  # where a file is cut off
        values = np.empty((len(kept), sum(map(len, self.channels))))
        for place, frame in enumerate(kept):
            values[place] = self.row(frame)
        return values


def open_bvh(path: Path) -> BvhFile:
    """Read the hierarchy of a BVH file and count its frames.

    Raises:
        UserError: another format, a broken hierarchy, a truncated file, no frame time.
    """
    lines = read_lines(path, "a Biovision hierarchy (.bvh)")
    first = next(place for place, line in enumerate(lines) if line.strip())
    if lines[first].split()[0].upper() != b"HIERARCHY":
        raise fault(path, first + 1, f"found {shown(lines[first])}, expected HIERARCHY.")
    tree, channels, place = _Hierarchy(path, lines).read(first + 1)
    frames, rate, start = _motion(path, lines, place)
    while not lines[-1].strip():
        lines.pop()
    found = len(lines) - start
    if found != frames:
        why = "the file is truncated" if found < frames else "there are lines too many"
        raise fault(path, len(lines), f"{found} frames, but the header says {frames}: {why}.")
    return BvhFile(path, tree, channels, rate, lines, start, frames)


def _motion(path: Path, lines: list[bytes], place: int) -> tuple[int, float, int]:
    """Return the number of frames, the rate, and where the first frame is."""
    found: dict[bytes, float] = {}
    for key in (b"frames:", b"frame time:"):
        while place < len(lines) and not lines[place].strip():
            place += 1
        line = b" ".join(lines[place].lower().split()) if place < len(lines) else b""
        if not line.startswith(key):
            raise fault(path, place + 1, f"found {shown(line)}, expected '{key.decode().capitalize()}' and a number.")
        (found[key],) = numbers(path, place + 1, line[len(key) :].split(), 1, key.decode().rstrip(":"))
        if found[key] <= 0:
            raise fault(path, place + 1, f"{shown(line)}, expected a number above 0.")
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
                    raise fault(self.path, place + 1, "MOTION begins before the hierarchy is closed.")
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
                raise fault(self.path, line, f"found {shown(b' '.join(words))}, expected one ROOT with joints inside.")
            self._add(line, b" ".join(words[1:]).decode("utf-8", "replace").rstrip("{ "), above)
            open_joints.append(len(self.names) - 1)
        elif key == b"END":
            if joint is None:
                raise fault(self.path, line, "an end site outside of a joint.")
            open_joints.append(None)
        elif key == b"OFFSET" and open_joints:
            offset = numbers(self.path, line, words[1:], 3, "OFFSET")
            if joint is not None:
                self.offsets[joint] = offset
            elif np.isnan(self.tips[above]).any():
                self.tips[above] = offset
        elif key == b"CHANNELS" and joint is not None:
            self.channels[joint] = self._channels(line, words[1:])
        elif key == b"}" and open_joints:
            open_joints.pop()
        elif key != b"{":
            raise fault(
                self.path, line, f"found {shown(b' '.join(words))}, expected JOINT, OFFSET, CHANNELS or End Site."
            )

    def _add(self, line: int, name: str, parent: int) -> None:
        if name in self.names:
            raise fault(self.path, line, f"a second joint is called '{name}'.")
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append([float("nan")] * 3)
        self.tips.append([float("nan")] * 3)
        self.channels.append([])

    def _channels(self, line: int, words: list[bytes]) -> list[str]:
        names = [word.decode("ascii", "replace").lower() for word in words[1:]]
        if not words or words[0] != str(len(names)).encode() or not set(names) <= _CHANNELS:
            raise fault(self.path, line, f"CHANNELS {shown(b' '.join(words))}, expected a count and as many channels.")
        return names

    def _check(self) -> None:
        for name, offset in zip(self.names, self.offsets, strict=True):
            if np.isnan(offset).any():
                raise UserError(f"{self.path}: joint '{name}' has no OFFSET.")
