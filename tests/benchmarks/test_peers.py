"""The published recipes of the accuracy benchmark, the supervised twin, the baselines."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import body_arrays, status_of
from lifts import H36M, bodies, lift_of_pose, training_set, true_pose

from uplift.config.loading import load_settings
from uplift.config.plugins import find_class
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.models.lifter import Lifter
from uplift.models.model import load

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.accuracy import floors, twin  # noqa: E402

pytestmark = pytest.mark.usefixtures("trusting")

PEERS = ROOT / "benchmarks" / "accuracy" / "peers"
TASKS = ("elepose", "links")


def peer(name: str, file: str) -> type:
    """Return the class ``name`` of a peer's file."""
    return find_class(f"{PEERS / file}.py:{name}", {}, "peers")


def test_bone_ratios_are_0_for_a_body_of_those_ratios_at_any_size():
    pose = true_pose(bodies(6))
    ends = torch.from_numpy(H36M.bone_indices.copy())
    lengths = (pose[:, ends[:, 1]] - pose[:, ends[:, 0]]).norm(dim=-1)[0]
    ratios = {child: float(r) for (_, child), r in zip(H36M.bones, lengths / lengths.mean(), strict=True)}
    prior = peer("BoneRatios", "bone_ratios")(H36M, ratios=ratios)
    assert float(prior.loss(lift_of_pose(pose * 1.7)).max()) < 1e-6
    longer = prior.loss(lift_of_pose(pose * torch.tensor([1.0, 1.0, 3.0])))
    assert float(longer.min()) > 1e-3
    with pytest.raises(UserError, match="expected one for each"):
        peer("BoneRatios", "bone_ratios")(H36M, ratios={"rhip": 1.0})


@pytest.mark.parametrize("confident", [False, True])
def test_gradients_reach_every_network_of_the_halves_and_no_half_sees_the_other(confident):
    settings = load_settings(str(PEERS / "links.yaml"), ["lifter.options.units=8", "lifter.options.blocks=1"])
    chosen = replace(settings.lifter, confidence_input=confident)
    lifter = Lifter(H36M, chosen)
    data = training_set(8)
    keypoints = data.keypoints.clone().requires_grad_()
    lifted = lifter(keypoints, data.confidence, data.distance)
    assert lifted.pose.shape == (8, 17, 3) and lifted.tilt.shape == (8,)
    (lifted.pose[..., 2].square().sum() + lifted.tilt.sum()).backward()
    for name, parameter in lifter.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name
    for part in settings.lifter.options["parts"]:
        # A joint that only this part has: its depth depends on the part's keypoints and the root's own depth.
        others = {name for rest in settings.lifter.options["parts"] if rest is not part for name in rest}
        own = next(H36M.index(name) for name in part if name not in others)
        depth = lifter.network(torch.cat([data.keypoints.flatten(1)] + [data.confidence] * confident, 1))[:, own]
        moved = data.keypoints.clone()
        moved[:, [H36M.index(name) for name in others - set(part)]] += 1.0
        again = lifter.network(torch.cat([moved.flatten(1)] + [data.confidence] * confident, 1))[:, own]
        torch.testing.assert_close(again, depth)


def test_halves_reject_what_does_not_fit():
    halves = peer("Halves", "halves")
    with pytest.raises(UserError, match="tail"):
        halves(6, 4, joints=["a", "b", "c"], parts=[["a", "tail"], ["b", "c"]])
    with pytest.raises(UserError, match="leave out"):
        halves(6, 4, joints=["a", "b", "c"], parts=[["a"], ["b"]])
    with pytest.raises(UserError, match="fill"):
        halves(6, 10, joints=["a", "b", "c"], parts=[["a", "b"], ["c"]])


