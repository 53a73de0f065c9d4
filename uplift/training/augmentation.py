"""Augmented views for a student: limbs mixed, mirrored, rotated, partly hidden, noisy."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from uplift.config.ranks import mean, total
from uplift.config.settings import StudentSettings
from uplift.data.clean import MIN_VISIBLE, joint_neighbours
from uplift.data.sampler import LabelledSampler
from uplift.data.samples import Samples
from uplift.geometry.camera import Camera
from uplift.geometry.normalise import mirror, renormalise
from uplift.geometry.rotation import about_y, about_z, least_rotation, level, nearest_rotation, random_rotations, turn
from uplift.models.lifter import Lifted
from uplift.skeleton import Skeleton
from uplift.training.pseudo_labels import PseudoPoses

__all__ = [
    "TILT_WEIGHT",
    "LimbMixer",
    "ShownViews",
    "ViewMaker",
    "depth_error",
    "distance_error",
    "gravity_error",
    "tilt_error",
]

# Limb mixing: new poses from limbs of one pose on the body of another.

_TEMPLATE_FRAMES = 20_000
_TINY = 1e-6
_JOINT_OFFSET = 0.5
"""Length of bones, in mean 2D radii, that vary by as much for ideas of where joints are as for bodies."""
_MOST_STRETCH = 3.0
"""Of short bones, beside 1 of long ones."""


@dataclass(frozen=True)
class _Limb:
    """One child of a branching joint and all below it: a leg on the hips, the trunk and all above it."""

    branch: int
    """Index of the branching joint that it is attached to."""
    bones: Tensor
    """Its bones but the first, which belongs to the branching joint."""
    joints: Tensor
    """The joints at the far ends of those bones."""
    inner: list[int]
    """Branching joints inside it, which rotate with it."""


class LimbMixer:
    """Swaps limbs between poses in the frame of the joint they are attached to, at the receiver's bone lengths.

    Training motions are few, and arms seen with one pair of legs are as realistic with another. A branching
    joint's frame is the rotation that best fits its bones to their mean directions (Kabsch 1976), so a swapped
    limb keeps its angles to the body.
    """

    def __init__(self, pose: Float[Tensor, "frames joints 3"], skeleton: Skeleton):
        children = _children(skeleton)
        parents = {child: parent for parent, below in children.items() for child in below}
        order = _below(skeleton.root_index, children)
        ends = order[1:]
        bone_of = {joint: bone for bone, joint in enumerate(ends)}
        self._path = pose.new_zeros(len(skeleton.joints), len(ends))
        """(joints bones), 1 where a bone lies between the root and the joint."""
        for joint, bone in bone_of.items():
            self._path[_below(joint, children), bone] = 1
        self._bones = pose[:, ends] - pose[:, [parents[joint] for joint in ends]]
        self._lengths = self._bones.norm(dim=-1, keepdim=True).clamp_min(_TINY)
        twin = [bone_of.get(skeleton.mirror_permutation[joint], bone) for bone, joint in enumerate(ends)]
        self._group = torch.tensor([min(bone, other) for bone, other in enumerate(twin)], device=pose.device)
        """(bones,): a bone and its mirror image have one number."""
        usual = self._lengths[..., 0].median(0).values
        usual = (usual + usual[twin]) / 2
        self._spread = (1 + (_JOINT_OFFSET / usual.clamp_min(_TINY)).square().clamp_max(_MOST_STRETCH**2)).sqrt()
        """(bones,): bodies differ by a share of each bone, ideas of where a joint is by the same length for all."""
        branching = [j for j in order if len(children[j]) >= 2]
        frames = []
        self._limbs: list[_Limb] = []
        for place, joint in enumerate(branching):
            directions = [self._bones[:, bone_of[child]] for child in children[joint]]
            if joint in parents:
                directions.append(-self._bones[:, bone_of[joint]])
            frames.append(_body_frames(torch.stack(directions, 1)))
            for child in children[joint]:
                below = _below(child, children)
                if len(below) > 1:
                    joints = torch.tensor(below[1:], device=pose.device)
                    bones = torch.tensor([bone_of[j] for j in below[1:]], device=pose.device)
                    self._limbs.append(_Limb(place, bones, joints, [i for i, j in enumerate(branching) if j in below]))
        self._frames = torch.stack(frames, 1) if frames else pose.new_zeros(len(pose), 0, 3, 3)

    def __call__(
        self,
        rows: Int[Tensor, " batch"],
        confidence: Float[Tensor, "frames joints"],
        *,
        share: float,
        limb: float,
        stretch: float = 0.0,
    ) -> tuple[Float[Tensor, "batch joints 3"], Float[Tensor, "batch joints"]]:
        """Return the poses of ``rows`` with limbs of others in the batch, and each joint's confidence.

        A ``share`` of the poses takes part, and each limb is swapped in a share ``limb`` of those. The log of each
        bone's length varies by ``stretch``, by more for short bones and as much on the left as on the right: so do
        bodies, and where trackers think that joints are.
        """
        bones, frames, mixed = self._bones[rows], self._frames[rows], confidence[rows]
        count = len(rows)
        taking = torch.randperm(count, device=rows.device)[: round(share * count)]
        for part in self._limbs:
            takers = taking[torch.randperm(len(taking), device=rows.device)[: round(limb * len(taking))]]
            givers = rows[torch.randint(count, (len(takers),), device=rows.device)]
            at = takers[:, None]
            rotation = frames[takers, part.branch] @ self._frames[givers, part.branch].mT
            given = self._bones[givers[:, None], part.bones] @ rotation.mT
            lengths = self._lengths[rows[takers][:, None], part.bones] / self._lengths[givers[:, None], part.bones]
            bones[at, part.bones] = given * lengths
            # Missing on either body is missing: an invisible limb has no length.
            seen = confidence[rows[takers][:, None], part.joints] > 0
            mixed[at, part.joints] = confidence[givers[:, None], part.joints] * seen
            for inner in part.inner:
                frames[takers, inner] = rotation @ self._frames[givers, inner]
        if stretch:
            log = stretch * self._spread * torch.randn(count, len(self._spread), device=rows.device)
            bones = bones * log[:, self._group].exp().unsqueeze(-1)
        return self._path @ bones, mixed


def _children(skeleton: Skeleton) -> dict[int, list[int]]:
    """Return the children of every joint in the skeleton's tree, by index."""
    children: dict[int, list[int]] = {joint: [] for joint in range(len(skeleton.joints))}
    for child, parent in skeleton.parents.items():
        if parent is not None:
            children[skeleton.index(parent)].append(skeleton.index(child))
    return children


