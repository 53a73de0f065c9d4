"""The command line as a stranger meets it: help at once, words checked, nothing overwritten, any folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bodies import QUICK, body_arrays, own_data, refusal, status_of, write_body

from uplift import __version__
from uplift.cli.main import main

HEAVY = ("torch", "lightning", "numpy", "omegaconf", "yaml", "skimage")


pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a.npz, b.npz, and two evaluated runs."""
    folder = tmp_path_factory.mktemp("fitted")
    write_body(folder / "b.npz", seed=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert status_of("fit", *own_data(folder / "a.npz"), "data.test=b.npz", "seed=0,1", "sweep.workers=1") == 0
    return folder


def the_runs(folder: Path) -> list[Path]:
    return sorted((folder / "runs/h36m17").glob("sweep_*/*_seed=*"))


@pytest.mark.parametrize("words", [[], ["--help"], ["--version"], ["fit", "--help"]])
def test_help_loads_nothing_heavy(words: list[str]) -> None:
    script = (
        f"import sys\nfrom uplift.cli.main import main\ntry:\n    main({words!r})\nexcept SystemExit as stop:\n"
        f"    assert not stop.code\nassert not set(sys.modules) & set({HEAVY!r})"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "usage: uplift" in done.stdout or __version__ in done.stdout


def test_a_typo_is_answered_before_torch_is_loaded() -> None:
    script = "import sys\nfrom uplift.cli.main import main\nassert main(['fit', 'task=cmuu']) == 2\nassert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stderr == refusal_text("cmuu")


def refusal_text(task: str) -> str:
    return f"uplift: No task '{task}'. Did you mean 'cmu'? `uplift tasks` lists them; your own task is a .yaml file.\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["fitt"], "no command 'fitt'. Did you mean 'fit'?"),
        (["-5"], "no command '-5'."),
        (["fit", "--task", "cmu"], "unrecognized arguments: --task"),
        (["skeleton", "--x"], "unrecognized arguments: --x"),
    ],
)
def test_an_unknown_verb_or_flag_ends_with_status_2(words: list[str], says: str, capsys: pytest.CaptureFixture) -> None:
    message = refusal(capsys, *words)
    assert says in message
    assert message.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["fit", "task="], "has no value"),
        (["fit", "resume"], "has no value"),
        (["fit", "demo"], "Did you mean task=demo?"),
        (["fit", "skeleton=h36m17", "seed=0,x"], "seed"),
        (["fit", "skeleton=h36m17", "seed=0,,1"], "seed"),
        (["fit", "skeleton=h36m17", "seed=0,-1"], "seed=-1"),
        (["fit", "data.train=a.npz"], "No skeleton: set skeleton=NAME"),
        (["fit", "skeleton=h36m18", "data.train=a.npz"], "Did you mean 'h36m17'"),
        (["fit", "skeleton=none.yaml", "data.train=a.npz"], "none.yaml"),
        (["evaluate"], "evaluate takes run=RUN or poses=FILE"),
        (["evaluate", "run=x", "poses=y"], "evaluate takes run=RUN or poses=FILE"),
        (["evaluate", "ran=x"], "Did you mean 'run'?"),
        (["evaluate", "run="], "'run=' has no value"),
        (["evaluate", "poses=x.npz"], "needs data.test=FILE"),
        (["evaluate", "run=x", "skeleton=h36m17"], "the run knows its skeleton"),
        (["evaluate", "run=runs/none"], "No run runs/none"),
        (["predict", "run=x"], "predict needs input="),
        (["predict", "run=RUN", "input=a.npz", "output=a"], "has no extension"),
        (["predict", "run=RUN", "input=a.npz", "output=a.htm"], "Did you mean '.html'?"),
        (["predict", "run=RUN", "input=a.npz", "output=none/a.npz"], "no folder"),
        (["predict", "run=RUN", "input=a.npz", "output=a.h5"], "Name it a.dlc.h5 or a.sleap.h5"),
        (["predict", "run=RUN", "input=a.npz", "output=a.csv", "nwb.sex=F"], "nwb= goes with output=FILE.nwb"),
        (
            ["predict", "run=RUN", "input=a.npz", "output=a.dlc.csv", "csv_safe=true"],
            "csv_safe= goes with output=FILE.csv",
        ),
        (["predict", "run=RUN", "input=a.npz", "output=a.nwb", "nwb.sex=female"], "nwb.sex=female: expected M, F"),
        (["predict", "run=RUN", "input=a.npz", "output=a.nwb", "nwb.specie=mouse"], "Did you mean 'nwb.species'?"),
        (["predict", "run=none", "input=a.npz", "output=b.npz"], "No run none"),
        (["simulate", "skeleton=h36m17"], "simulate needs output="),
        (["simulate", "skeleton=h36m17", "output=a.txt"], "written as .npz or .csv"),
        (["simulate", "skeleton=h36m17", "output=a.csv", "tracker=deeplabcat"], "Did you mean 'deeplabcut'?"),
        (["simulate", "skeleton=h36m17", "output=a.npz", "tracker=deeplabcut"], "are .csv"),
        (
            ["simulate", "skeleton=h36m17", "output=a.csv", "tracker=deeplabcut", "frames=3100", "clip_seconds=0.1"],
            "clip_seconds=30",
        ),
        (["simulate", "skeleton=h36m17", "output=a.npz", "frames=many"], "frames='many', expected a whole number"),
        (["simulate", "skeleton=h36m17", "output=a.npz", "frames=0"], "frames=0"),
        (["simulate", "skeleton=h36m17", "output=a.npz", "seed=-1"], "seed"),
        (["simulate", "skeleton=h36m17", "output=a.npz", "missing=2"], "missing"),
        (["simulate", "skeleton=h36m17", "output=none/a.npz"], "no folder"),
        (["simulate", "skeletons=h36m17", "output=a.npz"], "Did you mean 'skeleton'?"),
        (["compare", "runs/x"], "compare needs two runs"),
        (["compare", "runs/x", "runs/y"], "No run runs/x"),
        (["tasks", "x"], "tasks takes no settings"),
        (["skeletons", "x"], "skeletons takes no settings"),
        (["skeleton"], "expected `uplift skeleton check FILE"),
        (["skeleton", "chek", "x"], "expected `uplift skeleton check FILE"),
        (["skeleton", "check"], "takes one FILE"),
        (["skeleton", "check", "h36m17", "outptu=a.png"], "output"),
        (["skeleton", "check", "none.yaml"], "none.yaml"),
        (["skeleton", "check", "h36m17", "output=a.jpg"], "the drawing is a .png"),
        (["skeleton", "check", "h36m17", "output=none/a.png"], "none"),
        (["skeleton", "new"], "takes one FILE"),
        (["skeleton", "new", "none/a.yaml"], "No folder none"),
    ],
)
def test_wrong_words_are_refused(
    words: list[str], says: str, capsys: pytest.CaptureFixture, fitted: Path, here: Path
) -> None:
    assert says in refusal(capsys, *(word.replace("=RUN", f"={the_runs(fitted)[0]}") for word in words))
    assert not list(here.iterdir())


