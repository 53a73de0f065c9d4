"""Photos on shapes: what the camera saw of the surface, its mirror image on the other half, and soft colours elsewhere."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8

from uplift.export.html import Photos
from uplift.geometry.mesh import Mesh
from uplift.geometry.silhouette import project
from uplift.models.prediction import ShapePrediction

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["Texture", "photo_of", "photos_of", "textured"]


_QUALITY = 88


@dataclass(frozen=True)
class Texture:
    """A picture, and where in it each corner of a mesh has its colour."""

    mesh: Mesh
    """Corners are doubled where the picture has a seam."""
    corner: Int[np.ndarray, " vertices"]
    """Which corner of the mesh without seams each one is."""
    place: Float[np.ndarray, "vertices 2"]
    """From 0 to 1: x right, y down from the upper left of the picture."""
    picture: UInt8[np.ndarray, "side wide 3"]
    """On the left the photo, around the object filled with its colours; on the right the same, blurred."""

    def colours(self) -> UInt8[np.ndarray, "corners 3"]:
        """Return the colour of each corner of the mesh without seams."""
        high, wide = self.picture.shape[:2]
        x, y = (np.clip((self.place[:, k] * size).astype(int), 0, size - 1) for k, size in ((0, wide), (1, high)))
        count = np.bincount(self.corner)
        colour = [np.bincount(self.corner, channel) / count for channel in self.picture[y, x].T.astype(float)]
        return np.rint(np.stack(colour, 1)).astype(np.uint8)

    def jpeg(self) -> Image:
        """Return the picture, as small as a photo is."""
        from PIL import Image

        data = io.BytesIO()
        Image.fromarray(self.picture).save(data, "JPEG", quality=_QUALITY)
        return Image.open(data)


def photos_of(
    prediction: ShapePrediction, folder: str | Path | None, side: int
) -> tuple[list[Image | None], list[str]]:
    """Return each item's crop of its photo, ``side`` pixels wide, None where there is none, and what went wrong.

    Photos are looked for in ``folder``, by their name or its last part, and without a folder where
    `ShapePrediction.images` says. Raises UserError where there is no such folder.
    """
    photos = Photos(folder)
    if prediction.images is None:
        return [None] * len(prediction), []
    found = [photo_of(prediction, item, photos, side) for item in range(len(prediction))]
    wrong = photos.unreadable
    return found, [f"{len(wrong)} photos could not be read, such as {wrong[0]}."] if wrong else []


def photo_of(prediction: ShapePrediction, item: int, photos: Photos, side: int) -> Image | None:
    """Return an item's crop of its photo, ``side`` pixels wide, grey where the photo ends; None where there is none."""
    from PIL import Image

    if prediction.images is None:
        return None
    name, half = str(prediction.images[item]), float(prediction.scale_px[item])
    low, scale = prediction.centre_px[item] - half, side / (2 * half)
    found = photos.cut(name, float(low[0]), float(low[1]), 2 * half, scale)
    if found is None:
        return None
    picture, corners = found
    square = Image.new("RGB", (side, side), (128, 128, 128))
    square.paste(picture, (round((corners[0, 0] - low[0]) * scale), round((corners[0, 1] - low[1]) * scale)))
    return square


# The surface that the camera sees, and that whose mirror image it sees.

_DEPTH_SIDE = 192
_BEHIND = 0.03
"""How far behind the nearest surface a triangle still counts as seen, in units of the crop."""
_GRAZING, _SLANTED = 0.1, 0.35
"""Cosines between the ray and the surface: below the first nothing is seen, and above the second the mirror adds nothing."""
_OWN_MIRROR, _NEAR = 0.95, 0.06
"""A shape is its own mirror image where so many corners have another one so near to theirs, in the shape's frame."""
_EVEN_ROUNDS = 6


