"""The metrics of lifted shapes: silhouettes, surface and volume, one pure function each."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.optimize import minimize
from scipy.spatial import KDTree
from skimage.measure import marching_cubes
from torch import Tensor

from uplift.data.masks import Placed
from uplift.geometry.mesh import Mesh
from uplift.geometry.rotation import about_y
from uplift.geometry.silhouette import cover
from uplift.geometry.surface import written_surface
from uplift.models.prediction import ShapePrediction

__all__ = [
    "OWN_MIRROR", "SIDE", "Silhouette", "Standing", "TrueItem", "compare_surfaces", "grid_surface", "handedness",
    "mesh_surface", "of_mask", "overlap", "predicted", "score_item", "seen_overlap", "silhouette", "true", "volume_iou",
    "volume_iou_aligned", "voxel_centres",
]  # fmt: skip

_OF_GRID = ("inside", "empty", "span", "box", "surface")


@dataclass(frozen=True, eq=False)
class Standing:
    """An occupancy grid [z, y, x] in the cube of -1 to 1 of its own frame, whose point p is at ``matrix`` @ p + ``origin``."""

    occupancy: Float[Tensor, "depth height width"]
    level: float
    matrix: Float[np.ndarray, "3 3"]
    """From the shape's frame to the camera's: a rotation times the scale, with a reflection where mirrored."""
    origin: Float[np.ndarray, "3"]
    """Where the origin of the shape's frame is in the camera frame."""
    distance: float
    """Of the camera; infinite for parallel rays."""
    as_written: bool = False
    """Whether its surface is the one that files and pages have: smooth, cut finer than the grid."""

    @cached_property
    def inside(self) -> Bool[np.ndarray, "depth height width"]:
        """Voxels that are occupied."""
        return (self.occupancy > self.level).numpy()

    @cached_property
    def empty(self) -> bool:
        """Whether no voxel is occupied."""
        return not self.inside.any()

    @cached_property
    def span(self) -> tuple[slice, slice, slice]:
        """Where along z, y and x voxels are occupied, of a shape that is not empty."""
        z, y, x = (np.flatnonzero(self.inside.any(other)) for other in ((1, 2), (0, 2), (0, 1)))
        return slice(int(z[0]), int(z[-1]) + 1), slice(int(y[0]), int(y[-1]) + 1), slice(int(x[0]), int(x[-1]) + 1)

    @cached_property
    def box(self) -> Float[np.ndarray, "ends 3"]:
        """The lowest and the highest x, y and z that the occupied voxels reach, in the shape's frame."""
        side = self.occupancy.shape[0]
        return np.array([[2 * getattr(s, end) / side - 1 for s in self.span[::-1]] for end in ("start", "stop")])

    @cached_property
    def surface(self) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
        """Vertices in the shape's frame, and faces, of the surface at the level; none of an empty shape."""
        if self.empty:
            return np.zeros((0, 3)), np.zeros((0, 3), int)
        if self.as_written:
            mesh = written_surface(self.occupancy.numpy(), self.level).mesh
            if mesh is not None:
                return mesh.vertices, mesh.faces
        side = self.occupancy.shape[0]
        around = tuple(slice(s.start, s.stop + 2) for s in self.span)  # one more on each side, of a padded grid
        index, faces, _, _ = marching_cubes(np.pad(self.occupancy.numpy(), 1)[around], self.level)
        index = (index + [s.start - 1 for s in around])[:, ::-1]
        return (2 * index + 1) / side - 1, faces.astype(int)

    @cached_property
    def voxel(self) -> float:
        """Side of a voxel in the camera frame."""
        return 2 / self.occupancy.shape[0] * float(abs(np.linalg.det(self.matrix))) ** (1 / 3)

    @cached_property
    def occupied(self) -> Float[np.ndarray, "voxels 3"]:
        """Centres of the occupied voxels in the camera frame."""
        index = np.argwhere(self.inside)[:, ::-1]
        return self.to_camera((2 * index + 1) / self.occupancy.shape[0] - 1)

    @cached_property
    def volume(self) -> float:
        """Occupied volume in units of the camera frame."""
        return int(self.inside.sum()) * self.voxel**3

    @cached_property
    def depth(self) -> float:
        """Depth of the centroid of the occupied volume; the origin's where nothing is occupied."""
        return float(self.origin[2]) if self.empty else float(self.occupied[:, 2].mean())

    @cached_property
    def inverse(self) -> Float[np.ndarray, "3 3"]:
        """From the camera's directions to those of the shape's frame."""
        return np.linalg.inv(self.matrix)

    def to_camera(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Return points of the shape's frame in the camera's."""
        return points @ self.matrix.T + self.origin

    def inside_at(
        self, points: Float[Tensor, "depth height width 3"], matrix: np.ndarray, origin: np.ndarray
    ) -> Bool[np.ndarray, "depth height width"]:
        """Return which points of another frame are inside; that frame's point p is at ``matrix`` @ p + ``origin``."""
        turn = torch.from_numpy(self.inverse @ matrix).float()
        start = torch.from_numpy(self.inverse @ (origin - self.origin)).float()
        points = (points @ turn.T + start)[None].float()
        # Between voxels linearly; 0 outside the cube.
        found = torch.nn.functional.grid_sample(self.occupancy[None, None], points, align_corners=False)
        return (found[0, 0] > self.level).numpy()

    def moved(self, step: float) -> Standing:
        """Return the shape farther away by ``step``."""
        return self._elsewhere(origin=self.origin + np.array([0, 0, step]))

    def turned(self, rotation: Float[np.ndarray, "3 3"], about: Float[np.ndarray, "3"]) -> Standing:
        """Return the shape turned in the camera frame about a point, which becomes the frame's origin."""
        return self._elsewhere(matrix=rotation @ self.matrix, origin=rotation @ (self.origin - about))

    def mirrored(self) -> Standing:
        """Return the shape mirrored in depth, z to -z, its centroid where it was."""
        flip = np.array([1.0, 1.0, -1.0])
        middle = np.array([0, 0, 2 * self.depth])
        return self._elsewhere(matrix=flip[:, None] * self.matrix, origin=flip * self.origin + middle)

    def _elsewhere(self, **place: np.ndarray) -> Standing:
        """Return the same grid at another place: what is known of the grid itself is not found again."""
        other = replace(self, **place)
        other.__dict__.update({name: self.__dict__[name] for name in _OF_GRID if name in self.__dict__})
        return other


def predicted(prediction: ShapePrediction, row: int, *, as_written: bool = True) -> Standing:
    """Return a lifted shape where the prediction puts it."""
    return replace(_standing(prediction.occupancy[row], prediction.level, prediction, row), as_written=as_written)


def true(truth: Placed, row: int, filled: Bool[np.ndarray, "depth height width"]) -> Standing:
    """Return a true shape at its true place, given its filled grid."""
    return _standing(filled, 0.5, truth, row)


def _standing(occupancy: np.ndarray, level: float, placed: ShapePrediction | Placed, row: int) -> Standing:
    return Standing(
        torch.from_numpy(np.ascontiguousarray(occupancy, np.float32)),
        level,
        np.asarray(placed.view[row], np.float64) * float(placed.scale[row]),
        np.array([*placed.offset[row], 0.0], np.float64),
        float(placed.distance[row]),
    )


@functools.lru_cache(3)
def voxel_centres(resolution: int) -> Float[Tensor, "depth height width 3"]:
    """Return the voxel centres (x, y, z) of the cube from -1 to 1, indexed [z, y, x]; not to be changed."""
    along = (2 * torch.arange(resolution) + 1) / resolution - 1
    return torch.stack(torch.meshgrid(along, along, along, indexing="ij")[::-1], -1)


# Silhouettes of occupancy grids and meshes, in the input view and in new views about gravity, and their overlap.

SIDE = 64
"""Pixels along the crop in the input view, and along the truth's bounding sphere in a new one."""
_NEW_AZIMUTHS_DEG = tuple(range(40, 360, 40))
"""Turns about gravity from the input view: evenly spread, none nearer to it than 40 degrees, none opposite it."""


@dataclass(frozen=True)
class Silhouette:
    """Covered pixels of an endless image; the corner of four pixels is at its middle."""

    row: int
    """Of the first row of ``covered``."""
    column: int
    covered: Bool[np.ndarray, "height width"]


_NOTHING = Silhouette(0, 0, np.zeros((0, 0), bool))
_NEAREST = 0.05
"""Least distance from the camera, of its distance: what is nearer is drawn as if it were there."""
_FARTHEST = 2 * SIDE
"""Pixels from the middle beyond which nothing is drawn."""


def silhouette(shape: Standing, pixel: float) -> Silhouette:
    """Return the pixels whose centre's ray meets the shape's surface at its level; ``pixel`` is a pixel's side."""
    vertices, faces = shape.surface
    return _drawn(shape.to_camera(vertices), faces, shape.distance, pixel)


def _drawn(
    points: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], distance: float, pixel: float
) -> Silhouette:
    if not len(faces):
        return _NOTHING
    image = points[:, :2] / np.maximum(1 + points[:, 2:] / distance, _NEAREST) / pixel
    low = np.clip(np.floor(image.min(0)), -_FARTHEST, _FARTHEST).astype(int)
    width, height = (np.clip(np.ceil(image.max(0)), -_FARTHEST, _FARTHEST).astype(int) - low).tolist()
    if not width or not height:
        return _NOTHING
    return Silhouette(int(low[1]), int(low[0]), cover(image - low, faces, max(width, height))[:height, :width])


