"""Lifters that are wrong on purpose: one good lifter whose depths are changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from uplift.models.lifter import Lifted, Lifter
from uplift.models.model import Model

__all__ = ["CHANGES", "Distorted"]


def _noise(depth: Tensor, keypoints: Tensor) -> Tensor:
    """Return a fifth of a mean radius that differs from pose to pose and from joint to joint."""
    phase = keypoints.sum((1, 2))[:, None] + keypoints @ keypoints.new_tensor([3.1, 5.7])
    return depth + 0.2 * torch.sin(37 * phase)


def _some_flipped(depth: Tensor, keypoints: Tensor) -> Tensor:
    """Return the depth of about half of the poses reversed, however similar they are."""
    return depth * torch.sin(50 * keypoints[..., 0].abs().sum(1)).sign()[:, None]


CHANGES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "flat": lambda depth, keypoints: torch.zeros_like(depth),
    "constant": lambda depth, keypoints: depth.mean(0).expand_as(depth),
    "flipped": lambda depth, keypoints: -depth,
    "half_flipped": _some_flipped,
    "depth_x0.5": lambda depth, keypoints: 0.5 * depth,
    "depth_x0.8": lambda depth, keypoints: 0.8 * depth,
    "depth_x1.2": lambda depth, keypoints: 1.2 * depth,
    "depth_x1.5": lambda depth, keypoints: 1.5 * depth,
    "noise": _noise,
}
"""By name, what a depth (frames joints) of keypoints (frames joints 2) is changed to."""


class Distorted(Lifter):
    """A trained lifter whose depths, in units of the mean 2D radius, are changed."""

    def __init__(self, model: Model, change: Callable[[Tensor, Tensor], Tensor]):
        super().__init__(model.skeleton, model.settings)
        self.load_state_dict(model.lifter.state_dict())
        self.change = change
        self.eval()

    def forward(self, keypoints: Tensor, confidence: Tensor, distance: Tensor, guessed: Tensor | None = None) -> Lifted:
        """Lift, and change the depths."""
        lifted = super().forward(keypoints, confidence, distance, guessed)
        depth = self.change(lifted.pose[..., 2], lifted.keypoints)
        depth = depth - depth[:, self.skeleton.root_index, None]
        return dataclasses.replace(lifted, pose=self.camera.unproject(lifted.keypoints, depth, distance))
