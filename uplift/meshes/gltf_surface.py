"""A glTF file's triangles: primitives, morph targets, skins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from uplift.meshes.gltf_accessors import floats, wholes
from uplift.meshes.gltf_file import Document

__all__ = ["Primitive", "Skin", "read_meshes_of", "read_skins"]


@dataclass(frozen=True)
class Skin:
    """Which nodes carry a skin, and the skin's rest in the frame of each."""

    joints: list[int]
    inverse: Float[np.ndarray, "joints 4 4"]


@dataclass(frozen=True)
class Primitive:
    """Triangles of one material, in the frame of their mesh."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    joints: Int[np.ndarray, "vertices influences"] | None
    """Numbers of the skin's joints; None: without a skin."""
    weights: Float[np.ndarray, "vertices influences"] | None
    targets: Float[np.ndarray, "targets vertices 3"]
    """How far each morph target moves each vertex."""

    def moved(
        self, matrices: Float[np.ndarray, "joints 4 4"], skinned: bool, morph: Float[np.ndarray, " targets"]
    ) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
        """Return vertices and faces where the matrices of the skin's joints, or of the one node, put them."""
        vertices, faces = self.vertices, self.faces
        if len(self.targets):
            vertices = vertices + np.tensordot(morph, self.targets, 1)
        if skinned and self.joints is not None and self.weights is not None:
            each = np.einsum("vi,vijk->vjk", self.weights, matrices[self.joints])
        else:
            each = np.broadcast_to(matrices[0], (len(vertices), 4, 4))
        placed = np.einsum("vjk,vk->vj", each[:, :3, :3], vertices) + each[:, :3, 3]
        mirrored = np.linalg.det(each[faces[:, 0], :3, :3]) < 0
        return placed, np.where(mirrored[:, None], faces[:, ::-1], faces)


def read_skins(document: Document) -> list[Skin]:
    """Return the file's skins. Raises UserError for joints or matrices that are not there."""
    found = []
    for number, entry in enumerate(document.listed("skins")):
        joints = document.numbers_of("nodes", entry, "joints", f"skin {number}")
        if not joints:
            raise document.wrong(f"skin {number} has no joints")
        inverse = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        if "inverseBindMatrices" in entry:
            inverse = floats(document, entry["inverseBindMatrices"], "MAT4", f"skin {number}")
            inverse = inverse.reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(inverse) < len(joints):
                raise document.wrong(f"skin {number} has {len(inverse)} matrices for {len(joints)} joints")
        found.append(Skin(joints, inverse[: len(joints)]))
    return found


def read_meshes_of(document: Document) -> list[list[Primitive]]:
    """Return the triangles of each of the file's meshes; points and lines are passed over. Raises UserError."""
    found = []
    for number, entry in enumerate(document.listed("meshes")):
        primitives = []
        for primitive in document.objects(entry, "primitives", f"mesh {number}"):
            if primitive.get("mode", 4) in (4, 5, 6):
                primitives.append(_primitive(document, primitive, f"mesh {number}"))
        if len({len(primitive.targets) for primitive in primitives}) > 1:
            raise document.wrong(f"the parts of mesh {number} have different numbers of morph targets")
        found.append(primitives)
    return found


def _primitive(document: Document, entry: dict[str, Any], whose: str) -> Primitive:
    attributes = entry.get("attributes")
    if not isinstance(attributes, dict):
        raise document.wrong(f"{whose} has triangles without attributes")
    vertices = floats(document, attributes.get("POSITION"), "VEC3", f"'POSITION' of {whose}")
    faces = _faces(document, entry, len(vertices), whose)
    joints, weights = _influences(document, attributes, len(vertices), whose)
    targets = np.zeros((0, len(vertices), 3))
    if "targets" in entry:
        moves = [
            floats(document, target["POSITION"], "VEC3", f"a morph target of {whose}")
            if "POSITION" in target
            else np.zeros_like(vertices)
            for target in document.objects(entry, "targets", whose)
        ]
        if any(len(move) != len(vertices) for move in moves):
            raise document.wrong(f"a morph target of {whose} has not {len(vertices)} rows")
        targets = np.stack(moves) if moves else targets
    # Primitives often share one list of vertices: each keeps its own.
    used, faces = np.unique(faces, return_inverse=True)
    if joints is not None and weights is not None:
        joints, weights = joints[used], weights[used]
    return Primitive(vertices[used], faces.reshape(-1, 3), joints, weights, targets[:, used])


def _faces(document: Document, entry: dict[str, Any], vertices: int, whose: str) -> Int[np.ndarray, "faces 3"]:
    corners = np.arange(vertices)
    if "indices" in entry:
        corners = wholes(document, entry["indices"], "SCALAR", f"the indices of {whose}")[:, 0]
        if len(corners) and corners.max() >= vertices:
            raise document.wrong(f"{whose} refers to vertex {corners.max()}, of {vertices}")
    mode = entry.get("mode", 4)
    if mode == 4:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == 6:
        return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], 1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip


def _influences(
    document: Document, attributes: dict[str, Any], vertices: int, whose: str
) -> tuple[np.ndarray | None, np.ndarray | None]:
    joints, weights = [], []
    while f"JOINTS_{len(joints)}" in attributes:
        number = len(joints)
        joints.append(wholes(document, attributes[f"JOINTS_{number}"], "VEC4", f"'JOINTS_{number}' of {whose}"))
        name = f"WEIGHTS_{number}"
        weights.append(floats(document, attributes.get(name), "VEC4", f"'{name}' of {whose}"))
        if len(joints[-1]) != vertices or len(weights[-1]) != vertices:
            raise document.wrong(f"'{name}' of {whose} has not {vertices} rows")
    if not joints:
        return None, None
    every, weight = np.concatenate(joints, 1), np.concatenate(weights, 1).clip(0)
    total = weight.sum(1, keepdims=True)
    weight[total[:, 0] < 1e-9, 0] = 1.0  # on nothing: on its first joint
    return every, weight / np.maximum(weight.sum(1, keepdims=True), 1e-9)
