"""A stack trains each of its networks as its lone fit does, and none of them knows of the others."""

from __future__ import annotations

import copy
import csv
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from bodies import QUICK, last_words, write_body

from uplift.cli.fit import fit_settings, fit_stack
from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.config.trust import consent_of, granted
from uplift.data.module import KeypointData
from uplift.training.callbacks import Checkpoints
from uplift.training.lifting import LiftingModule
from uplift.training.stack import NotStackable, StackedStudents, StackedTeachers, stackable
from uplift.training.student import StudentModule

SMALL = {"network": "residual", "options": {"units": 16, "blocks": 1}}
FLOW = {"weight": 0.1, "steps": 3, "units": 8}


@pytest.fixture(autouse=True)
def in_its_own_folder(here: Path) -> None:
    """Write files where no other test does."""


def data(frames: int = 60) -> KeypointData:
    return KeypointData(str(write_body(Path(f"body{frames}.npz").absolute(), frames)), "h36m17", val=0)


def in_double(module: Any) -> Any:
    """Return a prepared module in double precision, in which rounding cannot hide a difference."""
    module.double()
    frames = module.frames
    fields = {field.name: getattr(frames, field.name) for field in dataclasses.fields(frames)}
    real = {k: v.double() for k, v in fields.items() if isinstance(v, torch.Tensor) and v.is_floating_point()}
    module.frames = dataclasses.replace(frames, **real)
    return module


def teachers(seeds: Sequence[int]) -> list[LiftingModule]:
    """Return prepared teachers that differ in seed, weights, learning rates and frames, of which some have more."""
    made = []
    for place, seed in enumerate(seeds):
        priors = {
            "flow": FLOW,
            "bones": 1.0 + place,
            "consistency": 1.0,
            "pairwise": 0.5,
            "handedness": 1.0,
            "critic": {"units": 8},
        }
        module = LiftingModule(
            "h36m17", priors=priors, lifter=SMALL, seed=seed, learning_rate=1e-3 * (1 + place), hide=0.2, average=0.9
        )
        module.prepare(data(60 + 7 * place))
        made.append(in_double(module))
    return made


def students(seeds: Sequence[int]) -> list[StudentModule]:
    teacher = LiftingModule("h36m17", priors={"bones": 1.0}, lifter=SMALL, seed=1)
    made = []
    for place, seed in enumerate(seeds):
        lifter = {**SMALL, "signs": 8, "uncertainty": True}
        student = StudentModule("h36m17", teacher=teacher, lifter=lifter, seed=seed, mix=0.2 + 0.1 * place, average=0.9)
        student.prepare(data())
        made.append(in_double(student))
    return made


