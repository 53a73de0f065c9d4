"""A clip as an animated binary glTF (``.glb``): a sphere for each joint, a cylinder for each bone."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.config.files import replacing
from uplift.data.poses import USUAL_FPS
from uplift.export.clips import frame_rate, one_clip, steps
from uplift.export.scene import SIDE_COLOURS, body_of, held, in_metres, known_points, linear, row_places
from uplift.geometry.rigid import least_turn, quaternion_matrix, quaternion_product
from uplift.models.prediction import Prediction

__all__ = ["bone_rotations", "write_glb"]

_JOINT_SHARE, _BONE_SHARE = 0.016, 0.008  # radii, as shares of the body


def write_glb(prediction: Prediction, path: str | Path, fps: int | float | None = None) -> None:
    """Write one clip with all its individuals, joints named; ``fps`` replaces the prediction's.

    Metres where the prediction is in mm; else a body is about 1.7 large, by the ``scale`` of ``asset.extras``, as
    glTF knows metres only. Axes as given; glTF has y up. Without a known place individuals stand side by side as in
    the image. Joints and bones that are not known are hidden. Where no rate is known it is 30 frames a second, and
    ``asset.extras`` says so. Raises UserError for several clips.
    """
    clip = one_clip(prediction, path)
    rate = frame_rate(prediction, fps)
    points = known_points(prediction.pose) + row_places(prediction, clip)[:, None]
    scale, body = in_metres(prediction)
    about = {
        "title": prediction.title or clip.name,
        "skeleton": prediction.skeleton.name,
        "axes": prediction.axes,
        "unit": "m" if prediction.unit == "mm" else f"{prediction.unit}, times scale",
        "scale": scale,
        "fps": rate or USUAL_FPS,
        "fps_assumed": rate is None,
    }
    file = _Gltf(clip.name, about)
    meshes = _meshes(file, body)
    times = steps(clip) / (rate or USUAL_FPS)
    moments = clip.by_moment(points * scale)
    for number, name in enumerate(clip.individual_names):
        _individual(file, prediction, name, moments[:, number], times, meshes)
    with replacing(path) as handle:
        handle.write(file.to_bytes())


def bone_rotations(directions: Float[np.ndarray, "frames bones 3"]) -> Float[np.ndarray, "frames bones 4"]:
    """Return quaternions (x y z w) that turn y onto unit ``directions``, each the least turn from the frame before.

    So neighbours never change sign, and interpolation between two keys takes the shortest path. NaN stays as it was.
    """
    turned = np.empty((*directions.shape[:2], 4))
    now = np.tile([0.0, 0.0, 0.0, 1.0], (directions.shape[1], 1))
    for frame, direction in enumerate(directions):
        at = quaternion_matrix(now)[..., 1]
        known = np.isfinite(np.sum(direction, axis=-1, keepdims=True))
        now = quaternion_product(least_turn(at, np.where(known, direction, at)), now)
        now /= np.linalg.norm(now, axis=-1, keepdims=True)
        turned[frame] = now
    return turned


def _meshes(file: _Gltf, size: float) -> tuple[list[int], list[int]]:
    """Return the meshes of joints and of bones, by side."""
    from trimesh.creation import cylinder, icosphere

    ball, rod = icosphere(subdivisions=2, radius=_JOINT_SHARE * size), cylinder(_BONE_SHARE * size, 1.0, sections=12)
    joint = file.shape(np.array(ball.vertices), np.array(ball.vertex_normals), np.array(ball.faces))
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # trimesh's cylinder is along z, about 0
    vertices, normals = np.array(rod.vertices) @ upright.T + [0, 0.5, 0], np.array(rod.vertex_normals) @ upright.T
    bone = file.shape(vertices, normals, np.array(rod.faces))
    colours = [file.material(name, rgb) for name, rgb in SIDE_COLOURS.items()]
    joints = [file.mesh(f"{name} joint", joint, colour) for name, colour in zip(SIDE_COLOURS, colours, strict=True)]
    bones = [file.mesh(f"{name} bone", bone, colour) for name, colour in zip(SIDE_COLOURS, colours, strict=True)]
    return joints, bones


def _individual(
    file: _Gltf, prediction: Prediction, name: str, points: np.ndarray, times: np.ndarray, meshes: tuple
) -> None:
    """Add an individual: joints below it, and each bone below the joint that it starts at."""
    top = file.node(name or prediction.skeleton.name)
    mark, (joint_meshes, bone_meshes) = f"{name}:" if name else "", meshes
    bones, sides, bone_sides = body_of(prediction)
    known = np.isfinite(np.sum(points, axis=-1))
    nodes = []
    for joint, label in enumerate(prediction.joint_names):
        nodes.append(file.node(mark + label, top, mesh=joint_meshes[sides[joint]]))
        file.animate(nodes[-1], "translation", times, held(points[:, joint]))
        if not known[:, joint].all():
            shown = np.repeat(known[:, joint, None], 3, 1).astype(float)
            file.animate(nodes[-1], "scale", times, shown, jumps=True)
    step = points[:, bones[:, 1]] - points[:, bones[:, 0]]
    length = np.linalg.norm(step, axis=-1)
    there = np.isfinite(length) & (length > 0)
    turned = bone_rotations(np.where(there[..., None], step / np.where(there, length, 1)[..., None], np.nan))
    for bone, side in enumerate(bone_sides):
        start, end = (prediction.joint_names[place] for place in bones[bone])
        node = file.node(f"{mark}{start}-{end}", nodes[bones[bone, 0]], mesh=bone_meshes[side])
        file.animate(node, "rotation", times, turned[:, bone])
        size = np.stack([np.ones(len(times)), length[:, bone], np.ones(len(times))], 1)
        file.animate(node, "scale", times, np.where(there[:, bone, None], size, 0.0))


# A binary glTF 2.0 file (``.glb``), built piece by piece: meshes, nodes and one animation.

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class _Gltf:
    """A glTF asset with one scene and one buffer, while it grows."""

    def __init__(self, name: str, about: dict[str, Any]):
        self._parts: list[bytes] = []
        self._size = 0
        kinds = ("nodes", "meshes", "materials", "samplers", "channels", "accessors", "bufferViews")
        self._lists: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
        self._times: dict[bytes, int] = {}
        self._name, self._about = name, about

    def _add(self, kind: str, item: dict[str, Any]) -> int:
        self._lists[kind].append(item)
        return len(self._lists[kind]) - 1

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
        look = {"baseColorFactor": [*_short(linear(rgb)), 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6}
        return self._add("materials", {"name": name, "pbrMetallicRoughness": look})

    def mesh(self, name: str, shape: dict[str, Any], material: int) -> int:
        return self._add("meshes", {"name": name, "primitives": [{**shape, "material": material}]})

    def node(self, name: str, parent: int | None = None, **rest: Any) -> int:
        """Add a node below ``parent`` and return it; ``rest`` is its ``mesh``, ``translation`` and so on."""
        place = self._add("nodes", {"name": name, **rest})
        if parent is not None:
            self._lists["nodes"][parent].setdefault("children", []).append(place)
        return place

    def animate(self, node: int, path: str, times: np.ndarray, values: np.ndarray, jumps: bool = False) -> None:
        """Give a node keyframes (times in s, times parts) of its translation, rotation (x y z w) or scale.

        It rests at the first. ``jumps``: each value stays until the next.
        """
        values = values.astype(np.float32)
        self._lists["nodes"][node][path] = _short(values[0])
        # A value that stays the same needs one key.
        if (values == values[0]).all():
            times, values = times[:1], values[:1]
        key = times.astype(np.float32).tobytes()
        if key not in self._times:
            self._times[key] = self._accessor(times.reshape(-1, 1).astype(np.float32), _FLOAT, bounds=True)
        keys = {"input": self._times[key], "output": self._accessor(values, _FLOAT)}
        sampler = self._add("samplers", {**keys, "interpolation": "STEP" if jumps else "LINEAR"})
        self._add("channels", {"sampler": sampler, "target": {"node": node, "path": path}})

    def to_bytes(self) -> bytes:
        nodes = self._lists["nodes"]
        below = {child for node in nodes for child in node.get("children", [])}
        motion = {kind: self._lists[kind] for kind in ("samplers", "channels")}
        asset = {
            "asset": {"version": "2.0", "generator": "uplift", "extras": self._about},
            "scene": 0,
            "scenes": [{"name": self._name, "nodes": [n for n in range(len(nodes)) if n not in below]}],
            **{kind: self._lists[kind] for kind in ("nodes", "meshes", "materials")},
            "animations": [{"name": self._name, **motion}],
            **{kind: self._lists[kind] for kind in ("accessors", "bufferViews")},
            "buffers": [{"byteLength": self._size}],
        }
        text = json.dumps(asset, separators=(",", ":"), ensure_ascii=False).encode("utf-8", "replace")
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._parts)
        head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
        chunks = ((b"JSON", text), (b"BIN\0", binary))
        return head + b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)

    def _accessor(self, values: np.ndarray, code: int, target: int | None = None, bounds: bool = False) -> int:
        """Store rows of values in a view of their own, begun at a multiple of four bytes."""
        data = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        place = self._add("bufferViews", view if target is None else {**view, "target": target})
        padded = data + b"\0" * (-len(data) % 4)
        self._parts.append(padded)
        self._size += len(padded)
        kind = {"componentType": code, "count": len(values), "type": _KINDS[values.shape[1]]}
        limits = {"min": values.min(0).tolist(), "max": values.max(0).tolist()} if bounds else {}
        return self._add("accessors", {"bufferView": place, **kind, **limits})


def _short(values: np.ndarray) -> list[float]:
    """Return numbers that JSON writes in few letters."""
    return [float(f"{value:.6g}") for value in values.tolist()]
