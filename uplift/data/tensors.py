"""The whole training set as tensors on one device: indexed, never loaded again."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.data.container import PoseData
from uplift.normalise import Intrinsics, normalise
from uplift.skeleton import Skeleton

__all__ = ["Batch", "TrainingSet"]


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
        told = {name: getattr(self, name) for name in ("labels", "label_unit", "label_tilt")}
        return Batch(
            self.keypoints[rows],
            self.confidence[rows],
            self.scale[rows],
            self.distance[rows],
            **{name: None if value is None else value[rows] for name, value in told.items()},
        )


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

    def __len__(self) -> int:
        return len(self.keypoints)

    def mirrored(self, which: Tensor, permutation: Tensor) -> Batch:
        """Return the batch with the frames of the mask ``which`` seen in a mirror."""

        def swap(value: Tensor) -> Tensor:
            flipped = value[:, permutation]
            if value.ndim == 3:
                flipped = torch.cat([-flipped[..., :1], flipped[..., 1:]], -1)
            return torch.where(which.view(-1, *[1] * (value.ndim - 1)), flipped, value)

        labels = None if self.labels is None else swap(self.labels)
        return replace(self, keypoints=swap(self.keypoints), confidence=swap(self.confidence), labels=labels)
