"""Shapes as files: binary glTF, Wavefront OBJ, Stanford PLY, STL, npz, in the axes and unit asked for."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, names_from, refuse_existing, replacing
from uplift.config.progress import progress
from uplift.errors import UserError, did_you_mean
from uplift.export.clips import MOST_FILES
from uplift.export.html import Photos
from uplift.export.scene import FROM_LEVEL
from uplift.export.texture import photo_of, textured
from uplift.geometry.mesh import Mesh
from uplift.geometry.surface import Surface, surface_of
from uplift.models.prediction import ShapePrediction

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image
    from trimesh.visual.material import PBRMaterial

    from uplift.export import Job, Writer

__all__ = [
    "NO_COLOURS", "SHAPE_AXES", "Frame", "encode_glb", "encode_obj", "encode_ply", "encode_stl", "in_camera", "prediction_surfaces",
    "shape_jobs", "surfaces", "write_npz",
]  # fmt: skip

# Shapes: a file for all items, for a scene of a few, or for each item that has a surface.

_MOST_TOGETHER = 16  # items that one scene shows side by side by default
_UNITS = ("px", "mm", "crop")


def shape_jobs(
    prediction: ShapePrediction,
    writer: Writer,
    path: str | Path,
    axes: str | None,
    *,
    unit: str | None = None,
    height_mm: float | int | None = None,
    length_mm: float | int | None = None,
    smooth: int = 4,
    together: bool | None = None,
    texture: bool | None = None,
    images: str | Path | None = None,
    **options: Any,
) -> list[Job]:
    """Return the files of shapes, each with what writes it; the options are those of `uplift.export.write`."""
    frame = _frame(writer, path, axes, unit, {"height_mm": height_mm, "length_mm": length_mm})
    if writer.holds == "all":
        options |= {} if images is None else {"images": images}

        def write_all(file: Path) -> str:
            refuse_existing(file)
            return str(writer(prediction, file, **options) or "")

        return [("", write_all)]
    if options:
        raise UserError(f"{next(iter(options))}= is for a page (.html), not for {Path(path).suffix}.")
    cut = prediction_surfaces(prediction, smooth=smooth)
    parts = _parts(cut, writer.holds, together)
    gone = [f"{name} ({one.reason})" for name, one in zip(prediction.names, cut, strict=True) if one.mesh is None]
    more = f" and {len(gone) - 3} more" if len(gone) > 3 else ""
    left_out = f"without a surface: {', '.join(gone[:3])}{more}" if gone else ""
    ending = Path(path).suffix.lower()
    photos = _photos(prediction, ending, texture, images)

    def job(part: list[int], file: Path) -> str:
        refuse_existing(file)
        shown, wrong = _on_shapes(prediction, part, photos, texture)
        solids = [
            _solid(frame, mesh, prediction, item, photo, ending)
            for item, photo in zip(part, shown, strict=True)
            if (mesh := cut[item].mesh) is not None
        ]
        data = writer(solids, frame.about(prediction, part))
        with replacing(file) as handle:
            handle.write(data)
        cleaned = [cut[item].summary() for item in part]
        if len(part) > 1:
            cleaned = [f"{number}: {remark}" for number, remark in enumerate(cleaned, 1) if remark]
        return "; ".join(filter(None, [*cleaned, wrong, left_out if part is parts[0] else ""]))

    return [(prediction.names[part[0]], partial(job, part)) for part in parts]


NO_COLOURS = "a .stl has no colours: write a .glb, .obj or .ply to have the photo on the shape."
_PHOTO_SIDE = 512  # pixels of a photo's crop, in a texture


def _photos(prediction: ShapePrediction, ending: str, texture: bool | None, images: str | Path | None) -> Photos | None:
    """Return the photos that go on the shapes, None for none.

    Raises UserError where photos are asked for that the format cannot hold, or that nobody names.
    """
    if ending == ".stl" and (texture or images is not None):
        raise UserError(NO_COLOURS)
    if texture and prediction.images is None:
        raise UserError(
            "texture=true needs photos, and the masks name none. See images= of predict in docs/masks-input.md."
        )
    return None if texture is False or ending == ".stl" or prediction.images is None else Photos(images)


def _on_shapes(
    prediction: ShapePrediction, items: Sequence[int], photos: Photos | None, texture: bool | None
) -> tuple[list[Image | None], str]:
    """Return the photo of each item, None where there is none, and which could not be read."""
    if photos is None:
        return [None] * len(items), ""
    known = len(photos.unreadable)
    found = [photo_of(prediction, item, photos, _PHOTO_SIDE) for item in items]
    wrong = photos.unreadable[known:]
    if texture and None in found:
        absent = wrong[0] if wrong else str((photos.absent or [""])[-1]) or "that of " + prediction.names[items[0]]
        raise UserError(f"texture=true needs a photo for each shape, and one was not found or read: {absent}.")
    return found, f"without photos that could not be read: {', '.join(wrong)}" if wrong else ""


def _solid(
    frame: Frame, mesh: Mesh, prediction: ShapePrediction, item: int, photo: Image | None, ending: str
) -> trimesh.Trimesh:
    """Return an item's mesh in the file's frame, with its photo as a texture in a .glb, else as the colours of its corners."""
    import trimesh
    from trimesh.visual import ColorVisuals
    from trimesh.visual.texture import TextureVisuals

    points = frame.placed(mesh, prediction, item)
    solid = trimesh.Trimesh(points, mesh.faces, process=False)
    if photo is None:
        return solid
    look = textured(mesh, photo, prediction, item)
    if ending != ".glb":
        solid.visual = ColorVisuals(solid, vertex_colors=look.colours())
        return solid
    normals = solid.vertex_normals[look.corner]  # those of the mesh without seams: none is to be seen
    split = trimesh.Trimesh(points[look.corner], look.mesh.faces, vertex_normals=normals, process=False)
    split.visual = TextureVisuals(look.place * [1, -1] + [0, 1], _material(look.jpeg()))
    return split


def _material(picture: Image | None = None) -> PBRMaterial:
    from trimesh.visual.material import PBRMaterial

    factor = _COLOUR if picture is None else None
    return PBRMaterial(
        "shape", baseColorFactor=factor, baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=0.75
    )


def _kind(solid: trimesh.Trimesh) -> str | None:
    return None if solid.visual is None else solid.visual.kind


def _frame(
    writer: Writer, path: str | Path, axes: str | None, unit: str | None, sizes: Mapping[str, float | int | None]
) -> Frame:
    """Return the axes and unit asked for; raises UserError for invalid ones."""
    given = {name: float(value) for name, value in sizes.items() if value is not None}
    asked = [name for name, value in {"axes": axes, "unit": unit, **given}.items() if value is not None]
    if writer.holds == "all" and asked:
        raise UserError(f"{asked[0]}= goes with the formats of meshes (.glb .obj .ply .stl), not with {path}.")
    for name, value in given.items():
        if not (np.isfinite(value) and value > 0):
            raise UserError(f"{name}={value:g}: expected how large each object is, more than 0 mm.")
    if len(given) > 1:
        raise UserError("height_mm= and length_mm= both say how large an object is: give one.")
    if unit is not None and unit not in _UNITS:
        raise UserError(f"unit={unit}: no such unit.{did_you_mean(unit, _UNITS)}")
    if unit == "mm" and not given:
        raise UserError("unit=mm: a mask does not tell how large its object is. Add height_mm= or length_mm=.")
    if given and unit not in (None, "mm"):
        raise UserError(f"unit={unit} and {next(iter(given))}= do not go together: a size makes the unit mm.")
    axes = axes or writer.axes
    if axes not in SHAPE_AXES:
        raise UserError(f"axes={axes}: no such axes of shapes.{did_you_mean(axes, SHAPE_AXES)}")
    return Frame(axes, "mm" if given else unit or "px", **given)


def _parts(cut: Sequence[Surface], holds: str, together: bool | None) -> list[list[int]]:
    """Return which items go into each file; raises UserError for no surface at all, or too many files."""
    there = [item for item, one in enumerate(cut) if one.mesh is not None]
    if not there:
        why = cut[0].reason if cut else "the prediction has no items"
        raise UserError(f"there is no surface to write: {why}. Nothing was lifted, or level= is too high.")
    if together and holds != "scene":
        raise UserError("together=true puts several shapes into one .glb; other formats hold one each.")
    if holds == "scene" and (together or (together is None and len(there) <= _MOST_TOGETHER)):
        return [there]
    if len(there) > MOST_FILES:
        raise UserError(
            f"{len(there):,} shapes would be as many files; the most is {MOST_FILES}. Give fewer masks at a time, "
            "write a .glb with together=true, or .npz."
        )
    return [[item] for item in there]


# Axes and unit.

_OWN = {
    "own": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "gltf": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "print": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}
"""Rotations from the shape's own frame."""
SHAPE_AXES = {
    "own": "x the object's left, y down, z behind it",
    "gltf": "y up, the object faces +z, x is its left",
    "print": "z up, the object faces -y, x is its left",
    "camera": "x right in the image, y down, z away from the camera",
    "opencv": "another name of camera: x right in the image, y down, z away from the camera",
    "level": "as seen, y is gravity: x right, y down, z away, level",
    "blender": "as seen, z up: x right, y away from the camera, level",
    "opensim": "as seen, y up: x right, z towards the camera, level",
}
"""Names of axes and what they mean; all are right-handed, so left stays left."""


