"""Refine the lifted poses of a clip jointly: one body that moves smoothly and projects to the keypoints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from uplift.config import ranks
from uplift.config.settings import RefineSettings
from uplift.config.threads import in_threads
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import NEAREST, Camera, Orthographic
from uplift.geometry.normalise import bone_lengths

__all__ = ["has_clips", "refine_clips"]

_BLOCK_FRAMES = 4000
"""Frames solved for together: few enough to stay in the processor's cache."""
_BLOCK_FRAMES_ELSEWHERE = 200_000
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
    only: Bool[Tensor, " frames"] | None = None,
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
        only: frames of the clips to refine; those of others are returned unchanged, and only say how bodies are. None: all.
    """
    refined = camera.unproject(keypoints, depth, data.distance)
    if settings.iterations == 0 or not has_clips(data):
        return refined
    rows = torch.argsort(data.clip, stable=True)
    rows = rows[torch.bincount(data.clip)[data.clip[rows]] > 1]
    whole = _Bodies.of(data, rows, refined[rows])
    if only is not None:
        kept = only[rows]
        rows, whole = rows[kept], whole.some(kept)
    most = _BLOCK_FRAMES if depth.device.type == "cpu" else _BLOCK_FRAMES_ELSEWHERE

    def solve(block: tuple[slice, slice]) -> None:
        part, bodies = rows[block[0]], whole.part(*block)
        refined[part] = _solve(_Problem(data, part, keypoints[part], depth[part], camera, settings, bodies), settings)

    blocks = _blocks(torch.bincount(whole.clip), most)
    in_threads(solve, ranks.my_parts(blocks), depth.device, "refining clips")
    return ranks.filled(refined, [rows[frames] for frames, _ in blocks])


def _blocks(frames_of: Int[Tensor, " clips"], most: int) -> list[tuple[slice, slice]]:
    """Return blocks of whole clips, of ``most`` frames or one clip, that are solved together: their frames and clips."""
    edges = np.concatenate([[0], frames_of.cpu().numpy().cumsum()])
    start, blocks = 0, []
    while start < len(frames_of):
        stop = max(start + 1, int(np.searchsorted(edges, edges[start] + most, side="right")) - 1)
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

    def some(self, frames: Bool[Tensor, " frames"]) -> _Bodies:
        """Return the bodies of the complete clips of ``frames``."""
        chosen = {name: getattr(self, name)[frames] for name in ("clip", "middle", "size")}
        clips, chosen["clip"] = torch.unique(chosen["clip"], return_inverse=True)
        return replace(self, **chosen, shape=self.shape[:, clips])

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

    Terms look at the joints in the frame of the real camera, times exp(size): with perspective each joint moves along one
    ray there, so that turning costs nothing in the descent. A point at or behind the pinhole is held at a share of the
    distance. Results of a step are written over those of the step before.
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
        self.parallel = isinstance(camera, Orthographic)
        self.distance, self.root = data.distance[rows], data.skeleton.root_index
        self.rotation = None if data.rotation is None else data.rotation[rows].permute(1, 2, 0).contiguous()
        self.parent, self.child = torch.tensor(data.skeleton.bone_indices, device=depth.device).T.contiguous()
        self.partner = torch.tensor(data.skeleton.bone_mirror_permutation, device=depth.device)
        self.keypoints = keypoints.permute(2, 1, 0).contiguous()
        self.lifted = depth.T.clone(memory_format=torch.contiguous_format)
        self.lifted[self.root] = 0
        self._weigh(data.confidence[rows].T.contiguous())
        self.variables = {"depth": self.lifted.clone(), "size": bodies.size.clone()}
        self.variables["shape"] = bodies.shape.clone(memory_format=torch.contiguous_format)
        if self.loose.any():
            self.variables["shift"] = torch.zeros_like(self.keypoints)
        self._prepare()

    def _weigh(self, confidence: Float[Tensor, "joints frames"]) -> None:
        """Set the weights of joints, bones and frames in each term."""
        settings, middle = self.settings, self.bodies.middle
        joint_weight = _joint_weight(confidence)
        self.near_weight = settings.near * joint_weight
        self.bone_weight = joint_weight[self.parent] * joint_weight[self.child]
        self.pull_weight = settings.bones * _BONE_WEIGHT * self.bone_weight
        self.loose = (confidence < _EXACT).to(confidence.dtype)
        """1 for uncertain and missing joints, which may move in the image, 0 for others."""
        self.shift_weight = torch.where(confidence > 0, settings.seen * confidence.square(), settings.near)
        self.smooth = bool(settings.smooth) and bool(middle.any())
        self.smooth_weight = (settings.smooth * self.bodies.frames_per_middle * middle.to(confidence.dtype))[1:-1]

    def _prepare(self) -> None:
        """Make room for what a step computes, and compute what stays."""
        depth, (_, joints, frames) = self.variables["depth"], self.keypoints.shape
        bones = len(self.child)
        sums = torch.float32 if depth.device.type == "mps" else torch.float64  # which are far larger than differences
        self.one, self.per_distance = depth.new_ones(()), 1 / self.distance
        self.ratio, self.scale, self.by_scale, self.off = (torch.empty_like(depth) for _ in range(4))
        self.base, self.point, self.by_point = (depth.new_empty(3, joints, frames) for _ in range(3))
        self.pull, self.held = depth.new_zeros(3, joints, frames + 2), torch.empty_like(depth, dtype=torch.bool)
        self.by_flat, self.total = torch.empty_like(self.keypoints), depth.new_empty(bones, frames, dtype=sums)
        self.bone, self.start = (depth.new_empty(3, bones, frames) for _ in range(2))
        self.squared, self.stretch, self.of_clip = (depth.new_empty(bones, frames) for _ in range(3))
        clip = self.bodies.clip
        self.last = torch.bincount(clip).cumsum(0) - 1
        self.ray = self._ray(self.keypoints)

    def _ray(self, flat: Float[Tensor, "2 joints frames"]) -> Float[Tensor, "3 joints frames"]:
        """Return where joints are seen at the root's depth, in the real camera's frame."""
        ray = torch.cat([flat, self.distance.expand_as(flat[:1])])
        return ray if self.rotation is None else _turned(ray, self.rotation)

    def pose(self) -> Float[Tensor, "frames joints 3"]:
        """Return the root-relative poses that the variables describe."""
        depth, flat = self.variables["depth"], self.keypoints
        flat = flat + self.variables["shift"] if "shift" in self.variables else flat
        ratio = self.camera.ratio(depth.T.unsqueeze(-1), self.distance)
        ratio = ratio.squeeze(-1).T if isinstance(ratio, Tensor) else ratio
        pose = torch.cat([flat * ratio, depth[None]])
        return (pose - pose[:, self.root, None]).permute(2, 1, 0)

    def gradient(self) -> dict[str, Tensor]:
        """Return the derivatives of the cost by the variables."""
        size, place = self.variables["size"].exp(), self._place_parallel if self.parallel else self._place
        base = place(size)
        by_shape = self._by_shape()
        if self.smooth:
            self._set_acceleration()
        else:
            self.by_point.zero_()
        self._add_bones(by_shape)
        by_scale = _dotted(self.by_point, self.point if self.parallel else base, self.by_scale)
        # Terms know sizes and depths by the points alone, which are as large as the scale.
        by_size = self._by_size().add_(
            (by_scale if self.parallel else self.off.copy_(by_scale).mul_(self.scale)).sum(0)
        )
        if self.parallel:
            self._along(2, by_scale).mul_(size)
        else:
            by_scale.mul_(size * self.per_distance)
            by_scale.masked_fill_(torch.le(self.ratio, NEAREST, out=self.held), 0)
        by_scale[self.root] = 0
        self._add_near(by_scale)
        gradient = {"depth": by_scale, "size": by_size, "shape": by_shape}
        if "shift" in self.variables:
            gradient["shift"] = self._by_shift(size)
        return gradient

    def _place(self, size: Float[Tensor, " frames"]) -> Float[Tensor, "3 joints frames"]:
        """Set where joints are, times exp(size), and return what is multiplied by the scale: seen from a pinhole."""
        base = self.ray if "shift" not in self.variables else self._shifted(self.variables["shift"])
        torch.addcmul(self.one, self.variables["depth"], self.per_distance, out=self.ratio).clamp_min_(NEAREST)
        torch.mul(self.ratio, size, out=self.scale)
        torch.mul(base, self.scale, out=self.point)
        return base

    def _place_parallel(self, size: Float[Tensor, " frames"]) -> Float[Tensor, "3 joints frames"]:
        base = self.ray if "shift" not in self.variables else self._shifted(self.variables["shift"])
        self.scale.copy_(size)
        if self.rotation is None:
            self.point.copy_(base)[2].add_(self.variables["depth"])
        else:
            torch.addcmul(base, self.rotation[2, :, None], self.variables["depth"], out=self.point)
        self.point.mul_(size)
        return base

    def _shifted(self, shift: Float[Tensor, "2 joints frames"]) -> Float[Tensor, "3 joints frames"]:
        """Return `_ray` of joints that have moved in the image."""
        if self.rotation is None:
            self.base.copy_(self.ray)[:2].add_(shift)
            return self.base
        torch.addcmul(self.ray, self.rotation[0, :, None], shift[0], out=self.base)
        return self.base.addcmul_(self.rotation[1, :, None], shift[1])

    def _along(self, axis: int, out: Float[Tensor, "joints frames"]) -> Tensor:
        """Return the derivatives by the points along an axis of the camera that looks at the root, in ``out``."""
        if self.rotation is None:
            return out.copy_(self.by_point[axis])
        return _dotted(self.by_point, self.rotation[axis, :, None], out)

    def _by_shift(self, size: Float[Tensor, " frames"]) -> Float[Tensor, "2 joints frames"]:
        """Return the derivatives by the shift, with those of seen H(shift) weight."""
        for axis in range(2):
            self._along(axis, self.by_flat[axis])
        by_shift = self.by_flat.mul_(size if self.parallel else self.scale).mul_(self.loose)
        pull = torch.clamp(self.variables["shift"], -_SHIFT_DELTA, _SHIFT_DELTA, out=self.base[:2])
        return by_shift.addcmul_(pull, self.shift_weight)

    def _add_bones(self, by_shape: Float[Tensor, "bones clips"]) -> None:
        """bones 10 H((log(exp(size) |child - parent|) - shape) weight): bones are constant over a clip."""
        torch.index_select(self.point, 1, self.child, out=self.bone)
        torch.index_select(self.point, 1, self.parent, out=self.start)
        bone = self.bone.sub_(self.start)
        squared = _dotted(bone, bone, self.squared).add_(_TINY)
        torch.index_select(self.variables["shape"], 1, self.bodies.clip, out=self.of_clip)
        short = torch.sub(self.of_clip, torch.log(squared, out=self.stretch), alpha=0.5, out=self.stretch)
        pull = short.mul_(self.bone_weight).clamp_(-_BONE_DELTA, _BONE_DELTA).mul_(self.pull_weight)
        upto = torch.cumsum(pull, 1, dtype=self.total.dtype, out=self.total)[
            :, self.last
        ]  # far quicker than to add up by clip
        by_shape.add_(upto.diff(dim=1, prepend=upto.new_zeros(len(upto), 1)))
        bone.mul_(pull.div_(squared))
        self.by_point.index_add_(1, self.child, bone, alpha=-1).index_add_(1, self.parent, bone)

    def _set_acceleration(self) -> None:
        """smooth H(second difference of exp(size) (pose + (0, 0, distance)) in the real camera's frame)."""
        # Missing joints count too: this fills them in from the frames around them.
        pull = _second(self.point, self.pull[..., 2:-2])
        pull.clamp_(-_ACCELERATION_DELTA, _ACCELERATION_DELTA).mul_(self.smooth_weight)
        _second(self.pull, self.by_point)  # second differences are their own adjoint

    def _add_near(self, by_depth: Float[Tensor, "joints frames"]) -> None:
        """near H(depth - lifted depth) weight."""
        off = torch.sub(self.variables["depth"], self.lifted, out=self.off).clamp_(-_DEPTH_DELTA, _DEPTH_DELTA)
        by_depth.addcmul_(off, self.near_weight)

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


def _second(value: Float[Tensor, "3 joints frames"], out: Tensor) -> Tensor:
    """Return the second differences along frames, in ``out``, which is two frames shorter."""
    return torch.add(value[..., :-2], value[..., 2:], out=out).sub_(value[..., 1:-1], alpha=2)


def _dotted(one: Tensor, other: Tensor, out: Tensor) -> Tensor:
    """Return the sum over the first axis, of length 3, of the products, in ``out``."""
    (x, y, z), (other_x, other_y, other_z) = one.unbind(), other.unbind()
    return torch.mul(x, other_x, out=out).addcmul_(y, other_y).addcmul_(z, other_z)


def _turned(
    points: Float[Tensor, "3 joints frames"], rotation: Float[Tensor, "3 3 frames"]
) -> Float[Tensor, "3 joints frames"]:
    """Return row vectors times ``rotation``."""
    turned = points[0] * rotation[0].unsqueeze(1)
    return turned.addcmul_(points[1], rotation[1].unsqueeze(1)).addcmul_(points[2], rotation[2].unsqueeze(1))


# The descent.


def _solve(problem: _Problem, settings: RefineSettings) -> Float[Tensor, "frames joints 3"]:
    """Return the poses that minimise the cost, by Adam (Kingma and Ba 2015)."""
    variables = problem.variables
    moments = {name: (torch.zeros_like(x), torch.zeros_like(x)) for name, x in variables.items()}
    steps = {name: torch.zeros((), device=x.device) for name, x in variables.items()}
    of_mean, of_square = _BETAS
    usual = {"beta1": of_mean, "beta2": of_square, "weight_decay": 0.0, "eps": _EPSILON, "amsgrad": False}
    for step in range(settings.iterations):
        rate = settings.rate * (1 - _RATE_DECAY * step / settings.iterations)
        for name, gradient in problem.gradient().items():
            (mean, square), share = moments[name], _RATE_SHARES[name]
            # What `torch.optim.Adam(fused=True)` calls, in one sweep over memory, after more checks than the step takes.
            torch._fused_adam_(
                [variables[name]], [gradient], [mean], [square], [], [steps[name].add_(1)],
                lr=rate * share, maximize=False, **usual,
            )  # fmt: skip
    return problem.pose()
