"""Depth signs: chains of any skeleton, states and back, messages along clips, hypotheses, and the student that learns them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

import uplift.models.signs as signs
from uplift.config.files import shipped_names
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Orthographic, Perspective
from uplift.geometry.normalise import Intrinsics, mirror
from uplift.models.signs import SignChains, solve_signs, spread_hypotheses
from uplift.skeleton import load_skeleton

H36M = load_skeleton("h36m17")
CHAINS = SignChains(H36M)
CAMERA = Perspective()


@pytest.mark.parametrize("name", shipped_names("skeletons"))
def test_every_joint_but_the_root_ends_one_bone_and_chains_start_where_others_were(name: str) -> None:
    skeleton = load_skeleton(name)
    chains = SignChains(skeleton).chains
    ends = [child for chain in chains for _, child in chain]
    assert sorted([*ends, skeleton.root_index]) == list(range(len(skeleton.joints)))
    known = {skeleton.root_index}
    for chain in chains:
        assert chain[0][0] in known and len(chain) <= 4
        assert all(before[1] == after[0] for before, after in itertools.pairwise(chain))
        known |= {child for _, child in chain}


def test_the_human_has_two_legs_a_spine_up_to_the_head_and_two_arms() -> None:
    names = [[H36M.joints[child] for _, child in chain] for chain in CHAINS.chains]
    assert names == [
        ["rhip", "rknee", "rankle"],
        ["lhip", "lknee", "lankle"],
        ["spine", "thorax", "nose", "headtop"],
        ["lshoulder", "lelbow", "lwrist"],
        ["rshoulder", "relbow", "rwrist"],
    ]


@pytest.fixture(scope="module")
def clips() -> tuple[TrainingSet, torch.Tensor]:
    """Four clips of simulated people at 10 frames/s, seen by a known camera, and their true poses in its frame and in units."""
    data = simulate(H36M, frames=120, seed=3, clip_seconds=3.0)
    assert data.focal_px is not None and data.centre_px is not None
    assert data.pose is not None and data.root is not None
    frames = TrainingSet.of(data, H36M, count_root=False, intrinsics=Intrinsics(data.focal_px, data.centre_px))
    assert frames.rotation is not None
    unit = torch.from_numpy(np.linalg.norm(data.root, axis=1)).float() / frames.distance
    return frames, torch.from_numpy(data.pose).float() @ frames.rotation.mT / unit[:, None, None]


def certain(states: torch.Tensor, sure: float = 30.0) -> torch.Tensor:
    """Return log-odds that say these states."""
    columns = states.T
    parts = zip(columns, CHAINS.counts, strict=True)
    return torch.cat([sure * torch.nn.functional.one_hot(one, count).float() for one, count in parts], 1)


@pytest.mark.parametrize("camera", [CAMERA, Orthographic()], ids=["perspective", "orthographic"])
def test_a_pose_is_found_again_from_its_keypoints_bones_and_signs(camera) -> None:
    torch.manual_seed(0)
    pose = torch.randn(5, 17, 3) * 0.4
    pose[:, 0] = 0
    frames = one_body(pose, camera)
    far = frames.distance if camera is CAMERA else torch.full_like(frames.distance, 1e5)
    states = CHAINS.states(pose, far)
    scene, size = signs._scene_of(frames, pose, camera, CHAINS)
    lengths = (pose[:, CHAINS.bones[:, 1]] - pose[:, CHAINS.bones[:, 0]]).norm(dim=-1) * size[:, None]
    found = replace(scene, length=lengths).placed(torch.arange(5), states[:, None])[:, 0] / size[:, None, None]
    torch.testing.assert_close(found, pose, atol=2e-3, rtol=0)


def one_body(pose: torch.Tensor, camera, follows: bool = False) -> TrainingSet:
    count = len(pose)
    distance = torch.full((count,), 10.0)
    keypoints = camera.project(pose, distance)
    one = torch.zeros(count, dtype=torch.long)
    after = torch.arange(count) > 0
    return TrainingSet(
        H36M, keypoints, torch.ones(count, 17), torch.ones(count), distance, one, after & follows, one, fps=10.0
    )


def test_signs_that_are_sure_give_the_true_poses(clips) -> None:
    frames, pose = clips
    solution = solve_signs(frames, pose, certain(CHAINS.states(pose, frames.distance)), CAMERA, CHAINS)
    assert (solution.pose - pose).norm(dim=-1).mean() < 0.03  # its spine and neck are not quite of one length
    assert solution.deviation.mean() < 0.1  # no state is ruled out
    projected = CAMERA.project(solution.pose, frames.distance)
    torch.testing.assert_close(projected, CAMERA.project(pose, frames.distance), atol=1e-4, rtol=0)
    elbow, wrist = H36M.index("lelbow"), H36M.index("lwrist")
    depth = pose[..., 2].clone()
    depth[::3, wrist] = 2 * depth[::3, elbow] - depth[::3, wrist]  # a forearm that points the wrong way, now and then
    wrong = CAMERA.unproject(projected, depth, frames.distance)
    mended = solve_signs(frames, wrong, certain(CHAINS.states(pose, frames.distance)), CAMERA, CHAINS).pose
    error, before = ((one - pose)[:, wrist].norm(dim=-1).mean() for one in (mended, wrong))
    assert error < 0.5 * before


def test_neighbours_in_time_outvote_a_frame_that_errs(clips, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, pose = clips
    torch.manual_seed(1)
    true = CHAINS.states(pose, frames.distance)
    other = torch.stack([torch.randint(count, (len(true),)) for count in CHAINS.counts], 1)
    logits = certain(torch.where(torch.rand(true.shape) < 0.25, other, true), 3.0)

    def error() -> float:
        return float((solve_signs(frames, pose, logits, CAMERA, CHAINS).pose - pose).norm(dim=-1).mean())

    together = error()
    for name in ("_ACCELERATION", "_SPEED"):
        monkeypatch.setattr(signs, name, 1e6)  # any motion is as likely as any other
    assert together < 0.8 * error()


@pytest.mark.parametrize("order", [1, 2])
def test_messages_agree_with_the_sum_over_all_sequences(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signs, "_SECOND_ORDER", 8 if order == 2 else 0)
    torch.manual_seed(0)
    length, states, width = 5, 4, {1: signs._SPEED, 2: signs._ACCELERATION}[order]
    ends, likely = [0.2 * torch.randn(count, 3, 2 * length) for count in (2, states)], torch.rand(states, 2 * length)
    one = torch.zeros(2 * length, dtype=torch.long)
    frames = one_body(torch.randn(2 * length, 17, 3), CAMERA, follows=True)
    follows = frames.follows.clone()
    follows[length + 1 :: length] = follows[length - 1] = False  # runs of other lengths beside the first
    windows = signs._Windows.of(replace(frames, follows=follows, clip=one), 1)
    found = signs._marginals(ends, likely, windows, 1.0).T[: length - 1]
    length -= 1
    expected = torch.zeros(length, states, dtype=torch.float64)
    for path in itertools.product(range(states), repeat=length):
        at = torch.stack([torch.stack([ends[0][s // 2, :, t], ends[1][s, :, t]]) for t, s in enumerate(path)]).double()
        chance = torch.stack([likely[s, t] for t, s in enumerate(path)]).double().prod()
        for _ in range(order):
            at = at[1:] - at[:-1]
        chance = chance / (1 + at.square().sum(-1) / width**2).prod()
        for t, s in enumerate(path):
            expected[t, s] += chance
    np.testing.assert_allclose(found.numpy(), (expected / expected.sum(1, keepdim=True)).numpy(), atol=1e-5)


def test_turning_the_camera_and_the_order_of_clips_change_nothing(clips) -> None:
    frames, pose = clips
    torch.manual_seed(2)
    logits = torch.randn(len(pose), sum(CHAINS.counts))
    found = solve_signs(frames, pose, logits, CAMERA, CHAINS).pose
    from uplift.geometry.rotation import random_rotations

    turn = random_rotations(1)
    assert frames.rotation is not None
    other = replace(frames, rotation=frames.rotation @ turn)  # the real camera is turned as a whole
    torch.testing.assert_close(solve_signs(other, pose, logits, CAMERA, CHAINS).pose, found, atol=1e-3, rtol=0)
    order = torch.cat([torch.arange(60, len(pose)), torch.arange(60)])
    moved = solve_signs(frames.select(order), pose[order], logits[order], CAMERA, CHAINS).pose
    assert (moved - found[order]).norm(dim=-1).median() < 1e-3


def test_a_mirror_image_has_the_mirrored_answer(clips) -> None:
    frames, pose = clips
    torch.manual_seed(3)
    swap = torch.tensor(H36M.mirror_permutation)
    logits = torch.randn(len(pose), sum(CHAINS.counts))
    assert CHAINS.mirrored == [1, 0, 2, 4, 3]
    torch.testing.assert_close(
        CHAINS.states(mirror(pose, swap), frames.distance), CHAINS.states(pose, frames.distance)[:, CHAINS.mirrored]
    )
    parts = logits.split(CHAINS.counts, 1)
    mirrored = torch.cat([parts[image] for image in CHAINS.mirrored], 1)
    same = CHAINS.mean(logits, mirrored)
    torch.testing.assert_close(same, torch.cat(CHAINS.split(logits), 1))


def test_films_of_more_frames_are_solved_at_the_same_rate(clips) -> None:
    """Each frame shown five times at five times the rate has the answer of one."""
    frames, pose = clips
    torch.manual_seed(4)
    logits = torch.randn(len(pose), sum(CHAINS.counts))
    rows = torch.arange(len(pose)).repeat_interleave(5)
    follows = torch.ones(len(rows), dtype=torch.bool)
    follows[::5] = frames.follows
    fast = replace(frames.select(rows), follows=follows, fps=50.0)
    found = solve_signs(fast, pose[rows], logits[rows], CAMERA, CHAINS).pose[2::5]
    assert (found - solve_signs(frames, pose, logits, CAMERA, CHAINS).pose).norm(dim=-1).mean() < 0.02


def test_hypotheses_differ_fit_the_keypoints_and_have_probabilities(clips) -> None:
    frames, pose = clips
    torch.manual_seed(5)
    true = CHAINS.states(pose, frames.distance)
    solution = solve_signs(frames, pose, certain(true, 2.0), CAMERA, CHAINS)
    found = spread_hypotheses(solution, 5)
    assert found.pose.shape == (len(pose), 5, 17, 3)
    torch.testing.assert_close(found.weight.sum(1), torch.ones(len(pose)))
    assert (found.weight.diff(dim=1) <= 1e-6).all() and (found.weight >= 0).all()
    expected = CAMERA.project(pose, frames.distance)
    for number in range(5):
        torch.testing.assert_close(CAMERA.project(found.pose[:, number], frames.distance), expected, atol=1e-3, rtol=0)
    error = (found.pose - pose[:, None]).norm(dim=-1).mean(-1)
    assert error.min(1).values.mean() < 0.9 * (solution.pose - pose).norm(dim=-1).mean()
    assert (found.pose[:, 0] - found.pose[:, 1]).norm(dim=-1).mean(-1).median() > 0.01


def test_limbs_that_are_seen_long_are_long(clips) -> None:
    """A lifter that shortens the forearms: the keypoints of other frames show how long they are at least."""
    frames, pose = clips
    bone = [H36M.joints[child] for _, child in CHAINS.bones.tolist()].index("lwrist")
    parent, child = CHAINS.bones[bone].tolist()
    short = pose.clone()
    short[:, child, 2] = pose[:, parent, 2] + 0.5 * (pose[:, child, 2] - pose[:, parent, 2])
    scene, _ = signs._scene_of(frames, short, CAMERA, CHAINS)
    true, _ = signs._scene_of(frames, pose, CAMERA, CHAINS)
    medians = (short[:, child] - short[:, parent]).norm(dim=-1) / (pose[:, child] - pose[:, parent]).norm(dim=-1)
    ratio = scene.length[:, bone] / true.length[:, bone]
    assert (ratio - 1).abs().mean() < (medians - 1).abs().mean()
