"""Depth signs: whether each bone points towards the camera or away from it, decided for chains of bones along clips.

A bone of known length whose one end is known has its other end on a sphere, and the line of sight of the keypoint meets
the sphere at two points: each bone is seen in one of two states. Networks that regress depths answer with the mean of
the two where they are unsure; here the states have probabilities.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import cross_entropy, log_softmax, normalize, pad

from uplift.config import ranks
from uplift.data.poses import USUAL_FPS
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Camera, Orthographic
from uplift.geometry.normalise import bone_lengths
from uplift.geometry.rotation import turn
from uplift.skeleton import Skeleton

__all__ = ["Hypotheses", "SignChains", "Solution", "solve_signs", "spread_hypotheses"]

# The chains of a skeleton, and the states of their bones.

Chain = tuple[tuple[int, int], ...]
"""Bones as (parent, child), each from the end of the one before it."""

_MOST_BONES = 4
"""Of a chain, which has 2 to the power of that many states."""


class SignChains:
    """The tree of a skeleton's bones, cut into chains whose signs are decided together.

    A chain goes on to the only child of a joint, or the only one that is its own mirror image (from the hips up the
    spine to the head); other children start chains of their own. Chains come after those that they start from. A state
    of a chain is a binary number with one digit for each bone, the first bone's first: 1 where it points away.
    """

    def __init__(self, skeleton: Skeleton):
        self.chains = _chains(skeleton)
        self.bones = torch.tensor([bone for chain in self.chains for bone in chain])
        """(bones 2) parent and child, chain after chain."""
        self.counts = [2 ** len(chain) for chain in self.chains]
        self.starts = np.cumsum([0, *map(len, self.chains)]).tolist()
        """The place of each chain's first bone among all."""
        self.mirrored = self._mirrored(skeleton)
        """For each chain the number of its mirror image; None where some have none."""

    def _mirrored(self, skeleton: Skeleton) -> list[int] | None:
        swap = skeleton.mirror_permutation.tolist()
        images = [tuple((swap[parent], swap[child]) for parent, child in chain) for chain in self.chains]
        known = skeleton.has_mirror_image and all(image in self.chains for image in images)
        return [self.chains.index(image) for image in images] if known else None

    def split(self, logits: Float[Tensor, "frames states"]) -> list[Tensor]:
        """Return the log-probabilities (frames states) of each chain's states from ``logits`` of all."""
        return [log_softmax(part, 1) for part in logits.split(self.counts, 1)]

    def mean(
        self, straight: Float[Tensor, "frames states"], mirrored: Float[Tensor, "frames states"]
    ) -> Float[Tensor, "frames states"]:
        """Return the mean log-probabilities of keypoints and of their mirror images: a mirror leaves depth signs as they are."""
        assert self.mirrored is not None
        one, other = self.split(straight), self.split(mirrored)
        return torch.cat([(one[place] + other[image]) / 2 for place, image in enumerate(self.mirrored)], 1)

    def states(
        self, pose: Float[Tensor, "frames joints 3"], distance: Float[Tensor, " frames"]
    ) -> Int[Tensor, "frames chains"]:
        """Return the state of each chain in poses seen from ``distance``."""
        ray = torch.cat([pose[..., :2], pose[..., 2:] + distance[:, None, None]], -1)
        parent, child = self.bones.to(pose.device).T
        away = ((pose[:, child] - pose[:, parent]) * ray[:, child]).sum(-1) > 0
        digits = [away[:, start:stop].long() for start, stop in pairwise(self.starts)]
        return torch.stack([reduce(lambda state, bit: 2 * state + bit, part.T) for part in digits], 1)

    def loss(
        self,
        logits: Float[Tensor, "frames states"],
        states: Int[Tensor, "frames chains"],
        weight: Float[Tensor, "frames joints"],
    ) -> Float[Tensor, ""]:
        """Return the mean cross-entropy of a frame, over chains all of whose joints have a ``weight``."""
        total = logits.new_zeros(())
        for place, (part, chain) in enumerate(zip(logits.split(self.counts, 1), self.chains, strict=True)):
            joints = sorted({joint for bone in chain for joint in bone})
            known = (weight[:, joints] > 0).all(1).to(logits.dtype)
            total = total + (cross_entropy(part, states[:, place], reduction="none") * known).mean()
        return total


