"""`score_2d`: how good a lifter of keypoints is, from 2D alone, to choose between lifters where there is no truth.

The score is a sum of figures, each a length in mean 2D radii of the body, as errors are:

- ``unrealistic``: distance of a rotated view to the nearest real picture of another scene, beyond that between real
  pictures (a correctly lifted pose still looks real when it is turned: Kudo et al. 2018);
- ``uncovered``: distance of a real picture to the nearest rotated view, likewise: large where all poses are alike.
  The sum of both is a Chamfer distance between two sets of pictures; no critic has to be trained;
- ``bones``: mean absolute deviation of a bone from its median over a body, with all frames brought to one size;
- ``mirrored``: share of frames with the wrong handedness, times twice the mean depth, which is how far a depth flip
  moves a joint. Real bodies twist, so that a skeleton's share may be above 0 for the truth;
- ``relift``: error of a view that is lifted again, after the best rotation and scale (self-consistency: Chen et al.
  2019). It sees poses that are flipped at random, which the pictures do not;
- ``uneven``: Wasserstein distance between the extents of bones across and along the line of sight, in the level
  frame: the two are distributed equally over bodies that are seen from all sides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.data.clean import clean
from uplift.data.confidence import calibrated
from uplift.data.names import codes_of
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.errors import UserError
from uplift.geometry.normalise import bone_lengths, renormalise
from uplift.geometry.rigid import quaternion_entries
from uplift.geometry.rotation import about_y, nearest_rotation, turn
from uplift.metrics.pose_metrics import facing_sign, has_handedness
from uplift.models.lifter import Lifted
from uplift.models.model import Model
from uplift.models.predict import lift_frames, with_estimated_distance
from uplift.skeleton import Skeleton

__all__ = ["LEAST_FRAMES", "WEIGHTS", "score_2d"]

WEIGHTS = {"unrealistic": 1.0, "uncovered": 1.0, "bones": 1.0, "mirrored": 1.0, "relift": 0.2, "uneven": 0.2}
"""How much each figure counts in the score."""

LEAST_FRAMES = 20
"""Frames that a score needs."""
_VIEWS = 3
"""Random views of each pose that are compared with real pictures."""
_BLOCKS = 10
"""Parts of a single film: its pictures are compared with those of other parts."""
_FEWEST_BODY = 5
"""Frames of a body whose bone lengths say how much they vary."""
_FEWEST_JOINTS = 3


@torch.no_grad()
def score_2d(
    model: Model,
    data: PoseData,
    *,
    seed: int = 0,
    most: int = 2000,
    azimuth_deg: tuple[float, float] = (-180.0, 180.0),
) -> dict[str, float]:
    """Return ``score_2d``, lower is better, and the figures that it is the sum of, times their `WEIGHTS`.

    Frames are lifted one by one, and each pose is seen from random views: about gravity, or from anywhere without it.
    What the data or the skeleton does not allow is left out. A score has no meaning by itself, and may be below 0:
    compare lifters of one skeleton on the same frames, with the same ``seed`` and ``most``. `pose`, `root` and
    `tilt_deg` of the data are not used. The score of poses that are not finite is infinite.

    Args:
        model: lifter, skeleton and settings; its lifter is left as it was.
        data: held-out frames with the joints of the skeleton, in its order.
        seed: of the frames and the views; the global random state is neither used nor changed.
        most: frames at most, drawn at random.
        azimuth_deg: range of the turn about gravity, as `views.azimuth_deg` of the fit.

    Raises:
        UserError: fewer than 20 frames that can be lifted.
    """
    generator = torch.Generator().manual_seed(seed)
    data, frames = _frames(model, data, generator, most)
    with _evaluating(model.lifter):
        lifted = lift_frames(model.lifter, frames, both_ways=model.settings.both_ways)
        frames = with_estimated_distance(frames, lifted)
        views = [_view(model, frames, lifted, generator, azimuth_deg) for _ in range(_VIEWS)]
        if not all(view.keypoints.isfinite().all() for view in views):
            return {"score_2d": math.inf}
        relift = _relift(model, frames, lifted, views[0])
    pictures = torch.stack([view.keypoints for view in views])
    figures = {**_two_samples(frames, pictures, _scenes(data)), "relift": relift}
    figures |= {**_uneven(frames, lifted, azimuth_deg), **_bones(frames, lifted, data), **_mirrored(frames, lifted)}
    total = sum(WEIGHTS[name] * value for name, value in figures.items())
    finite = {name: value for name, value in figures.items() if math.isfinite(value)}
    return {"score_2d": total if len(finite) == len(figures) else math.inf, **finite}


def _frames(model: Model, data: PoseData, generator: torch.Generator, most: int) -> tuple[PoseData, TrainingSet]:
    """Return at most ``most`` frames that can be lifted, in their order, and the same in the model's units."""
    data, _ = clean(data.without_truth(), model.skeleton)
    if len(data) < LEAST_FRAMES:
        raise UserError(
            f"{data.source or 'the data'}: {len(data)} frames can be lifted, expected {LEAST_FRAMES} or more to compare pictures with (of held-out frames: raise val=)."
        )
    rows = torch.randperm(len(data), generator=generator)[:most].sort().values.numpy()
    data = calibrated(data, model.skeleton, model.settings).select(rows)
    device = next(model.lifter.parameters()).device
    return data, to_training_set(data, model.skeleton, model.settings).to(device)