@contextmanager
def drawing_in_double() -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@drawing_in_double()
def train(module: Any, steps: int, batch: int = 12) -> list[float]:
    """Train without a trainer; every step draws the same numbers."""
    optimizer, losses = module.configure_optimizers(), []
    for _ in range(steps):
        torch.manual_seed(module.step_seed)
        loss, _ = module.objective(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        module.averaged.update_parameters(module.lifter)
        losses.append(float(loss))
    return losses


@pytest.mark.parametrize("make", [teachers, students])
def test_networks_of_a_stack_are_trained_as_they_are_alone(
    make: Callable[[Sequence[int]], list[Any]],
) -> None:
    alone = make([3, 4, 5])
    together = copy.deepcopy(alone)
    stack: Any = (StackedTeachers if isinstance(alone[0], LiftingModule) else StackedStudents)(together)
    before = copy.deepcopy(alone[2].lifter.state_dict())
    losses = [train(module, 6) for module in alone]
    assert train(stack, 6) == pytest.approx([sum(step) for step in zip(*losses, strict=True)], rel=1e-9)
    for one, other in zip(alone, together, strict=True):
        for name, value in one.state_dict().items():
            torch.testing.assert_close(other.state_dict()[name], value, rtol=1e-9, atol=1e-9, msg=name)
    moved = [(value - before[name]).abs().max() for name, value in together[2].lifter.state_dict().items()]
    assert max(map(float, moved)) > 1e-3
    if isinstance(alone[0], LiftingModule):
        assert len({len(one.frames) for one in alone}) > 1  # or the filling up of frames is not tested
        for one, other in zip(alone, stack.each(), strict=True):
            assert other.terms.metrics(other.last_lift) == pytest.approx(one.terms.metrics(one.last_lift))


def test_no_network_of_a_stack_knows_of_another() -> None:
    found = []
    for last in (5, 6):
        stacked = teachers([3, 4, last])
        if last == 6:  # and one that has diverged
            with torch.no_grad():
                next(stacked[2].lifter.parameters()).fill_(torch.nan)
        stack = StackedTeachers(stacked)
        train(stack, 3)
        assert set(stack.failed) == ({2} if last == 6 else set())
        found.append([one.lifter.state_dict() for one in stacked])
    for number in (0, 1):
        for name, value in found[0][number].items():
            torch.testing.assert_close(found[1][number][name], value, rtol=1e-12, atol=1e-12)


def test_one_stream_for_all_gives_every_network_its_own_numbers() -> None:
    """As on a GPU, where each network's own stream would be a kernel each."""
    same = [teachers([3])[0] for _ in range(3)]
    stack, found = StackedTeachers(same, exact=False), []
    with drawing_in_double():
        for _ in range(2):
            torch.manual_seed(0)
            stack.objective(12)
            found.append(stack.last_step["loss"].tolist())
    assert len(set(found[0])) == 3
    assert found[1] == pytest.approx(found[0])


# From settings to run folders.

SWEEP = ("trainer.max_steps=12", "trainer.log_every=1", "student.rounds=1,2", "trainer.checkpoint_steps=2")


def settings(*words: str, seeds: int = 2) -> list[Any]:
    write_body(Path("body.npz"))
    base = ["skeleton=h36m17", "data.train=body.npz", "data.root=.", *QUICK, *SWEEP]
    return [load_settings(None, last_words(*base, f"seed={seed}", *words)) for seed in range(seeds)]


def folders(every: Sequence[Any], name: str) -> list[RunFolder]:
    made = []
    for one in every:
        run = RunFolder.create(one, "uplift fit")
        Path(name).mkdir(exist_ok=True)
        made.append(RunFolder(run.path.rename(Path(name) / f"{one.seed}")))
    return made


def metrics(run: RunFolder) -> dict[str, float]:
    with open(run.path / "metrics.csv", newline="") as file:
        return {f"{row['stage']}/{row['step']}/{row['name']}": float(row["value"]) for row in csv.DictReader(file)}


def weights(run: RunFolder) -> dict[str, torch.Tensor]:
    return torch.load(run.weights, weights_only=True)["state"]


class Killed(Exception):
    """Stands for what ends a process."""


def test_fits_of_a_stack_are_ordinary_runs(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = settings()
    assert stackable(every) is None
    alone, together, killed = (folders(every, name) for name in ("alone", "together", "killed"))
    monkeypatch.setattr(
        "uplift.cli.fit.report", lambda run, *rest: (run.path / "report.md").touch()
    )  # tested elsewhere
    for one, run in zip(every, alone, strict=True):
        fit_settings(one, run)
    assert list(fit_stack(every, together, here / "stack")) == [None] * len(every)
    for one, other in zip(alone, together, strict=True):
        assert metrics(other) == pytest.approx(metrics(one), rel=0.01, abs=1e-3)
        assert {path.name for path in one.path.rglob("*")} == {path.name for path in other.path.rglob("*")}

    real = Checkpoints.on_train_batch_end

    def kill(self: Checkpoints, trainer: Any, module: Any, *rest: Any) -> None:
        real(self, trainer, module, *rest)
        if self.path.stem == "student_2" and trainer.global_step == 3:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "on_train_batch_end", kill)
        with pytest.raises(Killed):
            list(fit_stack(every, killed, here / "killed_stack"))
    list(fit_stack(every, killed, here / "killed_stack"))
    for one, other in zip(together, killed, strict=True):
        assert metrics(one) == metrics(other)
        assert all(torch.equal(value, weights(other)[name]) for name, value in weights(one).items())

    # A run alone goes on where the stack left it, with Adam's state: here from the end of the first two stages.
    (together[1].checkpoints / "student_2.ckpt").unlink()
    before = weights(together[1])
    fit_settings(every[1], together[1])
    for name, value in weights(together[1]).items():
        torch.testing.assert_close(value, before[name], rtol=0.05, atol=0.05)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("lifter.options.units=8",), "lifter.options.units differs (16, 8)"),
        (("teacher.batch_size=8",), "teacher.batch_size differs (16, 8)"),
        (("priors.bones.weight=3",), None),
        (("priors.flow.noise=0.1", "teacher.learning_rate=0.01", "student.mix=0.1"), None),
        (("priors.flow.steps=4",), "priors.flow.steps differs (3, 4)"),
    ],
)
def test_what_cannot_be_stacked_is_named(words: Sequence[str], reason: str | None, here: Path) -> None:
    found = stackable([*settings(seeds=1), *settings(*words, seeds=1)])
    assert found == reason if reason is None else str(found).startswith(reason)


PRIOR = """
import uplift
class Counting(uplift.Prior):
    def loss(self, lift):
        {loss}
"""


@pytest.mark.parametrize(
    ("loss", "words"),
    [
        (
            "return lift.pose.square().mean() * float(lift.pose.mean() > 0)",
            "my.py, line 5: RuntimeError: vmap: It looks like you're calling .item() on a Tensor",
        ),
        (
            "self.calls = getattr(self, 'calls', 0) + 1; return lift.pose.square().mean() * self.calls",
            "keeps something of its own",
        ),
        ("return (lift.pose * lift.pose.new_empty(3).normal_()).square().mean()", "random"),
    ],
)
def test_a_prior_that_cannot_be_stacked_is_one_clear_line(loss: str, words: str, here: Path) -> None:
    (here / "my.py").write_text(PRIOR.format(loss=loss))
    every = settings("priors.mine.use=my.py:Counting", "student.share=0", seeds=2)
    runs = folders(every, "runs_of")
    with granted(consent_of(["my.py:Counting"])), pytest.raises(NotStackable) as found:
        list(fit_stack(every, runs, here / "stack"))
    assert "\n" not in str(found.value)
    assert words in str(found.value)