def textured(mesh: Mesh, photo: Image, prediction: ShapePrediction, item: int) -> Texture:
    """Return the mesh of an item, in the shape's frame, with the crop of its photo on it.

    What the camera sees has the photo's pixels where they project (`uplift.data.masks.Placed`). Of a shape that is its
    own mirror image (x to -x), what only its mirror image shows has those of the mirror image. All else has a blurred
    colour of the nearest surface that is seen.
    """
    square = np.asarray(photo.convert("RGB"))
    own, own_cosine = _seen(mesh, mesh, prediction, item)
    kind = np.where(own_cosine > _GRAZING, 0, 2)
    places = [own, own]
    if _is_own_mirror(mesh):
        other = replace(mesh, vertices=mesh.vertices * [-1.0, 1, 1], faces=mesh.faces[:, ::-1])
        mirrored, mirrored_cosine = _seen(other, mesh, prediction, item)
        kind[(mirrored_cosine > _GRAZING) & (own_cosine < _SLANTED) & (mirrored_cosine > own_cosine)] = 1
        places[1] = mirrored
    kind = _evened(mesh.faces, kind)
    return _with_seams(mesh, kind, [*places, _spread(mesh, kind, places)], _atlas(square, prediction.masks[item]))


def _seen(
    mesh: Mesh, before: Mesh, prediction: ShapePrediction, item: int
) -> tuple[Float[np.ndarray, "vertices 2"], Float[np.ndarray, " faces"]]:
    """Return where each corner is in the crop, and how directly each triangle is seen: 0 where something is in front.

    ``before`` is the surface that may be in front.
    """
    distance = float(prediction.distance[item])
    turn, shift = prediction.scale[item] * prediction.view[item].T, np.append(prediction.offset[item], 0.0)
    points, in_front = (one.vertices @ turn + shift for one in (mesh, before))
    depth = _depths(in_front, before.faces, distance)
    corners = points[mesh.faces]
    middle = corners.mean(1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ray = middle + [0, 0, distance] if np.isfinite(distance) else np.tile([0.0, 0, 1], (len(middle), 1))
    cosine = -(normal * ray).sum(1) / np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1), 1e-30)
    x, y = _pixels(project(middle, distance)).T
    return project(points, distance), np.where(middle[:, 2] <= depth[y, x] + _BEHIND, cosine, 0.0)


def _pixels(flat: Float[np.ndarray, "points 2"]) -> Int[np.ndarray, "points 2"]:
    return np.clip((flat + 1) * (_DEPTH_SIDE / 2), 0, _DEPTH_SIDE - 1).astype(int)


def _depths(points: np.ndarray, faces: np.ndarray, distance: float) -> Float[np.ndarray, "side side"]:
    """Return the depth of the nearest surface in each pixel of the crop, from points set closer than pixels on it."""
    depth = np.full((_DEPTH_SIDE, _DEPTH_SIDE), np.inf)
    flat = project(points, distance)[faces]
    longest = np.ptp(flat, axis=1).max(1) * (_DEPTH_SIDE / 2)
    steps = 1 << np.clip(np.ceil(np.log2(np.maximum(1.5 * longest, 1))), 0, 8).astype(int)
    for count in np.unique(steps).tolist():
        a, b = np.divmod(np.arange((count + 1) ** 2), count + 1)
        share = np.stack([a, b, count - a - b], 1)[a + b <= count] / count
        dots = np.einsum("sk,nkd->nsd", share, points[faces[steps == count]]).reshape(-1, 3)
        x, y = _pixels(project(dots, distance)).T
        np.minimum.at(depth, (y, x), dots[:, 2])
    return depth


def _evened(faces: Int[np.ndarray, "faces 3"], kind: Int[np.ndarray, " faces"]) -> Int[np.ndarray, " faces"]:
    """Return the kinds without specks: that of two or more neighbours over an edge, a few times over."""
    edges = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), 1)
    order = np.lexsort(edges.T)
    same = np.flatnonzero((edges[order[1:]] == edges[order[:-1]]).all(1))
    first, second = order[same] % len(faces), order[same + 1] % len(faces)
    for _ in range(_EVEN_ROUNDS):
        votes = np.eye(3)[kind] * 1.5
        np.add.at(votes, first, np.eye(3)[kind[second]])
        np.add.at(votes, second, np.eye(3)[kind[first]])
        kind = votes.argmax(1)
    return kind


