"""glTF 2.0 files: the surface of what is in them at any moment of their animations."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.geometry.mesh import Mesh
from uplift.geometry.rigid import quaternion_matrix, slerp

__all__ = ["GltfFile"]

# A glTF 2.0 file taken apart: its JSON, its buffers, and looking things up in them.

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
# What may be required and changes nothing in the geometry read here, or is read (quantised numbers).
_HARMLESS = ("KHR_mesh_quantization", "KHR_texture_", "KHR_materials_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")


@dataclass
class _Document:
    """The JSON of one file and the bytes of its buffers."""

    path: Path
    tree: dict[str, Any]
    buffers: list[bytes]

    def wrong(self, what: str) -> UserError:
        """Return the error that says what is wrong with the file."""
        return _damaged(self.path, what)

    def listed(self, kind: str) -> list[dict[str, Any]]:
        """Return the file's nodes, meshes, accessors, ...: a list of objects, empty without any."""
        return self.objects(self.tree, kind, "the file")

    def objects(self, entry: dict[str, Any], key: str, whose: str) -> list[dict[str, Any]]:
        """Return a list of objects of an entry, empty without any."""
        found = entry.get(key, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.wrong(f"'{key}' of {whose} is not a list of objects")
        return found

    def entry(self, kind: str, index: Any, whose: str) -> dict[str, Any]:
        """Return one of the file's nodes, meshes, accessors, ... by its number."""
        every = self.tree.get(kind, [])
        if not isinstance(every, list):
            raise self.wrong(f"'{kind}' of the file is not a list of objects")
        found = every[self.number_of(kind, index, whose)]
        if not isinstance(found, dict):
            raise self.wrong(f"{kind} {index} is not an object")
        return found

    def number_of(self, kind: str, index: Any, whose: str) -> int:
        """Return ``index`` where the file has such an entry."""
        count = len(self.tree.get(kind, []))
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
            raise self.wrong(f"{whose} refers to {kind} {str(index)[:40]}, of {count}")
        return index

    def numbers_of(self, kind: str, entry: dict[str, Any], key: str, whose: str) -> list[int]:
        """Return a list of numbers of entries, empty without any."""
        found = entry.get(key, [])
        if not isinstance(found, list):
            raise self.wrong(f"'{key}' of {whose} is not a list")
        return [self.number_of(kind, index, whose) for index in found]

    def whole_number(self, entry: dict[str, Any], key: str, default: int | None, whose: str) -> int:
        """Return a whole number of an entry, 0 or more."""
        found = entry.get(key, default)
        if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found < 1 << 40:
            raise self.wrong(f"'{key}' of {whose} is {str(found)[:40]}, expected a whole number")
        return found


def _read_document(path: str | Path) -> _Document:
    """Read a .glb file, or a .gltf file with its buffers inside or beside it.

    Source: Khronos, glTF 2.0 specification, chapters 3.6 (buffers) and 4.4 (GLB layout).

    Raises:
        UserError: no such file, no glTF 2.0, cut off, or of a kind that is not read.
    """
    path = Path(path)
    try:
        found = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}).") from error
    binary = None
    if found[:4] == b"glTF":
        found, binary = _chunks(path, found)
    elif path.suffix.lower() != ".gltf":
        raise UserError(f"{path}: no glTF binary: it does not begin with 'glTF'. Expected a .glb file.")
    try:
        tree = json.loads(found.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"its JSON cannot be read ({str(error)[:80]})") from error
    document = _Document(path, tree if isinstance(tree, dict) else {}, [])
    _check_kind(document)
    for number, buffer in enumerate(document.listed("buffers")):
        document.buffers.append(_buffer(document, number, buffer, binary))
    return document


def _damaged(path: Path, what: str) -> UserError:
    return UserError(f"{path}: damaged, or not glTF 2.0: {what}. Export it again as a glTF 2.0 binary (.glb).")


