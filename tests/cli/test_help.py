"""`--help`: it says what the code accepts, of every verb, group, setting and class, and starts at once."""

from __future__ import annotations

import re
import subprocess
import sys
import typing
from pathlib import Path

import pytest
from bodies import refusal

from uplift.cli.help import option_settings, value_text
from uplift.cli.main import _RUN, _complete, main
from uplift.cli.verbs import NEEDED, VERBS
from uplift.config.loading import load_settings
from uplift.config.plugins import find_class
from uplift.config.settings import PRIOR_SETTINGS, TRAINER_FLAGS, Setting, all_groups, all_settings
from uplift.data.datasets import DATA_SETS
from uplift.models.networks import NETWORKS
from uplift.priors import PRIORS

pytestmark = pytest.mark.usefixtures("here")

PRIOR = '''
from torch import nn

import uplift

class Flat(uplift.Prior):
    """The feet rest on one plane.

    More about it.

    Args:
        skeleton: of the poses.
        slack: what costs nothing,
            in radii.
    """

    def __init__(self, skeleton, *, slack=0.05, feet=("rankle",), strict):
        super().__init__(skeleton)

class Net(nn.Module):
    """A network.

    Args:
        width (int): of the layers.
    """

    def __init__(self, inputs, outputs, *, width=3, **rest):
        super().__init__()

class Thing:
    pass
'''


@pytest.fixture(autouse=True)
def eighty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def shown(capsys: pytest.CaptureFixture, *words: str) -> str:
    assert main(list(words)) == 0
    return capsys.readouterr().out


def entries(text: str) -> dict[str, str]:
    """Return the entries of a help text: the name and all that is said of it, in one line."""
    found: dict[str, str] = {}
    for start in re.finditer(r"^  (\S+)(.*(?:\n {8,}.*)*)$", text, re.M):
        found[start[1]] = " ".join(start[2].split())
    return found


def says(entry: str, one: Setting) -> bool:
    """Return whether an entry has the type, range, choices and default of a setting."""
    facts = re.search(r"\[([^]]*(?:\[[^]]*\])?[^]]*)\]$", entry)
    assert facts, entry
    accepts, *others = facts[1].split("; ")
    default = "needed" if one.default is NEEDED else "unset" if one.default is None else value_text(one.default)
    return one.accepts.removeprefix("a ") == accepts and (not default or f"{default}" in " ".join(others))


@pytest.mark.parametrize("verb", VERBS)
def test_every_setting_of_every_verb_is_listed_as_it_is_defined(verb: str, capsys: pytest.CaptureFixture) -> None:
    text = shown(capsys, *verb.split(), "--help")
    listed = entries(text)
    for name, one in VERBS[verb].settings.items():
        assert says(listed[name], one), (name, listed[name])
        first = one.help.removeprefix(f"{','.join(one.parts)}: ").replace("`", "").split(" (")[0].split()[0]
        assert listed[name].startswith(first)
    assert set(listed) - {"uplift"} <= set(VERBS[verb].settings) | set(VERBS[verb].words)
    assert all(len(line) <= 80 for line in text.splitlines())
    for form in VERBS[verb].usage:
        assert f"uplift {form}" in text


def test_the_settings_of_fit_are_those_of_the_dataclasses(capsys: pytest.CaptureFixture) -> None:
    listed = entries(shown(capsys, "fit", "--help"))
    assert set(all_settings()) <= set(listed)
    for name, one in all_settings().items():
        assert says(listed[name], one), name


@pytest.mark.parametrize("words", [["--help"], ["-h"], []])
def test_the_program_lists_its_verbs(words: list[str], capsys: pytest.CaptureFixture) -> None:
    text = shown(capsys, *words)
    assert {name.split()[0] for name in VERBS} == set(_RUN)
    assert all(f"\n  {name} " in text for name in VERBS)
    assert all(len(line) <= 80 for line in text.splitlines())


@pytest.mark.parametrize("group", [group for group in all_groups() if group])
def test_a_group_has_its_own_settings(group: str, capsys: pytest.CaptureFixture) -> None:
    listed = entries(shown(capsys, "fit", "--help", group))
    assert {name for name in all_settings() if name.startswith(f"{group}.")} == set(listed)


def test_one_setting(capsys: pytest.CaptureFixture) -> None:
    assert entries(shown(capsys, "fit", "--help", "lifter.distance")) == {
        "lifter.distance": "distance of the perspective camera without intrinsics, in mean 2D radii of the body "
        "[number from 2 to 10,000; default 10]"
    }
    assert list(entries(shown(capsys, "predict", "--help", "frames", "axes"))) == ["frames", "axes"]
    assert list(entries(shown(capsys, "data", "render", "--help", "views"))) == ["views"]


