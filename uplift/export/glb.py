"""A clip as an animated binary glTF (``.glb``): a sphere for each joint, a cylinder for each bone."""

from __future__ import annotations

import json
import shutil
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import replacing, scratch
from uplift.data.poses import USUAL_FPS
from uplift.errors import UserError
from uplift.export.clips import Clip, frame_rate, one_clip, steps
from uplift.export.scene import SIDE_COLOURS, body_of, held, in_metres, known_points, linear, row_places
from uplift.geometry.rigid import least_turn, quaternion_matrix, quaternion_product
from uplift.models.prediction import Prediction

__all__ = ["bone_rotations", "write_glb"]

_JOINT_SHARE, _BONE_SHARE = 0.016, 0.008  # radii, as shares of the body
_AT_ONCE = 1 << 18
"""Turns of bones that are computed at once: many bones of a short clip, few of a long one."""


def write_glb(prediction: Prediction, path: str | Path, fps: int | float | None = None) -> None:
    """Write one clip with all its individuals, joints named; ``fps`` replaces the prediction's.

    Metres where the prediction is in mm; else a body is about 1.7 large, by the ``scale`` of ``asset.extras``, as
    glTF knows metres only. Axes as given; glTF has y up. Without a known place individuals stand side by side as in
    the image. Joints and bones that are not known are hidden. Where no rate is known it is 30 frames a second, and
    ``asset.extras`` says so. Raises UserError for several clips.
    """
    clip = one_clip(prediction, path)
    rate = frame_rate(prediction, fps)
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
    roots = row_places(prediction, clip)
    with replacing(path) as handle, scratch(path) as binary:
        file = _Gltf(clip.name, about, binary)
        meshes = _meshes(file, body)
        times = steps(clip) / (rate or USUAL_FPS)
        for name in clip.individual_names:
            _individual(file, prediction, _Places(prediction.pose, roots, clip.only(name), scale), times, meshes)
        if file.size >= _MOST:
            raise UserError(
                f"cannot write {path}: a .glb holds {_MOST / 2**30:.0f} GB, and these {len(clip.rows):,} poses take "
                f"{file.size / 2**30:.1f}. Write shorter clips."
            )
        file.write(handle)


@dataclass(frozen=True)
class _Places:
    """Where the joints of one individual are, taken joint by joint: those of a long clip are large."""

    pose: Float[np.ndarray, "rows joints 3"]
    roots: Float[np.ndarray, "rows 3"]
    clip: Clip
    scale: float

    def at(self, joint: int) -> Float[np.ndarray, "moments 3"]:
        """Return the places of a joint in metres, NaN where they are not known."""
        points = known_points(self.pose[:, joint][:, None])[:, 0] + self.roots
        return self.clip.by_moment(points * self.scale)[:, 0]


def bone_rotations(directions: Float[np.ndarray, "frames bones 3"]) -> Float[np.ndarray, "frames bones 4"]:
    """Return quaternions (x y z w) that turn y onto unit ``directions``, each the least turn from the frame before.

    So neighbours never change sign, and interpolation between two keys takes the shortest path. NaN stays as it was.
    """
    known = np.isfinite(directions[..., 0] + directions[..., 1] + directions[..., 2])
    last = np.maximum.accumulate(np.where(known, np.arange(len(known))[:, None], -1))
    found = np.take_along_axis(directions, np.maximum(last, 0)[..., None], 0)
    found[last < 0] = (0, 1, 0)
    turned = _one_after_another(
        least_turn(np.concatenate([np.broadcast_to([[[0.0, 1, 0]]], found[:1].shape), found[:-1]]), found)
    )
    # What was rounded in many products is made good.
    turned = quaternion_product(least_turn(quaternion_matrix(turned)[..., 1], found), turned)
    return turned / np.linalg.norm(turned, axis=-1, keepdims=True)


def _one_after_another(turns: Float[np.ndarray, "frames bones 4"]) -> Float[np.ndarray, "frames bones 4"]:
    """Return the product of each turn and all before it: within stretches side by side, then of whole stretches."""
    frames = len(turns)
    length = int(np.ceil(np.sqrt(frames)))
    rest = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (-frames % length, *turns.shape[1:]))
    found = np.concatenate([turns, rest]).reshape(-1, length, *turns.shape[1:])
    for place in range(1, length):
        found[:, place] = quaternion_product(found[:, place], found[:, place - 1])
    before = found[:, -1].copy()
    for stretch in range(1, len(found)):
        before[stretch] = quaternion_product(before[stretch], before[stretch - 1])
    found[1:] = quaternion_product(found[1:], before[:-1, None])
    found = found.reshape(-1, *turns.shape[1:])[:frames]
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


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


