"""The run folder: what is in it, how it is found, and that nothing of a user's is overwritten."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import pytest
from bodies import own_data, refusal, status_of, write_body

from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.errors import UserError


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    return tmp_path


def made(task: str = "demo", *overrides: str) -> RunFolder:
    run = RunFolder.create(load_settings(task, overrides), f"uplift fit task={task}")
    run.link_last()
    return run


def test_a_run_that_kept_nothing_is_removed_and_last_stays(here: Path) -> None:
    kept = made()
    (kept.checkpoints / "teacher.ckpt").write_bytes(b"x")
    empty = RunFolder.create(load_settings("demo"), "uplift fit task=demo")
    assert (here / "runs/demo/last").resolve() == here / kept.path
    empty.discard_if_empty()
    kept.discard_if_empty()
    assert not empty.path.exists()
    assert kept.path.exists()


def test_nothing_of_a_users_is_removed_or_replaced(here: Path) -> None:
    """Neither a resumed run's folder, nor notes in a new one, nor a file called last."""
    noted = made()
    (noted.path / "notes.txt").write_text("mine")
    noted.discard_if_empty()
    assert (noted.path / "notes.txt").read_text() == "mine" and noted.config.is_file()
    resumed = RunFolder.open(made().path)
    resumed.discard_if_empty()
    assert resumed.config.is_file()
    for other in ("file", "folder"):
        run = RunFolder.create(load_settings("rat"), "uplift fit task=rat")
        last = run.path.with_name("last")
        if other == "file":
            last.write_text("mine")
        else:
            last.unlink()
            last.mkdir()
        run.link_last()
        assert not last.is_symlink() and (last.is_dir() or last.read_text() == "mine")


def test_what_a_run_was_made_with(here: Path) -> None:
    run = made("demo", "seed=3", "trainer.max_steps=5")
    assert run.path.parent == Path("runs/demo")
    facts = run.facts()
    assert (facts["task"], facts["seed"], facts["command"]) == ("demo", 3, "uplift fit task=demo")
    assert facts["versions"]["torch"]
    assert facts["cores"] >= 1
    settings = run.settings()
    assert (settings.task, settings.seed, settings.trainer.max_steps) == ("demo", 3, 5)
    assert (here / "runs/demo/last").resolve() == (here / run.path)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
@pytest.mark.parametrize("step", ["save_settings", "_facts"])
def test_a_run_that_was_not_made_to_its_end_leaves_nothing(
    here: Path, monkeypatch: pytest.MonkeyPatch, step: str, error: BaseException
) -> None:
    """A folder of a run is there with all that resuming needs, or not at all."""

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(f"uplift.config.run.{step}", fail)
    with pytest.raises(type(error)):
        RunFolder.create(load_settings("demo"), "uplift fit task=demo")
    assert os.listdir(here / "runs/demo") == []


def test_two_runs_in_one_second_are_two_runs(here: Path) -> None:
    paths = [made().path for _ in range(4)]
    assert len(set(paths)) == 4
    assert (here / "runs/demo/last").resolve().name == paths[-1].name


def test_a_run_is_found_by_its_path_and_by_last(here: Path) -> None:
    run = made()
    for name in (run.path, here / run.path, "runs/demo/last", "runs/demo"):
        assert RunFolder.open(name).path == here / run.path


def test_a_run_finds_its_data_from_any_folder(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uplift.data.load import find_data

    (here / "sets" / "cmu").mkdir(parents=True)
    for name in ("train.npz", "test.npz"):
        write_body(here / "sets" / "cmu" / name)
    monkeypatch.setenv("UPLIFT_DATA", "sets")
    run = RunFolder.open(made("cmu").path)
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    monkeypatch.delenv("UPLIFT_DATA")
    assert find_data(run.settings(), "test") == here / "sets/cmu/test.npz"


def test_no_such_run(here: Path) -> None:
    with pytest.raises(UserError, match="There are no runs here yet"):
        RunFolder.open("runs/demo/last")
    made()
    with pytest.raises(UserError, match="No run runs/demo/lost"):
        RunFolder.open("runs/demo/lost")
    (here / "stuff").mkdir()
    with pytest.raises(UserError, match="stuff is not a run: it has no config.yaml"):
        RunFolder.open("stuff")
    write_body(here / "a.npz")
    with pytest.raises(UserError, match="is not a run"):
        RunFolder.open("a.npz")


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"3"])
def test_damaged_facts_and_evaluations_are_named(content: bytes) -> None:
    run = made()
    for name, read in (("run.json", run.facts), ("evaluation.json", run.evaluation)):
        (run.path / name).write_bytes(content)
        with pytest.raises(UserError, match=name):
            read()


