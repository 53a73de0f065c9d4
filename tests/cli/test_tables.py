"""The paper's tables: published rows, and rows of fits on small files with the structure of the real ones."""

from __future__ import annotations

import json
from pathlib import Path

import h36m_files
import mpi_inf_3dhp_files
import numpy as np
import pytest
from bodies import QUICK, last_words

import uplift
from uplift.cli import tables
from uplift.cli.main import main
from uplift.cli.tables import Recipe, place_of, uses_of
from uplift.config.loading import load_settings
from uplift.metrics import kudo2018
from uplift.metrics.kudo2018 import COLUMNS, PUBLISHED
from uplift.training.callbacks import Interrupted

KUDO = ("lifter.options.units=16", "priors.critic.units=16", "trainer.max_epochs=null", "trainer.max_steps=10",
        "trainer.threads=1")  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Return a data folder with both sets: all subjects, actions and cameras, few frames."""
    folder = tmp_path_factory.mktemp("data")
    h36m_files.write_videopose3d(folder / "h36m", ("gt", "sh"))
    for subject in range(1, 9):
        mpi_inf_3dhp_files.write_train(folder / "mpi_inf_3dhp", f"S{subject}", frames=4, seed=subject)
    for number in range(1, 7):
        mpi_inf_3dhp_files.write_test(folder / "mpi_inf_3dhp", number, frames=14)
    return folder


@pytest.fixture(scope="module")
def place(data, tmp_path_factory):
    """Return the folder of runs and results shared by the tests of this file, with UPLIFT_DATA set."""
    with pytest.MonkeyPatch.context() as patch:
        here = tmp_path_factory.mktemp("here")
        patch.chdir(here)
        patch.setenv("UPLIFT_DATA", str(data))
        patch.setenv("UPLIFT_CACHE", str(here / "cache"))
        patch.setattr(tables, "RESULTS", here / "results")
        yield here


def rows_of(printed: str) -> list[list[str]]:
    """Return the cells of each line of a markdown table."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in printed.splitlines() if line[:1] == "|"]


def ours(printed: str, name: str) -> list[list[str]]:
    return [row for row in rows_of(printed) if row[0].startswith(name)]


@pytest.mark.parametrize("table", PUBLISHED)
def test_published_rows_are_complete(table):
    for row in PUBLISHED[table]:
        assert len(row.errors) == len(COLUMNS) == 15
    kudo = PUBLISHED[table][-1]
    assert np.mean([error for error in kudo.errors if error]) == pytest.approx(kudo.average, abs=0.05)
    assert kudo.average == {"table1": 130.9, "table2": 173.2}[table]


def test_table_1_end_to_end(place, capsys):
    assert main(["tables", "table1", "task=h36m", *QUICK, "seeds=0,1", "markdown=true"]) == 0
    printed = capsys.readouterr().out
    head = rows_of(printed)[0]
    assert head[4:20] == [*COLUMNS, "Avg"]
    assert next(r for r in rows_of(printed) if r[0][:4] == "Kudo")[:5] == ["Kudo et al. 2018", "GT", "2D", "-", "125.0"]
    [row, more] = ours(printed, "h36m, 10steps")
    assert row[1:4] == ["GT", "2D, lenses", "0,1"]
    files = sorted((place / "results" / "table1").glob("*.json"))
    results = [json.loads(file.read_text()) for file in files]
    assert [of["seed"] for of in results] == [0, 1]
    assert results[0]["command"].startswith("uplift fit task=h36m ") and results[0]["command"].endswith("seed=0")
    assert (
        results[0]["budget"] == "10steps"
        and results[0]["fitted_by"]["versions"]["torch"]
        and str(place) not in files[0].read_text()
    )
    average = np.mean([of["overall"]["mpjpe_gt_scale_action_mean"] for of in results])
    assert row[19] == f"{average:.1f}" == more[3]
    eating = np.mean([of["per_action"]["Eating"]["mpjpe_gt_scale"] for of in results])
    assert row[head.index("Eating")] == f"{eating:.1f}"
    assert float(row[19]) == pytest.approx(np.mean([float(cell) for cell in row[4:19]]), abs=0.1)
    runs = sorted(Path("runs/h36m").glob("2*"))

    assert main(["tables", "table1", "task=h36m", *QUICK, "seeds=0,1"]) == 0  # stored results are not fitted again
    assert "stored" in capsys.readouterr().out and sorted(Path("runs/h36m").glob("2*")) == runs
    assert (
        main(["tables", f"run={runs[0]}", f"run={runs[1]}", "markdown=true"]) == 0
    )  # existing runs give the same rows
    assert ours(capsys.readouterr().out, "h36m, 10steps") == [row, more]
    assert sorted((place / "results" / "table1").glob("*.json")) == files


