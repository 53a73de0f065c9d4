"""Properties of limb mixing."""

from __future__ import annotations

import torch

from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton
from uplift.training.augmentation import LimbMixer

SKELETON = load_skeleton("h36m17")


def poses(frames: int = 200) -> torch.Tensor:
    return torch.from_numpy(simulate(SKELETON, frames, seed=3).pose).float() / 300


def known(frames: int = 200) -> torch.Tensor:
    return torch.ones(frames, 17)


def lengths(pose: torch.Tensor) -> torch.Tensor:
    bones = torch.as_tensor(SKELETON.bone_indices.copy())
    return (pose[:, bones[:, 1]] - pose[:, bones[:, 0]]).norm(dim=-1)


def test_without_sharing_poses_come_back():
    pose = poses()
    rows = torch.arange(200)
    mixed, sure = LimbMixer(pose, SKELETON)(rows, known(), share=0.0, limb=1.0)
    torch.testing.assert_close(mixed, pose - pose[:, :1], atol=1e-5, rtol=1e-5)
    assert (sure == 1).all()


def test_the_receiver_keeps_its_bone_lengths():
    pose = poses()
    torch.manual_seed(0)
    mixed, _ = LimbMixer(pose, SKELETON)(torch.arange(200), known(), share=1.0, limb=0.5)
    torch.testing.assert_close(lengths(mixed), lengths(pose), atol=1e-4, rtol=1e-4)
    assert (mixed - pose + pose[:, :1]).abs().amax((1, 2)).gt(0.05).float().mean() > 0.9


def test_stretching_keeps_directions_and_symmetry_and_short_bones_vary_more():
    pose = poses()
    torch.manual_seed(0)
    mixed, _ = LimbMixer(pose, SKELETON)(torch.arange(200), known(), share=0.0, limb=0.0, stretch=0.05)
    factor = (lengths(mixed) / lengths(pose)).log()
    start, end = torch.as_tensor(SKELETON.bone_indices.copy()).T
    directions = [(one[:, end] - one[:, start]) / lengths(one)[..., None] for one in (mixed, pose)]
    torch.testing.assert_close(*directions, atol=1e-3, rtol=0)
    torch.testing.assert_close(factor, factor[:, list(SKELETON.bone_mirror_permutation)], atol=1e-3, rtol=0)
    spread = {
        SKELETON.joints[child]: float(factor[:, bone].std()) for bone, (_, child) in enumerate(SKELETON.bone_indices)
    }
    short, long = spread["rhip"], spread["rknee"]
    assert 0.04 < long < 0.09 < short < 0.2


def test_mixing_turns_with_the_body():
    """Turning every pose turns every mixed pose: a limb keeps its angles to the body it hangs on."""
    pose = poses()
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)))[0]
    turn = turn * torch.linalg.det(turn)
    rows = torch.arange(200)
    mixed = []
    for given in (pose, pose @ turn.T):
        mixer = LimbMixer(given, SKELETON)
        torch.manual_seed(5)
        mixed.append(mixer(rows, known(), share=1.0, limb=0.5)[0])
    difference = (mixed[0] @ turn.T - mixed[1]).norm(dim=-1)
    assert difference.median() < 1e-3


def test_a_limb_that_was_not_seen_is_not_known_on_its_new_body():
    pose = poses()
    seen = known()
    wrist = SKELETON.index("lwrist")
    seen[100:, wrist] = 0
    torch.manual_seed(0)
    _, sure = LimbMixer(pose, SKELETON)(torch.arange(100), seen[:100], share=1.0, limb=1.0)
    assert (sure == 1).all()
    torch.manual_seed(0)
    _, sure = LimbMixer(pose, SKELETON)(torch.arange(200), seen, share=1.0, limb=1.0)
    assert (sure[100:, wrist] == 0).all()
    assert (sure[:100, wrist] == 0).any()


def test_closed_loops_and_chains_without_branches_do_not_break():
    for name in ("rat23", "chair10", "hand21"):
        skeleton = load_skeleton(name)
        pose = torch.from_numpy(simulate(skeleton, 50, seed=0).pose).float()
        sure = torch.ones(50, len(skeleton.joints))
        mixed, _ = LimbMixer(pose, skeleton)(torch.arange(50), sure, share=1.0, limb=0.5)
        assert mixed.isfinite().all()
