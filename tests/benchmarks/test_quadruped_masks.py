"""The benchmark of masks alongside keypoints: masks, hidden joints, from the fit to the table."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import status_of

from benchmarks.common import BenchmarkError
from benchmarks.quadruped_masks import __main__ as benchmark
from benchmarks.quadruped_masks.files import LIMBS, NODES, Frames, align, draw_mask, hidden_joints, masks_of_rows
from uplift.data.formats import read
from uplift.skeleton import load_skeleton

QUICK = (
    "lifter.options.units=16", "lifter.options.blocks=1", "priors.flow.steps=3", "priors.flow.units=8",
    "teacher.batch_size=16", "student.batch_size=16", "student.rounds=1", "student.options.units=16",
    "student.last_options.units=16", "student.refine.iterations=1",
)  # fmt: skip
JOINTS = load_skeleton("quadruped28").joints


def test_every_joint_but_the_nose_is_at_a_node() -> None:
    assert set(NODES) == set(JOINTS) - {"nose"}
    assert {joint for limb in LIMBS for joint in limb} <= set(JOINTS)


def test_align_finds_the_transform() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(9, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    scale, turned, shift = align(points, 3.0 * points @ rotation.T + [1.0, 2.0, 3.0])
    assert scale == pytest.approx(3)
    np.testing.assert_allclose(turned, rotation, atol=1e-9)
    np.testing.assert_allclose(shift, [1, 2, 3], atol=1e-9)


def test_a_drawn_triangle_covers_its_area() -> None:
    corners = np.array([[[110.0, 210.0], [150.0, 210.0], [110.0, 250.0]]])
    mask = draw_mask(corners, np.array([100.0, 200.0, 64.0]), 64)
    assert mask.sum() / 255 == pytest.approx(800, rel=0.06)
    rows, columns = np.nonzero(mask > 127)
    for found in (columns, rows):
        assert found.min() == pytest.approx(10, abs=1) and found.max() == pytest.approx(49, abs=1.5)


@pytest.mark.parametrize("split", ["train", "test"])
def test_masks_match_the_poses(split: str, benchmark_data) -> None:
    """The posed and aligned nodes of the files coincide with the joints of the data; masks contain the joints."""
    path = benchmark_data(f"quadruped/{split}.npz")
    with np.load(path) as file:
        data = dict(file)
    rows = np.linspace(0, len(data["keypoints"]) - 1, 4).astype(int)
    masks, box, off_px = masks_of_rows(data, rows, path.parent.parent / "animal_meshes")
    assert off_px.max() < 4
    at = ((data["keypoints"][rows] - box[:, None, :2]) * (masks.shape[1] / box[:, None, 2:])).astype(int)
    assert ((at >= 0) & (at < masks.shape[1])).all()
    assert (masks[np.arange(4)[:, None], at[..., 1], at[..., 0]] > 127).mean() > 0.9


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_the_requested_fraction_of_joints_is_hidden(share: float) -> None:
    hidden = hidden_joints(JOINTS, 400, share, 3)
    assert hidden.mean() == pytest.approx(share, abs=0.02)
    assert (~hidden).sum(1).min() >= 8
    assert np.array_equal(hidden, hidden_joints(JOINTS, 400, share, 3))
    limb = hidden[:, [JOINTS.index(joint) for joint in LIMBS[0]]].all(1).mean()
    assert limb > 3 * share**3 or share == 0


def test_errors_of_seen_and_missing_joints_are_separate() -> None:
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(5, 28, 3))
    missing = hidden_joints(JOINTS, 5, 0.3, 0)
    off = truth + 0.01 * missing[..., None]
    found = benchmark.errors_of(off, truth, missing, 6)
    assert found["n_mpjpe_seen"] < 0.2 * found["n_mpjpe_missing"]
    assert "n_mpjpe_missing" not in benchmark.errors_of(off, truth, np.zeros_like(missing), 6)


def _frames(folder: Path, split: str, cache: Path) -> Frames:
    import uplift

    path = cache / f"{split}.npz"
    if not path.is_file():
        uplift.simulate("quadruped28", path, frames=40, seed=len(split))
    data = read(path)
    assert data.pose is not None
    box = np.array([[*k.min(0) - 20, np.ptp(k, 0).max() + 40] for k in data.keypoints], np.float32)
    arrays = {"keypoints": data.keypoints, "pose": data.pose, "joint_names": np.array(data.joint_names)}
    return Frames({**arrays, "masks": np.full((40, 16, 16), 255, np.uint8), "mask_box": box})


def test_from_the_fit_to_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def in_this_process(verb: str, words: list[str], folder: Path, cores: set[int]) -> None:
        with contextlib.chdir(folder):
            assert status_of(verb, *words) == 0

    for name, value in (("RESULTS", tmp_path / "stored.json"), ("COMMON", ["data.train=train.npz", *QUICK])):
        monkeypatch.setattr(benchmark, name, value)
    monkeypatch.setattr(benchmark, "rendered_frames", _frames)
    monkeypatch.setattr(benchmark, "run_uplift", in_this_process)
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    words = ["--kinds", "masks", "--missing", "0.3", "--steps", "4", "--seeds", "0", "--cache", str(tmp_path)]
    threads = torch.get_num_threads()
    try:
        assert benchmark.main(words) == 0
    finally:
        torch.set_num_threads(threads)
    (key, result), *more = json.loads((tmp_path / "stored.json").read_text()).items()
    assert key == "masks_30%_4steps_seed0" and not more
    assert "priors.mask.weight" in result["command"] and result["seed"] == 0 and result["commit"]
    assert set(result["errors"]) == {"teacher", "student"}
    assert result["errors"]["teacher"]["test"] != result["errors"]["student"]["test"]
    monkeypatch.setattr(benchmark, "run_uplift", None)  # stored results are not run again
    capsys.readouterr()
    assert benchmark.main(words) == 0
    table = capsys.readouterr().out
    assert "teacher" in table and f"{result['errors']['student']['test']['n_mpjpe_missing']:.0f}" in table


def test_missing_data_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(benchmark, "RESULTS", tmp_path / "stored.json")
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    assert benchmark.main(["--kinds", "masks", "--missing", "0.4", "--seeds", "0", "--cache", str(tmp_path)]) == 1
    assert "UPLIFT_DATA is not set" in capsys.readouterr().err
    with pytest.raises(BenchmarkError):
        benchmark.run_case("masks", 0.4, 4, 0, tmp_path, {0})
