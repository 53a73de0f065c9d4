"""Training data as tensors on one device, in the model's units and camera: poses, labels and masks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from uplift.config.settings import LifterSettings, ShapeSettings
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData, mask_maps
from uplift.errors import UserError
from uplift.geometry.normalise import Intrinsics, Normalised, bone_lengths, normalise
from uplift.geometry.rotation import gravity_of, turn
from uplift.geometry.voxels import coverage
from uplift.skeleton import Skeleton

__all__ = [
    "SPREAD",
    "Batch",
    "MaskSet",
    "TrainingSet",
    "as_seen",
    "as_tensor",
    "frames_of",
    "intrinsics_of",
    "joined",
    "mask_set",
    "mean_bones",
    "moments",
    "recrop",
    "with_labels",
]

# The whole training set as tensors on one device: indexed, never loaded again.

_BESIDE = ("labels", "label_unit", "label_tilt", "masks", "mask_map")


@dataclass(frozen=True)
class TrainingSet:
    """Normalised keypoints of every training frame. Nothing in it came from 3D but `labels`."""

    skeleton: Skeleton
    keypoints: Float[Tensor, "frames joints 2"]
    """About the root, mean radius 1; missing joints are 0."""
    confidence: Float[Tensor, "frames joints"]
    """0..1; 0 = missing."""
    scale: Float[Tensor, " frames"]
    """Pixels per unit."""
    distance: Float[Tensor, " frames"]
    """Of the camera to the root, in units: known from intrinsics, else one guess for all."""
    clip: Int[Tensor, " frames"]
    """Frames of one clip have one number, from 0 without gaps."""
    follows: Bool[Tensor, " frames"]
    """Whether a frame is the next in time to the one before it in the file."""
    rotation: Float[Tensor, "frames 3 3"] | None = None
    """From the real camera's frame to that of one turned to look at the root; None without intrinsics."""
    labels: Float[Tensor, "frames joints 3"] | None = None
    """True poses in units, NaN where unlabelled; None in training from 2D alone."""
    label_unit: Float[Tensor, " frames"] | None = None
    """Of the labels' own unit (mm) in one unit, NaN where unlabelled."""
    label_tilt: Float[Tensor, " frames"] | None = None
    """True tilt, radians, of the camera that looks at the root; NaN where that is not known."""
    masks: UInt8[Tensor, "frames side side"] | None = None
    """Crops of the images: 0 outside the body, 255 inside; None where the data has none."""
    mask_map: Float[Tensor, "frames 3 3"] | None = None
    """What takes normalised keypoints (x, y, 1) to the crop, (u w, v w, w): u, v from -1 to 1 over it. NaN without a mask."""

    @classmethod
    def of(
        cls,
        data: PoseData,
        skeleton: Skeleton,
        *,
        count_root: bool = True,
        intrinsics: Intrinsics | None = None,
        distance: float = 10.0,
    ) -> TrainingSet:
        """Return the training set of cleaned ``data``; its `pose`, `root` and `tilt_deg` are not looked at."""
        keypoints, confidence = torch.from_numpy(data.keypoints), torch.from_numpy(data.confidence)
        normal = normalise(
            keypoints,
            confidence,
            skeleton.root_index,
            count_root=count_root,
            intrinsics=intrinsics,
            distance=distance,
        )
        return cls(
            skeleton=skeleton,
            keypoints=normal.keypoints,
            confidence=confidence,
            scale=normal.scale_px,
            distance=normal.distance,
            clip=torch.from_numpy(data.clips()),
            follows=torch.from_numpy(data.follows()),
            rotation=normal.rotation,
            **_masks(data, skeleton, normal, intrinsics),
        )

    def __len__(self) -> int:
        return len(self.keypoints)

    def to(self, device: torch.device | str) -> TrainingSet:
        """Return the same set on ``device``."""
        moved = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "skeleton"}
        return replace(self, **{k: None if v is None else v.to(device) for k, v in moved.items()})

    def part(self, rows: Tensor) -> TrainingSet:
        """Return the frames of ``rows``, a mask or indices; clips are numbered anew."""
        chosen = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "skeleton"}
        chosen = {name: None if value is None else value[rows] for name, value in chosen.items()}
        chosen["clip"] = torch.unique(chosen["clip"], return_inverse=True)[1]
        return replace(self, **chosen)

    def some(self, most: int, seed: int) -> TrainingSet:
        """Return about ``most`` frames, whole clips in seeded order and all that are labelled; the set itself if it has no more."""
        if len(self) <= most:
            return self
        counts = torch.bincount(self.clip)
        order = torch.randperm(len(counts), generator=torch.Generator().manual_seed(seed)).to(self.clip.device)
        # The first clip stays whatever its length, so that something does.
        kept = torch.zeros_like(counts, dtype=torch.bool)
        kept[order[: max(1, int((counts[order].cumsum(0) <= most).sum()))]] = True
        kept[self.clip[self.labelled]] = True
        return self.part(kept[self.clip])

    @property
    def labelled(self) -> Bool[Tensor, " frames"]:
        """Which frames have a true pose."""
        if self.labels is None:
            return torch.zeros_like(self.follows)
        return self.labels.isfinite().all(-1).any(-1)

    def draw(self, rows: Int[Tensor, " batch"]) -> Batch:
        """Return the frames of ``rows``."""
        told = {name: getattr(self, name) for name in _BESIDE}
        return Batch(
            self.keypoints[rows],
            self.confidence[rows],
            self.scale[rows],
            self.distance[rows],
            **{name: None if value is None else value[rows] for name, value in told.items()},
            row=rows,
        )


