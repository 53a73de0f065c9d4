"""Mesh files and folders of them as meshes in their own frame, animated ones in several poses."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import refuse_special
from uplift.data.parsers.files import read_bytes, reason_of
from uplift.data.parsers.gltf import GltfFile
from uplift.errors import UserError, did_you_mean
from uplift.geometry.mesh import Mesh

__all__ = ["ENDINGS", "MeshOptions", "axes_to_own", "find_mesh_files", "read_meshes"]

ENDINGS = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Files of meshes that are read."""
_AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}
_FRONTS = {"y": "z", "-y": "z", "z": "-y", "-z": "-y"}
_SPLITS = ("train", "test", "val", "validation")
_LONGEST_LINE = 100_000
"""Characters of a line of text: a face of ten thousand corners has no more."""
_FLAT = 1e-5
"""Thickness of a shape, as a share of its size, that counts as flat."""
_MERGED = 1e-6
"""Share of a mesh's size within which two of its vertices are one: files split them at every edge and colour."""


@dataclass(frozen=True)
class MeshOptions:
    """How files of meshes are understood."""

    up: str = "y"
    """The file's axis that points up: x, y, z, -x, -y or -z."""
    front: str | None = None
    """The file's axis the object looks along; None: z where y is up (glTF's convention), -y where z is (Blender's)."""
    poses: int = 20
    """Moments drawn from each animated file's animations; 0: the pose it has at rest."""
    animations: tuple[str, ...] = ()
    """Parts of the names of those that poses are drawn from, with a minus of those that they are not; empty: all."""
    seed: int = 0
    category: str | None = None
    """Of all meshes; None: the outermost folder below the given one that is not called train, test, val or validation,
    else the file's own name without a number at its end."""
    most: int | None = None
    """Files that are read, drawn at random; None: all."""


def read_meshes(sources: str | Path | Sequence[str | Path], options: MeshOptions | None = None) -> list[Mesh]:
    """Return the meshes of files and folders in their own frame (x left, y down, z behind), in the file's unit.

    A file gives one mesh, all its parts together; a .glb or .gltf file with animations one for each pose.

    Raises:
        UserError: no files, an unknown kind, a damaged file, no triangles, a flat shape, invalid axes.
    """
    options = options or MeshOptions()
    rotation = axes_to_own(options.up, options.front)
    files = find_mesh_files(sources)
    if options.most is not None and len(files) > options.most:
        chosen = np.random.default_rng(options.seed).choice(len(files), options.most, replace=False)
        files = [files[row] for row in sorted(chosen)]
    found = []
    for path, category in files:
        for mesh in _posed(path, options) if path.suffix.lower() in (".glb", ".gltf") else [_static(path)]:
            vertices, faces = _cleaned(path, mesh.vertices @ rotation.T, mesh.faces)
            found.append(Mesh(vertices, faces, mesh.name, options.category or category))
    return found


def find_mesh_files(sources: str | Path | Sequence[str | Path]) -> list[tuple[Path, str]]:
    """Return the mesh files of files and folders, sorted, and the category of each. Raises UserError for none."""
    given = [sources] if isinstance(sources, str | Path) else list(sources)
    found: dict[Path, str] = {}
    for source in given:
        path = Path(source).expanduser()
        refuse_special(path)
        if path.is_dir():
            files = [file for file in sorted(path.rglob("*")) if _is_mesh(file, path)]
            if not files:
                raise UserError(f"{path}: no mesh files in this folder. Expected {', '.join(ENDINGS)}.")
            for file in files:
                found.setdefault(file, _category(file.relative_to(path)))
        elif not path.exists():
            raise UserError(f"{path}: no such file or folder. Expected mesh files ({', '.join(ENDINGS)}) or folders.")
        elif path.suffix.lower() not in ENDINGS:
            export = "Export others as .glb, from Blender with File > Export > glTF 2.0."
            raise UserError(f"{path}: files of meshes end in {', '.join(ENDINGS)}. {export}")
        else:
            found.setdefault(path, _category(Path(path.name)))
    if not found:
        raise UserError(f"no meshes given. Expected files ({', '.join(ENDINGS)}) or folders of them.")
    return list(found.items())


def _category(file: Path) -> str:
    """Return the outermost folder that is no split of a data set, else the file's name without its number, `chair_0012`."""
    folders = [name for name in file.parts[:-1] if name.casefold() not in _SPLITS]
    return folders[0] if folders else re.sub(r"_\d+$", "", file.stem) or file.stem


