"""Silhouettes of grids: those of rays through the grid in 3D, with gradients to everything, whatever the resolution."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation
from shape_spaces import smooth_density
from torch import Tensor

from uplift.models.silhouettes import ObjectPose, angles_of, silhouettes

ANGLE = st.floats(-math.pi, math.pi)
TILT = st.floats(-1.4, 1.4)
SHIFT = st.floats(-0.2, 0.2)
DEPTH, VOXELS = 1.1, 32 / 2
"""Half the depth that rays are seen over, and how many voxels of the usual grid a unit has."""


def pose_of(azimuth: float, elevation: float, roll: float, scale: float, x: float, y: float) -> ObjectPose:
    """Return the pose of one item."""
    return ObjectPose(*(torch.tensor([part]) for part in (azimuth, elevation, roll, scale)), torch.tensor([[x, y]]))


def along_rays(density: np.ndarray, pose: ObjectPose, side: int, distance: float) -> np.ndarray:
    """Return the silhouette by marching along the ray of each pixel, as `uplift.data.masks.Placed` has cameras."""
    azimuth, elevation, roll, scale = (float(part[0]) for part in pose[:4])
    view = Rotation.from_euler("ZXY", [roll, elevation, azimuth]).as_matrix()
    at = (2 * np.arange(side) + 1) / side - 1
    steps = 4 * side
    depth = ((2 * np.arange(steps) + 1) / steps - 1) * DEPTH
    t, v, u = np.meshgrid(depth, at, at, indexing="ij")
    x, y = (
        (image * (1 + t / distance) - float(off)) / scale for image, off in zip((u, v), pose.offset[0], strict=True)
    )
    own = np.stack([x, y, t], -1) @ view  # the inverse of the rotation
    place = ((own + 1) * density.shape[0] - 1) / 2
    sampled = map_coordinates(density, [place[..., 2], place[..., 1], place[..., 0]], order=1, cval=0.0)
    thickness = (sampled**2).sum(0) * (2 * DEPTH / steps) * VOXELS
    return 1 - np.exp(-np.sqrt(thickness))


@given(ANGLE, TILT, ANGLE, st.floats(0.35, 0.6), SHIFT, SHIFT, st.floats(2.5, 50), st.integers(0, 50))
@settings(max_examples=15)
def test_silhouettes_are_those_of_rays_in_3d(
    azimuth: float, elevation: float, roll: float, scale: float, x: float, y: float, distance: float, seed: int
) -> None:
    pose = pose_of(azimuth, elevation, roll, scale, x, y)
    density = smooth_density(24, seed)
    expected = along_rays(density[0].numpy(), pose, 24, distance)
    found = silhouettes(density, pose, 24, distance, rolls=True)[0].numpy()
    assert expected.max() > 0.5
    # Three resamplings blur, and leaning a fourth: with twice the resolution these are a third.
    assert np.abs(found - expected).max() < 0.2
    assert np.abs(found - expected).mean() < 0.01
    upright = pose._replace(roll=torch.zeros(1))
    finer = silhouettes(density, upright, 24, distance, rolls=False)[0].numpy()
    off = np.abs(finer - along_rays(density[0].numpy(), upright, 24, distance))
    assert off.max() < 0.06
    assert off.mean() < 0.003
    both = silhouettes(density, upright, 24, distance, rolls=True)[0].numpy()
    assert np.allclose(finer, both, atol=1e-4), "an image that does not lean is not changed by leaning"


def test_each_item_is_seen_in_its_own_pose() -> None:
    poses = [pose_of(0.3, 0.2, 0.1, 0.5, 0.1, 0.0), pose_of(-2, -0.4, 2.0, 0.4, 0.0, -0.1)]
    density = torch.cat([smooth_density(12, seed) for seed in (0, 1)])
    both = ObjectPose(*(torch.cat(part) for part in zip(*poses, strict=True)))
    seen = silhouettes(density, both, 16, 6.0, rolls=True)
    for row, pose in enumerate(poses):
        alone = silhouettes(density[row : row + 1], pose, 16, 6.0, rolls=True)
        assert torch.allclose(seen[row : row + 1], alone, atol=1e-5)
        assert all(torch.equal(a, b) for a, b in zip(both.pick(slice(row, row + 1)), pose, strict=True))


@pytest.mark.parametrize("seed", range(3))
def test_gradients_reach_density_and_every_part_of_the_pose(seed: int) -> None:
    torch.manual_seed(seed)
    density = torch.rand(1, 6, 6, 6, dtype=torch.float64) + 0.1
    parts = [torch.tensor([part], dtype=torch.float64) for part in (0.7 + seed, 0.31, 0.23, 0.52)]
    given = [part.requires_grad_() for part in (density, *parts, torch.tensor([[0.07, -0.05]], dtype=torch.float64))]

    def seen(density: Tensor, *pose: Tensor) -> Tensor:
        return silhouettes(density, ObjectPose(*pose), 5, 6.0, rolls=True)

    # One voxel and one pixel after the other would take long: random mixtures of them.
    assert torch.autograd.gradcheck(seen, given, eps=1e-6, atol=1e-5, fast_mode=True)
    slopes = torch.autograd.grad(seen(*given).square().sum(), given)
    assert all(float(slope.abs().max()) > 1e-4 for slope in slopes)


@given(ANGLE, TILT, ANGLE, SHIFT, SHIFT)
@settings(max_examples=20)
def test_the_mirrored_pose_of_a_symmetric_shape_has_the_mirror_image(
    azimuth: float, elevation: float, roll: float, x: float, y: float
) -> None:
    density = smooth_density(12)
    density = density + density.flip(-1)
    pose = pose_of(azimuth, elevation, roll, 0.5, x, y)
    image, mirrored = (silhouettes(density, one, 16, 5.0, rolls=True) for one in (pose, pose.mirrored))
    assert torch.allclose(mirrored, image.flip(-1), atol=1e-4)
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    assert torch.allclose(pose.mirrored.view, flip @ pose.view @ flip, atol=1e-5)


@given(ANGLE, TILT, ANGLE)
def test_angles_are_those_of_the_view(azimuth: float, elevation: float, roll: float) -> None:
    pose = pose_of(azimuth, elevation, roll, 0.5, 0.1, 0.2)
    expected = Rotation.from_euler("ZXY", [roll, elevation, azimuth]).as_matrix()
    assert np.allclose(pose.view[0].numpy(), expected, atol=1e-5)
    for found, angle in zip(angles_of(pose.view), (azimuth, elevation, roll), strict=True):
        assert abs(math.remainder(float(found[0]) - angle, 2 * math.pi)) < 1e-3
    again = ObjectPose.of(pose.view, pose.scale, pose.offset)
    assert torch.allclose(again.view, pose.view, atol=1e-4)


@pytest.mark.parametrize("elevation", [0.0, 0.5])
def test_opacity_hardly_depends_on_the_resolution(elevation: float) -> None:
    pose = pose_of(0.6, elevation, 0.0, 0.5, 0.1, -0.1)
    usual = silhouettes(smooth_density(24), pose, 16, 6.0, rolls=False)
    finer = silhouettes(smooth_density(48), pose, 16, 6.0, rolls=False)
    larger = silhouettes(smooth_density(24), pose, 48, 6.0, rolls=False)
    assert float((usual - finer).abs().max()) < 0.04
    pooled = torch.nn.functional.avg_pool2d(larger, 3)
    assert float((usual - pooled).abs().max()) < 0.1


def test_poses_are_chosen_item_by_item() -> None:
    one, other = pose_of(0.3, 0.2, 0.1, 0.5, 0.1, 0.0), pose_of(-2, -0.4, 2.0, 0.4, 0.0, -0.1)
    pair = ObjectPose(*(torch.cat([a, b]) for a, b in zip(one, other, strict=True)))
    swapped = ObjectPose(*(torch.cat([b, a]) for a, b in zip(one, other, strict=True)))
    mixed = ObjectPose.where(torch.tensor([True, False]), pair, swapped)
    assert all(torch.equal(part[0], part[1]) for part in mixed)
    assert torch.equal(mixed.offset[0], one.offset[0])