def _masks(
    data: PoseData, skeleton: Skeleton, normal: Normalised, intrinsics: Intrinsics | None
) -> dict[str, Tensor | None]:
    """Return the masks and the way from normalised keypoints into them, where the data has any."""
    if data.masks is None:
        return {}
    rotation = None if normal.rotation is None else normal.rotation.numpy()
    maps = mask_maps(data, skeleton.root_index, normal.scale_px.numpy(), rotation, intrinsics)
    return {"masks": torch.from_numpy(data.masks), "mask_map": torch.from_numpy(maps).to(normal.scale_px.dtype)}


@dataclass(frozen=True)
class Batch:
    """Some frames of a `TrainingSet`."""

    keypoints: Float[Tensor, "batch joints 2"]
    confidence: Float[Tensor, "batch joints"]
    scale: Float[Tensor, " batch"]
    distance: Float[Tensor, " batch"]
    labels: Float[Tensor, "batch joints 3"] | None = None
    label_unit: Float[Tensor, " batch"] | None = None
    label_tilt: Float[Tensor, " batch"] | None = None
    masks: UInt8[Tensor, "batch side side"] | None = None
    mask_map: Float[Tensor, "batch 3 3"] | None = None
    row: Int[Tensor, " batch"] | None = None
    """Which frames of the training set they are."""

    def __len__(self) -> int:
        return len(self.keypoints)

    def beside(self) -> dict[str, Any]:
        """Return what is known of the frames beside their keypoints, by name: labels, masks, their rows."""
        return {name: getattr(self, name) for name in (*_BESIDE, "row")}

    def mirrored(self, which: Tensor, permutation: Tensor) -> Batch:
        """Return the batch with the frames of the mask ``which`` seen in a mirror.

        `masks` stay as they are: `mask_map` takes the mirrored keypoints to where the real ones are in them.
        """

        def swap(value: Tensor) -> Tensor:
            flipped = value[:, permutation]
            if value.ndim == 3:
                flipped = torch.cat([-flipped[..., :1], flipped[..., 1:]], -1)
            return torch.where(which.view(-1, *[1] * (value.ndim - 1)), flipped, value)

        labels = None if self.labels is None else swap(self.labels)
        mask_map = self.mask_map
        if mask_map is not None:
            mask_map = torch.where(which[:, None, None], mask_map * mask_map.new_tensor([-1.0, 1.0, 1.0]), mask_map)
        return replace(
            self,
            keypoints=swap(self.keypoints),
            confidence=swap(self.confidence),
            labels=labels,
            mask_map=mask_map,
        )


# Data as a lifter sees it: through which camera, in which units.


def intrinsics_of(data: PoseData, settings: LifterSettings) -> Intrinsics | None:
    """Return the camera that ``data`` knows and the settings let be used, None otherwise."""
    if settings.intrinsics == "off" or settings.camera == "orthographic":
        return None
    if data.focal_px is None or data.centre_px is None:
        return None
    return Intrinsics(data.focal_px, data.centre_px)


def as_seen(data: PoseData, settings: LifterSettings) -> PoseData:
    """Return ``data`` as the lifter is to see it: through one ideal camera where its lenses are known and may be used."""
    use = settings.intrinsics != "off" and settings.camera != "orthographic"
    return data.straightened() if use else data


