"""Refining a clip: bones become constant, what was seen stays, single frames are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from uplift.config.settings import RefineSettings
from uplift.data.clean import clean
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Perspective
from uplift.geometry.normalise import Intrinsics, bone_lengths
from uplift.models.refine import has_clips, refine_clips
from uplift.skeleton import load_skeleton

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


def refined(training_set: TrainingSet, depth: torch.Tensor, **settings: float) -> torch.Tensor:
    return refine_clips(training_set, training_set.keypoints, depth, Perspective(), RefineSettings(**settings))


def test_noisy_depths_come_nearer_to_the_truth(clips):
    training_set, depth = clips
    torch.manual_seed(0)
    noisy = depth + 0.15 * torch.randn_like(depth)
    noisy[:, 0] = 0
    pose = refined(training_set, noisy)
    assert (pose[..., 2] - depth).abs().mean() < 0.6 * (noisy - depth).abs().mean()
    assert (pose[:, 0] == 0).all()


def test_sure_keypoints_stay_where_they_were_seen(clips):
    training_set, depth = clips
    torch.manual_seed(0)
    pose = refined(training_set, depth + 0.1 * torch.randn_like(depth))
    seen = Perspective().project(pose, training_set.distance)
    torch.testing.assert_close(seen, training_set.keypoints, atol=1e-5, rtol=1e-5)


def test_noisy_keypoints_come_nearer_to_the_truth(clips):
    training_set, depth = clips
    torch.manual_seed(0)
    off = 0.04 * torch.randn_like(training_set.keypoints)
    off[:, 0] = 0
    doubtful = torch.full_like(training_set.confidence, 0.7)
    noisy = replace(training_set, keypoints=training_set.keypoints + off, confidence=doubtful)
    seen = Perspective().project(refined(noisy, depth), training_set.distance)
    assert (seen - training_set.keypoints).norm(dim=-1).mean() < 0.8 * off.norm(dim=-1).mean()


def test_true_depths_stay(clips):
    training_set, depth = clips
    assert (refined(training_set, depth)[..., 2] - depth).abs().mean() < 0.05


def test_single_frames_come_back_as_they_were(clips):
    training_set, depth = clips
    alone = replace(training_set, clip=torch.arange(len(depth)), follows=torch.zeros(len(depth), dtype=torch.bool))
    assert not has_clips(alone)
    assert torch.equal(refined(alone, depth), Perspective().unproject(alone.keypoints, depth, alone.distance))
    one = replace(training_set, clip=training_set.clip.clone(), follows=training_set.follows.clone())
    one.clip[0] = one.clip.max() + 1
    one.follows[:2] = False
    untouched = Perspective().unproject(one.keypoints, depth, one.distance)[0]
    assert torch.equal(refined(one, depth + 0.1 * torch.eye(len(depth), 17))[0, 1:], untouched[1:])


def test_a_missing_joint_is_found_again_between_the_frames_that_show_it(clips):
    training_set, depth = clips
    wrist = SKELETON.index("lwrist")
    gone = training_set.follows.clone()
    gone[:-1] &= training_set.follows[1:]
    gone &= torch.arange(len(gone)) % 3 == 1
    confidence = training_set.confidence.masked_fill(gone[:, None] & (torch.arange(17) == wrist), 0)
    keypoints, given = training_set.keypoints.clone(), depth.clone()
    keypoints[gone, wrist] += 0.4
    given[gone, wrist] -= 0.4
    blind = replace(training_set, confidence=confidence, keypoints=keypoints)
    pose, truth = refined(blind, given), Perspective().unproject(training_set.keypoints, depth, training_set.distance)
    before = Perspective().unproject(keypoints, given, training_set.distance)
    off = (pose - truth)[gone, wrist].norm(dim=-1).median()
    assert off < 0.5 * (before - truth)[gone, wrist].norm(dim=-1).median()
