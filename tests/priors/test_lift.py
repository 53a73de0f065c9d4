"""What a prior sees: frames, scales and what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, doubles, lift_of, small_lifter, training_set

from uplift.priors.base import Lift
from uplift.skeleton import load_skeleton

VIEWS = {"elevation": ["batch", "normal", "same"]}


@pytest.fixture(autouse=True)
def _double():
    with doubles():
        yield


def _tilted():
    return small_lifter(tilt="predicted")


@pytest.mark.parametrize("elevation", VIEWS["elevation"])
def test_turned_is_the_pose_from_the_view(elevation):
    lift = lift_of(_tilted(), training_set(missing=0.2), elevation=elevation)
    expected = np.einsum("bij,bnj->bni", lift.view.detach().numpy(), lift.pose.detach().numpy())
    np.testing.assert_allclose(lift.rotated.detach().numpy(), expected, atol=1e-12)
    torch.testing.assert_close(lift.view @ lift.view.mT, torch.eye(3).expand(len(lift.pose), 3, 3))


@pytest.mark.parametrize("count_root", [True, False])
def test_seen_is_normalised_as_real_keypoints_are(count_root):
    data = training_set(missing=0.2, count_root=count_root)
    lift = lift_of(_tilted(), data, count_root=count_root)
    weight = lift.confidence.clone()
    weight[:, H36M.root_index] *= count_root
    for keypoints in (lift.reprojected, lift.keypoints):
        radius = (keypoints.norm(dim=-1) * weight).sum(1) / weight.sum(1)
        torch.testing.assert_close(radius, torch.ones(len(radius)), rtol=0, atol=1e-6)
        assert keypoints[:, H36M.root_index].abs().max() < 1e-12
    projected = lift.lifter.camera.project(lift.rotated, lift.distance)
    torch.testing.assert_close(lift.reprojected * lift.reprojected_scale[:, None, None], projected)


def test_without_renormalisation_seen_is_the_projection():
    lift = lift_of(_tilted(), training_set(), renormalise=False)
    assert torch.equal(lift.reprojected, lift.lifter.camera.project(lift.rotated, lift.distance))
    assert (lift.reprojected_scale == 1).all()


def test_level_pose_undoes_the_tilt():
    """Gravity as the camera sees it, (0, cos, sin), is y in the level frame; the view keeps what is level, level."""
    lift = lift_of(_tilted(), training_set(), elevation="same")
    down = torch.stack([torch.zeros_like(lift.tilt), lift.tilt.cos(), lift.tilt.sin()], -1)
    height = (lift.pose * down[:, None]).sum(-1)
    torch.testing.assert_close(lift.level_pose[..., 1], height)
    torch.testing.assert_close((lift.rotated * down[:, None]).sum(-1), height)


def test_views_without_gravity_are_any_rotation():
    hand = load_skeleton("hand21")
    lift = lift_of(small_lifter(hand), training_set(200, skeleton=hand))
    assert torch.equal(lift.level_pose, lift.pose)
    assert lift.view.mean(0).abs().max() < 0.15


def test_azimuth_range_and_new_tilts():
    lifter = small_lifter(tilt="level")
    lift = lift_of(lifter, training_set(200), azimuth_deg=(10.0, 30.0))
    azimuth = torch.atan2(lift.view[:, 0, 2], lift.view[:, 0, 0]).rad2deg()
    assert azimuth.min() > 10 and azimuth.max() < 30 and azimuth.std() > 4
    predicted = lift_of(_tilted(), training_set(200), elevation="batch")
    new = torch.atan2(predicted.view[:, 2, 1], predicted.view[:, 1, 1])  # only for tilts and azimuths near 0
    assert new.isfinite().all()
    gravity = torch.stack([torch.zeros(200), predicted.tilt.cos(), predicted.tilt.sin()], -1)
    after = (predicted.view @ gravity[..., None])[..., 0]
    found = torch.atan2(after[:, 2], after[:, 1]).sort().values
    torch.testing.assert_close(found, predicted.tilt.sort().values), "the batch's own tilts, in another order"


def test_hidden_joints_are_known_but_not_shown():
    lifter, data = small_lifter(), training_set(40, missing=0.2)
    lift = lift_of(lifter, data, hide=0.5)
    assert not lift.hidden[:, H36M.root_index].any()
    assert not (lift.hidden & (lift.confidence == 0)).any()
    assert 0.3 < float(lift.hidden.double().mean()) < 0.5
    assert torch.equal(lift.keypoints, data.keypoints) and torch.equal(lift.confidence, data.confidence)
    moved = replace(data, keypoints=torch.where(lift.hidden[..., None], data.keypoints + 9, data.keypoints))
    assert torch.equal(lift_of(lifter, moved, hide=0.5).pose, lift.pose)


def test_relifting_has_the_same_joints_missing():
    lift = lift_of(_tilted(), training_set(missing=0.3))
    keypoints = torch.where(lift.visible[..., None] > 0, lift.reprojected, 0.0)
    expected = lift.lifter(keypoints, lift.confidence, lift.distance / lift.reprojected_scale)
    torch.testing.assert_close(lift.relifted.pose, expected.pose)


def test_everything_carries_gradients_to_the_lifter():
    lifter = _tilted()
    for name in ("pose", "level_pose", "rotated", "reprojected"):
        lifter.zero_grad()
        getattr(lift_of(lifter, training_set()), name).square().sum().backward()
        assert lifter.network.enter.weight.grad.abs().sum() > 0, name


def test_weighted_mean():
    value = torch.tensor([[1.0, 2], [3, 100]])
    assert Lift.mean(value, torch.tensor([[1.0, 1], [2, 0]])) == pytest.approx(9 / 4)
    assert Lift.mean(value, torch.zeros(2, 2)) == 0


@pytest.mark.parametrize(
    ("old", "new"), [("seen", "reprojected"), ("seen_scale", "reprojected_scale"), ("turned", "rotated")]
)
def test_a_former_name_is_an_error_with_the_new_one(old: str, new: str) -> None:
    with pytest.raises(AttributeError, match=rf"lift\.{old} is now called lift\.{new}"):
        getattr(lift_of(small_lifter(), training_set()), old)
