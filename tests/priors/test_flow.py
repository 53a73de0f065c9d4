"""The flow prior, the gaps it fills, and pairwise deformation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from lifts import H36M, bodies, doubles, lift_of, lift_of_pose, small_lifter, training_set, true_pose
from torch.func import jacrev, vmap

from uplift.geometry.rotation import turn
from uplift.models.lifter import Lifted
from uplift.models.networks import CouplingFlow
from uplift.priors.flow import Flow
from uplift.priors.imputation import impute_gaussian
from uplift.priors.pairwise import Pairwise


def crooked_flow(size: int):
    """Return a flow whose blocks are far from the identity."""
    torch.manual_seed(1)
    flow = CouplingFlow(size, blocks=3, units=8)
    for parameter in flow.parameters():
        torch.nn.init.normal_(parameter, std=0.6)
    return flow


@pytest.mark.parametrize("size", [2, 7, 26])
def test_a_flow_goes_there_and_back(size):
    with doubles():
        flow, x = crooked_flow(size), torch.randn(5, size)
        z, _ = flow(x)
        assert (z - x).abs().max() > 0.1
        torch.testing.assert_close(flow.inverse(z), x)


@pytest.mark.parametrize("size", [2, 7])
def test_a_flows_volume_is_that_of_its_jacobian(size):
    with doubles():
        flow, x = crooked_flow(size), torch.randn(4, size)
        jacobian = vmap(jacrev(lambda one: flow(one[None])[0][0]))(x)
        torch.testing.assert_close(flow(x)[1], torch.linalg.slogdet(jacobian).logabsdet)


def test_a_fitted_flow_is_less_surprised_at_real_keypoints_than_at_others():
    data = training_set(200)
    prior = Flow(H36M, axes=10, units=16, steps=150, batch_size=64)
    prior.prepare(data)
    real = lift_of(small_lifter(), data)
    others = replace(real, pose=real.pose * torch.tensor([1.0, 1.0, 4.0]))
    assert prior.usual.isfinite()
    assert prior.loss(real).isfinite().all()
    assert not any(parameter.requires_grad for parameter in prior.parameters())
    flat = (data.keypoints[:, prior.places].flatten(1) - prior.mean) @ prior.whiten
    assert (prior.flow.surprise(flat) - prior.usual).mean() < prior.loss(others).mean()


def test_a_view_far_from_all_data_costs_no_more_than_a_logarithm():
    """Squares of a steep flow would outweigh every other view and every other prior."""
    data = training_set(200)
    prior = Flow(H36M, axes=10, units=16, steps=150, batch_size=64)
    prior.prepare(data)
    near = prior.loss(lift_of(small_lifter(), data)).max()
    far = prior.loss(
        replace(lift_of(small_lifter(), data), renormalise_views=False, pose=torch.randn(200, 17, 3) * 1e3)
    )
    assert far.isfinite().all()
    assert near < far.min() < far.max() < 500


def test_a_flow_looks_at_its_own_joints_only():
    data = training_set(60)
    prior = Flow(H36M, joints=["lknee", "hip", "lankle"], steps=2, units=8)
    prior.prepare(data)
    lift = lift_of(small_lifter(), data, renormalise=False)  # the radius of a view runs over all joints
    lift.pose.retain_grad()
    prior.loss(lift).sum().backward()
    assert lift.pose.grad is not None
    moved = {H36M.joints[j] for j in lift.pose.grad.abs().sum((0, 2)).nonzero()[:, 0].tolist()}
    assert moved == {"lknee", "lankle"}


def perfect(lift):
    """Return the lift whose turned views are lifted back to exactly what they were seen of."""
    lift.__dict__["relifted"] = Lifted(
        lift.rotated / lift.reprojected_scale[:, None, None], lift.tilt, lift.reprojected
    )
    return lift


def test_pairwise_deformation_is_0_for_a_perfect_lifter():
    with doubles():
        lift = perfect(lift_of_pose(true_pose(bodies(9))))
        pairwise = Pairwise(H36M)
        assert float(pairwise.loss(lift)) < 1e-5
        bent = lift.relifted.pose.clone()
        bent[0, 3] += 0.5
        lift = perfect(lift_of_pose(true_pose(bodies(9))))
        lift.__dict__["relifted"] = replace(lift.relifted, pose=bent)
        expected = 0.5 * 3**0.5 * float(lift.reprojected_scale[0]) / 4  # one of four pairs
        assert float(pairwise.loss(lift)) == pytest.approx(expected, abs=1e-5)


def test_what_a_pair_has_in_common_is_no_deformation():
    with doubles():
        lift = perfect(lift_of_pose(true_pose(bodies(2))))
        shared = turn(torch.randn(1, 17, 3).expand(2, -1, -1), lift.view)
        shared = shared - shared[:, H36M.root_index, None]
        moved = lift.relifted.pose + shared / lift.reprojected_scale[:, None, None]
        lift.__dict__["relifted"] = replace(lift.relifted, pose=moved)
        assert float(Pairwise(H36M).loss(lift)) < 1e-5


def test_gaps_are_filled_with_what_the_seen_joints_leave_open():
    """Two joints that move together: the missing one is found from the other, with the spread it has."""
    torch.manual_seed(0)
    first = torch.randn(4000, 1, 2)
    second = 2 * first + 0.1 * torch.randn(4000, 1, 2)
    keypoints = torch.cat([torch.zeros(4000, 1, 2), first, second], 1)
    confidence = torch.ones(4000, 3)
    confidence[:2000, 2] = 0
    filled = impute_gaussian(keypoints * (confidence > 0).unsqueeze(-1), confidence)
    assert torch.equal(filled[confidence > 0], keypoints[confidence > 0])
    off = (filled - 2 * first)[:2000, 2]
    assert off.mean().abs() < 0.02
    assert off.std() == pytest.approx(0.1, abs=0.04)
    assert torch.equal(impute_gaussian(keypoints, torch.ones(4000, 3)), keypoints)


def test_a_flow_is_fitted_to_frames_with_gaps():
    data = training_set(80, missing=0.3)
    prior = Flow(H36M, axes=10, units=8, steps=5, batch_size=32)
    prior.prepare(data)
    assert prior.loss(lift_of(small_lifter(), data)).isfinite().all()


def test_a_flow_that_was_fitted_before_is_the_same_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit by bit, and so are the random numbers that come next; other data, options or damage make it fit anew."""
    monkeypatch.setenv("UPLIFT_CACHE", str(tmp_path))
    fits: list[int] = []
    fit = Flow._fit
    monkeypatch.setattr(Flow, "_fit", lambda self, real: (fits.append(len(real)), fit(self, real)))

    def fitted(frames: int = 60, **options: Any) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        data = training_set(frames)
        torch.manual_seed(7)
        prior = Flow(H36M, axes=10, units=8, batch_size=32, **{"steps": 5, **options})
        prior.prepare(data)
        assert not any(parameter.requires_grad for parameter in prior.parameters())
        return dict(prior.state_dict()), torch.rand(3)

    first, again = fitted(), fitted()
    assert len(fits) == 1
    torch.testing.assert_close(first, again, rtol=0, atol=0)
    for other in ({"frames": 61}, {"noise": 0.06}, {"steps": 6}):
        fitted(**other)
    assert len(fits) == 4
    for kept in (tmp_path / "flows").iterdir():
        content = bytearray(kept.read_bytes())
        content[-100] ^= 1
        kept.write_bytes(content)
    torch.testing.assert_close(fitted(), first, rtol=0, atol=0)
    assert len(fits) == 5