def test_tasks_and_skeletons_are_listed(capsys: pytest.CaptureFixture, here: Path, monkeypatch) -> None:
    assert main(["tasks"]) == 0
    listed = capsys.readouterr().out
    assert re.search(r"^demo +no data needed", listed, re.M)
    assert re.search(r"^cmu +data missing", listed, re.M)
    (here / "sets" / "cmu").mkdir(parents=True)
    write_body(here / "sets" / "cmu" / "train.npz", 4)
    monkeypatch.setenv("UPLIFT_DATA", str(here / "sets"))
    assert main(["tasks"]) == 0
    assert re.search(r"^cmu +data present", capsys.readouterr().out, re.M)
    assert main(["skeletons"]) == 0
    assert re.search(r"^h36m17 +17 joints", capsys.readouterr().out, re.M)


def test_several_seeds_are_several_runs_with_mean_and_spread(fitted: Path) -> None:
    runs = the_runs(fitted)
    assert len(runs) == 2
    assert {(run / "run.json").read_text().split('"seed": ')[1][0] for run in runs} == {"0", "1"}


def test_compare_puts_runs_side_by_side(fitted: Path, capsys: pytest.CaptureFixture) -> None:
    first, second = the_runs(fitted)
    assert main(["compare", str(first), str(second)]) == 0
    table = capsys.readouterr().out
    assert "test data: b.npz" in table
    assert "seed 0" in table
    assert "seed 1" in table
    assert re.search(r"^p_mpjpe +\d+\.\d+ +\d+\.\d+$", table, re.M)
    (first / "evaluation.json").rename(first / "kept.json")
    assert "was not evaluated" in refusal(capsys, "compare", str(first), str(second))
    (first / "evaluation.json").write_text("{}")
    assert "is not an evaluation" in refusal(capsys, "compare", str(first), str(second))
    (first / "kept.json").rename(first / "evaluation.json")


