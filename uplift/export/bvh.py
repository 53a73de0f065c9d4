"""One individual's clip as a Biovision hierarchy (``.bvh``): a rig and its turns, for animation programs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import as_bytes, replacing, scratch
from uplift.data.parsers.mocap import Tree
from uplift.errors import UserError
from uplift.export.clips import frame_rate, one_body, seen_at, steps
from uplift.export.scene import from_y_down, held, known_points
from uplift.export.tables import unique
from uplift.geometry.rigid import least_turn, nearest_rotation, nearest_rotations, quaternion_matrix
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.skeleton.draw import rest_pose

__all__ = ["euler_zxy", "turn_onto", "write_bvh"]

_MOST_REPEATS = 20  # frames in the file for each one there is


@dataclass(frozen=True)
class _BvhFit:
    """How far the file's joints are from the predicted ones, in ``unit``: BVH has bones of one length only."""

    largest_error: float
    mean_error: float
    unit: str
    frames: int
    added: tuple[str, ...]
    """Joints without length, added where children of one joint move on their own."""

    def __str__(self) -> str:
        """Return a sentence for a log."""
        unit = "" if self.unit == "relative" else f" {self.unit}"
        return (
            f"bones of one length each: joints are {self.mean_error:.3g}{unit} from the predicted ones on average, "
            f"{self.largest_error:.3g}{unit} at most"
        )


def write_bvh(
    prediction: Prediction, path: str | Path, fps: int | float | None = None, individual: str | None = None
) -> _BvhFit:
    """Write one individual of a clip, ``individual`` of several, and return how well it fits; ``fps`` replaces the prediction's.

    Lengths are centimetres where the prediction is in mm, else as they are; axes as given. Every bone has its
    median length, every direction is kept; the twist about a bone is not observed and left as small as it can be
    (see `_Rig`). A joint or frame that is missing holds what was last known: BVH has no gaps. A joint at the end of
    a limb gets an end site a tenth of its bone further on. Raises UserError for several clips or individuals, where
    no rate is known, and for frame numbers with wide gaps.
    """
    clip = one_body(prediction, path, individual)
    rate = frame_rate(prediction, fps)
    if rate is None:
        raise UserError(f"cannot write {path}: a .bvh needs frames a second, which the input does not say. Add fps=30.")
    when = steps(clip)[clip.moment]
    when -= when[0]
    count = round(float(when[-1])) + 1
    if count > _MOST_REPEATS * len(when):
        raise UserError(
            f"cannot write {path}: a .bvh has no gaps, and the frames {clip.frames[clip.moment[0]]} to "
            f"{clip.frames[clip.moment[-1]]} hold only "
            f"{len(when):,} poses. Write each stretch of frames on its own, or a .glb."
        )
    rows = clip.rows[seen_at(when, np.arange(count, dtype=float))]
    place = (
        np.zeros((count, 3)) if prediction.root is None else held(known_points(prediction.root[rows][:, None])[:, 0])
    )
    with replacing(path) as handle, scratch(path) as turns:
        rig = _Rig(_Body(prediction, rows), turns)
        for text in _text(rig, place, 0.1 if prediction.unit == "mm" else 1.0, rate):
            handle.write(as_bytes(text))
    added = tuple(name for name in rig.tree.names if name not in prediction.joint_names)
    return _BvhFit(rig.largest_error, rig.sum_of_errors / rig.errors, prediction.unit, count, added)


