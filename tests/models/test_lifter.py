"""The lifter: depth relative to the root, mirror images, missing joints, tilts."""

from __future__ import annotations

import pytest
import torch
from lifts import H36M, doubles, small_lifter, training_set
from torch import Tensor, nn

from uplift.config.settings import LifterSettings
from uplift.geometry.normalise import mirror
from uplift.models.lifter import Lifted, Lifter
from uplift.skeleton import load_skeleton


@pytest.fixture(autouse=True)
def _double():
    with doubles():
        yield


def _lift(lifter: Lifter, data, *, both_ways: bool = False) -> Lifted:
    call = lifter.lift_both_ways if both_ways else lifter
    return call(data.keypoints, data.confidence, data.distance)


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_pose_projects_to_the_keypoints(camera, missing):
    lifter, data = small_lifter(camera=camera), training_set(missing=missing)
    lifted = _lift(lifter, data)
    seen = lifter.camera.project(lifted.pose, data.distance)
    torch.testing.assert_close(seen, lifted.keypoints, rtol=0, atol=1e-12)
    there = data.confidence > 0
    torch.testing.assert_close(seen[there], data.keypoints[there], rtol=0, atol=1e-12)
    assert not lifted.pose[:, H36M.root_index].any()
    assert lifted.pose[..., 2].std() > 0.1


def test_root_free_leaves_the_depth_of_the_root():
    data = training_set()
    lifter = small_lifter(camera="orthographic", root_free=True)
    bound = small_lifter(camera="orthographic")
    free, fixed = _lift(lifter, data).pose, _lift(bound, data).pose
    assert free[:, H36M.root_index, 2].abs().min() > 0
    torch.testing.assert_close(free - free[:, [H36M.root_index]], fixed)


@pytest.mark.parametrize("both_ways", [False, True])
def test_missing_joints_have_no_influence(both_ways):
    """Whatever coordinates a joint of confidence 0 has, everything comes out the same."""
    lifter, data = small_lifter(uncertainty=True, cameras="any", signs=8), training_set(missing=0.4)
    there = data.confidence[..., None] > 0
    moved = torch.where(there, data.keypoints, torch.randn_like(data.keypoints) * 50)
    call = lifter.lift_both_ways if both_ways else lifter
    one, other = _lift(lifter, data, both_ways=both_ways), call(moved, data.confidence, data.distance)
    assert all(torch.equal(value, getattr(other, name)) for name, value in vars(one).items())


def test_without_filling_missing_joints_stay_at_the_root():
    data = training_set(missing=0.4)
    gone = data.confidence == 0
    assert not _lift(small_lifter(fill=False), data).keypoints[gone].any()
    assert _lift(small_lifter(), data).keypoints[gone].abs().min() > 0


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
def test_both_ways_is_mirror_equivariant(camera):
    lifter, data = small_lifter(camera=camera), training_set(missing=0.3)
    swap = lifter.mirror_permutation
    straight = _lift(lifter, data, both_ways=True)
    mirrored = lifter.lift_both_ways(mirror(data.keypoints, swap), data.confidence[:, swap], data.distance)
    torch.testing.assert_close(mirrored.pose, mirror(straight.pose, swap), rtol=0, atol=1e-13)
    torch.testing.assert_close(mirrored.keypoints, mirror(straight.keypoints, swap), rtol=0, atol=1e-13)
    torch.testing.assert_close(mirrored.tilt, straight.tilt, rtol=0, atol=1e-13)
    assert (straight.pose - _lift(lifter, data).pose).abs().max() > 0.01, "the network alone is not equivariant"


def test_a_missing_root_is_where_the_lifter_says_it_is():
    """The others were measured from a stand-in; in the output they are measured from the root again."""
    lifter, data = small_lifter(), training_set()
    confidence = data.confidence.clone()
    confidence[:, H36M.root_index] = 0
    lifted = lifter(data.keypoints, confidence, data.distance)
    moved = lifted.keypoints - data.keypoints
    others = [joint for joint in range(len(H36M.joints)) if joint != H36M.root_index]
    assert not lifted.keypoints[:, H36M.root_index].any()
    torch.testing.assert_close(moved[:, others], moved[:, others[:1]].expand(-1, len(others), 2))
    assert moved[:, others].abs().min() > 0


def test_a_lifter_that_denoises_moves_what_it_sees():
    lifter, data = small_lifter(denoise=True), training_set()
    moved = _lift(lifter, data).keypoints - data.keypoints
    assert moved.abs().mean() > 0.01
    assert not moved[:, H36M.root_index].any()


