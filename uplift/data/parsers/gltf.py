"""glTF 2.0 files: the surface of what is in them at any moment of their animations."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import inside
from uplift.data.parsers.files import read_bytes
from uplift.errors import UserError, did_you_mean
from uplift.geometry.mesh import Mesh
from uplift.geometry.rigid import quaternion_matrix, slerp

__all__ = ["GltfFile"]

_TO_OWN = np.array([1.0, -1.0, -1.0])
"""glTF has y up and the front at +z: half a turn about x makes it y down and the front at -z."""
_MOST_VERTICES = 20_000_000
_MOST_PARTS = 10_000
"""Meshes times where they are shown, primitive by primitive: each costs time in each pose, whatever its size."""


class GltfFile:
    """One glTF 2.0 file, checked and decoded, that can be posed at any moment.

    Shapes are in their own frame, x their left, y down, z behind, in the file's unit (metres by the standard).
    """

    def __init__(self, path: Path, nodes: _Nodes, parts: list[_Part], tracks: dict[str, list[_Track]]) -> None:
        self.path = path
        self._nodes, self._parts, self._tracks = nodes, parts, tracks
        self.animations = {
            name: float(max((track.times_s[-1] for track in found), default=0.0)) for name, found in tracks.items()
        }
        """Seconds of each animation, by its name."""

    @classmethod
    def read(cls, path: str | Path) -> GltfFile:
        """Read a .glb file, or a .gltf file with its buffers inside or beside it.

        Source: Khronos, glTF 2.0 specification. Materials, cameras and lights are ignored.

        Raises:
            UserError: not glTF 2.0, damaged, compressed, or without a triangle.
        """
        document = _Document(Path(path))
        nodes = _read_nodes(document)
        parts = _read_parts(document, nodes)
        if not any(len(primitive.faces) for part in parts for primitive in part.primitives):
            raise UserError(f"{path}: no triangles in its scene. Expected a file with at least one mesh.")
        targets = {part.node: len(part.morph) for part in parts}
        return cls(Path(path), nodes, parts, _read_animations(document, nodes, targets))

    def posed(self, animation: str | None = None, time_s: float = 0.0) -> Mesh:
        """Return the surface at a moment of an animation, or as the file has it at rest.

        Before an animation's first key and after its last it does not move. Raises UserError for an unknown name.
        """
        tracks = self._tracks_of(animation)
        matrices = self._nodes.placed(tracks, time_s)
        weights = {track.node: track.at(time_s) for track in tracks if track.path == "weights"}
        vertices, faces, count = [], [], 0
        for part in self._parts:
            skin = None if part.skin is None else matrices[part.skin.joints] @ part.skin.inverse
            for primitive in part.primitives:
                morph = weights.get(part.node, part.morph)
                points, corners = primitive.moved(matrices[part.node], skin, morph)
                vertices.append(points)
                faces.append(corners + count)
                count += len(points)
        return Mesh(np.concatenate(vertices) * _TO_OWN, np.concatenate(faces), self.path.stem)

    def node_positions(self, animation: str | None = None, time_s: float = 0.0) -> dict[str, np.ndarray]:
        """Return where each node, such as a bone, is at a moment: (3,) each, in the frame and unit of `posed`."""
        matrices = self._nodes.placed(self._tracks_of(animation), time_s)
        return dict(zip(self._nodes.names, matrices[:, :3, 3] * _TO_OWN, strict=True))

    def _tracks_of(self, animation: str | None) -> list[_Track]:
        if animation is None:
            return []
        if animation not in self._tracks:
            hint = did_you_mean(animation, self._tracks) or " It has none."
            raise UserError(f"{self.path}: no animation '{animation}'.{hint}")
        return self._tracks[animation]


# The file: its JSON, its buffers, and the numbers in them.

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_LISTS = ("buffers", "bufferViews", "accessors", "nodes", "meshes", "skins", "animations", "scenes")
# What may be required and changes nothing in the geometry read here, or is read (quantised numbers).
_HARMLESS = ("KHR_mesh_quantization", "KHR_texture_", "KHR_materials_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MOST_EMPTY = 5_000_000
"""Rows of all accessors without data, which cost a file nothing to claim."""
_MOST_DECODED = 16
"""Numbers for each byte of the file, over what a small one may have: many accessors can read the same bytes."""
_SMALL = 20_000_000


class _Document:
    """The JSON of one file, its lists of entries, and the bytes of its buffers (specification, chapters 3.6 and 4.4)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        found, binary = read_bytes(path), None
        if found[:4] == b"glTF":
            found, binary = self._chunks(found)
        elif path.suffix.lower() != ".gltf":
            raise UserError(f"{path}: not a glTF binary: it does not begin with 'glTF'. Expected a .glb file.")
        try:
            tree = json.loads(found.decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise self.wrong(f"its JSON cannot be read ({str(error)[:80]})") from error
        self.tree: dict[str, Any] = tree if isinstance(tree, dict) else {}
        self._check_kind()
        self.lists = {kind: self.objects(self.tree, kind, "the file") for kind in _LISTS}
        self._decoded: dict[tuple[str, str, str], np.ndarray] = {}
        self._count = self._empty = 0
        self.buffers = [self._buffer(number, entry, binary) for number, entry in enumerate(self.lists["buffers"])]

    def wrong(self, what: str) -> UserError:
        """Return the error for a damaged file."""
        return UserError(f"{self.path}: damaged, or not glTF 2.0: {what}. Export it again as a glTF 2.0 binary (.glb).")

    def _chunks(self, found: bytes) -> tuple[bytes, bytes | None]:
        if len(found) < 20:
            raise self.wrong(f"it is cut off after {len(found)} bytes")
        version, length = struct.unpack_from("<II", found, 4)
        if version != 2:
            raise UserError(f"{self.path}: glTF binary of version {version}, expected 2. Export it again as glTF 2.0.")
        if length > len(found):
            raise self.wrong(f"it is cut off: {len(found):,} bytes of {length:,}")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", found, at)
            if at + 8 + size > length:
                raise self.wrong(f"a chunk of {size:,} bytes ends after the file's end")
            chunks.setdefault(kind, found[at + 8 : at + 8 + size])
            at += 8 + size + (-size % 4)
        if _JSON not in chunks:
            raise self.wrong("it has no JSON chunk")
        return chunks[_JSON], chunks.get(_BINARY)

    def _check_kind(self) -> None:
        asset = self.tree.get("asset")
        version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
        if not version.startswith("2"):
            raise UserError(f"{self.path}: glTF version '{version[:20]}', expected 2.0. Export it again as glTF 2.0.")
        required = self.tree.get("extensionsRequired", [])
        for name in required if isinstance(required, list) else []:
            if not str(name).startswith(_HARMLESS):
                raise UserError(
                    f"{self.path}: needs the extension '{str(name)[:60]}', which is not read here. "
                    "Export it again without compression (Draco, meshopt) and extensions."
                )

    def _buffer(self, number: int, buffer: dict[str, Any], binary: bytes | None) -> bytes:
        length = self.integer(buffer, "byteLength", None, f"buffer {number}")
        uri = buffer.get("uri")
        if uri is None:
            found = binary if number == 0 and binary is not None else b""
        elif isinstance(uri, str) and uri.startswith("data:"):
            try:
                found = base64.b64decode(uri.partition(",")[2], validate=True)
            except (binascii.Error, ValueError) as error:
                raise self.wrong(f"the data of buffer {number} is not base64") from error
        else:
            found = self._beside(str(uri), length)
        if len(found) < length:
            raise self.wrong(f"buffer {number} has {len(found):,} bytes of {length:,}")
        return found[:length]

    def _beside(self, uri: str, length: int) -> bytes:
        file = None if ":" in uri else inside(self.path.parent, unquote(uri))
        if file is None:
            raise UserError(f"{self.path}: its buffer is at '{uri[:80]}', expected a file beside it.")
        try:
            if not file.is_file():
                raise UserError(f"{self.path}: its buffer {file} is missing. Put it beside the .gltf file.")
            with file.open("rb") as stream:
                return stream.read(length)
        except (OSError, ValueError) as error:
            raise UserError(f"{file}: cannot be read ({error}).") from error

    def objects(self, entry: dict[str, Any], key: str, whose: str) -> list[dict[str, Any]]:
        """Return a list of objects of an entry, empty without any."""
        found = entry.get(key, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.wrong(f"'{key}' of {whose} is not a list of objects")
        return found

    def index(self, kind: str, index: Any, whose: str, count: int | None = None) -> int:
        """Return ``index`` where the file has such an entry, or where it is below ``count``."""
        count = len(self.lists[kind]) if count is None else count
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
            raise self.wrong(f"{whose} refers to {kind} {str(index)[:40]}, of {count}")
        return index

    def node_indices(self, entry: dict[str, Any], key: str, whose: str) -> list[int]:
        """Return a list of indices of nodes, empty without any."""
        found = entry.get(key, [])
        if not isinstance(found, list):
            raise self.wrong(f"'{key}' of {whose} is not a list")
        return [self.index("nodes", index, whose) for index in found]

    def integer(self, entry: dict[str, Any], key: str, default: int | None, whose: str) -> int:
        """Return a whole number of an entry, 0 or more."""
        found = entry.get(key, default)
        if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found < 1 << 40:
            raise self.wrong(f"'{key}' of {whose} is {str(found)[:40]}, expected a whole number")
        return found

    def floats(self, index: Any, kind: str, whose: str) -> Float[np.ndarray, "rows width"]:
        """Return an accessor's numbers, normalised integers as -1..1 or 0..1; they are shared, not to be changed."""
        return self._once(self._as_floats, index, kind, whose)

    def integers(self, index: Any, kind: str, whose: str) -> Int[np.ndarray, "rows width"]:
        """Return an accessor's whole numbers, 0 or more; they are shared, not to be changed."""
        return self._once(self._as_integers, index, kind, whose)

    def _once(self, decoded: Callable[..., np.ndarray], index: Any, kind: str, whose: str) -> np.ndarray:
        """Return what ``decoded`` does, from before where it is known: parts often share one list of vertices."""
        key = (decoded.__name__, str(index), kind)
        if key not in self._decoded:
            self._decoded[key] = decoded(index, kind, whose)
        return self._decoded[key]

    def count(self, numbers: int) -> None:
        """Count numbers that are read; raises UserError for many more than the file has bytes."""
        self._count += numbers
        if self._count > _SMALL + _MOST_DECODED * sum(map(len, self.buffers)):
            raise self.wrong(f"its accessors read the same bytes again and again, {self._count:,} numbers by now")

    def _as_floats(self, index: Any, kind: str, whose: str) -> np.ndarray:
        accessor, found = self._rows(index, kind, whose)
        values = found.astype(np.float64)
        if accessor.get("normalized") is True and found.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(found.dtype).max, -1.0)
        if not np.isfinite(values).all():
            raise self.wrong(f"{whose} has numbers that are not finite")
        return values

    def _as_integers(self, index: Any, kind: str, whose: str) -> np.ndarray:
        _, found = self._rows(index, kind, whose)
        if found.dtype.kind != "u":
            raise self.wrong(f"{whose} are not unsigned whole numbers")
        return found.astype(np.int64)

    def _rows(self, index: Any, kind: str, whose: str) -> tuple[dict[str, Any], np.ndarray]:
        accessor, name = self.lists["accessors"][self.index("accessors", index, whose)], f"accessor {index}"
        if accessor.get("type") != kind:
            raise self.wrong(f"{name} is {str(accessor.get('type'))[:20]}, expected {kind}")
        shape = self.integer(accessor, "count", None, name), _WIDTHS[kind]
        dtype = self._component(accessor, name)
        if "bufferView" in accessor:
            found = self._viewed(accessor, dtype, shape, name)
        else:
            self._empty += shape[0]
            if self._empty > _MOST_EMPTY:
                raise self.wrong(f"{name} claims {shape[0]:,} rows and has no data")
            found = np.zeros(shape, dtype)
        self.count(found.size)
        return accessor, self._changed(accessor, found, name) if "sparse" in accessor else found

    def _component(self, entry: dict[str, Any], name: str) -> np.dtype:
        kind = entry.get("componentType")
        if not isinstance(kind, int) or kind not in _COMPONENTS:
            raise self.wrong(f"{name} has the component type {str(kind)[:20]}")
        return np.dtype(_COMPONENTS[kind])

    def _viewed(self, entry: dict[str, Any], dtype: np.dtype, shape: tuple[int, int], name: str) -> np.ndarray:
        """Return rows of a buffer view, without a copy."""
        view = self.lists["bufferViews"][self.index("bufferViews", entry.get("bufferView"), name)]
        whose, size = f"the view of {name}", dtype.itemsize * shape[1]
        buffer = self.buffers[self.index("buffers", view.get("buffer"), whose)]
        start = self.integer(view, "byteOffset", 0, whose)
        length = self.integer(view, "byteLength", None, whose)
        offset = self.integer(entry, "byteOffset", 0, name)
        stride = self.integer(view, "byteStride", size, whose)
        if stride < size:
            raise self.wrong(f"the rows of {name} are {size} bytes and {stride} apart")
        needed = offset + (stride * (shape[0] - 1) + size if shape[0] else 0)
        if start + length > len(buffer) or needed > length:
            had = min(start + length, len(buffer))
            raise self.wrong(f"{name} needs {start + needed:,} bytes, its buffer has {had:,}")
        if not shape[0]:
            return np.zeros(shape, dtype)
        return np.ndarray(shape, dtype, buffer, start + offset, (stride, dtype.itemsize))

    def _changed(self, accessor: dict[str, Any], found: np.ndarray, name: str) -> np.ndarray:
        sparse = accessor["sparse"] if isinstance(accessor["sparse"], dict) else {}
        at, values = sparse.get("indices"), sparse.get("values")
        if not isinstance(at, dict) or not isinstance(values, dict):
            raise self.wrong(f"the sparse changes of {name} are not objects")
        count = self.integer(sparse, "count", None, name)
        rows = self._viewed(at, self._component(at, name), (count, 1), name)[:, 0]
        if rows.dtype.kind != "u" or (rows >= len(found)).any():
            raise self.wrong(f"the sparse changes of {name} are in rows that it does not have")
        changed = found.copy()
        changed[rows] = self._viewed(values, found.dtype, (count, found.shape[1]), name)
        return changed


# The tree of nodes.


@dataclass(frozen=True)
class _Nodes:
    """Every node's place relative to its parent, at rest."""

    names: list[str]
    parents: list[int]
    """-1 for the roots."""
    order: list[int]
    """All nodes, parents before their children."""
    rest: dict[str, Float[np.ndarray, "nodes _"]]
    """``translation``, ``rotation`` (quaternions x, y, z, w) and ``scale``, as tracks call them."""
    fixed: dict[int, np.ndarray]
    """Matrices (4, 4) of the nodes that have one in place of the three."""

    def placed(self, tracks: Sequence[_Track], time_s: float) -> Float[np.ndarray, "nodes 4 4"]:
        """Return the matrices from each node's own frame to the file's at a moment of an animation's tracks."""
        state = {path: values.copy() for path, values in self.rest.items()}
        for track in tracks:
            if track.path in state:
                state[track.path][track.node] = track.at(time_s)
        found = np.zeros((len(self.names), 4, 4))
        found[:, :3, :3] = quaternion_matrix(state["rotation"]) * state["scale"][:, None, :]
        found[:, :3, 3] = state["translation"]
        found[:, 3, 3] = 1.0
        for node, matrix in self.fixed.items():
            found[node] = matrix
        for node in self.order:
            if self.parents[node] >= 0:
                found[node] = found[self.parents[node]] @ found[node]
        return found


def _read_nodes(document: _Document) -> _Nodes:
    entries = document.lists["nodes"]
    parents = [-1] * len(entries)
    for node, entry in enumerate(entries):
        for child in document.node_indices(entry, "children", f"node {node}"):
            if parents[child] >= 0:
                raise document.wrong(f"node {child} has two parents, {parents[child]} and {node}")
            parents[child] = node
    order = [node for node, parent in enumerate(parents) if parent < 0]
    for node in order:  # grows while it is walked
        order.extend(entries[node].get("children", ()))
    if len(order) < len(entries):
        lost = min(set(range(len(entries))) - set(order))
        raise document.wrong(f"the parents of node {lost} form a circle")
    rest = {
        "translation": _numbers(document, "translation", (0.0, 0.0, 0.0)),
        "rotation": _numbers(document, "rotation", (0.0, 0.0, 0.0, 1.0)),
        "scale": _numbers(document, "scale", (1.0, 1.0, 1.0)),
    }
    length = np.linalg.norm(rest["rotation"], axis=1, keepdims=True)
    if (length < 1e-6).any():
        raise document.wrong(f"node {int(length.argmin())} has a rotation of length 0")
    rest["rotation"] /= length
    matrices = _numbers(document, "matrix", tuple(np.eye(4).ravel())).reshape(-1, 4, 4)
    fixed = {node: matrices[node].T for node, entry in enumerate(entries) if "matrix" in entry}
    return _Nodes(_unique_names(entries, "node"), parents, order, rest, fixed)


def _unique_names(entries: list[dict[str, Any]], kind: str) -> list[str]:
    """Return names that differ: ``kind N`` for an entry without one, ``NAME (2)`` for the second of a name."""
    seen: dict[str, int] = {}
    found = []
    for number, entry in enumerate(entries):
        name = entry.get("name")
        text = name if isinstance(name, str) and name else f"{kind} {number}"
        seen[text] = seen.get(text, 0) + 1
        found.append(text if seen[text] == 1 else f"{text} ({seen[text]})")
    return found


def _numbers(document: _Document, key: str, default: tuple[float, ...]) -> np.ndarray:
    """Return the numbers that each node has under ``key``."""
    entries = document.lists["nodes"]
    found = np.tile(np.array(default, np.float64), (len(entries), 1))
    for node, entry in enumerate(entries):
        if key in entry:
            if not _are_numbers(entry[key], len(default)):
                raise document.wrong(f"'{key}' of node {node} is not {len(default)} numbers")
            found[node] = entry[key]
    return found


def _are_numbers(value: Any, count: int) -> bool:
    fits = isinstance(value, list) and len(value) == count
    return fits and all(isinstance(one, int | float) and abs(one) < 1e30 for one in value)


# Animations: what moves, and its value at any moment.

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}


