"""Acclaim motion (``.amc``): for each frame a number, then a line of values for the root and each bone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.asf import AsfSkeleton
from uplift.mocap.bone import Bone
from uplift.mocap.figure import Figure
from uplift.mocap.text import MOST, fault, read_lines, shown

__all__ = ["read_amc"]


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
        raise fault(path, place + 1, f"found {shown(line)}, expected the number of the first frame.")
    raise fault(path, len(lines), "the file ends before the first frame.")


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
                    raise fault(self.path, number, f"frame {last} ends without {_listed(missing)}.")
                if last is not None and int(words[0]) != last + 1:
                    raise fault(self.path, number, f"frame {int(words[0])} follows frame {last}: frames are missing.")
                last, missing = int(words[0]), set(self.widths)
                continue
            name = words[0].decode("utf-8", "replace")
            if name not in missing:
                what = "a second time" if name in self.widths else f"which moves nothing in {self.skeleton.path.name}"
                raise fault(self.path, number, f"found {shown(line)} in frame {last}, {what}.")
            missing.discard(name)
        if missing:
            last_line = self.places[-1]
            raise fault(self.path, last_line, f"frame {last} ends without {_listed(missing)}: the file is truncated.")

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
                if not (np.abs(row) < MOST).all():
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
                right = right and all(abs(float(word)) < MOST for word in words[1:])
            except (ValueError, IndexError):
                right = False
            if not right:
                wanted = f"expected '{name}' and {width} number{'s' * (width > 1)} ({self.skeleton.path.name})."
                return fault(self.path, self.places[place], f"found {shown(self.lines[place])}, {wanted}")
        return fault(self.path, self.places[start], "this frame does not fit the skeleton.")


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
    spin = Bone(order=skeleton.root.order, dof=["rx", "ry", "rz"])
    turned: list[np.ndarray | None] = [spin.turned(values[:, [columns[name] for name in spin.dof]])]
    for bone in skeleton.bones:
        start = starts.get(bone.name)
        turned.append(None if start is None else bone.turned(values[:, start : start + len(bone.dof)]))
    return Figure.posed(skeleton.tree, root, turned)


def _translations(skeleton: AsfSkeleton, names: list[str], widths: dict[str, int]) -> list[int]:
    start = sum(widths[name] for name in names[: names.index("root")])
    return [start + place for place, key in enumerate(skeleton.root.dof) if key[0] == "t"]
