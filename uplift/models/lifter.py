"""The lifter: normalised 2D keypoints and confidence in, depth and the camera's tilt out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from uplift.config.settings import LifterSettings
from uplift.data.samples import Samples
from uplift.geometry.camera import build_camera
from uplift.geometry.normalise import bone_lengths, mirror
from uplift.geometry.rotation import least_rotation, level
from uplift.models.networks import ResidualNetwork, build_network
from uplift.models.signs import SignChains
from uplift.skeleton import Skeleton

__all__ = ["Lifted", "Lifter", "mixed_networks", "networks_precision", "without_signs"]

_LOG_UNCERTAINTY = (-5.0, 2.0)
_USUAL_DISTANCE = 10.0
"""In units, where the network's input for the distance is 0."""


@dataclass(frozen=True)
class Lifted(Samples):
    """Poses that a lifter estimates from a batch of keypoints."""

    pose: Float[Tensor, "batch joints 3"]
    """Camera frame, relative to the root, in units of the mean 2D radius."""
    tilt: Float[Tensor, " batch"]
    """Down-tilt of the camera, radians; 0 without gravity or where the camera is assumed to be level."""
    keypoints: Float[Tensor, "batch joints 2"]
    """The keypoints that `pose` projects to: those given, with missing joints filled in."""
    uncertainty: Float[Tensor, "batch joints"] | None = None
    """The expected absolute error of each depth, in units; None where the lifter was not trained to predict it."""
    gravity: Float[Tensor, "batch 3"] | None = None
    """Its direction, in the frame of the camera that looks at the root, of a length near 1; None where only the tilt is
    predicted."""
    distance: Float[Tensor, " batch"] | None = None
    """Of the camera to the root, in units: the one given, or the lifter's estimate where that is a guess; None for a
    lifter that does not estimate it."""
    signs: Float[Tensor, "batch states"] | None = None
    """Log-odds of depth signs, the states of all chains (`uplift.models.signs`); None where the lifter does not predict them."""

    def levelling(self) -> Float[Tensor, "batch 3 3"]:
        """Return the rotations that take the poses to the level frame, where y is gravity."""
        if self.gravity is None:
            return level(self.tilt)
        return least_rotation(self.gravity, self.gravity.new_tensor([0.0, 1.0, 0.0]))


_MIXED: ContextVar[torch.dtype | None] = ContextVar("mixed", default=None)


@contextmanager
def mixed_networks(precision: torch.dtype | None) -> Iterator[None]:
    """Compute the networks of lifters inside in mixed ``precision``, if any, and not their geometry."""
    before = _MIXED.set(precision)
    try:
        yield
    finally:
        _MIXED.reset(before)


_SIGNS: ContextVar[bool] = ContextVar("signs", default=True)


@contextmanager
def without_signs(on: bool = True) -> Iterator[None]:
    """Lift without depth signs inside, a second network's; `Lifter.sign_logits` are those alone."""
    before = _SIGNS.set(not on)
    try:
        yield
    finally:
        _SIGNS.reset(before)


def networks_precision(device: torch.device) -> AbstractContextManager[object]:
    precision = _MIXED.get()
    return nullcontext() if precision is None else torch.autocast(device.type, precision)