def _chunks(path: Path, found: bytes) -> tuple[bytes, bytes | None]:
    if len(found) < 20:
        raise _damaged(path, f"it is cut off after {len(found)} bytes")
    version, length = struct.unpack_from("<II", found, 4)
    if version != 2:
        raise UserError(f"{path}: glTF binary of version {version}, expected 2. Export it again as glTF 2.0.")
    if length > len(found):
        raise _damaged(path, f"it is cut off: {len(found):,} bytes of {length:,}")
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", found, at)
        if at + 8 + size > length:
            raise _damaged(path, f"a chunk of {size:,} bytes ends behind the file's end")
        chunks.setdefault(kind, found[at + 8 : at + 8 + size])
        at += 8 + size + (-size % 4)
    if _JSON not in chunks:
        raise _damaged(path, "it has no JSON chunk")
    return chunks[_JSON], chunks.get(_BINARY)


def _check_kind(document: _Document) -> None:
    asset = document.tree.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if not version.startswith("2"):
        raise UserError(f"{document.path}: glTF version '{version[:20]}', expected 2.0. Export it again as glTF 2.0.")
    required = document.tree.get("extensionsRequired", [])
    for name in required if isinstance(required, list) else []:
        if not str(name).startswith(_HARMLESS):
            raise UserError(
                f"{document.path}: needs the extension '{str(name)[:60]}', which is not read here. "
                "Export it again without compression (Draco, meshopt) and extensions."
            )


def _buffer(document: _Document, number: int, buffer: dict[str, Any], binary: bytes | None) -> bytes:
    whose = f"buffer {number}"
    length = document.whole_number(buffer, "byteLength", None, whose)
    uri = buffer.get("uri")
    if uri is None:
        found = binary if number == 0 and binary is not None else b""
    elif isinstance(uri, str) and uri.startswith("data:"):
        try:
            found = base64.b64decode(uri.partition(",")[2], validate=True)
        except (binascii.Error, ValueError) as error:
            raise document.wrong(f"the data of {whose} is not base64") from error
    else:
        found = _beside(document, str(uri), length)
    if len(found) < length:
        raise document.wrong(f"{whose} has {len(found):,} bytes of {length:,}")
    return found[:length]


def _beside(document: _Document, uri: str, length: int) -> bytes:
    name = Path(unquote(uri))
    if ":" in uri or "\0" in str(name) or name.is_absolute() or ".." in name.parts:
        raise UserError(f"{document.path}: its buffer is at '{uri[:80]}', expected a file beside it.")
    file = document.path.parent / name
    try:
        if not file.is_file():
            raise UserError(f"{document.path}: its buffer {file} is not there. Put it beside the .gltf file.")
        with file.open("rb") as stream:
            return stream.read(length)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: cannot be read ({error}).") from error


# Numbers out of a glTF file's buffers: strides, sparse changes, normalised integers.

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MOST_EMPTY = 5_000_000
"""Rows of an accessor without data of its own, which costs a file nothing to claim."""


def _floats(document: _Document, index: Any, kind: str, whose: str) -> Float[np.ndarray, "rows width"]:
    """Return an accessor's numbers, normalised integers as -1..1 or 0..1. Raises UserError for what is not there."""
    accessor = document.entry("accessors", index, whose)
    found = _rows(document, accessor, f"accessor {index}", kind)
    values = found.astype(np.float64)
    if accessor.get("normalized") is True and found.dtype.kind in "iu":
        values = np.maximum(values / np.iinfo(found.dtype).max, -1.0)
    if not np.isfinite(values).all():
        raise document.wrong(f"{whose} has numbers that are not finite")
    return values


def _wholes(document: _Document, index: Any, kind: str, whose: str) -> Int[np.ndarray, "rows width"]:
    """Return an accessor's whole numbers, 0 or more. Raises UserError for what is not there."""
    found = _rows(document, document.entry("accessors", index, whose), f"accessor {index}", kind)
    if found.dtype.kind != "u":
        raise document.wrong(f"{whose} are not unsigned whole numbers")
    return found.astype(np.int64)


