"""Which frames a batch is made of: labelled and unlabelled ones in a set ratio."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Int
from torch import Tensor

__all__ = ["Rows"]


class Rows:
    """Draws frame numbers, ``share`` of them from the labelled frames.

    All frames alike where ``share`` is None, or where all or none are labelled: then there is nothing
    to balance.
    """

    def __init__(self, labelled: Bool[Tensor, " frames"], share: float | None):
        self.frames = len(labelled)
        self.device = labelled.device
        self.share = share
        self.parts = (labelled.nonzero()[:, 0], (~labelled).nonzero()[:, 0])

    def __call__(self, count: int) -> Int[Tensor, " count"]:
        """Return ``count`` random frame numbers, in random order."""
        labelled, rest = self.parts
        if self.share is None or not len(labelled) or not len(rest):
            return torch.randint(self.frames, (count,), device=self.device)
        first = round(self.share * count)
        drawn = [
            part[torch.randint(len(part), (size,), device=self.device)]
            for part, size in ((labelled, first), (rest, count - first))
        ]
        return torch.cat(drawn)[torch.randperm(count, device=self.device)]
