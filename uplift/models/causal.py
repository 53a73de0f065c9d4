"""Lifting as live use needs it: no frame knows of others that come more than a fixed lag after it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from uplift.data.poses import USUAL_FPS, PoseData, previous_frames

__all__ = ["LAG_SECONDS", "causal_windows"]

LAG_SECONDS = 0.5
"""How much later than a frame the last one is that may change its pose."""
_PAST_SECONDS = 3.0
"""Of a clip that is lifted together: bodies are learned from it, and a longer one changes little."""


def causal_windows(data: PoseData) -> tuple[PoseData, Int[np.ndarray, " frames"]]:
    """Return short clips of ``data``, and the row among theirs of each frame of ``data``.

    Each clip ends with at most `LAG_SECONDS` of frames behind the last one that is taken from it. Frames are taken from a clip
    several at a time, those that one step of half the lag brings, so the lag is between half and all of `LAG_SECONDS`.
    A clip is a body of its own; what is known of all clips together (their mean body, what confidences are worth) is
    that of the whole file. ``data`` are in the order of `PoseData.in_order`.
    """
    fps = data.fps or USUAL_FPS
    hop = max(1, round(LAG_SECONDS * fps / 2))
    past = max(hop, round(_PAST_SECONDS * fps))
    follows = previous_frames(data.clips(), data.identity.get("frame")) >= 0
    starts = np.append(np.flatnonzero(~follows), len(data))
    rows, windows, taken = [], [], np.zeros(len(data), np.int64)
    total = 0
    for first, stop in pairwise(starts.tolist()):
        for start in range(first, stop, hop):
            low, high = max(first, start + hop - past), min(stop, start + 2 * hop)
            end = min(stop, start + hop)
            taken[start:end] = total + np.arange(start, end) - low
            rows.append(np.arange(low, high))
            windows.append(np.full(high - low, len(windows)))
            total += high - low
    every = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    found = data.select(every)
    identity = {key: found.identity[key] for key in ("camera", "frame", "instance") if key in found.identity}
    names = np.concatenate(windows).astype(str) if windows else np.zeros(0, "U1")
    return replace(found, identity={**identity, "sequence": names}), taken
