"""Code that is not part of the package runs only by the user's words: a file that names it leaves no trace on the disk."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from bodies import QUICK, refusal, status_of, write_body

import uplift
from uplift.config.loading import load_settings, save_settings
from uplift.config.settings import LifterSettings
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.skeleton import load_skeleton

SMALL = {"units": 4, "blocks": 1}


@pytest.fixture(autouse=True)
def strange(here: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder with a file and a module whose code leaves the file ``ran``, and keypoints."""
    for name in ("evil.py", "package/strange_module.py"):
        (here / name).parent.mkdir(exist_ok=True)
        (here / name).write_text(f"open({str(here / 'ran')!r}, 'w')\n")
    (here / "link.py").symlink_to("evil.py")
    monkeypatch.syspath_prepend(here / "package")
    forget()
    write_body(here / "a.npz", frames=20)
    return here


def forget() -> None:
    """Forget which code of users was run: a second time it would leave no trace."""
    for name in [name for name in sys.modules if name.startswith("uplift_user_") or name == "strange_module"]:
        del sys.modules[name]


def ran() -> bool:
    """Return whether the strange code ran, and remove its trace."""
    found = Path("ran").exists()
    Path("ran").unlink(missing_ok=True)
    return found


def write_run(network: str = "residual", **changes: Any) -> Path:
    """Write a run as a fit leaves it, untrained, with other settings and another network than those it has."""
    run, skeleton = Path("run"), load_skeleton("h36m17")
    settings = load_settings(None, ["skeleton=h36m17", f"data.train={Path('a.npz').absolute()}"])
    (run / "checkpoints").mkdir(parents=True)
    save_settings(settings, run / "config.yaml")
    plain = yaml.safe_load((run / "config.yaml").read_text())
    for key, value in changes.items():
        group, _, name = key.rpartition("__")
        (plain[group] if group else plain)[name] = value
    (run / "config.yaml").write_text(yaml.safe_dump(plain))
    (run / "run.json").write_text("{}")
    chosen = LifterSettings(options=SMALL)
    Model(Lifter(skeleton, chosen), skeleton, chosen).save(run / "lifter.pt")
    state = torch.load(run / "lifter.pt", weights_only=True)
    state["lifter"]["network"] = network
    torch.save(state, run / "lifter.pt")
    return run


# Task files: each setting that names a class.

ASKING = {
    "module": "module: evil.py:X",
    "lifter.network": "lifter: {network: evil.py:X}",
    "data.use": "data: {simulate: 0, use: evil.py:X, name: set, train: train}",
    "data.format": "data: {simulate: 0, train: a.npz, format: evil.py:X}",
    "views.use": "views: {use: evil.py:X}",
    "student.network": "student: {network: evil.py:X}",
    "student.loss": "student: {loss: link.py:X}",
    "student.module": "student: {module: /proc/self/cwd/evil.py:X}",
    "priors.mine.use": "priors: {mine: {use: evil.py:X}}",
    "priors.mine.use (masks)": "extends: masks_demo\npriors: {mine: {use: evil.py:X}}",
    "callbacks.mine.use": "callbacks: {mine: {use: evil.py:X}}",
    "loggers.mine.use": "loggers: {mine: {use: 'strange_module:X'}}",
}


@pytest.mark.parametrize("setting", ASKING)
def test_a_task_file_runs_nothing_by_itself(setting: str, capsys: pytest.CaptureFixture) -> None:
    Path("evil.yaml").write_text(f"extends: demo\n{ASKING[setting]}\n".replace("extends: demo\nextends", "extends"))
    message = refusal(capsys, "fit", "task=evil.yaml")
    assert message.startswith(f"uplift: evil.yaml asks for {setting.partition(' ')[0]}=")
    assert message.rstrip().endswith("add trust=strange_module" if "loggers" in setting else "add trust=evil.py")
    if setting.startswith("data"):
        assert status_of("data", "check", "task=evil.yaml") == 2
        assert "add trust=evil.py" in "".join(capsys.readouterr())
    if setting.startswith("priors"):
        assert "add trust=evil.py" in refusal(capsys, "fit", "--help", "priors.mine", "task=evil.yaml")
    assert not ran()


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "task=evil.yaml", "trust=evil.py"),
        ("fit", "--trust", "evil.py", "task=evil.yaml"),
        ("fit", "task=evil.yaml", "trust=[strange_module,/proc/self/cwd/link.py]"),
        ("data", "check", "task=evil.yaml", "trust=link.py"),
        ("fit", "task=demo", "data.simulate=0", "data.train=a.npz", "data.format=evil.py:X"),
    ],
)
def test_it_runs_by_the_words_of_the_command(words: tuple[str, ...]) -> None:
    Path("evil.yaml").write_text(f"extends: demo\n{ASKING['data.format']}\n")
    assert status_of(*words) == 2, "there is no class X"
    assert ran()


