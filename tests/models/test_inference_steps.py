"""The steps of inference one by one, against what they say they do: SciPy, loops, and lifters that say one thing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, bodies, seen_bodies, small_lifter
from scipy.spatial.transform import Rotation

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.data.confidence import calibrated
from uplift.data.poses import PoseData
from uplift.data.tensors import intrinsics_of, to_training_set
from uplift.geometry.camera import Perspective
from uplift.models import predict
from uplift.models.metric_scale import KnownLength
from uplift.models.predict import (
    as_measured,
    gap_joints,
    infer,
    interpolate_gaps,
    lift_frames,
    mm_per_pixel,
    refine_lifted,
    to_level,
    with_constant_bones,
)

SETTINGS = LifterSettings(confidence="given")  # the bodies of a film here jump from frame to frame
BODY = np.repeat([0, 1], 20)


def film(**changes) -> PoseData:
    """Return two clips of twenty frames seen by a known camera."""
    identity = {"sequence": np.repeat(["a", "b"], 20), "frame": np.tile(np.arange(20), 2)}
    return replace(seen_bodies(), identity=identity, labelled=None, tilt_deg=None, **changes)


def test_gravity_is_that_of_a_camera_without_roll_that_looks_down_as_the_lifter_says() -> None:
    data, lifter = film(), small_lifter(tilt="learned", uncertainty=True)
    with torch.no_grad():
        lifter.common_tilt.fill_(0.25)
    found = infer(lifter, data, SETTINGS, refine=False)
    frames = to_training_set(data, H36M, SETTINGS)
    assert not found.gravity[:, 0].any()
    torch.testing.assert_close(found.gravity.norm(dim=-1), torch.ones(40))
    seen = torch.einsum("fij,fj->fi", frames.rotation, found.gravity)  # by the camera that looks at the root
    torch.testing.assert_close(seen[:, 2], torch.full((40,), 0.25).sin(), atol=1e-5, rtol=0)
    lifted = lift_frames(lifter, frames)
    torch.testing.assert_close(found.uncertainty, lifted.uncertainty * frames.scale[:, None])
    assert found.mm_per_px is None
    lifter.bone_mm.fill_(200.0)
    mm = infer(lifter, data, SETTINGS, refine=False)
    start, end = H36M.bone_indices.T
    lengths = (mm.pose[:, end] - mm.pose[:, start]).norm(dim=-1) * mm.mm_per_px[:, None]
    torch.testing.assert_close(lengths.sum(1), torch.full((40,), 200.0 * 16), rtol=1e-4, atol=0)


def test_frames_are_lifted_in_parts_and_both_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    frames, lifter = to_training_set(film(), H36M, SETTINGS), small_lifter()
    given = (frames.keypoints, frames.confidence, frames.distance)
    whole, once = lifter.lift_both_ways(*given), lifter(*given)
    monkeypatch.setattr(predict, "_CHUNK", 7)
    torch.testing.assert_close(lift_frames(lifter, frames).pose, whole.pose)
    torch.testing.assert_close(lift_frames(lifter, frames, both_ways=False).pose, once.pose)
    assert not lift_frames(lifter, frames).pose.requires_grad


def test_refined_frames_of_a_clip_have_one_tilt_of_the_real_camera() -> None:
    frames = to_training_set(film(), H36M, SETTINGS)
    lifted = lift_frames(small_lifter(uncertainty=True), frames)
    found = refine_lifted(lifted, frames, Perspective(), RefineSettings(iterations=2))
    torch.testing.assert_close(found.keypoints, Perspective().project(found.pose, frames.distance))
    assert torch.equal(found.uncertainty, lifted.uncertainty)
    # Of all tilts t of a camera without roll, the one whose gravity (0, cos t, sin t) is seen at this depth.
    candidates = torch.linspace(-1.4, 1.4, 28001, dtype=torch.float64)
    down = torch.stack([candidates.cos(), candidates.sin()], -1)

    def real(tilt: torch.Tensor) -> torch.Tensor:
        depth = down @ frames.rotation[:, 2, 1:].double().T
        return candidates[(depth - tilt.double().sin()).abs().argmin(0)]

    before, after = real(lifted.tilt), real(found.tilt)
    for clip in (slice(0, 20), slice(20, 40)):
        middle = before[clip].sort().values[9:11]
        assert after[clip].max() - after[clip].min() < 3e-4
        assert middle[0] - 3e-4 <= after[clip].mean() <= middle[1] + 3e-4


def test_what_is_measured_from_a_stand_in_is_moved_to_it() -> None:
    frames = to_training_set(bodies(6), H36M, SETTINGS)
    confidence = frames.confidence.clone()
    confidence[3:, H36M.root_index], confidence[:, 5] = 0, 0
    shift = torch.tensor([0.3, -0.2])
    lifted = frames.keypoints + shift
    lifted[:, 5] += 7  # missing: does not count
    found = as_measured(replace(frames, confidence=confidence), lifted)
    assert torch.equal(found[:3], lifted[:3])
    torch.testing.assert_close(found[3:], lifted[3:] - shift)


def test_gaps_are_what_a_neighbour_in_time_shows() -> None:
    data = film()
    seen = np.random.default_rng(0).random((40, 17)) > 0.5
    seen[7] = False
    data = replace(data, confidence=seen.astype(np.float32))
    found = gap_joints(to_training_set(data, H36M, SETTINGS)).numpy()
    for row in range(40):
        near = [other for other in (row - 1, row + 1) if 0 <= other < 40 and (other < 20) == (row < 20)]
        expected = ~seen[row] & np.any([seen[other] for other in near], 0) & seen[row].any()
        assert np.array_equal(found[row], expected), row


@pytest.mark.parametrize("known", [True, False])
def test_a_gap_is_filled_where_the_lifted_joint_is_in_the_image_with_the_usual_confidence(known: bool) -> None:
    data, settings = film(), LifterSettings(intrinsics="auto" if known else "off")
    confidence = np.random.default_rng(0).choice(np.float32([0.2, 0.3, 0.9]), (40, 17), p=[0.2, 0.5, 0.3])
    confidence[5, 3], confidence[30, 13], confidence[30, 2] = 0, 0, 0
    confidence[[29, 31], 2] = 0  # in frame 30 no neighbour shows it
    data = replace(data, confidence=confidence)
    frames, camera = to_training_set(data, H36M, settings), intrinsics_of(data, settings)
    lifted = lift_frames(small_lifter(), frames)
    pixels = torch.from_numpy(data.keypoints)
    found, trust = (part.numpy() for part in interpolate_gaps(frames, pixels, lifted.keypoints, camera))
    gaps = np.argwhere((found != data.keypoints).any(-1) | (trust != confidence)).tolist()
    assert gaps == [[5, 3], [29, 2], [30, 13], [31, 2]]
    for row, joint in ([5, 3], [30, 13]):
        point = lifted.keypoints[row, joint].double().numpy()
        if known:
            ray = frames.rotation[row].double().numpy().T @ [*(point / float(frames.distance[row])), 1]
            expected = ray[:2] / ray[2] * 1145 + 500
        else:
            expected = data.keypoints[row, H36M.root_index] + point * float(frames.scale[row])
        np.testing.assert_allclose(found[row, joint], expected, atol=0.01)
        assert trust[row, joint] == np.float32(0.3)


def test_bones_become_their_medians_and_keep_their_sum_and_steady_bodies_stay() -> None:
    pose = seen_bodies().pose.astype(np.float64)
    start, end = H36M.bone_indices.T
    lengths = np.linalg.norm(pose[:, end] - pose[:, start], axis=-1)
    shares = lengths / lengths.sum(1, keepdims=True)
    scale = np.random.default_rng(0).uniform(0.5, 2, (40, 1, 1))
    noisy = (pose * scale * np.random.default_rng(1).uniform(0.97, 1.03, (40, 17, 1))).astype(np.float32)
    found = with_constant_bones(noisy, H36M, BODY)
    before, after = (np.linalg.norm(x[:, end] - x[:, start], axis=-1) for x in (noisy, found))
    np.testing.assert_allclose(after.sum(1), before.sum(1), rtol=1e-5)
    for body in (0, 1):
        expected = np.median(before[body == BODY] / before[body == BODY].sum(1, keepdims=True), axis=0)
        np.testing.assert_allclose(
            (after / after.sum(1, keepdims=True))[body == BODY], [expected / expected.sum()] * 20, atol=1e-5
        )
    assert not found[:, H36M.root_index].any() and found.dtype == np.float32
    moved = np.linalg.norm(found - noisy, axis=-1).mean(1) / before.sum(1)
    assert moved.max() < 0.01
    assert np.ptp(shares, axis=0).max() < 1e-5
    steady = with_constant_bones((pose * scale).astype(np.float32), H36M, BODY)
    np.testing.assert_allclose(steady, pose * scale, atol=0.01)


def test_bodies_are_subjects_and_instances_else_clips_else_one() -> None:
    data = film()
    assert data.bodies().tolist() == BODY.tolist()
    named = replace(
        data, identity={**data.identity, "subject": np.tile(["x", "y"], 20), "instance": np.repeat([0, 1], 20)}
    )
    assert len(set(named.bodies())) == 4
    assert replace(named, identity={"subject": named.identity["subject"]}).bodies().tolist() == [0, 1] * 20
    assert not replace(data, identity={}).bodies().any()
    assert len(data.select(slice(0, 0)).bodies()) == 0


def test_the_scale_is_that_of_the_size_given_then_the_skeletons_then_the_labels() -> None:
    data, pose = film(), seen_bodies().pose
    inferred = replace(infer(small_lifter(), data, SETTINGS, refine=False), mm_per_px=torch.full((40,), 3.0))
    given = KnownLength(("rhip", "rknee"), 400.0)
    found = mm_per_pixel(inferred, pose, data, H36M, BODY, given)
    thighs = [np.linalg.norm(pose[0, H36M.index(f"{s}hip")] - pose[0, H36M.index(f"{s}knee")]) for s in "lr"]
    np.testing.assert_allclose(found, 400 / np.mean(thighs), rtol=1e-4)
    np.testing.assert_allclose(mm_per_pixel(inferred, pose, data, H36M, BODY, None), 3.0)
    assert mm_per_pixel(replace(inferred, mm_per_px=None), pose, data, H36M, BODY, None) is None


def test_level_poses_are_turned_the_least_way_that_brings_gravity_down() -> None:
    rng = np.random.default_rng(0)
    pose = rng.normal(size=(10, 17, 3)).astype(np.float32)
    gravity = rng.normal(size=(10, 3)) + [0, 2, 0]
    gravity /= np.linalg.norm(gravity, axis=-1, keepdims=True)
    axis = np.cross(gravity, [0, 1, 0])
    turn = axis / np.linalg.norm(axis, axis=-1, keepdims=True) * np.arccos(gravity[:, 1:2])
    expected = [Rotation.from_rotvec(one).apply(points) for one, points in zip(turn, pose, strict=True)]
    np.testing.assert_allclose(to_level(pose, torch.from_numpy(gravity).float()), expected, atol=1e-5)


# A lifter of any cameras.

ANY = LifterSettings(cameras="any")


def any_lifter():
    """Return a lifter that says one gravity, and that guessed distances are 1.5 times too near."""
    lifter = small_lifter(cameras="any")
    first = len(H36M.joints) * 3
    with torch.no_grad():
        for parameter in lifter.network.leave.parameters():
            parameter[first:] = 0
        lifter.network.leave.bias[first:] = torch.tensor([np.log(1.5), 0.3, 0.2, -0.4])
    return lifter


def test_an_unknown_focal_length_is_the_longest_side_of_the_image_and_the_distance_a_guess() -> None:
    known, unknown = film(image_size=(1920, 1080)), film(image_size=(1920, 1080), focal_px=None)
    guess = replace(unknown, focal_px=1920.0)
    for given, same, guessed in ((known, known, False), (unknown, guess, True)):
        found, expected = to_training_set(given, H36M, ANY), to_training_set(same, H36M, SETTINGS)
        assert all(torch.equal(getattr(found, key), getattr(expected, key)) for key in ("distance", "rotation"))
        assert (found.guessed == guessed).all() and expected.guessed is None
    for data in (film(focal_px=None, image_size=None), unknown):  # as before where nothing is known
        found = to_training_set(data, H36M, ANY if data.image_size is None else SETTINGS)
        assert found.rotation is None and (found.distance == 10).all()


def test_the_gravity_of_any_camera_is_one_for_each_clip_with_its_roll() -> None:
    data, lifter = film(focal_px=None), any_lifter()
    frames = to_training_set(calibrated(data, H36M, ANY), H36M, ANY)
    lifted = lift_frames(lifter, frames)
    said = lifter(frames.keypoints, frames.confidence, frames.distance, frames.guessed).gravity
    torch.testing.assert_close(said, torch.tensor([[0.3, 1.2, -0.4]]).expand(40, 3))
    # With the mirror image of it, nothing is left of the roll in the frame of the camera that looks at the root.
    torch.testing.assert_close(lifted.gravity, torch.tensor([[0.0, 1.2, -0.4]]).expand(40, 3), atol=1e-6, rtol=0)
    real = torch.einsum("fji,fj->fi", frames.rotation, lifted.gravity)
    single = infer(lifter, data, ANY, refine=False)
    torch.testing.assert_close(single.gravity, real / real.norm(dim=-1, keepdim=True))
    refined = infer(lifter, data, ANY, refine=True).gravity
    for clip in (slice(0, 20), slice(20, 40)):
        torch.testing.assert_close(refined[clip], refined[clip][:1].expand(20, 3))
        off = (refined[clip][0] - single.gravity[clip]).norm(dim=-1)
        spread = (single.gravity[clip][:, None] - single.gravity[clip]).norm(dim=-1).sum(0)
        assert off.sum() <= spread.min() * 1.01, "no frame is nearer to all others"


def test_a_guessed_distance_is_corrected_and_a_known_one_stays() -> None:
    lifter = any_lifter()
    for data, factor in ((film(), 1.0), (film(focal_px=None), 1.5)):
        frames = to_training_set(data, H36M, ANY)
        lifted = lift_frames(lifter, frames)
        torch.testing.assert_close(lifted.distance, frames.distance * factor)
        projected = Perspective().project(lifted.pose, frames.distance * factor)
        torch.testing.assert_close(projected, lifted.keypoints, atol=1e-5, rtol=1e-5)
        refined = refine_lifted(lifted, frames, Perspective(), RefineSettings(iterations=1))
        torch.testing.assert_close(refined.distance, frames.distance * factor)