def _chains(skeleton: Skeleton) -> list[Chain]:
    children: dict[int, list[int]] = {joint: [] for joint in range(len(skeleton.joints))}
    for child, parent in skeleton.parents.items():
        if parent is not None:
            children[skeleton.index(parent)].append(skeleton.index(child))

    def depth(joint: int) -> int:
        return 1 + max(map(depth, children[joint]), default=0)

    def goes_on(joint: int) -> int | None:
        below = children[joint]
        central = [one for one in below if skeleton.mirror and skeleton.mirror_permutation[one] == one]
        return max(central or below, key=depth) if central or len(below) == 1 else None

    chains: list[Chain] = []
    starts = [(skeleton.root_index, child) for child in children[skeleton.root_index]]
    while starts:
        chain = [starts.pop(0)]
        while len(chain) < _MOST_BONES and (following := goes_on(chain[-1][1])) is not None:
            chain.append((chain[-1][1], following))
        chains.append(tuple(chain))
        used = dict(chain)
        starts += [(joint, child) for _, joint in chain for child in children[joint] if used.get(joint) != child]
    return chains


# The scene: lines of sight and bone lengths, in one unit for all frames of a body.

_BODY = 4.0
"""Sum of the lengths of all bones in the unit of the scene: about a metre for a human of 17 joints."""
_LONG = 0.95
"""Quantile over a body's frames of what a bone must at least measure to reach its keypoint's line of sight."""


@dataclass(frozen=True)
class _Scene:
    """Frames in the frame of the real camera where it is known, relative to the root, sizes as of `_BODY`."""

    chains: SignChains
    point: Float[Tensor, "frames joints 3"]
    """Of each line of sight, at the root's depth."""
    ray: Float[Tensor, "frames joints 3"]
    """Its direction, of length 1."""
    length: Float[Tensor, "frames bones"]
    """As in `SignChains.bones`."""

    def ends(self, place: int, start: Float[Tensor, "frames 3"]) -> Float[Tensor, "frames states bones 3"]:
        """Return the far ends of a chain's bones in all of its states.

        Where a bone cannot reach the line of sight, both states are the point of the line nearest to its start.
        """
        at, columns = start[:, None], []
        for number, (_, child) in enumerate(self.chains.chains[place]):
            point, ray = self.point[:, child, None], self.ray[:, child, None]
            length = self.length[:, self.chains.starts[place] + number, None]
            along, half = _meets(at - point, ray, length)
            both = torch.stack([along - half, along + half], -1)
            at = (point[:, :, None] + ray[:, :, None] * both[..., None]).flatten(1, 2)
            columns = [*(column.repeat_interleave(2, 1) for column in columns), at]
        return torch.stack(columns, 2)

    def placed(
        self, rows: Int[Tensor, " frames"], states: Int[Tensor, "frames poses chains"]
    ) -> Float[Tensor, "frames poses joints 3"]:
        """Return the poses of frames ``rows`` that the states of all chains describe."""
        result = self.point.new_zeros(*states.shape[:2], *self.point.shape[1:])
        for place, chain in enumerate(self.chains.chains):
            for number, (parent, child) in enumerate(chain):
                sign = 2 * (states[..., place] >> (len(chain) - 1 - number) & 1) - 1
                point, ray = self.point[rows, None, child], self.ray[rows, None, child]
                length = self.length[rows, None, self.chains.starts[place] + number]
                along, half = _meets(result[:, :, parent] - point, ray, length)
                result[:, :, child] = point + ray * (along + sign * half)[..., None]
        return result


def _meets(off: Tensor, ray: Tensor, length: Tensor) -> tuple[Tensor, Tensor]:
    """Return how far along rays the nearest points to ``off`` are, and from there the points ``length`` away from it."""
    along = (off * ray).sum(-1)
    return along, (length.square() - off.square().sum(-1) + along.square()).clamp_min(0).sqrt()


def _scene_of(frames: TrainingSet, pose: Tensor, camera: Camera, chains: SignChains) -> tuple[_Scene, Tensor]:
    """Return the scene of ``pose``, in the units of ``frames``, and the scene's units in one of these."""
    bones = chains.bones.to(pose.device)
    lengths = bone_lengths(pose, bones)
    size = _BODY / lengths.sum(1).clamp_min(1e-6)
    point = pad(camera.project(pose, frames.distance), (0, 1))
    ahead = pad(torch.ones_like(point[..., :1]), (2, 0))
    parallel = isinstance(camera, Orthographic)
    ray = ahead if parallel else normalize(point + ahead * frames.distance[:, None, None], dim=-1)
    pose, point = pose * size[:, None, None], point * size[:, None, None]
    if frames.rotation is not None:
        pose, point, ray = (turn(part, frames.rotation.mT) for part in (pose, point, ray))
    parent, child = bones.T
    off = pose[:, parent] - point[:, child]
    reach = (off - (off * ray[:, child]).sum(-1, keepdim=True) * ray[:, child]).norm(dim=-1)
    length = _body_lengths(lengths * size[:, None], reach, frames.body, _limb_bones(frames.skeleton, chains))
    return _Scene(chains, point, ray, length), size