@dataclass(frozen=True)
class Frame:
    """Axes and unit of files of one prediction."""

    axes: str
    unit: str = "px"
    height_mm: float | None = None
    """Of every object, along its y."""
    length_mm: float | None = None
    """The longest side of every object's box in its own axes."""

    def placed(self, mesh: Mesh, prediction: ShapePrediction, item: int) -> Float[np.ndarray, "points 3"]:
        """Return the corners of a mesh of the shape's frame in these axes and this unit.

        The origin of ``own``, ``gltf`` and ``print`` is that of the shape's own frame, that of all others the
        crop's centre at the depth of that origin.
        """
        scale = float(prediction.scale[item])
        if self.axes in _OWN:
            points = scale * (mesh.vertices @ np.array(_OWN[self.axes], float).T)
        else:
            points = in_camera(mesh.vertices, prediction.view[item], scale, prediction.offset[item])
            points = points @ self._from_camera(prediction.view[item]).T
        return np.asarray(points * self._factor(mesh, prediction, item), float)

    def _from_camera(self, view: np.ndarray) -> np.ndarray:
        if self.axes in ("camera", "opencv"):
            return np.eye(3)
        # Gravity is the own frame's y: the least turn about x that takes it to y keeps what is right in the image.
        _, cos, sin = view[:, 1]
        size = np.hypot(cos, sin) or 1.0
        level = np.array([[1, 0, 0], [0, cos / size, sin / size], [0, -sin / size, cos / size]])
        return np.array(FROM_LEVEL[self.axes], float) @ level

    def _factor(self, mesh: Mesh, prediction: ShapePrediction, item: int) -> float:
        """Return units of the file in one unit of the crop."""
        sides = np.ptp(mesh.vertices, axis=0) * float(prediction.scale[item])
        if self.height_mm is not None:
            return self.height_mm / max(float(sides[1]), 1e-12)
        if self.length_mm is not None:
            return self.length_mm / max(float(sides.max()), 1e-12)
        return float(prediction.scale_px[item]) if self.unit == "px" else 1.0

    def about(self, prediction: ShapePrediction, items: list[int]) -> dict[str, Any]:
        """Return the facts that a file holds beside its meshes: unit, axes, and the place of its items in the photo."""
        return {
            "unit": self.unit,
            "unit_is": self._unit_words(),
            "axes": self.axes,
            "axes_are": SHAPE_AXES[self.axes],
            "handedness": "right",
            "items": [_standing(prediction, item) for item in items],
        }

    def _unit_words(self) -> str:
        if self.height_mm is not None:
            return f"millimetres, each object taken to be {self.height_mm:g} mm high"
        if self.length_mm is not None:
            return f"millimetres, the longest side of each object's box taken to be {self.length_mm:g} mm"
        if self.unit == "px":
            return "pixels of the photo that the mask came from, at the object's depth"
        return "half the side of the mask's crop"


