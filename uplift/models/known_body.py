"""Whether keypoints are of the body that a lifter knows: hide each joint in turn, and see where the others put it.

A lifter that fills in missing joints says where a joint must be. How far off it is on what it was trained on, which
2D alone tells, is kept with its weights. On another kind of body, and on joints that have the names of others, it is
several times as far off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from uplift.data.clean import clean
from uplift.data.poses import PoseData
from uplift.data.tensors import to_training_set
from uplift.errors import UserError, listed
from uplift.models.model import Model, UsualErrors
from uplift.models.predict import as_measured

__all__ = ["OTHER", "STRANGE", "check_body", "hidden_errors", "strangeness", "usual_errors"]

_TRAINING_ROWS, _ROWS = 6400, 1600
"""Frames times joints that training data and files are judged by."""
_OTHERS = 4
"""Joints that must be visible beside the hidden one and the root."""
_FLOOR = 0.03
"""Errors below it, in mean 2D radii, are not better than others: keypoints are no more exact."""
_MOST_HIDDEN = 0.75
"""The share of missing joints up to which what is usual is known."""
_MOST_RATIO = 20.0

STRANGE, OTHER, _OTHER_IN_FEW, _FEW = 3.7, 4.4, 8.0, 20
"""Strangeness of what is said, and what is refused, in many frames and in few. Real files of people have 0.4 to 3.9 (252 test clips of
motion capture with and without errors of a detector, and 15 files of seven trackers), four-legged animals with the names of
people's joints 4.6 to 7.0, mixed-up joints 11 to 14; a single frame of a person may reach 8."""


def usual_errors(model: Model, train: PoseData) -> UsualErrors | None:
    """Return how far off hidden joints are in training data; None of a lifter that does not fill in missing joints."""
    if not model.lifter.fill:
        return None
    train = train.select(_spread(train, _TRAINING_ROWS))
    hidden = np.random.default_rng(0).random(train.confidence.shape) < 0.5
    hidden[:, model.skeleton.root_index] = False
    halved = replace(train, confidence=np.where(hidden, 0, train.confidence).astype(np.float32))
    return _medians(hidden_errors(model, train)), _medians(hidden_errors(model, halved))


def _medians(errors: Float[np.ndarray, "frames joints"]) -> tuple[float, ...]:
    known = [one[np.isfinite(one)] for one in errors.T]
    return tuple(round(float(np.median(one)), 5) if len(one) else 0.0 for one in known)


def _spread(data: PoseData, rows: int) -> np.ndarray:
    """Return frames that are evenly spread, with so many joints in all."""
    most = max(2 * _FEW, rows // len(data.joint_names))
    return np.linspace(0, len(data) - 1, min(most, len(data))).round().astype(int)


@torch.no_grad()
def hidden_errors(model: Model, data: PoseData) -> Float[np.ndarray, "frames joints"]:
    """Return how far each visible joint is from where the lifter puts it when it is hidden, in mean 2D radii.

    NaN for the root and for joints that are not visible, and in frames of too few others.
    """
    data, _ = clean(data, model.skeleton, drop=False)
    frames = to_training_set(data, model.skeleton, model.settings)
    frames = frames.to(next(model.lifter.parameters()).device)
    seen = frames.confidence > 0
    guessed = [] if frames.guessed is None else [frames.guessed]
    errors = torch.full_like(frames.confidence, torch.nan)
    judged = seen & (seen.sum(1, keepdim=True) > _OTHERS + 1)
    for joint in range(seen.shape[1]):
        if joint == model.skeleton.root_index or not judged[:, joint].any():
            continue
        hidden = frames.confidence.clone()
        hidden[:, joint] = 0
        without = replace(frames, confidence=hidden)
        lifted = model.lifter(frames.keypoints, hidden, frames.distance, *guessed, with_signs=False)
        off = as_measured(without, lifted.keypoints)[:, joint] - frames.keypoints[:, joint]
        errors[:, joint] = torch.where(judged[:, joint], off.norm(dim=-1), torch.nan)
    return errors.cpu().numpy()


def strangeness(model: Model, data: PoseData) -> tuple[float, int, Float[np.ndarray, " joints"]]:
    """Return how many times as far off as usual hidden joints are, in how many frames, and the same of each joint.

    It is the median over frames of the mean over joints. NaN where no frame, or no such joint, can be judged.
    """
    assert model.usual is not None
    errors = hidden_errors(model, data.select(_spread(data, _ROWS)))
    errors = errors[np.isfinite(errors).any(1)]
    if not len(errors):
        return np.nan, 0, np.full(errors.shape[1], np.nan)
    judged = np.isfinite(errors)
    hidden = np.clip(1 - judged.sum(1) / (errors.shape[1] - 1), 0, _MOST_HIDDEN)[:, None]
    shown, halved = (np.maximum(one, 1e-6) for one in np.asarray(model.usual))
    usual = np.maximum(shown ** (1 - 2 * hidden) * halved ** (2 * hidden), _FLOOR)  # grows by a factor with each share
    known = judged & (np.asarray(model.usual[0]) > 0)
    ratio = np.where(known, np.minimum(errors / usual, _MOST_RATIO), np.nan)
    by_frame = np.nansum(ratio, 1) / np.maximum(known.sum(1), 1)
    by_joint = [np.median(one[np.isfinite(one)]) if np.isfinite(one).any() else np.nan for one in ratio.T]
    return float(np.median(by_frame)), len(errors), np.array(by_joint)


def check_body(model: Model, data: PoseData, name: str, *, refuse: bool) -> str | None:
    """Return a warning where ``data`` is hardly of the body that ``model``, called ``name``, knows; None where it is.

    A body that is upside down is one that it knows: `uplift.data.upright` says which way it lies.

    Raises:
        UserError: with ``refuse``, where it certainly is another body.
    """
    if model.usual is None:
        return None
    found, frames, by_joint = strangeness(model, data)
    if not found > STRANGE:
        return None
    if model.skeleton.gravity:
        turned = strangeness(model, replace(data, keypoints=-data.keypoints, image_size=None, focal_px=None))
        if turned[0] < STRANGE:
            return None
    skeleton = model.skeleton
    worst = listed(skeleton.joints[place] for place in np.argsort(-np.nan_to_num(by_joint))[:4])
    what = (
        f"these keypoints do not look like the body that {name} knows ({skeleton.description or skeleton.name}): where each "
        f"joint is hidden in turn, it is {found:.1f} times as far from where the others put it as in training, most of all "
        f"{worst}"
    )
    why = (
        f"another kind of body, or joints with the names of others (uplift skeleton map FILE skeleton={skeleton.name})"
    )
    if refuse and found > (OTHER if frames >= _FEW else _OTHER_IN_FEW):
        raise UserError(f"{data.source}: {what}. It is {why}. check=false lifts it all the same.".removeprefix(": "))
    return f"WARNING: {what}: {why}, or poses unlike those it was trained on"
