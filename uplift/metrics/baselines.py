"""Baselines that a lifter must beat: flat depth for keypoints; visual hull, mean shape and nearest shape for masks."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.data.masks import MaskData, Placed
from uplift.errors import UserError
from uplift.metrics.evaluate_shapes import RESOLUTION as TRUE_RESOLUTION
from uplift.metrics.evaluate_shapes import evaluate_all, filled_truths
from uplift.metrics.protocols import BEST_BASELINE, metric_better, metric_order
from uplift.metrics.report import ShapeEvaluation
from uplift.metrics.shape_metrics import true, voxel_centres
from uplift.models.prediction import ShapePrediction

__all__ = [
    "best_thickness", "extrusion", "flat_depth", "hull_occupancy", "mask_half", "mean_shape", "nearest_masks",
    "score_with_baselines", "shape_baselines", "training_truth",
]  # fmt: skip

RESOLUTION = 48
"""Voxels along the grids of baselines of shapes, an even number."""
_SAMPLE = 500
"""Training items that thickness and mean shape are taken from."""
_BEST_OF = ("silhouette_iou_unseen", "f_score", "chamfer", "volume_iou", "volume_iou_aligned")


def flat_depth(keypoints: Float[np.ndarray, "frames joints 2"], root: int) -> Float[np.ndarray, "frames joints 3"]:
    """Return the observed 2D relative to the root with z = 0: the error that any lifter of keypoints must beat."""
    centred = keypoints - keypoints[:, root, None]
    return np.concatenate([centred, np.zeros_like(centred[..., :1])], -1)


def shape_baselines(
    train: MaskData, test: MaskData, *, resolution: int = RESOLUTION, sample: int = _SAMPLE, seed: int = 0
) -> dict[str, ShapePrediction]:
    """Return the shapes that `hull`, `mean_shape` and `nearest` give for the masks of ``test``.

    They learn from the true shapes of ``train``; of ``test`` they see the masks alone. Hull and mean
    shape stand in the camera's own frame, the nearest item's shape where it stood in its camera.

    Raises UserError: the training set has no true shapes, or no items.
    """
    if train.truth is None or not len(train):
        raise UserError(
            f"{train.source or 'the training masks'}: no true shapes, and every baseline (hull, mean_shape, nearest) is made "
            "of them. Give masks that were rendered from meshes."
        )
    known = training_truth(train, train.truth, sample, resolution, seed)
    return {
        "hull": _hull(known, test),
        "mean_shape": _mean_shape(known, test),
        "nearest": _nearest(train, train.truth, test, resolution),
    }


def score_with_baselines(
    prediction: ShapePrediction,
    train: MaskData,
    test: MaskData,
    name: str,
    found: Mapping[str, ShapePrediction] | None = None,
    resolution: int = TRUE_RESOLUTION,
) -> ShapeEvaluation:
    """Return `evaluate_shapes` with every baseline's figures, and the best one's in ``overall``.

    ``found`` are baselines already made by `shape_baselines`, where several predictions of the same masks are scored;
    ``resolution`` is that of the truth's grid.

    Raises UserError: training or test masks without true shapes, other numbers of items.
    """
    if test.truth is None:
        raise UserError(f"{name}: no true shapes to compare with, only masks.")
    found = shape_baselines(train, test) if found is None else found
    scored = evaluate_all({"": prediction, **found}, test.truth, test.masks, name, test.category, resolution)
    own = scored.pop("")
    beside = {title: result.overall for title, result in scored.items()}
    overall = dict(own.overall)
    for metric in _BEST_OF:
        best = max if metric_better(metric) == "higher" else min
        overall[BEST_BASELINE + metric] = best(values[metric] for values in beside.values())
    notes = [f"baseline {title}: {note}" for title, baseline in found.items() for note in baseline.notes]
    return replace(
        own,
        overall={metric: overall[metric] for metric in sorted(overall, key=metric_order)},
        baselines=beside,
        notes=[*own.notes, *notes],
    )


def _hull(train: _TrainingTruth, test: MaskData) -> ShapePrediction:
    thickness = best_thickness(train)
    occupancy = [hull_occupancy(mask, train.distance, thickness, train.resolution) for mask in test.masks]
    note = f"each mask extruded by {thickness:.2f} of its longer side, the best on the truth of {len(train.half)} training items"
    return _in_camera("hull", occupancy, train, test, note)


def _mean_shape(train: _TrainingTruth, test: MaskData) -> ShapePrediction:
    mean = mean_shape(train)
    occupancy = [_mean_occupancy(mean, mask, train.distance) for mask in test.masks]
    where = "inside each mask" if mean.in_mask else "uncut"
    note = f"mean of {len(train.half)} true training shapes above {mean.level:.2f}, {where}, the best on them"
    return _in_camera("mean_shape", occupancy, train, test, note)


def _in_camera(
    title: str, occupancy: list[np.ndarray], train: _TrainingTruth, test: MaskData, note: str
) -> ShapePrediction:
    """Return shapes whose own frame is the camera's, the cube of the crop."""
    # Half precision: baselines of a thousand masks stay below a gigabyte.
    grids = np.array(occupancy, np.float16).reshape(-1, *[train.resolution] * 3)
    items = len(test)
    view, zero = np.repeat(np.eye(3)[None], items, 0), np.zeros((items, 2))
    return _prediction(title, test, note, grids, view, np.ones(items), zero, np.full(items, train.distance))


