"""Refine the lifted poses of a clip jointly: one body that moves smoothly and projects to the keypoints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from uplift.config import ranks
from uplift.config.progress import progress
from uplift.config.settings import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Camera
from uplift.geometry.normalise import bone_lengths

__all__ = ["has_clips", "refine_clips"]

_BLOCK_FRAMES = 4000
"""Frames solved for together: few enough to stay in the processor's cache."""
_BLOCK_FRAMES_ELSEWHERE = 50_000
"""On other devices: enough to keep them busy."""
_EXACT = 0.999
"""Confidence from which a keypoint is taken as exact and does not move."""
_FILLED_WEIGHT = 0.1
"""Of a joint that the lifter filled in, beside 1 of one that was seen."""
_BETAS = (0.8, 0.9)
"""Of Adam: shorter memories than usual, as there are few iterations."""
_EPSILON = 1e-8
"""Of Adam."""
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
_TINY = 1e-8
"""Added to squared lengths, whose logarithms are finite then."""


def has_clips(data: TrainingSet) -> bool:
    """Return whether any two frames belong to one clip."""
    return bool(len(data)) and int(torch.bincount(data.clip).max()) > 1


@torch.no_grad()
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
    rows = torch.argsort(data.clip, stable=True)
    rows = rows[torch.bincount(data.clip)[data.clip[rows]] > 1]
    whole = _Bodies.of(data, rows, refined[rows])
    most = _BLOCK_FRAMES if depth.device.type == "cpu" else _BLOCK_FRAMES_ELSEWHERE
    blocks = _blocks(torch.bincount(whole.clip), most)
    mine = ranks.my_parts(blocks)
    for frames, clips in progress(mine, "refining clips") if len(mine) > 1 else mine:
        part = rows[frames]
        bodies = whole.part(frames, clips)
        problem = _Problem(data, part, keypoints[part], depth[part], camera, settings, bodies)
        refined[part] = _solve(problem, settings)
    return ranks.filled(refined, [rows[frames] for frames, _ in blocks])


def _blocks(frames_of: Int[Tensor, " clips"], most: int) -> list[tuple[slice, slice]]:
    """Return blocks of whole clips, of ``most`` frames or one clip, that are solved together: their frames and clips."""
    edges = pad(frames_of.cumsum(0), (1, 0))
    start, clips, blocks = 0, len(frames_of), []
    while start < clips:
        stop = int(torch.searchsorted(edges, edges[start] + most, right=True)) - 1
        stop = max(start + 1, stop)
        blocks.append((slice(int(edges[start]), int(edges[stop])), slice(start, stop)))
        start = stop
    return blocks


# What the descent works on. All arrays have frames last, so that every operation is one sweep over memory.


@dataclass(frozen=True)
class _Bodies:
    """The sizes and bodies of the lifted poses, at which the descent starts, and what they are compared with."""

    clip: Int[Tensor, " frames"]
    middle: Bool[Tensor, " frames"]
    """Frames whose two neighbours in the file are their neighbours in time."""
    size: Float[Tensor, " frames"]
    """Log of the factor that makes all frames of a body equally large."""
    shape: Float[Tensor, "bones clips"]
    """Mean log lengths of the bones of each clip's body, all bodies equally large."""
    common: Float[Tensor, "bones 1"]
    """Those of the mean body, left and right alike."""
    variance: Float[Tensor, "bones 1"]
    """Of `shape` about `common`."""
    frames_per_clip: float
    frames_per_middle: float

    @classmethod
    def of(cls, data: TrainingSet, rows: Tensor, pose: Float[Tensor, "frames joints 3"]) -> _Bodies:
        """Return those of the frames ``rows``, complete clips one after the other, lifted as ``pose``."""
        clip, follows = torch.unique(data.clip[rows], return_inverse=True)[1], data.follows[rows]
        bones = torch.tensor(data.skeleton.bone_indices, device=pose.device)
        weight = _joint_weight(data.confidence[rows])[:, bones].prod(-1)
        lengths = bone_lengths(pose, bones)
        size = -((lengths * weight).sum(1) / weight.sum(1).clamp_min(1e-6)).clamp_min(1e-3).log()
        scaled, clips = lengths.log() + size[:, None], int(clip.max()) + 1
        shape = _group_mean(scaled, clip, clips, weight)
        common = _group_mean(scaled, torch.zeros_like(clip), 1, weight)
        partner = torch.tensor(data.skeleton.bone_mirror_permutation, device=pose.device)
        common = (common + common[:, partner]) / 2
        variance = (shape - common).square().mean(0, keepdim=True) + _SHAPE_SPREAD**2
        middle = follows & pad(follows[1:], (0, 1))
        per_middle = len(rows) / max(int(middle.sum()), 1)
        return cls(clip, middle, size, shape.T, common.T, variance.T, len(rows) / clips, per_middle)

    def part(self, frames: slice, clips: slice) -> _Bodies:
        """Return the bodies of some complete clips."""
        chosen = {name: getattr(self, name)[frames] for name in ("clip", "middle", "size")}
        chosen["clip"] = chosen["clip"] - clips.start
        return replace(self, **chosen, shape=self.shape[:, clips])