def _standing(prediction: ShapePrediction, item: int) -> dict[str, Any]:
    """Return one item's name and place: own frame to camera, in units of the crop."""
    distance = float(prediction.distance[item])
    return {
        "name": prediction.names[item],
        "view": np.round(prediction.view[item], 6).tolist(),
        "scale": round(float(prediction.scale[item]), 6),
        "offset": np.round(prediction.offset[item], 6).tolist(),
        "distance": round(distance, 6) if np.isfinite(distance) else None,
        "centre_px": np.round(prediction.centre_px[item], 3).tolist(),
        "scale_px": round(float(prediction.scale_px[item]), 4),
    }


# Surfaces, in the frames of the shapes or where the camera sees them.

_FINER = 2  # twice as fine as the grid: thin parts come out round, and files stay small


def surfaces(prediction: ShapePrediction, *, frame: str = "own", smooth: int = 4) -> list[Mesh | None]:
    """Return the mesh of each item, None where its grid is empty.

    ``own`` is the shape's frame, the cube from -1 to 1; ``camera`` is the camera's, in units of the crop.
    Raises ValueError for another frame.
    """
    if frame not in ("own", "camera"):
        raise ValueError(f"frame={frame}: expected own or camera")
    found: list[Mesh | None] = []
    for item, one in enumerate(prediction_surfaces(prediction, smooth=smooth)):
        mesh = one.mesh
        if mesh is not None and frame == "camera":
            points = in_camera(mesh.vertices, prediction.view[item], prediction.scale[item], prediction.offset[item])
            mesh = replace(mesh, vertices=np.asarray(points, float))
        found.append(mesh)
    return found


