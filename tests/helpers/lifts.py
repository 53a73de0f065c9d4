"""Training sets, lifters and lifts of random bodies."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch
from bodies import body_arrays
from torch import Tensor

from uplift.config.settings import LifterSettings, ViewSettings
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, to_training_set, with_labels
from uplift.models.lifter import Lifter
from uplift.priors.base import Lift
from uplift.skeleton import Skeleton, load_skeleton
from uplift.training.lifting import make_lift
from uplift.training.views import build_views

H36M = load_skeleton("h36m17")


@contextmanager
def doubles() -> Iterator[None]:
    """Compute in float64, to compare values to twelve digits."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def bodies(frames: int = 12, seed: int = 0, skeleton: Skeleton = H36M, missing: float = 0.0) -> PoseData:
    """Return random bodies of ``skeleton`` in the default float type; the root is never missing."""
    kind = torch.zeros(()).numpy().dtype
    arrays = body_arrays(frames, seed, skeleton.name, film=False)
    rng = np.random.default_rng(seed + 1)
    confidence = (rng.random(arrays["keypoints"].shape[:2]) >= missing).astype(kind)
    confidence[:, skeleton.root_index] = 1
    keypoints = arrays["keypoints"].astype(kind) * (confidence[..., None] > 0)
    pose = arrays["pose"].astype(kind)
    return PoseData(keypoints, confidence, skeleton.joints, pose=pose, root=arrays["root"].astype(kind))


def seen_bodies(**changes) -> PoseData:
    """Return bodies seen by a known camera, all labelled."""
    data = replace(bodies(40), focal_px=1145.0, image_size=(1000, 1000), labelled=np.ones(40, bool))
    return replace(data, tilt_deg=body_arrays(40, film=False)["tilt_deg"], **changes)


def labelled_frames(data: PoseData, **settings) -> TrainingSet:
    return with_labels(to_training_set(data, H36M, LifterSettings(**settings)), data)


def training_set(frames: int = 12, seed: int = 0, skeleton: Skeleton = H36M, **rest) -> TrainingSet:
    """Return the training set of `bodies`."""
    return TrainingSet.of(bodies(frames, seed, skeleton, rest.pop("missing", 0.0)), skeleton, **rest)


def small_lifter(skeleton: Skeleton = H36M, seed: int = 0, **settings) -> Lifter:
    """Return a small lifter whose depths are not close to 0."""
    torch.manual_seed(seed)
    settings.setdefault("uncertainty", False)
    lifter = Lifter(skeleton, LifterSettings(options={"units": 16, "blocks": 1}, **settings))
    with torch.no_grad():
        for parameter in lifter.network.leave.parameters():
            parameter.mul_(20)
    return lifter


def lift_of(lifter: Lifter, data: TrainingSet, seed: int = 0, hide: float = 0.0, **views) -> Lift:
    """Return one lift of all frames of ``data``."""
    torch.manual_seed(seed)
    settings = ViewSettings(**views)
    make_views = build_views(settings, lifter.skeleton)
    return make_lift(lifter, data.draw(torch.arange(len(data))), make_views, settings, hide)


def lift_of_pose(pose: Tensor, skeleton: Skeleton = H36M, confidence: Tensor | None = None, seed: int = 0) -> Lift:
    """Return a lift whose pose is ``pose`` itself, seen by a level perspective camera."""
    lifter = small_lifter(skeleton, tilt="level")
    confidence = torch.ones(pose.shape[:2]) if confidence is None else confidence
    distance = torch.full((len(pose),), 10.0)
    keypoints = lifter.camera.project(pose.detach(), distance) * (confidence > 0).unsqueeze(-1)
    data = replace(
        training_set(len(pose), skeleton=skeleton),
        keypoints=keypoints, confidence=confidence, scale=torch.ones(len(pose)), distance=distance,
    )  # fmt: skip
    return replace(lift_of(lifter, data, seed), pose=pose, tilt=torch.zeros(len(pose)))


def true_pose(data: PoseData) -> Tensor:
    """Return the true poses at a mean 3D radius of 1."""
    assert data.pose is not None
    pose = torch.from_numpy(data.pose)
    return pose / pose.norm(dim=-1).mean(1)[:, None, None]


def permuted(skeleton: Skeleton, order: np.ndarray) -> Skeleton:
    """Return the skeleton with its joints listed in another order."""
    plain = copy.deepcopy(skeleton.to_dict())
    plain["joints"] = [skeleton.joints[i] for i in order]
    return Skeleton.from_dict(plain)
