"""Shapes as one self-contained page: masks, silhouettes from all sides and meshes to turn; no network, no WebGL."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from uplift.data.masks import Placed
from uplift.errors import UserError
from uplift.export.html import Curve, Section, jpeg_address, pack, scripted_page, write_text
from uplift.export.meshes import prediction_surfaces
from uplift.export.texture import photos_of, textured
from uplift.geometry.mesh import Mesh
from uplift.geometry.simplify import thinned
from uplift.geometry.surface import Surface
from uplift.models.prediction import ShapePrediction

if TYPE_CHECKING:
    from PIL.Image import Image

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
    smooth: int = 4,
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
    photos, wrong = photos_of(shown, images, _SIDE_PX)
    of_rows = {name: np.asarray(of, float)[rows] for name, of in scores.items()}
    data, cut = _shape_data(shown, true, of_rows, smooth, photos)
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

_ALL_FACES, _MOST_FACES, _LEAST_FACES = 600_000, 12_000, 600
_FINE_FACES = 4000  # with fewer triangles a finer grid would show nothing more
_FINEST = 2 / 2048
_MASK_SIDE, _MASK_STEPS = 64, 15


def _shape_data(
    prediction: ShapePrediction,
    truth: Placed | None,
    scores: _Scores,
    smooth: int,
    photos: Sequence[Image | None],
) -> tuple[dict[str, Any], list[Surface]]:
    """Return the data of a page for these items, and what was cut out of their grids."""
    count = len(prediction) * (1 if truth is None else 2)
    faces = int(np.clip(_ALL_FACES // count, _LEAST_FACES, _MOST_FACES))
    cut = prediction_surfaces(prediction, smooth=smooth, finer=2 if faces >= _FINE_FACES else 1)
    drawn: list[_Drawn] = []
    items: list[dict[str, Any]] = []
    for item, (name, title, one) in enumerate(zip(prediction.names, _titles(prediction.names), cut, strict=True)):
        items.append({
            "name": title,
            "id": name,
            "mesh": -1 if one.mesh is None else len(drawn),
            "about": one.summary(),
            "scores": [_number(scores[kind][item]) for kind in scores],
            **_standing(prediction, item),
        })  # fmt: skip
        photo = photos[item]
        items[-1] |= {} if photo is None else {"photo": jpeg_address(photo)}
        if one.mesh is not None:
            shown = _drawn(thinned(one.mesh, faces), prediction, item, photo)
            items[-1] |= {} if shown.texture is None else {"texture": jpeg_address(shown.texture)}
            drawn.append(shown)
    if truth is not None:
        shown = np.unique(truth.shape).tolist()
        where = {shape: len(drawn) + place for place, shape in enumerate(shown)}
        drawn += [_drawn(thinned(truth.meshes[shape], faces)) for shape in shown]
        for item, shape in enumerate(truth.shape):
            items[item]["truth"] = {"mesh": where[int(shape)], **_standing(truth, item)}
    packed, layout = pack(_arrays(drawn, prediction))
    data = {
        "meshes": [[len(one.mesh.vertices), len(one.mesh.faces)] for one in drawn],
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


@dataclass(frozen=True)
class _Drawn:
    """A mesh of the page and what its corners look like, in an order in which neighbours are alike."""

    mesh: Mesh
    sky: Float[np.ndarray, " vertices"]
    """How much of the sky a corner sees, 0 to 1."""
    place: Float[np.ndarray, "vertices 2"] | None = None
    """In the texture."""
    texture: Image | None = None
    doubt: Float[np.ndarray, " vertices"] | None = None
    """The uncertainty of the occupancy."""


def _drawn(mesh: Mesh, prediction: ShapePrediction | None = None, item: int = 0, photo: Image | None = None) -> _Drawn:
    sky, place, texture, doubt = _sky(mesh), None, None, None
    if prediction is not None and photo is not None:
        look = textured(mesh, photo, prediction, item)
        mesh, sky, place, texture = look.mesh, sky[look.corner], look.place, look.jpeg()
    if prediction is not None and prediction.uncertainty is not None:
        doubt = _at(np.asarray(prediction.uncertainty[item], np.float64), mesh.vertices)
    order = np.lexsort(np.rint(mesh.vertices / (8 * _FINEST)).T[[2, 0, 1]])
    faces = np.argsort(order)[mesh.faces]
    start = faces.argmin(1)
    faces = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, 1)
    ordered = replace(mesh, vertices=mesh.vertices[order], faces=faces[np.lexsort(faces.T[::-1])])
    return _Drawn(
        ordered, sky[order], None if place is None else place[order], texture, None if doubt is None else doubt[order]
    )


def _at(grid: Float[np.ndarray, "depth height width"], points: Float[np.ndarray, "points 3"]) -> np.ndarray:
    """Return the values of a grid over the cube of -1 to 1 at points, between its voxels linearly."""
    index = (points[:, ::-1].T + 1) * (len(grid) / 2) - 0.5
    return np.asarray(ndimage.map_coordinates(grid, index, order=1, mode="nearest"))


_SKY_SIDE, _SKY_POINTS = 40, 20_000
_SKY_SCALES = ((1.5, 0.55), (4.0, 0.75))
"""Widths in cells, and how dark what is all shut in at that width becomes."""


def _sky(mesh: Mesh) -> Float[np.ndarray, " vertices"]:
    """Return how open the surface is around each corner, 1 where it is flat or bulges: soft light from all sides.

    The density of surface a little above each corner, in cells of which the shape's longest side has `_SKY_SIDE`, less
    what a plane has there.
    """
    low, size = mesh.vertices.min(0), max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-9)
    points = (mesh.vertices - low) * (_SKY_SIDE / size) + 8
    a, b, c = (points[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1) / 2
    rng = np.random.default_rng(0)
    face = np.searchsorted(np.cumsum(area), rng.random(_SKY_POINTS) * area.sum()).clip(max=len(area) - 1)
    u, v = np.sort(rng.random((2, _SKY_POINTS, 1)), axis=0)
    dots = u * a[face] + (v - u) * b[face] + (1 - v) * c[face]
    cells = np.zeros((_SKY_SIDE + 16,) * 3)
    np.add.at(cells, tuple(dots.astype(int).T), area.sum() / _SKY_POINTS)
    normal = np.zeros_like(points)
    for k in range(3):
        np.add.at(normal, mesh.faces[:, k], cross)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    found = np.ones(len(points))
    for width, dark in _SKY_SCALES:
        above = (points + 2 * width * normal - 0.5).T
        density = ndimage.map_coordinates(ndimage.gaussian_filter(cells, width), above, order=1) * width * 2.5066
        found *= 1 - dark * np.clip(density - np.exp(-2), 0, 1)
    return found


def _arrays(drawn: Sequence[_Drawn], prediction: ShapePrediction) -> dict[str, tuple[np.ndarray, float]]:
    """Return corners, triangles, looks and masks as `pack` takes them."""
    # A last row of zeros: there may be no mesh at all.
    small, none = prediction.masks.astype(np.float32) / 255, np.zeros((1, 3))
    if small.shape[1] > _MASK_SIDE:
        from skimage.transform import resize

        small = np.asarray(resize(small, (len(small), _MASK_SIDE, _MASK_SIDE), order=1, anti_aliasing=True), np.float32)
    steps = np.rint(small * _MASK_STEPS) / _MASK_STEPS
    arrays = {
        "vertices": (np.concatenate([*(one.mesh.vertices for one in drawn), none]), _FINEST),
        "faces": (np.concatenate([*(one.mesh.faces for one in drawn), none.astype(int)]), 1.0),
        "sky": (np.concatenate([*(one.sky for one in drawn), none[0, :1]]), 1 / 64),
        "masks": (steps.reshape(-1, small.shape[2]), 1 / _MASK_STEPS),
    }
    if any(one.place is not None for one in drawn):
        places = [np.zeros((len(one.sky), 2)) if one.place is None else one.place for one in drawn]
        arrays["place"] = (np.concatenate([*places, none[:, :2]]), 1 / 2048)
    if prediction.uncertainty is not None:
        doubts = [np.zeros(len(one.sky)) if one.doubt is None else one.doubt for one in drawn]
        arrays["doubt"] = (np.concatenate([*doubts, none[0, :1]]), 1 / 256)
    return arrays


_SIDE_PX = 224  # of an item's photo
