"""Depth signs: whether each bone points towards the camera or away from it, decided for chains of bones along clips.

A bone of known length whose one end is known has its other end on a sphere, and the line of sight of the keypoint meets
the sphere at two points: each bone is seen in one of two states. Networks that regress depths answer with the mean of
the two where they are unsure; here the states have probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, log_softmax, normalize, pad

from uplift.config import ranks
from uplift.config.threads import in_threads
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


class SignChains(nn.Module):
    """The tree of a skeleton's bones, cut into chains whose signs are decided together.

    A chain goes on to the only child of a joint, or the only one that is its own mirror image (from the hips up the
    spine to the head); other children start chains of their own. Chains come after those that they start from. A state
    of a chain is a binary number with one digit for each bone, the first bone's first: 1 where it points away.
    """

    bones: Tensor
    """(bones 2) parent and child, chain after chain."""
    members: Tensor
    """(joints chains), 1 where a joint is one of a chain."""

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.chains = _chains(skeleton)
        members = [
            [float(any(joint in bone for bone in chain)) for chain in self.chains]
            for joint in range(len(skeleton.joints))
        ]
        self.register_buffer("bones", torch.tensor([bone for chain in self.chains for bone in chain]), persistent=False)
        self.register_buffer("members", torch.tensor(members), persistent=False)
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
        parent, child = self.bones.T
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
        known = ((weight <= 0).to(self.members.dtype) @ self.members == 0).to(logits.dtype)
        parts = zip(logits.split(self.counts, 1), states.unbind(1), strict=True)
        each = torch.stack([cross_entropy(part, state, reduction="none") for part, state in parts], 1)
        return (each * known).mean(0).sum()


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

    def ends(self, place: int, start: Float[Tensor, "3 frames"]) -> list[Tensor]:
        """Return, for each bone of a chain, where it may end (states 3 frames), by the digits of the bones up to it.

        Where a bone cannot reach the line of sight, both states are the point of the line nearest to its start.
        """
        at, found = start[None], []
        for number, (_, child) in enumerate(self.chains.chains[place]):
            point, ray = self.point[:, child].T.contiguous(), self.ray[:, child].T.contiguous()
            length = self.length[:, self.chains.starts[place] + number]
            along, half = _meets(at - point, ray, length, 1)
            both = torch.stack([along - half, along + half], 1).flatten(0, 1)
            at = torch.addcmul(point, ray, both[:, None])
            found.append(at)
        return found

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
                along, half = _meets(result[:, :, parent] - point, ray, length, -1)
                result[:, :, child] = point + ray * (along + sign * half)[..., None]
        return result


def _meets(off: Tensor, ray: Tensor, length: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Return how far along rays the nearest points to ``off`` are, and from there the points ``length`` away from it."""
    along = (off * ray).sum(axis)
    return along, (length.square() - off.square().sum(axis) + along.square()).clamp_min(0).sqrt()


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
    length = _body_lengths(
        lengths * size[:, None], reach, frames.body, _limb_bones(frames.skeleton, chains, pose.device)
    )
    return _Scene(chains, point, ray, length), size