def _limb_bones(skeleton: Skeleton, chains: SignChains) -> Bool[Tensor, " bones"]:
    """Return which bones belong to limbs: both ends have mirror images; all without any, but those at the root."""
    swap = skeleton.mirror_permutation
    if skeleton.mirror:
        return torch.tensor([bool(swap[one] != one and swap[other] != other) for one, other in chains.bones.tolist()])
    return chains.bones[:, 0] != skeleton.root_index


def _body_lengths(
    length: Float[Tensor, "frames bones"],
    reach: Float[Tensor, "frames bones"],
    body: Int[Tensor, " frames"],
    limbs: Bool[Tensor, " bones"],
) -> Float[Tensor, "frames bones"]:
    """Return the bones of each frame's body: the median over its frames, but limbs long enough for their keypoints.

    A lifter shortens limbs that it is unsure of. ``reach`` is what a bone must at least measure in a frame. The sum of
    all is that of the medians.
    """
    result = torch.empty_like(length)
    order = torch.argsort(body, stable=True)
    for rows in order.split(torch.bincount(body).tolist()):
        if len(rows):
            usual = length[rows].median(0).values
            long = reach[rows].kthvalue(max(1, round(_LONG * len(rows))), 0).values
            least = torch.where(limbs.to(usual.device), torch.maximum(usual, long), usual)
            result[rows] = least * (usual.sum() / least.sum())
    return result


# Messages along a clip: how likely each state is, given all frames.

_RATE = 10.0
"""Frames per second at which frames are compared; clips of more are taken apart into some of about this rate."""
_ACCELERATION = 0.2
"""Of a joint, in units of the scene per frame squared at `_RATE`, from which it counts: 20 m/s^2 of a human."""
_SPEED = 0.6
"""Of the joints of chains of many states, in units of the scene per frame at `_RATE`."""
_EVIDENCE = 0.5
"""Exponent of what the lifter says of a frame that has neighbours: their errors are alike."""
_LEAST = -9.0
"""Log-probability: no state is ruled out by one frame."""
_SECOND_ORDER = 8
"""States of a chain up to which accelerations count: more take too long, and their speeds count."""
_CORE, _CONTEXT = 64, 6
"""Frames of a window, and on either side those that it shares with its neighbours."""
_BLOCK_FRAMES = 4000


@dataclass(frozen=True)
class _Window:
    rows: Int[Tensor, " frames"]
    core: slice
    """Frames that the window is asked for."""


def _windows(frames: TrainingSet, stride: int) -> Iterator[_Window]:
    """Yield windows of frames in time, ``stride`` apart, that follow each other without a gap."""
    starts = torch.cat([(~frames.follows).nonzero()[:, 0], frames.clip.new_tensor([len(frames)])]).tolist()
    every = torch.arange(len(frames), device=frames.clip.device)
    for first, stop in pairwise(starts):
        for phase in range(first, min(first + stride, stop)):
            rows = every[phase:stop:stride]
            for start in range(0, len(rows), _CORE):
                low, end = max(0, start - _CONTEXT), min(len(rows), start + _CORE)
                yield _Window(rows[low : end + _CONTEXT], slice(start - low, end - low))


def _blocks(windows: Sequence[_Window]) -> Iterator[list[_Window]]:
    """Yield windows of about one length that are solved at once."""
    block: list[_Window] = []
    for window in sorted(windows, key=lambda one: len(one.rows)):
        if block and len(window.rows) * (len(block) + 1) > _BLOCK_FRAMES:
            yield block
            block = []
        block.append(window)
    if block:
        yield block


