"""Refining a clip: bones become constant, what was seen stays, single frames are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from uplift.camera import Perspective
from uplift.config import RefineSettings
from uplift.data.clean import clean
from uplift.data.tensors import TrainingSet
from uplift.normalise import Intrinsics
from uplift.pose import bone_lengths
from uplift.simulator import simulate
from uplift.skeleton import load_skeleton
from uplift.training.refine import refine_depth, steady_tilt

SKELETON = load_skeleton("h36m17")


@pytest.fixture(scope="module")
def clips() -> tuple[TrainingSet, torch.Tensor]:
    """Simulated clips with their true depths, in units."""
    data = simulate(SKELETON, 900, seed=4)
    clean_data, _ = clean(data, SKELETON)
    intrinsics = Intrinsics(data.focal_px, data.centre_px)
    training_set = TrainingSet.of(clean_data, SKELETON, count_root=False, intrinsics=intrinsics)
    pose = torch.from_numpy(clean_data.pose)
    unit = torch.from_numpy(np.linalg.norm(clean_data.root, axis=1)) / training_set.distance
    turned = pose @ training_set.rotation.mT / unit[:, None, None]
    return training_set, turned[..., 2]


def test_the_bodies_of_the_clips_are_steady(clips):
    training_set, depth = clips
    pose = Perspective().unproject(training_set.keypoints, depth, training_set.distance)
    lengths = bone_lengths(pose, torch.as_tensor(SKELETON.bone_indices.copy()))
    share = lengths / lengths.mean(1, keepdim=True)
    for clip in range(int(training_set.clip.max()) + 1):
        assert (share[training_set.clip == clip].std(0) < 0.1).all()


def test_noisy_depths_come_nearer_to_the_truth(clips):
    training_set, depth = clips
    torch.manual_seed(0)
    noisy = depth + 0.15 * torch.randn_like(depth)
    noisy[:, 0] = 0
    refined = refine_depth(training_set, training_set.keypoints, noisy, Perspective(), RefineSettings())
    assert (refined - depth).abs().mean() < 0.6 * (noisy - depth).abs().mean()
    assert (refined[:, 0] == 0).all()


def test_true_depths_stay(clips):
    training_set, depth = clips
    refined = refine_depth(training_set, training_set.keypoints, depth, Perspective(), RefineSettings())
    assert (refined - depth).abs().mean() < 0.05


def test_single_frames_come_back_as_they_were(clips):
    training_set, depth = clips
    alone = replace(training_set, clip=torch.arange(len(depth)), follows=torch.zeros(len(depth), dtype=torch.bool))
    assert refine_depth(alone, alone.keypoints, depth, Perspective(), RefineSettings()) is depth


def test_missing_joints_have_no_say(clips):
    training_set, depth = clips
    confidence = training_set.confidence.clone()
    wrist = SKELETON.index("lwrist")
    confidence[:, wrist] = 0
    blind = replace(training_set, confidence=confidence)
    refined = []
    for wrong in (0.0, 5.0):
        keypoints, given = blind.keypoints.clone(), depth.clone()
        keypoints[:, wrist] += wrong
        given[:, wrist] += wrong
        refined.append(refine_depth(blind, keypoints, given, Perspective(), RefineSettings(iterations=10)))
    others = [j for j in range(17) if j != wrist]
    torch.testing.assert_close(refined[0][:, others], refined[1][:, others])


def test_tilt_of_a_clip_is_steady(clips):
    training_set, _ = clips
    torch.manual_seed(0)
    tilt = 0.2 + 0.1 * torch.randn(len(training_set))
    # A camera that looks straight ahead has the tilt that was found: no rotation to undo.
    plain = replace(training_set, rotation=None)
    steady = steady_tilt(plain, tilt)
    for clip in range(int(plain.clip.max()) + 1):
        members = plain.clip == clip
        torch.testing.assert_close(steady[members], tilt[members].mean().expand(int(members.sum())))
    assert steady_tilt(training_set, tilt).std() < tilt.std()