@pytest.mark.parametrize("both_ways", [False, True])
def test_the_spread_is_positive_and_the_root_has_none(both_ways):
    spread = _lift(small_lifter(uncertainty=True), training_set(), both_ways=both_ways).uncertainty
    assert spread is not None
    assert not spread[:, H36M.root_index].any()
    assert (spread.sum(1) > 0).all()
    assert _lift(small_lifter(), training_set()).uncertainty is None


class Symmetric(nn.Module):
    """Depths that are the same seen in a mirror: of y and the squares of x."""

    def forward(self, features: Tensor) -> Tensor:
        x, y = features[:, 0 : 2 * len(H36M.joints) : 2], features[:, 1 : 2 * len(H36M.joints) : 2]
        return torch.sin(3 * y) + x.square() * (1 + y)


def test_mirror_commutes_with_a_lifter_that_is_equivariant():
    lifter = Lifter(
        H36M, LifterSettings(tilt="level", confidence_input=False, fill=False, uncertainty=False), Symmetric()
    )
    data, swap = training_set(), lifter.mirror_permutation
    once, twice = _lift(lifter, data), _lift(lifter, data, both_ways=True)
    mirrored = lifter(mirror(data.keypoints, swap), data.confidence, data.distance)
    torch.testing.assert_close(mirrored.pose, mirror(once.pose, swap))
    torch.testing.assert_close(twice.pose, once.pose)


def test_without_mirror_pairs_there_is_no_mirror_image():
    """A mirrored right hand is a left hand: the network never saw one."""
    hand = load_skeleton("hand21")
    lifter, data = small_lifter(hand, uncertainty=True), training_set(skeleton=hand)
    one, other = _lift(lifter, data), _lift(lifter, data, both_ways=True)
    assert torch.equal(one.pose, other.pose)
    assert torch.equal(one.uncertainty, other.uncertainty)


def test_tilts():
    data = training_set(30)
    assert _lift(small_lifter(tilt="predicted"), data).tilt.std() > 0
    learned = small_lifter(tilt="learned")
    with torch.no_grad():
        learned.common_tilt.fill_(0.2)
    assert (_lift(learned, data).tilt == 0.2).all()
    assert not _lift(small_lifter(tilt="level"), data).tilt.any()
    hand = load_skeleton("hand21")
    assert not _lift(small_lifter(hand, tilt="predicted"), training_set(skeleton=hand)).tilt.any(), (
        "no gravity, no tilt"
    )


def test_fresh_lifters_start_near_a_level_camera():
    torch.manual_seed(0)
    lifter = Lifter(H36M, LifterSettings())
    assert _lift(lifter, training_set(50)).tilt.abs().max() < 0.1


@pytest.mark.parametrize("denoise", [False, True])
def test_the_outputs_are_depths_then_places_then_logs_of_spreads_then_a_third_of_the_tilt(denoise):
    """Saved lifters are read by these places: none may move."""
    told = torch.arange(5 * (4 * 17 + 1), dtype=torch.float64).reshape(5, -1).sin() * 4

    class Fixed(nn.Module):
        def forward(self, features: Tensor) -> Tensor:
            assert torch.equal(features[:, 34:], data.confidence)
            assert torch.equal(features[:, :34].reshape(5, 17, 2), data.keypoints * (data.confidence > 0)[..., None])
            return told

    data = training_set(5, missing=0.3)
    settings = LifterSettings(tilt="predicted", uncertainty=True, denoise=denoise, camera="orthographic")
    lifted, root = _lift(Lifter(H36M, settings, Fixed()), data), H36M.root_index
    depth, spread = told[:, :17], told[:, 51:68].clamp(-5, 2).exp()
    torch.testing.assert_close(lifted.pose[..., 2], depth - depth[:, [root]])
    places = told[:, 17:51].reshape(5, 17, 2)
    seen = (data.confidence > 0)[..., None]
    expected = data.keypoints * seen + places if denoise else torch.where(seen, data.keypoints, places)
    torch.testing.assert_close(lifted.keypoints, expected - expected[:, [root]])
    others = [joint for joint in range(17) if joint != root]
    assert lifted.uncertainty is not None
    torch.testing.assert_close(lifted.uncertainty[:, others], spread[:, others])
    assert told[:, 51:68].min() < -3.9 and told[:, 51:68].max() > 2  # the bound below is far off
    torch.testing.assert_close(lifted.tilt, 0.3 * told[:, 68])