def test_the_defaults_of_a_task(capsys: pytest.CaptureFixture) -> None:
    settings = load_settings("cmu")
    listed = entries(shown(capsys, "fit", "task=cmu", "seed=7", "--help"))
    assert listed["trainer.max_time"].endswith(f"default {settings.trainer.max_time}]")
    assert listed["data.train"].endswith(f"default {settings.data.train}]")
    assert listed["seed"].endswith("default 7]")
    assert listed["task"].endswith("default cmu]")
    assert listed == entries(shown(capsys, "fit", "--help", "task=cmu", "seed=7"))
    assert "bones" in shown(capsys, "fit", "task=cmu", "--help", "priors").partition("in this fit:")[2]


def test_the_priors_are_listed(capsys: pytest.CaptureFixture) -> None:
    text = shown(capsys, "fit", "--help", "priors")
    listed = entries(text)
    assert set(PRIORS) | {f"priors.NAME.{name}" for name in PRIOR_SETTINGS} == set(listed)
    poses = text.partition("priors of shapes")[0]
    assert "  flow " in poses
    assert "  mask_critic " not in poses


@pytest.mark.parametrize("name", PRIORS)
def test_a_prior_has_its_options(name: str, capsys: pytest.CaptureFixture) -> None:
    listed = entries(shown(capsys, "fit", "--help", f"priors.{name}"))
    options = [*option_settings(find_class(name, PRIORS, ""), ("skeleton",)), *PRIOR_SETTINGS.values()]
    assert {f"priors.{name}.{one.name}" for one in options} == set(listed)
    for one in options:
        assert one.help, one.name
        assert value_text(one.default) in listed[f"priors.{name}.{one.name}"]


@pytest.mark.parametrize(("holder", "classes"), [("lifter.options", NETWORKS), ("student.last_options", NETWORKS), ("data.options", DATA_SETS)])  # fmt: skip
def test_networks_and_data_sets_have_their_options(holder: str, classes: dict[str, str], capsys) -> None:
    text = shown(capsys, "fit", "--help", holder)
    for name in classes:
        assert name in text
        for one in option_settings(find_class(name, classes, ""), ("inputs", "outputs", "folder")):
            assert one.help, (name, one.name)
            assert f"  {holder}.{one.name} " in text


def test_a_class_of_ones_own(here: Path, capsys: pytest.CaptureFixture) -> None:
    (here / "my.py").write_text(PRIOR)
    for words in (["my.py:Flat"], ["priors.NAME"]):
        if words == ["priors.NAME"]:
            words = ["priors.ground", "priors.ground.use=my.py:Flat"]
        text = shown(capsys, "fit", "--help", *words)
        listed = {name.split(".")[-1]: entry for name, entry in entries(text).items()}
        assert "The feet rest on one plane." in text
        assert "More about it." in text
        assert listed["slack"] == "what costs nothing, in radii [number; default 0.05]"
        assert "default rankle" in listed["feet"]
        assert "needed" in listed["strict"]
        assert set(listed) >= set(PRIOR_SETTINGS)
    network = shown(capsys, "fit", "--help", "my.py:Net")
    assert entries(network) == {"lifter.options.width": "of the layers [whole number; default 3]"}
    assert "any other option (**rest)" in network
    assert "--help: no file" in refusal(capsys, "fit", "--help", "none.py:Flat")
    assert "expected a prior, a student's loss, views" in refusal(capsys, "fit", "--help", "my.py:Thing")
    assert "no class 'Flut' there. Did you mean 'Flat'?" in refusal(capsys, "fit", "--help", "my.py:Flut")


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["fit", "--help", "lifer"], "there is no 'lifer'. Did you mean 'lifter'?"),
        (["fit", "--help", "priors.flwo"], "Did you mean 'priors.flow'?"),
        (["fit", "--help", "priors.flow.axs"], "Did you mean 'priors.flow.axes'?"),
        (["fit", "--help", "trainer.max_tme"], "Did you mean 'trainer.max_time'?"),
        (["fit", "task=cmuu", "--help"], "Did you mean 'cmu'?"),
        (["predict", "--help", "framse"], "Did you mean 'frames'?"),
        (["data", "chek", "--help"], "Did you mean 'check'?"),
        (["skeleton", "--help", "mapp"], "Did you mean 'map'?"),
    ],
)
def test_a_typo_is_one_error_with_the_nearest_name(words: list[str], hint: str, capsys: pytest.CaptureFixture) -> None:
    message = refusal(capsys, *words)
    assert hint in message
    assert message.count("\n") == 1


@pytest.mark.parametrize("words", [["data", "--help"], ["skeleton", "-h"]])
def test_verbs_of_two_words(words: list[str], capsys: pytest.CaptureFixture) -> None:
    text = shown(capsys, *words)
    assert {f"{words[0]} {name}" for name in entries(text)} == {
        name for name in VERBS if name.startswith(f"{words[0]} ")
    }


@pytest.mark.parametrize("words", [["fit", "task=cmu", "--help"], ["fit", "--help", "trainer"], ["predict", "--help"]])
def test_help_without_torch(words: list[str]) -> None:
    script = f"import sys\nfrom uplift.cli.main import main\nmain({words!r})\nassert not {{'torch', 'numpy'}} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_narrow_and_a_wide_terminal(capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    for columns, most in (("40", 60), ("100", 100), ("250", 100)):
        monkeypatch.setenv("COLUMNS", columns)
        text = shown(capsys, "fit", "--help")
        assert most - 12 < max(map(len, text.splitlines())) <= max(most, 72)