def prediction_surfaces(prediction: ShapePrediction, *, smooth: int = 4, finer: int = _FINER) -> list[Surface]:
    """Return the surface of each item's grid, in the shape's frame, named as the item; see `surface_of`."""
    return [
        surface_of(
            np.asarray(grid, np.float32), level=prediction.level, finer=finer, joined=True, smooth=smooth, name=name
        )
        for grid, name in progress(
            zip(prediction.occupancy, prediction.names, strict=True), "surfaces", len(prediction)
        )
    ]


def in_camera(
    points: Float[np.ndarray, "points 3"],
    view: Float[np.ndarray, "3 3"],
    scale: float | np.floating,
    offset: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "points 3"]:
    """Return points of the own frame in the camera's: x right, y down, z away, in units of the crop."""
    return scale * (points @ view.T) + np.append(offset, 0.0)


# npz: grids and their places, readable without pickle.

_ARRAYS = {
    "occupancy": np.float16, "view": np.float32, "scale": np.float32, "offset": np.float32, "distance": np.float32,
    "names": np.str_, "centre_px": np.float32, "scale_px": np.float32, "masks": np.uint8, "level": np.float32,
    "images": np.str_, "uncertainty": np.float16, "azimuth_deg": np.float32, "elevation_deg": np.float32,
    "roll_deg": np.float32, "probability": np.float32, "second_view": np.float32, "second_probability": np.float32,
}  # fmt: skip


def write_npz(prediction: ShapePrediction, path: str | Path) -> None:
    """Write what a `ShapePrediction` holds under the same names; the same shapes give the same bytes.

    ``occupancy`` (items depth height width) is float16, 0..1 at the centres of the voxels of the own cube,
    indices along z, y, x. A point p of the own frame is at scale * (view @ p) + (offset, 0) in the camera
    frame, in units of the mask's crop; ``scale_px`` of these are pixels, from ``centre_px``.
    """
    found = {name: (getattr(prediction, name), kind) for name, kind in _ARRAYS.items()}
    if prediction.images is not None:
        found["images"] = (names_from(Path(path).parent, prediction.images.tolist()), np.str_)
    arrays = {name: np.asarray(values, kind) for name, (values, kind) in found.items() if values is not None}
    with replacing(path) as handle:
        np.savez_compressed(handle, allow_pickle=False, **arrays)


