"""Small glTF files: a triangle, a bending arm, animations."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

__all__ = ["QUARTER", "TRIANGLE", "Glb", "animate", "arm", "plain"]

TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CODES = {"float32": 5126, "uint8": 5121, "int8": 5120, "uint16": 5123, "int16": 5122, "uint32": 5125}


class Glb:
    """A small glTF file, built array by array."""

    def __init__(self) -> None:
        self.tree: dict = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "buffers": []}
        self.data = b""

    def put(self, values, dtype: str = "float32", *, stride: int = 0, **more) -> int:
        """Add an accessor and return its number; matrices are given by rows and stored by columns."""
        array = np.asarray(values, dtype)
        if array.shape[1:] == (4, 4):
            array = array.transpose(0, 2, 1).reshape(-1, 16)
        array = array.reshape(len(array), -1)
        rows = [row.tobytes().ljust(stride, b"\xee") for row in array]
        start, self.data = len(self.data), self.data + b"".join(rows)
        view = {"buffer": 0, "byteOffset": start, "byteLength": len(self.data) - start}
        self.tree["bufferViews"].append(view | ({"byteStride": stride} if stride else {}))
        self.data += b"\0" * (-len(self.data) % 4)
        width = {"count": len(array), "componentType": CODES[dtype], "type": TYPES[array.shape[1]]}
        self.tree["accessors"].append({"bufferView": len(self.tree["bufferViews"]) - 1, **width, **more})
        return len(self.tree["accessors"]) - 1

    def bytes(self) -> bytes:
        tree = self.tree | {"buffers": [{"byteLength": len(self.data)}]}
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.data), 0x004E4942) + self.data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def write(self, path: Path) -> Path:
        path.write_bytes(self.bytes())
        return path


TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.5]]
QUARTER = [0.0, 0.0, 2**-0.5, 2**-0.5]
"""A quarter turn about z: x becomes y."""


def plain(**node) -> Glb:
    """Return one triangle on one node."""
    made = Glb()
    primitive = {"attributes": {"POSITION": made.put(TRIANGLE)}, "indices": made.put([0, 1, 2], "uint16")}
    made.tree |= {"meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0, **node}]}
    made.tree |= {"scenes": [{"nodes": [0]}], "scene": 0}
    return made


def arm() -> Glb:
    """Return an arm bent by an animation: two vertices on the elbow at x = 1, one on the shoulder."""
    made = Glb()
    points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    attributes = {
        "POSITION": made.put(points),
        "JOINTS_0": made.put([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]], "uint8"),
        "WEIGHTS_0": made.put([[255, 0, 0, 0], [255, 0, 0, 0], [255, 0, 0, 0]], "uint8", normalized=True),
    }
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, 0, 3] = -1.0
    made.tree |= {
        "meshes": [{"primitives": [{"attributes": attributes}]}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": made.put(inverse)}],
        # The skinned node's own place is not used: the skin's joints say where it is.
        "nodes": [
            {"name": "body", "mesh": 0, "skin": 0, "translation": [9, 9, 9]},
            {"name": "shoulder", "children": [2]},
            {"name": "elbow", "translation": [1, 0, 0]},
        ],
    }
    return made


def animate(made: Glb, node: int, path: str, times, values, how: str = "LINEAR", name: str = "bend") -> Glb:
    sampler = {"input": made.put(times), "output": made.put(values), "interpolation": how}
    channel = {"sampler": 0, "target": {"node": node, "path": path}}
    made.tree.setdefault("animations", []).append({"name": name, "samplers": [sampler], "channels": [channel]})
    return made