def _joint_weight(confidence: Tensor) -> Tensor:
    return torch.where(confidence > 0, 1.0, _FILLED_WEIGHT).to(confidence.dtype)


def _group_mean(
    value: Float[Tensor, "frames values"],
    group: Int[Tensor, " frames"],
    groups: int,
    weight: Float[Tensor, "frames values"],
) -> Float[Tensor, "groups values"]:
    """Return each group's weighted mean; 0 where all weights are 0."""
    total = value.new_zeros(groups, value.shape[1]).index_add_(0, group, value * weight)
    return total / value.new_zeros(groups, value.shape[1]).index_add_(0, group, weight).clamp_min(1e-6)


class _Problem:
    """What is solved for in some complete clips (depth, size, shape, shift), and the gradient of its cost.

    The cost is summed over frames; terms of a clip count as often as a clip has frames in the mean. H is Huber's
    loss, whose derivative is its argument, clamped to the delta at which H turns linear. Each method of a term has its
    formula, and adds its derivatives to those by what the term depends on.
    """

    def __init__(
        self,
        data: TrainingSet,
        rows: Int[Tensor, " frames"],
        keypoints: Float[Tensor, "frames joints 2"],
        depth: Float[Tensor, "frames joints"],
        camera: Camera,
        settings: RefineSettings,
        bodies: _Bodies,
    ):
        self.camera, self.settings, self.bodies = camera, settings, bodies
        self.distance, self.root = data.distance[rows], data.skeleton.root_index
        self.rotation = None if data.rotation is None else data.rotation[rows].permute(1, 2, 0).contiguous()
        self.parent, self.child = torch.tensor(data.skeleton.bone_indices, device=depth.device).T
        self.partner = torch.tensor(data.skeleton.bone_mirror_permutation, device=depth.device)
        self.keypoints = keypoints.permute(2, 1, 0).contiguous()
        self.lifted = depth.T.clone(memory_format=torch.contiguous_format)
        self.lifted[self.root] = 0
        self._weigh(data.confidence[rows].T.contiguous())
        self.variables = {"depth": self.lifted.clone(), "size": bodies.size.clone()}
        self.variables["shape"] = bodies.shape.clone(memory_format=torch.contiguous_format)
        if self.loose.any():
            self.variables["shift"] = torch.zeros_like(self.keypoints)

    def _weigh(self, confidence: Float[Tensor, "joints frames"]) -> None:
        """Set the weights of joints, bones and frames in each term."""
        settings, middle = self.settings, self.bodies.middle
        self.joint_weight = _joint_weight(confidence)
        self.bone_weight = self.joint_weight[self.parent] * self.joint_weight[self.child]
        self.loose = (confidence < _EXACT).to(confidence.dtype)
        """1 for uncertain and missing joints, which may move in the image, 0 for others."""
        self.shift_weight = torch.where(confidence > 0, settings.seen * confidence.square(), settings.near)
        self.smooth = bool(settings.smooth) and bool(middle.any())
        self.smooth_weight = settings.smooth * self.bodies.frames_per_middle * middle.to(confidence.dtype)

    def _of_depth(self, function: Callable[[Tensor, Tensor], Tensor | float]) -> Tensor | float:
        """Return the camera's `ratio` or `slope` of each joint (joints frames); a number where it is one for all."""
        value = function(self.variables["depth"].T.unsqueeze(-1), self.distance)
        return value.squeeze(-1).T if isinstance(value, Tensor) else value

    def _flat(self) -> Float[Tensor, "2 joints frames"]:
        """Return where the joints are in the image."""
        return self.keypoints + self.variables["shift"] if "shift" in self.variables else self.keypoints

    def pose(self) -> Float[Tensor, "frames joints 3"]:
        """Return the root-relative poses that the variables describe."""
        pose = torch.cat([self._flat() * self._of_depth(self.camera.ratio), self.variables["depth"][None]])
        return (pose - pose[:, self.root, None]).permute(2, 1, 0)

    def gradient(self) -> dict[str, Tensor]:
        """Return the derivatives of the cost by the variables."""
        flat, ratio = self._flat(), self._of_depth(self.camera.ratio)
        pose = torch.cat([flat * ratio, self.variables["depth"][None]])
        by_pose, by_size, by_shape = torch.zeros_like(pose), self._by_size(), self._by_shape()
        self._add_bones(pose, by_pose, by_size, by_shape)
        if self.smooth:
            self._add_acceleration(pose, by_pose, by_size)
        by_flat = by_pose[:2]
        by_ratio = (by_flat[0] * flat[0]).addcmul_(by_flat[1], flat[1])
        by_depth = by_ratio.mul_(self._of_depth(self.camera.slope)).add_(by_pose[2])
        by_depth[self.root] = 0
        self._add_near(by_depth)
        gradient = {"depth": by_depth, "size": by_size, "shape": by_shape}
        if "shift" in self.variables:
            gradient["shift"] = by_flat.mul_(ratio).mul_(self.loose)
            self._add_seen(gradient["shift"])
        return gradient

    def _add_bones(self, pose: Tensor, by_pose: Tensor, by_size: Tensor, by_shape: Tensor) -> None:
        """bones 10 H((log |child - parent| + size - shape) weight): bones are constant over a clip."""
        clip, weight = self.bodies.clip, self.bone_weight
        bone = pose.index_select(1, self.child).sub_(pose.index_select(1, self.parent))
        squared = (bone[0] * bone[0]).addcmul_(bone[1], bone[1]).addcmul_(bone[2], bone[2]).add_(_TINY)
        off = squared.log().mul_(0.5).add_(self.variables["size"])
        off.sub_(self.variables["shape"].index_select(1, clip)).mul_(weight)
        pull = off.clamp_(-_BONE_DELTA, _BONE_DELTA).mul_(weight).mul_(self.settings.bones * _BONE_WEIGHT)
        by_size.add_(pull.sum(0))
        by_shape.index_add_(1, clip, pull, alpha=-1)
        bone.mul_(pull.div_(squared))
        by_pose.index_add_(1, self.child, bone).index_add_(1, self.parent, bone, alpha=-1)

    def _add_acceleration(self, pose: Tensor, by_pose: Tensor, by_size: Tensor) -> None:
        """smooth H(second difference of exp(size) (pose + (0, 0, distance)) in the real camera's frame)."""
        # Missing joints count too: this fills them in from the frames around them.
        size, place = self.variables["size"].exp(), pose.clone()
        place[2].add_(self.distance)
        turn = None if self.rotation is None else self.rotation * size
        place = place.mul_(size) if turn is None else _turned(place, turn)
        pull = _second(place).clamp_(-_ACCELERATION_DELTA, _ACCELERATION_DELTA).mul_(self.smooth_weight[1:-1])
        by_place = _second(pad(pull, (2, 2)))  # second differences are their own adjoint
        by_size.add_((by_place * place).sum((0, 1)))
        by_pose.add_(by_place.mul_(size) if turn is None else _turned(by_place, turn.transpose(0, 1)))

    def _add_near(self, by_depth: Tensor) -> None:
        """near H(depth - lifted depth) weight."""
        off = (self.variables["depth"] - self.lifted).clamp_(-_DEPTH_DELTA, _DEPTH_DELTA)
        by_depth.addcmul_(off, self.joint_weight, value=self.settings.near)

    def _add_seen(self, by_shift: Tensor) -> None:
        """seen H(shift) weight."""
        by_shift.addcmul_(self.variables["shift"].clamp(-_SHIFT_DELTA, _SHIFT_DELTA), self.shift_weight)

    def _by_size(self) -> Float[Tensor, " frames"]:
        """(size - first size)^2."""
        return 2 * _SIZE_WEIGHT * (self.variables["size"] - self.bodies.size)

    def _by_shape(self) -> Float[Tensor, "bones clips"]:
        """frames per clip (sum of (shape - mirrored shape)^2 + 0.03 mean of (shape - common)^2 / variance)."""
        shape, bodies = self.variables["shape"], self.bodies
        # Each pair of bones is in the sum twice.
        by_sides = 4 * _SYMMETRY_WEIGHT * (shape - shape[self.partner])
        by_common = 2 * _COMMON_WEIGHT / len(shape) * (shape - bodies.common) / bodies.variance
        return bodies.frames_per_clip * (by_sides + by_common)


