"""Shapes as one self-contained page: masks, silhouettes from all sides and meshes to turn; no network, no WebGL."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from uplift.data.masks import Placed
from uplift.errors import UserError
from uplift.export.html import Curve, Section, jpeg_address, pack, scripted_page, write_text
from uplift.export.meshes import prediction_surfaces
from uplift.export.texture import photos_of
from uplift.geometry.mesh import Mesh
from uplift.geometry.simplify import thinned
from uplift.geometry.surface import Surface
from uplift.models.prediction import ShapePrediction

__all__ = ["shape_page_text", "write_shape_gallery", "write_shape_page"]

_Scores = Mapping[str, Sequence[float] | np.ndarray]
"""Name -> a number for each item."""
_SCRIPTS = ("decode", "shape_mesh", "shape_raster", "shape_colours", "shape_state", "shape_flat", "shape_deep",
            "shape_sheet", "shape_controls")  # fmt: skip


def write_shape_page(prediction: ShapePrediction, path: str | Path, **options: Any) -> None:
    """Write the page of `shape_page_text` to ``path`` with these options."""
    write_text(shape_page_text(prediction, **options), path)


def write_shape_gallery(prediction: ShapePrediction, path: str | Path, **options: Any) -> None:
    """Write the same page, opened at the sheet of all items."""
    write_shape_page(prediction, path, **{"sheet": True, **options})


def shape_page_text(
    prediction: ShapePrediction,
    *,
    truth: Placed | None = None,
    items: int = 100,
    scores: _Scores | None = None,
    images: str | Path | None = None,
    sheet: bool = False,
    smooth: int = 2,
    sections: Sequence[Section] = (),
    curves: Mapping[str, Curve] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """Return the page of at most ``items`` shapes, with the true ones beside them where ``truth`` has one for each item.

    ``scores`` are name -> a number for each item, shown with it and to sort the sheet by; ``images`` is the folder
    of the photos; ``sheet`` opens the page at all items. ``sections``, ``curves`` and ``notes`` are as in
    `uplift.export.page.page_text`.

    Raises:
        UserError: no item, a truth or score that is not one for each item, no such folder of photos.
    """
    scores, total, side = scores or {}, len(prediction), prediction.resolution
    if not total:
        raise UserError("there is no shape to show: no mask was lifted.")
    for name, values in {"truth": truth, **scores}.items():
        if values is not None and len(values) != total:
            raise UserError(f"{name} has {len(values)} rows, expected {total}, one for each shape.")
    if items < 1:
        raise UserError(f"items={items}: a page shows at least one shape.")
    rows = np.arange(min(items, total)) * total // min(items, total)
    shown, true = prediction.select(rows), None if truth is None else truth.select(rows)
    data, cut = _shape_data(shown, true, {name: np.asarray(of, float)[rows] for name, of in scores.items()}, smooth)
    photos, wrong = photos_of(shown, images, _SIDE_PX)
    for entry, photo in zip(data["items"], photos, strict=True):
        entry |= {"photo": jpeg_address(photo)} if photo else {}
    data["sheet"] = sheet and len(rows) > 1
    facts = [f"{total:,} shape{'s' * (total > 1)}", f"{side} × {side} × {side} voxels"]
    return scripted_page(
        "shape.htm",
        title=prediction.title or "Shapes",
        facts=[*facts, "true shapes known"] if truth is not None else facts,
        styles=["page.css", "shape.css"],
        notes=[*_remarks(cut, total), *wrong, *prediction.notes, *notes],
        data=data,
        scripts=_SCRIPTS,
        sections=sections,
        curves=curves,
        things="shapes",
    )


def _remarks(cut: Sequence[Surface], count: int) -> list[str]:
    remarks = [] if len(cut) == count else [f"{len(cut)} of {count:,} shapes are shown, spread evenly."]
    empty = sum(one.mesh is None for one in cut)
    if empty:
        remarks.append(f"{empty} of {len(cut)} shapes have no surface: their occupancy is below the level everywhere.")
    return [*remarks, "Meshes are drawn with fewer triangles than the files of shapes have."]


# What a page of shapes embeds: small meshes, masks, and the place of each item.

_ALL_FACES, _MOST_FACES, _LEAST_FACES = 600_000, 5000, 600
_FINEST = 2 / 2048
_MASK_SIDE, _MASK_STEPS = 64, 15


def _shape_data(
    prediction: ShapePrediction, truth: Placed | None, scores: _Scores, smooth: int
) -> tuple[dict[str, Any], list[Surface]]:
    """Return the data of a page for these items, and what was cut out of their grids."""
    cut = prediction_surfaces(prediction, smooth=smooth)
    faces = int(np.clip(_ALL_FACES // (len(cut) * (1 if truth is None else 2)), _LEAST_FACES, _MOST_FACES))
    meshes = [thinned(one.mesh, faces) for one in cut if one.mesh is not None]
    places = iter(range(len(meshes)))
    items = [
        {
            "name": title,
            "id": name,
            "mesh": -1 if one.mesh is None else next(places),
            "about": one.summary(),
            "scores": [_number(scores[kind][item]) for kind in scores],
            **_standing(prediction, item),
        }
        for item, (name, title, one) in enumerate(zip(prediction.names, _titles(prediction.names), cut, strict=True))
    ]
    if truth is not None:
        shown = np.unique(truth.shape).tolist()
        where = {shape: len(meshes) + place for place, shape in enumerate(shown)}
        meshes += [thinned(truth.meshes[shape], faces) for shape in shown]
        for item, shape in enumerate(truth.shape):
            items[item]["truth"] = {"mesh": where[int(shape)], **_standing(truth, item)}
    packed, layout = pack(_arrays(meshes, prediction.masks))
    data = {
        "meshes": [[len(mesh.vertices), len(mesh.faces)] for mesh in meshes],
        "items": items,
        "scoreNames": list(scores),
        "side": min(_MASK_SIDE, prediction.masks.shape[1]),
        "layout": layout,
        "packed": packed,
    }
    return data, cut


def _titles(names: Sequence[str]) -> list[str]:
    """Return names for people: without folders, seeds and numbers of items, and numbered where they are then the same."""
    short = [
        re.sub(r"^([a-z]+)-\d+-(\d+)$", lambda found: f"{found[1]} {int(found[2]) + 1}", _stem(name)) for name in names
    ]
    count, met = Counter(short), Counter[str]()
    titles = []
    for name in short:
        met[name] += 1
        titles.append(f"{name} · {met[name]}" if count[name] > 1 else name)
    return titles


def _stem(name: str) -> str:
    """Return the last part of a path, without the ``:3`` of an item; all of it where nothing else is there."""
    return re.sub(r":\d+$", "", PurePosixPath(name).name) or name


def _standing(placed: ShapePrediction | Placed, item: int) -> dict[str, Any]:
    return {
        "view": np.round(np.asarray(placed.view[item], float).ravel(), 5).tolist(),
        "scale": round(float(placed.scale[item]), 5),
        "offset": np.round(np.asarray(placed.offset[item], float), 5).tolist(),
        "distance": _number(placed.distance[item]),
    }


def _number(value: float | np.floating) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _arrays(meshes: Sequence[Mesh], masks: np.ndarray) -> dict[str, tuple[np.ndarray, float]]:
    """Return corners, triangles and masks as `pack` takes them, in an order in which neighbours are alike."""
    ordered = [_ordered(mesh) for mesh in meshes]
    # A last row of zeros: there may be no mesh at all.
    corners = np.concatenate([*(mesh.vertices for mesh in ordered), np.zeros((1, 3))])
    faces = np.concatenate([*(mesh.faces for mesh in ordered), np.zeros((1, 3), np.int64)])
    small = masks.astype(np.float32) / 255
    if small.shape[1] > _MASK_SIDE:
        from skimage.transform import resize

        side = _MASK_SIDE
        small = np.asarray(resize(small, (len(masks), side, side), order=1, anti_aliasing=True), np.float32)
    steps = np.rint(small * _MASK_STEPS) / _MASK_STEPS
    return {
        "vertices": (corners, _FINEST),
        "faces": (faces, 1.0),
        "masks": (steps.reshape(-1, small.shape[2]), 1 / _MASK_STEPS),
    }


def _ordered(mesh: Mesh) -> Mesh:
    """Return the mesh with its corners from top to bottom and its triangles by their first corner."""
    order = np.lexsort(np.rint(mesh.vertices / (8 * _FINEST)).T[[2, 0, 1]])
    faces = np.argsort(order)[mesh.faces]
    start = faces.argmin(1)
    faces = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, 1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return Mesh(mesh.vertices[order], faces, mesh.name, mesh.category)


_SIDE_PX = 224  # of an item's photo
