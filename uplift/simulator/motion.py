"""The motion of clips before it meets a camera, and the choice of what each clip shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError, did_you_mean

__all__ = ["Motion", "choose_actions"]


@dataclass
class Motion:
    """Joint angles over time and where the body is, clip by clip."""

    angles_deg: Float[np.ndarray, "clips frames angles"]
    lift: Float[np.ndarray, "clips frames"]
    """Height of the lowest point above the floor, body heights."""
    travel: Float[np.ndarray, "clips frames 2"]
    """Way over the floor (x, z), body heights."""
    actions: np.ndarray
    """(clips,) names."""

    @classmethod
    def empty(cls, clips: int, frames: int, angles: int) -> Motion:
        """Return a motion that stands still in the rest pose."""
        return cls(
            np.zeros((clips, frames, angles)), np.zeros((clips, frames)), np.zeros((clips, frames, 2)),
            np.full(clips, "", dtype="<U32"),
        )  # fmt: skip

    def put(self, rows: np.ndarray, name: str, part: Motion) -> None:
        """Take ``part`` as the clips of ``rows``."""
        self.angles_deg[rows], self.lift[rows], self.travel[rows] = part.angles_deg, part.lift, part.travel
        self.actions[rows] = name


def choose_actions(
    rng: np.random.Generator, shares: dict[str, float], clips: int, mode: str | list[str] | tuple[str, ...]
) -> np.ndarray:
    """Return an action for each clip, in proportion to ``shares``; raises UserError for an unknown one.

    ``mode`` is ``all`` or a list of actions.
    """
    wanted = list(shares) if mode == "all" else [mode] if isinstance(mode, str) else list(mode)
    for name in wanted:
        if name not in shares:
            raise UserError(f"motion '{name}' is unknown for this body.{did_you_mean(name, ('all', *shares))}")
    if not wanted:
        raise UserError("mode is an empty list: expected 'all' or at least one motion.")
    weights = np.array([shares[name] for name in wanted])
    # Even shares first, then chance: a small sample still shows a bit of everything.
    quota = (np.arange(clips) + rng.uniform()) / clips
    places = np.searchsorted(np.cumsum(weights) / weights.sum(), quota).clip(0, len(wanted) - 1)
    return rng.permutation(np.array(wanted, dtype="<U32")[places])