def test_the_papers_own_method_on_both_tables(place, capsys):
    words = [word for task in ("kudo2018_code", "kudo2018_paper") for word in (f"task={task}",)]
    assert main(["tables", "table1", "table2", *words, *KUDO, "seeds=3", "markdown=true"]) == 0
    printed = capsys.readouterr().out
    rows = [row for row in ours(printed, "kudo2018") if len(row) > 15]
    assert [(row[0], *row[1:4]) for row in rows] == [
        (f"{task}, 10steps", seen, "2D", "3") for seen in ("GT", "SH") for task in ("kudo2018_code", "kudo2018_paper")
    ]
    assert all(40 < float(cell) < 2000 for row in rows for cell in row[4:20])
    assert main(["tables", "show=true"]) == 0
    assert "kudo2018_paper, 10steps" in capsys.readouterr().out


def test_labels_are_listed(place, capsys):
    assert (
        main(
            [
                "tables",
                "table2",
                "task=semi_h36m",
                *QUICK,
                "data.options.keypoints=detected",
                "seeds=0",
                "data.labelled.fraction=0.5",
            ]
        )
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    [row] = [line for line in lines if line.strip().startswith("semi_h36m, 10steps  ") and "SH" in line]
    assert "2D, lenses, 3D of 50 % of S1" in row
    sections = [line.strip() for line in lines]
    assert sections.index("w/ 3D dataset") < sections.index(row.strip()) < sections.index("w/o 3D dataset")


def test_a_table_without_data_does_not_stop_the_others(place, data, capsys):
    words = ["data.root=" + str(data / "h36m"), "task=kudo2018_code", *KUDO, "seeds=3", "markdown=true"]
    assert main(["tables", "table1", *words]) == 0  # stored: another folder is the same fit
    assert main(["tables", "3dhp", *last_words(*[word for word in words if word[:4] != "task"], *QUICK)]) == 2
    printed = capsys.readouterr()
    assert "stored kudo2018_code" in printed.out and "no 3dhp" in printed.err


def test_an_interrupted_table_can_be_continued(monkeypatch, capsys):
    def stop(*_):
        raise Interrupted(Path("runs/h36m/now"))

    monkeypatch.setattr(tables, "_missing", lambda _: {})
    monkeypatch.setattr(uplift, "fit", stop)
    assert main(["tables", "table1"]) == 130
    assert "repeat the command" in capsys.readouterr().err


def test_the_3dhp_figure(place, capsys):
    assert main(["tables", "3dhp", "task=mpi_inf_3dhp", *QUICK, "seeds=0", "markdown=true"]) == 0
    printed = capsys.readouterr().out
    assert "89.3" in next(row for row in rows_of(printed) if row[0].startswith("Kudo"))
    assert "z alone, on the training data" in printed
    figures, pck, auc = ours(printed, "mpi_inf_3dhp, 10steps")
    [file] = (place / "results" / "3dhp").glob("*.json")
    result = json.loads(file.read_text())
    assert figures[3] == f"{100 * result['train']['overall']['pck_z@150']:.1f}"
    shares = [result["overall"][name] for name in ("pck_z@150", "pck@150", "auc", "pck14@150", "auc14")]
    assert figures[4:9] == [f"{100 * share:.1f}" for share in shares]
    assert result["overall"]["pck_z@150"] != result["train"]["overall"]["pck_z@150"]
    assert main(["tables", "3dhp", "task=kudo2018_code", *KUDO, "seeds=0", "markdown=true"]) == 0
    row, *_ = ours(capsys.readouterr().out, "kudo2018_code, 10steps")
    assert row[1:3] == ["2D", "0"] and all(0 < float(cell) < 100 for cell in row[3:9])
    assert pck[-1] == figures[5] and auc[-1] == figures[6] and "-" not in pck


def test_missing_data_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    monkeypatch.setattr(tables, "RESULTS", tmp_path / "results")
    for word, missing in (("table2", "data_3d_h36m.npz"), ("3dhp", "S1/Seq1/annot.mat")):
        assert main(["tables", word, "seeds=0"]) == 2
        error = capsys.readouterr().err
        assert missing in error and "UPLIFT_DATA=FOLDER" in error and len(error.splitlines()) < 20
    assert main(["tables", "seeds=0"]) == 2  # the first message in full, a line for each other table
    error = capsys.readouterr().err
    assert error.count("UPLIFT_DATA=FOLDER") == 1 and "no table1: Human3.6M" in error and "no 3dhp: MPI" in error
    assert not (tmp_path / "runs").exists()
    assert main(["tables", "show=true"]) == 0  # the published rows need none
    assert "130.9" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["table3"], "no table 'table3'. Did you mean 'table2'? Expected any of table1, table2, 3dhp."),
        (["table1", "seed=3"], "seeds="),
        (["run=runs/none", "task=h36m"], "leave out task="),
        (["run=runs/none"], "No run runs/none"),
        (["3dhp", "task=h36m"], "other data"),
        (["table1", "task=h37m"], "h36m"),
        (["table1", "trainer.max_tim=3"], "trainer.max_time"),
    ],
)
def test_invalid_arguments_are_rejected(words, said, here, capsys):
    assert main(["tables", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_run_on_other_data_is_rejected():
    from uplift.errors import UserError

    with pytest.raises(UserError, match="the tables need Human3.6M"):
        tables.table_of(load_settings("cmu"), "runs/cmu/last")


def test_different_fits_have_different_files():
    def name(*words: str, task: str = "h36m", table: str = "table1", seed: int = 0) -> str:
        return place_of(table, Recipe.of(table, task, words, seed).settings()).name

    plain = name()
    assert plain.startswith("h36m_10min_") and plain.endswith("_seed0.json")
    assert name("data.root=elsewhere", "trainer.threads=1") == plain
    different = [name("trainer.max_time=00:20:00"), name("data.options.fps=50"), name("lifter.options.units=16"),
                 name(seed=1), name(task="kudo2018_code"), name(task="semi_h36m")]  # fmt: skip
    assert len({plain, *different}) == 7


def test_what_a_fit_uses():
    assert uses_of(load_settings("kudo2018_code")) == "2D"
    assert uses_of(load_settings("h36m")) == "2D, lenses"
    assert uses_of(load_settings("supervised_h36m")) == "2D, lenses, 3D of 10 % of S1 only"
    assert (
        uses_of(load_settings("h36m", ["lifter.intrinsics=off", "data.labelled.subjects=S1,S5"])) == "2D, 3D of S1, S5"
    )


def test_other_frame_rates_are_shown():
    result = {"task": "h36m", "budget": "10min", "fps": 50}
    assert kudo2018._name(result).strip() == "h36m, 10min, 50 fps"
    assert kudo2018._name(result | {"fps": 10}).strip() == "h36m, 10min"


def test_a_damaged_result_is_one_message(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    (tmp_path / "table1").mkdir()
    (tmp_path / "table1" / "h36m_10min_0_seed0.json").write_text('{"task": ')
    assert main(["tables", "table1", "show=true"]) == 2
    assert "not a valid result" in capsys.readouterr().err
