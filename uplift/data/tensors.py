"""Training data as tensors on one device, in the model's units and camera: poses, labels and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from uplift.config.settings import LifterSettings
from uplift.data.poses import PoseData, mask_maps
from uplift.data.samples import Samples
from uplift.errors import UserError
from uplift.geometry.normalise import Intrinsics, Normalised, bone_lengths, mirror, normalise
from uplift.geometry.rotation import gravity_of, turn
from uplift.skeleton import Skeleton

__all__ = ["Batch", "TrainingSet", "intrinsics_of", "mean_bones", "to_training_set", "undistorted", "with_labels"]

_INPUT = ("keypoints", "confidence", "scale", "distance", "guessed")
_BESIDE = ("labels", "label_unit", "label_tilt", "masks", "mask_map")


@dataclass(frozen=True)
class TrainingSet(Samples):
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
    body: Int[Tensor, " frames"]
    """Frames of one body have one number, from 0 without gaps (`PoseData.bodies`)."""
    fps: float | None = None
    """Frames per second, where known."""
    rotation: Float[Tensor, "frames 3 3"] | None = None
    """From the real camera's frame to that of one turned to look at the root; None without intrinsics."""
    labels: Float[Tensor, "frames joints 3"] | None = None
    """True poses in units, NaN where unlabelled; None in training from 2D alone."""
    label_unit: Float[Tensor, " frames"] | None = None
    """Of the labels' unit (mm) in one unit, NaN where unlabelled."""
    label_tilt: Float[Tensor, " frames"] | None = None
    """True tilt, radians, of the camera that looks at the root; NaN where that is not known."""
    masks: UInt8[Tensor, "frames side side"] | None = None
    """Crops of the images: 0 outside the body, 255 inside; None where the data has none."""
    mask_map: Float[Tensor, "frames 3 3"] | None = None
    """What takes normalised keypoints (x, y, 1) to the crop, (u w, v w, w): u, v from -1 to 1 over it. NaN without a mask."""
    guessed: Bool[Tensor, " frames"] | None = None
    """Frames whose `distance` is no more than a guess, for a lifter that estimates it; None for one that does not."""

    @classmethod
    def of(
        cls,
        data: PoseData,
        skeleton: Skeleton,
        *,
        count_root: bool = True,
        intrinsics: Intrinsics | None = None,
        distance: float = 10.0,
        guessed: bool | None = None,
    ) -> TrainingSet:
        """Return the training set of cleaned ``data``; its `pose`, `root` and `tilt_deg` are not used."""
        keypoints, confidence = torch.from_numpy(data.keypoints), torch.from_numpy(data.confidence)
        normal = normalise(
            keypoints, confidence, skeleton.root_index, count_root=count_root, intrinsics=intrinsics, distance=distance
        )
        return cls(
            skeleton=skeleton,
            keypoints=normal.keypoints,
            confidence=confidence,
            scale=normal.scale_px,
            distance=normal.distance,
            clip=torch.from_numpy(data.clips()),
            follows=torch.from_numpy(data.follows()),
            body=torch.from_numpy(data.bodies()),
            fps=data.fps,
            guessed=None if guessed is None else torch.full((len(data),), guessed),
            rotation=normal.rotation,
            **_masks(data, skeleton, normal, intrinsics),
        )

    def select(self, rows: Tensor | slice) -> TrainingSet:
        """Return the frames of ``rows``, a mask or indices; clips are numbered anew, and frames follow those still before them."""
        chosen = super().select(rows)
        place = torch.arange(len(self), device=self.clip.device)[rows]
        follows = chosen.follows & (place.diff(prepend=place[:1] - 2) == 1)
        clip, body = (torch.unique(value, return_inverse=True)[1] for value in (chosen.clip, chosen.body))
        return replace(chosen, clip=clip, body=body, follows=follows)

    @classmethod
    def concat(cls, parts: Sequence[Any], **changed: Any) -> TrainingSet:
        """Return the frames of all parts, one after the other; what only some know is blank for the others.

        Raises UserError: masks of different sides.
        """
        sides = [part.masks.shape[1] for part in parts if part.masks is not None]
        if len(set(sides)) > 1:
            raise UserError(
                f"Labelled frames have masks of {sides[1]} px a side, the others of {sides[0]}: expected the same."
            )
        for name in ("clip", "body"):
            counts = [int(getattr(part, name).max()) + 1 if len(part) else 0 for part in parts[:-1]]
            starts = np.cumsum([0, *counts]).tolist()
            changed[name] = torch.cat([getattr(part, name) + start for part, start in zip(parts, starts, strict=True)])
        if any(part.rotation is not None for part in parts):  # a camera that was not turned
            eye = torch.eye(3)
            parts = [p if p.rotation is not None else replace(p, rotation=eye.expand(len(p), 3, 3)) for p in parts]
        return super().concat(parts, **changed)

    def some(self, most: int, seed: int) -> TrainingSet:
        """Return about ``most`` frames, complete clips in seeded order and all that are labelled; the set itself if it has no more."""
        if len(self) <= most:
            return self
        counts = torch.bincount(self.clip)
        order = torch.randperm(len(counts), generator=torch.Generator().manual_seed(seed)).to(self.clip.device)
        # The first clip stays whatever its length, so that something does.
        kept = torch.zeros_like(counts, dtype=torch.bool)
        kept[order[: max(1, int((counts[order].cumsum(0) <= most).sum()))]] = True
        kept[self.clip[self.labelled]] = True
        return self.select(kept[self.clip])

    @property
    def labelled(self) -> Bool[Tensor, " frames"]:
        """Which frames have a true pose."""
        if self.labels is None:
            return torch.zeros_like(self.follows)
        return self.labels.isfinite().all(-1).any(-1)

    def draw(self, rows: Int[Tensor, " batch"]) -> Batch:
        """Return the frames of ``rows``."""
        columns: dict[str, Any] = {name: getattr(self, name) for name in (*_INPUT, *_BESIDE)}
        chosen: dict[str, Any] = {name: value if value is None else value[rows] for name, value in columns.items()}
        return Batch(**chosen, row=rows)


