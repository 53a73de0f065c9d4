"""Masks beside keypoints: read, checked, carried along, and the way from a keypoint into its mask."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import H36M, bodies
from masked_bodies import WHOLE, masked

from uplift.data.concat import concat_poses
from uplift.data.formats.npz import read_npz, write_keypoints
from uplift.data.poses import mask_maps
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.geometry.normalise import Intrinsics
from uplift.priors.mask import into_crop, sample_field, segment_distances, signed_distances, soft_gap, unit_of

SEEDS = st.integers(0, 2**31 - 1)


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_maps_take_keypoints_to_their_crop(seed):
    """With and without a known camera; by hand in px."""
    data = masked(bodies(3, seed % 1000), 8)
    assert data.mask_box is not None
    px = (data.keypoints - data.mask_box[:, None, :2]) / data.mask_box[:, None, 2:] * 2 - 1
    for intrinsics in (None, Intrinsics(1145.0, (500.0, 500.0))):
        frames = TrainingSet.of(data, H36M, intrinsics=intrinsics)
        assert frames.mask_map is not None
        torch.testing.assert_close(
            into_crop(frames.keypoints, frames.mask_map), torch.from_numpy(px), rtol=1e-3, atol=2e-3
        )
    flat = mask_maps(data, 0, np.ones(3))
    np.testing.assert_allclose(unit_of(torch.from_numpy(flat)), data.mask_box[:, 2] / 2, rtol=1e-4)


def test_distances_are_those_of_a_disc():
    at = (2 * np.arange(64) + 1) / 64 - 1
    radius = np.hypot(*np.meshgrid(at, at))
    field = signed_distances(torch.from_numpy(((radius < 0.5) * 255).astype(np.uint8)[None]))
    points = torch.tensor([[[0.0, 0.9], [0.3, 0.0], [-3.0, 0.0], [0.25, 0.25]]])
    expected = points.norm(dim=-1) - 0.5
    torch.testing.assert_close(sample_field(field, points), expected, rtol=0, atol=0.04)


def test_capsules_are_as_far_as_their_segment():
    ends = torch.tensor([[[[0.0, 0.0], [2.0, 0.0]], [[1.0, 1.0], [1.0, 1.0]]]])
    points = torch.tensor([[[1.0, 0.5], [3.0, 0.0], [-3.0, 4.0]]])
    found = segment_distances(points, ends)
    expected = torch.tensor([[[0.5, 0.5], [1.0, 5**0.5], [5.0, 5.0]]])
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-3)
    gap = soft_gap(found, torch.tensor([0.6, 0.6]))
    assert gap[0, 0] == 0
    assert float(gap[0, 1]) == pytest.approx(0.4, abs=0.01)


# Data


def test_masks_go_where_their_frames_go(tmp_path: Path):
    write_keypoints(WHOLE, tmp_path / "whole.npz")
    back = read_npz(tmp_path / "whole.npz")
    assert WHOLE.masks is not None and WHOLE.mask_box is not None
    assert back.masks is not None and back.mask_box is not None and np.array_equal(back.masks, WHOLE.masks)
    np.testing.assert_array_equal(back.mask_box, WHOLE.mask_box)
    assert WHOLE.masks is not None and WHOLE.mask_box is not None
    rows = np.array([5, 2])
    some = WHOLE.select(rows)
    assert some.masks is not None and some.mask_box is not None
    assert np.array_equal(some.masks, WHOLE.masks[rows]) and np.array_equal(some.mask_box, WHOLE.mask_box[rows])
    none = replace(WHOLE, masks=None, mask_box=None)
    both = concat_poses([none, some])
    assert both.masks is not None and both.mask_box is not None
    assert not both.masks[:24].any() and np.isnan(both.mask_box[:24]).all()
    assert np.array_equal(both.masks[24:], some.masks)
    with pytest.raises(UserError, match="16 and 32 px a side"):
        concat_poses([WHOLE, masked(bodies(2), 16)])


def test_training_sets_with_and_without_masks_are_joined():
    one, other = TrainingSet.of(WHOLE, H36M), TrainingSet.of(replace(WHOLE, masks=None, mask_box=None), H36M)
    both = TrainingSet.concat([other, one])
    assert both.masks is not None and both.mask_map is not None and one.mask_map is not None
    assert both.masks.dtype == torch.uint8
    assert both.mask_map[:24].isnan().all() and torch.equal(both.mask_map[24:], one.mask_map)
    with pytest.raises(UserError, match="px a side"):
        TrainingSet.concat([one, TrainingSet.of(masked(bodies(2), 16), H36M)])


@pytest.mark.parametrize("kind", [bool, np.uint8])
def test_masks_of_zeros_and_ones_are_read_as_whole(tmp_path: Path, kind):
    assert WHOLE.masks is not None and WHOLE.mask_box is not None
    path = tmp_path / "body.npz"
    np.savez(
        path, keypoints=WHOLE.keypoints, joint_names=np.array(H36M.joints), mask_box=WHOLE.mask_box,
        masks=(WHOLE.masks > 127).astype(kind),
    )  # fmt: skip
    back = read_npz(path)
    assert back.masks is not None and set(np.unique(back.masks)) == {0, 255}


MISTAKES = {
    "no box": ({"mask_box": None}, "'masks' without 'mask_box'"),
    "no masks": ({"masks": None}, "'mask_box' without 'masks'"),
    "floats": ({"masks": np.zeros((24, 32, 32))}, "'masks' is float64"),
    "not square": ({"masks": np.zeros((24, 32, 16), np.uint8)}, "expected uint8"),
    "other frames": ({"masks": np.zeros((23, 32, 32), np.uint8)}, r"\(24, side, side\)"),
    "tiny": ({"masks": np.zeros((24, 2, 2), np.uint8)}, "2 px a side"),
    "box of four": ({"mask_box": np.ones((24, 4))}, "x0, y0, side"),
    "text": ({"mask_box": np.full((24, 3), "x")}, "expected numbers"),
    "negative": ({"mask_box": np.full((24, 3), -1.0)}, "negative"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_bad_arrays_are_refused(name, tmp_path: Path):
    changes, message = MISTAKES[name]
    arrays = {"masks": WHOLE.masks, "mask_box": WHOLE.mask_box, **changes}
    arrays = {key: value for key, value in arrays.items() if value is not None}
    path = tmp_path / "bad.npz"
    np.savez(path, keypoints=WHOLE.keypoints, joint_names=np.array(H36M.joints), **arrays)
    with pytest.raises(UserError, match=message):
        read_npz(path)