def _marginals(
    place: Float[Tensor, "frames states bones 3"],
    likely: Float[Tensor, "frames states"],
    windows: Sequence[_Window],
    pace: float,
) -> Float[Tensor, "frames states"]:
    """Return the probability of each state given all frames of its window (forward-backward, Rabiner 1989).

    Joints move as little as Cauchy-distributed accelerations, or speeds, allow. ``pace`` is the time between frames
    over that of `_RATE`.
    """
    if not windows:
        return likely / likely.sum(1, keepdim=True)
    result, blocks = torch.empty_like(likely), list(_blocks(windows))
    for block in ranks.my_parts(blocks):
        longest = max(len(window.rows) for window in block)
        rows = torch.stack([pad(one.rows, (0, longest - len(one.rows)), value=int(one.rows[-1])) for one in block])
        valid = torch.stack([torch.arange(longest, device=rows.device) < len(one.rows) for one in block])
        seen = likely[rows].where(valid[..., None], 1.0)
        if longest == 1:
            found = seen / seen.sum(-1, keepdim=True)
        elif longest == 2 or likely.shape[1] > _SECOND_ORDER:
            found = _by_speed(place[rows], seen, valid, _SPEED * pace)
        else:
            found = _by_acceleration(place[rows], seen, valid, _ACCELERATION * pace**2)
        for window, one in zip(block, found, strict=True):
            result[window.rows[window.core]] = one[window.core]
    return ranks.filled(result, [torch.cat([window.rows[window.core] for window in block]) for block in blocks])


def _products(one: Tensor, other: Tensor) -> Float[Tensor, "clips frames bones states states"]:
    return torch.einsum("ctajx,ctbjx->ctjab", one, other)


def _by_acceleration(
    place: Float[Tensor, "clips frames states bones 3"],
    seen: Float[Tensor, "clips frames states"],
    valid: Bool[Tensor, "clips frames"],
    width: float,
) -> Float[Tensor, "clips frames states"]:
    """Return the marginals of a chain of second order: a state depends on the two before it."""
    square = place.square().sum(-1).movedim(-1, 2)
    near, far = _products(place[:, :-1], place[:, 1:]), 2 * _products(place[:, :-2], place[:, 2:])
    # |a - 2b + c|^2, for the states a, b and c of three frames
    start = square[:, :-2, :, :, None] + 4 * square[:, 1:-1, :, None, :] - 4 * near[:, :-1]
    end = square[:, 2:, :, None, :] - 4 * near[:, 1:]
    step = place.new_ones(())
    for bone in range(place.shape[3]):
        away = start[:, :, bone, :, :, None] + end[:, :, bone, None] + far[:, :, bone, :, None]
        step = step * away.clamp_min_(0).mul_(1 / width**2).add_(1)
    step = step.reciprocal().where(valid[:, 2:, None, None, None], 1.0)
    forward = [seen[:, 0, :, None] * seen[:, 1, None]]
    for at in range(2, seen.shape[1]):
        message = (forward[-1][..., None] * step[:, at - 2]).sum(1) * seen[:, at, None]
        forward.append(message / message.sum((1, 2), keepdim=True))
    backward, found = torch.ones_like(forward[0]), []
    for at in range(seen.shape[1] - 1, 0, -1):
        pair = forward[at - 1] * backward
        found.append(pair.sum(1))
        if at == 1:
            found.append(pair.sum(2))
        else:
            backward = (step[:, at - 2] * (seen[:, at, None] * backward)[:, None]).sum(-1)
            backward = backward / backward.amax((1, 2), keepdim=True)
    result = torch.stack(found[::-1], 1)
    return result / result.sum(-1, keepdim=True)


def _by_speed(
    place: Float[Tensor, "clips frames states bones 3"],
    seen: Float[Tensor, "clips frames states"],
    valid: Bool[Tensor, "clips frames"],
    width: float,
) -> Float[Tensor, "clips frames states"]:
    """Return the marginals of a chain of first order: a state depends on the one before it."""
    square = place.square().sum(-1).movedim(-1, 2)
    away = square[:, :-1, :, :, None] + square[:, 1:, :, None] - 2 * _products(place[:, :-1], place[:, 1:])
    step = (away.clamp_min(0) / width**2 + 1).prod(2).reciprocal().where(valid[:, 1:, None, None], 1.0)
    forward = [seen[:, 0]]
    for at in range(1, seen.shape[1]):
        message = (forward[-1][..., None] * step[:, at - 1]).sum(1) * seen[:, at]
        forward.append(message / message.sum(1, keepdim=True))
    backward, found = torch.ones_like(forward[0]), [forward[-1]]
    for at in range(seen.shape[1] - 1, 0, -1):
        backward = (step[:, at - 1] * (seen[:, at] * backward)[:, None]).sum(-1)
        backward = backward / backward.amax(1, keepdim=True)
        found.append(forward[at - 1] * backward)
    result = torch.stack(found[::-1], 1)
    return result / result.sum(-1, keepdim=True)