def _masks(
    data: PoseData, skeleton: Skeleton, normal: Normalised, intrinsics: Intrinsics | None
) -> dict[str, Tensor | None]:
    """Return the masks and the maps of normalised keypoints into them, where the data has any."""
    if data.masks is None:
        return {}
    rotation = None if normal.rotation is None else normal.rotation.numpy()
    maps = mask_maps(data, skeleton.root_index, normal.scale_px.numpy(), rotation, intrinsics)
    return {"masks": torch.from_numpy(data.masks), "mask_map": torch.from_numpy(maps).to(normal.scale_px.dtype)}


@dataclass(frozen=True)
class Batch(Samples):
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
    guessed: Bool[Tensor, " batch"] | None = None
    """Where `distance` is a guess; None: nowhere."""

    def beside(self) -> dict[str, Any]:
        """Return what is known of the frames beside their keypoints, by name: labels, masks, their rows."""
        return {name: getattr(self, name) for name in (*_BESIDE, "row")}

    def mirrored(self, which: Tensor, permutation: Tensor) -> Batch:
        """Return the batch with the frames of the mask ``which`` seen in a mirror.

        `masks` stay as they are: `mask_map` takes the mirrored keypoints to where the real ones are in them.
        """

        def swap(value: Tensor) -> Tensor:
            flipped = mirror(value, permutation) if value.ndim == 3 else value[:, permutation]
            return torch.where(which.view(-1, *[1] * (value.ndim - 1)), flipped, value)

        labels = None if self.labels is None else swap(self.labels)
        mask_map = self.mask_map
        if mask_map is not None:
            across = torch.where(which[:, None, None], -mask_map[..., :1], mask_map[..., :1])
            mask_map = torch.cat([across, mask_map[..., 1:]], -1)
        return replace(
            self, keypoints=swap(self.keypoints), confidence=swap(self.confidence), labels=labels, mask_map=mask_map
        )


# From `PoseData` to a training set: through which camera, in which units, with which labels.


def to_training_set(data: PoseData, skeleton: Skeleton, settings: LifterSettings) -> TrainingSet:
    """Return cleaned ``data`` in the units and the camera of ``settings``."""
    data = undistorted(data, settings)
    known = _use_camera(settings) and data.focal_px is not None and data.centre_px is not None
    return TrainingSet.of(
        data,
        skeleton,
        count_root=settings.radius == "all",
        intrinsics=intrinsics_of(data, settings),
        distance=settings.distance,
        guessed=not known if settings.cameras == "any" else None,
    )


def intrinsics_of(data: PoseData, settings: LifterSettings) -> Intrinsics | None:
    """Return the camera that ``data`` knows and the settings let be used, None otherwise.

    For a lifter of any cameras an unknown focal length is taken to be the longest side of the image: the lifter
    expects to be told one that is wrong.
    """
    if not _use_camera(settings) or data.image_size is None or data.centre_px is None:
        return None
    guess = float(max(data.image_size)) if settings.cameras == "any" else None
    focal_px = data.focal_px or guess
    return None if focal_px is None else Intrinsics(focal_px, data.centre_px)


def undistorted(data: PoseData, settings: LifterSettings) -> PoseData:
    """Return ``data`` as one ideal camera sees it, where its lenses are known and ``settings`` use them."""
    return data.straightened() if _use_camera(settings) else data


def _use_camera(settings: LifterSettings) -> bool:
    return settings.intrinsics != "off" and settings.camera != "orthographic"


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
    unit = _label_units(frames, pose.nan_to_num(), known, data.root)
    tilt = torch.full_like(unit, torch.nan)
    if data.tilt_deg is not None and frames.skeleton.gravity:
        real = torch.from_numpy(np.radians(data.tilt_deg).astype(np.float32))
        tilt = gravity_of(real, frames.rotation)[:, 2].clamp(-1, 1).asin()
    labels = (pose / unit[:, None, None]).where((labelled[:, None] & known)[..., None], torch.nan)
    return replace(
        frames, labels=labels, label_unit=unit.where(labelled, torch.nan), label_tilt=tilt.where(labelled, torch.nan)
    )


def _label_units(
    frames: TrainingSet, pose: Tensor, known: Bool[Tensor, "frames joints"], root: np.ndarray | None
) -> Tensor:
    """Return the length of one unit of the model in the unit of ``pose``."""
    both = ((frames.confidence > 0) & known).unsqueeze(-1)
    flat = pose[..., :2] * both
    by_keypoints = flat.square().sum((1, 2)) / (flat * frames.keypoints).sum((1, 2)).clamp_min(1e-9)
    if frames.rotation is None or root is None or (frames.guessed is not None and bool(frames.guessed.any())):
        return by_keypoints
    by_distance = torch.from_numpy(root).norm(dim=-1) / frames.distance
    return torch.where(by_distance.isfinite() & (by_distance > 0), by_distance, by_keypoints)


def mean_bones(frames: TrainingSet) -> Float[Tensor, " bones"] | None:
    """Return the mean length of each bone over the labelled frames, in the labels' unit; NaN where no frame has it."""
    if frames.labels is None or frames.label_unit is None:
        return None
    bones = torch.as_tensor(frames.skeleton.bone_indices.copy())
    lengths = bone_lengths(frames.labels[frames.labelled], bones) * frames.label_unit[frames.labelled, None]
    return lengths.nanmean(0)