def _individual(file: _Gltf, prediction: Prediction, places: _Places, times: np.ndarray, meshes: tuple) -> None:
    """Add an individual: joints below it, and each bone below the joint that it starts at."""
    name, (joint_meshes, bone_meshes) = places.clip.individual_names[0], meshes
    top, mark = file.node(name or prediction.skeleton.name), f"{name}:" if name else ""
    bones, sides, bone_sides = body_of(prediction)
    nodes = []
    for joint, label in enumerate(prediction.joint_names):
        points = places.at(joint)
        nodes.append(file.node(mark + label, top, mesh=joint_meshes[sides[joint]]))
        file.animate(nodes[-1], "translation", times, held(points))
        known = np.isfinite(points[:, 0])
        if not known.all():
            file.animate(nodes[-1], "scale", times, np.repeat(known[:, None], 3, 1), jumps=True)
    together = max(1, _AT_ONCE // len(times))
    for first in range(0, len(bones), together):
        some = slice(first, first + together)
        turned, length = _moved(places, bones[some])
        for at, (bone, side) in enumerate(zip(bones[some].tolist(), bone_sides[some], strict=True)):
            start, end = (prediction.joint_names[place] for place in bone)
            node = file.node(f"{mark}{start}-{end}", nodes[bone[0]], mesh=bone_meshes[side])
            file.animate(node, "rotation", times, turned[:, at])
            there = (length[:, at] > 0)[:, None]
            size = np.where(there, np.stack([np.ones(len(times)), length[:, at], np.ones(len(times))], 1), 0.0)
            file.animate(node, "scale", times, size)


def _moved(places: _Places, bones: Int[np.ndarray, "bones 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Return how bones are turned (frames bones 4), and how long they are (frames bones), NaN where that is not known."""
    points = {joint: places.at(joint) for joint in set(bones.ravel().tolist())}
    step = np.stack([points[end] - points[start] for start, end in bones.tolist()], 1)
    length = np.linalg.norm(step, axis=-1)
    return bone_rotations(step / np.where(length > 0, length, np.nan)[..., None]), length


# A binary glTF 2.0 file (``.glb``), built piece by piece: meshes, nodes and one animation.

_MOST = 1 << 32
"""Bytes of a file, whose length is a number of 32 bits."""
_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class _Gltf:
    """A glTF asset with one scene and one buffer, while it grows; the buffer does so in a file of its own."""

    def __init__(self, name: str, about: dict[str, Any], binary: IO[bytes]):
        self._binary, self.size = binary, 0
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

    def write(self, handle: IO[bytes]) -> None:
        """Write the file."""
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
            "buffers": [{"byteLength": self.size}],
        }
        text = json.dumps(asset, separators=(",", ":"), ensure_ascii=False).encode("utf-8", "replace")
        text += b" " * (-len(text) % 4)
        handle.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self.size))
        handle.write(struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", self.size, b"BIN\0"))
        self._binary.seek(0)
        shutil.copyfileobj(self._binary, handle, 1 << 20)

    def _accessor(self, values: np.ndarray, code: int, target: int | None = None, bounds: bool = False) -> int:
        """Store rows of values in a view of their own, begun at a multiple of four bytes."""
        data = np.ascontiguousarray(values)
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": data.nbytes}
        place = self._add("bufferViews", view if target is None else {**view, "target": target})
        self._binary.write(data.data)
        self.size += data.nbytes + self._binary.write(b"\0" * (-data.nbytes % 4))
        kind = {"componentType": code, "count": len(values), "type": _KINDS[values.shape[1]]}
        limits = {"min": values.min(0).tolist(), "max": values.max(0).tolist()} if bounds else {}
        return self._add("accessors", {"bufferView": place, **kind, **limits})


def _short(values: np.ndarray) -> list[float]:
    """Return numbers that JSON writes in few letters."""
    return [float(f"{value:.6g}") for value in values.tolist()]