def axes_to_own(up: str, front: str | None = None) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from a file's axes to a shape's own frame. Raises UserError for invalid axes."""
    front = _FRONTS.get(up, "z") if front is None else front
    for key, value in (("up", up), ("front", front)):
        if value not in _AXES:
            raise UserError(f"{key}={value}: expected one of {', '.join(_AXES)}: an axis of the mesh files.")
    if up[-1] == front[-1]:
        raise UserError(f"up={up} and front={front} are one axis. Expected two, such as up=z front=-y.")
    above, ahead = np.array(_AXES[up], float), np.array(_AXES[front], float)
    return np.stack([np.cross(above, ahead), -above, -ahead])


def _is_mesh(file: Path, folder: Path) -> bool:
    hidden = any(part.startswith(".") for part in file.relative_to(folder).parts)
    return file.suffix.lower() in ENDINGS and not hidden and file.is_file()


def _posed(path: Path, options: MeshOptions) -> list[Mesh]:
    """Return one mesh for each of some moments, in glTF's axes."""
    file = GltfFile.read(path)
    moving = [name for name, length in file.animations.items() if length > 0]
    if not moving or not options.poses:
        return [_in_file_axes(file.posed(), path.stem)]
    names = [name for name in moving if _taken(name, options.animations)]
    if not names:
        given = f"animations={','.join(options.animations)}"
        raise UserError(f"{path}: {given} leaves none of its animations.{did_you_mean('', moving)}")
    random = np.random.default_rng([options.seed, zlib.crc32(path.name.encode())])
    # All animations have the same number of poses, or one more.
    order = np.concatenate([random.permutation(len(names)) for _ in range(-(-options.poses // len(names)))])
    found = []
    for number in order[: options.poses]:
        time_s = float(random.uniform(0, file.animations[names[number]]))
        short = re.split(r"[|/\\:]", names[number])[-1]
        found.append(_in_file_axes(file.posed(names[number], time_s), f"{path.stem} {short} {time_s:.2f}s"))
    return found


def _taken(name: str, parts: tuple[str, ...]) -> bool:
    wanted = [part.casefold() for part in parts if not part.startswith("-")]
    refused = [part[1:].casefold() for part in parts if part.startswith("-")]
    name = name.casefold()
    return (not wanted or any(part in name for part in wanted)) and not any(part in name for part in refused)


def _in_file_axes(mesh: Mesh, name: str) -> Mesh:
    return Mesh(mesh.vertices * [1.0, -1.0, -1.0], mesh.faces, name)


def _static(path: Path) -> Mesh:
    """Return one file's triangles in its own axes, read by trimesh, without materials: no other file is opened."""
    import trimesh

    content = read_bytes(path)
    kind = path.suffix.lower()[1:]
    longest = max(map(len, content.split(b"\n"))) if kind in ("obj", "off") else 0
    if longest > _LONGEST_LINE:
        raise UserError(f"{path}: a line of {longest:,} characters. Expected faces of a few corners: triangulate it.")
    try:
        found = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False, skip_materials=True)
        vertices, faces = np.asarray(found.vertices, np.float64), np.asarray(getattr(found, "faces", []))
    except Exception as error:  # a foreign file can break its parser in any way
        reason = "" if isinstance(error, ImportError) else f" ({reason_of(error)})"
        raise UserError(f"{path}: damaged, or not a .{kind} file{reason}. Export it again.") from error
    if vertices.size and (vertices.ndim != 2 or vertices.shape[1] != 3):
        raise UserError(f"{path}: its vertices have {vertices.shape[-1]} numbers each, expected 3. Export it again.")
    if not vertices.size or not faces.size:
        raise UserError(f"{path}: no triangles in it. Expected a mesh, not points, lines or text.")
    return Mesh(vertices.reshape(-1, 3), faces.astype(np.int64).reshape(-1, 3), path.stem)


def _is_flat(spread: np.ndarray) -> bool:
    """Return whether the least of three variances is nothing beside the largest."""
    return bool(spread[0] <= _FLAT**2 * spread[-1])


def _cleaned(path: Path, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces without duplicates, faces without area and unused vertices."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise UserError(f"{path}: a face refers to a vertex of {len(vertices):,} that does not exist. Export it again.")
    used, corners = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], corners.reshape(-1, 3)
    if not np.isfinite(vertices).all():
        count = int((~np.isfinite(vertices)).any(1).sum())
        raise UserError(f"{path}: {count:,} of {len(vertices):,} vertices are not finite. Export it again.")
    size = float(np.ptp(vertices, axis=0).max())
    corners = vertices / max(size, 1e-300)
    if not np.isfinite(size) or len(corners) < 4 or _is_flat(np.linalg.eigvalsh(np.cov(corners.T))):
        raise UserError(f"{path}: flat, or without a size (its longest side is {size:.4g}). Expected a solid shape.")
    steps = np.round((vertices - vertices.min(0)) / (_MERGED * size)).astype(np.int64)
    _, first, twin = np.unique(steps, axis=0, return_index=True, return_inverse=True)
    faces = twin.reshape(-1)[faces]
    solid = (faces != np.roll(faces, 1, axis=1)).all(1)
    if not solid.any():
        raise UserError(f"{path}: none of its faces has an area. Expected a solid shape.")
    return vertices[first], faces[solid]