def _rows(document: _Document, accessor: dict[str, Any], name: str, kind: str) -> np.ndarray:
    if accessor.get("type") != kind:
        raise document.wrong(f"{name} is {str(accessor.get('type'))[:20]}, expected {kind}")
    count = document.whole_number(accessor, "count", None, name)
    dtype, width = _component(document, accessor, name), _WIDTHS[kind]
    if "bufferView" in accessor:
        found = _viewed(document, accessor, "byteOffset", dtype, (count, width), name)
    elif count <= _MOST_EMPTY:
        found = np.zeros((count, width), dtype)
    else:
        raise document.wrong(f"{name} claims {count:,} rows and has no data")
    return _changed(document, accessor, found, name) if "sparse" in accessor else found


def _component(document: _Document, entry: dict[str, Any], name: str) -> np.dtype:
    kind = entry.get("componentType")
    if not isinstance(kind, int) or kind not in _COMPONENTS:
        raise document.wrong(f"{name} has the component type {str(kind)[:20]}")
    return np.dtype(_COMPONENTS[kind])


def _viewed(
    document: _Document, entry: dict[str, Any], key: str, dtype: np.dtype, shape: tuple[int, int], name: str
) -> np.ndarray:
    """Return rows of a buffer view, without a copy."""
    view = document.entry("bufferViews", entry.get("bufferView"), name)
    buffer = document.buffers[document.number_of("buffers", view.get("buffer"), f"the view of {name}")]
    start = document.whole_number(view, "byteOffset", 0, f"the view of {name}")
    length = document.whole_number(view, "byteLength", None, f"the view of {name}")
    offset = document.whole_number(entry, key, 0, name)
    size = dtype.itemsize * shape[1]
    stride = document.whole_number(view, "byteStride", size, f"the view of {name}")
    if stride < size:
        raise document.wrong(f"the rows of {name} are {size} bytes and {stride} apart")
    needed = offset + (stride * (shape[0] - 1) + size if shape[0] else 0)
    if start + length > len(buffer) or needed > length:
        raise document.wrong(
            f"{name} needs {start + needed:,} bytes, its buffer has {min(start + length, len(buffer)):,}"
        )
    if not shape[0]:
        return np.zeros(shape, dtype)
    return np.ndarray(shape, dtype, buffer, start + offset, (stride, dtype.itemsize))


def _changed(document: _Document, accessor: dict[str, Any], found: np.ndarray, name: str) -> np.ndarray:
    sparse = accessor["sparse"] if isinstance(accessor["sparse"], dict) else {}
    at, values = sparse.get("indices"), sparse.get("values")
    if not isinstance(at, dict) or not isinstance(values, dict):
        raise document.wrong(f"the sparse changes of {name} are not objects")
    count = document.whole_number(sparse, "count", None, name)
    where = _component(document, at, name)
    rows = _viewed(document, at, "byteOffset", where, (count, 1), name)[:, 0]
    if where.kind != "u" or (rows >= len(found)).any():
        raise document.wrong(f"the sparse changes of {name} are at rows it does not have")
    changed = found.copy()
    changed[rows] = _viewed(document, values, "byteOffset", found.dtype, (count, found.shape[1]), name)
    return changed


# The tree of a glTF file's nodes: who hangs on whom, and where everything is.


@dataclass(frozen=True)
class _Nodes:
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
        found[:, :3, :3] = quaternion_matrix(self.rotation) * self.scale[:, None, :]
        found[:, :3, 3] = self.translation
        found[:, 3, 3] = 1.0
        for node, matrix in self.fixed.items():
            found[node] = matrix
        for node in self.order:
            if self.parents[node] >= 0:
                found[node] = found[self.parents[node]] @ found[node]
        return found