def euler_zxy(rotation: Float[np.ndarray, "frames 3 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return degrees about z, x, y (each about the axes turned before it) that change little from frame to frame.

    A rotation has two triples of angles, and full turns more or less: of these the nearest to the frame before. Whether
    it stays in the first or second kind of triple does not depend on which that was, so that kinds and full turns are sums
    over the frames before.
    """
    x = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    z = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    y = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    locked = np.hypot(rotation[:, 0, 1], rotation[:, 1, 1]) < 1e-6
    if locked.any():  # z and y turn about one axis: z stays
        last = np.maximum.accumulate(np.where(locked, -1, np.arange(len(z))))
        z = np.where(last < 0, 0.0, z[last])
        y = np.where(locked, np.sign(x) * (np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]) - z), y)
    angles = np.stack([z, x, y], 1)
    other = np.stack([z + np.pi, np.where(locked, x, np.pi - x), y + np.pi], 1)
    near, far = (np.abs(_wrapped(kind[1:] - angles[:-1])).sum(1) for kind in (angles, other))
    changes = np.cumsum((far < near) & ~locked[1:]) % 2 == 1
    angles[1:][changes] = other[1:][changes]
    angles[1:] += 2 * np.pi * np.cumsum(np.round((angles[:-1] - angles[1:]) / (2 * np.pi)), 0)
    return np.degrees(angles)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles less the full turns in them."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


_ROWS = 512


def _text(rig: _Rig, place: np.ndarray, scale: float, rate: float) -> Iterator[str]:
    """Yield the text of the file: the tree, then some frames at a time."""
    # White space and braces divide the words of the file.
    names = unique(re.sub(r"[\s{}]+", "_", name) or "_" for name in rig.tree.names)
    lines, depths = ["HIERARCHY"], [-1]
    for joint, parent in enumerate(rig.tree.parents):
        depth = depths[parent + 1] + 1
        lines += [f"{'  ' * level}}}" for level in range(depths[-1], depth - 1, -1)]
        lines += _joint_lines(rig, joint, names[joint], "  " * depth, scale)
        depths.append(depth)
    lines += [f"{'  ' * level}}}" for level in range(depths[-1], -1, -1)]
    yield "\n".join([*lines, "MOTION", f"Frames: {len(place)}", f"Frame Time: {1 / rate:.8f}", ""])
    template = " ".join(["%.5f"] * (3 + 3 * len(names))) + "\n"
    for start in range(0, len(place), _ROWS):
        part = slice(start, start + _ROWS)
        values = np.concatenate([place[part] * scale, *rig.degrees(part)], 1) + 0.0
        yield template * len(values) % tuple(values.ravel().tolist())


def _joint_lines(rig: _Rig, joint: int, name: str, pad: str, scale: float) -> list[str]:
    kind, place = ("JOINT", "3 ") if joint else ("ROOT", "6 Xposition Yposition Zposition ")
    lines = [f"{pad}{kind} {name}", f"{pad}{{", f"{pad}  {_offset(rig.tree.offsets[joint], scale)}"]
    lines.append(f"{pad}  CHANNELS {place}Zrotation Xrotation Yrotation")
    if np.isfinite(tip := rig.tree.tips[joint]).all():
        lines += [f"{pad}  End Site", f"{pad}  {{", f"{pad}    {_offset(tip, scale)}", f"{pad}  }}"]
    return lines


def _offset(offset: np.ndarray, scale: float) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in offset * scale + 0.0)


# The rig: bones of one length each, and the rotations that bring them nearest to the poses.

_OWN_JOINT = 2e-4  # share of a bone by which a child may miss before it gets a turn of its own
_WEAK = 1e-5  # weight of the parent's frame, which decides what the bones leave open
_FOLDED = 0.5
"""1 + cosine of the angle to the rest direction (120 degrees) below which the previous frame counts."""
_TIP = 0.1
_SETTLE = 8
_BLOCK = 1 << 14


class _Rig:
    """The rig of a body: a tree in the prediction's unit, its motion, and how far its joints are from the body's.

    Bones have their median length. A joint with one child turns the least way from its parent's frame, as the
    twist about a bone cannot be seen; where the bone folds back on its rest direction, and the least way is
    undefined, the twist follows from the frame before. A joint with several children turns rigidly onto them (Kabsch,
    Acta Cryst. A32, 1976), and a child that this misses gets a separate turn at the same place, which is exact. What
    is not known holds its last turn. Joints are listed parents first and depth first, as in the file. Raises UserError
    where a joint is nowhere known.
    """

    def __init__(self, body: _Body, turns: IO[bytes]):
        prediction = body.prediction
        self._body, self._turns, self._places = body, turns, []
        self._rest = _rest_directions(body)
        self._settles = rest_pose(prediction.skeleton) is None
        parents = prediction.skeleton.parents
        self._children: dict[str, list[str]] = {joint: [] for joint in parents}
        for joint in (name for name in prediction.joint_names if parents.get(name) is not None):
            self._children[str(parents[joint])].append(joint)
        self._joints: list[tuple[str, int, np.ndarray, np.ndarray]] = []
        self.largest_error, self.sum_of_errors, self.errors = 0.0, 0.0, 0
        start = np.broadcast_to(np.eye(3), (len(body), 3, 3))
        self._add(prediction.skeleton.root, -1, np.zeros(3), start, np.zeros((len(body), 3)))
        names, above, offsets, tips = zip(*self._joints, strict=True)
        self.tree = Tree(names, above, np.array(offsets), np.array(tips))

    def degrees(self, frames: slice) -> Iterator[Float[np.ndarray, "frames 3"]]:
        """Yield how each joint is turned in its parent's frame, about z, x, y: those of a long clip wait in a file."""
        start, end, _ = frames.indices(len(self._body))
        for place in self._places:
            if place is None:
                yield np.zeros((end - start, 3))
            else:
                self._turns.seek(place + 24 * start)
                yield np.frombuffer(self._turns.read(24 * (end - start))).reshape(-1, 3)

    def _add(self, joint: str, parent: int, offset: np.ndarray, frame: np.ndarray, at: np.ndarray) -> None:
        """Add a joint ``at`` a place from the root in its parent's ``frame``, and what is below it."""
        children = self._children[joint]
        turned = self._turned(children, frame) if children else frame
        tip = np.full(3, np.nan) if children else offset * _TIP
        place = self._append((joint, parent, offset, tip), joint, frame, turned, at)
        for child in children:
            rest, below, basis = self._rest[child], place, turned
            if np.nanmax(_norm(turned @ rest - self._body.directions([child])[:, 0])) > _OWN_JOINT:
                basis = turn_onto(rest[None], self._body.directions([child]), turned)
                bare = f"{joint}_to_{child}", place, np.zeros(3), np.full(3, np.nan)
                below = self._append(bare, joint, turned, basis, at)
            step = rest * self._body.lengths[child]
            self._add(child, below, step, basis, at + basis @ step)

    def _turned(self, children: list[str], frame: np.ndarray) -> np.ndarray:
        """Turn a joint onto its children; without a rest pose these first settle at their mean in its frame."""
        directions = self._body.directions(children)
        for _ in range(_SETTLE if self._settles and len(children) > 1 else 0):
            turned = turn_onto(np.stack([self._rest[child] for child in children]), directions, frame)
            for place, child in enumerate(children):
                along = np.einsum("fji,fj->i", turned, np.nan_to_num(directions[:, place]))
                if (size := np.linalg.norm(along)) > 0:
                    self._rest[child] = along / size
        return turn_onto(np.stack([self._rest[child] for child in children]), directions, frame)

    def _append(self, joint: tuple, source: str, frame: np.ndarray, turned: np.ndarray, at: np.ndarray) -> int:
        """Add one joint of the file, which sits on the joint ``source`` of the body."""
        self._joints.append(joint)
        still = turned is frame  # at the end of a limb
        self._places.append(None if still else self._turns.tell())
        if not still:
            self._turns.write(euler_zxy(frame.transpose(0, 2, 1) @ turned).data)
        gap = _norm(at - self._body.points(source))
        gap = gap[np.isfinite(gap)]
        self.largest_error = max(self.largest_error, float(gap.max(initial=0)))
        self.sum_of_errors, self.errors = self.sum_of_errors + float(gap.sum()), self.errors + len(gap)
        return len(self._joints) - 1


def turn_onto(
    rest: Float[np.ndarray, "children 3"],
    directions: Float[np.ndarray, "frames children 3"],
    frame: Float[np.ndarray, "frames 3 3"],
) -> Float[np.ndarray, "frames 3 3"]:
    """Return rotations that bring ``rest`` onto ``directions``, what these leave open as ``frame`` has it."""
    turned, trust = np.empty(frame.shape), np.empty(len(frame))
    for start in range(0, len(frame), _BLOCK):
        part = slice(start, start + _BLOCK)
        turned[part], trust[part] = _turned_onto(rest, directions[part], frame[part])
    if (trust < 1).any():
        _follow(turned, trust, rest, directions, frame)
    return turned


def _turned_onto(
    rest: Float[np.ndarray, "children 3"],
    directions: Float[np.ndarray, "frames children 3"],
    frame: Float[np.ndarray, "frames 3 3"],
) -> tuple[Float[np.ndarray, "frames 3 3"], Float[np.ndarray, " frames"]]:
    """Return the rotations, each for itself, and how much each is trusted, from 0 to 1."""
    known = np.asarray(np.isfinite(directions[..., 0]))
    directions = np.where(known[..., None], directions, 0)
    trust = known.all(1).astype(float)
    if len(rest) > 1:
        return nearest_rotations(directions.transpose(0, 2, 1) @ rest + _WEAK * frame), trust
    now, wanted = frame @ rest[0], directions[:, 0]
    trust *= np.clip((1 + np.einsum("fi,fi->f", now, wanted)) / _FOLDED, 0, 1)
    # What is nearest to wanted rest^T + _WEAK frame, nearly of rank 1, is a turn about the line across both directions.
    wanted = wanted + 2 * _WEAK * now
    return quaternion_matrix(least_turn(now, wanted / _norm(wanted)[:, None])) @ frame, trust


def _follow(
    turned: Float[np.ndarray, "frames 3 3"],
    trust: Float[np.ndarray, " frames"],
    rest: Float[np.ndarray, "children 3"],
    directions: Float[np.ndarray, "frames children 3"],
    frame: Float[np.ndarray, "frames 3 3"],
) -> None:
    """Turn frames that are trusted less than 1 as the one before leaves it open, and hold the last turn where nothing is seen.

    Stretches of such frames depend on one frame before them each, and go side by side.
    """
    seen = np.asarray(np.isfinite(directions[..., 0]).any(1))
    trusted = np.flatnonzero(trust == 1)
    first = frame[trusted[0]].T @ turned[trusted[0]] if len(trusted) else np.eye(3)

    def before(last: Int[np.ndarray, " some"]) -> Float[np.ndarray, "some 3 3"]:
        return np.where((last < 0)[:, None, None], first, frame[last].transpose(0, 2, 1) @ turned[last])

    rows = np.flatnonzero(seen)
    sure = trust[rows] == 1
    place = np.arange(len(rows))
    since = place - np.maximum.accumulate(np.where(sure, place, -1))  # frames since the last sure one
    order = np.argsort(since, kind="stable")[np.count_nonzero(sure) :]
    for together in np.split(order, np.flatnonzero(np.diff(since[order])) + 1):
        now, share = rows[together], trust[rows[together]][:, None, None]
        leave = share * np.eye(3) + (1 - share) * before(np.where(together > 0, rows[together - 1], -1))
        wanted = np.nan_to_num(directions[now]).transpose(0, 2, 1) @ rest
        turned[now], _ = nearest_rotation(wanted + _WEAK * (frame[now] @ leave))
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), -1))
    turned[~seen] = frame[~seen] @ before(last[~seen])