def test_evaluate_of_a_run_is_what_the_fit_said(fitted: Path, capsys: pytest.CaptureFixture) -> None:
    run = the_runs(fitted)[0]
    before = (run / "evaluation.json").read_text()
    older = len(list((run / "evaluations").iterdir()))
    assert main(["evaluate", f"run={run}"]) == 0
    assert "p_mpjpe" in capsys.readouterr().out
    assert (run / "evaluation.json").read_text() == before
    assert len(list((run / "evaluations").iterdir())) == older + 1
    assert main(["evaluate", f"run={run}", f"data.test={fitted / 'a.npz'}", "evaluation=on-a"]) == 0
    assert json.loads((run / "evaluation.json").read_text())["data"] == "a.npz"
    assert (run / "evaluations/on-a.json").read_text() == (run / "evaluation.json").read_text()
    assert main(["evaluate", f"run={run}", f"data.test={fitted / 'a.npz'}", "camera.tilt_deg=50"]) == 0
    off = np.abs(50 - np.load(fitted / "a.npz")["tilt_deg"])
    assert json.loads((run / "evaluation.json").read_text())["overall"]["elevation_deg"] == pytest.approx(
        np.median(off)
    )
    assert "already" in refusal(capsys, "evaluate", f"run={run}", "evaluation=on-a")
    assert "expected a name" in refusal(capsys, "evaluate", f"run={run}", "evaluation=../a")


def test_compare_takes_the_evaluation_that_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    def table(*words: str) -> list[str]:
        assert main(["compare", "one", "two", *words]) == 0
        return capsys.readouterr().out.split()[-3:]

    for run, errors in {"one": (11, 12, 13), "two": (21, 22, 23)}.items():
        (tmp_path / run / "evaluations").mkdir(parents=True)
        (tmp_path / run / "config.yaml").write_text("seed: 0\n")
        (tmp_path / run / "run.json").write_text("{}")
        for age, (data, name, error) in enumerate(
            zip(("a.npz", "b.npz", "b.npz"), ("old", "zz", "aa"), errors, strict=True)
        ):
            found = tmp_path / run / f"evaluations/{name}.json"
            found.write_text(json.dumps({"data": str(tmp_path / data), "overall": {"mpjpe": error}}))
            os.utime(found, (age, age))
        (tmp_path / run / "evaluation.json").write_text(found.read_text())
    assert table() == table("data.test=b.npz") == ["mpjpe", "13.000", "23.000"]
    assert table("data.test=a.npz") == table("evaluation=old") == ["mpjpe", "11.000", "21.000"]
    assert table("evaluation=zz,old.json") == ["mpjpe", "12.000", "21.000"]
    for words, says in {
        ("data.test=c.npz",): "was not evaluated on c.npz (but on",
        ("evaluation=odl",): "Did you mean 'old'?",
        ("evaluation=old,zz,aa",): "3 names for 2 runs",
        ("evaluation=old", "data.test=a.npz"): "Give one of them",
        ("evaluations=old",): "Did you mean 'evaluation'?",
    }.items():
        assert says in refusal(capsys, "compare", "one", "two", *words)


def test_evaluate_of_predicted_poses_is_that_of_the_run(fitted: Path, here: Path, capsys) -> None:
    run, poses = the_runs(fitted)[1], here / "poses.npz"
    assert main(["predict", f"run={run}", f"input={fitted / 'b.npz'}", f"output={poses}"]) == 0
    capsys.readouterr()
    assert main(["evaluate", f"poses={poses}", f"data.test={fitted / 'b.npz'}"]) == 0
    figure = re.search(r"p_mpjpe\s+([\d.]+)", capsys.readouterr().out).group(1)
    assert f'"p_mpjpe": {figure[:-1]}' in (run / "evaluation.json").read_text()
    assert not list(here.glob("runs"))


