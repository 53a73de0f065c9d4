"""Refine the lifted poses of a clip jointly: one body that moves smoothly and projects to the keypoints."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import huber_loss

from uplift.config.progress import progress
from uplift.config.settings import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Camera
from uplift.geometry.normalise import bone_lengths

__all__ = ["has_clips", "refine_clips"]

_BLOCK_FRAMES = 20_000
"""Frames solved for together: few enough to stay in the processor's cache."""
_EXACT = 0.999
"""Confidence from which a keypoint is taken as exact and does not move."""
_FILLED_WEIGHT = 0.1
"""Of a joint that the lifter filled in, beside 1 of one that was seen."""
_BETAS = (0.8, 0.9)
"""Of Adam: shorter memories than usual, as there are few iterations."""
_RATE_SHARES = {"depth": 1.0, "size": 0.5, "shape": 0.25, "shift": 0.5}
"""Of the learning rate. What many joints or frames share moves more slowly than a joint's depth."""
_RATE_DECAY = 0.9
"""Share of the learning rate that is gone after the last iteration, so that it settles."""

# Where each robust term turns from square to linear, in the term's unit: a typical error of a good lifter.
_BONE_DELTA = 0.1  # log of a bone's length
_DEPTH_DELTA = 0.2  # mean 2D radii
_SHIFT_DELTA = 0.05  # mean 2D radii: errors in the image are smaller than in depth
_ACCELERATION_DELTA = 0.1  # mean 2D radii per frame squared

# Weights of the terms beside those of the settings.
_BONE_WEIGHT = 10.0  # of `settings.bones`, which brings it to the scale of the others
_SYMMETRY_WEIGHT = 1.0  # left and right bones are alike
_COMMON_WEIGHT = 0.03  # a clip's body is like those of other clips: weak, as bodies do differ
_SIZE_WEIGHT = 1.0  # frames keep the size they were lifted at
_SHAPE_SPREAD = 0.02
"""Standard deviation of log bone lengths between bodies that is always allowed."""


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
    """Return root-relative poses, near the lifted ones, of which each clip has one body and moves smoothly.

    Solved by gradient descent on robust (Huber) terms for each joint's depth (and its position in the image where
    its confidence is below 1), a size for each frame and bone lengths for each clip: bones are constant over a
    clip, joints accelerate little in the real camera's frame, and everything stays near the lifted pose. In the
    spirit of factorisation methods (Bregler et al. 2000; Akhter et al. 2011), with a lifter's depths in place
    of a basis. Frames outside clips of two or more are returned unchanged.

    Args:
        data: the frames, for confidence, clips and cameras.
        keypoints: those of ``data``, with missing joints filled in by the lifter, mean 2D radius 1.
        depth: as lifted, in the same unit.
        camera, settings: the lifter's projection; weights and number of iterations.
    """
    refined = camera.unproject(keypoints, depth, data.distance)
    if settings.iterations == 0 or not has_clips(data):
        return refined
    frames_of = torch.bincount(data.clip)
    edges = torch.nn.functional.pad(frames_of.cumsum(0), (1, 0))
    order = torch.argsort(data.clip, stable=True)
    blocks = _blocks(edges)
    for start, stop in progress(blocks, "refining clips") if len(blocks) > 1 else blocks:
        rows = order[int(edges[start]) : int(edges[stop])]
        alone = frames_of[data.clip[rows]] < 2
        solved = _solve(_Problem(data, rows, keypoints[rows], depth[rows], camera, settings), settings)
        refined[rows] = torch.where(alone[:, None, None], refined[rows], solved)
    return refined


def _blocks(edges: Int[Tensor, " clips_and_one"]) -> list[tuple[int, int]]:
    """Return the first and the last clip (exclusive) of blocks of clips that are solved together."""
    start, clips, blocks = 0, len(edges) - 1, []
    while start < clips:
        stop = int(torch.searchsorted(edges, edges[start] + _BLOCK_FRAMES, right=True)) - 1
        stop = max(start + 1, min(stop, clips))
        blocks.append((start, stop))
        start = stop
    return blocks


@torch.enable_grad()
def _solve(problem: _Problem, settings: RefineSettings) -> Tensor:
    """Return the root-relative poses that minimise the weighted sum of all terms."""
    variables = {name: getattr(problem, name) for name in _RATE_SHARES}
    groups = [{"params": [x], "share": _RATE_SHARES[name]} for name, x in variables.items() if x.requires_grad]
    optimizer = torch.optim.Adam(groups, betas=_BETAS)
    for step in range(settings.iterations):
        for group in optimizer.param_groups:
            group["lr"] = settings.rate * group["share"] * (1 - _RATE_DECAY * step / settings.iterations)
        loss = problem.loss()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        pose = problem.pose()
        return pose - pose[:, problem.root, None]


