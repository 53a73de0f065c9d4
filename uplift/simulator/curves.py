"""Smooth curves in time: minimum-jerk moves between postures, smooth noise, periodic curves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["KeyTimes", "minimum_jerk_path", "periodic_curve", "smooth_noise"]

KeyTimes = tuple[np.ndarray, np.ndarray]
"""Start and duration of each move, (clips moves) s."""


def key_times(rng: np.random.Generator, clips: int, seconds: float) -> KeyTimes:
    """Return random moves that fill ``seconds``: each clip has its own tempo, moves are followed by holds."""
    tempo = np.exp(rng.normal(np.log(0.9), 0.45, (clips, 1))).clip(0.35, 3.0)
    moves = int(np.ceil(seconds / 0.35)) + 2
    gaps = tempo * rng.uniform(0.6, 1.5, (clips, moves))
    starts = np.cumsum(gaps, 1) - gaps - rng.uniform(0, 1, (clips, 1)) * gaps[:, :1]
    return starts, gaps * rng.uniform(0.6, 1.0, (clips, moves))


def minimum_jerk_path(
    time_s: Float[np.ndarray, " frames"], moves: KeyTimes, values: Float[np.ndarray, "clips keys angles"]
) -> Float[np.ndarray, "clips frames angles"]:
    """Return the path through ``values`` with a minimum-jerk move from each to the next (Flash & Hogan 1985)."""
    starts, durations = moves
    path = np.repeat(values[:, :1], len(time_s), 1)
    for move in range(min(starts.shape[1], values.shape[1] - 1)):
        share = ((time_s - starts[:, move, None]) / durations[:, move, None]).clip(0, 1)
        eased = share**3 * (10 - 15 * share + 6 * share**2)
        path += eased[..., None] * (values[:, move + 1] - values[:, move])[:, None]
    return path


def smooth_noise(
    rng: np.random.Generator, time_s: Float[np.ndarray, " frames"], clips: int, angles: int, hz: float = 0.5
) -> Float[np.ndarray, "clips frames angles"]:
    """Return noise of unit variance made of four random sines of up to twice ``hz``."""
    rates = 2 * np.pi * hz * rng.uniform(0.2, 2.0, (4, clips, 1, angles))
    phases = rng.uniform(0, 2 * np.pi, rates.shape)
    return (np.sin(rates * time_s[:, None] + phases) / np.sqrt(2)).sum(0)


def periodic_curve(
    points: tuple[int, ...] | tuple[float, ...], phase: Float[np.ndarray, "*frames"], harmonics: int = 6
) -> Float[np.ndarray, "*frames"]:
    """Return the Fourier curve through evenly spaced ``points`` of one cycle at ``phase`` (cycles)."""
    spectrum = np.fft.rfft(points) / len(points)
    value = np.full(np.shape(phase), spectrum[0].real)
    for harmonic in range(1, min(harmonics, (len(points) - 1) // 2) + 1):
        turn = 2 * np.pi * harmonic * phase
        value += 2 * (spectrum[harmonic].real * np.cos(turn) - spectrum[harmonic].imag * np.sin(turn))
    return value