class Lifter(nn.Module):
    """A network, built as the settings say unless one is given, and the geometry around it.

    ``tilt`` is ``predicted`` (one per pose), ``learned`` (one for all) or ``level``. With ``fill`` the
    network also predicts where missing joints are; without, they stay at the root. With ``denoise`` it
    also moves visible joints, and with ``uncertainty`` it predicts the error of each depth. With ``signs`` a second
    network of that many units predicts the depth signs of bones.
    With ``root_free`` the root's depth is not subtracted, as in the code of Kudo et al. 2018.
    A lifter for ``any_camera`` is told the distance, corrects it where it is a guess, and with gravity predicts its
    direction, roll included, in place of the tilt.
    """

    mirror_permutation: Tensor
    root_place: Tensor
    bones: Tensor
    bone_mm: Tensor
    """(bones,) mean lengths of labelled bodies, mm, 0 where unknown: they make a pose's scale known."""

    def __init__(self, skeleton: Skeleton, settings: LifterSettings, network: nn.Module | None = None):
        super().__init__()
        self.skeleton, self.camera = skeleton, build_camera(settings.camera)
        self.tilt = settings.tilt if skeleton.gravity else "level"
        self.confidence_input, self.root_free = settings.confidence_input, settings.root_free
        self.fill, self.uncertainty = settings.fill, settings.uncertainty
        self.denoise = bool(settings.denoise) and settings.fill
        self.calibrated = settings.confidence == "calibrated"
        self.any_camera = settings.cameras == "any"
        self.gravity = self.any_camera and self.tilt == "predicted"
        inputs, outputs = len(self.input_names()), len(self.output_names())
        joints = len(skeleton.joints)
        sizes = [joints, 2 * joints * self.fill, joints * self.uncertainty, int(self.any_camera)]
        self._sizes = [*sizes, outputs - sum(sizes)]
        if network is None:
            network = build_network(settings.network, inputs, outputs, settings.options)
        self.network = network
        self.chains = SignChains(skeleton)
        self.signs = None
        if settings.signs and not skeleton.rigid:  # all bones of a rigid body turn at once, which depths say better
            self.signs = ResidualNetwork(inputs + 1, sum(self.chains.counts), units=settings.signs, slope=0.1)
        if self.tilt == "learned":
            self.common_tilt = nn.Parameter(torch.zeros(()))
        self.register_buffer("bone_mm", torch.zeros(len(skeleton.bones)))
        self.register_buffer("bones", torch.tensor(skeleton.bone_indices), persistent=False)
        self.register_buffer("mirror_permutation", torch.tensor(skeleton.mirror_permutation), persistent=False)
        self.register_buffer("root_place", torch.tensor([skeleton.root_index]), persistent=False)

    def forward(
        self,
        keypoints: Float[Tensor, "batch joints 2"],
        confidence: Float[Tensor, "batch joints"],
        distance: Float[Tensor, " batch"],
        guessed: Bool[Tensor, " batch"] | None = None,
    ) -> Lifted:
        """Lift normalised keypoints; a joint of confidence 0 is ignored wherever it is.

        Args:
            keypoints: about the root, mean radius 1.
            confidence: 0..1; 0 is missing.
            distance: of the camera to the root, in units.
            guessed: where the distance is a guess, which a lifter for any camera corrects; None: nowhere.
        """
        features, keypoints, visible, guessed = self._seen(keypoints, confidence, distance, guessed)
        with networks_precision(features.device):
            output = self.network(features)
            signs = self._signs(features, distance) if _SIGNS.get() else None
        output = output.to(features.dtype)  # geometry is in full precision
        root = self.skeleton.root_index
        depth, filled, spread, far, camera = output.split(self._sizes, 1)
        if not self.root_free:
            depth = depth - depth[:, root, None]
        if self.fill:
            filled = filled.view_as(keypoints)
            keypoints = keypoints + filled if self.denoise else torch.where(visible, keypoints, filled)
            # A missing root had its neighbours as a stand-in; from here on the origin is the predicted root.
            keypoints = keypoints - keypoints[:, root, None]
        uncertainty = None
        if self.uncertainty:
            uncertainty = spread.clamp(*_LOG_UNCERTAINTY).exp()
            uncertainty = uncertainty.index_fill(1, self.root_place, 0.0)
        gravity = estimated = None
        if self.any_camera:
            distance = estimated = distance * (far[:, 0] * guessed).clamp(-2, 2).exp()
            gravity = _upright(camera) if self.gravity else None
        tilt = self._tilt(camera) if gravity is None else _tilt_of(gravity)
        pose = self.camera.unproject(keypoints, depth, distance)
        return Lifted(pose, tilt, keypoints, uncertainty, gravity, estimated, signs)

    def _seen(
        self, keypoints: Tensor, confidence: Tensor, distance: Tensor, guessed: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return what the networks see, visible keypoints, which those are (batch joints 1), and where distances are guesses."""
        visible = (confidence > 0).unsqueeze(-1)
        keypoints = keypoints * visible
        if self.calibrated:  # a network that is shown errors learns the rest of its poses more slowly
            confidence = visible.squeeze(-1).to(confidence.dtype)
        guessed = torch.zeros_like(distance, dtype=torch.bool) if guessed is None else guessed
        return self._features(keypoints, confidence, distance, guessed), keypoints, visible, guessed

    def sign_logits(
        self,
        keypoints: Float[Tensor, "batch joints 2"],
        confidence: Float[Tensor, "batch joints"],
        distance: Float[Tensor, " batch"],
        guessed: Bool[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch states"] | None:
        """Return `Lifted.signs` of the same keypoints as `forward` takes, without lifting them."""
        features = self._seen(keypoints, confidence, distance, guessed)[0]
        with networks_precision(features.device):
            return self._signs(features, distance)

    @property
    def halves(self) -> bool:
        """Whether the network is one that can multiply in bfloat16 without harm."""
        return bool(getattr(self.network, "exact_ends", False))

    @property
    def knows_signs(self) -> bool:
        """Whether depth signs were learned; weights of a lifter of another skeleton have none (`uplift.models.transfer`)."""
        return self.signs is not None and bool(self.signs.leave.weight.any())

    def input_names(self) -> list[tuple[str, str]]:
        """Return what each number is that the network sees, with its joint: "" where it is of the whole pose."""
        joints = self.skeleton.joints
        names = [(axis, joint) for joint in joints for axis in "xy"]
        names += [("confidence", joint) for joint in joints] * self.confidence_input
        return names + [("distance", ""), ("guessed", "")] * self.any_camera

    def output_names(self) -> list[tuple[str, str]]:
        """Return what each number is that the network returns, as `input_names` does."""
        joints = self.skeleton.joints
        names = [("depth", joint) for joint in joints]
        names += [(f"filled {axis}", joint) for joint in joints for axis in "xy"] * self.fill
        names += [("uncertainty", joint) for joint in joints] * self.uncertainty
        names += [("distance", "")] * self.any_camera
        camera = [f"gravity {axis}" for axis in "xyz"] if self.gravity else ["tilt"] * (self.tilt == "predicted")
        return names + [(name, "") for name in camera]

    def _features(self, keypoints: Tensor, confidence: Tensor, distance: Tensor, guessed: Tensor) -> Tensor:
        """Return what the network sees."""
        parts = [keypoints.flatten(1)]
        if self.confidence_input:
            parts.append(confidence)
        if self.any_camera:
            parts += [(distance / _USUAL_DISTANCE).log().clamp(-2, 2)[:, None], guessed.to(distance.dtype)[:, None]]
        return torch.cat(parts, 1)

    def _signs(self, features: Tensor, distance: Tensor) -> Tensor | None:
        if self.signs is None:
            return None
        return self.signs(torch.cat([features, _USUAL_DISTANCE / distance[:, None]], 1)).to(features.dtype)

    def _tilt(self, camera: Tensor) -> Tensor:
        if self.tilt == "predicted":
            # Learns more slowly than the depths: the camera's tilt should not explain what a pose can.
            return 0.3 * camera[:, 0]
        if self.tilt == "learned":
            return self.common_tilt.expand(len(camera))
        return camera.new_zeros(len(camera))

    def unit_mm(self, pose: Float[Tensor, "batch joints 3"]) -> Float[Tensor, " batch"] | None:
        """Return mm per unit of each pose, for a body as large as the labelled ones; None without any."""
        known = self.bone_mm > 0
        if not known.any():
            return None
        lengths = bone_lengths(pose, self.bones[known])
        return self.bone_mm[known].sum() / lengths.sum(1).clamp_min(1e-6)

    def lift_both_ways(
        self,
        keypoints: Float[Tensor, "batch joints 2"],
        confidence: Float[Tensor, "batch joints"],
        distance: Float[Tensor, " batch"],
        guessed: Bool[Tensor, " batch"] | None = None,
    ) -> Lifted:
        """Return the mean of the lifted keypoints and their lifted mirror image, if any (after Pavllo et al. 2019)."""
        if not self.skeleton.has_mirror_image:
            given = [] if guessed is None else [guessed]
            return self(keypoints, confidence, distance, *given)
        swap, count = self.mirror_permutation, len(keypoints)
        both = self(*self._both_ways(keypoints, confidence, distance, guessed))
        straight, mirrored = both.select(slice(None, count)), both.select(slice(count, None))
        depth = (straight.pose[..., 2] + mirrored.pose[:, swap, 2]) / 2
        filled = (straight.keypoints + mirror(mirrored.keypoints, swap)) / 2
        uncertainty = None
        if straight.uncertainty is not None and mirrored.uncertainty is not None:
            uncertainty = (straight.uncertainty + mirrored.uncertainty[:, swap]) / 2
        gravity, tilt = None, (straight.tilt + mirrored.tilt) / 2
        if straight.gravity is not None and mirrored.gravity is not None:
            gravity = (straight.gravity + mirrored.gravity * mirrored.gravity.new_tensor([-1.0, 1.0, 1.0])) / 2
            tilt = _tilt_of(gravity)
        if straight.distance is not None and mirrored.distance is not None:
            distance = estimated = (straight.distance * mirrored.distance).sqrt()
        else:
            estimated = None
        pose = self.camera.unproject(filled, depth, distance)
        signs = self._mean_signs(straight.signs, mirrored.signs)
        return Lifted(pose, tilt, filled, uncertainty, gravity, estimated, signs)

    def signs_both_ways(
        self,
        keypoints: Float[Tensor, "batch joints 2"],
        confidence: Float[Tensor, "batch joints"],
        distance: Float[Tensor, " batch"],
        guessed: Bool[Tensor, " batch"] | None = None,
    ) -> Float[Tensor, "batch states"] | None:
        """Return `Lifted.signs` of `lift_both_ways`, without lifting."""
        if not self.skeleton.has_mirror_image:
            return self.sign_logits(keypoints, confidence, distance, guessed)
        both = self.sign_logits(*self._both_ways(keypoints, confidence, distance, guessed))
        return None if both is None else self._mean_signs(*both.split(len(keypoints)))

    def _both_ways(
        self, keypoints: Tensor, confidence: Tensor, distance: Tensor, guessed: Tensor | None
    ) -> list[Tensor]:
        """Return keypoints and their mirror images as one batch: what `forward` takes."""
        swap = self.mirror_permutation
        both = [torch.cat([keypoints, mirror(keypoints, swap)]), torch.cat([confidence, confidence[:, swap]])]
        return [*both, distance.repeat(2)] + ([] if guessed is None else [guessed.repeat(2)])

    def _mean_signs(self, straight: Tensor | None, mirrored: Tensor | None) -> Tensor | None:
        if straight is None or mirrored is None or self.chains.mirrored is None:
            return straight
        return self.chains.mean(straight, mirrored)


def _upright(output: Tensor) -> Tensor:
    """Return gravity as the network says it, relative to that of a level camera."""
    return output + torch.eye(3, dtype=output.dtype, device=output.device)[1]


def _tilt_of(gravity: Tensor) -> Tensor:
    return normalize(gravity, dim=-1)[:, 2].clamp(-1, 1).asin()
