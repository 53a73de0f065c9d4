"""Gravity: one tilt for two cameras, the upright of bodies, medians of clips."""

from __future__ import annotations

import pytest
import torch

from uplift.geometry.rotation import (
    about_x,
    about_y,
    body_tilt,
    clip_direction,
    clip_median,
    gravity_of,
    least_rotation,
    real_tilt,
    turn,
)


def _turned_cameras(count: int) -> torch.Tensor:
    """Return rotations of cameras that look aside, as one does that looks at a root off the image's centre."""
    rays = torch.cat([0.5 * torch.randn(count, 2), torch.ones(count, 1)], 1)
    return least_rotation(rays, torch.tensor([0.0, 0.0, 1.0]))


def test_the_tilt_of_a_turned_camera_gives_that_of_the_real_one():
    torch.manual_seed(0)
    tilt, rotation = torch.rand(500) - 0.3, _turned_cameras(500)
    seen = gravity_of(tilt, rotation)[:, 2].asin()
    torch.testing.assert_close(real_tilt(seen, rotation), tilt, atol=1e-4, rtol=1e-4)
    assert (seen - tilt).abs().mean() > 0.1, "the two cameras differ"
    assert torch.equal(real_tilt(tilt, None), tilt)


def test_gravity_is_down_in_a_level_camera():
    torch.testing.assert_close(gravity_of(torch.zeros(1), None), torch.tensor([[0.0, 1.0, 0.0]]))
    turned = turn(torch.tensor([[[0.0, 1.0, 0.0]]]), about_x(torch.tensor([0.3])))[:, 0]
    torch.testing.assert_close(gravity_of(torch.tensor([0.3]), None), turned)


@pytest.mark.parametrize("tilts", [(0.0, 0.7), (0.5, 0.5)])
def test_bodies_tell_the_tilt(tilts):
    """Bodies that mostly stand, seen from all around: their upright is the world's, whatever joints are where."""
    torch.manual_seed(0)
    body = torch.randn(12, 3)
    shape = body + 0.15 * torch.randn(3000, 12, 3)
    lean = about_x(0.1 * torch.randn(3000)) @ about_y(2 * torch.pi * torch.rand(3000))
    tilt = tilts[0] + (tilts[1] - tilts[0]) * torch.rand(3000)
    found, trust = body_tilt(turn(shape, about_x(tilt) @ lean))
    assert (found - tilt).abs().median() < 0.08
    assert (trust > 0).all()


def test_rigid_bodies_tell_the_tilt_exactly_and_others_are_not_trusted():
    """Bodies of many sizes that turn about gravity alone; a tenth of them are of another shape and lie anyhow."""
    generator = torch.Generator().manual_seed(0)
    body, other = torch.randn(2, 12, 3, generator=generator, dtype=torch.float64)
    body -= body.mean(0)
    azimuth, tilt, size = torch.rand(3, 400, generator=generator, dtype=torch.float64)
    tilt, strange = 0.9 * tilt - 0.3, torch.arange(400) % 10 == 3
    pose = turn(body.expand(400, 12, 3), about_x(tilt) @ about_y(6.3 * azimuth)) * (0.5 + size)[:, None, None]
    pose[strange] = turn(other.expand(400, 12, 3), about_x(9 * tilt) @ about_y(6.3 * azimuth))[strange]
    found, trust = body_tilt(pose)
    torch.testing.assert_close(found[~strange], tilt[~strange], atol=2e-3, rtol=0)
    assert trust[strange].max() < 1e-3 < 0.1 < trust[~strange].median() <= 1
    upside_down, _ = body_tilt(turn(pose, about_x(torch.full((400,), torch.pi, dtype=torch.float64))))
    torch.testing.assert_close(upside_down[~strange], tilt[~strange], atol=2e-3, rtol=0)


def test_neither_size_nor_a_turn_of_the_camera_changes_the_trust():
    generator = torch.Generator().manual_seed(2)
    body, noise = torch.randn(12, 3, generator=generator), torch.randn(60, 12, 3, generator=generator)
    azimuth, tilt, size = torch.rand(3, 60, generator=generator)
    pose = turn(body + 0.2 * noise, about_x(0.4 * tilt) @ about_y(6.3 * azimuth)).double()
    found, trust = body_tilt(pose)
    scaled = body_tilt(pose * (0.2 + 3 * size.double())[:, None, None])
    down = body_tilt(turn(pose, about_x(torch.full((60,), 0.3, dtype=torch.float64))))
    torch.testing.assert_close(scaled, (found, trust), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(down, (found + 0.3, trust), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_two_frames_of_a_body_are_enough_to_stand_it_upright(seed):
    body = torch.randn(12, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    tilt = torch.tensor([0.1, 0.1, 0.3], dtype=torch.float64)
    pose = turn(body.expand(3, 12, 3), about_x(tilt) @ about_y(torch.tensor([0.0, 1.5, 3.0], dtype=torch.float64)))
    torch.testing.assert_close(body_tilt(pose)[0], tilt, atol=1e-3, rtol=0)


def test_the_median_is_the_least_value_that_half_of_the_weight_does_not_exceed():
    generator = torch.Generator().manual_seed(1)
    value, weight = torch.rand(2, 60, generator=generator)
    clip = torch.randint(7, (60,), generator=generator)
    for number in range(7):
        mine = clip == number
        below = [weight[mine & (value <= one)].sum() for one in value[mine]]
        expected = min(one for one, sum in zip(value[mine], below, strict=True) if sum >= weight[mine].sum() / 2)
        assert (clip_median(value, weight, clip)[mine] == expected).all()


def test_the_median_of_a_clip():
    clip = torch.tensor([1, 0, 0, 1, 0, 2])
    value = torch.tensor([5.0, 1.0, 9.0, 7.0, 2.0, 4.0])
    median = clip_median(value, torch.tensor([1.0, 1, 1, 3, 1, 1]), clip)
    assert median.tolist() == [7, 2, 2, 7, 2, 4]
    weightless = clip_median(value, torch.tensor([0.0, 1, 1, 0, 1, 0]), clip)
    assert weightless.tolist() == [5, 2, 2, 5, 2, 4]  # of its own clip whatever the trust


def test_a_clips_direction_is_its_median_whatever_a_minority_says():
    torch.manual_seed(0)
    down = torch.tensor([0.2, 0.9, 0.3])
    vector = torch.cat([down + 0.02 * torch.randn(60, 3), torch.tensor([[0.9, -0.3, 0.2]]).expand(25, 3), -down[None]])
    clip = torch.tensor([0] * 85 + [1])
    found = clip_direction(vector, clip)
    assert (found[:85] == found[0]).all()
    assert torch.rad2deg((found[0] @ down / down.norm()).acos()) < 2
    torch.testing.assert_close(found[85], -down / down.norm())
    torch.testing.assert_close(clip_direction(vector * 3, clip), found)
