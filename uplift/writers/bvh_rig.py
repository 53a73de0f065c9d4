"""A rig for a clip of poses: bones of one length each, and the turns that bring them nearest to the poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.figure import Figure, Tree
from uplift.prediction import Prediction
from uplift.skeleton.layout import rest_pose
from uplift.writers.bvh_rest import nearest_rotation, rest_directions

__all__ = ["Rig", "fit_rig", "turn_onto"]

_OWN_JOINT = 2e-4
"""Share of a bone by which a child may miss before it gets a turn of its own."""
_WEAK = 1e-5
"""Of what the bones leave open, against what they say."""
_FOLDED = 0.5
"""1 + cosine of the angle to the rest direction (120 degrees) below which the frame before has a say."""
_TIP = 0.1
_SETTLE = 8


@dataclass(frozen=True)
class Rig:
    """A tree in the prediction's unit and its motion; ``sources[i]`` is the joint that rig joint i sits on."""

    tree: Tree
    sources: tuple[int, ...]
    turned: list[Float[np.ndarray, "frames 3 3"]]
    """Of each rig joint in its parent's frame."""

    def positions(self, root: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "joints frames 3"]:
        """Return where the rig's joints are."""
        return Figure.posed(self.tree, root, self.turned).positions


def fit_rig(prediction: Prediction, pose: Float[np.ndarray, "frames joints 3"]) -> Rig:
    """Return the rig of a pose (relative to the root, NaN where not known).

    Bones have their median length. A joint with one child turns the least way from its parent's frame, as the
    twist about a bone cannot be seen; where the bone folds back on its rest direction, and the least way is
    undefined, the twist follows from the frame before. A joint with several turns as a whole (Kabsch, Acta Cryst.
    A32, 1976), and a child that this misses gets a turn of its own at the same place, which is exact. What is not
    known holds its last turn. Raises UserError where a joint is nowhere known.
    """
    ways, lengths = _bones(prediction, pose)
    return _Builder(prediction, ways, lengths, rest_directions(prediction, ways, lengths)).rig()


def turn_onto(
    rest: Float[np.ndarray, "children 3"],
    ways: Float[np.ndarray, "frames children 3"],
    frame: Float[np.ndarray, "frames 3 3"],
) -> Float[np.ndarray, "frames 3 3"]:
    """Return rotations that bring ``rest`` onto ``ways``, what these leave open as ``frame`` has it."""
    known = np.isfinite(np.sum(ways, axis=-1))
    wanted = np.einsum("fki,kj->fij", np.where(known[..., None], ways, 0), rest)
    trust = known.all(1).astype(float)
    if len(rest) == 1:
        unfolded = np.einsum("fi,fij,j->f", np.nan_to_num(ways[:, 0]), frame, rest[0])
        trust *= np.clip((1 + unfolded) / _FOLDED, 0, 1)
    turned = nearest_rotation(wanted + _WEAK * frame)
    sure = np.flatnonzero(trust == 1)
    before = frame[sure[0]].T @ turned[sure[0]] if len(sure) else np.eye(3)
    for now in np.flatnonzero(trust < 1):
        before = frame[now - 1].T @ turned[now - 1] if now else before
        leave = frame[now] @ (trust[now] * np.eye(3) + (1 - trust[now]) * before)
        turned[now] = nearest_rotation(wanted[now] + _WEAK * leave)
    return turned


def _bones(prediction: Prediction, pose: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Return of every joint but the root the direction from its parent (frames 3), and the length."""
    where = {name: place for place, name in enumerate(prediction.joint_names)}
    ways, lengths = {}, {}
    for joint, parent in prediction.skeleton.parents.items():
        if parent is None:
            continue
        step = pose[:, where[joint]] - pose[:, where[parent]]
        length = np.linalg.norm(step, axis=-1)
        known = np.isfinite(length) & (length > 0)
        if not known.any():
            raise UserError(
                f"a .bvh holds whole bodies, but the bone from '{parent}' to '{joint}' is in no frame of this clip. "
                "Leave the joint out of the skeleton, or write another format."
            )
        lengths[joint] = float(np.median(length[known]))
        ways[joint] = np.where(known[:, None], step / np.where(known, length, 1)[:, None], np.nan)
    return ways, lengths


class _Builder:
    """The rig while it grows, parents first and depth first, as the file lists it."""

    def __init__(self, prediction: Prediction, ways: dict, lengths: dict, rest: dict):
        self.ways, self.lengths, self.rest = ways, lengths, rest
        self.loose = rest_pose(prediction.skeleton) is None
        self.where = {name: place for place, name in enumerate(prediction.joint_names)}
        self.root, parents = prediction.skeleton.root, prediction.skeleton.parents
        self.children: dict[str, list[str]] = {joint: [] for joint in parents}
        for joint in (name for name in prediction.joint_names if parents.get(name) is not None):
            self.children[str(parents[joint])].append(joint)
        self.frames = len(next(iter(ways.values())))
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[np.ndarray] = []
        self.tips: list[np.ndarray] = []
        self.sources: list[int] = []
        self.turned: list[np.ndarray] = []

    def rig(self) -> Rig:
        self._add(self.root, -1, np.zeros(3), np.tile(np.eye(3), (self.frames, 1, 1)))
        tree = Tree(tuple(self.names), tuple(self.parents), np.array(self.offsets), np.array(self.tips))
        return Rig(tree, tuple(self.sources), self.turned)

    def _add(self, joint: str, parent: int, offset: np.ndarray, frame: np.ndarray) -> None:
        children = self.children[joint]
        turned, tip = frame, np.full(3, np.nan)
        if children:
            turned = self._turned(children, frame)
        else:
            tip = offset * _TIP
        place = self._append(joint, parent, offset, tip, joint, frame, turned)
        for child in children:
            step, below, basis = self.rest[child] * self.lengths[child], place, turned
            miss = np.linalg.norm(turned @ self.rest[child] - self.ways[child], axis=-1)
            if np.nanmax(miss) > _OWN_JOINT:
                basis = turn_onto(self._rest([child]), self.ways[child][:, None], turned)
                name = f"{joint}_to_{child}"
                below = self._append(name, place, np.zeros(3), np.full(3, np.nan), joint, turned, basis)
            self._add(child, below, step, basis)

    def _turned(self, children: list[str], frame: np.ndarray) -> np.ndarray:
        """Turn a joint onto its children; without a rest pose these first settle at their mean in its frame."""
        ways = np.stack([self.ways[child] for child in children], 1)
        for _ in range(_SETTLE if self.loose and len(children) > 1 else 0):
            turned = turn_onto(self._rest(children), ways, frame)
            for place, child in enumerate(children):
                mean = np.nanmean(np.einsum("fji,fj->fi", turned, ways[:, place]), 0)
                if (size := np.linalg.norm(mean)) > 0:
                    self.rest[child] = mean / size
        return turn_onto(self._rest(children), ways, frame)

    def _append(self, name, parent: int, offset, tip, source: str, frame, turned) -> int:
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append(offset)
        self.tips.append(tip)
        self.sources.append(self.where[source])
        self.turned.append(np.einsum("fji,fjk->fik", frame, turned))
        return len(self.names) - 1

    def _rest(self, children: list[str]) -> np.ndarray:
        return np.stack([self.rest[child] for child in children])
