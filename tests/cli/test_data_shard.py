"""`uplift data shard`: from files of several kinds to a folder that fit, check and evaluate take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.cli.main import main
from uplift.data.formats import read
from uplift.data.formats.npz import read_npz
from uplift.data.formats.shards import Shards

BEETLE = ["skeleton=rat23"]


@pytest.fixture
def files(here: Path) -> Path:
    """Return a folder with an npz of 400 frames, and an npz and a csv of 200."""
    for name, seed, frames in (("a.npz", 1, 400), ("b.npz", 2, 200), ("b.csv", 2, 200)):
        assert main(["simulate", *BEETLE, f"output={name}", f"frames={frames}", f"seed={seed}", "clip_seconds=2"]) == 0
    return here


def test_files_become_shards_and_shards_become_others(files: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "shard", "?.npz", "b.csv", "output=all", "frames=300", *BEETLE]) == 0
    printed = capsys.readouterr().out
    assert "wrote all: 800 frames in 40 clips, 3 shards" in printed
    assert "next: uplift fit skeleton=rat23 data.train=all" in printed
    whole = read("all")
    parts = [read_npz("a.npz"), read_npz("b.npz"), read("b.csv")]
    np.testing.assert_allclose(whole.keypoints, np.concatenate([part.keypoints for part in parts]), atol=1e-2)
    assert np.isfinite(whole.pose[:600]).all()
    assert np.isnan(whole.pose[600:]).all()
    assert len(set(whole.identity["sequence"].tolist())) == 40  # those of three files stay apart
    assert main(["data", "shard", "all", "output=half", "dtype=float16"]) == 0
    half = Shards("half")
    assert half.is_float16
    np.testing.assert_allclose(half.read().keypoints, whole.keypoints, atol=0.2)
    assert main(["data", "check", *BEETLE, "data.train=half"]) == 0
    assert "800 frames of 23 joints, with poses" in capsys.readouterr().out


def test_simulated_frames_become_shards(here: Path):
    assert main(["simulate", *BEETLE, "output=many", "frames=31000", "clip_seconds=30"]) == 0
    found = Shards("many").read()
    assert len(found) == 31000
    assert len(np.unique(found.clips())) == 104
    assert found.pose is not None
    np.testing.assert_array_equal(found.keypoints[:300], read("many").keypoints[:300])
    first, later = found.keypoints[:300], found.keypoints[30000:30300]
    assert np.abs(first - later).mean() > 1  # another part has other motions


def test_a_fit_goes_through_more_than_its_buffer(files: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "shard", "a.npz", "output=train"]) == 0
    words = [
        "data.train=train",
        "data.test=b.npz",
        "data.buffer=128",
        "data.val=0.2",
        "trainer.max_steps=6",
        "trainer.max_time=",
    ]
    small = [
        "teacher.batch_size=32",
        "student.batch_size=16",
        "lifter.options.units=8",
        "student.options.units=8",
        "lifter.signs=0",
    ]
    priors = ["priors.flow.weight=0", "priors.handedness.weight=0", "student.frames=60"]
    assert main(["fit", *BEETLE, *words, *small, *priors, "trainer.accelerator=cpu"]) == 0
    printed = capsys.readouterr().out
    assert "train: 400 frames from" in printed
    assert "in memory at a time (data.buffer)" in printed
    assert main(["evaluate", "run=runs/rat23/last", "data.test=train"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["output=x"], "takes files of keypoints"),
        (["a.npz"], "needs output="),
        (["nothing.npz", "output=x"], "No file nothing.npz"),
        (["a.npz", "output=a.npz"], "exists already"),
        (["a.npz", "h36m:train", "output=x"], "needs skeleton=NAME"),
        (["a.npz", "data.root=.", "output=x"], "goes with a published set"),
        (["a.npz", "output=x", "dtype=int8"], "expected float32 or float16"),
        (["a.npz", "broken.npz", "output=x"], "broken.npz"),
        (["a.npz", "output=x", "skeleton=h36m17"], "a.npz"),
    ],
)
def test_what_cannot_be_is_one_line(files: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str):
    (files / "broken.npz").write_bytes((files / "b.npz").read_bytes()[:-100])
    assert main(["data", "shard", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not (files / "x").exists()  # nothing half done
    assert not list(files.glob(".x*"))
