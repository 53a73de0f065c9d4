"""Labels in the model's units: they agree with their keypoints, stay in mm, and join other files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import refusal, write_body
from lifts import H36M, bodies, labelled_frames, seen_bodies

from uplift.config.loading import load_settings
from uplift.config.settings import LifterSettings
from uplift.data.load import load_data
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, mean_bones, to_training_set, with_labels
from uplift.geometry.camera import build_camera
from uplift.training.pseudo_labels import true_poses


def test_a_label_projects_to_its_keypoints() -> None:
    frames = labelled_frames(seen_bodies())
    projected = build_camera("perspective").project(frames.labels, frames.distance)
    torch.testing.assert_close(projected, frames.keypoints, atol=2e-4, rtol=0)


def test_a_label_in_its_own_unit_is_the_pose() -> None:
    data = seen_bodies()
    frames = labelled_frames(data)
    lengths = (frames.labels * frames.label_unit[:, None, None]).norm(dim=-1)
    torch.testing.assert_close(lengths, torch.from_numpy(data.pose).norm(dim=-1), rtol=1e-4, atol=1e-2)


def test_without_a_known_camera_the_label_has_the_scale_of_its_keypoints() -> None:
    frames = labelled_frames(seen_bodies(), intrinsics="off")
    assert frames.rotation is None
    flat, seen = frames.labels[..., :2], frames.keypoints
    best = (flat * seen).sum((1, 2)) / flat.square().sum((1, 2))
    torch.testing.assert_close(best, torch.ones(40), rtol=1e-4, atol=1e-4)


def test_only_labelled_frames_and_known_joints_have_a_label() -> None:
    data = seen_bodies()
    data.labelled[::2] = False
    data.pose[1, 3] = np.nan
    frames = labelled_frames(data)
    assert not frames.labelled[::2].any()
    assert frames.labelled[1::2].all()
    assert frames.labels[1, 3].isnan().all()
    assert frames.labels[1, 4].isfinite().all()
    assert frames.label_tilt[::2].isnan().all()
    assert with_labels(frames, replace(data, labelled=None)) is frames


def test_mean_bones_are_those_of_the_labelled_bodies_in_mm() -> None:
    data = seen_bodies()
    data.labelled[20:] = False
    start, end = H36M.bone_indices.T
    expected = np.linalg.norm(data.pose[:20, end] - data.pose[:20, start], axis=-1).mean(0)
    np.testing.assert_allclose(mean_bones(labelled_frames(data)).numpy(), expected, rtol=1e-4)
    assert mean_bones(labelled_frames(replace(data, labelled=None))) is None


def test_a_mirrored_frame_has_its_label_mirrored() -> None:
    batch = labelled_frames(seen_bodies()).draw(torch.arange(40))
    batch = replace(batch, confidence=torch.linspace(0.1, 1, 17).expand(40, 17))
    which = torch.arange(40) % 2 == 0
    mirrored = batch.mirrored(which, torch.tensor(H36M.mirror_permutation))
    projected = build_camera("perspective").project(mirrored.labels, mirrored.distance)
    torch.testing.assert_close(projected, mirrored.keypoints, atol=2e-4, rtol=0)
    left, right = H36M.index("lwrist"), H36M.index("rwrist")
    torch.testing.assert_close(mirrored.labels[::2, left], batch.labels[::2, right] * torch.tensor([-1.0, 1, 1]))
    assert torch.equal(mirrored.confidence[::2, left], batch.confidence[::2, right])
    for name in ("keypoints", "confidence", "labels"):
        assert torch.equal(getattr(mirrored, name)[1::2], getattr(batch, name)[1::2])


@pytest.mark.parametrize("tilt_deg", [-10.0, 0.0, 25.0])
def test_a_camera_that_looks_down_at_a_body_below_its_axis_looks_down_by_both_angles(tilt_deg: float) -> None:
    """The camera that looks at the root: its own tilt, and the angle below the axis that the root is seen at."""
    data = seen_bodies()
    below = np.radians(np.linspace(-15, 15, 40))
    root = H36M.root_index
    seen = np.stack([np.full(40, 500.0), 500 + 1145 * np.tan(below)], -1)
    keypoints = data.keypoints - data.keypoints[:, [root]] + seen[:, None]
    data = replace(data, keypoints=keypoints.astype(np.float32), tilt_deg=np.full(40, tilt_deg))
    expected = np.radians(tilt_deg) + below
    np.testing.assert_allclose(labelled_frames(data).label_tilt, expected, atol=1e-4)
    np.testing.assert_allclose(labelled_frames(data, intrinsics="off").label_tilt, np.radians(tilt_deg), atol=1e-5)


@pytest.mark.parametrize("camera", ["known", "unknown"])
def test_labelled_bodies_that_stand_are_upright_whatever_the_tilt(camera: str) -> None:
    """A body is a line along gravity, which a camera tilted down by t sees at (0, cos t, sin t)."""
    tilt = np.radians(np.linspace(-20, 40, 40))
    down = np.stack([np.zeros(40), np.cos(tilt), np.sin(tilt)], -1)
    pose = (np.linspace(0, -1500, 17)[:, None] * down[:, None]).astype(np.float32)
    place = np.array([300.0, -200.0, 4000.0])
    seen = (pose + place)[..., :2] / (pose + place)[..., 2:] * 1145 + 500
    root = np.broadcast_to(place, (40, 3)).astype(np.float32)
    data = seen_bodies(pose=pose, keypoints=seen.astype(np.float32), root=root)
    data = replace(data, tilt_deg=np.degrees(tilt))
    frames = labelled_frames(data, intrinsics="off" if camera == "unknown" else "auto")
    top = true_poses(frames, build_camera("perspective")).pose[:, -1]
    torch.testing.assert_close(top / top.norm(dim=-1, keepdim=True), torch.tensor([0.0, -1, 0]).expand(40, 3))


def test_joined_keeps_both_and_mixes_no_clips() -> None:
    plain = replace(bodies(10), identity={"sequence": np.repeat(["a", "b"], 5)})
    one = to_training_set(plain, H36M, LifterSettings())
    other = labelled_frames(seen_bodies())
    both = TrainingSet.concat([one, other])
    assert len(both) == 50
    assert both.labelled.tolist() == [False] * 10 + [True] * 40
    assert not set(both.clip[:10].tolist()) & set(both.clip[10:].tolist())
    torch.testing.assert_close(both.rotation[:10], torch.eye(3).expand(10, 3, 3))
    torch.testing.assert_close(both.rotation[10:], other.rotation)
    torch.testing.assert_close(both.select(both.labelled).labels, other.labels)


def chosen(here: Path, *words: str, task: str | None = None) -> PoseData:
    return load_data(load_settings(task, [f"data.train={here / 'a.npz'}", *words]), H36M).train


def test_labels_are_whole_clips_in_seeded_order_the_last_cut(here: Path) -> None:
    write_body(here / "a.npz")
    for fraction, frames in ((0.1, 6), (0.5, 30), (1.0, 60)):
        found = chosen(here, f"data.labelled.fraction={fraction}")
        assert int(found.labelled.sum()) == frames
        of_clip = np.bincount(found.clips()[found.labelled], minlength=6)
        assert sorted(of_clip)[::-1][: frames // 10] == [10] * (frames // 10)
    smaller, larger = (chosen(here, f"data.labelled.fraction={f}").labelled for f in (0.1, 0.5))
    assert not (smaller & ~larger).any()


def test_the_same_seed_labels_the_same_frames_in_every_task(here: Path) -> None:
    write_body(here / "a.npz")
    words = ("data.labelled.fraction=0.25", "data.test=null")
    semi = chosen(here, *words, task="semi_cmu")
    alone = chosen(here, *words, task="supervised_cmu")
    assert len(alone) == 15
    np.testing.assert_array_equal(semi.keypoints[semi.labelled], alone.keypoints)
    other = chosen(here, *words, "seed=1", task="semi_cmu")
    assert (other.labelled != semi.labelled).any()


def test_subjects_and_actions_choose_before_the_fraction(here: Path) -> None:
    write_body(here / "a.npz")
    found = chosen(here, "data.labelled.subjects=S1", "data.labelled.fraction=0.5")
    assert int(found.labelled.sum()) == 10
    assert set(found.identity["subject"][found.labelled]) == {"S1"}
    found = chosen(here, "data.labelled.actions=sit down")
    assert set(found.identity["action"][found.labelled]) == {"sit down"}
    assert set(found.identity["action"][~found.labelled]) == {"walk"}


def test_semi_h36m_labels_a_tenth_of_every_video_of_s1_and_leaves_its_rest_out(here: Path) -> None:
    """As VideoPose3D does: two videos of ten frames have one labelled frame each, and 40 frames are of others."""
    write_body(here / "a.npz")
    plain = load_settings("semi_h36m").data.labelled
    assert (plain.subjects, plain.fraction, plain.of_each_clip, plain.rest) == (["S1"], 0.1, True, "leave_out")
    words = ("data.labelled.subjects=S1", "data.labelled.fraction=0.1", "data.labelled.of_each_clip=true")
    kept, found = chosen(here, *words), chosen(here, *words, "data.labelled.rest=leave_out")
    assert (len(kept), len(found)) == (60, 42)
    for data in (kept, found):
        assert sorted(np.unique(data.clips()[data.labelled], return_counts=True)[1]) == [1, 1]
        assert set(data.identity["subject"][data.labelled]) == {"S1"}
    assert found.labelled[found.identity["subject"] == "S1"].all()
    only = chosen(here, *words, "data.labelled.rest=leave_out", "data.labelled.only=true")
    np.testing.assert_array_equal(only.keypoints, kept.keypoints[kept.labelled])


def test_labelled_frames_of_another_file_and_layout(here: Path) -> None:
    write_body(here / "a.npz", pose=None, root=None, tilt_deg=None)
    write_body(here / "b.npz", frames=20, seed=3, skeleton="mpii16")
    loaded = load_data(load_settings(None, [f"data.train={here / 'a.npz'}", "data.labelled.file=b.npz"]), H36M)
    assert loaded.train.labelled is None
    assert len(loaded.more) == 20
    assert loaded.more.labelled.all()
    nose, wrist = H36M.index("nose"), H36M.index("lwrist")
    assert np.isnan(loaded.more.pose[:, nose]).all()  # mpii16 has none
    assert np.isfinite(loaded.more.pose[:, wrist]).all()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["data.labelled.only=true"], "data.labelled.fraction"),
        (["data.labelled.fraction=2"], "expected a number above 0 and at most 1"),
        (["data.labelled.subjects=S9"], "no frame with subject 'S9'"),
        (["data.labelled.subject=S1"], "Did you mean 'data.labelled.subjects'?"),
        (["data.labelled.file=nowhere.npz"], "No file"),
        (["data.labelled.share=1.5", "data.labelled.fraction=0.5"], "data.labelled.share=1.5"),
    ],
)
def test_labels_that_cannot_be_had(here: Path, capsys, words: list[str], says: str) -> None:
    write_body(here / "a.npz")
    assert says in refusal(capsys, "fit", "skeleton=h36m17", "data.train=a.npz", *words)


def test_labels_without_poses_are_refused(here: Path, capsys) -> None:
    write_body(here / "a.npz", pose=None)
    words = ("fit", "skeleton=h36m17", "data.train=a.npz", "data.labelled.fraction=0.5")
    assert "holds no 'pose'" in refusal(capsys, *words)