@contextmanager
def _evaluating(lifter: torch.nn.Module) -> Iterator[None]:
    """Put the lifter into evaluation mode for a while, and every part of it back as it was."""
    modes = [(part, part.training) for part in lifter.modules()]
    lifter.eval()
    try:
        yield
    finally:
        for part, mode in modes:
            part.training = mode


# Rotated views.


@dataclass(frozen=True)
class _View:
    """One random view of each pose."""

    rotation: Float[Tensor, "frames 3 3"]
    keypoints: Float[Tensor, "frames joints 2"]
    """Normalised as real ones are."""
    scale: Float[Tensor, " frames"]
    """Units of the pose per unit of `keypoints`."""


def _view(
    model: Model, frames: TrainingSet, lifted: Lifted, generator: torch.Generator, azimuth_deg: tuple[float, float]
) -> _View:
    """Return a random view of each pose through the tilt of another frame's camera."""
    rotation = _rotations(lifted, generator, azimuth_deg, model.skeleton.gravity)
    seen = model.lifter.camera.project(turn(lifted.pose, rotation), frames.distance)
    count_root = model.settings.radius == "all"
    keypoints, scale = renormalise(seen, frames.confidence, model.skeleton.root_index, count_root=count_root)
    return _View(rotation, keypoints, scale)


def _rotations(
    lifted: Lifted, generator: torch.Generator, azimuth_deg: tuple[float, float], gravity: bool
) -> Float[Tensor, "frames 3 3"]:
    count, levelled = len(lifted), lifted.levelling()
    if not gravity:  # uniform on SO(3), from unit quaternions (Shoemake 1992)
        quaternion = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1)
        return torch.stack(quaternion_entries(*quaternion.unbind(-1)), -1).reshape(count, 3, 3).to(levelled)
    low, high = (math.radians(angle) for angle in azimuth_deg)
    azimuth = (low + (high - low) * torch.rand(count, generator=generator)).to(levelled)
    other = torch.randperm(count, generator=generator).to(levelled.device)
    return levelled[other].mT @ about_y(azimuth) @ levelled


def _relift(model: Model, frames: TrainingSet, lifted: Lifted, view: _View) -> float:
    """Return the mean distance of the joints of a view lifted again to the pose, after the best rotation and scale."""
    again = _relifted(model, frames, view)
    if not again.isfinite().all():
        return math.inf
    weight = (frames.confidence > 0).to(again.dtype)
    return float((_aligned_distance(again, lifted.pose, weight) * weight).sum() / weight.sum())


def _relifted(model: Model, frames: TrainingSet, view: _View) -> Float[Tensor, "frames joints 3"]:
    """Return the views lifted again and turned back, relative to the root, in units of the first poses."""
    keypoints = view.keypoints * (frames.confidence > 0)[..., None]
    lift = model.lifter.lift_both_ways if model.settings.both_ways else model.lifter
    again = lift(keypoints, frames.confidence, frames.distance / view.scale).pose * view.scale[:, None, None]
    return turn(again - again[:, model.skeleton.root_index, None], view.rotation.mT)


def _aligned_distance(
    one: Float[Tensor, "frames joints 3"],
    other: Float[Tensor, "frames joints 3"],
    weight: Float[Tensor, "frames joints"],
) -> Float[Tensor, "frames joints"]:
    """Return the distance of each joint of ``one``, after the best similarity without reflection, to ``other``."""
    share = (weight / weight.sum(1, keepdim=True))[..., None]
    one, other = (pose - (pose * share).sum(1, keepdim=True) for pose in (one, other))
    rotation = nearest_rotation((other * share).mT @ one)
    turned = turn(one, rotation)
    size = (turned.square() * share).sum((1, 2)).clamp_min(1e-12)
    scale = ((turned * other * share).sum((1, 2)) / size).clamp_min(0)
    return (turned * scale[:, None, None] - other).norm(dim=-1)


# Two sets of pictures: those the camera took, and the views.


def _two_samples(
    frames: TrainingSet, pictures: Float[Tensor, "views frames joints 2"], scene: Int[Tensor, " frames"]
) -> dict[str, float]:
    """Return how far views are from the nearest real picture and real pictures from the nearest view, of other scenes."""
    seen = (frames.confidence > 0).to(pictures.dtype)
    same = (scene[:, None] == scene).to(seen.device)
    usual = _nearest(_distances(frames.keypoints, frames.keypoints, seen), same)
    if usual.isnan().all():
        return {}
    unrealistic, uncovered = [], []
    for view in pictures:
        apart = _distances(view, frames.keypoints, seen)
        unrealistic.append(_nearest(apart, same) - usual)
        uncovered.append(_nearest(apart.mT, same) - usual)
    return {
        "unrealistic": float(torch.stack(unrealistic).nanmean()),
        "uncovered": float(torch.stack(uncovered).nanmean()),
    }