def test_names_are_bold_in_a_terminal(capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    plain = shown(capsys, "simulate", "--help")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    styled = shown(capsys, "simulate", "--help")
    assert "  \033[1mframes\033[0m " in styled
    assert re.sub(r"\033\[\d?m", "", styled) == plain
    monkeypatch.setenv("NO_COLOR", "1")
    assert shown(capsys, "simulate", "--help") == plain


# Tab completion.


def test_completion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COMP_LINE", "uplift fit ")
    names = _complete("fit", "")
    listed = {f"{one.name}=" for one in all_settings().values() if typing.get_origin(one.kind) is not dict}
    assert listed | {"resume=", "trust="} | {f"trainer.{name}=" for name in TRAINER_FLAGS} == set(names)
    assert _complete("fit", "lifter.camera=") == ["lifter.camera=orthographic", "lifter.camera=perspective"]
    assert _complete("fit", "lifter.fill=t") == ["lifter.fill=true", "lifter.fill=false"]
    assert "task=cmu" in _complete("fit", "task=")
    assert "task=default" not in _complete("fit", "task=")
    assert "skeleton=h36m17" in _complete("simulate", "skeleton=h")
    assert _complete("fit", "trainer.max_time=") == []
    monkeypatch.setenv("COMP_LINE", "uplift data ")
    assert _complete("data", "") == ["check", "cmu", "render", "shard"]
    monkeypatch.setenv("COMP_LINE", "uplift data render --help ")
    assert "views" in _complete("data", "")
    monkeypatch.setenv("COMP_LINE", "uplift fit --help ")
    assert {"trainer", "trainer.max_time"} <= set(_complete("fit", ""))


def test_completion_as_the_shell_asks_for_it() -> None:
    line = "uplift fit lifter.root"
    environment = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    script = "import os, sys\nos.dup2(1, 8)\nsys.argv[0] = 'uplift'\nfrom uplift.cli.main import main\nmain()"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60,
        env={**environment, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), "PATH": "/usr/bin"},
    )  # fmt: skip
    assert done.stdout.strip() == "lifter.root_free="


def test_callbacks_loggers_and_flags_of_lightning(capsys: pytest.CaptureFixture) -> None:
    assert main(["fit", "--help", "callbacks"]) == 0
    text = capsys.readouterr().out
    assert "EarlyStopping" in text and "callbacks.NAME.use=file.py:Class" in text
    assert main(["fit", "--help", "callbacks.EarlyStopping"]) == 0
    text = capsys.readouterr().out
    assert "callbacks.EarlyStopping.patience" in text and "default 3" in text and "needed" in text
    assert main(["fit", "--help", "loggers.csv"]) == 0
    assert "loggers.csv.save_dir" in capsys.readouterr().out
    assert main(["fit", "--help", "trainer.flags"]) == 0
    text = capsys.readouterr().out
    assert all(f"trainer.{name}" in text for name in TRAINER_FLAGS)
    assert main(["fit", "--help", "trainer.gradient_clip_val"]) == 0
    assert "clip gradients" in capsys.readouterr().out
    assert "Did you mean 'callbacks.EarlyStopping'?" in refusal(capsys, "fit", "--help", "callbacks.EarlyStoping")
    assert "Did you mean 'trainer.gradient_clip_val'?" in refusal(capsys, "fit", "--help", "trainer.gradient_clip_vall")


MINE = '''
import lightning as L
import uplift

class MyViews(uplift.Views):
    """From the side."""
    def __init__(self, skeleton, *, degrees=90.0):
        super().__init__(skeleton)

class MyLoss(uplift.StudentLoss):
    """Squares."""

class MyModule(uplift.LiftingModule):
    """Shallow poses."""
    def __init__(self, skeleton, *, strength=0.1, **options):
        super().__init__(skeleton, **options)

class MyCallback(L.Callback):
    """Notes."""
    def __init__(self, *, every=3):
        pass

class MyFormat(uplift.Format):
    """Text files."""
    def read(self, path, options):
        pass
'''


def test_classes_of_every_kind(here: Path, capsys: pytest.CaptureFixture) -> None:
    (here / "mine.py").write_text(MINE)
    expected = {
        "MyViews": ("views: From the side", "views.options.degrees"), "MyLoss": ("a student's loss: Squares", "no options"),
        "MyModule": ("a module: Shallow poses", "strength"), "MyCallback": ("a callback: Notes", "callbacks.NAME.every"),
        "MyFormat": ("a file format: Text files", "no options"),
    }  # fmt: skip
    for name, texts in expected.items():
        assert main(["fit", "--help", f"mine.py:{name}"]) == 0
        found = " ".join(capsys.readouterr().out.split())
        assert all(text in found for text in texts), found
