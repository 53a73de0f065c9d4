"""New poses out of those there are: limbs of one on the body of another."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from uplift.skeleton import Skeleton

__all__ = ["LimbMixer"]

_TEMPLATE_FRAMES = 20_000
_TINY = 1e-6


@dataclass(frozen=True)
class _Limb:
    """What hangs on one child of a branching joint: a leg on the hips, the trunk and all above it."""

    branch: int
    """Which branching joint it hangs on."""
    bones: Tensor
    """Its bones, without the first, which belongs to the branching joint."""
    joints: Tensor
    """The joints at the far ends of those bones."""
    inner: list[int]
    """Branching joints inside it: they turn with it."""


class LimbMixer:
    """Swaps limbs between poses in the frame of the joint they hang on, at the receiver's bone lengths.

    Training motions are few and test motions are others; arms that were seen with one pair of legs
    are as real with another. A branching joint's frame is the rotation that fits its bones best to
    their mean directions (Kabsch 1976), so a swapped limb keeps its angles to the body.
    """

    def __init__(self, pose: Float[Tensor, "frames joints 3"], skeleton: Skeleton):
        parents = {skeleton.index(c): skeleton.index(p) for c, p in skeleton.parents.items() if p is not None}
        children: dict[int, list[int]] = {j: [] for j in range(len(skeleton.joints))}
        for child, parent in parents.items():
            children[parent].append(child)
        order = _below(skeleton.root_index, children)
        self._ends = torch.tensor([j for j in order if j in parents], device=pose.device)
        bone_of = {int(j): i for i, j in enumerate(self._ends)}
        starts = torch.tensor([parents[int(j)] for j in self._ends], device=pose.device)
        self._path = _paths(parents, bone_of, len(skeleton.joints)).to(pose)
        self._bones = pose[:, self._ends] - pose[:, starts]
        self._lengths = self._bones.norm(dim=-1, keepdim=True).clamp_min(_TINY)
        branching = [j for j in order if len(children[j]) >= 2]
        frames = []
        self._limbs: list[_Limb] = []
        for place, joint in enumerate(branching):
            ways = [self._bones[:, bone_of[child]] for child in children[joint]]
            if joint in parents:
                ways.append(-self._bones[:, bone_of[joint]])
            frames.append(_body_frames(torch.stack(ways, 1)))
            for child in children[joint]:
                below = _below(child, children)
                if len(below) > 1:
                    bones = torch.tensor([bone_of[j] for j in below[1:]], device=pose.device)
                    inner = [i for i, j in enumerate(branching) if j in below]
                    self._limbs.append(_Limb(place, bones, self._ends[bones], inner))
        self._frames = torch.stack(frames, 1) if frames else pose.new_zeros(len(pose), 0, 3, 3)

    def __call__(
        self,
        rows: Int[Tensor, " batch"],
        confidence: Float[Tensor, "frames joints"],
        *,
        share: float,
        limb: float,
    ) -> tuple[Float[Tensor, "batch joints 3"], Float[Tensor, "batch joints"]]:
        """Return the poses of ``rows`` with limbs of others of the batch, and each joint's confidence.

        ``share`` of the poses take part, and each of their limbs is swapped with probability ``limb``.
        """
        bones, frames, sure = self._bones[rows], self._frames[rows], confidence[rows]
        count = len(rows)
        taking = torch.rand(count, device=rows.device) < share
        for part in self._limbs:
            takers = (taking & (torch.rand(count, device=rows.device) < limb)).nonzero()[:, 0]
            givers = rows[torch.randint(count, (len(takers),), device=rows.device)]
            at = takers[:, None]
            rotation = frames[takers, part.branch] @ self._frames[givers, part.branch].mT
            given = self._bones[givers[:, None], part.bones] @ rotation.mT
            lengths = self._lengths[rows[takers][:, None], part.bones] / self._lengths[givers[:, None], part.bones]
            bones[at, part.bones] = given * lengths
            # Missing on either body is missing: a limb that was not seen has no length to give it.
            seen = confidence[rows[takers][:, None], part.joints] > 0
            sure[at, part.joints] = confidence[givers[:, None], part.joints] * seen
            for inner in part.inner:
                frames[takers, inner] = rotation @ self._frames[givers, inner]
        return self._path @ bones, sure


def _below(joint: int, children: dict[int, list[int]]) -> list[int]:
    """Return ``joint`` and all joints below it, parents first."""
    found = [joint]
    for child in children[joint]:
        found += _below(child, children)
    return found


def _paths(parents: dict[int, int], bone_of: dict[int, int], joints: int) -> Tensor:
    """Return (joints bones): 1 where a bone lies between the root and the joint."""
    path = torch.zeros(joints, len(bone_of))
    for joint in range(joints):
        above = joint
        while above in parents:
            path[joint, bone_of[above]] = 1
            above = parents[above]
    return path


def _body_frames(ways: Float[Tensor, "frames ways 3"]) -> Float[Tensor, "frames 3 3"]:
    """Return the rotations that take the mean directions of the bones to each frame's own."""
    ways = normalize(ways, dim=-1)
    sample = ways[:: max(1, len(ways) // _TEMPLATE_FRAMES)]
    template = sample[0]
    for _ in range(3):
        template = (_fit(sample, template).mT @ sample.mT).mean(0).T
    return _fit(ways, template)


def _fit(ways: Tensor, template: Tensor) -> Tensor:
    """Return the proper rotations R for which ``template @ R.T`` is nearest to ``ways``."""
    left, _, right = torch.linalg.svd(ways.mT @ template)
    proper = torch.linalg.det(left @ right)
    left = torch.cat([left[..., :2], left[..., 2:] * proper[:, None, None]], -1)
    return left @ right
