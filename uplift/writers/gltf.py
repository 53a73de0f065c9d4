"""A binary glTF 2.0 file (``.glb``), built piece by piece: meshes, nodes and one animation.

The glTF 2.0 Specification, Khronos Group 2021 (ISO/IEC 12113:2022).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from jaxtyping import Float

__all__ = ["Gltf"]

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class Gltf:
    """A glTF asset with one scene and one buffer, while it grows."""

    def __init__(self, name: str, about: dict[str, Any]):
        self._parts: list[bytes] = []
        self._size = 0
        self._accessors: list[dict[str, Any]] = []
        self._views: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self.nodes: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._times: dict[bytes, int] = {}
        self._name, self._about = name, about

    def shape(
        self, vertices: Float[np.ndarray, "vertices 3"], normals: Float[np.ndarray, "vertices 3"], faces: np.ndarray
    ) -> dict[str, Any]:
        """Store a shape once and return the primitive that meshes of any material share."""
        kind, code = (np.uint16, _USHORT) if len(vertices) < 2**16 else (np.uint32, _UINT)
        place = self._accessor(vertices.astype(np.float32), _FLOAT, _VERTICES, bounds=True)
        normal = self._accessor(normals.astype(np.float32), _FLOAT, _VERTICES)
        indices = self._accessor(faces.reshape(-1, 1).astype(kind), code, _INDICES)
        return {"attributes": {"POSITION": place, "NORMAL": normal}, "indices": indices}

    def material(self, name: str, rgb: tuple[int, int, int]) -> int:
        """Return a matt material of an sRGB colour, 0 to 255."""
        colour = np.asarray(rgb) / 255
        linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
        look = {"baseColorFactor": [*_short(linear), 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6}
        self._materials.append({"name": name, "pbrMetallicRoughness": look})
        return len(self._materials) - 1

    def mesh(self, name: str, shape: dict[str, Any], material: int) -> int:
        """Return a mesh of a shape in a material."""
        self._meshes.append({"name": name, "primitives": [{**shape, "material": material}]})
        return len(self._meshes) - 1

    def node(self, name: str, parent: int | None = None, **rest: Any) -> int:
        """Add a node below ``parent`` and return it; ``rest`` is its ``mesh``, ``translation`` and so on."""
        self.nodes.append({"name": name, **rest})
        if parent is not None:
            self.nodes[parent].setdefault("children", []).append(len(self.nodes) - 1)
        return len(self.nodes) - 1

    def animate(
        self,
        node: int,
        path: str,
        times: Float[np.ndarray, " times"],
        values: Float[np.ndarray, "times parts"],
        jumps: bool = False,
    ) -> None:
        """Give a node keyframes (seconds) of its translation, rotation (x y z w) or scale, and the first as it rests.

        ``jumps``: each value stays until the next.
        """
        values = values.astype(np.float32)
        self.nodes[node][path] = _short(values[0])
        # A value that stays the same needs one key.
        if (values == values[0]).all():
            times, values = times[:1], values[:1]
        key = times.astype(np.float32).tobytes()
        if key not in self._times:
            self._times[key] = self._accessor(times.reshape(-1, 1).astype(np.float32), _FLOAT, bounds=True)
        sampler = {"input": self._times[key], "output": self._accessor(values, _FLOAT)}
        self._samplers.append({**sampler, "interpolation": "STEP" if jumps else "LINEAR"})
        self._channels.append({"sampler": len(self._samplers) - 1, "target": {"node": node, "path": path}})

    def to_bytes(self) -> bytes:
        """Return the file."""
        below = {child for node in self.nodes for child in node.get("children", [])}
        asset = {
            "asset": {"version": "2.0", "generator": "uplift", "extras": self._about},
            "scene": 0,
            "scenes": [{"name": self._name, "nodes": [n for n in range(len(self.nodes)) if n not in below]}],
            "nodes": self.nodes,
            "meshes": self._meshes,
            "materials": self._materials,
            "animations": [{"name": self._name, "samplers": self._samplers, "channels": self._channels}],
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": self._size}],
        }
        text = json.dumps(asset, separators=(",", ":"), ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._parts)
        head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
        return (
            head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        )

    def _accessor(self, values: np.ndarray, code: int, target: int | None = None, bounds: bool = False) -> int:
        """Store rows of values in a view of their own, begun at a multiple of four bytes."""
        data = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        self._views.append(view if target is None else {**view, "target": target})
        padded = data + b"\0" * (-len(data) % 4)
        self._parts.append(padded)
        self._size += len(padded)
        kind = {"componentType": code, "count": len(values), "type": _KINDS[values.shape[1]]}
        accessor = {"bufferView": len(self._views) - 1, **kind}
        if bounds:
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1


def _short(values: np.ndarray) -> list[float]:
    """Return numbers that JSON writes in few letters."""
    return [float(f"{value:.6g}") for value in values.tolist()]
