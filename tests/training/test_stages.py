"""Stages: a finished one is not run again, and its time is remembered."""

from __future__ import annotations

from pathlib import Path

import torch
from lifts import H36M, small_lifter, training_set

from uplift.config.settings import TeacherSettings, TrainerSettings, ViewSettings
from uplift.priors.bones import Bones
from uplift.training.adversarial import AdversarialTraining
from uplift.training.stages import StageBudget, run_stage


def _module(seed: int) -> AdversarialTraining:
    settings = TeacherSettings(batch_size=8)
    priors = {"bones": Bones(H36M)}
    return AdversarialTraining(
        small_lifter(seed=seed), training_set(40), settings, ViewSettings(), priors, {"bones": 1.0}, 0
    )


def test_a_finished_stage_comes_back_with_its_weights_and_its_time(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    settings, budget = TrainerSettings(max_time=None, max_steps=5, threads=1), StageBudget(5, None)
    first, second = _module(0), _module(1)
    spent = run_stage("teacher", first, settings, budget, tmp_path).spent
    rows = (tmp_path / "metrics.csv").read_text()
    again = run_stage("teacher", second, settings, budget, tmp_path)
    assert spent > 0
    assert again.spent == spent
    assert (tmp_path / "metrics.csv").read_text() == rows
    for one, other in zip(first.final.parameters(), second.final.parameters(), strict=True):
        assert torch.equal(one, other)
