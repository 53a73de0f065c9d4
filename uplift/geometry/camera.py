"""The two cameras that the model projects with: orthographic (Kudo et al. 2018) and perspective."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.errors import UserError, did_you_mean

__all__ = ["NEAREST", "Camera", "Orthographic", "Perspective", "build_camera"]

NEAREST = 0.1
"""Share of the distance at which a point at or behind the pinhole is held: it has no image."""


class Camera:
    """What both cameras share: ``ratio`` is how much smaller a point at depth z is seen than one at the root's depth."""

    def ratio(self, z: Tensor, distance: Tensor) -> Tensor | float:
        raise NotImplementedError

    def unproject(
        self,
        keypoints: Float[Tensor, "frames joints 2"],
        depth: Float[Tensor, "frames joints"],
        distance: Float[Tensor, " frames"],
    ) -> Float[Tensor, "frames joints 3"]:
        """Return the pose that ``keypoints`` at ``depth`` are the projection of."""
        z = depth.unsqueeze(-1)
        return torch.cat([keypoints * self.ratio(z, distance), z], -1)

    def project(
        self, pose: Float[Tensor, "frames joints 3"], distance: Float[Tensor, " frames"]
    ) -> Float[Tensor, "frames joints 2"]:
        """Return the 2D keypoints of ``pose``."""
        across, z = pose.split([2, 1], -1)
        return across / self.ratio(z, distance)


@dataclass(frozen=True)
class Orthographic(Camera):
    """Parallel rays: x and y of the pose are those of the keypoints; ``distance`` does not matter."""

    def ratio(self, z: Tensor, distance: Tensor) -> float:
        return 1.0


@dataclass(frozen=True)
class Perspective(Camera):
    """A pinhole that looks at the root from ``distance``, in units of the body's mean 2D radius.

    At the root's depth one unit of the pose is one unit of the keypoints, so focal length and
    distance are one number: focal length over mean radius, both in pixels, where the camera is
    known, else a guess (ElePose, Wandt et al. 2022, uses 10).
    """

    def ratio(self, z: Tensor, distance: Tensor) -> Tensor:
        return (1 + z / distance[:, None, None]).clamp_min(NEAREST)


def build_camera(name: str) -> Camera:
    """Return the camera called ``orthographic`` or ``perspective``."""
    cameras = {"orthographic": Orthographic, "perspective": Perspective}
    if name not in cameras:
        raise UserError(f"lifter.camera={name!r} is unknown.{did_you_mean(name, cameras)}")
    return cameras[name]()
