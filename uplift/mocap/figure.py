"""A tree of joints as a motion capture file describes it, and where its joints are in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Figure", "Tree", "turns"]


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


def turns(degrees: Float[np.ndarray, "frames angles"], axes: str) -> Float[np.ndarray, "frames 3 3"]:
    """Return the rotations about the axes of ``axes`` (such as ``zyx``), each about the axes turned before it."""
    result: np.ndarray | None = None
    for angle, axis in zip(np.deg2rad(degrees).T, axes, strict=True):
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.zeros((len(angle), 3, 3))
        here = "xyz".index(axis)
        first, second = (here + 1) % 3, (here + 2) % 3
        turn[:, here, here] = 1
        turn[:, first, first] = turn[:, second, second] = cosine
        turn[:, first, second], turn[:, second, first] = -sine, sine
        result = turn if result is None else result @ turn
    return np.tile(np.eye(3), (len(degrees), 1, 1)) if result is None else result
