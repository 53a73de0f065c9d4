"""Measures and mirror of poses."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.config.files import shipped_names
from uplift.geometry.normalise import bone_lengths, mean_radius, mirror
from uplift.skeleton import load_skeleton


@pytest.mark.parametrize("name", shipped_names("skeletons"))
@pytest.mark.parametrize("axes", [2, 3])
def test_mirror_is_an_involution(name, axes):
    skeleton = load_skeleton(name)
    points = torch.randn(4, len(skeleton.joints), axes, generator=torch.Generator().manual_seed(0))
    swap = torch.as_tensor(skeleton.mirror_permutation.copy())
    once = mirror(points, swap)
    assert torch.equal(mirror(once, swap), points)
    for one, other in skeleton.mirror:
        i, j = skeleton.index(one), skeleton.index(other)
        assert torch.equal(once[:, i, 0], -points[:, j, 0])
        assert torch.equal(once[:, i, 1:], points[:, j, 1:])


@given(seed=st.integers(0, 2**31 - 1), factor=st.floats(0.01, 100))
@settings(max_examples=25, deadline=None)
def test_bone_lengths_are_distances_and_scale(seed, factor):
    pose = torch.from_numpy(np.random.default_rng(seed).normal(size=(3, 17, 3)))
    bones = torch.as_tensor(load_skeleton("h36m17").bone_indices.copy())
    expected = np.linalg.norm(pose.numpy()[:, bones[:, 0]] - pose.numpy()[:, bones[:, 1]], axis=-1)
    np.testing.assert_allclose(bone_lengths(pose, bones).numpy(), expected, atol=1e-6)
    np.testing.assert_allclose(bone_lengths(pose * factor, bones).numpy(), expected * factor, rtol=1e-5, atol=1e-4)


def test_lengths_and_radius_of_nothing_have_finite_gradients():
    pose = torch.zeros(2, 5, 3, requires_grad=True)
    bones = torch.tensor([[0, 1], [1, 2]])
    (bone_lengths(pose, bones).sum() + mean_radius(pose[..., :2], torch.ones(2, 5), 0).sum()).backward()
    assert pose.grad is not None and pose.grad.isfinite().all()
    assert (mean_radius(pose[..., :2], torch.ones(2, 5), 0) > 0).all()
    assert (mean_radius(pose[..., :2], torch.zeros(2, 5), 0, count_root=False) > 0).all()
