"""Crops of masks: the same wherever the mask lies and however large it is."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from uplift.data.mask_tensors import SPREAD, moments, recrop


def ellipse(x: float, y: float, wide: float, high: float, side: int = 48) -> Tensor:
    """Return a mask with a corner cut off, so that it has left and right, top and bottom."""
    at = (2 * torch.arange(side) + 1) / side - 1
    u, v = (at[None] - x) / wide, (at[:, None] - y) / high
    inside = torch.sigmoid((1 - (u**2 + v**2).sqrt()) * 12)
    return inside * torch.sigmoid((0.5 - u - v) * 12)


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.4, 0.7), st.floats(0.4, 0.7))
@settings(max_examples=20)
def test_crops_do_not_tell_place_and_proportions(x: float, y: float, wide: float, high: float) -> None:
    images = torch.stack([ellipse(0, 0, 0.6, 0.6), ellipse(x, y, wide, high)])
    centre, spread = moments(images)
    moved, stretched = centre[1] - centre[0] * torch.tensor([wide, high]) / 0.6, spread[1] / spread[0]
    assert moved.tolist() == pytest.approx([x, y], abs=0.02)
    assert (stretched * 0.6).tolist() == pytest.approx([wide, high], rel=0.05)
    first, second = recrop(images, centre, spread, 32)
    assert float((first - second).abs().mean()) < 0.02


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.2, 0.6), st.floats(0.2, 0.6))
@settings(max_examples=20)
def test_a_crop_has_its_centroid_in_the_middle_and_the_one_spread(x, y, wide, high) -> None:
    image = ellipse(x, y, wide, high)[None]
    crop = recrop(image, *moments(image), 32)
    centre, spread = moments(crop)
    assert centre[0].tolist() == pytest.approx([0, 0], abs=0.03)
    assert spread[0].tolist() == pytest.approx([SPREAD, SPREAD], rel=0.08)
    again = recrop(crop, centre, spread, 32)
    assert float((again - crop).abs().mean()) < 0.03


def test_mirror_images_have_mirrored_moments_and_crops() -> None:
    image = ellipse(0.1, -0.2, 0.5, 0.3)[None]
    centre, spread = moments(image)
    mirrored_centre, mirrored_spread = moments(image.flip(-1))
    assert torch.allclose(mirrored_centre, centre * torch.tensor([-1.0, 1.0]), atol=1e-6)
    assert torch.allclose(mirrored_spread, spread, atol=1e-6)
    mirrored = recrop(image.flip(-1), mirrored_centre, mirrored_spread, 32)
    assert torch.allclose(mirrored.flip(-1), recrop(image, centre, spread, 32), atol=1e-5)


def test_haze_moves_nothing_and_an_empty_mask_gives_numbers() -> None:
    image = ellipse(0.1, 0.1, 0.4, 0.4)[None]
    haze = image.clone()
    haze[:, :, :10] = haze[:, :, :10].clamp_min(0.25)
    for sharp, hazy in zip(moments(image), moments(haze), strict=True):
        assert torch.allclose(sharp, hazy, atol=1e-3)
    empty = torch.zeros(2, 48, 48)
    crop = recrop(empty, *moments(empty), 16)
    assert crop.shape == (2, 16, 16)
    assert bool(torch.isfinite(crop).all())