# The answer: the mean over all states, and whole poses that are likely.


@dataclass(frozen=True)
class Solution:
    """Poses as `solve_signs` finds them."""

    pose: Float[Tensor, "frames joints 3"]
    """The mean over all states, in the units and the camera of the frames, in frames without neighbours mixed with the pose
    given; it projects to the same keypoints."""
    deviation: Float[Tensor, "frames joints"]
    """Standard deviation of each joint's place along its line of sight, in units, as far as it comes from the signs."""
    likely: list[Tensor]
    """For each chain the probabilities (frames states) of its states."""
    scene: _Scene
    size: Float[Tensor, " frames"]
    """Units of the scene in one unit."""
    rotation: Float[Tensor, "frames 3 3"] | None

    def in_units(self, pose: Tensor) -> Tensor:
        """Return poses (frames ... joints 3) of the scene in the units and the camera of the frames."""
        pose = pose / self.size.view(-1, *[1] * (pose.ndim - 1))
        if self.rotation is None:
            return pose
        return torch.einsum("f...x,fyx->f...y", pose, self.rotation)


@torch.no_grad()
def solve_signs(
    frames: TrainingSet,
    pose: Float[Tensor, "frames joints 3"],
    logits: Float[Tensor, "frames states"],
    camera: Camera,
    chains: SignChains,
    uncertainty: Float[Tensor, "frames joints"] | None = None,
) -> Solution:
    """Return poses with the bones of each body and the depth signs that are likely, given whole clips.

    Bones have one length for all frames of a body. Each chain's states are weighed by what the lifter says of each
    frame and by how joints then move along the clip; chains start at the mean of those before them. In frames without
    neighbours the answer is a weighted mean with the pose given.

    Args:
        frames: for clips, bodies and cameras.
        pose: as lifted, better refined: gives the keypoints, the size of each frame and the bones.
        logits: of the states of all chains, as a lifter with `Lifter.chains` predicts them.
        camera: the lifter's projection.
        chains: those of the skeleton.
        uncertainty: of the depths of ``pose``, in units, where it is known.
    """
    scene, size = _scene_of(frames, pose, camera, chains)
    fps = frames.fps or USUAL_FPS
    stride = max(1, round(fps / _RATE))
    windows = list(_windows(frames, stride)) if bool(frames.follows.any()) else []
    follows = frames.follows | pad(frames.follows[1:], (0, 1))
    evidence = torch.where(follows, _EVIDENCE, 1.0)[:, None]
    found, deviation, likely = torch.zeros_like(pose), torch.zeros_like(pose[..., 0]), []
    for place, (chain, part) in enumerate(zip(chains.chains, chains.split(logits), strict=True)):
        start = chain[0][0]
        ends = scene.ends(place, found[:, start])
        seen = (evidence * part.clamp_min(_LEAST)).softmax(1)
        state = _smooth(_marginals(ends, seen, windows, stride * _RATE / fps), frames, stride)
        mean = torch.einsum("fs,fsbx->fbx", state, ends)
        spread = torch.einsum("fs,fsb->fb", state, (ends - mean[:, None]).square().sum(-1))
        children = [child for _, child in chain]
        found[:, children] = mean
        deviation[:, children] = (spread + deviation[:, [start]].square()).sqrt()
        likely.append(state)
    solution = Solution(pose, deviation / size[:, None], likely, scene, size, frames.rotation)
    weight = torch.where(follows[:, None], 1.0, _weight_alone(solution.deviation, uncertainty))
    return replace(solution, pose=torch.lerp(pose, solution.in_units(found), weight[..., None]))


def _weight_alone(deviation: Tensor, uncertainty: Tensor | None) -> Float[Tensor, "frames joints"]:
    """Return the weight of the answer, beside the pose given, in frames without neighbours.

    Where the signs leave little open the answer knows no more than the pose, but takes all bones for stiff.
    """
    if uncertainty is None:
        return torch.full_like(deviation, 0.5)
    return deviation / (deviation + uncertainty).clamp_min(1e-9)