def _read_nodes(document: _Document) -> _Nodes:
    """Return the file's nodes. Raises UserError for a damaged tree, or invalid numbers."""
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
    names = _unique_names([entry.get("name") for entry in entries], "node")
    rotation = _numbers(document, entries, "rotation", (0.0, 0.0, 0.0, 1.0))
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if (length < 1e-6).any():
        raise document.wrong(f"node {int(length.argmin())} has a rotation of length 0")
    matrices = _numbers(document, entries, "matrix", tuple(np.eye(4).ravel())).reshape(-1, 4, 4)
    fixed = {node: matrices[node].T for node, entry in enumerate(entries) if "matrix" in entry}
    return _Nodes(
        names,
        parents,
        order,
        _numbers(document, entries, "translation", (0.0, 0.0, 0.0)),
        rotation / length,
        _numbers(document, entries, "scale", (1.0, 1.0, 1.0)),
        fixed,
    )


def _unique_names(names: list[Any], kind: str) -> list[str]:
    """Return names that differ: ``kind N`` for one without, ``NAME (2)`` for the second of a name."""
    seen: dict[str, int] = {}
    found = []
    for number, name in enumerate(names):
        text = name if isinstance(name, str) and name else f"{kind} {number}"
        seen[text] = seen.get(text, 0) + 1
        found.append(text if seen[text] == 1 else f"{text} ({seen[text]})")
    return found


def _numbers(document: _Document, entries: list[dict[str, Any]], key: str, default: tuple[float, ...]) -> np.ndarray:
    found = np.tile(np.array(default, np.float64), (len(entries), 1))
    for node, entry in enumerate(entries):
        if key in entry:
            value = entry[key]
            fits = isinstance(value, list) and len(value) == len(default)
            if not fits or not all(isinstance(one, int | float) and abs(one) < 1e30 for one in value):
                raise document.wrong(f"'{key}' of node {node} is not {len(default)} numbers")
            found[node] = value
    return found


# A glTF file's animations: what moves, and its value at any moment.

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}


@dataclass(frozen=True)
class _Track:
    """One thing that moves: where a node is, how it is turned, its scale, or the weights of its morph targets."""

    node: int
    path: str
    how: str
    """STEP, LINEAR or CUBICSPLINE."""
    times_s: Float[np.ndarray, " keys"]
    values: Float[np.ndarray, "keys parts width"]
    """One part, or three of CUBICSPLINE: tangent before, value, tangent behind."""

    def at(self, time_s: float) -> Float[np.ndarray, " width"]:
        """Return the value at a moment; before the first and behind the last key it stands (specification, appendix C)."""
        after = int(np.searchsorted(self.times_s, time_s, side="right"))
        middle = self.values.shape[1] // 2
        if after == 0 or after == len(self.times_s):
            found = self.values[min(after, len(self.times_s) - 1), middle]
        elif self.how == "STEP":
            found = self.values[after - 1, 0]
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


def _read_animations(document: _Document, nodes: _Nodes, targets: dict[int, int]) -> dict[str, list[_Track]]:
    """Return the tracks of each animation; ``targets`` counts each node's morph targets. Raises UserError."""
    entries = document.listed("animations")
    names = _unique_names([entry.get("name") for entry in entries], "animation")
    found = {}
    for name, entry in zip(names, entries, strict=True):
        samplers = document.objects(entry, "samplers", f"animation '{name}'")
        tracks = []
        for channel in document.objects(entry, "channels", f"animation '{name}'"):
            target = channel.get("target")
            if isinstance(target, dict) and "node" in target:  # one without is to be passed over
                tracks.append(
                    _track(document, samplers, channel.get("sampler"), target, f"animation '{name}'", targets)
                )
                if tracks[-1].node in nodes.fixed and tracks[-1].path != "weights":
                    raise document.wrong(f"animation '{name}' moves node {tracks[-1].node}, which has a matrix")
        found[name] = tracks
    return found


def _at_moment(nodes: _Nodes, tracks: Sequence[_Track], time_s: float) -> tuple[_Nodes, dict[int, np.ndarray]]:
    """Return the nodes as they are at a moment, and the weights of the morph targets that move."""
    state = {"translation": nodes.translation, "rotation": nodes.rotation, "scale": nodes.scale}
    state = {path: values.copy() for path, values in state.items()}
    weights = {}
    for track in tracks:
        if track.path == "weights":
            weights[track.node] = track.at(time_s)
        else:
            state[track.path][track.node] = track.at(time_s)
    return replace(nodes, **state), weights


