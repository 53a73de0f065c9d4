"""The whole training set as tensors on one device: indexed, never loaded again."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from uplift.data.body_masks import mask_maps
from uplift.data.container import PoseData
from uplift.normalise import Intrinsics, Normalised, normalise
from uplift.skeleton import Skeleton

__all__ = ["Batch", "TrainingSet"]

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