@pytest.mark.parametrize(
    "found",
    [
        {"overall": {}}, {"data": "a", "overall": []}, {"data": ["a"], "overall": {}}, {"data": "a", "overall": {"b": "c"}},
        {"data": "a", "overall": {"b": None}},
    ],
)  # fmt: skip
def test_an_evaluation_without_its_parts_is_named(found: dict) -> None:
    run = made()
    assert run.evaluation() is None
    (run.path / "evaluation.json").write_text(json.dumps(found))
    with pytest.raises(UserError, match="is not an evaluation"):
        run.evaluation()


@pytest.mark.parametrize("found", [{"task": 3}, {"steps": [1]}, {"steps": {"teacher": "many"}}])
def test_facts_of_other_kinds_are_named(found: dict) -> None:
    run = made()
    (run.path / "run.json").write_text(json.dumps(found))
    with pytest.raises(UserError, match=r"run\.json"):
        run.facts()


@pytest.mark.parametrize("place", ["runs", "runs/demo"])
def test_something_else_in_the_place_of_the_runs(here: Path, place: str) -> None:
    (here / place).parent.mkdir(exist_ok=True)
    (here / place).write_text("mine")
    with pytest.raises(UserError, match="something else is in its place"):
        made()
    assert (here / place).read_text() == "mine"
    (here / place).unlink()
    (here / place).symlink_to("nowhere")
    with pytest.raises(UserError, match="something else is in its place"):
        made()


def test_a_folder_called_last_is_left_alone(here: Path) -> None:
    (here / "runs/demo/last").mkdir(parents=True)
    (here / "runs/demo/last/mine.txt").write_text("mine")
    run = made()
    assert (here / "runs/demo/last/mine.txt").read_text() == "mine"
    assert not list((here / "runs/demo").glob(".last*"))
    assert run.config.is_file()


def test_a_run_folder_that_cannot_be_written(here: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """As root every folder can be written, so the system's refusal is played back."""

    def refuse(self: Path, *rest: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    words = own_data(here / "a.npz")
    monkeypatch.setattr(Path, "mkdir", refuse)
    message = refusal(capsys, "fit", *words)
    assert "Permission denied (runs" in message


def test_the_end_of_a_fit_names_a_run_that_is_there(here: Path, capsys: pytest.CaptureFixture) -> None:
    (here / "runs/h36m17/last").mkdir(parents=True)
    train = own_data(here / os.fsdecode(b"caf\xe9.npz"))  # its name is in no text
    assert status_of("fit", *train, "student.share=0", "trainer.max_steps=1") == 0
    printed = capsys.readouterr().out
    (run,) = [path for path in Path("runs/h36m17").iterdir() if path.name != "last"]
    assert f"uplift predict run={run} " in printed
    assert "caf\\udce9.npz" in (run / "report.md").read_text("utf-8")
    assert os.fsencode(RunFolder.open(run).settings().data.train or "").endswith(b"/caf\xe9.npz")


def test_a_short_fit_and_an_idle_prior_are_said_everywhere(here: Path, capsys: pytest.CaptureFixture) -> None:
    """In what the fit prints, its report and page, and again where it predicts; labels are named only where there are any."""
    (here / "idle.py").write_text(
        "import uplift\nclass Idle(uplift.Prior):\n    def loss(self, lift):\n        return 0 * lift.pose.sum()\n"
    )
    assert status_of("fit", *own_data(here / "a.npz"), "priors.mine.use=idle.py:Idle") == 0
    run = RunFolder.open("runs/h36m17").path
    expected = "a short fit: 10 steps, 0.1 % of the 10,000 of a usual fit"
    idle = "priors.mine had no gradient in any of 4 steps"
    printed, report = capsys.readouterr().out, (run / "report.md").read_text()
    for text in (printed, report, (run / "page.html").read_text()):
        assert expected in text and text.count("no gradient") == text.count(idle) == 1
    assert "- teacher: " in report and "4 steps" in report and "6 steps" in report
    assert "Priors (weight): flow" in report and "labelled" not in report
    assert RunFolder(run).facts()["steps"] == {"teacher": 4, "student_1": 6}
    assert status_of("predict", f"run={run}", "input=a.npz", "output=poses.npz") == 0
    assert expected in capsys.readouterr().out
    RunFolder(run).add_facts(steps={"teacher": 400, "student_1": 700}, idle_priors={})
    assert RunFolder(run).warnings() == []
    assert status_of("fit", *own_data(here / "a.npz"), "data.labelled.fraction=0.5") == 0
    assert "labelled 40" in (RunFolder.open("runs/h36m17").path / "report.md").read_text()


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ('{"versions": []}', "'versions' is not a value for each name"),
        ('{"task": 3}', "'task' is not text"),
        ('{"command": ["uplift"]}', "'command' is not text"),
        ('{"steps": [1]}', "'steps' is not a value for each name"),
        ('{"idle_priors": {"mine": "many"}}', "'idle_priors' are {'mine': 'many'}, expected whole numbers"),
        ("[]", "holds list"),
    ],
)
def test_facts_that_no_fit_writes_are_refused(facts: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(facts)
    with pytest.raises(UserError, match=re.escape(says)):
        RunFolder(tmp_path).facts()