def _is_own_mirror(mesh: Mesh) -> bool:
    from scipy.spatial import KDTree

    corners = mesh.vertices[:: max(1, len(mesh.vertices) // 2000)]
    away, _ = KDTree(mesh.vertices).query(corners * [-1.0, 1, 1])
    return bool((away < _NEAR).mean() > _OWN_MIRROR)


# The picture, and places in it.

_EDGE = 0.015
"""Of the crop: so near to the mask's border pixels are not the object's alone."""
_BLUR = 0.05
"""Of the crop: how much the colours of what is not seen are blurred."""
_ROUNDS = 40


def _atlas(photo: UInt8[np.ndarray, "side side 3"], mask: UInt8[np.ndarray, "pixels pixels"]) -> np.ndarray:
    """Return the photo with the object's colours all around it, and beside it the same, blurred."""
    from scipy import ndimage

    side = len(photo)
    fine = ndimage.zoom(mask.astype(np.float32), side / len(mask), order=1, grid_mode=True, mode="nearest")
    inside = np.asarray(fine) > 127
    away = np.asarray(ndimage.distance_transform_edt(np.pad(inside, 1)))[1:-1, 1:-1]
    kept = inside & (away > min(_EDGE * side, 0.5 * away.max()))
    if not kept.any():
        kept = np.ones_like(inside)
    row, column = np.asarray(ndimage.distance_transform_edt(~kept, return_distances=False, return_indices=True))
    filled = photo[row, column]
    blurred = ndimage.gaussian_filter(filled.astype(np.float32), (_BLUR * side, _BLUR * side, 0), mode="nearest")
    return np.concatenate([filled, np.rint(blurred).astype(np.uint8)], 1)


def _spread(mesh: Mesh, kind: Int[np.ndarray, " faces"], places: Sequence[np.ndarray]) -> np.ndarray:
    """Return places in the crop for corners that nothing shows: those of the nearest that is seen, then evened out."""
    from scipy.sparse import csr_array
    from scipy.spatial import KDTree

    found, known = np.zeros((len(mesh.vertices), 2)), np.zeros(len(mesh.vertices), bool)
    for which in (1, 0):
        corners = np.unique(mesh.faces[kind == which])
        found[corners], known[corners] = places[which][corners], True
    if not known.any():
        return places[0]
    if known.all():
        return found
    nearest = KDTree(mesh.vertices[known]).query(mesh.vertices[~known])[1]
    found[~known] = found[known][nearest]
    pairs = np.concatenate([mesh.faces[:, [k, (k + other) % 3]] for k in range(3) for other in (1, 2)])
    count = len(mesh.vertices)
    near = csr_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    of = np.maximum(near.sum(1), 1)[:, None]
    for _ in range(_ROUNDS):
        found = np.where(known[:, None], found, (near @ found) / of)
    return found


def _with_seams(mesh: Mesh, kind: np.ndarray, places: Sequence[np.ndarray], picture: np.ndarray) -> Texture:
    """Return the mesh with a corner for each kind of triangle around it, 0 seen, 1 by the mirror, 2 not at all."""
    used, faces = np.unique(3 * mesh.faces + kind[:, None], return_inverse=True)
    corner, of_kind = np.divmod(used, 3)
    place = np.clip((np.stack(places)[of_kind, corner] + 1) / 2, 0, 1)
    side = len(picture)
    inset = np.clip(place, 0.5 / side, 1 - 0.5 / side) / [2, 1]  # half a pixel: the halves do not mix
    inset[:, 0] += 0.5 * (of_kind == 2)
    whole = replace(mesh, vertices=mesh.vertices[corner], faces=faces.reshape(-1, 3))
    return Texture(whole, corner, inset, picture)