def test_python_runs_nothing_of_a_task_file_by_itself() -> None:
    Path("evil.yaml").write_text("extends: demo\nmodule: evil.py:X\n")
    with pytest.raises(uplift.UserError, match="evil.yaml asks for module="):
        uplift.fit("evil.yaml")
    assert not ran()
    with pytest.raises(uplift.UserError, match="no class 'X'"):
        uplift.fit("evil.yaml", "data.simulate=20", trust="evil.py")
    assert ran()


def test_what_is_trusted_is_one_file(capsys: pytest.CaptureFixture) -> None:
    """Another file of the same name, or of the same content, is another file."""
    Path("evil.yaml").write_text("extends: demo\npriors: {mine: {use: evil.py:X}, more: {use: strange_module:X}}\n")
    Path("other").mkdir()
    Path("other/evil.py").write_bytes(Path("evil.py").read_bytes())
    message = refusal(capsys, "fit", "task=evil.yaml", "trust=other/evil.py")
    assert message.rstrip().endswith("add trust=evil.py,strange_module"), "both at once"
    assert "no name of code" in refusal(capsys, "fit", "task=evil.yaml", "trust=run/lifter.pt")
    assert "no such file" in refusal(capsys, "fit", "task=evil.yaml", "trust=none.py")
    assert not ran()


# Runs, lifters, checkpoints.

NETWORKS = ["evil.py", "{}/evil.py", "/proc/self/cwd/evil.py", "{}/link.py", "strange_module"]


@pytest.mark.parametrize("place", NETWORKS)
def test_a_lifter_runs_nothing_by_itself(place: str, strange: Path, capsys: pytest.CaptureFixture) -> None:
    run = write_run(network=place.format(strange) + ":Net")
    for words in (
        ("predict", f"run={run}/lifter.pt", "input=a.npz", "output=b.npz"),
        ("evaluate", f"run={run}", "data.test=a.npz"),
        ("fit", "skeleton=h36m17", "data.train=a.npz", f"init={run}", "trainer.max_steps=9", "trainer.max_time=null"),
    ):
        assert "lifter.pt: lifter.network=" in refusal(capsys, *words)
    for load in (uplift.load, uplift.evaluate, lambda run: uplift.predict(run, "a.npz")):
        with pytest.raises(uplift.UserError, match="add trust="):
            load(run)
    assert not ran()


def test_a_teacher_runs_nothing_by_itself() -> None:
    run, data = write_run(network="evil.py:Net"), uplift.KeypointData("a.npz", "h36m17")
    with pytest.raises(uplift.UserError, match="add trust="):
        uplift.StudentModule("h36m17", teacher=run, lifter={"options": SMALL}).prepare(data)
    assert not ran()


@pytest.mark.parametrize("place", NETWORKS)
def test_a_lifter_is_loaded_by_trust(place: str, strange: Path) -> None:
    run, trust = write_run(network=place.format(strange) + ":Net"), "evil.py" if "." in place else place
    calls: tuple[Callable[[], Any], ...] = (
        lambda: uplift.load(run, trust=trust),
        lambda: uplift.predict(run, "a.npz", trust=[trust]),
        lambda: uplift.evaluate(run, "a.npz", trust=strange / trust if "." in trust else trust),
    )
    for call in calls:
        forget()
        with pytest.raises(uplift.UserError, match="no class 'Net'"):
            call()
        assert ran()


@pytest.mark.parametrize(("key", "setting"), [("data__use", "data.use"), ("data__format", "format")])
def test_the_settings_of_a_run_run_nothing_by_themselves(key: str, setting: str, strange: Path, capsys) -> None:
    run = write_run(**{key: f"{strange}/evil.py:X"})
    for words in (
        ("evaluate", f"run={run}"),
        ("fit", f"resume={run}"),
        ("predict", f"run={run}", "input=a.npz", "output=b.csv"),
    ):
        capsys.readouterr()
        status = status_of(*words)
        assert words[0] == "predict" or (status == 2 and f"{setting}=" in capsys.readouterr().err)
        assert not ran()
    assert status_of("evaluate", f"run={run}", "trust=evil.py") == 2
    assert ran()