# Mesh files: binary glTF, Wavefront OBJ, Stanford PLY, STL.

_COLOUR = [0.62, 0.55, 0.46, 1.0]
_APART = 1.25  # from middle to middle of neighbours, in widths of the widest
_STL_HEADER = 80


def encode_glb(solids: Sequence[trimesh.Trimesh], about: dict[str, Any]) -> bytes:
    """Return a scene with a node for each item, side by side along x, and ``about`` in ``asset.extras``.

    Lengths are metres in the glTF 2.0 Specification (section 3.4): millimetres become metres; pixels stay pixels.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual.texture import TextureVisuals

    plain = _material()
    if about["unit"] == "mm":
        about = about | {"unit": "m", "unit_is": str(about["unit_is"]).replace("millimetres", "metres")}
        for solid in solids:
            solid.apply_scale(0.001)
    several = len(solids) > 1
    step = _APART * max(float(np.ptp(solid.vertices[:, 0])) for solid in solids)
    scene = trimesh.Scene(base_frame="world")
    for number, (item, solid) in enumerate(zip(about["items"], solids, strict=True)):
        if _kind(solid) != "texture":
            solid.visual = TextureVisuals(material=plain)
        aside = np.eye(4)
        aside[0, 3] = (number - (len(solids) - 1) / 2) * step
        name = f"{number + 1} {item['name']}" if several else item["name"]
        scene.add_geometry(solid, name, name, transform=aside)
    extras = about | {"apart": step if several else 0.0}

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"] = {"version": "2.0", "generator": "uplift", "extras": extras}

    return export_glb(scene, include_normals=True, tree_postprocessor=describe)


def encode_obj(solids: Sequence[trimesh.Trimesh], about: dict[str, Any]) -> bytes:
    """Return one item's corners, normals and triangles, with unit and axes in comment lines."""
    from trimesh.exchange.obj import export_obj

    header = "\n# ".join(_lines(about))
    text = export_obj(
        solids[0],
        include_normals=True,
        include_color=_kind(solids[0]) == "vertex",
        include_texture=False,
        digits=6,
        header=header,
    )
    return as_bytes(f"{text}\n")


def encode_ply(solids: Sequence[trimesh.Trimesh], about: dict[str, Any]) -> bytes:
    """Return one item's corners with normals and its triangles, binary, with unit and axes in comment lines."""
    from trimesh.exchange.ply import export_ply

    data = export_ply(solids[0], vertex_normal=True)
    first = data.index(b"\n", data.index(b"format ")) + 1
    comments = "".join(f"comment {line}\n" for line in _lines(about))
    return data[:first] + comments.encode("ascii", "replace") + data[first:]


def encode_stl(solids: Sequence[trimesh.Trimesh], about: dict[str, Any]) -> bytes:
    """Return one item's triangles, binary; the 80 letters of the header name unit and axes."""
    from trimesh.exchange.stl import export_stl

    # A header that begins with "solid" is read as text by many programs.
    header = f"uplift, unit {about['unit']}, axes {about['axes']}, {about['items'][0]['name']}"
    return header.encode("ascii", "replace")[:_STL_HEADER].ljust(_STL_HEADER) + export_stl(solids[0])[_STL_HEADER:]


def _lines(about: dict[str, Any]) -> list[str]:
    (item,) = about["items"]
    rest = {key: value for key, value in item.items() if key != "name"}
    return [
        "uplift, a shape lifted from a mask",
        f"name: {' '.join(item['name'].split())}",
        f"unit: {about['unit']} ({about['unit_is']})",
        f"axes: {about['axes']} ({about['axes_are']}), right-handed",
        f"from the shape's own frame to the camera's, in units of the crop: {json.dumps(rest)}",
    ]
