"""A glTF 2.0 file taken apart: its JSON, its buffers, and looking things up in them."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from uplift.errors import UserError

__all__ = ["Document", "read_document"]

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
# What may be required and changes nothing in the geometry read here, or is read (quantised numbers).
_HARMLESS = ("KHR_mesh_quantization", "KHR_texture_", "KHR_materials_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")


@dataclass
class Document:
    """The JSON of one file and the bytes of its buffers."""

    path: Path
    tree: dict[str, Any]
    buffers: list[bytes]

    def wrong(self, what: str) -> UserError:
        """Return the error that says what is wrong with the file."""
        return _damaged(self.path, what)

    def listed(self, kind: str) -> list[dict[str, Any]]:
        """Return the file's nodes, meshes, accessors, ...: a list of objects, empty where there is none."""
        return self.objects(self.tree, kind, "the file")

    def objects(self, entry: dict[str, Any], key: str, whose: str) -> list[dict[str, Any]]:
        """Return a list of objects of an entry, empty where there is none."""
        found = entry.get(key, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.wrong(f"'{key}' of {whose} is no list of objects")
        return found

    def entry(self, kind: str, index: Any, whose: str) -> dict[str, Any]:
        """Return one of the file's nodes, meshes, accessors, ... by its number."""
        every = self.tree.get(kind, [])
        if not isinstance(every, list):
            raise self.wrong(f"'{kind}' of the file is no list of objects")
        found = every[self.number_of(kind, index, whose)]
        if not isinstance(found, dict):
            raise self.wrong(f"{kind} {index} is no object")
        return found

    def number_of(self, kind: str, index: Any, whose: str) -> int:
        """Return ``index`` where the file has such an entry."""
        count = len(self.tree.get(kind, []))
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
            raise self.wrong(f"{whose} refers to {kind} {str(index)[:40]}, of {count}")
        return index

    def numbers_of(self, kind: str, entry: dict[str, Any], key: str, whose: str) -> list[int]:
        """Return a list of numbers of entries, empty where there is none."""
        found = entry.get(key, [])
        if not isinstance(found, list):
            raise self.wrong(f"'{key}' of {whose} is no list")
        return [self.number_of(kind, index, whose) for index in found]

    def whole(self, entry: dict[str, Any], key: str, default: int | None, whose: str) -> int:
        """Return a whole number of an entry, 0 or more."""
        found = entry.get(key, default)
        if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found < 1 << 40:
            raise self.wrong(f"'{key}' of {whose} is {str(found)[:40]}, expected a whole number")
        return found


def read_document(path: str | Path) -> Document:
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
    document = Document(path, tree if isinstance(tree, dict) else {}, [])
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


def _check_kind(document: Document) -> None:
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


def _buffer(document: Document, number: int, buffer: dict[str, Any], binary: bytes | None) -> bytes:
    whose = f"buffer {number}"
    length = document.whole(buffer, "byteLength", None, whose)
    uri = buffer.get("uri")
    if uri is None:
        found = binary if number == 0 and binary is not None else b""
    elif isinstance(uri, str) and uri.startswith("data:"):
        try:
            found = base64.b64decode(uri.partition(",")[2], validate=True)
        except (binascii.Error, ValueError) as error:
            raise document.wrong(f"the data of {whose} is no base64") from error
    else:
        found = _beside(document, str(uri), length)
    if len(found) < length:
        raise document.wrong(f"{whose} has {len(found):,} bytes of {length:,}")
    return found[:length]


def _beside(document: Document, uri: str, length: int) -> bytes:
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
