"""Finer mixtures: every shape becomes several that begin nearly alike and grow apart."""

from __future__ import annotations

import torch
from torch import nn

from uplift.shapes.mixture import ShapeMixture

__all__ = ["split"]

_NOISE = 0.7
"""Standard deviation of what is added to the logits: enough for two copies to explain other masks."""
_COARSE = 8


def split(mixture: ShapeMixture, times: int, azimuths: int) -> ShapeMixture:
    """Return a mixture of ``times`` as many shapes, each one of ``mixture`` with some smooth noise.

    Views are known by then, so a shape of few masks is found at once. ``azimuths`` is how many views there are
    around the finer shapes, a multiple of those so far; shapes that are seen from anywhere keep theirs.
    """
    before = mixture.grid.azimuths
    finer = azimuths // before if mixture.settings.gravity else 1
    made = ShapeMixture(mixture.settings, len(mixture.logits) * times, before * finer)
    if finer == 1:
        made.projector = mixture.projector
    with torch.no_grad():
        logits = mixture.logits.repeat_interleave(times, 0)
        coarse = torch.randn(len(logits), 1, _COARSE, _COARSE, _COARSE // 2 if mixture.settings.symmetric else _COARSE)
        noise = nn.functional.interpolate(coarse, logits.shape[1:], mode="trilinear")[:, 0]
        made.logits.copy_(logits + _NOISE * noise.to(logits) * (times > 1))
        made.azimuth_bias.copy_(mixture.azimuth_bias.repeat_interleave(times, 0).repeat_interleave(finer, 1))
        made.part_bias.copy_(mixture.part_bias.repeat_interleave(times, 0))
        made.level.copy_(mixture.level)
    return made
