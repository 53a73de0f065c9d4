"""Tasks and overrides: what is read, what is refused, and what the message says."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest
import yaml
from bodies import refusal
from lightning.pytorch.callbacks import Timer

from uplift.config.files import shipped_names
from uplift.config.loading import load_settings, read_task, save_settings, setting_names, settings_from, task_path
from uplift.config.settings import RENAMED, all_settings, seconds_of
from uplift.config.yaml_file import read_value
from uplift.errors import UserError
from uplift.training.stages import stage_budgets


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def complaint(*overrides: str, task: str | None = None) -> str:
    with pytest.raises(UserError) as caught:
        load_settings(task, overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", shipped_names("tasks"))
def test_every_shipped_task_is_whole(name: str) -> None:
    settings = load_settings(name)
    assert settings.task == name
    assert settings.description
    assert settings.skeleton or settings.lifts == "masks" or name == "default"


@pytest.mark.parametrize("name", shipped_names("tasks"))
def test_saved_settings_are_a_task_with_the_same_settings(name: str, here: Path) -> None:
    settings = load_settings(name, ["trainer.max_steps=7", "priors.ground.use=my.py:Ground", "data.get=${HOME}"])
    save_settings(settings, here / "again.yaml")
    again = load_settings("again.yaml")
    again.task = settings.task
    assert again == settings
    assert settings.data.get == "${HOME}"


@pytest.mark.parametrize(
    ("override", "read"),
    [
        ("trainer.max_time=1:00:00", lambda s: s.trainer.max_time == "1:00:00"),
        ("trainer.max_steps=null", lambda s: s.trainer.max_steps is None),
        ("teacher.learning_rate=1e-3", lambda s: s.teacher.learning_rate == 1e-3),
        ("teacher.average=null", lambda s: s.teacher.average is None),
        ("teacher.mirror=false", lambda s: s.teacher.mirror is False),
        ("seed=12", lambda s: s.seed == 12),
        ("trainer.devices=1", lambda s: s.trainer.devices == "1"),
        ("trainer.precision=32", lambda s: s.trainer.precision == "32"),
        ("data.name=007", lambda s: s.data.name == "007"),
        ("data.select.subjects=S1,S2", lambda s: s.data.select.subjects == ["S1", "S2"]),
        ("data.select.subjects=[S1, 'S2']", lambda s: s.data.select.subjects == ["S1", "S2"]),
        ("data.select.subjects=01", lambda s: s.data.select.subjects == ["01"]),
        ("data.select.actions=sit down,yes", lambda s: s.data.select.actions == ["sit down", "yes"]),
        ("data.select.subjects=", lambda s: s.data.select.subjects == []),
        ("data.select.fraction=0.2", lambda s: s.data.select.fraction == 0.2),
        ("views.azimuth_deg=-90,90", lambda s: tuple(s.views.azimuth_deg) == (-90, 90)),
        ("views.azimuth_deg=[-90, 90]", lambda s: tuple(s.views.azimuth_deg) == (-90, 90)),
        ("priors.ground.weight=1e-3", lambda s: s.priors["ground"] == {"weight": 1e-3}),
        ("priors.ground.joints=[hip, nose]", lambda s: s.priors["ground"]["joints"] == ["hip", "nose"]),
        ("priors.ground.planar=false", lambda s: s.priors["ground"]["planar"] is False),
        ("priors.ground.when=00:10:00", lambda s: s.priors["ground"]["when"] == "00:10:00"),
        ("priors.ground.text=${x}", lambda s: s.priors["ground"]["text"] == "${x}"),
        ("lifter.options.units=16", lambda s: s.lifter.options["units"] == 16),
        ("skeleton=h36m17", lambda s: s.skeleton == "h36m17"),
    ],
)
def test_an_override_is_read_as_its_setting_wants_it(override: str, read) -> None:
    assert read(load_settings(None, [override]))


@pytest.mark.parametrize("words", [("seed=1", "seed=2"), ("priors.flow.weight=1", "seed=1", "priors.flow.weight=1")])
def test_a_key_given_twice_is_refused(words: tuple[str, ...]) -> None:
    key = words[0].partition("=")[0]
    assert f"'{key}' is given twice: {words[0]} and {words[-1]}" in complaint(*words)


def test_paths_of_overrides_are_relative_to_the_current_folder(here: Path) -> None:
    settings = load_settings(
        None,
        ["data.train=a.npz", "data.test=sub/b.npz", "data.root=own", "init=runs/x", "skeleton=my.yaml"]
        + ["priors.ground.use=my.py:Ground", "lifter.network=net.py:Net"],
    )
    assert settings.data.train == str(here / "a.npz")
    assert settings.data.test == str(here / "sub/b.npz")
    assert settings.data.root == str(here / "own")
    assert settings.init == str(here / "runs/x")
    assert settings.skeleton == str(here / "my.yaml")
    assert settings.priors["ground"]["use"] == f"{here / 'my.py'}:Ground"
    assert settings.lifter.network == f"{here / 'net.py'}:Net"


def test_paths_of_a_task_file_are_relative_to_it(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "base.yaml").write_text("skeleton: my.yaml\npriors: {ground: {use: 'my.py:Ground'}}\n")
    (here / "mine" / "top.yaml").write_text("extends: base.yaml\ndata: {train: a.npz, root: sub}\nseed: 3\n")
    settings = load_settings("mine/top.yaml")
    assert settings.skeleton == str(here / "mine" / "my.yaml")
    assert settings.priors["ground"]["use"] == f"{here / 'mine' / 'my.py'}:Ground"
    assert (settings.data.train, settings.data.root) == ("a.npz", str(here / "mine" / "sub"))
    assert (settings.task, settings.seed) == ("top", 3)


def test_extends_chains_and_merges(here: Path) -> None:
    (here / "a.yaml").write_text("extends: cmu\nteacher: {share: 0.5}\npriors: {flow: {weight: 2}}\n")
    (here / "b.yaml").write_text("extends: a.yaml\npriors: {flow: {units: 64}, bones: {weight: 0}}\n")
    settings, cmu = load_settings("b.yaml"), load_settings("cmu")
    assert settings.data == cmu.data
    assert settings.teacher.share == 0.5
    assert settings.priors["flow"] == {**cmu.priors["flow"], "weight": 2, "units": 64}
    assert settings.priors["bones"]["weight"] == 0


def test_durations_need_no_quotes_in_a_task_file(here: Path) -> None:
    (here / "a.yaml").write_text("trainer: {max_time: 1:30:00}\ndata: {select: {subjects: [01, 017]}}\n")
    settings = load_settings("a.yaml")
    assert settings.trainer.max_time == "1:30:00"
    assert settings.data.select.subjects == ["01", "017"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("extends: a.yaml\n", "extend one another. Is there a circle?"),
        ("extends: nothing\n", "No task 'nothing'"),
        ("extends: other.yaml\n", "No task file"),
        ("extends: [cmu]\n", "line 1: 'extends' is ['cmu'], expected a task or a file"),
        ("traner: {max_steps: 3}\n", "line 1: unknown setting 'traner'. Did you mean 'trainer'?"),
        (
            "seed: 1\ntrainer:\n  max_step: 3\n",
            "line 3: unknown setting 'trainer.max_step'. Did you mean 'trainer.max_steps'?",
        ),
        ("trainer: 5\n", "'trainer' is 5, expected settings below it"),
        ("trainer:\n", "'trainer' is None, expected settings below it"),
        ("seed: many\n", "seed"),
        ("priors: [critic]\n", "priors"),
        ("priors: {critic: 2}\n", "priors.critic is 2, expected settings"),
        ("- a\n", "expected settings as `key: value`"),
        ("", "the file is empty"),
        ("seed: 1\nseed: 2\n", "the key 'seed' twice"),
        ("trainer: {max_time: {minuts: 2}}\n", "expected seconds, hours:minutes:seconds such as 00:10:00, or units"),
        ("trainer: {max_time: [1, 2]}\n", "trainer.max_time"),
    ],
)
def test_a_wrong_task_file(here: Path, content: str, says: str) -> None:
    (here / "a.yaml").write_text(content)
    message = complaint(task="a.yaml")
    assert says in message
    assert "a.yaml" in message or "line" not in says


def test_a_circle_of_two(here: Path) -> None:
    (here / "a.yaml").write_text("extends: b.yaml\n")
    (here / "b.yaml").write_text("extends: a.yaml\n")
    assert "Is there a circle?" in complaint(task="a.yaml")


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("traner.max_steps=3", "'traner.max_steps=3': unknown setting 'traner'. Did you mean 'trainer'?"),
        ("trainer.max_step=3", "Did you mean 'trainer.max_steps'?"),
        ("teacher.learning-rate=3", "Did you mean 'teacher.learning_rate'?"),
        ("resum=runs/x", "Did you mean 'resume'?"),
        ("max_steps=3", "unknown setting 'max_steps'"),
        ("demo", "Did you mean task=demo?"),
        ("=3", "expected key=value"),
        (".=3", "unknown setting"),
        ("trainer..max_steps=3", "unknown setting 'trainer.'"),
        ("trainer=5", "'trainer' holds settings: set one of them. Valid: trainer.max_time"),
        ("trainer={max_steps: 5}", "'trainer' holds settings"),
        ("trainer.max_steps.now=5", "'trainer.max_steps' is one setting, with none below it"),
        ("trainer.max_steps=many", "trainer.max_steps"),
        ("trainer.max_steps=1.5", "trainer.max_steps"),
        ("trainer.max_steps=0", "trainer.max_steps=0: expected a number of at least 1"),
        ("trainer.max_time=10m", "trainer.max_time='10m': expected seconds, hours:minutes:seconds"),
        ("trainer.max_time=00:10", "expected seconds, hours:minutes:seconds"),
        ("trainer.max_time=0", "no time to train in"),
        ("trainer.max_time=inf", "expected seconds"),
        ("trainer.max_time=99999999999999:00:00", "expected at most 1e+09 seconds"),
        ("trainer.max_time=00:00:00", "no time to train in"),
        ("trainer.max_time=-1:00:00", "expected seconds"),
        ("trainer.max_time=null", "the fit would never end"),
        ("trainer.threads=0", "trainer.threads=0"),
        ("trainer.threads=100000", "expected a number from 1 to 1,024"),
        ("trainer.checkpoint_every=-1", "trainer.checkpoint_every"),
        ("teacher.share=0", "teacher.share is 0"),
        ("teacher.share=inf", "teacher.share=inf"),
        ("student.share=nan", "student.share=nan"),
        ("student.rounds=", "student.rounds is empty"),
        ("student.rounds=0,1", "student.rounds[0]=0.0"),
        ("teacher.batch_size=1", "teacher.batch_size=1"),
        ("teacher.learning_rate=0", "teacher.learning_rate=0"),
        ("teacher.learning_rate=fast", "teacher.learning_rate"),
        ("teacher.prior_learning_rate=-1", "teacher.prior_learning_rate=-1"),
        ("teacher.weight_decay=-1", "teacher.weight_decay=-1"),
        ("teacher.decay_from=nan", "teacher.decay_from=nan"),
        ("teacher.average=1", "teacher.average=1"),
        ("teacher.mirror=maybe", "teacher.mirror"),
        ("views.azimuth_deg=1,2,3", "views.azimuth_deg"),
        ("views.azimuth_deg=a,b", "views.azimuth_deg"),
        ("views.azimuth_deg=0,nan", "views.azimuth_deg[1]=nan"),
        ("views.elevation=bach", "Did you mean 'batch'?"),
        ("lifter.tilt=xx", "lifter.tilt='xx': expected one of predicted, learned, level."),
        ("lifter.tilt=levle", "lifter.tilt='levle': expected one of predicted, learned, level. Did you mean 'level'?"),
        ("lifter.distance=1", "lifter.distance=1"),
        ("lifter.options=3", "lifter.options"),
        ("data.simulate=-1", "data.simulate=-1"),
        ("data.select.subjects=[S1", "a bracket is missing"),
        ("data.select=S1", "'data.select' holds settings"),
        ("data.select.fraction=half", "data.select.fraction"),
        ("seed=-1", "seed=-1: expected a number from 0 to 2,147,483,647"),
        ("seed=1.5", "seed"),
        ("seed=", "seed"),
        ("priors=3", "priors"),
        ("priors.flow=3", "priors.flow is 3, expected settings"),
        ("priors.flow.weight.x=3", "'weight' is not a group of settings"),
        ("priors.x.y=!!python/object/apply:os.getcwd []", "YAML tag"),
        ("priors.x.y=" + "[" * 200, "nested more than"),
        ("priors.x.y=" + "9" * 400, "a whole number of 400 digits"),
        ("teacher.beta1=" + "9" * 400, "a whole number of 400 digits"),
        ("priors.x.y=&a [*a]", "alias"),
        ('priors.x.y=!!int ""', "not a valid int"),
        ('trainer.max_steps=!!float ""', "not a valid float"),
    ],
)
def test_a_wrong_override(override: str, says: str) -> None:
    assert says in complaint(override)


def test_no_such_task() -> None:
    assert "No task 'cmuu'. Did you mean 'cmu'?" in complaint(task="cmuu")
    assert "No task file none.yaml" in complaint(task="none.yaml")
    assert "default" not in complaint(task="nothing like it").split("Valid:")[-1]
    assert task_path("cmu").is_file()


def test_every_setting_is_named_and_known() -> None:
    names = setting_names()
    assert "trainer.max_time" in names
    assert "data.select.subjects" in names
    assert len(names) == len(set(names))
    assert all(name.startswith("views.") for name in setting_names("views."))


def test_every_setting_describes_itself() -> None:
    for name, setting in all_settings().items():
        assert setting.name == name
        assert setting.help
        assert (setting.low is None) == (setting.high is None)
    assert all_settings()["shape.parts"].only == all_settings()["data.side"].only == "masks"
    assert all_settings()["data.select.subjects"].only == "keypoints"
    assert all_settings()["lifter.refine.smooth"].default == 1.0


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("00:10:00", 600), ("1:00:00", 3600), ("00:00:20.5", 20.5), ("01:00:00:00", 86400), ("90", 90), ("1.5", 1.5),
        ("{minutes: 1, seconds: 30}", 90), ("{days: 1, hours: 1}", 90_000),
    ],
)  # fmt: skip
def test_max_time_is_read(text: str, seconds: float, here: Path) -> None:
    (here / "a.yaml").write_text(f"trainer: {{max_time: {text}}}\n")
    (here / "b.yaml").write_text("extends: a.yaml\nseed: 2\n")
    as_word = load_settings(None, [f"trainer.max_time={text}"])
    for settings in (as_word, load_settings("b.yaml"), settings_from({"trainer": {"max_time": read_value(text)}})):
        assert seconds_of(settings.trainer.max_time) == seconds
    times = stage_budgets(as_word.trainer, [1.0, 3.0], 100, 10)
    assert [one.seconds for one in times] == [seconds / 4, 3 * seconds / 4]


def test_max_time_is_what_lightning_takes() -> None:
    for given in ("00:00:01:30", {"minutes": 1, "seconds": 30}, timedelta(seconds=90)):
        assert seconds_of(given) == Timer(given).time_remaining("train") == 90


@pytest.mark.parametrize(
    "payload",
    [
        "!!python/object/apply:pathlib.Path.touch [{path}]",
        "!!python/object/new:os.system [touch {path}]",
        "!!python/name:os.system",
        "!!python/module:os",
        "!<tag:yaml.org,2002:python/object/apply:os.system> [touch {path}]",
    ],
)
@pytest.mark.parametrize("as_file", [True, False])
def test_yaml_tags_never_run(payload: str, as_file: bool, here: Path, capsys: pytest.CaptureFixture) -> None:
    marker = here / "marker"
    text = payload.format(path=marker)
    (here / "a.yaml").write_text(f"seed: 1\ndata:\n  select:\n    subjects:\n    - {text}\n")
    word = "task=a.yaml" if as_file else f"priors.ground.height={text}"
    message = refusal(capsys, "fit", word)
    assert "YAML tag" in message
    assert "line 5" in message or not as_file
    assert not marker.exists()


def test_a_task_file_is_plain_data(here: Path) -> None:
    settings = load_settings("cmu")
    save_settings(settings, here / "a.yaml")
    assert yaml.safe_load((here / "a.yaml").read_text())["skeleton"] == "h36m17"
    assert read_task(here / "a.yaml")["data"]["name"] == "cmu"


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_a_renamed_setting_names_the_new_one(old: str, new: str, here: Path) -> None:
    says = f"the setting '{old}' is now called '{new}'"
    assert says in complaint(f"{old}=1")
    *groups, key = old.split(".")
    (here / "a.yaml").write_text(
        "seed: 1\n" + "".join(f"{group}: {{" for group in groups) + f"{key}: 1{'}' * len(groups)}"
    )
    assert f"a.yaml, line 2: {says}" in complaint(task="a.yaml")


def test_the_settings_of_a_run_before_a_renaming_are_read(here: Path) -> None:
    (here / "config.yaml").write_text("lifts: masks\nshape: {hot: 0.3, cold: 0.05, parts: 2}\n")
    shape = load_settings("config.yaml").shape
    assert (shape.temperature_start, shape.temperature_end, shape.parts) == (0.3, 0.05, 2)


def test_a_run_of_version_0_1_is_still_read(here: Path) -> None:
    (here / "config.yaml").write_text("data: {select: {subject: [S1], camera: []}, hold_out: {action: [walk]}}\n")
    settings = load_settings("config.yaml")
    assert settings.data.select.subjects == ["S1"]
    assert settings.data.hold_out.actions == ["walk"]