def _second(value: Float[Tensor, "... frames"]) -> Float[Tensor, "... middle_frames"]:
    """Return the second differences along frames."""
    return (value[..., :-2] + value[..., 2:]).sub_(value[..., 1:-1], alpha=2)


def _turned(
    points: Float[Tensor, "3 joints frames"], rotation: Float[Tensor, "3 3 frames"]
) -> Float[Tensor, "3 joints frames"]:
    """Return row vectors times ``rotation``."""
    turned = points[0] * rotation[0].unsqueeze(1)
    return turned.addcmul_(points[1], rotation[1].unsqueeze(1)).addcmul_(points[2], rotation[2].unsqueeze(1))


# The descent.


def _solve(problem: _Problem, settings: RefineSettings) -> Float[Tensor, "frames joints 3"]:
    """Return the poses that minimise the cost, by Adam (Kingma and Ba 2015)."""
    moments = {name: (torch.zeros_like(x), torch.zeros_like(x)) for name, x in problem.variables.items()}
    for step in range(settings.iterations):
        rate = settings.rate * (1 - _RATE_DECAY * step / settings.iterations)
        for name, gradient in problem.gradient().items():
            _step(problem.variables[name], gradient, *moments[name], rate * _RATE_SHARES[name], step + 1)
    return problem.pose()


def _step(value: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, rate: float, step: int) -> None:
    """Take Adam's step number ``step``, from 1, in place; ``mean`` and ``square`` are its moments so far."""
    of_mean, of_square = _BETAS
    mean.lerp_(gradient, 1 - of_mean)
    square.mul_(of_square).addcmul_(gradient, gradient, value=1 - of_square)
    unbiased = math.sqrt(1 - of_square**step)
    value.addcdiv_(mean, square.sqrt().add_(_EPSILON * unbiased), value=-rate * unbiased / (1 - of_mean**step))
