"""Fits with labelled frames: between the unsupervised run and the supervised twin, equal to each at its end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import QUICK, body_arrays, last_words, status_of, write_body
from lifts import H36M, bodies, labelled_frames, lift_of, seen_bodies, small_lifter

import uplift
from uplift.config.loading import load_settings
from uplift.config.settings import RefineSettings
from uplift.data.load import load_data
from uplift.data.module import KeypointData
from uplift.data.sampler import LabelledSampler
from uplift.geometry.camera import build_camera
from uplift.priors.bones import Bones
from uplift.priors.handedness import Handedness
from uplift.priors.labelled import Labelled
from uplift.training.pose_recipe import PoseRecipe
from uplift.training.pseudo_labels import lift_all, true_poses
from uplift.training.student import StudentModule


def fitted(folder: Path, *words: str, **changes) -> tuple[dict[str, torch.Tensor], str]:
    """Return the weights and the report of a quick fit."""
    folder.mkdir()
    write_body(folder / "a.npz", **changes)
    write_body(folder / "b.npz", seed=5)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert status_of("fit", "skeleton=h36m17", "data.train=a.npz", "data.test=b.npz", *QUICK, *words) == 0
    run = folder / "runs" / "h36m17" / "last"
    return torch.load(run / "lifter.pt", weights_only=True)["state"], (run / "report.md").read_text()


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def test_no_label_is_the_unsupervised_run_and_every_label_the_supervised_one(tmp_path: Path) -> None:
    plain, report = fitted(tmp_path / "plain")
    assert "from 2D keypoints alone" in report
    assert "mpjpe_gt_scale" in report
    assert "| `mpjpe` |" not in report
    unused, _ = fitted(tmp_path / "unused", "priors.labelled.weight=0")
    assert same(plain, unused)
    everything, report = fitted(tmp_path / "all", "data.labelled.fraction=1")
    assert "60 labelled frames of 60" in report
    assert "| `mpjpe` |" in report
    alone, _ = fitted(tmp_path / "alone", "data.labelled.fraction=1", "data.labelled.only=true")
    assert same(everything, alone)
    some, _ = fitted(tmp_path / "some", "data.labelled.fraction=0.2")
    assert not same(some, plain)
    assert not same(some, everything)


def test_truth_without_a_label_changes_no_bit(tmp_path: Path) -> None:
    arrays = body_arrays()
    weights, _ = fitted(tmp_path / "true", "data.labelled.subjects=S1")
    hidden = arrays["subject"] != "S1"
    changed = {name: arrays[name].copy() for name in ("pose", "root", "tilt_deg")}
    for value in changed.values():
        value[hidden] = np.random.default_rng(0).normal(0, 1e3, value[hidden].shape)
    other, _ = fitted(tmp_path / "noise", "data.labelled.subjects=S1", **changed)
    assert same(weights, other)
    changed["pose"][~hidden, 3, 2] += 50
    other, _ = fitted(tmp_path / "label", "data.labelled.subjects=S1", **changed)
    assert not same(weights, other)


def test_a_labelled_fit_predicts_in_mm_and_a_killed_one_resumes(tmp_path: Path) -> None:
    weights, _ = fitted(tmp_path / "a", "data.labelled.fraction=0.5")
    assert (weights["bone_mm"] > 50).all()
    run = tmp_path / "a" / "runs" / "h36m17" / "last"
    found = uplift.predict(run, tmp_path / "a" / "b.npz")
    assert found.unit == "mm"
    start, end = H36M.bone_indices.T
    lengths = np.linalg.norm(found.pose[:, end] - found.pose[:, start], axis=-1).sum(1)
    np.testing.assert_allclose(lengths, weights["bone_mm"].sum().item(), rtol=1e-3)


def test_labels_of_another_file_teach_frames_of_this_one(tmp_path: Path) -> None:
    weights, report = fitted(
        tmp_path / "a", "data.labelled.file=b.npz", "data.labelled.fraction=0.5", pose=None, root=None, tilt_deg=None
    )
    assert "30 labelled frames of 90" in report
    assert (weights["bone_mm"] > 50).all()


def test_rows_keep_the_ratio_and_draw_all_frames() -> None:
    labelled = torch.zeros(100, dtype=torch.bool)
    labelled[:5] = True
    drawn = torch.stack([LabelledSampler(labelled, 0.25)(40) for _ in range(200)])
    assert (labelled[drawn].sum(1) == 10).all()
    assert drawn.unique().tolist() == list(range(100))
    assert labelled[drawn[:, :10]].any(1).float().mean() < 0.999  # not all of them first
    assert labelled[LabelledSampler(labelled, None)(20_000)].float().mean() == pytest.approx(0.05, abs=0.01)
    for alike in (torch.zeros(10, dtype=torch.bool), torch.ones(10, dtype=torch.bool)):
        assert LabelledSampler(alike, 0.25)(1000).unique().tolist() == list(range(10))


def test_a_few_labelled_frames_are_not_learned_by_heart() -> None:
    labelled = torch.arange(10_000) < 10
    rows = LabelledSampler(labelled, 0.25)
    assert rows.share == pytest.approx(0.025)
    assert int(labelled[rows(400)].sum()) == 10
    assert int(labelled[rows(8)].sum()) == 1  # yet never none


def test_lift_all_puts_labels_in_place_of_what_was_lifted() -> None:
    data = seen_bodies()
    data.labelled[20:] = False
    frames = labelled_frames(data)
    poses = lift_all(small_lifter(), frames, RefineSettings(iterations=0))
    assert poses.labelled.tolist() == frames.labelled.tolist()
    truth = true_poses(frames.select(frames.labelled), build_camera("perspective"))
    torch.testing.assert_close(poses.pose[:20], truth.pose)
    torch.testing.assert_close(poses.gravity[:20], truth.gravity)
    assert truth.noise is None  # labels and keypoints agree


def test_true_poses_are_level_as_the_labels_say() -> None:
    frames = labelled_frames(seen_bodies())
    truth = true_poses(frames, build_camera("perspective"))
    torch.testing.assert_close(truth.gravity[:, 2].asin(), frames.label_tilt, atol=1e-5, rtol=0)
    torch.testing.assert_close(truth.pose.norm(dim=-1), frames.labels.norm(dim=-1), atol=1e-4, rtol=1e-4)


def test_a_joint_without_a_label_teaches_nothing() -> None:
    data = seen_bodies()
    data.pose[:, 4] = np.nan
    truth = true_poses(labelled_frames(data), build_camera("perspective"))
    assert (truth.confidence[:, 4] == 0).all()
    assert (truth.confidence[:, 5] == 1).all()
    assert truth.pose.isfinite().all()


def test_the_labelled_term_is_in_mm_and_knows_the_tilt() -> None:
    frames = labelled_frames(seen_bodies())
    lifter = small_lifter()
    lift = lift_of(lifter, frames)
    prior = Labelled(H36M, elevation=0.0)
    prior.prepare(frames)
    off_mm = ((lift.pose - lift.labels).norm(dim=-1) * lift.label_unit[:, None]).mean(1)
    torch.testing.assert_close(prior.loss(lift), off_mm / frames.label_unit.mean(), rtol=1e-4, atol=1e-5)
    assert prior.metrics(lift)["labelled_error"] == pytest.approx(off_mm.mean().item(), rel=1e-4)
    prior.elevation = 2.0
    tilt = (lift.tilt - lift.label_tilt).abs()
    torch.testing.assert_close(prior.loss(lift), off_mm / frames.label_unit.mean() + 2 * tilt, rtol=1e-4, atol=1e-5)
    prior.loss(lift).mean().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in lifter.network.parameters())


def test_bones_are_held_near_those_of_the_labels_unless_switched_off() -> None:
    frames = labelled_frames(seen_bodies())
    lift = lift_of(small_lifter(), frames)
    free, held = Bones(H36M, labels=False), Bones(H36M)
    free.prepare(frames)
    held.prepare(frames)
    assert held.loss(lift) > free.loss(lift)
    torch.testing.assert_close(held.true_share.mean(), torch.tensor(1.0))


def test_labels_have_the_last_word_on_handedness() -> None:
    frames = labelled_frames(seen_bodies())
    lift = lift_of(small_lifter(), frames)
    usual = Handedness(H36M, labels=False)
    usual.prepare(frames)
    value, known = usual.value(frames.labels, torch.zeros(40), torch.ones(40, 17))
    right = float((value > 0).float().mean()) >= 0.5
    prior = Handedness(H36M)
    if right:
        prior.prepare(frames)
    else:
        with pytest.warns(UserWarning, match="the other way round"):
            prior.prepare(frames)
    told, _ = prior.value(frames.labels, torch.zeros(40), known[:, None].expand(40, 17))
    assert float((told > 0).float().mean()) >= 0.5
    assert (float(prior.sign) == 1) == right
    assert prior.loss(lift).isfinite()


def stages(tmp_path: Path, *words: str) -> PoseRecipe:
    """Return the stages of a quick fit, not trained."""
    write_body(tmp_path / "a.npz")
    settings = load_settings(None, last_words("skeleton=h36m17", f"data.train={tmp_path / 'a.npz'}", *QUICK, *words))
    return PoseRecipe(settings, KeypointData.of(load_data(settings, H36M), H36M, settings), None)


def test_labels_take_the_place_of_the_teachers_time(tmp_path: Path) -> None:
    def steps(*words: str) -> list[int | None]:
        return [budget.steps for budget in stages(tmp_path, "trainer.max_steps=1000", *words).budgets.values()]

    assert steps() == [400, 600]
    assert steps("data.labelled.fraction=0.1") == [62, 938]  # nine tenths of a batch: 0.4 * 0.1 against 0.6
    assert steps("data.labelled.fraction=0.1", "data.labelled.share=null") == [375, 625]
    assert steps("data.labelled.fraction=1")[1] == 1000
    assert "no teacher" in stages(tmp_path, "data.labelled.fraction=1").notes[0]


def test_a_warm_round_starts_where_the_last_one_ended() -> None:
    data, last = KeypointData(bodies(40), H36M, val=None), small_lifter(seed=1)
    options = {"units": 16, "blocks": 1}

    def student(*, warm: bool, uncertainty: bool = False) -> StudentModule:
        lifter = {"options": options, "uncertainty": uncertainty, "cameras": "own", "signs": 0}
        module = StudentModule(H36M, teacher=last, lifter=lifter, seed=2, warm=warm, refine={"iterations": 0})
        module.before = {key: value.clone() for key, value in module.lifter.state_dict().items()}
        module.prepare(data)
        return module

    fresh, warm = student(warm=False), student(warm=True)
    assert same(fresh.before, dict(fresh.lifter.state_dict()))
    assert not same(dict(last.state_dict()), fresh.before)
    for lifter in (warm.lifter, warm.final):
        assert same(dict(last.state_dict()), dict(lifter.state_dict()))
    wider = student(warm=True, uncertainty=True)
    assert same(wider.before, dict(wider.lifter.state_dict()))


def test_a_fit_goes_on_from_a_run_and_keeps_its_own_labels_sizes(tmp_path: Path) -> None:
    first, _ = fitted(tmp_path / "first", "data.labelled.fraction=1")
    run = tmp_path / "first" / "runs" / "h36m17" / "last"
    arrays = body_arrays()
    larger = {name: 2 * arrays[name] for name in ("pose", "root")}
    words = ("data.labelled.fraction=1", f"init={run}", "student.learning_rate=1e-9", "student.average=null")
    second, _ = fitted(tmp_path / "second", *words, **larger)
    torch.testing.assert_close(second["bone_mm"], 2 * first["bone_mm"], rtol=1e-4, atol=1e-3)
    weights = [key for key in first if key.startswith("network") and key.endswith("weight")]
    for key in weights:
        torch.testing.assert_close(second[key], first[key], rtol=1e-3, atol=1e-4)
