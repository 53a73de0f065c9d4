"""What of Lightning's reaches a fit from the command line: flags, callbacks, loggers, and classes of the user's own."""

from __future__ import annotations

import csv
import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L
import pytest
import torch
from bodies import QUICK, last_words, own_data, refusal, status_of, write_body

from uplift.config.run import RunFolder
from uplift.config.settings import TRAINER_FLAGS, TRAINER_FLAGS_OF_FIT, TrainerSettings

MINE = '''
import json
import lightning as L
import torch
from torch import nn
import uplift
from uplift.geometry.rotation import about_y


class MyModule(uplift.LiftingModule):
    def objective(self, batch):
        loss, terms = super().objective(batch)
        depth = self.last_lift.pose[..., 2].abs().mean()
        return loss + 100 * depth, {**terms, "depth": depth.detach()}


class MyViewModule(uplift.LiftingModule):
    def configure_views(self):
        return lambda lifted: about_y(torch.full_like(lifted.tilt, 3.0))


class MyStudent(uplift.StudentModule):
    def objective(self, batch):
        loss, terms = super().objective(batch)
        return 2 * loss, {**terms, "twice": 2 * loss.detach()}


class MyViews(uplift.Views):
    def __init__(self, skeleton, *, degrees=90.0):
        super().__init__(skeleton)
        self.degrees = degrees

    def __call__(self, lifted):
        return about_y(torch.full_like(lifted.tilt, torch.pi / 180 * self.degrees))


class NoViews(uplift.Views):
    def __call__(self, lifted):
        return lifted.tilt.nothing


class MyLoss(uplift.StudentLoss):
    def __init__(self, skeleton, *, power=2.0):
        super().__init__(skeleton)
        self.power = power

    def forward(self, lifted, views, lifter):
        error = (lifted.pose[..., 2] - views.pose[..., 2]).abs().pow(self.power) * views.weight
        return error.mean(), {"powered": error.mean().detach()}


class NoLoss(uplift.StudentLoss):
    def forward(self, lifted, views, lifter):
        return 3.0


class MyNet(nn.Module):
    def __init__(self, inputs, outputs, *, wide=12):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(inputs, wide), nn.Tanh(), nn.Linear(wide, outputs))

    def forward(self, features):
        return self.layers(features)


class MyCallback(L.Callback):
    def __init__(self, path, *, every=1):
        self.path, self.every = path, every

    def on_train_batch_end(self, trainer, module, *rest):
        if trainer.global_step % self.every == 0:
            with open(self.path, "a") as file:
                file.write(f"{module.log_prefix} {trainer.global_step} {trainer.gradient_clip_val}\\n")


class MyLogger(L.pytorch.loggers.logger.Logger):
    name, version = "mine", 0

    def __init__(self, save_dir, *, file="log.txt"):
        super().__init__()
        self.path = f"{save_dir}/{file}"

    def log_metrics(self, metrics, step=None):
        with open(self.path, "a") as file:
            file.write(json.dumps([step, metrics]) + "\\n")

    def log_hyperparams(self, *rest, **more):
        pass


class NoCallback:
    pass


class Raises(L.Callback):
    def on_train_start(self, trainer, module):
        raise ValueError("what a pity")
'''  # fmt: skip


def fitted(*words: str) -> tuple[Path, dict[str, list[float]]]:
    """Return the run of a fit in the current folder, and its metrics by stage and name."""
    assert status_of("fit", *words) == 0
    folder = RunFolder.open("runs/h36m17").path
    found: dict[str, list[float]] = {}
    with open(folder / "metrics.csv", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(f"{row['stage']}/{row['name']}", []).append(float(row["value"]))
    return folder, found


@pytest.fixture
def fit(here: Path) -> Callable[..., tuple[Path, dict[str, list[float]]]]:
    """Return `fitted` with the words of a quick fit before those that it is given."""
    (here / "my.py").write_text(MINE)
    words = own_data(here / "a.npz")
    return lambda *more: fitted(*last_words(*words, *more))


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, list[float]]]:
    """Return `fitted` without any words of one's own."""
    folder = tmp_path_factory.mktemp("usual")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run, found = fitted(*own_data(folder / "a.npz"))
    return folder / run, found


def weights(run: Path) -> dict[str, torch.Tensor]:
    return torch.load(run / "lifter.pt", weights_only=True)["state"]


def same(one: Path, other: Path) -> bool:
    first, second = weights(one), weights(other)
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)


def test_every_flag_of_lightnings_trainer_is_set_or_taken_or_refused() -> None:
    ours = {field.name for field in dataclasses.fields(TrainerSettings)}
    known = set(inspect.signature(L.Trainer.__init__).parameters) - {"self"}
    assert known <= ours | set(TRAINER_FLAGS) | set(TRAINER_FLAGS_OF_FIT)
    assert set(TRAINER_FLAGS) <= known and set(TRAINER_FLAGS_OF_FIT) <= known
    assert not set(TRAINER_FLAGS) & (ours | set(TRAINER_FLAGS_OF_FIT))


