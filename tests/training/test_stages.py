"""Stages: a finished one is not run again, and its time is remembered."""

from __future__ import annotations

from pathlib import Path

import torch
from lifts import H36M, bodies, small_lifter, training_set
from modules import lifting_module

from uplift.config.settings import TrainerSettings
from uplift.data.module import KeypointData
from uplift.priors.bones import Bones
from uplift.training.lifting import LiftingModule
from uplift.training.stages import StageBudget, run_stage


def _module(seed: int) -> LiftingModule:
    return lifting_module(small_lifter(seed=seed), training_set(40), {"bones": Bones(H36M)})


def test_a_finished_stage_comes_back_with_its_weights_and_its_time(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    settings, budget = TrainerSettings(max_time=None, max_steps=5, threads=1), StageBudget(5, None)
    data = KeypointData(bodies(40), H36M, val=None, batch_size=8)
    first, second = _module(0), _module(1)
    record = run_stage("teacher", first, data, settings, budget, tmp_path)
    rows = (tmp_path / "metrics.csv").read_text()
    again = run_stage("teacher", second, data, settings, budget, tmp_path)
    assert record.spent > 0
    assert record.steps == 5
    assert again == record
    assert (tmp_path / "metrics.csv").read_text() == rows
    for one, other in zip(first.final.parameters(), second.final.parameters(), strict=True):
        assert torch.equal(one, other)
