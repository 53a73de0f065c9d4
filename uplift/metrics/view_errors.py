"""How far predicted views of shapes are from the true ones: about gravity, in the camera's tilt, or over all rotations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = [
    "WITHIN_DEG",
    "azimuth_errors_deg",
    "elevation_errors_deg",
    "is_upright",
    "rotation_errors_deg",
    "view_errors_deg",
]

WITHIN_DEG = 20.0
"""A view whose error is at most this is found."""
_TURNS_DEG = np.arange(0, 360, 1.0)
_NEARLY = 0.02
"""Common turns whose share of found views is within this of the largest are equally good in it."""
_MOST_TURNS = 500
_ROLL = 1e-3

_Views = Float[np.ndarray, "items 3 3"]
_Errors = Float[np.ndarray, " items"]


def view_errors_deg(views: _Views, truth: _Views) -> _Errors | None:
    """Return by how many degrees each view is wrong: `azimuth_errors_deg` if true views are upright, else `rotation_errors_deg`.

    Views take a shape's own frame to the camera's. A shape learned from masks alone may face anywhere, but all shapes
    should face alike: errors are those after the one common turn with which most views are found (see the two).
    The share of found views is ``(view_errors_deg(views, truth) <= WITHIN_DEG).mean()``. None if fewer than two views
    are given, or all are the same: such shapes are given in the camera's frame.
    """
    return azimuth_errors_deg(views, truth) if is_upright(truth) else rotation_errors_deg(views, truth)


def is_upright(views: _Views) -> bool:
    """Return whether the own y axis of every shape, gravity, is upright in the image: no camera is rolled."""
    return bool(len(views)) and bool(np.abs(views[:, 0, 1]).max() < _ROLL)


def azimuth_errors_deg(views: _Views, truth: _Views) -> _Errors | None:
    """Return each view's error about gravity, after the common turn about it with which most are within `WITHIN_DEG`.

    The turn is a whole number of degrees; of those that are as good (to 2 % of the views), the one with the least mean
    error, where an error counts as `WITHIN_DEG` at most: views that are not found do not pull at it.
    """
    if _one_view(views):
        return None
    # Where the shape's z points, against the camera's depth.
    azimuth, true_azimuth = (np.degrees(np.arctan2(-of[:, 2, 0], of[:, 2, 2])) for of in (views, truth))
    off = azimuth - true_azimuth
    return _after_best(np.abs((off - _TURNS_DEG[:, None] + 180) % 360 - 180))


def elevation_errors_deg(views: _Views, truth: _Views) -> _Errors | None:
    """Return each view's error in the tilt against gravity, the y of the shape's frame; None as in `azimuth_errors_deg`."""
    if _one_view(views):
        return None
    tilt, true_tilt = (np.degrees(np.arcsin(np.clip(of[:, 2, 1], -1, 1))) for of in (views, truth))
    return np.abs(tilt - true_tilt)


def rotation_errors_deg(views: _Views, truth: _Views) -> _Errors | None:
    """Return the angle of the rotation between each view and the true one, after the best common rotation of own frames.

    Chosen like the turn of `azimuth_errors_deg`, among those that make one view exact (evenly chosen views, where there
    are more than 500), each moved to the mean of the views that are found with it.
    """
    if _one_view(views):
        return None
    own = np.swapaxes(truth, 1, 2).astype(np.float64) @ views  # equal for all, if every view is right
    turns = own[np.unique(np.linspace(0, len(own) - 1, _MOST_TURNS).astype(int))]
    found = _angles_deg(turns, own) <= WITHIN_DEG
    u, _, vt = np.linalg.svd(np.einsum("ti,iab->tab", found.astype(np.float64), own))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return _after_best(_angles_deg(u @ vt, own))


def _one_view(views: _Views) -> bool:
    return len(views) < 2 or bool(np.ptp(views, axis=0).max() < 1e-6)


def _angles_deg(first: Float[np.ndarray, "turns 3 3"], second: _Views) -> Float[np.ndarray, "turns items"]:
    trace = first.reshape(-1, 9) @ second.reshape(-1, 9).T
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _after_best(errors: Float[np.ndarray, "turns items"]) -> _Errors:
    shares = (errors <= WITHIN_DEG).mean(1)
    good = errors[shares >= shares.max() - _NEARLY]
    return good[np.minimum(good, WITHIN_DEG).mean(1).argmin()]