def checkpoint(**changes: Any) -> str:
    plain = {"skeleton": "h36m17", "lifter": {"options": SMALL}, "seed": 0}
    torch.save(
        {"state_dict": {}, "hyper_parameters": {**plain, **changes}, "pytorch-lightning_version": "2.6.0"}, "a.ckpt"
    )
    return "a.ckpt"


@pytest.mark.parametrize(
    "changes",
    [
        {"priors": {"mine": {"use": "evil.py:X"}}},
        {"lifter": {"network": "{}/evil.py:X"}},
        {"views": {"use": "strange_module:X"}},
        {"_instantiator": "strange_module.X"},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_checkpoint_runs_nothing_by_itself(changes: dict[str, Any], strange: Path) -> None:
    changes = yaml.safe_load(yaml.safe_dump(changes).replace("{}", str(strange)))
    path = checkpoint(**changes)
    with pytest.raises(uplift.UserError, match="a.ckpt"):
        uplift.LiftingModule.load_from_checkpoint(path)
    assert not ran()
    if "_instantiator" not in changes:
        with pytest.raises(uplift.UserError, match="no class 'X'"):
            uplift.LiftingModule.load_from_checkpoint(path, trust=["evil.py", "strange_module"])
        assert ran()


def test_what_python_is_given_directly_is_consent() -> None:
    for call in (
        lambda: uplift.LiftingModule("h36m17", lifter={"network": "evil.py:X"}),
        lambda: uplift.LiftingModule("h36m17", priors={"mine": "evil.py:X"}),
        lambda: uplift.StudentModule("h36m17", loss="link.py:X"),
        lambda: uplift.ShapeModule(priors={"mine": {"use": "strange_module:X", "weight": 2}}),
        lambda: uplift.KeypointData("a.npz", "h36m17", format="evil.py:X").train_samples,
        lambda: uplift.MaskDataModule("a.npz", format="evil.py:X").train_samples,
        lambda: uplift.predict(write_run(), "evil.py:X:train", None, "data.root=."),
        lambda: uplift.fit("demo", "priors.mine.use=evil.py:X"),
    ):
        forget()
        with pytest.raises(uplift.UserError, match="no class 'X'"):
            call()
        assert ran()


# A fit with classes of the user's own in its task file, from its start to what its last lines say.

OWN = """
import uplift
from torch import nn

class Net(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.layer = nn.Linear(inputs, outputs)

    def forward(self, features):
        return self.layer(features)

class Flat(uplift.Prior):
    def loss(self, lift):
        return lift.pose[..., 2].abs().mean()
"""


def test_the_words_at_the_end_of_a_fit_can_be_copied(strange: Path, capsys: pytest.CaptureFixture) -> None:
    Path("own.py").write_text(OWN)
    task = {
        "extends": "default",
        "skeleton": "h36m17",
        "lifter": {"network": "own.py:Net"},
        "data": {"train": "a.npz", "test": "a.npz"},
    }
    Path("own.yaml").write_text(yaml.safe_dump({**task, "priors": {"flat": {"use": "own.py:Flat"}}}))
    assert status_of("fit", "task=own.yaml", "trust=own.py", *(word for word in QUICK if ".options" not in word)) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in ("report.md", "page.html", "evaluation.json", "evaluation.csv"):
        assert strange.name not in Path("runs/own/last", name).read_text(), (
            "what is passed on says nothing of the machine"
        )
    (copied,) = (line.split()[1:] for line in lines if line.lstrip().startswith("uplift predict"))
    assert copied[-1] == "trust=own.py"
    words = ["input=a.npz" if word.startswith("input=") else word for word in copied]
    assert "trust=own.py" in refusal(capsys, *words[:-1])
    assert status_of(*words) == 0
    assert status_of("fit", "resume=runs/own/last", "trust=own.py") == 0
    Path("runs/own/last/lifter.pt").unlink()
    assert "`uplift fit resume=" in (message := refusal(capsys, *words)) and "trust=own.py`" in message
