"""Masks and what is known beside them as one npz file, without pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import names_from, replacing, without_folders
from uplift.data.clean_masks import MaskOptions
from uplift.data.concat import concat_masks, resized
from uplift.data.formats.base import FileFormat, Peek
from uplift.data.formats.masks import shuffled, wanted
from uplift.data.masks import MaskData, Placed
from uplift.data.parsers.npz import CheckedArrays, read_arrays
from uplift.data.parsers.pictures import Photos
from uplift.errors import UserError, listed
from uplift.geometry.mesh import Mesh

__all__ = ["FORMAT", "arrays_of", "chosen", "masks_of_arrays", "read_masks_npz", "write_masks_npz"]

_PLACED = ("shape", "view", "scale", "offset", "distance")
_MESHES = ("mesh_vertices", "mesh_vertex_start", "mesh_faces", "mesh_face_start", "mesh_names", "mesh_category")
_KNOWN = {
    "masks", "names", "centre_px", "scale_px", "category", "images", "labelled", "notes", "source", *_PLACED, *_MESHES,
}  # fmt: skip
_OLDEST = (1980, 1, 1, 0, 0, 0)
_TURN_ERROR = 1e-3


def write_masks_npz(data: MaskData, path: str | Path) -> None:
    """Write masks, names, crops, labels and the truth; the same data gives the same bytes.

    Photos are named from the folder of the file, and the source without its folders: files are passed on.
    """
    images = None if data.images is None else np.array(names_from(Path(path).parent, data.images.tolist()))
    notes = tuple(map(without_folders, data.notes))
    data = replace(data, images=images, notes=notes, source=without_folders(data.source))
    with replacing(path) as handle, zipfile.ZipFile(handle, "w") as archive:
        for name, array in arrays_of(data).items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_OLDEST)
            # Masks are mostly 0 and 255 and shrink tenfold; vertices and rotations hardly at all.
            entry.compress_type = zipfile.ZIP_STORED if array.dtype.kind == "f" else zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)


def arrays_of(data: MaskData) -> dict[str, np.ndarray]:
    """Return the arrays of masks by their names in the file.

    Meshes stand one behind the other: ``mesh_vertex_start`` (meshes + 1) says where each begins, and
    ``mesh_faces`` count from there. `MaskData.extra` is left out.
    """
    arrays = {
        "masks": data.masks,
        "names": np.asarray(data.names, np.str_),
        "centre_px": np.asarray(data.centre_px, np.float32),
        "scale_px": np.asarray(data.scale_px, np.float32),
        "notes": np.asarray(data.notes, np.str_),
        "source": np.asarray(data.source, np.str_),
    }
    for name, kind in (("category", np.str_), ("images", np.str_), ("labelled", np.bool_)):
        if getattr(data, name) is not None:
            arrays[name] = np.asarray(getattr(data, name), kind)
    if data.truth is not None:
        arrays |= _truth_arrays(data.truth)
    return arrays


def _truth_arrays(truth: Placed) -> dict[str, np.ndarray]:
    meshes = truth.meshes
    arrays = {name: np.asarray(getattr(truth, name), np.float32) for name in _PLACED if name != "shape"}
    return arrays | {
        "shape": np.asarray(truth.shape, np.int64),
        "mesh_vertices": np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32),
        "mesh_vertex_start": np.cumsum([0] + [len(mesh.vertices) for mesh in meshes]),
        "mesh_faces": np.concatenate([mesh.faces for mesh in meshes]).astype(np.int32),
        "mesh_face_start": np.cumsum([0] + [len(mesh.faces) for mesh in meshes]),
        "mesh_names": np.asarray([mesh.name for mesh in meshes], np.str_),
        "mesh_category": np.asarray([mesh.category for mesh in meshes], np.str_),
    }


def read_masks_npz(path: str | Path, photos: Photos | None = None) -> MaskData:
    """Read masks written by `write_masks_npz`, or by hand in the same layout; only ``masks`` must be there.

    Their photos are those of ``photos``, by default those in the file's folder.

    Raises:
        UserError: missing or unknown arrays, wrong kinds, shapes or ranges, invalid meshes.
    """
    found = masks_of_arrays(str(path), read_arrays(path, _KNOWN, others=False), Path(path).stem)
    return with_photos(found, photos or Photos(None), Path(path))


def with_photos(data: MaskData, photos: Photos, file: Path) -> MaskData:
    """Return masks with the paths of the photos that ``file`` names, and of masks that name none those named as they are."""
    named = [""] * len(data) if data.images is None else data.images.tolist()
    if data.images is None and photos.folder is None:
        return data
    pairs = zip(named, data.names, strict=True)
    return replace(
        data, images=np.array([photos.of_name(one, file) if one else photos.of_mask(own) for one, own in pairs])
    )


def masks_of_arrays(where: str, arrays: dict[str, np.ndarray], name: str) -> MaskData:
    """Return the `MaskData` of arrays of that layout; ``where`` they are from, for messages, and what masks without names are named after.

    Raises:
        UserError: no array ``masks``, wrong kinds, shapes or ranges, invalid meshes.
    """
    file = CheckedArrays(where, arrays)
    if "masks" not in arrays:
        found = listed(sorted(arrays)) or "nothing"
        raise UserError(
            f"{where}: no array 'masks' (found: {found}). Expected uint8 masks (items, side, side), 0..255."
        )
    masks = arrays["masks"]
    if masks.dtype != np.uint8 or masks.ndim != 3 or masks.shape[1] != masks.shape[2] or not masks.size:
        raise UserError(
            f"{where}: 'masks' is {masks.dtype} of shape {masks.shape}, expected uint8 (items, side, side)."
        )
    items, side = masks.shape[:2]
    names, notes = file.text("names", items), file.text("notes", None)
    centre, scale = file.numbers("centre_px", (items, 2)), file.numbers("scale_px", (items,), above=0)
    return MaskData(
        masks=masks,
        names=[f"{name}:{item}" for item in range(items)] if names is None else names.tolist(),
        centre_px=np.full((items, 2), side / 2, np.float32) if centre is None else centre,
        scale_px=np.full(items, side / 2, np.float32) if scale is None else scale,
        category=file.text("category", items),
        images=file.text("images", items),
        labelled=file.flags("labelled", items),
        truth=_truth(file, items),
        notes=() if notes is None else tuple(notes.tolist()),
        source=where,
    )


def _truth(file: CheckedArrays, items: int) -> Placed | None:
    wanted = (*_PLACED, *_MESHES)
    missing = [name for name in wanted if name not in file.arrays]
    if len(missing) == len(wanted):
        return None
    if missing:
        raise UserError(f"{file.where}: the truth lacks '{missing[0]}': either all of {', '.join(wanted)}, or none.")
    meshes = _meshes(file)
    view = file.numbers("view", (items, 3, 3))
    assert view is not None
    error = np.abs(view @ view.transpose(0, 2, 1) - np.eye(3)).max((1, 2)) + (np.linalg.det(view) < 0)
    if (error > _TURN_ERROR).any():
        raise UserError(f"{file.where}: 'view' of item {int(error.argmax())} is not a rotation.")
    parts = {
        "shape": file.indices("shape", (items,), len(meshes)),
        "scale": file.numbers("scale", (items,), above=0),
        "offset": file.numbers("offset", (items, 2)),
        "distance": file.numbers("distance", (items,), above=0, infinite=True),
    }
    return Placed(meshes, view=view, **parts)  # pyright: ignore[reportArgumentType] (none is missing)


def _meshes(file: CheckedArrays) -> Sequence[Mesh]:
    vertices: Any = file.numbers("mesh_vertices", (None, 3))
    vertex_start: Any = file.starts("mesh_vertex_start", len(vertices))
    faces: Any = file.indices("mesh_faces", (None, 3), max(len(vertices), 1))
    face_start: Any = file.starts("mesh_face_start", len(faces))
    count = len(vertex_start) - 1
    names: Any = file.text("mesh_names", count)
    category: Any = file.text("mesh_category", count)
    if len(face_start) != count + 1:
        raise UserError(f"{file.where}: 'mesh_face_start' has {len(face_start) - 1} meshes, expected {count}.")
    found = []
    for number in range(count):
        corners_of = faces[face_start[number] : face_start[number + 1]]
        corners = vertices[vertex_start[number] : vertex_start[number + 1]].astype(np.float64)
        if corners_of.max() >= len(corners):
            raise UserError(
                f"{file.where}: 'mesh_faces' of mesh {number} goes up to {corners_of.max()}, it has {len(corners)} vertices."
            )
        found.append(Mesh(corners, corners_of, str(names[number]), str(category[number])))
    return found


# Read the file as a format: categories, number of masks and side as they are asked for.


def _read(peek: Peek, options: MaskOptions) -> MaskData:
    photos = Photos(options.images)
    return chosen(concat_masks([read_masks_npz(path, photos) for path in peek.paths]), options, peek.where, photos)


def chosen(data: MaskData, options: MaskOptions, where: str, photos: Photos) -> MaskData:
    """Return the masks, already cut out, that ``options`` ask for, at their side, with the notes of ``photos``.

    Raises:
        UserError: no mask, or a category that is not there.
    """
    notes = photos.notes()
    if options.category:
        names = np.full(len(data), "") if data.category is None else data.category
        taken = wanted(options, set(names.tolist()), where)
        data = data.select(np.isin(names, list(taken)))
    if options.most is not None and options.most < len(data):
        rows = sorted(place for place, _ in shuffled(list(range(len(data))), options)[: options.most])
        notes.append(f"{options.most:,} of {len(data):,} masks are taken (most={options.most})")
        data = data.select(np.array(rows))
    if len(data) == 0:
        raise UserError(f"{where} has no masks.")
    if data.side != options.side:
        notes.append(f"crops of {data.side} px are resampled to {options.side} px")
        data = resized(data, options.side)
    return replace(data, notes=(*data.notes, *notes))


FORMAT = FileFormat("npz", "uplift's own npz of masks", lambda peek: "masks" in peek.npz_names, _read)
