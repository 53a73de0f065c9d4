"""The content of all files: bodies that walk past a camera, generated in chunks of frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["SIZE_PX", "Chunk", "Walk"]

SIZE_PX = (1280, 960)
_CHUNK = 8192
_MISSING = 0.05
_SPOTS = (0.0, 0.1, 0.5, 0.99)


@dataclass
class Chunk:
    """Consecutive frames."""

    frame: np.ndarray
    """(frames,)"""
    xy: np.ndarray
    """(frames bodies joints 2) px, rounded to six decimals."""
    score: np.ndarray
    """(frames bodies joints), rounded to six decimals."""
    missing: np.ndarray
    """(frames bodies joints) bool."""


@dataclass
class Walk:
    """Frames of one or two bodies with 5 % of the keypoints missing; deterministic."""

    rows: int
    joints: int = 17
    bodies: int = 1
    spots: list[dict[str, Any]] = field(default_factory=list)
    """Some of the generated bodies, to be found again in what is read."""

    @property
    def frames(self) -> int:
        """The number of frames."""
        return max(self.rows // self.bodies, 1)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all frames."""
        rng = np.random.default_rng(0)
        rest = rng.uniform((-60, -150), (60, 150), (self.joints, 2))
        phase = rng.uniform(0, 6, (self.bodies, self.joints, 2))
        wanted = sorted({int(share * self.frames) for share in _SPOTS})
        for start in range(0, self.frames, _CHUNK):
            frame = np.arange(start, min(start + _CHUNK, self.frames))
            chunk = self._chunk(frame, rest, phase, rng)
            for spot in wanted:
                if frame[0] <= spot <= frame[-1]:
                    self._remember(chunk, spot - start)
            yield chunk

    def all_frames(self) -> Chunk:
        """Return all frames as one chunk."""
        chunks = list(self.chunks())
        parts = ([getattr(chunk, name) for chunk in chunks] for name in ("frame", "xy", "score", "missing"))
        return Chunk(*map(np.concatenate, parts))

    def _chunk(self, frame: np.ndarray, rest: np.ndarray, phase: np.ndarray, rng: np.random.Generator) -> Chunk:
        shape = (len(frame), self.bodies, self.joints)
        turn = frame[:, None] / 300 + np.pi * np.arange(self.bodies)  # their paths cross
        centre = np.stack([640 + 300 * np.cos(turn), 480 + 40 * np.sin(turn)], -1)
        sway = 15 * np.sin(frame[:, None, None, None] / 15 + phase)
        xy = centre[:, :, None] + rest + sway + rng.normal(0, 1.5, (*shape, 2))
        score = rng.uniform(0.3, 0.99, shape)
        return Chunk(frame, np.round(xy, 6), np.round(score, 6), rng.random(shape) < _MISSING)

    def _remember(self, chunk: Chunk, at: int) -> None:
        for body in range(self.bodies):
            self.spots.append(
                {
                    "frame": int(chunk.frame[at]),
                    "keypoints": chunk.xy[at, body].tolist(),
                    "confidence": np.where(chunk.missing[at, body], 0, chunk.score[at, body]).tolist(),
                }
            )
