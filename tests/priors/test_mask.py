"""The mask prior: what it costs, whom it moves, and that without masks nothing is different."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import QUICK, own_data, refusal, status_of
from lifts import H36M, lift_of, permuted, small_lifter
from masked_bodies import HIDDEN, WHOLE
from modules import lifting_module

from uplift.data.formats.npz import write_keypoints
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.geometry.normalise import Intrinsics
from uplift.priors import build_priors
from uplift.priors.mask import Mask, into_crop, sample_field, signed_distances, unit_of


def prepared(data: TrainingSet, **options) -> Mask:
    torch.manual_seed(0)
    prior = Mask(data.skeleton, **options)
    prior.prepare(data)
    return prior


def test_gradients_reach_the_network_through_missing_joints():
    data = TrainingSet.of(HIDDEN, H36M)
    for options in ({"explained": 0.0}, {"inside": 0.0}, {}):
        lift = lift_of(small_lifter(), data)
        keypoints = lift.lifted_keypoints
        keypoints.retain_grad()
        prepared(data, **options).loss(lift).mean().backward()
        assert keypoints.grad is not None and keypoints.grad.isfinite().all()
        assert (keypoints.grad[lift.visible == 0] != 0).any()
        gradients = [p.grad for p in lift.lifter.parameters() if p.grad is not None]
        assert any(bool((g != 0).any()) for g in gradients) and all(bool(g.isfinite().all()) for g in gradients)


def test_inside_costs_nothing_and_outside_as_far_as_it_is():
    data = TrainingSet.of(WHOLE, H36M)
    prior = prepared(data, explained=0.0)
    lift = lift_of(small_lifter(), data)
    inside = prior.loss(lift)
    assert float(inside.detach().max()) < 0.5
    wrist = H36M.index("rwrist")
    costs = []
    for away in (3.0, 6.0, 9.0):
        moved = lift.lifted_keypoints.clone()
        moved[:, wrist] += torch.tensor([away, 0.0])
        costs.append(prior.loss(replace(lift, lifted_keypoints=moved)))
    assert (costs[0] > inside).all() and (costs[1] > costs[0]).all()
    # Far from the crop one bone's points are 1/3, 2/3 and all of the way further out.
    farther = costs[2] - costs[1]
    torch.testing.assert_close(farther, torch.full_like(farther, 2.0), rtol=0.1, atol=0)


def test_following_the_gradient_brings_a_joint_back_from_afar():
    data = TrainingSet.of(WHOLE, H36M)
    prior = prepared(data)
    lift = lift_of(small_lifter(), data)
    wrist = H36M.index("rwrist")
    place = (lift.keypoints[:, wrist] + torch.tensor([4.0, -3.0])).requires_grad_()
    descent = torch.optim.Adam([place], lr=0.1)
    before, moved = None, lift.lifted_keypoints
    for _ in range(120):
        moved = lift.lifted_keypoints.detach().index_copy(1, torch.tensor([wrist]), place.unsqueeze(1))
        loss = prior.loss(replace(lift, lifted_keypoints=moved)).sum()
        before = float(loss.detach()) if before is None else before
        descent.zero_grad()
        loss.backward()
        descent.step()
    assert before is not None and lift.mask_map is not None
    assert float(prior.loss(replace(lift, lifted_keypoints=moved)).detach().sum()) < 0.1 * before
    at = sample_field(prior.field, into_crop(place.detach().unsqueeze(1), lift.mask_map))[:, 0] * unit_of(lift.mask_map)
    assert float(at.max()) < 0.1


@pytest.mark.parametrize("intrinsics", [None, Intrinsics(1145.0, (500.0, 500.0))])
def test_a_mirrored_pose_with_its_mirrored_mask_costs_the_same(intrinsics):
    data = TrainingSet.of(HIDDEN, H36M, intrinsics=intrinsics)
    prior, lifter = prepared(data), small_lifter()
    swap = lifter.mirror_permutation
    batch = data.draw(torch.arange(len(data)))
    mirrored = batch.mirrored(torch.ones(len(data), dtype=torch.bool), swap)
    lift = lift_of(lifter, data)
    moved = lift.measured_keypoints.detach() + 0.3 * torch.randn(lift.lifted_keypoints.shape)
    flip = torch.tensor([-1.0, 1.0])
    one = replace(lift, lifted_keypoints=moved)
    other = replace(
        lift, lifted_keypoints=moved[:, swap] * flip, keypoints=mirrored.keypoints, confidence=mirrored.confidence,
        mask_map=mirrored.mask_map,
    )  # fmt: skip
    assert prior.loss(one).min() > 0
    torch.testing.assert_close(prior.loss(other), prior.loss(one), rtol=1e-3, atol=1e-4)
    # The same as mirroring the picture itself.
    assert WHOLE.masks is not None and mirrored.mask_map is not None
    turned = signed_distances(torch.from_numpy(WHOLE.masks[:, :, ::-1].copy()))
    points = into_crop(mirrored.keypoints, mirrored.mask_map) * flip
    torch.testing.assert_close(
        sample_field(turned, points), sample_field(prior.field, points * flip), rtol=1e-3, atol=1e-3
    )


def test_the_order_of_joints_does_not_matter():
    order = np.random.default_rng(4).permutation(17)
    rows = torch.as_tensor(order.copy())
    other = permuted(H36M, order)
    data = TrainingSet.of(HIDDEN, H36M)
    changed = replace(data, skeleton=other, keypoints=data.keypoints[:, rows], confidence=data.confidence[:, rows])
    lift = lift_of(small_lifter(), data)
    moved = replace(
        lift, skeleton=other, keypoints=lift.keypoints[:, rows], confidence=lift.confidence[:, rows],
        hidden=lift.hidden[:, rows], lifted_keypoints=lift.lifted_keypoints[:, rows],
    )  # fmt: skip
    # Gaps are filled at random while bones are measured: whole frames tell the same in any order.
    whole = TrainingSet.of(WHOLE, H36M)
    same = replace(whole, skeleton=other, keypoints=whole.keypoints[:, rows], confidence=whole.confidence[:, rows])
    torch.testing.assert_close(prepared(same).radii, prepared(whole).radii)
    one, two = prepared(data), prepared(changed)
    two.radii, two.unexplained, two.share = one.radii, one.unexplained, one.share
    torch.testing.assert_close(two.loss(moved), one.loss(lift))


def test_frames_without_a_mask_cost_nothing_and_pull_at_nothing():
    assert HIDDEN.masks is not None and HIDDEN.mask_box is not None
    box, masks = HIDDEN.mask_box.copy(), HIDDEN.masks.copy()
    box[3] = np.nan
    masks[5] = 0
    data = TrainingSet.of(replace(HIDDEN, masks=masks, mask_box=box), H36M)
    lift = lift_of(small_lifter(), data)
    keypoints = lift.lifted_keypoints
    keypoints.retain_grad()
    loss = prepared(data).loss(lift)
    loss.sum().backward()
    assert keypoints.grad is not None and keypoints.grad.isfinite().all()
    without = torch.tensor([3, 5])
    assert not loss[without].any() and not keypoints.grad[without].any()
    assert int((loss > 0).sum()) == len(data) - 2


def test_a_missing_root_is_measured_from_its_stand_in():
    confidence = HIDDEN.confidence.copy()
    confidence[:, H36M.root_index] = 0
    data = TrainingSet.of(replace(HIDDEN, confidence=confidence), H36M)
    lift = lift_of(small_lifter(), data)
    seen = lift.visible > 0
    assert (lift.lifted_keypoints - lift.keypoints).abs()[seen].max() > 0.01
    torch.testing.assert_close(lift.measured_keypoints[seen], lift.keypoints[seen], rtol=1e-4, atol=1e-5)


def test_masks_elsewhere_than_the_keypoints_are_told():
    assert WHOLE.mask_box is not None
    shifted = replace(WHOLE, mask_box=WHOLE.mask_box + np.array([2000, 0, 0], np.float32))
    with pytest.raises(UserError, match="0% of the keypoints lie in their frame's mask"):
        prepared(TrainingSet.of(shifted, H36M))


@pytest.mark.parametrize(
    ("option", "value"), [("inside", -1.0), ("explained", -1.0), ("thickness", -1.0), ("pixels", 0)]
)
def test_options_below_their_least_are_refused(option, value):
    with pytest.raises(UserError, match=rf"priors\.mask\.{option}={value}"):
        Mask(H36M, **{option: value})


# Fits


def _gradients(data: PoseData, *, mask: bool = False) -> list[torch.Tensor]:
    """Return the gradient of the lifter after one step's loss."""
    frames = TrainingSet.of(data, H36M)
    torch.manual_seed(0)
    priors = build_priors({"bones": {}, **({"mask": {}} if mask else {})}, H36M)[0]
    for prior in priors.values():
        prior.prepare(frames)
    module = lifting_module(small_lifter(), frames, priors)
    torch.manual_seed(1)
    module.objective(32)[0].backward()
    return [p.grad.clone() for p in module.lifter.parameters() if p.grad is not None]


