"""Simulated keypoints in files: plain csv, and what a tracker would have written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bodies import status_of

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.synthetic.simulate import as_tracked, simulate
from uplift.skeleton import load_skeleton

WORDS = ("simulate", "skeleton=rat23", "frames=60", "clip_seconds=2", "noise_px=1", "missing=0.2", "seed=3")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_csv_and_npz_of_one_seed_have_the_same_frames() -> None:
    assert status_of(*WORDS, "output=a.npz") == status_of(*WORDS, "output=a.csv") == 0
    truth, plain = read("a.npz"), read("a.csv")
    seen = truth.confidence > 0
    np.testing.assert_array_equal(plain.confidence, truth.confidence)
    np.testing.assert_array_equal(plain.keypoints[seen], truth.keypoints[seen])
    assert plain.pose is None and truth.pose is not None
    for key in truth.identity:
        np.testing.assert_array_equal(plain.identity[key].astype(str), truth.identity[key].astype(str))


def test_a_tracker_has_a_file_for_each_clip_and_a_place_for_each_joint(capsys: pytest.CaptureFixture) -> None:
    assert status_of(*WORDS, "output=v.csv", "tracker=deeplabcut") == status_of(*WORDS, "output=a.npz") == 0
    assert "wrote 3 files, v_000000.csv to v_000002.csv" in capsys.readouterr().out
    truth = read("a.npz")
    files = sorted(Path.cwd().glob("v_*.csv"))
    assert [KEYPOINT_FORMATS.guess(file).name for file in files] == ["deeplabcut"] * 3
    tracked = [read(file) for file in files]
    keypoints, confidence = (np.concatenate([getattr(t, n) for t in tracked]) for n in ("keypoints", "confidence"))
    seen = truth.confidence > 0
    np.testing.assert_array_equal(keypoints[seen], truth.keypoints[seen])
    assert confidence[seen].min() >= 0.8
    assert confidence[~seen].min() > 0 and confidence[~seen].max() <= 0.3
    assert np.linalg.norm(keypoints - truth.keypoints, axis=-1)[~seen].min() > 10


def test_one_clip_is_the_file_itself() -> None:
    assert status_of(*WORDS[:2], "frames=5", "output=v.csv", "tracker=deeplabcut") == 0
    assert [path.name for path in Path.cwd().iterdir()] == ["v.csv"]


def test_guesses_fall_on_joints_that_are_seen() -> None:
    data = simulate(load_skeleton("rat23"), 40, seed=0, missing=0.3)
    tracked = as_tracked(data)
    missing = data.confidence == 0
    away = np.linalg.norm(tracked.keypoints[:, :, None] - data.keypoints[:, None], axis=-1)
    away = np.where(missing[:, None], np.inf, away).min(2)
    assert np.median(away[missing]) < 10
    assert away[missing].max() < 30
    np.testing.assert_array_equal(as_tracked(data).keypoints, tracked.keypoints)
    assert not np.array_equal(as_tracked(data, seed=1).confidence, tracked.confidence)
    assert tracked.pose is None


def test_frames_without_any_joint_keep_low_likelihoods() -> None:
    data = simulate(load_skeleton("rat23"), 4, seed=0)
    data.confidence[1] = 0
    assert as_tracked(data).confidence[1].max() <= 0.3