class _Body:
    """The poses of some rows; directions are taken bone by bone, as those of a long clip are large."""

    def __init__(self, prediction: Prediction, rows: Int[np.ndarray, " frames"]):
        self.prediction = prediction
        self._pose = prediction.pose if np.array_equal(rows, np.arange(len(prediction))) else prediction.pose[rows]
        self._where = {name: place for place, name in enumerate(prediction.joint_names)}
        self.parents = {joint: parent for joint, parent in prediction.skeleton.parents.items() if parent is not None}
        self.lengths = {joint: self._length(joint) for joint in self.parents}
        """Of the bone to every joint but the root."""

    def __len__(self) -> int:
        return len(self._pose)

    def points(self, joint: str) -> Float[np.ndarray, "frames 3"]:
        """Return where a joint is from the root, not finite where that is not known."""
        return self._pose[:, self._where[joint]].astype(np.float64)

    def directions(self, joints: Iterable[str], frames: slice = slice(None)) -> Float[np.ndarray, "frames joints 3"]:
        """Return unit vectors to joints from their parents, NaN where one is not known."""
        step, length = self._steps(joints, frames)
        return step / length[..., None]

    def _steps(self, joints: Iterable[str], frames: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Return vectors to joints from their parents, and how long they are, NaN where that is not known or 0."""
        pairs = [(self._where[joint], self._where[self.parents[joint]]) for joint in joints]
        to, start = (self._pose[frames, list(places)].astype(np.float64) for places in zip(*pairs, strict=True))
        to -= start
        length = _norm(to)
        return to, np.where((length > 0) & (length < np.inf), length, np.nan)

    def _length(self, joint: str) -> float:
        length = self._steps([joint])[1]
        known = np.isfinite(length)
        if not known.any():
            raise UserError(
                f"a .bvh holds complete bodies, but the bone from '{self.parents[joint]}' to '{joint}' is in no frame of "
                "this clip. Leave the joint out of the skeleton, or write another format."
            )
        return float(np.median(length[known]))


def _norm(vectors: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any"]:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


# The rest directions of a rig: the skeleton's rest pose, or the mean shape of the clip.

_ROUNDS = 3
_SCATTERED = 0.3


def _rest_directions(body: _Body) -> dict[str, Float[np.ndarray, "3"]]:
    """Return the direction of every bone (by its child) in the rest pose, for a body that faces the viewer.

    Where the skeleton gives no rest pose it is the mean of the clip's frames, each turned onto the first.
    """
    skeleton = body.prediction.skeleton
    axes = from_y_down(body.prediction.axes)
    pose = rest_pose(skeleton)
    if pose is None:
        return _facing(skeleton, _mean_shape(body), body.lengths, axes)
    steps = {joint: pose[skeleton.index(joint)] - pose[skeleton.index(up)] for joint, up in body.parents.items()}
    return {joint: axes @ step / np.linalg.norm(step) for joint, step in steps.items()}


def _mean_shape(body: _Body) -> dict[str, np.ndarray]:
    """Return mean directions; those of the fullest frame for a bone that points everywhere."""

    def blocks() -> Iterator[np.ndarray]:
        for start in range(0, len(body), _BLOCK):
            yield body.directions(body.parents, slice(start, start + _BLOCK))

    count, fullest = np.zeros(len(body.parents)), np.full((len(body.parents), 3), np.nan)
    for block in blocks():
        known = np.isfinite(block[..., 0])
        best = int(np.argmax(known.sum(1)))
        fullest = block[best] if known[best].sum() > np.isfinite(fullest).all(-1).sum() else fullest
        count += known.sum(0)
    full = np.asarray(np.isfinite(fullest).all(-1))
    shape = np.where(full[:, None], fullest, 0)
    for _ in range(_ROUNDS):
        mean = np.zeros(shape.shape)
        for block in map(np.nan_to_num, blocks()):
            turn = nearest_rotations(np.einsum("bi,fbj->fij", shape, block) + 1e-9 * np.eye(3))
            mean += np.einsum("fij,fbj->bi", turn, block)
        mean /= np.maximum(count, 1)[:, None]
        scattered = (np.linalg.norm(mean, axis=-1) < _SCATTERED) & full
        mean[scattered] = fullest[scattered]
        size = np.linalg.norm(mean, axis=-1, keepdims=True)
        shape = np.where(size > 1e-6, mean / np.maximum(size, 1e-6), [0.0, 1.0, 0.0])
    return dict(zip(body.parents, shape, strict=True))


def _facing(
    skeleton: Skeleton, rest: dict[str, np.ndarray], lengths: dict[str, float], axes: np.ndarray
) -> dict[str, np.ndarray]:
    """Turn the shape to face the viewer, upright as it is under gravity; as it is where there is no front."""
    if "front" not in skeleton.facing:
        return rest
    pose = np.zeros((len(skeleton.joints), 3))
    for joint, parent in skeleton.parents.items():
        if parent is not None:
            pose[skeleton.index(joint)] = pose[skeleton.index(parent)] + rest[joint] * lengths[joint]
    front = skeleton.facing_matrix("front") @ pose
    up = axes @ [0.0, -1.0, 0.0]
    body_up = up if skeleton.gravity or "up" not in skeleton.facing else skeleton.facing_matrix("up") @ pose
    body, wanted = _basis(body_up, front), _basis(up, axes @ [0.0, 0.0, -1.0])
    if body is None or wanted is None:
        return rest
    return {joint: wanted.T @ body @ direction for joint, direction in rest.items()}


def _basis(up: np.ndarray, front: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    """Return the rows up, front and the side of a body; None where front is along up."""
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    front = front - up * (up @ front)
    size = float(np.linalg.norm(front))
    if size < 1e-6 or not np.linalg.norm(up) > 0.5:
        return None
    return np.stack([up, front / size, np.cross(up, front / size)])