def _distances(
    one: Float[Tensor, "frames joints 2"], other: Float[Tensor, "frames joints 2"], seen: Float[Tensor, "frames joints"]
) -> Float[Tensor, "frames frames"]:
    """Return root mean square distances over the joints that both pictures show; infinite where they are too few."""
    one, other = one * seen[..., None], other * seen[..., None]
    shared = seen @ seen.mT
    total = one.square().sum(-1) @ seen.mT + seen @ other.square().sum(-1).mT - 2 * one.flatten(1) @ other.flatten(1).mT
    apart = (total / shared.clamp_min(1)).clamp_min(0).sqrt()
    return apart.masked_fill(shared < _FEWEST_JOINTS, torch.inf)


def _nearest(apart: Float[Tensor, "frames frames"], same: Bool[Tensor, "frames frames"]) -> Float[Tensor, " frames"]:
    """Return the least distance to a frame of another scene; NaN where there is none to compare with."""
    least = apart.masked_fill(same, torch.inf).min(1).values
    return least.masked_fill(least.isinf(), torch.nan)


def _scenes(data: PoseData) -> Int[Tensor, " frames"]:
    """Return numbers that frames of one motion share, whatever the camera; parts of a film where there are few motions."""
    keys = [data.identity[key].astype(str) for key in ("subject", "sequence", "instance") if key in data.identity]
    if "sequence" not in data.identity or data.stills:
        return torch.arange(len(data))
    scene = codes_of(np.array([" ".join(names) for names in zip(*keys, strict=True)]))[1]
    if np.bincount(scene).max() > len(data) / 2:
        place = np.empty(len(data), np.int64)
        place[data.in_order()] = np.arange(len(data))
        scene = place * _BLOCKS // len(data)
    return torch.from_numpy(scene)


# What the poses themselves show.


def _uneven(frames: TrainingSet, lifted: Lifted, azimuth_deg: tuple[float, float]) -> dict[str, float]:
    """Return the mean over bones of the Wasserstein distance of their x and z in the level frame."""
    gravity = frames.skeleton.gravity
    if gravity and azimuth_deg[1] - azimuth_deg[0] < 360:
        return {}
    pose = turn(lifted.pose, lifted.levelling()) if gravity else lifted.pose
    pairs, seen = _bone_ends(frames)
    bones = pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]]
    found = [bones[rows, place] for place, rows in enumerate(seen.unbind(1)) if int(rows.sum()) >= _FEWEST_BODY]
    apart = [(bone[:, 0].sort().values - bone[:, 2].sort().values).abs().mean() for bone in found]
    return {"uneven": float(torch.stack(apart).mean())} if apart else {}


def _bone_ends(frames: TrainingSet) -> tuple[Int[Tensor, "bones 2"], Bool[Tensor, "frames bones"]]:
    """Return the joints that each bone is between, and whether both are visible."""
    pairs = torch.tensor(frames.skeleton.bone_indices)
    return pairs, (frames.confidence > 0)[:, pairs].all(-1)


def _bones(frames: TrainingSet, lifted: Lifted, data: PoseData) -> dict[str, float]:
    """Return how much bones vary over the frames of a body; over all frames where bodies have too few each."""
    pairs, seen = _bone_ends(frames)
    if not seen.any():
        return {}
    lengths = bone_lengths(lifted.pose, pairs).where(seen, torch.nan)
    size = (lengths / lengths.nanmean(0)).nanmean(1, keepdim=True)
    lengths = lengths / size
    body = data.bodies()
    numbers, counts = np.unique(body, return_counts=True)
    groups = [
        torch.from_numpy(body == one) for one, count in zip(numbers, counts, strict=True) if count >= _FEWEST_BODY
    ]
    groups = groups or [torch.ones(len(body), dtype=torch.bool)]
    found = torch.stack([_deviation(lengths[rows.to(lengths.device)]) for rows in groups]).nanmean()
    return {"bones": float(found)}


def _deviation(lengths: Float[Tensor, "frames bones"]) -> Float[Tensor, ""]:
    """Return the mean absolute deviation from the median of each bone that is known, averaged."""
    return (lengths - lengths.nanmedian(0).values).abs().nanmean(0).nanmean()


def _mirrored(frames: TrainingSet, lifted: Lifted) -> dict[str, float]:
    """Return the share of frames with the wrong handedness, times how far flipping a depth moves a joint."""
    skeleton: Skeleton = frames.skeleton
    if not has_handedness(skeleton):
        return {}
    seen = (frames.confidence > 0)[..., None]
    pose = turn(lifted.pose, lifted.levelling()) if skeleton.gravity else lifted.pose
    sign = facing_sign(pose.where(seen, torch.nan).cpu().numpy(), skeleton)
    known = np.isfinite(sign)
    if not known.any():
        return {}
    depth = float((lifted.pose[..., 2:].abs() * seen).sum() / seen.sum())
    return {"mirrored": 2 * depth * float(1 - sign[known].mean())}
