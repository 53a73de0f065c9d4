"""`LabelledSampler`: draws labelled and unlabelled frames in a fixed ratio."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Int
from torch import Tensor

__all__ = ["LabelledSampler"]

_MOST_OFTEN = 25


class LabelledSampler:
    """Draws frame numbers, ``share`` of them from the labelled frames.

    A labelled frame is drawn at most 25 times as often as by chance: a few frames would otherwise be
    memorised. Frames are drawn uniformly if ``share`` is None or if all or none are labelled. ``self.share``
    is the resulting share of labelled frames in a batch.
    """

    def __init__(self, labelled: Bool[Tensor, " frames"], share: float | None):
        self.frames = len(labelled)
        self.device = labelled.device
        self.parts = (labelled.nonzero()[:, 0], (~labelled).nonzero()[:, 0])
        natural = len(self.parts[0]) / max(1, len(labelled))
        self.balanced = share is not None and 0 < natural < 1
        self.share = min(share, _MOST_OFTEN * natural) if self.balanced and share is not None else natural

    def __call__(self, count: int) -> Int[Tensor, " count"]:
        """Return ``count`` random frame numbers, in random order."""
        if not self.balanced:
            return torch.randint(self.frames, (count,), device=self.device)
        first = max(1, round(self.share * count))
        sizes = zip(self.parts, (first, count - first), strict=True)
        drawn = [part[torch.randint(len(part), (size,), device=self.device)] for part, size in sizes]
        return torch.cat(drawn)[torch.randperm(count, device=self.device)]