def of_mask(mask: np.ndarray) -> Silhouette:
    """Return the pixels of a crop (side side, 0 to 255) of which more than half is covered, at `SIDE` pixels."""
    covered = torch.from_numpy(mask.astype(np.float32))[None, None]
    if mask.shape[0] != SIDE:
        covered = torch.nn.functional.interpolate(covered, (SIDE, SIDE), mode="area")
    return Silhouette(-SIDE // 2, -SIDE // 2, (covered[0, 0] > 127.5).numpy())


def overlap(first: Silhouette, second: Silhouette) -> float:
    """Return the pixels that both cover, of those that either covers; 0 where neither covers any."""
    corner = np.array([[s.row, s.column] for s in (first, second)])
    low = corner.max(0)
    high = np.maximum((corner + [s.covered.shape for s in (first, second)]).min(0), low)
    inside = (
        s.covered[tuple(slice(a, b) for a, b in zip(low - at, high - at, strict=True))]
        for s, at in zip((first, second), corner, strict=True)
    )
    shared = int(np.logical_and(*inside).sum())
    either = int(first.covered.sum()) + int(second.covered.sum()) - shared
    return shared / either if either else 0.0


# Surfaces: points and normals of meshes and of occupancy grids, and how near two of them are.

_POINTS = 10_000
"""Points on each surface."""
THRESHOLD = 0.02
"""Of the f_score, in the truth's longest side."""


@dataclass(frozen=True)
class _Surface:
    """Points of a surface and the unit normals there, in the camera frame."""

    points: Float[np.ndarray, "points 3"]
    normals: Float[np.ndarray, "points 3"]

    @cached_property
    def tree(self) -> KDTree:
        """Of the points; built for few questions."""
        return KDTree(self.points, leafsize=32, compact_nodes=False, balanced_tree=False)

    def nearest_to(self, other: _Surface) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each point of ``other`` is from the nearest one here, and which that is."""
        away, which = self.tree.query(other.points, workers=torch.get_num_threads())
        return away, np.asarray(which)


def mesh_surface(mesh: Mesh, truth: Standing, points: int = _POINTS) -> _Surface:
    """Return points spread evenly over the mesh's outer surface, in the place of ``truth`` (its filled grid).

    A point is inside the union, and left out, where the filled grid is occupied a voxel away on both
    sides of its triangle.
    """
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    found, normals = _spread(corners, 2 * points)
    step = normals * (2 / truth.inside.shape[0])
    outer = ~(_occupied(truth.inside, found + step) & _occupied(truth.inside, found - step))
    if outer.any():
        found, normals = found[outer], normals[outer]
    return _standing_surface(truth, found[:points], normals[:points])


def grid_surface(shape: Standing, points: int = _POINTS) -> _Surface | None:
    """Return points spread evenly over the surface at the shape's level (marching cubes); None for an empty shape."""
    if shape.empty:
        return None
    vertices, faces = shape.surface
    return _standing_surface(shape, *_spread(vertices[faces], points))


def _spread(corners: Float[np.ndarray, "faces 3 3"], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``count`` points, uniform over the area of the triangles, and their normals; always the same ones."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(0)
    area = np.cumsum(length)
    face = np.searchsorted(area, rng.random(count) * area[-1], side="right").clip(max=len(area) - 1)
    root, along = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    a, b, c = corners[face].transpose(1, 0, 2)
    points = (1 - root) * a + root * ((1 - along) * b + along * c)
    return points, normals[face] / np.maximum(length[face], 1e-30)[:, None]


def _occupied(inside: Bool[np.ndarray, "depth height width"], points: np.ndarray) -> Bool[np.ndarray, " points"]:
    side = inside.shape[0]
    index = np.floor((points + 1) * side / 2).astype(int)
    within = ((index >= 0) & (index < side)).all(1)
    x, y, z = index.clip(0, side - 1).T
    return inside[z, y, x] & within


def _standing_surface(shape: Standing, points: np.ndarray, normals: np.ndarray) -> _Surface:
    """Return points and normals of the shape's frame in the camera frame; its matrix is a rotation, perhaps mirrored, times a scale."""
    turned = normals @ shape.matrix.T
    return _Surface(shape.to_camera(points), turned / np.maximum(np.linalg.norm(turned, axis=1), 1e-30)[:, None])


def compare_surfaces(found: _Surface | None, truth: _Surface, longest: float) -> dict[str, float]:
    """Return chamfer (in ``longest``), f_score and normal_consistency of two surfaces."""
    if found is None:
        return {"chamfer": 1.0, "f_score": 0.0, "normal_consistency": 0.0}  # as far as the truth is long
    to_truth, nearest_true = truth.nearest_to(found)
    to_found, nearest_found = found.nearest_to(truth)
    precision, recall = ((away <= THRESHOLD * longest).mean() for away in (to_truth, to_found))
    cosines = [
        np.abs((one.normals * other.normals[nearest]).sum(1)).mean()
        for one, other, nearest in ((found, truth, nearest_true), (truth, found, nearest_found))
    ]
    return {
        "chamfer": float((to_truth.mean() + to_found.mean()) / 2 / longest),
        "f_score": float(2 * precision * recall / max(precision + recall, 1e-12)),
        "normal_consistency": float(np.mean(cosines)),
    }


# Occupied volume that two shapes share, and whether a shape is nearer to the truth than to its mirror image.

OWN_MIRROR = 0.9
"""Truths whose volume IoU with their own mirror image in depth is above this have no handedness."""
_TIE = 1e-6
"""IoUs that differ by less are equal."""


def volume_iou(found: Standing, truth: Standing, mirrored: bool = False) -> float:
    """Return the volume of both, of the volume of either, after ``found`` is moved to the truth's depth.

    Both are read at the voxel centres of the box of the truth in its own grid, ``found`` between its
    voxels linearly; the voxels that ``found`` has outside that box add to the union. ``mirrored``: with the
    mirror image in depth of ``found`` that has the same silhouette, each ray kept.
    """
    if found.empty or truth.empty:
        return 0.0
    return _iou_where_it_is(found.moved(truth.depth - found.depth), truth, mirrored)


def _iou_where_it_is(found: Standing, truth: Standing, mirrored: bool = False) -> float:
    side = truth.occupancy.shape[0]
    points = voxel_centres(side)[truth.span]
    occupied = found.occupied
    if mirrored:
        matrix, origin = (torch.from_numpy(part).float() for part in (truth.matrix.T, truth.origin))
        points = _other_way(points @ matrix + origin, truth)
        inside = found.inside_at(points, np.eye(3), np.zeros(3))
        occupied = _other_way(torch.from_numpy(occupied), truth).numpy()
    else:
        inside = found.inside_at(points, truth.matrix, truth.origin)
    low, high = truth.box
    own = (occupied - truth.origin) @ truth.inverse.T
    outside = int(((own < low) | (own > high)).any(1).sum()) * found.voxel**3
    true_inside = truth.inside[truth.span]
    shared, either = int((inside & true_inside).sum()), int((inside | true_inside).sum())
    return shared * truth.voxel**3 / (either * truth.voxel**3 + outside)


def _other_way(points: Tensor, truth: Standing) -> Tensor:
    """Return points of the camera frame mirrored in depth about the truth's centroid, each on its own ray."""
    depth = 2 * truth.depth - points[..., 2:]
    share = (1 + depth / truth.distance) / (1 + points[..., 2:] / truth.distance)
    return torch.cat([points[..., :2] * share, depth], -1)


def handedness(found: Standing, truth: Standing, iou: float) -> float:
    """Return 1 where the truth shares more with ``found`` (``iou``) than with its mirror image in depth.

    A tie is 0.5, an empty shape 0, and a truth that is its own mirror NaN.
    """
    if _is_own_mirror(truth):
        return float("nan")
    other = volume_iou(found, truth, mirrored=True)
    if abs(iou - other) < _TIE and not found.empty:
        return 0.5
    return float(iou > other)


@functools.lru_cache(1)
def _is_own_mirror(truth: Standing) -> bool:
    return volume_iou(truth, truth, mirrored=True) > OWN_MIRROR


# The volume IoU after the best small similarity, which a small error of the pose leaves as it is.

MOST_TURN_DEG, MOST_LEAN_DEG, MOST_SCALE, MOST_SHIFT = 15.0, 10.0, 1.15, 0.1
"""About gravity; of the up axis to each side; and its inverse; of the truth's longest side, along each axis."""
_BLURS = (0.12, 0.06, 0.03)
"""Standard deviations, in units of the truth's grid, with which the similarity is looked for: thin parts find each other."""
_MOST_POINTS = 2000


def volume_iou_aligned(found: Standing, truth: Standing) -> float:
    """Return `volume_iou` after the similarity, of those near none, that makes it best; never less than without.

    The shape is turned about the truth's centroid, scaled and shifted, within `MOST_TURN_DEG` about gravity (y of the
    truth's frame), `MOST_LEAN_DEG` about its x and z, `MOST_SCALE`, and `MOST_SHIFT`. The cosine between the truth and
    the blurred shape is climbed (L-BFGS-B, from no change), with less blur each time; the best end counts.
    """
    if found.empty or truth.empty:
        return 0.0
    found = found.moved(truth.depth - found.depth)
    best, at = _iou_where_it_is(found, truth), np.zeros(7)
    for blur in _BLURS:
        at = _climbed(found, truth, at, blur)
        best = max(best, _iou_where_it_is(_changed(found, truth, at), truth))
    return best


def _similarity(at: Float[Tensor, "7"], truth: Standing) -> tuple[Tensor, Tensor, Tensor]:
    """Return the turn times the scale, the scale, and the shift, in the truth's frame; ``at`` from -1 to 1 in each."""
    turn, lean_x, lean_z = at[:3] * torch.deg2rad(at.new_tensor([MOST_TURN_DEG, MOST_LEAN_DEG, MOST_LEAN_DEG]))
    zero = torch.zeros_like(turn)
    skew = torch.stack([zero, -lean_z, turn, lean_z, zero, -lean_x, -turn, lean_x, zero]).reshape(3, 3)
    scale = MOST_SCALE ** at[3]
    return torch.linalg.matrix_exp(skew) * scale, scale, at[4:] * (MOST_SHIFT * float(np.ptp(truth.box, axis=0).max()))


def _changed(found: Standing, truth: Standing, at: np.ndarray) -> Standing:
    """Return the shape after a similarity of the truth's frame about the truth's centroid."""
    turn, _, shift = (part.numpy() for part in _similarity(torch.from_numpy(at), truth))
    turn = truth.matrix @ turn @ truth.inverse
    middle = truth.occupied.mean(0)
    origin = middle + turn @ (found.origin - middle) + truth.matrix @ shift
    return replace(found, matrix=turn @ found.matrix, origin=origin)


@torch.inference_mode(False)
@torch.enable_grad()  # evaluations run without gradients
def _climbed(found: Standing, truth: Standing, start: np.ndarray, blur: float) -> Float[np.ndarray, "7"]:
    """Return the similarity near ``start`` with the best cosine between the truth and the shape blurred."""
    sigma = blur * truth.voxel * truth.occupancy.shape[0] / found.voxel / 2
    density = torch.from_numpy(
        ndimage.gaussian_filter(found.inside.astype(np.float32), sigma, mode="constant", truncate=2)
    )
    own = torch.from_numpy(_scattered(truth))
    to_found = torch.from_numpy(found.inverse @ truth.matrix)
    origin = torch.from_numpy(found.inverse @ (truth.occupied.mean(0) - found.origin))

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        at = torch.from_numpy(values).requires_grad_()
        turn, scale, shift = _similarity(at, truth)
        places = (own - shift) @ torch.linalg.inv(turn).T @ to_found.T + origin
        seen = torch.nn.functional.grid_sample(
            density[None, None], places.float()[None, None, None], align_corners=False
        )
        value = -seen.mean() / scale**1.5
        value.backward()
        assert at.grad is not None
        return float(value.detach()), at.grad.numpy().astype(np.float64)

    options = {"ftol": 1e-5, "maxiter": 20}
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(-1, 1)] * 7, options=options).x