def _track(
    document: _Document, samplers: list[dict], index: Any, target: dict, whose: str, targets: dict[int, int]
) -> _Track:
    if not isinstance(index, int) or not 0 <= index < len(samplers):
        raise document.wrong(f"{whose} refers to sampler {str(index)[:40]}, of {len(samplers)}")
    sampler, path = samplers[index], str(target.get("path"))
    node = document.number_of("nodes", target["node"], whose)
    how = sampler.get("interpolation", "LINEAR")
    if how not in ("STEP", "LINEAR", "CUBICSPLINE") or path not in _KINDS:
        raise document.wrong(f"{whose} moves '{path[:20]}' by '{str(how)[:20]}'")
    times = _floats(document, sampler.get("input"), "SCALAR", f"the times of {whose}")[:, 0]
    values = _floats(document, sampler.get("output"), _KINDS[path], f"the values of {whose}")
    if not len(times) or (np.diff(times) <= 0).any() or times[0] < 0:
        raise document.wrong(f"the times of {whose} do not grow")
    parts = 3 if how == "CUBICSPLINE" else 1
    width = targets.get(node, 0) if path == "weights" else values.shape[1]
    if values.size != len(times) * parts * width:
        raise document.wrong(f"{whose} has {values.size} values for {len(times)} moments of '{path}'")
    return _Track(node, path, how, times, values.reshape(len(times), parts, width))


def _spline(start: np.ndarray, end: np.ndarray, share: float, length: float) -> np.ndarray:
    """Return the cubic Hermite spline between two keys (specification, appendix C.5)."""
    square, cube = share**2, share**3
    return (
        (2 * cube - 3 * square + 1) * start[1]
        + length * (cube - 2 * square + share) * start[2]
        + (3 * square - 2 * cube) * end[1]
        + length * (cube - square) * end[0]
    )


# A glTF file's triangles: primitives, morph targets, skins.


@dataclass(frozen=True)
class _Skin:
    """Which nodes carry a skin, and the skin's rest in the frame of each."""

    joints: list[int]
    inverse: Float[np.ndarray, "joints 4 4"]


@dataclass(frozen=True)
class _Primitive:
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


def _read_skins(document: _Document) -> list[_Skin]:
    """Return the file's skins. Raises UserError for joints or matrices that are not there."""
    found = []
    for number, entry in enumerate(document.listed("skins")):
        joints = document.numbers_of("nodes", entry, "joints", f"skin {number}")
        if not joints:
            raise document.wrong(f"skin {number} has no joints")
        inverse = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        if "inverseBindMatrices" in entry:
            inverse = _floats(document, entry["inverseBindMatrices"], "MAT4", f"skin {number}")
            inverse = inverse.reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(inverse) < len(joints):
                raise document.wrong(f"skin {number} has {len(inverse)} matrices for {len(joints)} joints")
        found.append(_Skin(joints, inverse[: len(joints)]))
    return found


def _read_meshes_of(document: _Document) -> list[list[_Primitive]]:
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


