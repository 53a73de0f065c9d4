"""glTF 2.0 files: the surface of what is in them at any moment of their animations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError, did_you_mean
from uplift.meshes.gltf_animation import Track, at_moment, read_animations
from uplift.meshes.gltf_file import Document, read_document
from uplift.meshes.gltf_nodes import Nodes, read_nodes
from uplift.meshes.gltf_surface import Primitive, Skin, read_meshes_of, read_skins
from uplift.meshes.mesh import Mesh

__all__ = ["GltfFile"]

_TO_OWN = np.array([1.0, -1.0, -1.0])
"""glTF has y up and the front at +z: half a turn about x makes it y down and the front at -z."""
_MOST_VERTICES = 20_000_000


@dataclass(frozen=True)
class _Part:
    """A mesh that a node shows."""

    node: int
    primitives: Sequence[Primitive]
    skin: Skin | None
    morph: Float[np.ndarray, " targets"]


class GltfFile:
    """One glTF 2.0 file, checked and decoded whole: what was read can be posed at any moment.

    Shapes are in their own frame, x their left, y down, z behind, in the file's unit (metres by the standard).
    """

    def __init__(self, path: Path, nodes: Nodes, parts: list[_Part], tracks: dict[str, list[Track]]) -> None:
        self.path = path
        self._nodes, self._parts, self._tracks = nodes, parts, tracks
        self.animations = {
            name: float(max((track.times_s[-1] for track in found), default=0.0)) for name, found in tracks.items()
        }
        """Seconds of each animation, by its name."""

    @classmethod
    def read(cls, path: str | Path) -> GltfFile:
        """Read a .glb file, or a .gltf file with its buffers inside or beside it.

        Source: Khronos, glTF 2.0 specification. Materials, cameras and lights are passed over.

        Raises:
            UserError: no glTF 2.0, damaged, compressed, or without a triangle.
        """
        document = read_document(path)
        nodes = read_nodes(document)
        parts = _parts(document, nodes)
        if not sum(len(primitive.faces) for part in parts for primitive in part.primitives):
            raise UserError(f"{path}: no triangles in its scene. Expected a file with at least one mesh.")
        targets = {part.node: len(part.morph) for part in parts}
        return cls(Path(path), nodes, parts, read_animations(document, nodes, targets))

    def posed(self, animation: str | None = None, time_s: float = 0.0) -> Mesh:
        """Return the whole surface at a moment of an animation, or as the file has it at rest.

        Before an animation's first key and behind its last it stands still. Raises UserError for an unknown name.
        """
        nodes, weights = self._moment(animation, time_s)
        matrices = nodes.placed()
        vertices, faces, count = [], [], 0
        for part in self._parts:
            of = matrices[[part.node]]
            if part.skin is not None:
                of = matrices[part.skin.joints] @ part.skin.inverse
            for primitive in part.primitives:
                # A part without joints in a skinned mesh hangs on the node.
                skinned = part.skin is not None and primitive.joints is not None
                morph = weights.get(part.node, part.morph)
                points, corners = primitive.moved(of if skinned else matrices[[part.node]], skinned, morph)
                vertices.append(points)
                faces.append(corners + count)
                count += len(points)
        return Mesh(np.concatenate(vertices) * _TO_OWN, np.concatenate(faces), self.path.stem)

    def node_positions(self, animation: str | None = None, time_s: float = 0.0) -> dict[str, np.ndarray]:
        """Return where each node, such as a bone, is at a moment: (3,) each, in the frame and unit of `posed`."""
        nodes, _ = self._moment(animation, time_s)
        return dict(zip(nodes.names, nodes.placed()[:, :3, 3] * _TO_OWN, strict=True))

    def _moment(self, animation: str | None, time_s: float) -> tuple[Nodes, dict[int, np.ndarray]]:
        if animation is None:
            return self._nodes, {}
        if animation not in self._tracks:
            hint = did_you_mean(animation, self._tracks) or " It has none."
            raise UserError(f"{self.path}: no animation '{animation}'.{hint}")
        return at_moment(self._nodes, self._tracks[animation], time_s)


def _parts(document: Document, nodes: Nodes) -> list[_Part]:
    meshes, skins = read_meshes_of(document), read_skins(document)
    entries = document.listed("nodes")
    found, count = [], 0
    shown = _shown(document, nodes)
    for node, entry in enumerate(entries):
        if "mesh" not in entry:
            continue
        number = document.number_of("meshes", entry["mesh"], f"node {node}")
        skin = skins[document.number_of("skins", entry["skin"], f"node {node}")] if "skin" in entry else None
        for primitive in meshes[number] if skin else ():
            if primitive.joints is not None and primitive.joints.max(initial=-1) >= len(skin.joints if skin else ()):
                raise document.wrong(f"mesh {number} refers to joint {primitive.joints.max()} of its skin")
        count += sum(len(primitive.vertices) for primitive in meshes[number])
        if count > _MOST_VERTICES:
            raise document.wrong(f"it shows more than {_MOST_VERTICES:,} vertices")
        if node in shown:
            found.append(_Part(node, meshes[number], skin, _morph(document, entry, number, meshes[number])))
    return found


def _shown(document: Document, nodes: Nodes) -> set[int]:
    """Return the nodes of the file's scene; all where it has no scene."""
    scenes = document.listed("scenes")
    if not scenes:
        return set(range(len(nodes.names)))
    scene = document.entry("scenes", document.tree.get("scene", 0), "the file")
    shown = set(document.numbers_of("nodes", scene, "nodes", "the scene"))
    for node in nodes.order:
        if nodes.parents[node] in shown:
            shown.add(node)
    return shown


def _morph(document: Document, node: dict[str, Any], number: int, primitives: list[Primitive]) -> np.ndarray:
    count = len(primitives[0].targets) if primitives else 0
    told = node.get("weights", document.listed("meshes")[number].get("weights", [0.0] * count))
    if not count:
        return np.zeros(0)
    if not isinstance(told, list) or len(told) != count or not all(isinstance(one, int | float) for one in told):
        raise document.wrong(f"mesh {number} has not {count} weights of its morph targets")
    return np.array(told, np.float64)