def frames_of(data: PoseData, skeleton: Skeleton, settings: LifterSettings) -> TrainingSet:
    """Return cleaned ``data`` in the units and the camera that ``settings`` say."""
    data = as_seen(data, settings)
    return TrainingSet.of(
        data,
        skeleton,
        count_root=settings.radius == "all",
        intrinsics=intrinsics_of(data, settings),
        distance=settings.distance,
    )


# True poses that training may learn from, brought into the model's units and camera.


def with_labels(frames: TrainingSet, data: PoseData) -> TrainingSet:
    """Return ``frames``, which were made of ``data``, with the poses of its `labelled` frames; unchanged without any.

    A label and its keypoints agree: with a known camera and root by the true distance, else by the
    scale that fits the label to its 2D best.
    """
    if data.labelled is None or data.pose is None or not data.labelled.any():
        return frames
    labelled = torch.from_numpy(data.labelled)
    pose = torch.from_numpy(data.pose)
    if frames.rotation is not None:
        pose = turn(pose, frames.rotation)
    known = pose.isfinite().all(-1)
    unit = _own_unit(frames, pose.nan_to_num(), known, data.root)
    tilt = torch.full_like(unit, torch.nan)
    if data.tilt_deg is not None and frames.skeleton.gravity:
        real = torch.from_numpy(np.radians(data.tilt_deg).astype(np.float32))
        tilt = gravity_of(real, frames.rotation)[:, 2].clamp(-1, 1).asin()
    labels = (pose / unit[:, None, None]).where((labelled[:, None] & known)[..., None], torch.nan)
    return replace(
        frames,
        labels=labels,
        label_unit=unit.where(labelled, torch.nan),
        label_tilt=tilt.where(labelled, torch.nan),
    )


def _own_unit(
    frames: TrainingSet, pose: Tensor, known: Bool[Tensor, "frames joints"], root: np.ndarray | None
) -> Tensor:
    """Return how much of the pose's own unit one unit of the model is."""
    both = ((frames.confidence > 0) & known).unsqueeze(-1)
    flat = pose[..., :2] * both
    by_keypoints = flat.square().sum((1, 2)) / (flat * frames.keypoints).sum((1, 2)).clamp_min(1e-9)
    if frames.rotation is None or root is None:
        return by_keypoints
    by_distance = torch.from_numpy(root).norm(dim=-1) / frames.distance
    return torch.where(by_distance.isfinite() & (by_distance > 0), by_distance, by_keypoints)


def mean_bones(frames: TrainingSet) -> Float[Tensor, " bones"] | None:
    """Return the mean length of each bone over the labelled frames, in the labels' own unit; NaN where none shows it."""
    if frames.labels is None or frames.label_unit is None:
        return None
    bones = torch.as_tensor(frames.skeleton.bone_indices.copy())
    lengths = bone_lengths(frames.labels[frames.labelled], bones) * frames.label_unit[frames.labelled, None]
    return lengths.nanmean(0)


def joined(one: TrainingSet, other: TrainingSet) -> TrainingSet:
    """Return the frames of both; what only one knows is unknown for the other's."""
    sides = [frames.masks.shape[1] for frames in (one, other) if frames.masks is not None]
    if len(set(sides)) > 1:
        raise UserError(
            f"Labelled frames have masks of {sides[1]} px a side, the others of {sides[0]}: expected the same."
        )
    both = {}
    for field in fields(TrainingSet):
        if field.name == "skeleton":
            continue
        first, second = getattr(one, field.name), getattr(other, field.name)
        if field.name == "clip":
            second = second + (int(first.max()) + 1 if len(first) else 0)
        if first is None and second is None:
            both[field.name] = None
            continue
        first = _blank(field.name, second, len(one)) if first is None else first
        second = _blank(field.name, first, len(other)) if second is None else second
        both[field.name] = torch.cat([first, second])
    return replace(one, **both)


def _blank(name: str, like: Tensor, count: int) -> Tensor:
    """Return what stands for nothing known: no turn of the camera, no label."""
    if name == "rotation":
        return torch.eye(3).expand(count, 3, 3)
    if not like.is_floating_point():  # masks
        return like.new_zeros((count, *like.shape[1:]))
    return torch.full((count, *like.shape[1:]), torch.nan)


# Masks and silhouettes brought to the same place and size: centroid at 0, the same spread along x and along y.