def test_flags_reach_the_trainer_and_stay_with_the_run(fit, here: Path, usual) -> None:
    plain, _ = usual
    words = ("callbacks.mine.use=my.py:MyCallback", "callbacks.mine.path=seen.txt", "callbacks.mine.every=2")
    clipped, _ = fit("trainer.gradient_clip_val=0.01", *words)
    assert (here / "seen.txt").read_text() == "teacher 2 0.01\nteacher 4 0.01\n" + "".join(
        f"student_1 {step} 0.01\n" for step in (2, 4, 6)
    )
    assert not same(plain, clipped)
    assert RunFolder(clipped).settings().trainer.flags == {"gradient_clip_val": 0.01}
    (here / "task.yaml").write_text(
        "extends: default\ntrainer: {gradient_clip_val: 0.01}\nskeleton: h36m17\ndata: {train: a.npz}\n"
    )
    assert status_of("fit", "task=task.yaml", *QUICK) == 0
    assert same(RunFolder.open("runs/task").path, clipped)
    accumulated, _ = fit("trainer.accumulate_grad_batches=2", "trainer.profiler=simple")
    assert not same(plain, accumulated)


def test_a_fast_run_of_every_stage(fit) -> None:
    run, _ = fit("trainer.fast_dev_run=true")
    assert (run / "lifter.pt").is_file() and (run / "evaluation.json").is_file() is False


def test_loggers_see_one_run(fit, here: Path) -> None:
    run, found = fit(
        "loggers.mine.use=my.py:MyLogger", "trainer.logger=csv", "data.val=0.2", "trainer.val_check_interval=2"
    )
    import json

    rows = [json.loads(line) for line in (run / "log.txt").read_text().splitlines()]
    steps = [step for step, _ in rows]
    assert steps == sorted(steps) and steps[-1] == 9
    logged = {name: [row[name] for _, row in rows if name in row] for name in ("teacher/flow", "student_1/depth")}
    for name, values in logged.items():
        assert values == pytest.approx(found[name], rel=1e-4), name
    assert sum("val/p_mpjpe" in row for _, row in rows) == 5
    with open(run / "csv" / "version_0" / "metrics.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert {"teacher/flow", "student_1/depth", "val/p_mpjpe"} <= set(table[0])


def test_tensorboard_is_one_run_too(fit) -> None:
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    run, found = fit("trainer.logger=tensorboard")
    reader = events.EventAccumulator(str(run / "tensorboard"))
    reader.Reload()
    depth = reader.Scalars("student_1/depth")
    assert [event.step for event in depth] == [5, 7, 9]
    assert [event.value for event in depth] == pytest.approx(found["student_1/depth"], rel=1e-4)


def test_early_stopping_ends_a_stage_for_good(fit, here: Path) -> None:
    words = ("data.val=0.2", "trainer.val_check_interval=1", "callbacks.EarlyStopping.monitor=val/p_mpjpe")
    run, _ = fit(*words, "callbacks.EarlyStopping.patience=1", "callbacks.EarlyStopping.min_delta=1000000.0")
    before = (run / "metrics.csv").read_text()
    for stage in ("teacher", "student_1"):
        state = torch.load(run / "checkpoints" / f"{stage}.ckpt", weights_only=True)
        assert state["done"] == 1 and state["global_step"] == 2
    first = weights(run)
    (run / "lifter.pt").unlink()
    assert status_of("fit", f"resume={run}") == 0
    assert all(torch.equal(value, weights(run)[key]) for key, value in first.items())
    assert (run / "metrics.csv").read_text() == before


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("module=my.py:MyModule",), "teacher/depth"),
        (("module=my.py:MyViewModule",), "teacher/flow"),
        (("student.module=my.py:MyStudent",), "student_1/twice"),
        (("views.use=my.py:MyViews", "views.options.degrees=30"), "teacher/flow"),
        (("student.loss=my.py:MyLoss", "student.loss_options.power=1.5"), "student_1/powered"),
        (("lifter.network=my.py:MyNet",), "teacher/flow"),
    ],
)
def test_classes_of_the_users_own(
    fit, usual, here: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], name: str
) -> None:
    """They take part, the run is evaluated from another folder, and an interrupted fit would find them again."""
    changed = [*words, *(["lifter.options={}"] if "network" in words[0] else [])]
    run, found = fit(*changed)
    assert name in found
    assert found[name] != usual[1].get(name)
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    (run / "checkpoints" / "student_1.ckpt").unlink()
    first = weights(run)
    assert status_of("fit", f"resume={here / run}", f"trust={here / 'my.py'}") == 0
    assert all(torch.equal(value, weights(here / run)[key]) for key, value in first.items())


