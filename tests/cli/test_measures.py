"""Several outputs of one prediction, joint angles and gait among them, from the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bodies import refusal
from flat_runs import across_the_image, flat_run
from walks import SKELETON

from uplift.cli.main import main

ALL = "poses.csv,walk_angles.csv,walk.mot,gait.csv,page.html"


@pytest.fixture
def words(here: Path) -> list[str]:
    np.savez(here / "walk.npz", **across_the_image())
    return ["predict", f"run={flat_run(here)}", "input=walk.npz"]


def test_poses_angles_and_gait_are_written_from_one_lifting(
    words: list[str], here: Path, capsys: pytest.CaptureFixture
):
    assert main([*words, f"output={ALL}", "height_mm=1750", "axes=opensim", "csv_safe=true"]) == 0
    said = capsys.readouterr().out
    assert all((here / name).stat().st_size > 500 for name in ALL.split(","))
    assert "wrote gait.csv: gait of a body" in said and "wrote walk_angles.csv: 23 joint angles" in said
    assert set(pd.read_csv("poses.csv")["axes"]) == {"opensim"}  # which the others do not have
    assert len(pd.read_csv("walk_angles.csv")) == 80
    strides = pd.read_csv("gait.csv").set_index(["foot", "stride"])
    assert strides.loc[("all", "mean"), "stride_time_s"] == pytest.approx(1.2, abs=0.05)


def test_what_cannot_be_written_is_refused_before_any_work(words: list[str], here: Path, capsys: pytest.CaptureFixture):
    (here / "gait.csv").write_text("mine")
    assert "gait.csv" in refusal(capsys, *words, f"output={ALL}") and not (here / "poses.csv").exists()
    assert "'a.csv' is there twice" in refusal(capsys, *words, "output=a.csv,a.csv")
    assert "has no extension" in refusal(capsys, *words, "output=a.csv,b")
    assert "the same in all axes" in refusal(capsys, *words, "output=angles.csv", "axes=blender")
    bare = flat_run(here, replace(SKELETON, name="mine", angles={}, contacts=()))
    for name, why in (("angles.csv", "'mine' names no joint angles"), ("walk_gait.csv", "it names no contacts")):
        assert why in refusal(capsys, "predict", f"run={bare}", "input=walk.npz", f"output=poses.csv,{name}")
    assert not (here / "poses.csv").exists()
