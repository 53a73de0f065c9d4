"""Figures without truth that were measured beside those of `score_2d`, each lower where a lifter should be better."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from uplift.data.clean import clean
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.geometry.normalise import bone_lengths
from uplift.geometry.rotation import level, turn
from uplift.metrics.pose_metrics import symmetry
from uplift.metrics.score_2d import _bone_ends, _distances, _relifted, _scenes, _view
from uplift.models.lifter import Lifted
from uplift.models.model import Model
from uplift.models.predict import lift_frames
from uplift.skeleton.core import mirrored_bones

__all__ = ["candidates"]


@torch.no_grad()
def candidates(model: Model, data: PoseData, seed: int = 0) -> dict[str, float]:
    """Return the figures by name."""
    generator = torch.Generator().manual_seed(seed)
    data, _ = clean(data.without_truth(), model.skeleton)
    frames = to_training_set(data, model.skeleton, model.settings)
    lifted = lift_frames(model.lifter, frames, both_ways=model.settings.both_ways)
    view = _view(model, frames, lifted, generator, (-180.0, 180.0))
    back, seen = _relifted(model, frames, view), (frames.confidence > 0).float()
    centred = lifted.pose - lifted.pose[:, model.skeleton.root_index, None]
    found = {"relift, not aligned": float(((back - centred).norm(dim=-1) * seen).sum() / seen.sum())}
    found["relift, image only"] = float(((back - centred)[..., :2].norm(dim=-1) * seen).sum() / seen.sum())
    found |= _kernels(frames.keypoints, view.keypoints, seen)
    found |= _neighbours(frames.keypoints, view.keypoints, seen, _scenes(data))
    found["classifier AUC"] = _classifier(frames.keypoints, view.keypoints, seen, generator)
    found["Gaussian distance"] = _gaussians(frames.keypoints * seen[..., None], view.keypoints * seen[..., None])
    return found | _bodies(frames, lifted)


# Two-sample statistics of pictures.


def _kernels(real: Tensor, view: Tensor, seen: Tensor) -> dict[str, float]:
    """Return the energy distance (Szekely & Rizzo 2004) and the MMD with Gaussian kernels (Gretton et al. 2012)."""
    count = len(real)
    apart = {"rr": _distances(real, real, seen), "vv": _distances(view, view, seen), "rv": _distances(view, real, seen)}
    others = 1 - torch.eye(count)

    def mean(values: Tensor) -> float:
        return float((values.where(values.isfinite(), 0) * others).sum() / (count * (count - 1)))

    energy = 2 * mean(apart["rv"]) - mean(apart["rr"]) - mean(apart["vv"])
    usual, mmd = apart["rr"].where(apart["rr"].isfinite(), 0).median(), 0.0
    for width in (0.25, 0.5, 1.0):
        near = {name: mean(torch.exp(-values.square() / (2 * (width * usual) ** 2))) for name, values in apart.items()}
        mmd += near["rr"] + near["vv"] - 2 * near["rv"]
    return {"energy distance": energy, "MMD": mmd}


def _neighbours(real: Tensor, view: Tensor, seen: Tensor, scene: Tensor) -> dict[str, float]:
    """Return 1 - precision and 1 - recall (Kynkaanniemi et al. 2019), and the accuracy of the nearest neighbour's kind."""
    same = scene[:, None] == scene
    rr, vv, vr = (
        _distances(one, other, seen).masked_fill(same, torch.inf)
        for one, other in ((real, real), (view, view), (view, real))
    )
    third = {name: values.topk(3, largest=False).values[:, -1] for name, values in (("r", rr), ("v", vv))}
    kind = (vr.min(1).values > vv.min(1).values).float().mean() + (vr.min(0).values > rr.min(1).values).float().mean()
    return {
        "1 - kNN precision": 1 - float((vr < third["r"]).any(1).float().mean()),
        "1 - kNN recall": 1 - float((vr.mT < third["v"]).any(1).float().mean()),
        "nearest kind": float(kind / 2),
    }


def _classifier(real: Tensor, view: Tensor, seen: Tensor, generator: torch.Generator) -> float:
    """Return the AUC, on every other frame, of ridge regression on random Fourier features fitted on the rest."""
    count, parts = len(real), [(points * seen[..., None]).flatten(1) for points in (real, view)]
    fit, test = (torch.cat([part[start::2] for part in parts]) for start in (0, 1))
    is_real = [torch.cat([torch.ones(len(part) // 2), torch.zeros(len(part) // 2)]) for part in (fit, test)]
    mean, deviation = fit.mean(0), fit.std(0) + 1e-3
    project = torch.randn(fit.shape[1], 512, generator=generator) / math.sqrt(fit.shape[1])
    phase = 2 * math.pi * torch.rand(512, generator=generator)

    def features(points: Tensor) -> Tensor:
        scaled = (points - mean) / deviation
        return torch.cat([torch.cos(scaled @ project + phase), scaled, scaled.square()], 1)

    middle = features(fit).mean(0)
    known = features(fit) - middle
    ridge = known.mT @ known + 10 * torch.eye(known.shape[1])
    weight = torch.linalg.solve(ridge, known.mT @ (is_real[0] - is_real[0].mean()))
    rank = ((features(test) - middle) @ weight).argsort().argsort().double() + 1
    positive = float(is_real[1].sum())
    return float(
        (rank[is_real[1] > 0].sum() - positive * (positive + 1) / 2) / (positive * (2 * (count // 2) - positive))
    )


def _gaussians(real: Tensor, view: Tensor) -> float:
    """Return the affine-invariant distance of the two covariances, with noise of 0.03 mean radii."""
    first, second = (torch.cov(points.flatten(1).mT).double() for points in (real, view))
    noise = 0.03**2 * torch.eye(len(first), dtype=torch.float64)
    root = torch.linalg.inv(torch.linalg.cholesky(first + noise))
    return float(torch.linalg.eigvalsh(root @ (second + noise) @ root.mT).log().square().mean().sqrt())


# The poses themselves.


def _bodies(frames: TrainingSet, lifted: Lifted) -> dict[str, float]:
    """Return left against right, and how much depth exceeds or falls short of width, as a logarithm."""
    skeleton = frames.skeleton
    pairs, seen = _bone_ends(frames)
    lengths = bone_lengths(lifted.pose, pairs).where(seen, torch.nan).double().numpy()
    found = {}
    if skeleton.has_mirror_image:
        found["left and right"] = float(np.nanmean(symmetry(lengths, mirrored_bones(skeleton))))
    pose = turn(lifted.pose, level(lifted.tilt)) if skeleton.gravity else lifted.pose
    bones = (pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]]).where(seen[..., None], torch.nan)
    extent = bones.square().nanmean(0)
    found["depth to width"] = float((extent[:, 2] / extent[:, 0]).log().abs().nanmean() / 2)
    found["bones, standard deviation"] = float(np.nanmean(np.nanstd(lengths, 0)))
    return found
