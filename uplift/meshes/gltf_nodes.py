"""The tree of a glTF file's nodes: who hangs on whom, and where everything is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.meshes.gltf_file import Document

__all__ = ["Nodes", "read_nodes", "unique_names"]


@dataclass(frozen=True)
class Nodes:
    """Every node's place relative to its parent; what an animation moves is changed in a copy."""

    names: list[str]
    parents: list[int]
    """-1 for those that hang on nothing."""
    order: list[int]
    """All nodes, parents before their children."""
    translation: Float[np.ndarray, "nodes 3"]
    rotation: Float[np.ndarray, "nodes 4"]
    """Quaternions (x, y, z, w)."""
    scale: Float[np.ndarray, "nodes 3"]
    fixed: dict[int, np.ndarray]
    """Matrices (4, 4) of the nodes that have one in the place of the three."""

    def placed(self) -> Float[np.ndarray, "nodes 4 4"]:
        """Return the matrices from each node's own frame to the file's."""
        found = np.zeros((len(self.names), 4, 4))
        found[:, :3, :3] = _rotations(self.rotation) * self.scale[:, None, :]
        found[:, :3, 3] = self.translation
        found[:, 3, 3] = 1.0
        for node, matrix in self.fixed.items():
            found[node] = matrix
        for node in self.order:
            if self.parents[node] >= 0:
                found[node] = found[self.parents[node]] @ found[node]
        return found


def read_nodes(document: Document) -> Nodes:
    """Return the file's nodes. Raises UserError for a tree that is none, or numbers that are none."""
    entries = document.listed("nodes")
    parents = [-1] * len(entries)
    for node, entry in enumerate(entries):
        for child in document.numbers_of("nodes", entry, "children", f"node {node}"):
            if parents[child] >= 0:
                raise document.wrong(f"node {child} hangs on two nodes, {parents[child]} and {node}")
            parents[child] = node
    order = [node for node, parent in enumerate(parents) if parent < 0]
    for node in order:  # grows while it is walked
        order.extend(entries[node].get("children", ()))
    if len(order) < len(entries):
        lost = min(set(range(len(entries))) - set(order))
        raise document.wrong(f"node {lost} hangs on itself: its parents go round in a circle")
    names = unique_names([entry.get("name") for entry in entries], "node")
    rotation = _numbers(document, entries, "rotation", (0.0, 0.0, 0.0, 1.0))
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if (length < 1e-6).any():
        raise document.wrong(f"node {int(length.argmin())} has a rotation of length 0")
    matrices = _numbers(document, entries, "matrix", tuple(np.eye(4).ravel())).reshape(-1, 4, 4)
    fixed = {node: matrices[node].T for node, entry in enumerate(entries) if "matrix" in entry}
    return Nodes(
        names,
        parents,
        order,
        _numbers(document, entries, "translation", (0.0, 0.0, 0.0)),
        rotation / length,
        _numbers(document, entries, "scale", (1.0, 1.0, 1.0)),
        fixed,
    )


def unique_names(names: list[Any], kind: str) -> list[str]:
    """Return names that differ: ``kind N`` for one without, ``NAME (2)`` for the second of a name."""
    seen: dict[str, int] = {}
    found = []
    for number, name in enumerate(names):
        text = name if isinstance(name, str) and name else f"{kind} {number}"
        seen[text] = seen.get(text, 0) + 1
        found.append(text if seen[text] == 1 else f"{text} ({seen[text]})")
    return found


def _numbers(document: Document, entries: list[dict[str, Any]], key: str, default: tuple[float, ...]) -> np.ndarray:
    found = np.tile(np.array(default, np.float64), (len(entries), 1))
    for node, entry in enumerate(entries):
        if key in entry:
            value = entry[key]
            told = isinstance(value, list) and len(value) == len(default)
            if not told or not all(isinstance(one, int | float) and abs(one) < 1e30 for one in value):
                raise document.wrong(f"'{key}' of node {node} is not {len(default)} numbers")
            found[node] = value
    return found


def _rotations(quaternion: Float[np.ndarray, "nodes 4"]) -> Float[np.ndarray, "nodes 3 3"]:
    x, y, z, w = quaternion.T
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, -1).reshape(-1, 3, 3)
