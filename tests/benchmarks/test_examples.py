"""The benchmark of the examples: the page's files, from the fit to the table; stored results are not run again."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bodies import status_of

from benchmarks import examples
from benchmarks.common import BenchmarkError
from benchmarks.examples import EXAMPLES, files_of, main, write_files
from uplift.data.formats import read

QUICK = (
    "lifter.options.units=16", "lifter.options.blocks=1", "priors.flow.steps=3", "priors.flow.units=8", "student.share=0",
    "teacher.batch_size=16", "trainer.max_time=null", "trainer.max_steps=4", "trainer.threads=1",
)  # fmt: skip


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of the results, which does not exist yet."""
    file = tmp_path / "stored" / "examples.json"
    monkeypatch.setattr(examples, "RESULTS", file)
    return file


def a_set(folder: Path, skeleton: str, subjects: int = 2) -> None:
    """Write simulated train and test files in the layout of a real set."""
    import uplift

    folder.mkdir()
    for seed, split in enumerate(("train", "test")):
        uplift.simulate(skeleton, folder / f"{split}.npz", frames=40, seed=seed)
        with np.load(folder / f"{split}.npz") as file:
            arrays = dict(file) | {"subject": np.array([f"S{row % subjects}" for row in range(40)])}
        np.savez(folder / f"{split}.npz", **arrays)


def _in_this_process(verb: str, words: list[str], folder: Path, cores: set[int]) -> None:
    """Run a command in this process, which is faster."""
    with contextlib.chdir(folder):
        assert status_of(verb, *words) == 0


def test_the_files_are_those_of_the_page(tmp_path: Path) -> None:
    assert set(files_of()) == {f"my_{name}{ending}.yaml" for name in EXAMPLES for ending in ("", "_task")}
    for name in EXAMPLES:
        task = write_files(name, tmp_path)
        assert task.read_text() == files_of()[task.name]
        assert f"\nskeleton: my_{name}.yaml\n" in task.read_text()


def test_from_the_fit_to_the_table(
    tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    a_set(tmp_path / "chair", "chair10")
    monkeypatch.setattr(examples, "run_uplift", _in_this_process)
    found = examples.run_example("chair", 0.05, 3, {0}, QUICK)
    assert found["commands"][0].startswith(
        "uplift fit task=my_chair_task.yaml data.root=$UPLIFT_DATA/chair trainer.max_time=00:00:03 seed=3 "
    )
    assert str(tmp_path) not in results.read_text()
    data = read(tmp_path / "chair" / "test.npz")
    assert found["frames"] == len(data) == 40
    assert found["ratio"] == pytest.approx(found["n_mpjpe"] / found["flat_n_mpjpe"])
    assert set(found["subjects"]) == {"S0", "S1"}
    assert np.mean(list(found["subjects"].values())) == pytest.approx(found["n_mpjpe"])
    assert json.loads(results.read_text()) == {"chair_0.05min_seed3": found}
    shutil.rmtree(tmp_path / "chair")  # stored: the data is not needed again
    capsys.readouterr()
    assert main(["--only", "chair", "--minutes", "0.05", "--seeds", "3"]) == 0
    row = capsys.readouterr().out.splitlines()[-1].split()
    assert row[:3] == ["chair", "0.05min", "1"]
    assert [float(cell) for cell in row[3:6]] == pytest.approx(
        [found["n_mpjpe"], found["flat_n_mpjpe"], found["ratio"]], abs=6e-4
    )


def test_flat_depth_is_that_of_the_report(tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    a_set(tmp_path / "hand", "hand21")
    reports: list[str] = []

    def run(verb: str, words: list[str], folder: Path, cores: set[int]) -> None:
        _in_this_process(verb, words, folder, cores)
        reports.append((folder / "runs/my_hand_task/last/report.md").read_text())

    monkeypatch.setattr(examples, "run_uplift", run)
    found = examples.run_example("hand", 1, 0, {0}, QUICK)
    assert f"| `n_mpjpe` | {found['n_mpjpe']:.4g} | {found['flat_n_mpjpe']:.4g} |" in reports[0]


def test_failures_are_reported_and_not_stored(
    tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    with pytest.raises(BenchmarkError, match="UPLIFT_DATA is not set"):
        examples.run_example("rat", 2, 0, {0})
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    assert main(["--only", "rat", "--minutes", "0"]) == 1  # rejected before the child imports torch
    error = capsys.readouterr().err
    assert "rat_0min_seed0: uplift fit task=my_rat_task.yaml" in error
    assert "trainer.max_time" in error.rpartition("ended with status 2:")[2]
    assert not results.exists()
    assert main(["--print"]) == 0
    with pytest.raises(SystemExit):
        main(["--only", "rats"])