def _limb_bones(skeleton: Skeleton, chains: SignChains, device: torch.device) -> Bool[Tensor, " bones"]:
    """Return which bones belong to limbs: both ends have mirror images; all without any, but those at the root."""
    swap = skeleton.mirror_permutation
    if skeleton.mirror:
        found = [bool(swap[one] != one and swap[other] != other) for one, other in chains.bones.tolist()]
    else:
        found = (chains.bones[:, 0] != skeleton.root_index).tolist()
    return torch.tensor(found, device=device)


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
    counts = torch.bincount(body)
    first = counts.cumsum(0) - counts
    lengths, reaches = (_sorted_by_body(value, body, counts) for value in (length, reach))
    usual = lengths[first + (counts - 1).clamp_min(0) // 2]
    rank = (_LONG * counts).round().long().clamp_min(1) - 1
    least = torch.where(limbs, torch.maximum(usual, reaches[first + rank]), usual)
    return (least * (usual.sum(1) / least.sum(1))[:, None])[body]


def _sorted_by_body(
    value: Float[Tensor, "frames bones"], body: Int[Tensor, " frames"], counts: Int[Tensor, " bodies"]
) -> Float[Tensor, "frames bones"]:
    """Return the values of each bone with those of each body together, and there from small to large."""
    if value.device.type == "cpu":  # by what takes less time
        rows = torch.argsort(body, stable=True).split(counts.tolist())
        return torch.cat([value[part].sort(0).values for part in rows])
    value, order = value.sort(0)
    return value.gather(0, torch.argsort(body[order], dim=0, stable=True))


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
_WINDOWS, _WINDOWS_ELSEWHERE = 128, 8192
"""Windows solved at once: on the processor those whose steps stay in its cache, on other devices enough to keep them busy."""


@dataclass(frozen=True)
class _Windows:
    """Frames in time that follow each other without a gap, several windows of about one length side by side."""

    rows: Int[Tensor, "longest windows"]
    """After the end of a window its last frame, again and again."""
    length: Int[Tensor, " windows"]
    core: Bool[Tensor, "longest windows"]
    """Frames that the windows are asked for."""
    shortest: int

    @classmethod
    def of(cls, frames: TrainingSet, stride: int) -> list[_Windows]:
        """Return windows of frames that are ``stride`` apart; none where no frame follows another."""
        device = frames.clip.device
        follows = frames.follows.cpu().numpy()
        if not follows.any():
            return []
        first = np.flatnonzero(~follows)
        runs = np.append(first, len(follows))[1:] - first
        phases = np.minimum(stride, runs)
        first = np.repeat(first, phases) + _counted(phases)
        count = -(-(np.repeat(runs, phases) - _counted(phases)) // stride)  # frames of each run and phase
        parts = -(-count // _CORE)
        first, count, start = np.repeat(first, parts), np.repeat(count, parts), _CORE * _counted(parts)
        low, end = np.maximum(0, start - _CONTEXT), np.minimum(count, start + _CORE)
        length = np.minimum(count, end + _CONTEXT) - low
        table = np.stack([first + stride * low, length, start - low, end - low])
        table = table[:, np.argsort(length, kind="stable")]
        most = _WINDOWS if device.type == "cpu" else _WINDOWS_ELSEWHERE
        kinds = np.split(table, np.searchsorted(table[1], [2, 3]), axis=1)  # of one, of two, and of more frames
        blocks = [kind[:, at : at + most] for kind in kinds for at in range(0, kind.shape[1], most)]
        return [
            cls._block(torch.from_numpy(block).to(device), int(block[1].min()), int(block[1].max()), stride)
            for block in blocks
        ]

    @classmethod
    def _block(cls, table: Int[Tensor, "4 windows"], shortest: int, longest: int, stride: int) -> _Windows:
        first, length, start, end = table
        at = torch.arange(longest, device=table.device)[:, None]
        rows = first + stride * torch.minimum(at, length - 1)
        return cls(rows, length, (at >= start) & (at < end), shortest)

    def take(self, value: Float[Tensor, "*any frames"]) -> Float[Tensor, "*any longest windows"]:
        """Return what belongs to the windows' frames."""
        return value.index_select(-1, self.rows.flatten()).unflatten(-1, self.rows.shape)


def _counted(counts: Int[np.ndarray, " groups"]) -> Int[np.ndarray, " all"]:
    """Return 0, 1, 2, ... for each of the groups, of so many, one group after the other."""
    return np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)


def _marginals(
    ends: Sequence[Float[Tensor, "_ 3 frames"]],
    likely: Float[Tensor, "states frames"],
    windows: Sequence[_Windows],
    pace: float,
) -> Float[Tensor, "states frames"]:
    """Return the probability of each state given all frames of its window (forward-backward, Rabiner 1989).

    Joints move as little as Cauchy-distributed accelerations, or speeds, allow. ``ends`` are those of `_Scene`, ``pace`` is
    the time between frames over that of `_RATE`.
    """
    result = likely / likely.sum(0)

    def solve(block: _Windows) -> None:
        seen, longest = block.take(likely), len(block.rows)
        if longest == 1:
            return
        if longest == 2 or len(likely) > _SECOND_ORDER:
            found = _by_speed([block.take(end) / (_SPEED * pace) for end in ends], seen, block)
        else:
            found = _by_acceleration([block.take(end) / (_ACCELERATION * pace**2) for end in ends], seen, block)
        core = block.core.flatten().nonzero()[:, 0]
        result[:, block.rows.flatten()[core]] = found.flatten(1)[:, core]

    in_threads(solve, ranks.my_parts(windows), likely.device, "deciding depth signs")
    if ranks.world() > 1:
        ranks.filled(result.T, [block.rows.flatten()[block.core.flatten()] for block in windows])
    return result


def _products(one: Tensor, other: Tensor) -> Float[Tensor, "states states frames windows"]:
    """Return the scalar products of points (states 3 frames windows) of two frames."""
    products = one[:, None, 0] * other[None, :, 0]
    for axis in (1, 2):
        products.addcmul_(one[:, None, axis], other[None, :, axis])
    return products


def _grown(one: Tensor, before: Tensor | None, axes: int) -> Tensor:
    """Return ``one``, of a bone's states in so many frames, times that of the bones before it, whose states are half as many each."""
    if before is None:
        return one
    for axis in range(axes):
        one, before = one.unflatten(2 * axis, (-1, 2)), before.unsqueeze(2 * axis + 1)
    one.mul_(before)
    for axis in range(axes):
        one = one.flatten(axis, axis + 1)
    return one


def _by_acceleration(
    place: Sequence[Float[Tensor, "_ 3 frames windows"]], seen: Float[Tensor, "states frames windows"], block: _Windows
) -> Float[Tensor, "states frames windows"]:
    """Return the marginals of a chain of second order: a state depends on the two before it.

    ``place`` in the width of the distribution of accelerations. How far a step is from likely, of the states a, b and c of
    three frames, is a product over bones of 1 + |a - 2b + c|^2.
    """
    parts = []
    for points in place:
        square = points.square().sum(1)
        near, far = (
            _products(points[..., :-1, :], points[..., 1:, :]),
            _products(points[..., :-2, :], points[..., 2:, :]),
        )
        start = (square[:, None, :-2] + 1).sub(near[:, :, :-1], alpha=4).add_(square[None, :, 1:-1], alpha=4)
        parts.append((start, square[None, :, 2:].sub(near[:, :, 1:], alpha=4), far.mul_(2)))
    states, frames, windows = seen.shape
    step = seen.new_empty(frames - 2, states, states, states, windows)
    room = [seen.new_empty(*[len(points)] * 3, windows) for points in place[:-1]]
    forward, work = [seen[:, None, 0] * seen[None, :, 1]], torch.empty_like(step[0])
    for at in range(frames - 2):
        one = None
        for (start, end, far), out in zip(parts, [*room, step[at]], strict=True):
            both = torch.add(start[:, :, None, at], end[None, :, :, at], out=out)
            one = _grown(both.add_(far[:, None, :, at]), one, 3)
        message = torch.div(forward[-1][:, :, None], step[at], out=work).sum(0).mul_(seen[:, at + 2])
        forward.append(message.div_(message.sum((0, 1))))
    backward, found = torch.ones_like(forward[0]), torch.empty_like(seen)
    for at in range(frames - 1, 0, -1):
        pair = forward[at - 1] * backward
        torch.sum(pair, 0, out=found[:, at])
        if at > 1:
            backward = torch.div(backward * seen[:, at], step[at - 2], out=work).sum(2)
            backward = _after_end(backward.div_(backward.amax((0, 1))), at, block)
        else:
            torch.sum(pair, 1, out=found[:, 0])
    return found.div_(found.sum(0))


def _after_end(backward: Tensor, at: int, block: _Windows) -> Tensor:
    """Return the message to a frame; one that comes from behind a window's end says nothing."""
    return backward if at < block.shortest else backward.where(at < block.length, 1.0)


def _by_speed(
    place: Sequence[Float[Tensor, "_ 3 frames windows"]], seen: Float[Tensor, "states frames windows"], block: _Windows
) -> Float[Tensor, "states frames windows"]:
    """Return the marginals of a chain of first order: a state depends on the one before it.

    ``place`` in the width of the distribution of speeds.
    """
    step = None
    for points in place:
        square, near = points.square().sum(1), _products(points[..., :-1, :], points[..., 1:, :])
        away = near.mul_(-2).add_(square[:, None, :-1]).add_(square[None, :, 1:]).clamp_min_(0).add_(1)
        step = _grown(away, step, 2)
    assert step is not None
    forward, frames = [seen[:, 0]], seen.shape[1]
    for at in range(1, frames):
        message = (forward[-1][:, None] / step[:, :, at - 1]).sum(0).mul_(seen[:, at])
        forward.append(message.div_(message.sum(0)))
    backward, found = torch.ones_like(forward[0]), [forward[-1]]
    for at in range(frames - 1, 0, -1):
        backward = ((seen[:, at] * backward) / step[:, :, at - 1]).sum(1)
        backward = _after_end(backward.div_(backward.amax(0)), at, block)
        found.append(forward[at - 1] * backward)
    result = torch.stack(found[::-1], 1)
    return result.div_(result.sum(0))


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
    windows, clips = _Windows.of(frames, stride), (~frames.follows).cumsum(0)
    follows = frames.follows | pad(frames.follows[1:], (0, 1))
    evidence = torch.where(follows, _EVIDENCE, 1.0)[:, None]
    found = pose.new_zeros(pose.shape[1], 3, len(pose))
    spread, likely = torch.zeros_like(found[:, 0]), []
    for place, (chain, part) in enumerate(zip(chains.chains, chains.split(logits), strict=True)):
        start, children = chain[0][0], [child for _, child in chain]
        ends = scene.ends(place, found[start])
        seen = (evidence * part.clamp_min(_LEAST)).softmax(1).T.contiguous()
        state = _smooth(_marginals(ends, seen, windows, stride * _RATE / fps), clips, stride)
        for child, end in zip(children, ends, strict=True):
            chance = state.unflatten(0, (len(end), -1)).sum(1)
            mean = (chance[:, None] * end).sum(0)
            found[child] = mean
            spread[child] = (chance * (end - mean).square().sum(1)).sum(0) + spread[start]
        likely.append(state.T)
    deviation = spread.sqrt().T / size[:, None]
    solution = Solution(pose, deviation, likely, scene, size, frames.rotation)
    weight = torch.where(follows[:, None], 1.0, _weight_alone(deviation, uncertainty))
    return replace(solution, pose=torch.lerp(pose, solution.in_units(found.permute(2, 0, 1)), weight[..., None]))


def _weight_alone(deviation: Tensor, uncertainty: Tensor | None) -> Float[Tensor, "frames joints"]:
    """Return the weight of the answer, beside the pose given, in frames without neighbours.

    Where the signs leave little open the answer knows no more than the pose, but takes all bones for stiff.
    """
    if uncertainty is None:
        return torch.full_like(deviation, 0.5)
    return deviation / (deviation + uncertainty).clamp_min(1e-9)


def _smooth(
    state: Float[Tensor, "states frames"], clip: Int[Tensor, " frames"], stride: int
) -> Float[Tensor, "states frames"]:
    """Return the mean over ``stride`` neighbours in time, each of which was solved with others."""
    total, count = torch.zeros_like(state), torch.zeros_like(state[0])
    for shift in range(-(stride // 2), (stride + 1) // 2):
        here = slice(max(0, -shift), max(0, state.shape[1] - max(0, shift)))
        there = slice(max(0, shift), max(0, state.shape[1] - max(0, -shift)))
        same = (clip[there] == clip[here]).to(state.dtype)
        total[:, here].addcmul_(state[:, there], same)
        count[here] += same
    return total / count


# Several hypotheses: clusters of the poses that the states of all chains describe.

_BLOCK_FRAMES = 2000
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
    for rows in torch.arange(len(solution.pose), device=solution.pose.device).split(_BLOCK_FRAMES):
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