SPREAD = 0.4
"""Standard deviation of the pixels of a crop along x and along y, in half sides."""
_FAINT = 0.3
_LEAST = 0.03


def moments(image: Float[Tensor, "items side side"]) -> tuple[Float[Tensor, "items 2"], Float[Tensor, "items 2"]]:
    """Return the centroids (x, y) of masks or silhouettes and their spreads along x and y, in half sides of the image.

    Faint pixels do not count, so that the haze of an unfinished shape moves nothing.
    """
    weight = (image - _FAINT).clamp_min(0) + 1e-6
    weight = weight / weight.sum((1, 2), keepdim=True)
    side = image.shape[-1]
    at = (2 * torch.arange(side, device=image.device, dtype=image.dtype) + 1) / side - 1
    columns, rows = weight.sum(1), weight.sum(2)
    centre = torch.stack([columns @ at, rows @ at], -1)
    spread = torch.stack([(columns * (at - centre[:, :1]) ** 2).sum(1), (rows * (at - centre[:, 1:]) ** 2).sum(1)], -1)
    return centre, spread.sqrt().clamp_min(_LEAST)


def recrop(
    image: Float[Tensor, "items side side"],
    centre: Float[Tensor, "items 2"],
    spread: Float[Tensor, "items 2"],
    side: int,
) -> Float[Tensor, "items new new"]:
    """Return images cut out anew: ``centre`` in the middle, ``spread`` brought to `SPREAD` along each axis."""
    at = (2 * torch.arange(side, device=image.device, dtype=image.dtype) + 1) / side - 1
    x = at * (spread[:, :1] / SPREAD) + centre[:, :1]
    y = at * (spread[:, 1:] / SPREAD) + centre[:, 1:]
    points = torch.stack([x[:, None, :].expand(-1, side, -1), y[:, :, None].expand(-1, -1, side)], -1)
    return torch.nn.functional.grid_sample(image[:, None], points, align_corners=False)[:, 0]


# `MaskSet`: the masks of a training set as tensors, cut out as silhouettes are.


def as_tensor(masks: np.ndarray) -> Float[Tensor, "items side side"]:
    """Return masks of 0..255 as 0..1."""
    return torch.from_numpy(masks).float() / 255


@dataclass(frozen=True)
class MaskSet:
    """Masks and, of labelled ones, which true shape is seen from which view of the grid."""

    crops: Float[Tensor, "items side side"]
    spread: Float[Tensor, "items 2"]
    labelled: Bool[Tensor, " items"]
    view: Float[Tensor, "items 3 3"]
    """The true one; 0 where unlabelled."""
    shape: Int[Tensor, " items"]
    """Row of `shapes`; 0 where unlabelled."""
    shapes: Float[Tensor, "known depth height width"]
    """True occupancy of labelled shapes, at the mixture's detail."""

    def __len__(self) -> int:
        return len(self.crops)

    def to(self, device: Any) -> MaskSet:
        """Return the set on another device."""
        return MaskSet(*(getattr(self, part.name).to(device) for part in fields(self)))


def mask_set(data: MaskData, settings: ShapeSettings) -> MaskSet:
    """Return ``data`` as a mixture trains on it; true shapes are looked at for labelled items alone."""
    crops, spreads = [], []
    for start in range(0, len(data), 1000):
        part = as_tensor(data.masks[start : start + 1000])
        centre, spread = moments(part)
        crops.append(recrop(part, centre, spread, settings.crop))
        spreads.append(spread)
    count = len(data)
    labelled = np.zeros(count, bool) if data.labelled is None or data.truth is None else data.labelled
    view, shape = torch.zeros(count, 3, 3), torch.zeros(count, dtype=torch.long)
    shapes = torch.zeros(1, *(settings.detail,) * 3)
    if labelled.any():
        rows = np.flatnonzero(labelled)
        used, which = np.unique(data.truth.shape[rows], return_inverse=True)  # type: ignore[union-attr]
        meshes = [data.truth.meshes[number] for number in used]  # type: ignore[union-attr]
        shapes = torch.from_numpy(np.stack([coverage(mesh, settings.detail) for mesh in meshes])).float()
        view[rows] = torch.from_numpy(np.asarray(data.truth.view[rows], np.float32))  # type: ignore[union-attr]
        shape[rows] = torch.from_numpy(which)
    return MaskSet(torch.cat(crops), torch.cat(spreads), torch.from_numpy(labelled.copy()), view, shape, shapes)
