"""The ceiling: a network of the lifter's class and time that is trained on every true shape and view.

It says how much of what a mask tells about a shape is lost by learning from masks alone.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import (
    binary_cross_entropy_with_logits,
    dropout,
    grid_sample,
    interpolate,
    max_pool2d,
)

from benchmarks.common import facts, store
from benchmarks.shapes import fits
from uplift.cli.evaluate import score_shapes
from uplift.config.loading import load_settings
from uplift.config.progress import progress
from uplift.data.load_masks import load_masks
from uplift.data.mask_tensors import as_tensor
from uplift.data.masks import MaskData, Placed
from uplift.geometry.rotation import about_y, level
from uplift.geometry.voxels import coverage
from uplift.metrics.shape_metrics import voxel_centres
from uplift.models.prediction import ShapePrediction

__all__ = ["Supervised", "pose_of", "run_ceiling", "standing_of", "train"]

_RESOLUTION, _CODE, _WIDE = 32, 128, 512
_BATCH, _RATE, _FLAT_SHARE = 48, 1.5e-3, 0.3
_POSE_WEIGHTS = (1.0, 1.0, 10.0, 10.0, 10.0, 10.0)
_MIRROR = (1.0, -1.0, 1.0, 1.0, -1.0, 1.0)
"""What becomes of cosine and sine of the azimuth, elevation, scale, and offset when the mask is mirrored."""


def run_ceiling(family: str, seconds: float, seed: int) -> dict[str, Any]:
    """Train on the masks of the demo with ``family`` and all their truth, score as a fit is scored, store the result."""
    settings = load_settings(fits.TASK, [f"data.family={family}", f"seed={seed}"])
    masks = load_masks(settings)
    assert masks.train.truth is not None and masks.test is not None
    torch.set_num_threads(1)
    network, spent = train(masks.train, masks.train.truth, seconds, seed)
    *_, found = score_shapes(network, masks.test, masks.train, "supervised")  # type: ignore[arg-type]
    result = {
        "command": f"python -m benchmarks.shapes ceiling --families {family} --seconds {seconds:g} --seeds {seed}",
        "seed": seed,
        "cpu_seconds": seconds,
        "steps": spent,
        **facts(),
        **{part: value for part, value in found.to_dict().items() if part in fits.PARTS},
    }
    store(fits.RESULTS, fits.ceiling_key(family, seconds, seed), result)
    return result


class _Encoder(nn.Sequential):
    """A mask of 64 x 64 as ``outputs`` numbers."""

    def __init__(self, outputs: int, width: int) -> None:
        sizes = [1, width, 2 * width, 4 * width, 8 * width]
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Conv2d(before, after, 4, 2, 1, bias=False), nn.BatchNorm2d(after), nn.SiLU()]
        super().__init__(*layers, nn.Flatten(), nn.Linear(8 * width * 16, outputs))


class Supervised(nn.Module):
    """Mask to code to the half of a mirrored grid; and mask to azimuth, elevation, scale and offset."""

    def __init__(self, truth: Placed) -> None:
        super().__init__()
        self.shape = _Encoder(_CODE, 24)
        half = _RESOLUTION**3 // 2
        self.decode = nn.Sequential(nn.Linear(_CODE, _WIDE), nn.SiLU(), nn.Linear(_WIDE, half))
        self.pose = _Encoder(len(_POSE_WEIGHTS), 16)
        self.distance = float(np.median(truth.distance / truth.scale))
        """Of the camera, in units of the shape: not to be seen in a mask."""

    def forward(
        self, masks: Float[Tensor, "items side side"]
    ) -> tuple[Float[Tensor, "items depth height half"], Float[Tensor, "items pose"]]:
        """Return the logits of the occupancy at x > 0, and `pose_of`."""
        code = dropout(self.shape(masks[:, None]), 0.1, self.training)
        half = self.decode(code).view(-1, _RESOLUTION, _RESOLUTION, _RESOLUTION // 2)
        return half, self.pose(masks[:, None])

    @torch.no_grad()
    def predict(self, data: MaskData, title: str = "") -> ShapePrediction:
        """Return the shape of each mask: the mean over mask and mirror image, carved, above the level that is expected best."""
        self.eval()
        masks = interpolate(as_tensor(data.masks)[:, None], (64, 64), mode="area")[:, 0]
        (one, pose), (other, mirrored) = self(masks), self(masks.flip(-1))
        half = (one.sigmoid() + other.sigmoid()) / 2
        placed = standing_of((pose + mirrored * pose.new_tensor(_MIRROR)) / 2, self.distance)
        occupancy = _carved(torch.cat([half.flip(-1), half], -1), masks, placed)
        iso = _best_expected_level(occupancy)
        occupancy = _reaching(occupancy, masks, placed, iso)
        return ShapePrediction(
            occupancy.numpy(), placed.view.numpy(), placed.scale.numpy(), placed.offset.numpy(), placed.distance.numpy(),
            data.masks, list(data.names), data.centre_px, data.scale_px, level=iso, title=title, images=data.images,
        )  # fmt: skip


def train(data: MaskData, truth: Placed, seconds: float, seed: int) -> tuple[Supervised, int]:
    """Return a network trained for ``seconds`` of this process's CPU time, and its number of steps."""
    torch.manual_seed(seed)
    masks, pose = interpolate(as_tensor(data.masks)[:, None], (64, 64), mode="area")[:, 0], pose_of(truth)
    halves, shape = _halves(truth), torch.from_numpy(np.asarray(truth.shape, np.int64))
    network = Supervised(truth)
    optimizer = torch.optim.AdamW(network.parameters(), _RATE, betas=(0.9, 0.98), weight_decay=0.01, fused=True)
    begin, step, left = time.process_time(), 0, torch.empty(0, dtype=torch.int64)
    while (done := (time.process_time() - begin) / seconds) < 1:
        for group in optimizer.param_groups:
            group["lr"] = _RATE * _rate(step, done)
        left = torch.cat([left, torch.randperm(len(masks))]) if len(left) < _BATCH else left
        rows, left = left[:_BATCH], left[_BATCH:]
        flipped = torch.rand(()) < 0.5
        seen = masks[rows].flip(-1) if flipped else masks[rows]
        wanted = pose[rows] * pose.new_tensor(_MIRROR) if flipped else pose[rows]
        logits, found = network(seen)
        loss = 10 * binary_cross_entropy_with_logits(logits, halves[shape[rows]].float() / 255)
        loss = loss + ((found - wanted).square() * pose.new_tensor(_POSE_WEIGHTS)).sum(1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        step += 1
    return network, step


def _rate(step: int, done: float) -> float:
    """Return the learning rate's factor: a short warm-up, constant, then half a cosine."""
    fall = max(0.0, (done - _FLAT_SHARE) / (1 - _FLAT_SHARE))
    return min(1.0, (step + 1) / 100) * (0.5 + 0.5 * math.cos(math.pi * fall)) + 1e-3


def _halves(truth: Placed) -> Tensor:
    """Return each true shape at x > 0, the mean with its mirror image, 0..255: the loss is linear in the target."""
    found = np.zeros((len(truth.meshes), *(_RESOLUTION,) * 2, _RESOLUTION // 2), np.uint8)
    for number, mesh in enumerate(progress(truth.meshes, "filling shapes")):
        grid = coverage(mesh, _RESOLUTION)
        found[number] = np.round(127.5 * (grid + grid[:, :, ::-1])[:, :, _RESOLUTION // 2 :])
    return torch.from_numpy(found)


# Poses as numbers that a network gives.


def pose_of(truth: Placed) -> Float[Tensor, "items pose"]:
    """Return cosine and sine of the azimuth, elevation, scale and offset of each item."""
    view = torch.as_tensor(np.asarray(truth.view), dtype=torch.float32)
    azimuth = torch.atan2(-view[:, 2, 0], view[:, 2, 2])
    rest = (torch.as_tensor(np.asarray(part), dtype=torch.float32) for part in (truth.scale[:, None], truth.offset))
    elevation = view[:, 2, 1].clamp(-1, 1).arcsin()
    return torch.cat([torch.stack([azimuth.cos(), azimuth.sin(), elevation], 1), *rest], 1)


@dataclass(frozen=True)
class _Poses:
    """Where shapes stand (see `Placed`)."""

    view: Float[Tensor, "items 3 3"]
    scale: Float[Tensor, " items"]
    offset: Float[Tensor, "items 2"]
    distance: Float[Tensor, " items"]

    def image_of(self, points: Float[Tensor, "points 3"]) -> Float[Tensor, "items points 2"]:
        """Return where points of the shapes' frame are in the crop."""
        camera = torch.einsum("iab,pb->ipa", self.view * self.scale[:, None, None], points)
        return (camera[..., :2] + self.offset[:, None]) / (1 + camera[..., 2:] / self.distance[:, None, None])


def standing_of(pose: Float[Tensor, "items pose"], distance: float) -> _Poses:
    """Return where shapes of these poses stand; ``distance`` is in units of the shape."""
    azimuth, scale = torch.atan2(pose[:, 1], pose[:, 0]), pose[:, 3].clamp_min(0.05)
    return _Poses(level(pose[:, 2]).mT @ about_y(azimuth), scale, pose[:, 4:], distance * scale)


# From probabilities to a shape: what a lifter of masks may do as well, without any truth.

_OUTSIDE, _BESIDE = 0.3, 0.25
_LEVELS = tuple(np.round(np.arange(0.04, 0.56, 0.02), 2).tolist())
_RAYS = 32


def _carved(occupancy: Tensor, masks: Tensor, placed: _Poses) -> Tensor:
    """Return the occupancy without voxels that project outside the mask, and little of those whose mirror image does."""
    points = voxel_centres(occupancy.shape[-1]).reshape(-1, 3)
    inside = _read(masks, placed.image_of(points)) > _OUTSIDE
    wide = max_pool2d(masks[:, None], 3, 1, 1)[:, 0]
    beside = _read(wide, placed.image_of(points * points.new_tensor([-1.0, 1.0, 1.0]))).clamp_min(_BESIDE)
    return occupancy * (inside * beside).view_as(occupancy)


def _read(
    masks: Float[Tensor, "items side side"], at: Float[Tensor, "items points 2"]
) -> Float[Tensor, "items points"]:
    return grid_sample(masks[:, None], at[:, :, None], align_corners=False)[:, 0, :, 0]


def _best_expected_level(occupancy: Tensor) -> float:
    """Return the level with the best mean IoU to be expected if the occupancies are the truth's probabilities."""
    flat = occupancy.flatten(1)
    expected = []
    for at in _LEVELS:
        inside = flat > at
        expected.append(((flat * inside).sum(1) / (inside + flat * ~inside).sum(1).clamp_min(1e-6)).mean())
    return _LEVELS[int(torch.stack(expected).argmax())]


def _reaching(occupancy: Tensor, masks: Tensor, placed: _Poses, iso: float) -> Tensor:
    """Return the occupancy raised along rays of the mask on which nothing reaches the level, so that the likeliest do."""
    flat, image = occupancy.flatten(1), placed.image_of(voxel_centres(occupancy.shape[-1]).reshape(-1, 3))
    pixel = ((image + 1) / 2 * _RAYS).long().clamp(0, _RAYS - 1)
    ray = pixel[..., 1] * _RAYS + pixel[..., 0]
    best = flat.new_zeros(len(flat), _RAYS**2).scatter_reduce(1, ray, flat, "amax")
    covered = interpolate(masks[:, None], (_RAYS, _RAYS), mode="area").flatten(1) > 0.5
    gain = (1.2 * iso / best.clamp_min(0.03)).clamp_min(1).where(covered, 1.0)
    raised = (flat * gain.gather(1, ray)).clamp_max(1).view_as(occupancy)
    return torch.maximum(raised, raised.flip(-1))
