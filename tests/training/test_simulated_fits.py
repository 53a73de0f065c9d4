"""Every shipped skeleton trains on simulated data, from the command line's own path."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import uplift
from uplift.config.files import shipped_names
from uplift.skeleton import load_skeleton

TINY = (
    "lifter.options.units=16", "student.options.units=16", "priors.flow.steps=3", "teacher.batch_size=16",
    "student.batch_size=16", "student.refine.iterations=2", "trainer.max_time=null", "trainer.max_steps=9",
    "trainer.threads=1",
)  # fmt: skip


LIKE_ANOTHER = ("freihand21", "interhand21", "openpose25b")  # the same body in another order
NAMES = [name for name in shipped_names("skeletons") if load_skeleton(name).body and name not in LIKE_ANOTHER]


@pytest.mark.parametrize("name", NAMES)
def test_fits_and_evaluates(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    uplift.simulate(name, "train.npz", frames=60, seed=1)
    uplift.simulate(name, "test.npz", frames=30, seed=2)
    run = uplift.fit(None, f"skeleton={name}", "data.train=train.npz", "data.test=test.npz", *TINY)
    overall = json.loads((run.path / "evaluation.json").read_text())["overall"]
    assert 0 < overall["p_mpjpe"] < np.inf
    model = uplift.load(run.path)
    assert model.skeleton.joints == uplift.load_skeleton(name).joints
    pose = model(np.random.default_rng(0).normal(500, 100, (5, len(model.skeleton.joints), 2)))
    assert np.isfinite(pose).all()
