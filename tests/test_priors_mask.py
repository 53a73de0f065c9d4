"""The mask prior: what it costs, whom it moves, and that without masks nothing is different."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import QUICK, own_data, refusal, status_of
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import H36M, bodies, lift_of, permuted, small_lifter
from PIL import Image, ImageDraw

from uplift.config import TeacherSettings, ViewSettings
from uplift.data.body_masks import mask_maps
from uplift.data.container import PoseData
from uplift.data.joining import join_data
from uplift.data.labels import joined
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.normalise import Intrinsics
from uplift.priors import build_priors
from uplift.priors.capsules import segment_distances, soft_gap
from uplift.priors.mask import Mask
from uplift.priors.mask_field import into_crop, sample_field, signed_distances, unit_of
from uplift.readers.npz import read_npz
from uplift.training.adversarial import AdversarialTraining
from uplift.writers.keypoints import write_keypoints

SIDE = 32
THICK_PX = 24
SEEDS = st.integers(0, 2**31 - 1)


def masked(data: PoseData, side: int = SIDE) -> PoseData:
    """Return the frames with masks: their bones, drawn with a broad pen."""
    masks, box = [], []
    for keypoints in data.keypoints:
        low, high = keypoints.min(0) - THICK_PX, keypoints.max(0) + THICK_PX
        size = float((high - low).max())
        picture = Image.new("L", (side * 4, side * 4))
        draw = ImageDraw.Draw(picture)
        scale = side * 4 / size
        for bone in H36M.bone_indices:
            a, b = ((keypoints[j] - low) * scale for j in bone)
            draw.line([*a, *b], fill=255, width=max(1, round(2 * THICK_PX * scale)))
        masks.append(np.asarray(picture.reduce(4)))
        box.append([*low, size])
    return replace(data, masks=np.stack(masks), mask_box=np.array(box, np.float32))


def hiding(data: PoseData, share: float = 0.3, seed: int = 0) -> PoseData:
    """Return the frames with joints missing, never the root."""
    confidence = (np.random.default_rng(seed).random(data.confidence.shape) >= share).astype(np.float32)
    confidence[:, H36M.root_index] = 1
    return replace(data, confidence=confidence, keypoints=data.keypoints * (confidence[..., None] > 0))


WHOLE = masked(bodies(24))
HIDDEN = hiding(WHOLE)


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
    before = None
    for _ in range(120):
        moved = lift.lifted_keypoints.detach().index_copy(1, torch.tensor([wrist]), place.unsqueeze(1))
        loss = prior.loss(replace(lift, lifted_keypoints=moved)).sum()
        before = float(loss.detach()) if before is None else before
        descent.zero_grad()
        loss.backward()
        descent.step()
    assert float(loss.detach()) < 0.1 * before
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
        torch.testing.assert_close(into_crop(frames.keypoints, frames.mask_map), torch.from_numpy(px), rtol=1e-3, atol=2e-3)
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
    assert back.masks is not None and np.array_equal(back.masks, WHOLE.masks)
    np.testing.assert_array_equal(back.mask_box, WHOLE.mask_box)
    assert WHOLE.masks is not None and WHOLE.mask_box is not None
    rows = np.array([5, 2])
    some = WHOLE.select(rows)
    assert np.array_equal(some.masks, WHOLE.masks[rows]) and np.array_equal(some.mask_box, WHOLE.mask_box[rows])
    none = replace(WHOLE, masks=None, mask_box=None)
    both = join_data([none, some])
    assert both.masks is not None and both.mask_box is not None
    assert not both.masks[:24].any() and np.isnan(both.mask_box[:24]).all()
    assert np.array_equal(both.masks[24:], some.masks)
    with pytest.raises(UserError, match="16 and 32 px a side"):
        join_data([WHOLE, masked(bodies(2), 16)])


def test_training_sets_with_and_without_masks_are_joined():
    one, other = TrainingSet.of(WHOLE, H36M), TrainingSet.of(replace(WHOLE, masks=None, mask_box=None), H36M)
    both = joined(other, one)
    assert both.masks is not None and both.mask_map is not None and both.masks.dtype == torch.uint8
    assert both.mask_map[:24].isnan().all() and torch.equal(both.mask_map[24:], one.mask_map)
    with pytest.raises(UserError, match="px a side"):
        joined(one, TrainingSet.of(masked(bodies(2), 16), H36M))


@pytest.mark.parametrize("kind", [bool, np.uint8])
def test_masks_of_zeros_and_ones_are_read_as_whole(tmp_path: Path, kind):
    assert WHOLE.masks is not None
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


def test_masks_elsewhere_than_the_keypoints_are_told():
    assert WHOLE.mask_box is not None
    shifted = replace(WHOLE, mask_box=WHOLE.mask_box + np.array([2000, 0, 0], np.float32))
    with pytest.raises(UserError, match="0% of the keypoints lie in their frame's mask"):
        prepared(TrainingSet.of(shifted, H36M))


@pytest.mark.parametrize(("option", "value"), [("inside", -1.0), ("explained", -1.0), ("thickness", -1.0), ("pixels", 0)])
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
    weights = dict.fromkeys(priors, 1.0)
    settings = TeacherSettings(batch_size=32)
    module = AdversarialTraining(small_lifter(), frames, settings, ViewSettings(), priors, weights, 0)
    module.__class__ = type("Still", (AdversarialTraining,), {"global_step": 0, "device": torch.device("cpu")})
    torch.manual_seed(1)
    module.objective()[0].backward()
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