def test_an_nwb_says_what_the_command_said(fitted: Path, here: Path, capsys) -> None:
    h5py, _ = pytest.importorskip("h5py"), pytest.importorskip("ndx_pose")
    words = ["predict", f"run={the_runs(fitted)[1]}", f"input={fitted / 'b.npz'}", "output=poses.nwb", "fps=10"]
    assert main([*words, "nwb.species=Homo sapiens", "nwb.session_start_time=2026-05-01T10:30"]) == 0
    assert "not known: sex, age; say it by nwb.sex=" in capsys.readouterr().out
    for file in here.glob("poses*.nwb"):
        with h5py.File(file) as found:
            assert found["general/subject/species"].asstr()[()] == "Homo sapiens"
            assert found["session_start_time"].asstr()[()].startswith("2026-05-01T10:30")


@pytest.mark.parametrize("name", ["poses.npz", "poses.html"])
def test_nothing_is_overwritten_by_predict(fitted: Path, here: Path, name: str, capsys) -> None:
    words = ["predict", f"run={the_runs(fitted)[0]}", f"input={fitted / 'b.npz'}", f"output={name}"]
    (here / name).write_text("mine")
    assert "is not overwritten" in refusal(capsys, *words)
    assert (here / name).read_text() == "mine"
    (here / name).unlink()
    assert main(words) == 0
    assert (here / name).stat().st_size > 1000


def test_nothing_is_overwritten_by_simulate(here: Path, capsys: pytest.CaptureFixture) -> None:
    words = ["simulate", "skeleton=h36m17", "output=a.npz", "frames=20"]
    assert main(words) == 0
    made = (here / "a.npz").read_bytes()
    assert "is not overwritten" in refusal(capsys, *words)
    assert (here / "a.npz").read_bytes() == made
    assert status_of("fit", "skeleton=h36m17", "data.train=a.npz", *QUICK, "trainer.max_steps=2") == 0


def test_nothing_is_overwritten_by_skeleton(here: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["skeleton", "new", "beetle"]) == 0
    text = (here / "beetle.yaml").read_text()
    for name in ("beetle", "beetle.yaml"):
        assert "is not overwritten" in refusal(capsys, "skeleton", "new", name)
    assert (here / "beetle.yaml").read_text() == text
    assert main(["skeleton", "check", "beetle.yaml"]) == 0
    assert main(["skeleton", "check", "beetle.yaml"]) == 0
    assert len(list(here.glob("*.png"))) == 2
    (here / "a.png").write_text("mine")
    assert "is not overwritten" in refusal(capsys, "skeleton", "check", "beetle.yaml", "output=a.png")
    assert (here / "a.png").read_text() == "mine"


def test_unliftable_frames_keep_their_rows(fitted: Path, here: Path, capsys: pytest.CaptureFixture) -> None:
    keypoints = body_arrays(9)["keypoints"]
    keypoints[2, 1:] = np.nan
    keypoints[5] = 40
    write_body(here / "a.npz", 9, keypoints=keypoints)
    for name in ("poses.npz", "poses.html"):
        assert main(["predict", f"run={the_runs(fitted)[0]}", "input=a.npz", f"output={name}"]) == 0
    assert "2 of 9 frames cannot be lifted" in capsys.readouterr().out
    with np.load("poses.npz") as found:
        blank = np.isnan(found["pose"]).all((1, 2))
        np.testing.assert_array_equal(np.flatnonzero(blank), [2, 5])
        assert np.isfinite(found["pose"][~blank]).all()
        assert list(found["sequence"]) == list(body_arrays(9)["sequence"])


def test_a_fit_tells_what_it_dropped_and_filled(here: Path, capsys: pytest.CaptureFixture) -> None:
    confidence = np.full((60, 17), 0.03, np.float32)
    confidence[:6, 2:] = 0
    confidence[6:9, 0] = 0
    words = own_data(here / "a.npz", confidence=confidence)
    assert status_of("fit", *words, "trainer.max_steps=3") == 0
    printed = capsys.readouterr().out
    assert "6 of 60 frames dropped: fewer than 3 visible joints" in printed
    assert "3 frames had no root joint: filled from its visible neighbours" in printed
    assert "6 of 60 frames dropped" in (here / "runs/h36m17/last/report.md").read_text()


