"""Mend the lifted poses of a clip together: one body, moving smoothly, seen as it was seen."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import huber_loss

from uplift.config.settings import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Camera
from uplift.geometry.normalise import bone_lengths

__all__ = ["has_clips", "refine_clips"]

_BLOCK_FRAMES = 20_000
_EXACT = 0.999
"""Confidence from which a keypoint is taken as exact."""


def has_clips(data: TrainingSet) -> bool:
    """Return whether any two frames belong to one clip."""
    return bool(len(data)) and int(torch.bincount(data.clip).max()) > 1


def refine_clips(
    data: TrainingSet,
    keypoints: Float[Tensor, "frames joints 2"],
    depth: Float[Tensor, "frames joints"],
    camera: Camera,
    settings: RefineSettings,
) -> Float[Tensor, "frames joints 3"]:
    """Return poses near those given for which each clip has one body and moves smoothly.

    ``keypoints`` are those of the data with missing joints as the lifter filled them in. A keypoint
    of full confidence stays as it was seen; a doubtful one may move, the farther the less is known of
    it. Solved for by gradient descent on robust (Huber) terms: a depth and where it is free a place
    for each joint, a size for each frame and bone lengths for each clip, so that bones are as in the
    rest of the clip, joints accelerate little in the real camera's frame, and all is near what the
    lifter said. In the spirit of the factorisation methods the paper names (Bregler et al. 2000;
    Akhter et al. 2011), with a learned lifter's depths in place of a basis. Frames that belong to no
    clip of two or more come back as they were.
    """
    refined = camera.unproject(keypoints, depth, data.distance)
    if settings.iterations == 0 or not has_clips(data):
        return refined
    # Blocks of whole clips: small enough to stay in the processor's cache.
    frames_of = torch.bincount(data.clip)
    edges = torch.cat([data.clip.new_zeros(1), frames_of.cumsum(0)])
    order = torch.argsort(data.clip, stable=True)
    start = 0
    while start < len(frames_of):
        stop = int(torch.searchsorted(edges, edges[start] + _BLOCK_FRAMES, right=True)) - 1
        stop = max(start + 1, min(stop, len(frames_of)))
        rows = order[int(edges[start]) : int(edges[stop])]
        alone = frames_of[data.clip[rows]] < 2
        solved = _solve(_Block.of(data, rows, keypoints[rows], depth[rows], camera), settings)
        refined[rows] = torch.where(alone[:, None, None], refined[rows], solved)
        start = stop
    return refined


@dataclass(frozen=True)
class _Block:
    """Some whole clips, and what is known of them."""

    keypoints: Tensor
    depth: Tensor
    distance: Tensor
    rotation: Tensor | None
    confidence: Tensor
    clip: Tensor
    middle: Tensor
    """Frames whose two neighbours in the file are their neighbours in time."""
    bones: Tensor
    partner: Tensor
    """The bone that mirrors each bone; itself where there is none."""
    root: int
    camera: Camera

    @classmethod
    def of(cls, data: TrainingSet, rows: Tensor, keypoints: Tensor, depth: Tensor, camera: Camera) -> _Block:
        follows = data.follows[rows]
        bones = torch.as_tensor(data.skeleton.bone_indices.copy(), device=depth.device)
        partner = torch.as_tensor(data.skeleton.bone_mirror_permutation.copy(), device=depth.device)
        return cls(
            keypoints=keypoints,
            depth=depth,
            distance=data.distance[rows],
            rotation=None if data.rotation is None else data.rotation[rows],
            confidence=data.confidence[rows],
            clip=torch.unique(data.clip[rows], return_inverse=True)[1],
            middle=(follows[1:-1] & follows[2:]).nonzero()[:, 0] + 1,
            bones=bones,
            partner=partner,
            root=data.skeleton.root_index,
            camera=camera,
        )

    @property
    def known(self) -> Tensor:
        """How much a joint says: all where it was seen, a little where it was filled in."""
        return torch.where(self.confidence > 0, 1.0, 0.1)


@torch.enable_grad()
def _solve(block: _Block, settings: RefineSettings) -> Tensor:
    """Return the poses, relative to their roots, that weigh all terms best."""
    clips = int(block.clip.max()) + 1
    known = block.known
    pose = block.camera.unproject(block.keypoints, block.depth, block.distance)
    lengths = bone_lengths(pose, block.bones)
    sure = known[:, block.bones[:, 0]] * known[:, block.bones[:, 1]]
    first_size = -((lengths * sure).sum(1) / sure.sum(1).clamp_min(1e-6)).clamp_min(1e-3).log()
    shape = _group_mean(lengths.log() + first_size[:, None], block.clip, clips, sure)
    common = _group_mean(lengths.log() + first_size[:, None], torch.zeros_like(block.clip), 1, sure)
    common = (common + common[:, block.partner]) / 2
    spread = (shape - common).square().mean(0) + 0.02**2
    depth, size, shape = (x.clone().requires_grad_() for x in (block.depth, first_size, shape))
    # What may move in the image: doubtful joints and missing ones.
    loose = (block.confidence < _EXACT).to(depth.dtype).unsqueeze(-1)
    shift = torch.zeros_like(block.keypoints, requires_grad=bool(loose.any()))
    held = torch.where(block.confidence > 0, block.confidence.square(), settings.near / settings.seen)
    steps = [(depth, 1.0), (size, 0.5), (shape, 0.25), *([(shift, 0.5)] if shift.requires_grad else [])]
    optimizer = torch.optim.Adam([{"params": [p], "share": s} for p, s in steps], betas=(0.8, 0.9))
    free = torch.ones_like(block.depth[0])
    free[block.root] = 0
    for step in range(settings.iterations):
        for group in optimizer.param_groups:
            group["lr"] = settings.rate * group["share"] * (1 - 0.9 * step / settings.iterations)
        pose = block.camera.unproject(block.keypoints + shift * loose, depth * free, block.distance)
        off = (bone_lengths(pose, block.bones).log() + size[:, None] - shape[block.clip]) * sure
        loss = settings.bones * 10 * _robust(off, 0.1).sum(1).mean()
        loss = loss + settings.near * (_robust(depth - block.depth, 0.2) * known).sum(1).mean()
        if shift.requires_grad:
            loss = loss + settings.seen * (_robust(shift, 0.05).sum(-1) * held).sum(1).mean()
        loss = loss + (shape - shape[:, block.partner]).square().sum(1).mean()
        loss = loss + 0.03 * ((shape - common).square() / spread).mean()
        loss = loss + (size - first_size).square().mean()
        if settings.smooth and len(block.middle):
            loss = loss + settings.smooth * _acceleration(block, pose, size)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        pose = block.camera.unproject(block.keypoints + shift * loose, depth * free, block.distance)
        return pose - pose[:, block.root, None]


def _acceleration(block: _Block, pose: Tensor, size: Tensor) -> Tensor:
    """Return the robust second difference of the joints' places in the real camera's frame."""
    place = torch.cat([pose[..., :2], pose[..., 2:] + block.distance[:, None, None]], -1)
    place = place * size.exp()[:, None, None]
    if block.rotation is not None:
        place = place @ block.rotation  # rows times R are R transposed times columns: back to the camera
    at = block.middle
    second = place[at - 1] - 2 * place[at] + place[at + 1]
    # A joint that was not seen still moves smoothly: so it is filled in from the frames around it.
    return _robust(second, 0.1).sum(-1).sum(1).mean()


def _robust(value: Tensor, delta: float) -> Tensor:
    return huber_loss(value, torch.zeros_like(value), delta=delta, reduction="none")


def _group_mean(
    value: Float[Tensor, "frames values"],
    group: Int[Tensor, " frames"],
    groups: int,
    weight: Float[Tensor, "frames values"],
) -> Float[Tensor, "groups values"]:
    """Return each group's weighted mean; 0 where nothing weighs."""
    total = value.new_zeros(groups, value.shape[1]).index_add_(0, group, value * weight)
    return total / value.new_zeros(groups, value.shape[1]).index_add_(0, group, weight).clamp_min(1e-6)