@pytest.mark.parametrize("task", TASKS)
def test_a_peers_task_trains_from_any_folder(task, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    flows = [name for name in load_settings(str(PEERS / f"{task}.yaml")).priors if name.startswith("flow")]
    small = [word for name in flows for word in (f"priors.{name}.steps=3", f"priors.{name}.units=8")]
    status = status_of(
        "fit", f"task={PEERS / task}.yaml", f"trust={PEERS / 'bone_ratios.py'},{PEERS / 'halves.py'}", "data.train=null", "data.test=null", "data.simulate=300",
        "lifter.options.units=8", "lifter.options.blocks=1", "teacher.batch_size=16", *small,
        "trainer.max_time=null", "trainer.max_steps=4", "trainer.log_every=1", "trainer.threads=1",
    )  # fmt: skip
    assert status == 0, capsys.readouterr().err
    run = tmp_path / "runs" / task / "last"
    text = (run / "metrics.csv").read_text()
    assert all(f",{name}," in text for name in (*flows, "consistency", "pairwise", "bone_ratios"))
    assert np.isfinite(json.loads((run / "evaluation.json").read_text())["overall"]["p_mpjpe"])


@pytest.mark.parametrize("skeleton", ["h36m17", "hand21"])
def test_a_twin_trains_on_simulated_truth(skeleton, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [
        f"skeleton={skeleton}", "data.simulate=300", "lifter.options.units=16", "lifter.options.blocks=1",
        "student.batch_size=32", "trainer.max_time=null", "trainer.max_steps=6", "trainer.threads=1",
    ]  # fmt: skip
    assert twin.main(words) == 0
    run = tmp_path / "runs" / "own_twin" / "last"
    assert np.isfinite(json.loads((run / "evaluation.json").read_text())["overall"]["p_mpjpe"])
    assert load(run).skeleton.name == skeleton


@pytest.mark.parametrize("intrinsics", ["auto", "off"])
def test_a_twins_poses_are_the_upright_truth(intrinsics):
    data = simulate(H36M, 60, seed=3)
    settings = load_settings(None, [f"lifter.intrinsics={intrinsics}"])
    poses, note = twin.true_poses(settings, H36M, data)
    assert "tilts" in note and data.pose is not None and data.tilt_deg is not None
    ends = torch.from_numpy(H36M.bone_indices.copy())

    def shape(pose):
        lengths = (pose[:, ends[:, 1]] - pose[:, ends[:, 0]]).norm(dim=-1)
        return lengths / lengths.mean(1, keepdim=True)

    true = torch.from_numpy(data.pose)
    assert (shape(poses.pose) - shape(true)).abs().max() < (1e-3 if intrinsics == "auto" else 0.3)
    height = torch.from_numpy(np.radians(data.tilt_deg)).to(true)
    down = torch.stack([torch.zeros_like(height), height.cos(), height.sin()], -1)
    upright = (true * down[:, None]).sum(-1)  # each joint's height in the real camera's frame
    upright = upright / upright.abs().mean(1, keepdim=True)
    found = poses.pose[..., 1] / poses.pose[..., 1].abs().mean(1, keepdim=True)
    assert (found - upright).abs().max() < (2e-3 if intrinsics == "auto" else 1.0)


def test_gravity_is_found_from_simultaneous_views_without_roll():
    data = simulate(H36M, 30, seed=5)
    assert data.pose is not None and data.tilt_deg is not None
    rng = np.random.default_rng(0)
    tilt, azimuth = np.radians(rng.uniform(-10, 40, (3, 30))), rng.uniform(0, 2 * np.pi, (3, 30))
    cos, sin, zero = np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)
    about_y = np.stack([cos, zero, sin, zero, zero + 1, zero, -sin, zero, cos], -1).reshape(3, 30, 3, 3)
    cos, sin = np.cos(tilt), np.sin(tilt)
    about_x = np.stack([zero + 1, zero, zero, zero, cos, -sin, zero, sin, cos], -1).reshape(3, 30, 3, 3)
    views = (about_x @ about_y).reshape(-1, 3, 3)
    pose = np.tile(data.pose, (3, 1, 1)) @ views.transpose(0, 2, 1)
    moments = np.tile(np.arange(30), 3)
    seen = replace(data.select(moments), pose=pose.astype(np.float32), tilt_deg=None, identity={"frame": moments})
    gravity, note = twin.gravity_in_camera(seen, H36M)
    assert "several sides" in note
    np.testing.assert_allclose(gravity, views[:, :, 1], atol=1e-3)  # y of the world, in each camera
    alone = replace(seen, identity={"frame": np.arange(90)})
    assert twin.gravity_in_camera(alone, H36M)[1] == "unknown, cameras assumed level"


def test_a_twin_takes_the_poses_of_detected_keypoints_from_the_exact_file(tmp_path):
    arrays = body_arrays()
    np.savez(tmp_path / "train.npz", **arrays)
    noisy = {k: v for k, v in arrays.items() if k not in ("pose", "root", "tilt_deg")}
    np.savez(tmp_path / "train_detected.npz", **(noisy | {"keypoints": noisy["keypoints"] + 1.0}))
    words = ["skeleton=h36m17", f"data.train={tmp_path / 'train_detected.npz'}"]
    found = twin.load_labelled(load_settings(None, words), H36M).train
    np.testing.assert_array_equal(found.pose, arrays["pose"])
    np.testing.assert_allclose(found.keypoints, arrays["keypoints"] + 1.0, atol=1e-3)
    np.savez(tmp_path / "train.npz", **{k: v[::-1] if np.ndim(v) and len(v) == 60 else v for k, v in arrays.items()})
    with pytest.raises(UserError, match="are not those"):
        twin.load_labelled(load_settings(None, words), H36M)


def test_the_nearest_neighbour_of_a_training_frame_is_itself(tmp_path, capsys):
    train, out = tmp_path / "train.npz", tmp_path / "out.npz"
    np.savez(train, **body_arrays())
    assert floors.main(["nearest", str(train), str(train), str(out), "skeleton=h36m17"]) == 0
    np.testing.assert_allclose(np.load(out)["pose"], body_arrays()["pose"], atol=1e-3)
    assert status_of("evaluate", f"poses={out}", f"data.test={train}", "skeleton=h36m17") == 0
    assert floors.main(["flat", str(train), str(train), str(out), "skeleton=h36m17"]) == 0
    assert np.all(np.load(out)["pose"][..., 2] == 0)
    assert status_of("evaluate", f"poses={out}", f"data.test={train}", "skeleton=h36m17") == 0
    assert floors.main(["nearest", str(out), str(train), str(out), "skeleton=h36m17"]) == 2
    assert "keypoints" in capsys.readouterr().err


def test_the_nearest_neighbour_uses_the_visible_joints():
    torch.manual_seed(0)
    known, wanted = torch.randn(50, 5, 2), torch.randn(20, 5, 2)
    visible = torch.rand(20, 5) < 0.7
    apart = ((wanted[:, None] - known[None]).square().sum(-1) * visible[:, None]).sum(-1)
    assert torch.equal(floors.nearest_rows(wanted, visible, known), apart.argmin(1))
    everything = torch.ones_like(visible)
    assert torch.equal(
        floors.nearest_rows(wanted, everything, known), torch.cdist(wanted.flatten(1), known.flatten(1)).argmin(1)
    )
