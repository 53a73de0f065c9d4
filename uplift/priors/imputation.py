"""Gaussian imputation of missing keypoints, so that a density can be fitted to complete frames."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["impute_gaussian"]

_ROUNDS = 12
_SAMPLE = 10_000
"""Frames that are enough to fit the Gaussian."""
_CHUNK = 8192
_UNKNOWN = 1e4
"""Variance of a missing coordinate's measurement: so large that it has no weight."""


def impute_gaussian(
    keypoints: Float[Tensor, "frames joints 2"], confidence: Float[Tensor, "frames joints"]
) -> Float[Tensor, "frames joints 2"]:
    """Return ``keypoints`` with missing joints drawn from a Gaussian, conditional on the visible ones.

    Its mean and covariance are fitted to the data by stochastic expectation and maximisation (Dempster et al.
    1977).
    """
    seen = (confidence > 0).repeat_interleave(2, 1)
    flat = keypoints.flatten(1)
    if bool(seen.all()):
        return keypoints
    some = torch.randperm(len(flat), device=flat.device)[:_SAMPLE]
    weight = seen.to(flat.dtype)
    mean = (flat * weight).sum(0) / weight.sum(0).clamp_min(1)
    filled = torch.where(seen, flat, mean)[some]
    covariance = _covariance(filled)
    for _ in range(_ROUNDS):
        filled = _draw(flat[some], seen[some], mean, covariance)
        mean, covariance = filled.mean(0), _covariance(filled)
    return _draw(flat, seen, mean, covariance).reshape(keypoints.shape)


def _covariance(filled: Tensor) -> Tensor:
    offset = filled - filled.mean(0)
    return offset.mT @ offset / len(offset) + 1e-4 * torch.eye(offset.shape[1], device=offset.device)


def _draw(flat: Tensor, seen: Tensor, mean: Tensor, covariance: Tensor) -> Tensor:
    """Return missing values drawn conditional on visible ones: an unconditional draw, corrected by its error there."""
    root = torch.linalg.cholesky(covariance)
    filled = flat.clone()
    for start in range(0, len(flat), _CHUNK):
        rows = slice(start, start + _CHUNK)
        drawn = torch.randn_like(flat[rows]) @ root.mT
        error = torch.where(seen[rows], flat[rows] - mean - drawn, 0.0)
        noise = torch.where(seen[rows], 1e-5, _UNKNOWN)
        moved = torch.linalg.solve(covariance + torch.diag_embed(noise), error) @ covariance
        filled[rows] = torch.where(seen[rows], flat[rows], mean + drawn + moved)
    return filled
