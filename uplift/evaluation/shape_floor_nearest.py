"""The floor `nearest`: the training item whose mask, or its mirror image, is most like the mask, and its true shape."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

__all__ = ["nearest_masks"]

_SIDE = 32
_CHUNK = 512


def nearest_masks(masks: np.ndarray, train: np.ndarray) -> tuple[Int[np.ndarray, " items"], Bool[np.ndarray, " items"]]:
    """Return for each mask the training mask with the best IoU, and whether that one is to be mirrored left to right.

    Both are (items side side), 0 to 255, compared at 32 x 32 pixels. Equally near: as it is before mirrored, the
    first before later ones.
    """
    known = _small(train)
    both = torch.cat([known.flatten(1), known.flip(2).flatten(1)])
    area = both.sum(1)
    found = []
    for start in range(0, len(masks), _CHUNK):
        part = _small(masks[start : start + _CHUNK]).flatten(1)
        shared = part @ both.T
        found.append((shared / (part.sum(1, keepdim=True) + area - shared).clamp_min(1)).argmax(1))
    best = torch.cat(found).numpy() if found else np.zeros(0, np.int64)
    return best % len(train), best >= len(train)


def _small(masks: np.ndarray) -> Float[Tensor, "items side side"]:
    """Return masks at the side compared at, 1 where more than half is covered."""
    parts = []
    for start in range(0, len(masks), _CHUNK):
        part = torch.from_numpy(masks[start : start + _CHUNK].astype(np.float32))[:, None]
        parts.append(torch.nn.functional.interpolate(part, (_SIDE, _SIDE), mode="area")[:, 0] > 127.5)
    return torch.cat(parts).float()