def _primitive(document: _Document, entry: dict[str, Any], whose: str) -> _Primitive:
    attributes = entry.get("attributes")
    if not isinstance(attributes, dict):
        raise document.wrong(f"{whose} has triangles without attributes")
    vertices = _floats(document, attributes.get("POSITION"), "VEC3", f"'POSITION' of {whose}")
    faces = _faces(document, entry, len(vertices), whose)
    joints, weights = _influences(document, attributes, len(vertices), whose)
    targets = np.zeros((0, len(vertices), 3))
    if "targets" in entry:
        moves = [
            _floats(document, target["POSITION"], "VEC3", f"a morph target of {whose}")
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
    return _Primitive(vertices[used], faces.reshape(-1, 3), joints, weights, targets[:, used])


def _faces(document: _Document, entry: dict[str, Any], vertices: int, whose: str) -> Int[np.ndarray, "faces 3"]:
    corners = np.arange(vertices)
    if "indices" in entry:
        corners = _wholes(document, entry["indices"], "SCALAR", f"the indices of {whose}")[:, 0]
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
) -> tuple[np.ndarray | None, np.ndarray | None]:
    joints, weights = [], []
    while f"JOINTS_{len(joints)}" in attributes:
        number = len(joints)
        joints.append(_wholes(document, attributes[f"JOINTS_{number}"], "VEC4", f"'JOINTS_{number}' of {whose}"))
        name = f"WEIGHTS_{number}"
        weights.append(_floats(document, attributes.get(name), "VEC4", f"'{name}' of {whose}"))
        if len(joints[-1]) != vertices or len(weights[-1]) != vertices:
            raise document.wrong(f"'{name}' of {whose} has not {vertices} rows")
    if not joints:
        return None, None
    every, weight = np.concatenate(joints, 1), np.concatenate(weights, 1).clip(0)
    total = weight.sum(1, keepdims=True)
    weight[total[:, 0] < 1e-9, 0] = 1.0  # on nothing: on its first joint
    return every, weight / np.maximum(weight.sum(1, keepdims=True), 1e-9)


# glTF 2.0 files: the surface of what is in them at any moment of their animations.

_TO_OWN = np.array([1.0, -1.0, -1.0])
"""glTF has y up and the front at +z: half a turn about x makes it y down and the front at -z."""
_MOST_VERTICES = 20_000_000


@dataclass(frozen=True)
class _Part:
    """A mesh that a node shows."""

    node: int
    primitives: Sequence[_Primitive]
    skin: _Skin | None
    morph: Float[np.ndarray, " targets"]


class GltfFile:
    """One glTF 2.0 file, checked and decoded: what was read can be posed at any moment.

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

        Source: Khronos, glTF 2.0 specification. Materials, cameras and lights are passed over.

        Raises:
            UserError: no glTF 2.0, damaged, compressed, or without a triangle.
        """
        document = _read_document(path)
        nodes = _read_nodes(document)
        parts = _parts(document, nodes)
        if not sum(len(primitive.faces) for part in parts for primitive in part.primitives):
            raise UserError(f"{path}: no triangles in its scene. Expected a file with at least one mesh.")
        targets = {part.node: len(part.morph) for part in parts}
        return cls(Path(path), nodes, parts, _read_animations(document, nodes, targets))

    def posed(self, animation: str | None = None, time_s: float = 0.0) -> Mesh:
        """Return the surface at a moment of an animation, or as the file has it at rest.

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

    def _moment(self, animation: str | None, time_s: float) -> tuple[_Nodes, dict[int, np.ndarray]]:
        if animation is None:
            return self._nodes, {}
        if animation not in self._tracks:
            hint = did_you_mean(animation, self._tracks) or " It has none."
            raise UserError(f"{self.path}: no animation '{animation}'.{hint}")
        return _at_moment(self._nodes, self._tracks[animation], time_s)


def _parts(document: _Document, nodes: _Nodes) -> list[_Part]:
    meshes, skins = _read_meshes_of(document), _read_skins(document)
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


def _shown(document: _Document, nodes: _Nodes) -> set[int]:
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


def _morph(document: _Document, node: dict[str, Any], number: int, primitives: list[_Primitive]) -> np.ndarray:
    count = len(primitives[0].targets) if primitives else 0
    weights = node.get("weights", document.listed("meshes")[number].get("weights", [0.0] * count))
    if not count:
        return np.zeros(0)
    weights = weights if isinstance(weights, list) else []
    if len(weights) != count or not all(isinstance(one, int | float) and abs(one) < 1e30 for one in weights):
        raise document.wrong(f"mesh {number} has not {count} weights of its morph targets")
    return np.array(weights, np.float64)
