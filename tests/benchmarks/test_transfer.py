"""The benchmark of fits from a ready lifter: new data are split by motion, and a fit never sees the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import transfer
from benchmarks.transfer import CASES, write_split


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a set of two species in eight motions of ten frames."""
    frames = np.arange(160)
    arrays = {
        "keypoints": np.repeat(frames, 6).reshape(160, 3, 2).astype(np.float32),
        "joint_names": np.array(["a", "b", "c"]),
        "pose": np.zeros((160, 3, 3)), "root": np.zeros((160, 3)), "focal_px": np.float32(1145),
        "subject": np.where(frames < 80, "Cow", "Bull"),
        "sequence": np.array([f"{'Cow' if row < 80 else 'Bull'}/{row % 80 // 10}" for row in frames]),
    }  # fmt: skip
    (tmp_path / "quadruped").mkdir()
    np.savez(tmp_path / "quadruped/test.npz", **arrays)
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    return tmp_path


def test_motions_are_split_and_the_truth_stays_with_the_test(data: Path) -> None:
    case, chosen = replace(CASES["cow"], frames=25), []
    for seed in (0, 0, 1):
        write_split(case, seed, data)
        fit, test = (dict(np.load(data / f"{name}.npz")) for name in ("fit", "test"))
        assert not {"pose", "root", "tilt_deg"} & fit.keys()
        assert test["pose"].shape == (40, 3, 3)
        assert len(fit["keypoints"]) == len(fit["sequence"]) == 25
        assert set(fit["subject"]) == set(test["subject"]) == {"Cow"}
        assert not set(fit["sequence"]) & set(test["sequence"])
        assert fit["focal_px"] == 1145
        chosen.append(fit["keypoints"][:, 0, 0].tolist())
    assert chosen[0] == chosen[1] != chosen[2]


def test_what_is_stored_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(transfer, "RESULTS", tmp_path / "transfer.json")
    for seed, error in enumerate((40.0, 50.0)):
        transfer.store(transfer.RESULTS, f"cow_init_600_seed{seed}", {"p_mpjpe": error, "n_mpjpe": 2 * error})
    assert transfer.main(["--print", "--only", "cow", "--seeds", "0,1,2"]) == 0
    row = capsys.readouterr().out.splitlines()[-1].split()
    assert row[:5] == ["cow", "init", "600", "2", "45.0"]