def _nearest(train: MaskData, truth: Placed, test: MaskData, resolution: int) -> ShapePrediction:
    rows, mirrored = nearest_masks(test.masks, train.masks)
    flip = np.ones((len(rows), 3))
    flip[mirrored, 0] = -1
    occupancy = np.zeros((len(rows), resolution, resolution, resolution), np.float16)
    for row, filled in filled_truths(truth, np.unique(rows), resolution):
        for item in np.flatnonzero(rows == row):
            occupancy[item] = filled[:, :, ::-1] if mirrored[item] else filled
    # Mirrored left to right in the image and in its own frame: a rotation again.
    view = flip[:, :, None] * truth.view[rows] * flip[:, None, :]
    offset = truth.offset[rows] * flip[:, :2]
    note = f"the true shape of the training item with the most similar mask of {len(train):,}, mirror images included"
    return _prediction("nearest", test, note, occupancy, view, truth.scale[rows], offset, truth.distance[rows])


def _prediction(title: str, test: MaskData, note: str, occupancy, view, scale, offset, distance) -> ShapePrediction:
    return ShapePrediction(
        occupancy, view, scale, offset, distance, test.masks, list(test.names), test.centre_px, test.scale_px,
        title=title, images=test.images, notes=(note,),
    )  # fmt: skip


@dataclass(frozen=True)
class _TrainingTruth:
    """True shapes on one grid of the camera frame, the cube of -1 to 1 of the crop, centroids at depth 0."""

    inside: Bool[np.ndarray, "items depth height width"]
    extruded: Bool[np.ndarray, "items depth height width"]
    """What projects into the item's mask."""
    volume: Float[np.ndarray, " items"]
    """True volumes in voxels of the grid, with what lies outside it."""
    half: Float[np.ndarray, " items"]
    """Half of the longer side of each mask's box, in units of the crop."""
    distance: float
    """Of the camera: the median."""

    @property
    def resolution(self) -> int:
        """Voxels along the grid."""
        return self.inside.shape[-1]


def training_truth(train: MaskData, truth: Placed, count: int, resolution: int, seed: int) -> _TrainingTruth:
    """Return ``count`` items of the training set, chosen by ``seed``, or all where there are no more."""
    rows = np.arange(len(train))
    if len(rows) > count:
        rows = np.sort(np.random.default_rng(seed).choice(rows, count, replace=False))
    distance = float(np.median(truth.distance))
    inside = np.zeros((len(rows), resolution, resolution, resolution), bool)
    volume = np.zeros(len(rows))
    place = {int(row): at for at, row in enumerate(rows)}
    for row, filled in filled_truths(truth, rows, resolution):
        shape = true(truth, row, filled)
        centred = shape.moved(-shape.depth)
        inside[place[row]] = centred.inside_at(voxel_centres(resolution), np.eye(3), np.zeros(3))
        volume[place[row]] = shape.volume * (resolution / 2) ** 3
    return _TrainingTruth(
        inside=inside,
        extruded=np.stack([extrusion(train.masks[row], distance, resolution) > 0.5 for row in rows]),
        volume=volume,
        half=np.array([mask_half(train.masks[row]) for row in rows]),
        distance=distance,
    )


def extrusion(mask: np.ndarray, distance: float, resolution: int) -> Float[np.ndarray, "depth height width"]:
    """Return how much of the ray through each voxel centre of the crop's cube the mask (0 to 255) covers, 0 to 1."""
    flat = _seen_at(float(distance), resolution)
    covered = torch.from_numpy(mask.astype(np.float32) / 255)[None, None]
    found = torch.nn.functional.grid_sample(covered, flat, align_corners=False)
    return found.reshape(resolution, resolution, resolution).numpy()


@functools.lru_cache(2)
def _seen_at(distance: float, resolution: int) -> Float[Tensor, "one rows columns 2"]:
    points = voxel_centres(resolution)
    image = points[..., :2] / (1 + points[..., 2:] / distance).clamp_min(0.05)
    return image.reshape(1, resolution * resolution, resolution, 2)


def mask_half(mask: np.ndarray) -> float:
    """Return half of the longer side of the mask's box, in units of the crop; 0 for an empty mask."""
    found = [np.flatnonzero((mask > 127).any(axis)) for axis in (0, 1)]
    return max((float(f[-1] - f[0] + 1) for f in found if len(f)), default=0.0) / mask.shape[0]


# `hull`: the visual hull of one view, every mask extruded along its rays by one share of its size.

_THICKNESSES = np.linspace(0.02, 1.2, 60)