class _Problem:
    """What is solved for in some complete clips (depth, size, shape, shift), and its cost."""

    def __init__(
        self,
        data: TrainingSet,
        rows: Tensor,
        keypoints: Tensor,
        depth: Tensor,
        camera: Camera,
        settings: RefineSettings,
    ):
        self.keypoints, self.lifted_depth, self.camera, self.settings = keypoints, depth, camera, settings
        self.distance, self.root = data.distance[rows], data.skeleton.root_index
        self.rotation = None if data.rotation is None else data.rotation[rows]
        self.clip = torch.unique(data.clip[rows], return_inverse=True)[1]
        follows, confidence = data.follows[rows], data.confidence[rows]
        self.middle = (follows[1:-1] & follows[2:]).nonzero()[:, 0] + 1
        """Frames whose two neighbours in the file are their neighbours in time."""
        self.bones = torch.tensor(data.skeleton.bone_indices, device=depth.device)
        self.partner = torch.tensor(data.skeleton.bone_mirror_permutation, device=depth.device)
        self.joint_weight = torch.where(confidence > 0, 1.0, _FILLED_WEIGHT)
        self.bone_weight = self.joint_weight[:, self.bones[:, 0]] * self.joint_weight[:, self.bones[:, 1]]
        self._start()
        # Uncertain and missing joints may move in the image.
        self.loose = (confidence < _EXACT).to(depth.dtype).unsqueeze(-1)
        self.shift = torch.zeros_like(keypoints, requires_grad=bool(self.loose.any()))
        self.shift_weight = torch.where(confidence > 0, confidence.square(), settings.near / settings.seen)
        self.not_root = torch.ones_like(depth[0])
        self.not_root[self.root] = 0

    def _start(self) -> None:
        """Start at the lifted poses: their sizes, and the mean body of each clip and of all."""
        weight = self.bone_weight
        lengths = bone_lengths(self.camera.unproject(self.keypoints, self.lifted_depth, self.distance), self.bones)
        self.first_size = -((lengths * weight).sum(1) / weight.sum(1).clamp_min(1e-6)).clamp_min(1e-3).log()
        scaled = lengths.log() + self.first_size[:, None]
        shape = _group_mean(scaled, self.clip, int(self.clip.max()) + 1, weight)
        common = _group_mean(scaled, torch.zeros_like(self.clip), 1, weight)
        self.common = (common + common[:, self.partner]) / 2
        self.shape_variance = (shape - self.common).square().mean(0) + _SHAPE_SPREAD**2
        self.depth = self.lifted_depth.clone().requires_grad_()
        self.size = self.first_size.clone().requires_grad_()
        """(frames,) log of the factor that makes all frames of a body equally large."""
        self.shape = shape.clone().requires_grad_()
        """(clips bones) log lengths of the bones of each clip's body."""

    def pose(self) -> Tensor:
        """Return the poses that the variables describe."""
        keypoints, depth = self.keypoints + self.shift * self.loose, self.depth * self.not_root
        return self.camera.unproject(keypoints, depth, self.distance)

    def loss(self) -> Tensor:
        """Return the weighted sum of all terms."""
        settings, shape, pose = self.settings, self.shape, self.pose()
        bones = (bone_lengths(pose, self.bones).log() + self.size[:, None] - shape[self.clip]) * self.bone_weight
        loss = settings.bones * _BONE_WEIGHT * _robust(bones, _BONE_DELTA).sum(1).mean()
        near = _robust(self.depth - self.lifted_depth, _DEPTH_DELTA) * self.joint_weight
        loss = loss + settings.near * near.sum(1).mean()
        if self.shift.requires_grad:
            shifts = _robust(self.shift, _SHIFT_DELTA).sum(-1) * self.shift_weight
            loss = loss + settings.seen * shifts.sum(1).mean()
        loss = loss + _SYMMETRY_WEIGHT * (shape - shape[:, self.partner]).square().sum(1).mean()
        loss = loss + _COMMON_WEIGHT * ((shape - self.common).square() / self.shape_variance).mean()
        loss = loss + _SIZE_WEIGHT * (self.size - self.first_size).square().mean()
        if settings.smooth and len(self.middle):
            loss = loss + settings.smooth * self._acceleration(pose)
        return loss

    def _acceleration(self, pose: Tensor) -> Tensor:
        """Return the robust acceleration of the joints in the real camera's frame."""
        place = torch.cat([pose[..., :2], pose[..., 2:] + self.distance[:, None, None]], -1)
        place = place * self.size.exp()[:, None, None]
        if self.rotation is not None:
            place = place @ self.rotation  # row vectors times R: back to the real camera
        at = self.middle
        second = place[at - 1] - 2 * place[at] + place[at + 1]
        # Missing joints count too: this fills them in from the frames around them.
        return _robust(second, _ACCELERATION_DELTA).sum(-1).sum(1).mean()


def _robust(value: Tensor, delta: float) -> Tensor:
    return huber_loss(value, torch.zeros_like(value), delta=delta, reduction="none")


def _group_mean(
    value: Float[Tensor, "frames values"],
    group: Int[Tensor, " frames"],
    groups: int,
    weight: Float[Tensor, "frames values"],
) -> Float[Tensor, "groups values"]:
    """Return each group's weighted mean; 0 where all weights are 0."""
    total = value.new_zeros(groups, value.shape[1]).index_add_(0, group, value * weight)
    return total / value.new_zeros(groups, value.shape[1]).index_add_(0, group, weight).clamp_min(1e-6)