@functools.lru_cache(1)
def _scattered(truth: Standing) -> Float[np.ndarray, "points 3"]:
    """Return points of the truth's volume about its centroid in its frame; not at voxel centres, where both grids may have kinks."""
    random = np.random.default_rng(0)
    points = random.choice(truth.occupied, min(len(truth.occupied), _MOST_POINTS), replace=False)
    points = points + (random.random(points.shape) - 0.5) @ (truth.matrix.T * (2 / truth.occupancy.shape[0]))
    return (points - truth.occupied.mean(0)) @ truth.inverse.T


class TrueItem:
    """One true shape where it stands, and what every prediction of it is compared with, made once."""

    def __init__(self, truth: Placed, row: int, filled: Bool[np.ndarray, "depth height width"]) -> None:
        self.mesh: Mesh = truth.meshes[int(truth.shape[row])]
        self.standing: Standing = true(truth, row, filled)
        view = np.asarray(truth.view[row], np.float64)
        azimuth = torch.deg2rad(torch.tensor(_NEW_AZIMUTHS_DEG, dtype=torch.float64))
        self.turns = [view @ turn @ view.T for turn in about_y(azimuth).numpy()]
        self.longest = float(np.ptp(self.mesh.vertices, axis=0).max()) * float(truth.scale[row])

    @cached_property
    def surface(self) -> _Surface:
        """Of the mesh."""
        return mesh_surface(self.mesh, self.standing)

    @cached_property
    def pixel(self) -> float:
        """Side of a pixel of the new views: `SIDE` of them span the bounding sphere about the shape's origin."""
        corners = self.mesh.vertices[np.unique(self.mesh.faces)] @ self.standing.matrix.T
        return 2 * float(np.linalg.norm(corners, axis=1).max(initial=1e-9)) / SIDE

    @cached_property
    def silhouettes(self) -> list[Silhouette]:
        """Of the mesh in the new views."""
        points = self.mesh.vertices @ self.standing.matrix.T
        return [_drawn(points @ turn.T, self.mesh.faces, self.standing.distance, self.pixel) for turn in self.turns]


def seen_overlap(found: Standing, mask: np.ndarray) -> float:
    """Return the IoU of a shape's silhouette in the input view and the input mask."""
    return overlap(silhouette(found, 2 / SIDE), of_mask(mask))


def score_item(found: Standing, truth: TrueItem, mask: np.ndarray) -> dict[str, float]:
    """Return the metrics of one shape; the depths of the centroids are brought together for all but the seen view."""
    seen = seen_overlap(found, mask)
    found = found.moved(truth.standing.depth - found.depth)
    volume = volume_iou(found, truth.standing)
    new = [
        overlap(silhouette(found.turned(turn, truth.standing.origin), truth.pixel), true_one)
        for turn, true_one in zip(truth.turns, truth.silhouettes, strict=True)
    ]
    return {
        "silhouette_iou_unseen": float(np.mean(new)),
        **compare_surfaces(grid_surface(found), truth.surface, truth.longest),
        "volume_iou": volume,
        "volume_iou_aligned": volume_iou_aligned(found, truth.standing),
        "silhouette_iou_seen": seen,
        "handedness": handedness(found, truth.standing, volume),
    }