def _smooth(state: Float[Tensor, "frames states"], frames: TrainingSet, stride: int) -> Float[Tensor, "frames states"]:
    """Return the mean over ``stride`` neighbours in time, each of which was solved with others."""
    if stride == 1:
        return state
    run = (~frames.follows).cumsum(0)
    total, count = torch.zeros_like(state), torch.zeros_like(state[:, :1])
    for shift in range(-(stride // 2), (stride + 1) // 2):
        rows = torch.arange(len(state), device=state.device) + shift
        inside = (rows >= 0) & (rows < len(state))
        rows = rows.clamp(0, len(state) - 1)
        same = (inside & (run[rows] == run)).to(state.dtype)[:, None]
        total, count = total + state[rows] * same, count + same
    return total / count


# Several hypotheses: clusters of the poses that the states of all chains describe.

_CANDIDATES = 64
_APART = 0.05
"""Mean distance of joints, in units of the scene, between the poses that clusters start from."""
_ROUNDS = 2
_TEMPER = 0.5
"""Exponent of the states' probabilities: those of strangers are less sure than clips of pseudo labels say."""


@dataclass(frozen=True)
class Hypotheses:
    """Whole poses that the keypoints may show, the most likely first."""

    pose: Float[Tensor, "frames hypotheses joints 3"]
    weight: Float[Tensor, "frames hypotheses"]
    """Probabilities, 1 in sum."""


@torch.no_grad()
def spread_hypotheses(solution: Solution, count: int) -> Hypotheses:
    """Return ``count`` poses for each frame: means of clusters of likely poses, with the probability of each cluster."""
    poses, weights = [], []
    for rows in torch.arange(len(solution.pose), device=solution.pose.device).split(_BLOCK_FRAMES // 2):
        states, chance = _likeliest(solution, rows)
        candidates = solution.scene.placed(rows, states)
        centre = _apart(candidates, chance, count)
        for _ in range(_ROUNDS):
            share = _shares(candidates, chance, centre)
            weight = share.sum(1)
            mean = torch.einsum("fck,fcjx->fkjx", share, candidates) / weight.clamp_min(1e-9)[..., None, None]
            centre = torch.where((weight > 1e-6)[..., None, None], mean, centre)
        weight, order = _shares(candidates, chance, centre).sum(1).sort(1, descending=True)
        poses.append(centre.gather(1, order[..., None, None].expand_as(centre)))
        weights.append(weight)
    return Hypotheses(solution.in_units(torch.cat(poses)), torch.cat(weights))


def _likeliest(
    solution: Solution, rows: Int[Tensor, " frames"]
) -> tuple[Int[Tensor, "frames candidates chains"], Float[Tensor, "frames candidates"]]:
    """Return the likeliest combinations of the chains' states, and their probabilities, 1 in sum."""
    chance = torch.ones(len(rows), 1, device=rows.device)
    states = torch.zeros(len(rows), 1, 0, dtype=torch.long, device=rows.device)
    for part in solution.likely:
        both = (chance[..., None] * part[rows, None].clamp_min(1e-9) ** _TEMPER).flatten(1)
        chance, pick = both.topk(min(_CANDIDATES, both.shape[1]), 1)
        kept = states.gather(1, (pick // part.shape[1])[..., None].expand(-1, -1, states.shape[2]))
        states = torch.cat([kept, (pick % part.shape[1])[..., None]], 2)
        chance = chance / chance.sum(1, keepdim=True)
    return states, chance


def _apart(
    candidates: Float[Tensor, "frames candidates joints 3"], chance: Float[Tensor, "frames candidates"], count: int
) -> Float[Tensor, "frames count joints 3"]:
    """Return the likeliest candidates that are `_APART` from each other; nearer ones where there are no others."""
    chosen: list[Tensor] = []
    left, every = chance.clone(), torch.arange(len(chance), device=chance.device)
    while len(chosen) < count:
        pick = left.argmax(1)
        chosen.append(candidates[every, pick])
        near = (candidates - chosen[-1][:, None]).norm(dim=-1).mean(-1) < _APART
        left = left.where(~near, left * 1e-6)
        left[every, pick] = -1
    return torch.stack(chosen, 1)


def _shares(candidates: Tensor, chance: Tensor, centre: Tensor) -> Float[Tensor, "frames candidates clusters"]:
    """Return each candidate's probability in the column of the nearest centre."""
    gap = (candidates[:, :, None] - centre[:, None]).norm(dim=-1).mean(-1)
    return torch.zeros_like(gap).scatter_(2, gap.argmin(2, keepdim=True), chance[..., None])
