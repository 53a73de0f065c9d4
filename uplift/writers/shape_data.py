"""What a page of shapes embeds: small meshes, masks, and where each item stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.masks.container import Placed
from uplift.meshes.mesh import Mesh
from uplift.meshes.surface import Surface
from uplift.meshes.surface_frames import prediction_surfaces
from uplift.meshes.surface_thin import thinned
from uplift.shapes.prediction import ShapePrediction
from uplift.writers.packing import pack

__all__ = ["Scores", "chosen_items", "shape_data"]

Scores = Mapping[str, Sequence[float] | np.ndarray]
"""Name -> a number for each item."""

_ALL_FACES, _MOST_FACES, _LEAST_FACES = 600_000, 5000, 600
_FINEST = 2 / 2048
_MASK_SIDE, _MASK_STEPS = 64, 15


def chosen_items(count: int, most: int) -> np.ndarray:
    """Return at most so many of ``count`` items, spread evenly; raises UserError for a number below 1."""
    if most < 1:
        raise UserError(f"items={most}: a page shows at least one shape.")
    return np.arange(count) if count <= most else np.arange(most) * count // most


def shape_data(
    prediction: ShapePrediction, truth: Placed | None, scores: Scores, smooth: int
) -> tuple[dict[str, Any], list[Surface]]:
    """Return the data of a page for these items, and what was cut out of their grids."""
    cut = prediction_surfaces(prediction, smooth=smooth)
    faces = int(np.clip(_ALL_FACES // (len(cut) * (1 if truth is None else 2)), _LEAST_FACES, _MOST_FACES))
    meshes = [thinned(one.mesh, faces) for one in cut if one.mesh is not None]
    places = iter(range(len(meshes)))
    items = [
        {
            "name": name,
            "mesh": -1 if one.mesh is None else next(places),
            "about": one.told(),
            "scores": [_number(scores[kind][item]) for kind in scores],
            **_standing(prediction, item),
        }
        for item, (name, one) in enumerate(zip(prediction.names, cut, strict=True))
    ]
    for item, of_truth in _true(truth, meshes, faces):
        items[item]["truth"] = of_truth
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


def _true(truth: Placed | None, meshes: list[Mesh], faces: int) -> list[tuple[int, dict[str, Any]]]:
    """Return each item's true mesh and place; the meshes that items show are added once each."""
    if truth is None:
        return []
    where = {}
    for shape in np.unique(truth.shape).tolist():
        where[shape] = len(meshes)
        meshes.append(thinned(truth.meshes[shape], faces))
    return [(item, {"mesh": where[int(shape)], **_standing(truth, item)}) for item, shape in enumerate(truth.shape)]


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
    small = _smaller(masks)
    steps = np.rint(small * _MASK_STEPS) / _MASK_STEPS
    return {
        "vertices": (corners, _FINEST),
        "faces": (faces, 1.0),
        "masks": (steps.reshape(-1, small.shape[2]), 1 / _MASK_STEPS),
    }


def _ordered(mesh: Mesh) -> Mesh:
    """Return the mesh with its corners from top to bottom and its triangles by their first corner."""
    order = np.lexsort(np.rint(mesh.vertices / (8 * _FINEST)).T[[2, 0, 1]])
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    faces = place[mesh.faces]
    start = faces.argmin(1)
    faces = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, 1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return Mesh(mesh.vertices[order], faces, mesh.name, mesh.category)


def _smaller(masks: np.ndarray) -> np.ndarray:
    """Return masks 0..1 of at most 64 pixels a side."""
    side = masks.shape[1]
    if side <= _MASK_SIDE:
        return masks.astype(np.float32) / 255
    from skimage.transform import resize

    small = (len(masks), _MASK_SIDE, _MASK_SIDE)
    return np.asarray(resize(masks.astype(np.float32) / 255, small, order=1, anti_aliasing=True), np.float32)
