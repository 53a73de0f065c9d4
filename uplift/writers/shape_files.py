"""Lifted shapes as mesh files: binary glTF, Wavefront OBJ, Stanford PLY, STL."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.meshes.surface import Surface
from uplift.saving import replacing
from uplift.shapes.prediction import ShapePrediction
from uplift.writers.shape_axes import Frame

if TYPE_CHECKING:
    import trimesh

__all__ = ["write_glb", "write_obj", "write_ply", "write_stl"]

_COLOUR = [0.62, 0.55, 0.46, 1.0]
_APART = 1.25
"""From middle to middle of neighbours, in widths of the widest."""
_STL_HEADER = 80


def write_glb(
    prediction: ShapePrediction, items: list[int], cut: Sequence[Surface], frame: Frame, path: str | Path
) -> str:
    """Write a scene with a node for each item, side by side along x; returns what was cleaned.

    ``asset.extras`` holds unit, axes and where each item stands. Lengths are metres in the glTF 2.0
    Specification (section 3.4): millimetres become metres; pixels stay pixels.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual.material import PBRMaterial
    from trimesh.visual.texture import TextureVisuals

    look = PBRMaterial("shape", baseColorFactor=_COLOUR, metallicFactor=0.0, roughnessFactor=0.75)
    solids = [_solid(prediction, item, one, frame) for item, one in zip(items, cut, strict=True)]
    metric = frame.unit == "mm"
    for solid in solids if metric else ():
        solid.apply_scale(0.001)
    step = _APART * max(float(np.ptp(solid.vertices[:, 0])) for solid in solids)
    scene = trimesh.Scene(base_frame="world")
    for number, (item, solid) in enumerate(zip(items, solids, strict=True)):
        solid.visual = TextureVisuals(material=look)
        aside = np.eye(4)
        aside[0, 3] = (number - (len(solids) - 1) / 2) * step
        name = f"{number + 1} {prediction.names[item]}" if len(items) > 1 else prediction.names[item]
        scene.add_geometry(solid, name, name, transform=aside)
    about = frame.about(prediction, items) | {"apart": step if len(items) > 1 else 0.0}
    if metric:
        about |= {"unit": "m", "unit_is": str(about["unit_is"]).replace("millimetres", "metres")}

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"] = {"version": "2.0", "generator": "uplift", "extras": about}

    _save(path, export_glb(scene, include_normals=True, tree_postprocessor=describe))
    return _told(cut)


def write_obj(
    prediction: ShapePrediction, items: list[int], cut: Sequence[Surface], frame: Frame, path: str | Path
) -> str:
    """Write one item's corners, normals and triangles, with unit and axes in comment lines."""
    from trimesh.exchange.obj import export_obj

    solid = _solid(prediction, items[0], cut[0], frame)
    header = "\n# ".join(_lines(prediction, items, frame))
    text = export_obj(solid, include_normals=True, include_color=False, include_texture=False, digits=6, header=header)
    _save(path, f"{text}\n".encode())
    return _told(cut)


def write_ply(
    prediction: ShapePrediction, items: list[int], cut: Sequence[Surface], frame: Frame, path: str | Path
) -> str:
    """Write one item's corners with normals and its triangles, binary, with unit and axes in comment lines."""
    from trimesh.exchange.ply import export_ply

    data = export_ply(_solid(prediction, items[0], cut[0], frame), vertex_normal=True)
    first = data.index(b"\n", data.index(b"format ")) + 1
    comments = "".join(f"comment {line}\n" for line in _lines(prediction, items, frame))
    _save(path, data[:first] + comments.encode("ascii", "replace") + data[first:])
    return _told(cut)


def write_stl(
    prediction: ShapePrediction, items: list[int], cut: Sequence[Surface], frame: Frame, path: str | Path
) -> str:
    """Write one item's triangles, binary; the 80 letters of the header name unit and axes."""
    from trimesh.exchange.stl import export_stl

    data = export_stl(_solid(prediction, items[0], cut[0], frame))
    # A header that begins with "solid" is read as text by many programs.
    header = f"uplift, unit {frame.unit}, axes {frame.axes}, {prediction.names[items[0]]}"
    _save(path, header.encode("ascii", "replace")[:_STL_HEADER].ljust(_STL_HEADER) + data[_STL_HEADER:])
    return _told(cut)


def _solid(prediction: ShapePrediction, item: int, one: Surface, frame: Frame) -> trimesh.Trimesh:
    import trimesh

    assert one.mesh is not None
    return trimesh.Trimesh(frame.placed(one.mesh, prediction, item), one.mesh.faces, process=False)


def _lines(prediction: ShapePrediction, items: list[int], frame: Frame) -> list[str]:
    """Return what a file says of itself, a fact a line."""
    about = frame.about(prediction, items)
    (item,) = about["items"]
    rest = {key: value for key, value in item.items() if key != "name"}
    return [
        "uplift, a shape lifted from a mask",
        f"name: {' '.join(item['name'].split())}",
        f"unit: {about['unit']} ({about['unit_is']})",
        f"axes: {about['axes']} ({about['axes_are']}), right-handed",
        f"from the shape's own frame to the camera's, in units of the crop: {json.dumps(rest)}",
    ]


def _told(cut: Sequence[Surface]) -> str:
    words = [one.told() for one in cut]
    if len(cut) == 1:
        return words[0]
    return "; ".join(f"{number}: {word}" for number, word in enumerate(words, 1) if word)


def _save(path: str | Path, data: bytes) -> None:
    with replacing(path) as handle:
        handle.write(data)