@dataclass(frozen=True)
class _Track:
    """One thing that moves: a node's translation, rotation or scale, or the weights of its morph targets."""

    node: int
    path: str
    how: str
    """STEP, LINEAR or CUBICSPLINE."""
    times_s: Float[np.ndarray, " keys"]
    values: Float[np.ndarray, "keys parts width"]
    """One part, or three of CUBICSPLINE: incoming tangent, value, outgoing tangent."""

    def at(self, time_s: float) -> Float[np.ndarray, " width"]:
        """Return the value at a moment, constant before the first and after the last key (specification, appendix C)."""
        after = int(np.searchsorted(self.times_s, time_s, side="right"))
        if self.how == "STEP" or after in (0, len(self.times_s)):
            found = self.values[max(after - 1, 0), self.values.shape[1] // 2]
        else:
            length = self.times_s[after] - self.times_s[after - 1]
            share = (time_s - self.times_s[after - 1]) / length
            start, end = self.values[after - 1], self.values[after]
            if self.how == "CUBICSPLINE":
                found = _spline(start, end, share, length)
            elif self.path == "rotation":
                found = slerp(start[0], end[0], share)
            else:
                found = (1 - share) * start[0] + share * end[0]
        if self.path != "rotation":
            return found
        length = np.linalg.norm(found)
        return found / length if length > 1e-9 else np.array([0.0, 0.0, 0.0, 1.0])


def _spline(start: np.ndarray, end: np.ndarray, share: float, length: float) -> np.ndarray:
    """Return the cubic Hermite spline between two keys (specification, appendix C.5)."""
    square, cube = share**2, share**3
    return (
        (2 * cube - 3 * square + 1) * start[1]
        + length * (cube - 2 * square + share) * start[2]
        + (3 * square - 2 * cube) * end[1]
        + length * (cube - square) * end[0]
    )


def _read_animations(document: _Document, nodes: _Nodes, targets: dict[int, int]) -> dict[str, list[_Track]]:
    """Return the tracks of each animation; ``targets`` counts each node's morph targets."""
    entries = document.lists["animations"]
    found: dict[str, list[_Track]] = {}
    for name, entry in zip(_unique_names(entries, "animation"), entries, strict=True):
        whose, found[name] = f"animation '{name}'", []
        samplers = document.objects(entry, "samplers", whose)
        for channel in document.objects(entry, "channels", whose):
            target = channel.get("target")
            if isinstance(target, dict) and "node" in target:  # one without a node is to be ignored
                sampler = samplers[document.index("sampler", channel.get("sampler"), whose, len(samplers))]
                found[name].append(_track(document, sampler, target, whose, targets))
                if found[name][-1].node in nodes.fixed and found[name][-1].path != "weights":
                    raise document.wrong(f"{whose} moves node {target['node']}, which has a matrix")
    return found


def _track(
    document: _Document, sampler: dict[str, Any], target: dict[str, Any], whose: str, targets: dict[int, int]
) -> _Track:
    node, path = document.index("nodes", target["node"], whose), str(target.get("path"))
    how = sampler.get("interpolation", "LINEAR")
    if how not in ("STEP", "LINEAR", "CUBICSPLINE") or path not in _KINDS:
        raise document.wrong(f"{whose} moves '{path[:20]}' by '{str(how)[:20]}'")
    times = document.floats(sampler.get("input"), "SCALAR", f"the times of {whose}")[:, 0]
    values = document.floats(sampler.get("output"), _KINDS[path], f"the values of {whose}")
    if not len(times) or (np.diff(times) <= 0).any() or times[0] < 0:
        raise document.wrong(f"the times of {whose} do not increase from 0 or more")
    parts = 3 if how == "CUBICSPLINE" else 1
    width = targets.get(node, 0) if path == "weights" else values.shape[1]
    if values.size != len(times) * parts * width:
        raise document.wrong(f"{whose} has {values.size} values for {len(times)} moments of '{path}'")
    return _Track(node, path, how, times, values.reshape(len(times), parts, width))


# Triangles: meshes of primitives with morph targets, and the skins that move them.


@dataclass(frozen=True)
class _Skin:
    """The nodes that move a skin, and the skin at rest in the frame of each."""

    joints: list[int]
    inverse: Float[np.ndarray, "joints 4 4"]


@dataclass(frozen=True)
class _Part:
    """A mesh that a node shows."""

    node: int
    primitives: Sequence[_Primitive]
    skin: _Skin | None
    morph: Float[np.ndarray, " targets"]


@dataclass(frozen=True)
class _Primitive:
    """Triangles of one material, in the frame of their mesh."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    joints: Int[np.ndarray, "vertices influences"]
    """Indices into the skin's joints; no influences without a skin."""
    weights: Float[np.ndarray, "vertices influences"]
    targets: Float[np.ndarray, "targets vertices 3"]
    """How far each morph target moves each vertex."""

    def moved(
        self,
        node: Float[np.ndarray, "4 4"],
        skin: Float[np.ndarray, "joints 4 4"] | None,
        morph: Float[np.ndarray, " targets"],
    ) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
        """Return vertices and faces where the matrices of the skin's joints put them, or without any that of the node."""
        vertices, faces = self.vertices, self.faces
        if len(self.targets):
            vertices = vertices + np.tensordot(morph, self.targets, 1)
        if skin is not None and self.joints.shape[1]:
            each = np.einsum("vi,vijk->vjk", self.weights, skin[self.joints])
        else:
            each = np.broadcast_to(node, (len(vertices), 4, 4))
        placed = np.einsum("vjk,vk->vj", each[:, :3, :3], vertices) + each[:, :3, 3]
        mirrored = np.linalg.det(each[faces[:, 0], :3, :3]) < 0
        return placed, np.where(mirrored[:, None], faces[:, ::-1], faces)


def _read_parts(document: _Document, nodes: _Nodes) -> list[_Part]:
    primitives = sum(len(document.objects(entry, "primitives", "a mesh")) for entry in document.lists["meshes"])
    if primitives > _MOST_PARTS:
        raise UserError(
            f"{document.path}: {primitives:,} separate parts, expected at most {_MOST_PARTS:,}. Join them before export."
        )
    meshes = [_primitives(document, entry, f"mesh {number}") for number, entry in enumerate(document.lists["meshes"])]
    skins = [_skin(document, entry, f"skin {number}") for number, entry in enumerate(document.lists["skins"])]
    shown = _shown(document, nodes)
    shapes, count, parts = [], 0, 0
    for node, entry in enumerate(document.lists["nodes"]):
        if "mesh" not in entry:
            continue
        number = document.index("meshes", entry["mesh"], f"node {node}")
        skin = skins[document.index("skins", entry["skin"], f"node {node}")] if "skin" in entry else None
        last = max((int(primitive.joints.max(initial=-1)) for primitive in meshes[number]), default=-1)
        if skin is not None and last >= len(skin.joints):
            raise document.wrong(f"mesh {number} refers to joint {last} of its skin")
        count += sum(len(primitive.vertices) for primitive in meshes[number])
        parts += len(meshes[number])
        if count > _MOST_VERTICES or parts > _MOST_PARTS:
            found = f"{_MOST_VERTICES:,} vertices" if count > _MOST_VERTICES else f"{_MOST_PARTS:,} separate parts"
            raise UserError(f"{document.path}: shows more than {found}. Join its parts, or simplify it, before export.")
        if node in shown:
            shapes.append(_Part(node, meshes[number], skin, _morph(document, entry, number, meshes[number])))
    return shapes


def _shown(document: _Document, nodes: _Nodes) -> set[int]:
    """Return the nodes of the file's scene; all where it has no scene."""
    scenes = document.lists["scenes"]
    if not scenes:
        return set(nodes.order)
    scene = scenes[document.index("scenes", document.tree.get("scene", 0), "the file")]
    shown = set(document.node_indices(scene, "nodes", "the scene"))
    for node in nodes.order:
        if nodes.parents[node] in shown:
            shown.add(node)
    return shown


def _morph(document: _Document, node: dict[str, Any], number: int, primitives: list[_Primitive]) -> np.ndarray:
    count = len(primitives[0].targets) if primitives else 0
    weights = node.get("weights", document.lists["meshes"][number].get("weights", [0.0] * count))
    if count and not _are_numbers(weights, count):
        raise document.wrong(f"mesh {number} does not have {count} weights of its morph targets")
    return np.array(weights if count else [], np.float64)


def _skin(document: _Document, entry: dict[str, Any], whose: str) -> _Skin:
    joints = document.node_indices(entry, "joints", whose)
    if not joints:
        raise document.wrong(f"{whose} has no joints")
    if "inverseBindMatrices" not in entry:
        return _Skin(joints, np.broadcast_to(np.eye(4), (len(joints), 4, 4)))
    inverse = document.floats(entry["inverseBindMatrices"], "MAT4", whose).reshape(-1, 4, 4).transpose(0, 2, 1)
    if len(inverse) < len(joints):
        raise document.wrong(f"{whose} has {len(inverse)} matrices for {len(joints)} joints")
    return _Skin(joints, inverse[: len(joints)])


def _primitives(document: _Document, entry: dict[str, Any], whose: str) -> list[_Primitive]:
    """Return the triangles of a mesh; points and lines are ignored."""
    entries = document.objects(entry, "primitives", whose)
    found = [_primitive(document, one, whose) for one in entries if one.get("mode", 4) in (4, 5, 6)]
    if len({len(primitive.targets) for primitive in found}) > 1:
        raise document.wrong(f"the parts of {whose} have different numbers of morph targets")
    return found


def _primitive(document: _Document, entry: dict[str, Any], whose: str) -> _Primitive:
    attributes = entry.get("attributes")
    if not isinstance(attributes, dict):
        raise document.wrong(f"{whose} has triangles without attributes")
    vertices = document.floats(attributes.get("POSITION"), "VEC3", f"'POSITION' of {whose}")
    document.count(len(document.objects(entry, "targets", whose)) * vertices.size)
    faces = _faces(document, entry, len(vertices), whose)
    joints, weights = _influences(document, attributes, len(vertices), whose)
    moves = [
        document.floats(target["POSITION"], "VEC3", f"a morph target of {whose}")
        if "POSITION" in target
        else np.zeros_like(vertices)
        for target in document.objects(entry, "targets", whose)
    ]
    if any(len(move) != len(vertices) for move in moves):
        raise document.wrong(f"a morph target of {whose} does not have {len(vertices)} rows")
    targets = np.array(moves).reshape(len(moves), len(vertices), 3)
    # Primitives often share one list of vertices: each keeps only its own.
    used, faces = np.unique(faces, return_inverse=True)
    return _Primitive(vertices[used], faces.reshape(-1, 3), joints[used], weights[used], targets[:, used])


def _faces(document: _Document, entry: dict[str, Any], vertices: int, whose: str) -> Int[np.ndarray, "faces 3"]:
    corners = np.arange(vertices)
    if "indices" in entry:
        corners = document.integers(entry["indices"], "SCALAR", f"the indices of {whose}")[:, 0]
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
    document: _Document, attributes: dict[str, Any], vertices: int, whose: str
) -> tuple[Int[np.ndarray, "vertices influences"], Float[np.ndarray, "vertices influences"]]:
    joints, weights = [np.zeros((vertices, 0), np.int64)], [np.zeros((vertices, 0))]
    while (name := f"JOINTS_{len(joints) - 1}") in attributes:
        joints.append(document.integers(attributes[name], "VEC4", f"'{name}' of {whose}"))
        name = name.replace("JOINTS", "WEIGHTS")
        weights.append(document.floats(attributes.get(name), "VEC4", f"'{name}' of {whose}"))
        if len(joints[-1]) != vertices or len(weights[-1]) != vertices:
            raise document.wrong(f"'{name}' of {whose} does not have {vertices} rows")
    every, weight = np.concatenate(joints, 1), np.concatenate(weights, 1).clip(0)
    total = weight.sum(1, keepdims=True)
    weight[total[:, 0] < 1e-9, :1] = 1.0  # without a weight: all on the first joint
    return every, weight / np.maximum(weight.sum(1, keepdims=True), 1e-9)