def test_a_step_is_the_same_with_masks_that_no_prior_looks_at():
    without = _gradients(replace(HIDDEN, masks=None, mask_box=None))
    unused = _gradients(HIDDEN)
    used = _gradients(HIDDEN, mask=True)
    assert all(torch.equal(a, b) for a, b in zip(without, unused, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(without, used, strict=True))


def test_where_all_joints_are_seen_nothing_is_moved():
    without, used = _gradients(WHOLE), _gradients(WHOLE, mask=True)
    for one, other in zip(without, used, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_a_fit_says_how_many_filled_joints_are_inside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_keypoints(HIDDEN, tmp_path / "bodies.npz")
    quick = [*QUICK, "trainer.max_steps=4", "student.share=0", "priors.mask.weight=5"]
    assert status_of("fit", "skeleton=h36m17", "data.train=bodies.npz", *quick) == 0
    assert "mask_filled_inside" in next(Path("runs").glob("*/last/metrics.csv")).read_text()


def test_without_masks_nothing_is_held():
    data = TrainingSet.of(replace(WHOLE, masks=None, mask_box=None), H36M)
    lift = lift_of(small_lifter(), data)
    assert data.masks is None and data.mask_map is None and lift.masks is None and lift.mask_map is None


def test_the_prior_without_masks_is_one_clear_error(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said = refusal(capsys, "fit", *own_data(tmp_path / "bodies.npz"), "priors.mask.weight=1")
    assert "no training frame has a mask" in said and "priors.mask.weight=0" in said