def test_the_demo_needs_no_data_and_may_be_quiet(here: Path, capsys: pytest.CaptureFixture) -> None:
    words = ["task=demo", "data.simulate=200", *QUICK, "trainer.max_steps=3"]
    assert status_of("fit", "--quiet", *words) == 0
    said, run = capsys.readouterr(), (here / "runs/demo/last").resolve().relative_to(here)
    assert said.out == f"wrote {run}/: lifter.pt, report.md, page.html, evaluation.json\n"
    assert re.fullmatch(r"WARNING: a short fit: 3 steps.*\n", said.err)
    assert "p_mpjpe" in (run / "evaluation.json").read_text()
    page = (run / "page.html").read_text()
    assert (
        "Joint error, aligned<small>p_mpjpe · mm, lower is better</small>" in page and "there are no curves" not in page
    )


def test_quiet_leaves_what_was_written_and_answers(fitted: Path, here: Path, capsys: pytest.CaptureFixture) -> None:
    run, b = the_runs(fitted)[1], fitted / "b.npz"
    for words, wrote in {
        ("simulate", "skeleton=h36m17", "output=s.npz", "frames=20", "-q"): "s.npz",
        ("-q", "skeleton", "new", "new.yaml"): "new.yaml",
        ("predict", "--quiet", f"run={run}", f"input={b}", "output=poses.npz"): "poses.npz",
        ("evaluate", f"run={run}", "-q"): f"{run}/evaluation.json",
    }.items():
        assert main(list(words)) == 0
        said = capsys.readouterr()
        assert said.out.startswith(f"wrote {wrote}") and said.out.count("\n") == 1
        assert all("WARNING" in line for line in said.err.splitlines())
    assert main(["-q", "data", "check", "task=demo"]) == 0
    assert "no files needed" in capsys.readouterr().out
    assert "did you mean" in refusal(capsys, "predict", "-q", f"run={run}", f"input={b}", "outptu=a.npz").lower()
    assert main(["simulate", "skeleton=h36m17", "output=t.npz", "frames=20"]) == 0
    assert "simulated 20 frames" in capsys.readouterr().out


def test_a_name_that_is_too_long_is_the_users_mistake(capsys: pytest.CaptureFixture) -> None:
    assert "File name too long" in refusal(capsys, "fit", "skeleton=h36m17", f"data.train={'a' * 300}.npz")


@pytest.mark.parametrize(
    ("words", "twice"),
    [
        (("fit", "task=demo", "seed=1", "seed=2"), ("seed=1", "seed=2")),
        (("fit", "task=demo", "task=cmu"), ("task=demo", "task=cmu")),
        (("fit", "resume=a", "resume=b"), ("resume=a", "resume=b")),
        (("evaluate", "run=a", "items=3", "items=4"), ("items=3", "items=4")),
        (("predict", "run=a", "run=b", "input=a.npz", "output=b.npz"), ("run=a", "run=b")),
        (("simulate", "skeleton=h36m17", "output=a.npz", "frames=50", "frames=60"), ("frames=50", "frames=60")),
        (("skeleton", "check", "h36m17", "output=a.png", "output=b.png"), ("output=a.png", "output=b.png")),
        (("skeleton", "new", "a", "from=a.csv", "from=b.csv"), ("from=a.csv", "from=b.csv")),
        (("skeleton", "map", "a", "skeleton=h36m17", "skeleton=coco17"), ("skeleton=h36m17", "skeleton=coco17")),
        (("data", "check", "task=cmu", "task=demo"), ("task=cmu", "task=demo")),
        (("data", "cmu", "folder", "output=a", "output=b"), ("output=a", "output=b")),
        (("data", "render", "chairs", "output=a.npz", "side=8", "side=16"), ("side=8", "side=16")),
    ],
)
def test_a_key_given_twice_is_refused(words: tuple[str, ...], twice: tuple[str, str], capsys) -> None:
    assert main(words) == 2
    message = capsys.readouterr().err
    assert f"'{twice[0].partition('=')[0]}' is given twice: {twice[0]} and {twice[1]}. Keep one." in message