def test_a_shipped_recipe_takes_any_network(fit, capsys: pytest.CaptureFixture) -> None:
    """All stages are built before any is trained, and the options of another network are left out with a line."""
    fit("lifter.network=kudo", "lifter.options={}", "lifter.options.units=8", "student.options.blocks=3")
    text = capsys.readouterr().out
    assert "without student.options.blocks" in text and "of another network than kudo" in text
    message = refusal(capsys, "fit", *own_data(Path("a.npz")), "lifter.options.bloks=2")
    assert "takes no such option" in message and "blocks" in message
    message = refusal(capsys, "fit", *own_data(Path("a.npz")), "student.options.bloks=2")
    assert "takes no such option" in message
    assert len(list(Path("runs/h36m17").iterdir())) == 2  # the first fit, and `last`


ERRORS = [
    ("trainer.gradient_clip_vall=1", "Did you mean 'trainer.gradient_clip_val'?"),
    ("trainer.max_tme=1", "Did you mean 'trainer.max_time'?"),
    ("trainer.callbacks=1", "name them as callbacks.NAME.use=file.py:Class"),
    ("trainer.log_every_n_steps=1", "set trainer.log_every"),
    ("trainer.strategy=fsdpx", "trainer.strategy=fsdpx"),
    ("trainer.gradient_clip_val=abc", "expected a whole number or a number"),
    ("callbacks.EarlyStoping.monitor=x", "Did you mean 'EarlyStopping'?"),
    (
        "callbacks.EarlyStopping.monitr=x",
        "callbacks.EarlyStopping.monitr: 'EarlyStopping' takes no such option. Did you mean 'monitor'?",
    ),
    ("callbacks.EarlyStopping.patience=3", "needs the option 'monitor'"),
    ("callbacks.mine.use=my.py:NoCallback", "is not a subclass of lightning.Callback"),
    ("callbacks.mine=3", "callbacks.mine is 3, expected settings: use, and options of the class"),
    ("loggers.mine.use=none.py:Logger", "no file"),
    ("trainer.logger=tensorbord", "Did you mean 'tensorboard'?"),
    ("module=my.py:MyModul", "Did you mean 'MyModule'?"),
    ("module=my.py:MyStudent", "is not a subclass of uplift.LiftingModule"),
    ("student.module=my.py:MyModule", "is not a subclass of uplift.StudentModule"),
    ("module=MyModule", "expected file.py:Class"),
    ("views.use=my.py:MyNet", "is not a subclass of uplift.Views"),
    ("views.use=my.py:NoViews", "my.py, line"),
    ("views.options.degrees=3", "set views.use=file.py:Class"),
    ("student.loss=my.py:MyViews", "is not a subclass of uplift.StudentLoss"),
    ("callbacks.LearningRateMonitor.logging_interval=step", "Lightning refuses the fit"),
    ("callbacks.bad.use=my.py:Raises", "my.py, line"),
    ("trainer.accumulate_grad_batches=x", "expected a whole number from 1 to"),
    ("trainer.devices=9999", "a process for each, expected at most"),
    ("trainer.num_nodes=1000", "would wait for other computers"),
    ("lifter.options.blocks=1000000", "expected a whole number from 1 to 256"),
    ("trainer.flags.nonsense=1", "no such flag"),
    ("data.val=none.npz", "No file"),
    ("data.val=1.5", "expected a share"),
]


@pytest.mark.parametrize(("word", "message"), ERRORS)
def test_what_is_wrong_is_said(here: Path, capsys: pytest.CaptureFixture, word: str, message: str) -> None:
    (here / "my.py").write_text(MINE)
    found = refusal(capsys, "fit", *own_data(here / "a.npz"), word)
    assert message in found, found


SCRIPT = """
import json, sys
import lightning as L
import torch
import uplift


class Note(L.Callback):
    def on_train_end(self, trainer, module):
        draw = float(module.last_lift.keypoints.sum())
        weights = float(sum(p.double().sum() for p in module.lifter.parameters()))
        with open(f"rank{trainer.global_rank}.json", "w") as file:
            json.dump([draw, weights, trainer.world_size, trainer.global_step], file)


if __name__ == "__main__":
    data = uplift.KeypointData("a.npz", "h36m17", batch_size=8, val=0.2)
    module = uplift.LiftingModule("h36m17", priors={"flow": {"steps": 3}, "bones": 10.0}, lifter={"options": {"units": 8}})
    L.Trainer(
        max_epochs=2, accelerator="cpu", devices=2, strategy="ddp", logger=False, enable_checkpointing=False,
        enable_progress_bar=False, callbacks=[Note()],
    ).fit(module, data)
"""


def test_two_processes_draw_different_frames_and_keep_the_same_weights(here: Path) -> None:
    import json
    import subprocess
    import sys

    write_body(here / "a.npz", frames=80)
    (here / "train.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "train.py"], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-3000:]
    found: list[list[Any]] = [json.loads((here / f"rank{rank}.json").read_text()) for rank in (0, 1)]
    assert found[0][0] != found[1][0]
    assert found[0][1] == found[1][1]
    assert found[0][2:] == found[1][2:] == [2, 2 * 8]