def _below(joint: int, children: dict[int, list[int]]) -> list[int]:
    """Return ``joint`` and all joints below it, parents first."""
    return [joint, *(below for child in children[joint] for below in _below(child, children))]


def _body_frames(directions: Float[Tensor, "frames bones 3"]) -> Float[Tensor, "frames 3 3"]:
    """Return the rotations from the mean directions of the bones to those of each frame."""
    directions = normalize(directions, dim=-1)
    sample = directions[:: max(1, len(directions) // _TEMPLATE_FRAMES)]
    template = sample[0]
    for _ in range(3):
        template = (nearest_rotation(sample.mT @ template).mT @ sample.mT).mean(0).T
    return nearest_rotation(directions.mT @ template)


# Augmented views of poses and how well a lifter does on them.

_LIMB_SHARE = 0.3
_MOST_HIDDEN = 0.5
TILT_WEIGHT = 0.1
"""Of an error of the tilt in radians, beside that of depths in units."""


@dataclass(frozen=True)
class ShownViews(Samples):
    """Augmented views: input and targets of a lifter, in units of the input's mean radius."""

    input: Float[Tensor, "views joints 2"]
    """Keypoints with noise, relative to the root with its noise."""
    confidence: Float[Tensor, "views joints"]
    """Of `input`; 0 for missing and hidden joints."""
    keypoints: Float[Tensor, "views joints 2"]
    """Keypoints without noise, relative to the true root."""
    pose: Float[Tensor, "views joints 3"]
    tilt: Float[Tensor, " views"]
    """Radians."""
    gravity: Float[Tensor, "views 3"]
    """Its direction in the frame of the camera that looks at the root."""
    distance: Float[Tensor, " views"]
    weight: Float[Tensor, "views joints"]
    """Confidence of the poses; 0 where there is nothing to learn."""
    told: Float[Tensor, " views"]
    """The distance that the lifter is told; `distance`, or a guess."""
    guessed: Bool[Tensor, " views"]
    """Where it is a guess."""
    upright: Bool[Tensor, " views"]
    """Whether bodies stand as they were seen; others are turned over, any way, for depth signs alone."""

    def only_upright(self) -> ShownViews:
        """Return the views with nothing to learn from those that are turned over."""
        return replace(self, weight=self.weight * self.upright[:, None])


def depth_error(lifted: Lifted, views: ShownViews) -> Float[Tensor, ""]:
    """Return the weighted mean absolute error of the depths."""
    error = (lifted.pose[..., 2] - views.pose[..., 2]).abs()
    off, known = total((error * views.weight).sum(), views.weight.sum())
    return off / known.clamp_min(1)


def tilt_error(lifted: Lifted, views: ShownViews) -> Float[Tensor, ""]:
    """Return the mean absolute error of the tilts, in radians."""
    return mean(((lifted.tilt - views.tilt).abs() * views.upright).mean())[0]


def gravity_error(lifted: Lifted, views: ShownViews) -> Float[Tensor, ""]:
    """Return the mean distance of gravity from its true unit vector."""
    assert lifted.gravity is not None
    return mean(((lifted.gravity - views.gravity).norm(dim=-1) * views.upright).mean())[0]


def distance_error(lifted: Lifted, views: ShownViews) -> Float[Tensor, ""]:
    """Return the mean absolute error of the logarithm of the guessed distances."""
    assert lifted.distance is not None
    error = (lifted.distance / views.distance).log().abs() * views.guessed
    off, guessed = total(error.sum(), views.guessed.sum().to(error.dtype))
    return off / guessed.clamp_min(1)


_FOCAL_SPREAD = 0.35
"""Standard deviation of the logarithm of a guessed focal length over the true one: lenses have 0.7 to 1.5 of the image's
longest side."""
_NO_IMAGE = 0.15
"""Share of the views with a guessed distance whose image size is unknown too: no camera can be turned to the root."""
_ASIDE = 0.3
"""Largest x/z and y/z of the root in any cameras."""
_NEAREST = 0.1
"""Of the distance: a joint at or behind the pinhole is held there, as `Perspective` does."""


class _Shown(NamedTuple):
    """Poses as cameras see them that are turned to the root, in the units of the poses; see `ShownViews`."""

    pose: Tensor
    gravity: Tensor
    keypoints: Tensor
    distance: Tensor
    told: Tensor
    """NaN where not even a guess is known."""
    guessed: Tensor


class ViewMaker:
    """Makes random augmented views of ``poses``, with torch's global random numbers.

    They are seen by the cameras of the poses; with ``usual_distance``, which is what a camera of unknown distance is
    told, all but `StudentSettings.own_share` of them by any camera.
    """

    def __init__(
        self,
        poses: PseudoPoses,
        camera: Camera,
        settings: StudentSettings,
        *,
        count_root: bool,
        labelled_share: float | None = None,
        usual_distance: float | None = None,
    ):
        self.usual_distance = usual_distance
        self.poses, self.camera, self.settings, self.count_root = poses, camera, settings, count_root
        labelled = torch.zeros_like(poses.distance, dtype=torch.bool) if poses.labelled is None else poses.labelled
        self.sampler = LabelledSampler(labelled, labelled_share)
        skeleton, device = poses.skeleton, poses.pose.device
        self.mirrors = settings.mirror and skeleton.has_mirror_image
        self.swap = torch.tensor(skeleton.mirror_permutation, device=device)
        self.rings = [torch.tensor(ring, device=device) for ring in joint_neighbours(skeleton)]
        self.axes = torch.eye(3, dtype=poses.pose.dtype, device=device)
        self._own: dict[int, tuple[Tensor, Tensor, Tensor]] = {}
        self.limbs = _limbs(skeleton).to(device)
        mixes = (settings.mix or settings.stretch) and not skeleton.rigid
        self.mixer = LimbMixer(poses.pose, skeleton) if mixes else None

    def __call__(self, count: int) -> ShownViews:
        """Return ``count`` views."""
        poses, root = self.poses, self.poses.skeleton.root_index
        rows = self.sampler(count)
        pose, weight = self._mixed(rows)
        pose, upright = self._turned_over(pose)
        shown = self._shown(pose, rows)
        seen, confidence = shown.keypoints.clone(), weight
        if poses.noise is not None and self.settings.noise:
            # Error and confidence of one real frame belong together.
            other = self._draw(count)
            seen = seen + poses.noise[other]
            confidence = poses.confidence[other] * (weight > 0)
        confidence = self._hide(confidence)
        # The radius is that of the visible joints, as in real data. A view with too few of them has no weight.
        few = ((confidence > 0).sum(1, keepdim=True)) < MIN_VISIBLE
        weight, counted = weight.masked_fill(few, 0), confidence.masked_fill(few, 1)
        seen[:, root] = _stand_in(seen, confidence, root, self.rings)
        noisy, radius = renormalise(seen, counted, root, count_root=self.count_root)
        exact = (shown.keypoints - shown.keypoints[:, root, None]) / radius[:, None, None]
        tilt = torch.asin(shown.gravity[:, 2].clamp(-1, 1))
        pose, told = shown.pose / radius[:, None, None], shown.told / radius
        if self.usual_distance is not None:
            told = told.nan_to_num(self.usual_distance)
        camera = (tilt, shown.gravity, shown.distance / radius)
        return ShownViews(noisy, confidence, exact, pose, *camera, weight, told, shown.guessed, upright)

    def _draw(self, count: int) -> Tensor:
        return torch.randint(len(self.poses), (count,), device=self.poses.pose.device)

    def _mixed(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the poses of ``rows`` with limbs of others, half of them mirrored, and their confidence."""
        poses, settings = self.poses, self.settings
        if self.mixer is None:
            pose, confidence = poses.pose[rows], poses.confidence[rows]
        else:
            pose, confidence = self.mixer(
                rows, poses.confidence, share=settings.mix, limb=settings.mix_limb, stretch=settings.stretch
            )
        if self.mirrors:
            flip = torch.rand(len(rows), device=rows.device) < 0.5
            pose = torch.where(flip[:, None, None], mirror(pose, self.swap), pose)
            confidence = torch.where(flip[:, None], confidence[:, self.swap], confidence)
        return pose, confidence

    def _turned_over(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Return the poses, some turned any way (a handstand is a standing body turned over), and which are not."""
        upright = torch.ones(len(pose), dtype=torch.bool, device=pose.device)
        if not (self.settings.any_way and self.settings.turn and self.poses.skeleton.gravity):
            return pose, upright
        upright = torch.rand(len(pose), device=pose.device) >= self.settings.any_way
        turned = turn(pose, random_rotations(len(pose), pose.device))
        return torch.where(upright[:, None, None], pose, turned), upright

    def _shown(self, level: Tensor, rows: Tensor) -> _Shown:
        """Return the level poses of ``rows`` as cameras see them."""
        if self.usual_distance is None:
            return self._by_own_cameras(level, rows)
        first, second, order = self._own_and_any(len(rows))
        parts = [self._by_own_cameras(level[first], rows[first]), self._by_any_camera(level[second])]
        return _Shown(*(torch.cat(both)[order] for both in zip(*parts, strict=True)))

    def _own_and_any(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return which of ``count`` views are by cameras of their own, which by any, and the order of both together.

        They are evenly spread and always the same, as rows are random and a choice would make a GPU wait.
        """
        if count not in self._own:
            whole = (torch.arange(count + 1, dtype=torch.float64) * self.settings.own_share).floor()
            own = whole.diff() > 0
            parts = own.nonzero()[:, 0], (~own).nonzero()[:, 0]
            first, second, order = (part.to(self.axes.device) for part in (*parts, torch.cat(parts).argsort()))
            self._own = {count: (first, second, order)}
        return self._own[count]

    def _by_own_cameras(self, level: Tensor, rows: Tensor) -> _Shown:
        """Return the level poses of ``rows`` as cameras like their own see them."""
        pose, gravity = self._rotated(level, rows)
        distance = self.poses.distance[rows]
        guessed = torch.zeros_like(rows, dtype=torch.bool) if self.poses.guessed is None else self.poses.guessed[rows]
        told = distance if self.usual_distance is None else distance.masked_fill(guessed, math.nan)
        return _Shown(pose, gravity, self.camera.project(pose, distance), distance, told, guessed)

    def _by_any_camera(self, level: Tensor) -> _Shown:
        """Return level poses as any camera sees them.

        Where the focal length is unknown, all is as if it were the guessed one: the camera is turned to where the root
        then seems to be, and the distance that goes with the guess is off by the same factor.
        """
        count, device = len(level), level.device
        view = self._any_views(count, device)
        low, high = (math.log(end) for end in self.settings.distance)
        distance = (low + (high - low) * torch.rand(count, device=device)).exp()
        aside = _ASIDE * (2 * torch.rand(count, 2, device=device) - 1)
        ahead = normalize(torch.cat([aside, torch.ones_like(aside[:, :1])], 1), dim=-1)
        guessed = torch.rand(count, device=device) < self.settings.unknown_focal
        wrong = torch.where(guessed, (_FOCAL_SPREAD * torch.randn(count, device=device)).exp(), 1.0)
        straight = guessed & (torch.rand(count, device=device) < _NO_IMAGE)
        pose = turn(level, view)
        place = pose + (distance[:, None] * ahead)[:, None]
        rays = place[..., :2] / torch.maximum(place[..., 2:], _NEAREST * distance[:, None, None]) / wrong[:, None, None]
        rays = torch.cat([rays, torch.ones_like(rays[..., :1])], -1)
        root = self.poses.skeleton.root_index
        look = least_rotation(rays[:, root], self.axes[2])
        look = torch.where(straight[:, None, None], self.axes, look)
        rays = turn(rays, look)
        told = distance * wrong
        keypoints = rays[..., :2] / rays[..., 2:].clamp_min(_NEAREST) * told[:, None, None]
        keypoints = keypoints - keypoints[:, root, None]
        gravity = (look @ view)[:, :, 1]
        return _Shown(turn(pose, look), gravity, keypoints, distance, told.masked_fill(straight, math.nan), guessed)

    def _any_views(self, count: int, device: torch.device) -> Tensor:
        """Return the rotations from the level frame to random cameras."""
        if not self.poses.skeleton.gravity:
            return random_rotations(count, device)
        (low, high), most = (math.radians(end) for end in self.settings.tilt_deg), math.radians(self.settings.roll_deg)
        tilt = low + (high - low) * torch.rand(count, device=device)
        roll = most * (2 * torch.rand(count, device=device) - 1)
        azimuth = 2 * torch.pi * torch.rand(count, device=device)
        return about_z(roll) @ level(tilt).mT @ about_y(azimuth)

    def _rotated(self, pose: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the level poses of ``rows`` in the frames of random cameras (or the real ones), and gravity there."""
        count, device = len(pose), pose.device
        down = self.axes[1]
        if not self.settings.turn:
            gravity = self.poses.gravity[rows]
            return (turn(pose, least_rotation(gravity, down).mT) if self.poses.skeleton.gravity else pose), gravity
        gravity = self.poses.gravity[self._draw(count)]
        if not self.poses.skeleton.gravity:
            return turn(pose, random_rotations(count, device)), gravity
        azimuth = 2 * torch.pi * torch.rand(count, device=device)
        return turn(pose, least_rotation(gravity, down).mT @ about_y(azimuth)), gravity

    def _hide(self, confidence: Tensor) -> Tensor:
        """Return the confidence, set to 0 for some joints of some views: a random share of them, or a limb."""
        if not self.settings.occlude:
            return confidence
        count, device = len(confidence), confidence.device
        share = _MOST_HIDDEN * torch.rand(count, 1, device=device)
        hidden = torch.rand(confidence.shape, device=device) < share
        if len(self.limbs):
            limb = self.limbs[torch.randint(len(self.limbs), (count,), device=device)]
            hidden = torch.where(torch.rand(count, 1, device=device) < _LIMB_SHARE, limb, hidden)
        hidden &= torch.rand(count, 1, device=device) < self.settings.occlude
        return confidence.masked_fill(hidden, 0)


def _stand_in(keypoints: Tensor, confidence: Tensor, root: int, rings: list[Tensor]) -> Tensor:
    """Return the root, or where it is missing the mean of its nearest visible neighbours, as `clean` does."""
    origin, missing = keypoints[:, root], confidence[:, root] == 0
    for ring in rings:
        weight = (confidence.index_select(1, ring) > 0).to(keypoints.dtype).unsqueeze(-1)
        mean = (keypoints.index_select(1, ring) * weight).sum(1) / weight.sum(1).clamp_min(1)
        use = missing & (weight.sum((1, 2)) > 0)
        origin = torch.where(use[:, None], mean, origin)
        missing = missing & ~use
    return origin


def _limbs(skeleton: Skeleton) -> Tensor:
    """Return (limbs joints) bool: every joint with all below it, where that is at most a third of the body."""
    children, count = _children(skeleton), len(skeleton.joints)
    limbs = [_below(joint, children) for joint in children]
    found = {tuple(joint in limb for joint in children) for limb in limbs if 2 <= len(limb) <= count / 3}
    return torch.tensor(sorted(found), dtype=torch.bool).reshape(-1, count)
