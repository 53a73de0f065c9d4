"""How far the predicted views are from the true ones: about gravity, and in the camera's tilt."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["azimuth_errors_deg", "elevation_errors_deg"]

_CANDIDATES_DEG = np.arange(0, 360, 1.0)


def azimuth_errors_deg(
    view: Float[np.ndarray, "items 3 3"], truth: Float[np.ndarray, "items 3 3"]
) -> Float[np.ndarray, " items"] | None:
    """Return each view's error about gravity after the one turn of all own frames with the least mean error.

    A shape learnt from masks alone faces anywhere, but all of one kind should face alike. None where
    every view is the same: such shapes are given in the camera's frame, and face nowhere.
    """
    if len(view) < 2 or np.ptp(view, axis=0).max() < 1e-6:
        return None
    off = _azimuth_deg(view) - _azimuth_deg(truth)
    errors = np.abs((off - _CANDIDATES_DEG[:, None] + 180) % 360 - 180)
    return errors[errors.mean(1).argmin()]


def elevation_errors_deg(
    view: Float[np.ndarray, "items 3 3"], truth: Float[np.ndarray, "items 3 3"]
) -> Float[np.ndarray, " items"] | None:
    """Return each view's error in the tilt against gravity, the own frame's y; None where every view is the same."""
    if len(view) < 2 or np.ptp(view, axis=0).max() < 1e-6:
        return None
    return np.abs(_tilt_deg(view) - _tilt_deg(truth))


def _azimuth_deg(view: np.ndarray) -> np.ndarray:
    """Return how far each shape is turned about its own y: where its z points, against the camera's depth."""
    return np.degrees(np.arctan2(-view[:, 2, 0], view[:, 2, 2]))


def _tilt_deg(view: np.ndarray) -> np.ndarray:
    return np.degrees(np.arcsin(np.clip(view[:, 2, 1], -1, 1)))