def best_thickness(train: _TrainingTruth) -> float:
    """Return the thickness, in the longer side of the mask's box, with the best mean volume IoU on the training truth.

    Source: the visual hull of Laurentini (1994) from one silhouette, which bounds no depth, cut to a slab.
    """
    middle = (2 * np.arange(train.resolution) + 1) / train.resolution - 1
    layer = np.argsort(np.abs(middle), kind="stable")
    reach = np.concatenate([[0], np.sort(np.abs(middle))[1::2] + 1 / train.resolution])
    ious = np.zeros(len(_THICKNESSES))
    for inside, extruded, volume, half in zip(train.inside, train.extruded, train.volume, train.half, strict=True):
        both = (inside & extruded).sum((1, 2))[layer]
        hull = extruded.sum((1, 2))[layer]
        shared, own = (
            np.interp(_THICKNESSES * half, reach, np.concatenate([[0], x.cumsum()[1::2]])) for x in (both, hull)
        )
        ious += shared / np.maximum(own + volume - shared, 1e-12)
    return float(_THICKNESSES[ious.argmax()])


def hull_occupancy(
    mask: np.ndarray, distance: float, thickness: float, resolution: int
) -> Float[np.ndarray, "depth height width"]:
    """Return the slab of the mask's extrusion on the crop's cube: its surface is where the occupancy is 0.5."""
    depth = np.abs((2 * np.arange(resolution) + 1) / resolution - 1)
    slab = np.clip((thickness * mask_half(mask) - depth) * resolution / 2 + 0.5, 0, 1)
    return np.minimum(extrusion(mask, distance, resolution), slab[:, None, None]).astype(np.float32)


# `mean_shape`: the mean of the training shapes in the camera frame, cut at one level.

_LEVELS = np.linspace(0.02, 0.98, 49)


@dataclass(frozen=True)
class _MeanShape:
    """The mean occupancy of training shapes, and how it is cut."""

    mean: Float[np.ndarray, "depth height width"]
    level: float
    in_mask: bool
    """Whether each item's shape is what of it projects into the item's mask."""


def mean_shape(train: _TrainingTruth) -> _MeanShape:
    """Return the mean of the training shapes, cut at the level, inside the mask or not, with the best mean volume IoU on them."""
    mean = train.inside.mean(0, dtype=np.float32)
    rank = np.searchsorted(_LEVELS, mean, side="left")  # how many levels lie below each voxel's mean
    ious = np.zeros((2, len(_LEVELS)))
    everywhere = _above(rank)
    for inside, extruded, volume in zip(train.inside, train.extruded, train.volume, strict=True):
        for in_mask, (shared, own) in enumerate(
            [(_above(rank[inside]), everywhere), (_above(rank[inside & extruded]), _above(rank[extruded]))]
        ):
            ious[in_mask] += shared / np.maximum(own + volume - shared, 1e-12)
    in_mask, level = np.unravel_index(ious.argmax(), ious.shape)
    return _MeanShape(mean, float(_LEVELS[level]), bool(in_mask))


def _above(rank: np.ndarray) -> np.ndarray:
    """Return how many of the voxels are above each level."""
    return np.bincount(rank.ravel(), minlength=len(_LEVELS) + 1)[::-1].cumsum()[::-1][1:]


def _mean_occupancy(found: _MeanShape, mask: np.ndarray, distance: float) -> Float[np.ndarray, "depth height width"]:
    """Return the mean shape for one mask, scaled so that its surface is where the occupancy is 0.5."""
    occupancy = np.minimum(found.mean / (2 * found.level), 1)
    if found.in_mask:
        occupancy = np.minimum(occupancy, extrusion(mask, distance, found.mean.shape[-1]))
    return occupancy.astype(np.float32)


# `nearest`: the true shape of the training item whose mask, or its mirror image, is most like the mask.

_SIDE = 32
_CHUNK = 512


def nearest_masks(masks: np.ndarray, train: np.ndarray) -> tuple[Int[np.ndarray, " items"], Bool[np.ndarray, " items"]]:
    """Return for each mask the training mask with the best IoU, and whether that one is to be mirrored left to right.

    Both are (items side side), 0 to 255, compared at 32 x 32 pixels. Equally near: as it is before mirrored, the
    first before later ones.
    """
    known = _small(train)
    both = torch.cat([known.flatten(1), known.flip(2).flatten(1)])
    area = both.sum(1)
    found = []
    for start in range(0, len(masks), _CHUNK):
        part = _small(masks[start : start + _CHUNK]).flatten(1)
        shared = part @ both.T
        found.append((shared / (part.sum(1, keepdim=True) + area - shared).clamp_min(1)).argmax(1))
    best = torch.cat(found).numpy() if found else np.zeros(0, np.int64)
    return best % len(train), best >= len(train)


def _small(masks: np.ndarray) -> Float[Tensor, "items side side"]:
    """Return masks at the side compared at, 1 where more than half is covered."""
    parts = []
    for start in range(0, len(masks), _CHUNK):
        part = torch.from_numpy(masks[start : start + _CHUNK].astype(np.float32))[:, None]
        parts.append(torch.nn.functional.interpolate(part, (_SIDE, _SIDE), mode="area")[:, 0] > 127.5)
    return torch.cat(parts).float()
