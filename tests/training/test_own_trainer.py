"""`KeypointData`, `LiftingModule` and `StudentModule` in a Trainer of the user's own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import pytest
import torch
from bodies import body_arrays, write_body
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint, Timer
from lightning.pytorch.loggers import CSVLogger
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode

import uplift
from uplift.metrics.evaluate_shapes import evaluate_shapes
from uplift.models.lifter import Lifter
from uplift.training.base import seeded

SMALL: dict[str, Any] = {"options": {"units": 16, "blocks": 1}}
PRIORS: dict[str, Any] = {
    "flow": {"weight": 1.0, "steps": 3, "units": 8},
    "bones": 10.0,
    "critic": {"units": 8, "blocks": 1},
}
QUIET: dict[str, Any] = {
    "accelerator": "cpu", "logger": False, "enable_checkpointing": False, "enable_progress_bar": False,
    "enable_model_summary": False, "num_sanity_val_steps": 0,
}  # fmt: skip


def data_of(folder: Path, **options: Any) -> uplift.KeypointData:
    """Return 120 frames of bodies, in steps of 16."""
    given = {"val": 0.2, "batch_size": 16, "test": write_body(folder / "b.npz", seed=5)} | options
    return uplift.KeypointData(write_body(folder / "a.npz", frames=120), "h36m17", **given)


def module_of(cls: type[uplift.LiftingModule] = uplift.LiftingModule, **options: Any) -> uplift.LiftingModule:
    """Return a small module."""
    return cls("h36m17", **{"priors": PRIORS, "lifter": SMALL, "average": 0.9} | options)


def fit(module: L.LightningModule, data: uplift.KeypointData, ckpt_path: Any = None, **flags: Any) -> L.Trainer:
    """Return the trainer after a fit."""
    trainer = L.Trainer(**{**QUIET, **flags})
    trainer.fit(module, data, ckpt_path=ckpt_path)
    return trainer


def weights(module: L.LightningModule) -> dict[str, torch.Tensor]:
    """Return a copy of all weights and buffers."""
    return {key: value.detach().clone() for key, value in module.state_dict().items()}


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def test_ten_lines_train_validate_test_predict_and_load(here: Path) -> None:
    """The figures that are logged are those of `uplift evaluate`."""
    data, module = data_of(here), module_of()
    best = ModelCheckpoint("best", monitor="val/p_mpjpe")
    callbacks, logger = [best, LearningRateMonitor()], CSVLogger("logs")
    trainer = fit(
        module, data, max_epochs=2, callbacks=callbacks, logger=logger, enable_checkpointing=True, log_every_n_steps=1
    )
    steps = 2 * -(-96 // 16)
    assert trainer.global_step == steps
    rows = np.genfromtxt(Path(logger.log_dir) / "metrics.csv", delimiter=",", names=True, deletechars="")
    logged = rows["train/flow"][np.isfinite(rows["train/flow"])]
    assert len(logged) == steps and len(set(logged)) == steps
    assert {"train/bones", "train/critic", "train/critic_own", "train/loss", "val/p_mpjpe"} <= set(rows.dtype.names)
    rates = rows["lr-Adam/lifter"][np.isfinite(rows["lr-Adam/lifter"])]
    assert rates[0] == pytest.approx(1e-3) and rates[-1] == pytest.approx(1e-3 * module.schedule((steps - 1) / steps))
    loaded = uplift.LiftingModule.load_from_checkpoint(best.best_model_path)
    (found,) = L.Trainer(**QUIET).validate(loaded, data, verbose=False)
    assert found["val/p_mpjpe"] == pytest.approx(float(best.best_model_score))
    (tested,) = trainer.test(module, data, verbose=False)
    module.save("lifter.pt")
    module.model().predict(data.test_samples)
    expected = uplift_evaluation(here / "lifter.pt", here / "b.npz")
    assert {name: tested[f"test/{name}"] for name in expected} == pytest.approx(expected, rel=1e-6)
    (prediction,) = trainer.predict(module, data)
    assert prediction.pose.shape == (60, 17, 3)
    assert np.array_equal(prediction.pose, uplift.load("lifter.pt").predict(data.test_samples).pose)


def uplift_evaluation(lifter: Path, test: Path) -> dict[str, float]:
    """Return what `uplift evaluate` prints of poses that `uplift predict` wrote of the file."""
    uplift.predict(lifter, test, "poses.npz")
    return dict(uplift.evaluate_poses("poses.npz", test).overall)


def test_without_truth_a_score_of_the_2d_alone_is_logged(here: Path) -> None:
    arrays = body_arrays(120)
    data = uplift.KeypointData((arrays["keypoints"], np.ones((120, 17))), "h36m17", val=0.2, batch_size=16)
    found = fit(module_of(), data, max_epochs=1).callback_metrics
    assert {"val/score_2d", "val/unrealistic", "val/uncovered"} <= found.keys() and "val/p_mpjpe" not in found
    assert np.isfinite(float(found["val/score_2d"]))
    few = uplift.KeypointData((arrays["keypoints"], np.ones((120, 17))), "h36m17", val=0.1, batch_size=16)
    with pytest.warns(UserWarning, match="expected 20 or more"):
        assert "val/score_2d" not in fit(module_of(), few, max_epochs=1).callback_metrics


def test_a_fit_that_goes_on_from_a_checkpoint_ends_bit_identical(here: Path) -> None:
    """In the middle of an epoch and at its end, with validation in between and a schedule over all of it."""
    whole, saver = module_of(), ModelCheckpoint("all", "{step}", every_n_train_steps=1, save_top_k=-1)
    flags: dict[str, Any] = {"max_epochs": 3, "enable_checkpointing": True}
    fit(whole, data_of(here), callbacks=[saver], **flags)
    for step in (1, 4, 6, 7, 12, 17):
        again = module_of()
        fit(again, data_of(here), ckpt_path=f"all/step={step}.ckpt", callbacks=[ModelCheckpoint("others")], **flags)
        assert same(weights(again), weights(whole)), step
        assert again.global_step == whole.global_step == 18


def test_global_random_numbers_change_nothing_and_are_left_alone(here: Path) -> None:
    results = []
    for noise in (0, 5):
        torch.manual_seed(noise)
        torch.rand(noise)
        before = torch.get_rng_state()
        module = module_of()
        assert torch.equal(before, torch.get_rng_state())
        fit(module, data_of(here), max_steps=3)
        results.append(weights(module))
    assert same(*results)
    other = module_of(seed=1)
    fit(other, data_of(here), max_steps=3)
    assert not same(results[0], weights(other))


@pytest.mark.parametrize(
    "flags",
    [
        {"fast_dev_run": True},
        {"accumulate_grad_batches": 2, "max_steps": 3, "gradient_clip_val": 1.0},
        {"overfit_batches": 1, "max_epochs": 2},
        {"max_time": {"seconds": 1}, "max_epochs": -1},
        {"max_epochs": 1, "limit_train_batches": 2, "val_check_interval": 1, "detect_anomaly": True},
    ],
)
def test_flags_of_the_trainer(here: Path, flags: dict[str, Any]) -> None:
    module = module_of()
    before = weights(module)
    fit(module, data_of(here), **flags)
    after = weights(module)
    assert all(value.isfinite().all() for value in after.values() if value.is_floating_point())
    assert not torch.equal(before["lifter.network.enter.weight"], after["lifter.network.enter.weight"])
    if "max_time" in flags:
        assert module.done == 1


class Draws(L.Callback):
    """Remember what each batch drew, and the learning rate."""

    def __init__(self) -> None:
        self.drawn: list[torch.Tensor] = []
        self.rates: list[float] = []

    def on_train_batch_end(self, trainer: L.Trainer, module: Any, *rest: Any) -> None:
        self.lift = module.last_lift
        self.drawn.append(self.lift.keypoints)
        self.rates.append(module.optimizers().param_groups[0]["lr"])


def test_batches_of_one_accumulated_step_are_different(here: Path) -> None:
    draws = Draws()
    fit(module_of(), data_of(here), accumulate_grad_batches=3, max_steps=2, callbacks=[draws])
    assert len(draws.drawn) == 6
    assert len({float(one.sum()) for one in draws.drawn}) == 6


def test_the_schedule_follows_steps_epochs_or_a_timer(here: Path) -> None:
    for flags in ({"max_steps": 12}, {"max_epochs": 2}):
        draws = Draws()
        module = module_of(decay_from=0.0, warm_up=0.0)
        fit(module, data_of(here), callbacks=[draws], **flags)
        assert draws.rates == pytest.approx([1e-3 * module.schedule(step / 12) for step in range(12)])
    draws, timer = Draws(), Timer({"seconds": 2})
    fit(module_of(decay_from=0.0), data_of(here), callbacks=[draws, timer], max_epochs=-1)
    assert draws.rates[-1] < 0.1e-3 and draws.rates == sorted(draws.rates, reverse=True)


def test_a_student_learns_from_a_module(here: Path) -> None:
    data, teacher = data_of(here), module_of()
    fit(teacher, data, max_steps=3)
    before = weights(teacher)
    student = uplift.StudentModule("h36m17", teacher=teacher, lifter=SMALL, refine={"iterations": 2})
    trainer = fit(student, data, max_steps=3)
    assert same(before, weights(teacher)) and not any(key.startswith("teacher") for key in weights(student))
    trainer.save_checkpoint("student.ckpt")
    loaded = uplift.StudentModule.load_from_checkpoint("student.ckpt")
    assert same(weights(loaded), weights(student))
    one, other = (module.model().predict(data.test_samples).pose for module in (loaded, student))
    assert np.array_equal(one, other)
    alone = uplift.StudentModule("h36m17", lifter=SMALL)
    with pytest.raises(uplift.UserError, match="needs teacher="):
        fit(alone, data, max_steps=1)
    labelled = data_of(here, labelled=1.0)
    fit(alone, labelled, max_steps=2)
    assert alone.model().predict(data.test_samples).unit == "mm"


def test_a_second_fit_takes_the_data_it_is_given(here: Path) -> None:
    module, first = module_of(), data_of(here)
    fit(module, first, max_steps=1)
    frames = module.frames
    fit(module, first, max_steps=1)
    assert torch.equal(module.frames.keypoints, frames.keypoints)
    second = uplift.KeypointData(write_body(here / "c.npz", frames=80, seed=9), "h36m17", val=0, batch_size=16)
    fit(module, second, max_steps=1)
    assert len(module.frames) == 80


class Plain(uplift.LiftingModule):
    """An optimiser and a schedule of its own."""

    def configure_optimizers(self) -> Any:
        optimizer = torch.optim.SGD(self.parameters(), lr=1e-4)
        return [optimizer], [torch.optim.lr_scheduler.StepLR(optimizer, 1, 0.5)]


def test_an_optimiser_of_ones_own_keeps_its_schedule(here: Path) -> None:
    draws = Draws()
    fit(module_of(Plain), data_of(here), max_epochs=2, callbacks=[draws])
    assert draws.rates[:5] == [1e-4] * 5 and draws.rates[6:11] == [0.5e-4] * 5


def test_labels_take_part(here: Path) -> None:
    draws, module = Draws(), module_of(priors={**PRIORS, "labelled": 40.0})
    fit(module, data_of(here, labelled=0.5), max_steps=2, callbacks=[draws])
    assert {"labelled", "labelled_views"} <= module.logged.keys()
    assert (module.lifter.bone_mm > 50).all() and torch.equal(module.final.bone_mm, module.lifter.bone_mm)
    default = uplift.LiftingModule("h36m17", lifter=SMALL)
    assert "labelled" in default.priors
    default.priors["flow"].steps = 3
    default.prepare(data_of(here))
    assert "labelled" not in default.terms.priors


class Flatter(uplift.LiftingModule):
    """A term of its own, with an option."""

    def __init__(self, skeleton: Any, *, strength: float = 0.5, **options: Any):
        super().__init__(skeleton, **options)
        self.strength = strength
        self.save_hyperparameters("strength")

    def objective(self, batch: Any) -> tuple[torch.Tensor, dict[str, Any]]:
        loss, terms = super().objective(batch)
        depth = self.last_lift.pose[..., 2].abs().mean()
        return loss + self.strength * depth, {**terms, "depth": depth.detach()}


class Behind(uplift.LiftingModule):
    """Views from behind alone."""

    def configure_views(self) -> Any:
        return lambda lifted: torch.diag(torch.tensor([-1.0, 1.0, -1.0])).expand(len(lifted.tilt), 3, 3)


class Wide(uplift.LiftingModule):
    """A network of its own."""

    def configure_lifter(self) -> Lifter:
        network = nn.Sequential(nn.Linear(3 * 17, 24), nn.ReLU(), nn.Linear(24, 17 * 3 + 1))
        return Lifter(self.skeleton, self.lifter_settings, network)


def test_subclasses_are_small_and_load_again(here: Path) -> None:
    data = data_of(here)
    flatter = module_of(Flatter, strength=2.0)
    fit(flatter, data, max_steps=2).save_checkpoint("flatter.ckpt")
    assert "depth" in flatter.logged
    loaded = Flatter.load_from_checkpoint("flatter.ckpt")
    assert loaded.strength == 2.0 and same(weights(loaded), weights(flatter))
    behind, draws = module_of(Behind), Draws()
    fit(behind, data, max_steps=1, callbacks=[draws])
    lift = draws.lift
    assert behind.last_lift is None, "no graph is kept"
    torch.testing.assert_close(lift.rotated[..., [0, 2]], -lift.pose[..., [0, 2]])
    wide = module_of(Wide)
    fit(wide, data, max_steps=2).save_checkpoint("wide.ckpt")
    assert same(weights(Wide.load_from_checkpoint("wide.ckpt")), weights(wide))


NET = """
from torch import nn

class Net(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.layer = nn.Linear(inputs, outputs)

    def forward(self, features):
        return self.layer(features)
"""


def test_a_network_of_a_file_is_found_from_anywhere(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "net.py").write_text(NET)
    data, module = data_of(here), module_of(lifter={"network": "net.py:Net"})
    fit(module, data, max_steps=1).save_checkpoint("a.ckpt")
    module.save("a.pt")
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert same(weights(uplift.LiftingModule.load_from_checkpoint("../a.ckpt", trust="../net.py")), weights(module))
    assert uplift.load("../a.pt", trust="../net.py").predict(data.test_samples).pose.shape == (60, 17, 3)


class Wrong(uplift.LiftingModule):
    """Views that are no rotations."""

    def configure_views(self) -> Any:
        return lambda lifted: torch.ones(len(lifted.tilt), 3, 3)


class Detector(L.LightningModule):
    """A detector and a lifter trained together, on pictures of one bright pixel a joint."""

    def __init__(self) -> None:
        super().__init__()
        self.detector = nn.Linear(10, 17 * 2)
        self.lifting = module_of()

    def training_step(self, batch: torch.Tensor, batch_idx: int) -> torch.Tensor:
        keypoints = 500 + 100 * self.detector(batch).reshape(-1, 17, 2)
        loss, _ = self.lifting.objective(keypoints)
        return loss

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.parameters(), lr=1e-3)


def test_a_bigger_module_trains_a_detector_through_the_lifter(here: Path) -> None:
    module = Detector()
    module.lifting.prepare(data_of(here))
    before = module.detector.weight.detach().clone()
    loader = torch.utils.data.DataLoader(torch.randn(32, 10, generator=torch.Generator().manual_seed(0)), batch_size=8)
    L.Trainer(**QUIET, max_epochs=1).fit(module, loader)
    assert not torch.equal(before, module.detector.weight) and module.detector.weight.isfinite().all()


def test_forward_is_differentiable_and_in_pixels() -> None:
    module = module_of()
    keypoints = torch.from_numpy(body_arrays(20)["keypoints"]).requires_grad_()
    pose = module(keypoints)
    assert pose.shape == (20, 17, 3) and (pose[:, module.skeleton.root_index] == 0).all()
    moved, larger = module(keypoints + 50), module(keypoints * 2)
    torch.testing.assert_close(moved, pose, rtol=1e-3, atol=0.05)
    torch.testing.assert_close(larger, 2 * pose, rtol=1e-3, atol=0.1)
    pose.square().sum().backward()
    assert keypoints.grad is not None and keypoints.grad.abs().sum() > 0


def test_loaders_of_the_users_own(here: Path) -> None:
    """Batches of pixels in any of three forms."""
    keypoints = torch.from_numpy(body_arrays(64)["keypoints"])
    sets = [
        keypoints,
        torch.utils.data.TensorDataset(keypoints, torch.ones(64, 17)),
        [{"keypoints": k} for k in keypoints],
    ]
    results = []
    for one in sets:
        module = module_of()
        module.prepare(data_of(here))
        L.Trainer(**QUIET, max_epochs=1).fit(module, torch.utils.data.DataLoader(one, batch_size=16))
        results.append(weights(module))
    assert same(results[0], results[1]) and same(results[1], results[2])


ERRORS = [
    (lambda here: uplift.LiftingModule("h36m17", lerning_rate=1e-3), "'lerning_rate' is not an option of a module. Did you mean 'learning_rate'"),
    (lambda here: uplift.LiftingModule("h36m17", batch_size=8), "batch_size is not an option of a module"),
    (lambda here: uplift.LiftingModule("h36m17", learning_rate=-1.0), "teacher.learning_rate=-1.0: expected a number above 0"),
    (lambda here: uplift.LiftingModule("h36m17", priors={"flwo": 1.0}), "no such built-in. Did you mean 'flow'"),
    (lambda here: uplift.LiftingModule("h36m17", priors={}), "No prior is on"),
    (lambda here: uplift.LiftingModule("h36m17", lifter={"network": "kodu"}), "no such network. Valid: kudo, residual"),
    (lambda here: uplift.LiftingModule("h36m17", lifter={"cammera": "x"}), "unknown setting 'lifter.cammera'. Did you mean 'lifter.camera'"),
    (lambda here: uplift.KeypointData("a.npz", "h36m17", formt="csv"), "'formt' is not an option of the data. Did you mean 'format'"),
    (lambda here: uplift.KeypointData("a.npz"), "needs skeleton=NAME"),
    (lambda here: uplift.KeypointData("none.npz", "h36m17").setup("fit"), "No file"),
    (lambda here: uplift.KeypointData(np.zeros((5, 3, 2)), "h36m17").setup("fit"), "expected (frames, 17, 2)"),
    (lambda here: uplift.KeypointData("a.npz", "h36m17", batch_size=1), "batch_size=1: expected a whole number of at least 2"),
    (lambda here: uplift.KeypointData("a.npz", "h36m17", val=1.5), "val=1.5: expected a share"),
    (lambda here: uplift.KeypointData(None, "h36m17").setup("fit"), "There are no training data"),
    (lambda here: data_of(here, test=None).test_samples, "There are no test data"),
    (lambda here: fit(module_of(), uplift.KeypointData(30, "hand21", batch_size=8), max_steps=1), "skeleton 'hand21' (21 joints), the module 'h36m17' (17 joints)"),
    (lambda here: L.Trainer(**QUIET, max_steps=1).fit(module_of(), [8, 8]), "trains on a uplift.KeypointData"),
    (lambda here: fit(module_of(Wrong), data_of(here), max_steps=1), "are not rotations"),
]  # fmt: skip


@pytest.mark.parametrize(("act", "message"), ERRORS)
def test_what_is_wrong_is_said(here: Path, act: Any, message: str) -> None:
    with pytest.raises(uplift.UserError) as error:
        act(here)
    assert message in str(error.value), str(error.value)


def test_priors_are_given_as_weights_settings_classes_or_objects(here: Path) -> None:
    from uplift.priors.bones import Bones

    class Ground(uplift.Prior):
        def loss(self, lift: Any) -> Any:
            return lift.level_pose[..., 1].amax(1)

    skeleton = uplift.load_skeleton("h36m17")
    given = {"flow": {"weight": 2.0, "steps": 3}, "ground": Ground, "bones": Bones(skeleton), "symmetry": 0.5}
    module = module_of(priors=given)
    assert module.terms.weights == {"flow": 2.0, "symmetry": 0.5, "ground": 1.0, "bones": 1.0}
    fit(module, data_of(here), max_steps=1).save_checkpoint("a.ckpt")
    with pytest.raises(uplift.UserError, match="pass priors="):
        uplift.LiftingModule.load_from_checkpoint("a.ckpt")
    loaded = uplift.LiftingModule.load_from_checkpoint("a.ckpt", priors=given)
    assert same(weights(loaded), weights(module))


def test_checkpoints_are_plain_data(here: Path) -> None:
    """Nothing in them can run."""
    fit(module_of(), data_of(here), max_steps=1).save_checkpoint("a.ckpt")
    state = torch.load("a.ckpt", weights_only=True)
    assert json.dumps(state["hyper_parameters"])
    assert state["hyper_parameters"]["skeleton"]["root"] == "hip"


@pytest.mark.parametrize("kind", ["deeplabcut", "simulated", "arrays", "poses"])
def test_data_of_any_origin(here: Path, kind: str) -> None:
    """The same ten lines on a tracker's csv, the simulator, arrays and `PoseData`."""
    if kind == "deeplabcut":
        uplift.simulate("h36m17", "film.csv", frames=90, clip_seconds=1.5, tracker="deeplabcut")
        given: Any = "film_*.csv"
    elif kind == "simulated":
        given = 90
    else:
        arrays = body_arrays(90)
        given = (arrays["keypoints"], np.ones((90, 17)))
        if kind == "poses":
            given = uplift.PoseData(*given, tuple(reversed(arrays["joint_names"].tolist())), stills=True)
            given.keypoints[:] = given.keypoints[:, ::-1]
    data = uplift.KeypointData(given, "h36m17", val=0.3, batch_size=16)
    module = module_of()
    trainer = fit(module, data, max_epochs=1)
    assert trainer.global_step == -(-len(data.train_samples) // 16)
    assert len(data.train_samples) + len(data.val_samples) in range(80, 91)
    known = "val/p_mpjpe" if kind == "simulated" else "val/score_2d"
    assert np.isfinite(float(trainer.callback_metrics[known]))
    clips = [
        set(zip(*(np.asarray(part.identity[key]) for key in ("sequence",)), strict=True))
        for part in (data.train_samples, data.val_samples)
        if "sequence" in part.identity
    ]
    assert len(clips) < 2 or not clips[0] & clips[1] or kind == "deeplabcut"


SHAPE: dict[str, Any] = {
    "coarse": 8, "detail": 12, "crop": 12, "pixels": 12, "code": 4, "hidden": 16, "parts": 1, "resolution": 12, "refine": 2,
    "elevation_deg": (20.0, 1.0),
}  # fmt: skip


def views_found(data: uplift.MaskDataModule) -> uplift.MixtureModule:
    """Return what a space of shapes starts from."""
    views = uplift.MixtureModule(shape=SHAPE)
    fit(views, data, max_steps=2)
    return views


def test_masks_have_classes_of_their_own(here: Path) -> None:
    data = uplift.MaskDataModule(60, family="chairs", side=32, batch_size=16, shape=SHAPE, val=0.05)
    views, priors = uplift.MixtureModule(shape=SHAPE), {"smoothness": 0.1, "mask_critic": {"weight": 0.1}}
    flags: dict[str, Any] = {"enable_checkpointing": True, "log_every_n_steps": 1, "max_epochs": 3}
    saver = ModelCheckpoint("views", "{step}", monitor=None, every_n_train_steps=1, save_top_k=-1)
    assert "train/energy" in fit(views, data, callbacks=[saver], **flags).callback_metrics
    again = uplift.MixtureModule(shape=SHAPE)
    fit(again, data, ckpt_path="views/step=7.ckpt", callbacks=[ModelCheckpoint("others")], **flags)
    assert same(weights(again), weights(views))
    module = uplift.ShapeModule(views, shape=SHAPE, priors=priors)
    saver = ModelCheckpoint("masks", "{step}", monitor=None, every_n_train_steps=1, save_top_k=-1)
    trainer = fit(module, data, callbacks=[saver], **flags)
    assert trainer.global_step == 3 * -(-len(data.train_samples) // 16) == 12
    assert {
        "train/silhouettes",
        "train/code",
        "train/smoothness",
        "val/volume_iou",
    } <= trainer.callback_metrics.keys()
    assert data.train_samples.truth is None and data.val_samples.truth is not None
    for step in (5, 8):
        again = uplift.ShapeModule(shape=SHAPE, priors=priors)  # poses are in the checkpoint
        fit(again, data, ckpt_path=f"masks/step={step}.ckpt", callbacks=[ModelCheckpoint("others")], **flags)
        assert same(weights(again), weights(module)), step
    loaded = uplift.ShapeModule.load_from_checkpoint("masks/step=12.ckpt")
    assert same(weights(loaded), weights(module))
    (found,) = trainer.test(loaded, data, verbose=False)
    (prediction,) = trainer.predict(loaded, data)
    assert len(prediction) == len(data.test_samples) and 0 <= found["test/volume_iou"] <= 1
    loaded.save("shapes.pt")
    prediction = uplift.load("shapes.pt").predict(data.test_samples.without_truth())
    expected = evaluate_shapes(prediction, data.test_samples.truth, data.test_samples.masks, "", None).overall
    assert {name: found[f"test/{name}"] for name in expected} == pytest.approx(expected, rel=1e-6)
    finer = module.go_on(16)
    fit(finer, data, max_steps=2)
    assert finer.lifter.detail == 16 and finer.priors is module.priors
    unknown = uplift.MaskDataModule(data.train_samples.without_truth(), val=0.2, batch_size=16)
    other = uplift.ShapeModule(loaded.final, shape=SHAPE)
    assert "val/silhouette_iou_seen" in fit(other, unknown, max_epochs=1).callback_metrics


class Lighter(uplift.ShapeModule):
    """A term of its own."""

    def objective(self, batch: int) -> tuple[torch.Tensor, dict[str, Any]]:
        loss, terms = super().objective(batch)
        light = self.lifter.last.bias.sigmoid().mean()
        return loss + 1e4 * light, {**terms, "light": light.detach()}


def test_a_subclass_for_masks(here: Path) -> None:
    data = uplift.MaskDataModule(30, family="chairs", side=32, batch_size=16, shape=SHAPE, val=0)
    views = views_found(data)
    module, plain = Lighter(views, shape=SHAPE), uplift.ShapeModule(views, shape=SHAPE)
    for one in (module, plain):
        fit(one, data, max_steps=6)
    assert "light" in module.logged and module.lifter.last.bias.mean() < plain.lifter.last.bias.mean()
    assert isinstance(module.go_on(), Lighter)
    with pytest.raises(uplift.UserError, match="trains on a uplift.MaskDataModule"):
        fit(uplift.ShapeModule(views, shape=SHAPE), data_of(here), max_steps=1)
    with pytest.raises(uplift.UserError, match="trains on a uplift.MaskDataModule"):
        fit(uplift.MixtureModule(shape=SHAPE), data_of(here), max_steps=1)


class Endless(torch.utils.data.IterableDataset):
    """Keypoints without a length."""

    def __iter__(self) -> Any:
        return iter(torch.from_numpy(body_arrays(48)["keypoints"]))


def test_a_loader_without_a_length_keeps_the_rate(here: Path) -> None:
    module, draws = module_of(), Draws()
    module.prepare(data_of(here))
    loader = torch.utils.data.DataLoader(Endless(), batch_size=16)
    L.Trainer(**QUIET, max_epochs=2, callbacks=[draws]).fit(module, loader)
    assert draws.rates == [1e-3] * 6


def test_what_is_left_of_a_fit_does_not_reach_the_next(here: Path) -> None:
    """Neither a student's views, nor labels, nor sizes of bodies."""
    first, labelled = data_of(here), data_of(here, labelled=0.5)
    second = uplift.KeypointData(write_body(here / "c.npz", frames=80, seed=9), "h36m17", val=0, batch_size=32)
    teacher = module_of(priors={**PRIORS, "labelled": {"weight": 40.0, "if_possible": True}})
    fit(teacher, first, max_steps=1)
    assert "labelled" not in teacher.logged
    fit(teacher, labelled, max_steps=1)
    assert "labelled_views" in teacher.logged and teacher.lifter.bone_mm.any()
    fit(teacher, first, max_steps=1)
    assert "labelled" not in teacher.logged and not teacher.lifter.bone_mm.any()
    students = [
        uplift.StudentModule("h36m17", teacher=teacher, lifter=SMALL, refine={"iterations": 0}) for _ in range(2)
    ]
    fit(students[0], first, max_steps=1)
    students[0].load_state_dict(students[1].state_dict())
    for student in students:
        fit(student, second, max_steps=1)
    assert same(weights(students[0]), weights(students[1]))


def test_modules_are_copied_pickled_and_saved_without_harm(here: Path) -> None:
    import copy
    import pickle

    data, module = data_of(here), module_of()
    assert "not read yet" in str(data)
    fit(module, data, max_steps=1)
    assert "120 frames" in str(data) and same(weights(copy.deepcopy(module)), weights(module))
    assert same(weights(pickle.loads(pickle.dumps(module_of()))), weights(module_of()))
    (here / "mine.txt").write_text("mine")
    with pytest.raises(uplift.UserError, match="is not overwritten"):
        module.save("mine.txt")
    assert (here / "mine.txt").read_text() == "mine"
    module.train()
    module.model()
    assert module.lifter.training


def test_missing_joints_are_ignored_whatever_they_hold(here: Path) -> None:
    module = module_of()
    module.prepare(data_of(here))
    keypoints, confidence = torch.from_numpy(body_arrays(20)["keypoints"]), torch.ones(20, 17)
    confidence[:, 3] = 0
    other = keypoints.clone()
    other[:, 3] = torch.nan
    torch.testing.assert_close(module(other, confidence), module(keypoints, confidence))
    torch.testing.assert_close(module(other), module(keypoints, confidence))
    assert module.objective((other, confidence))[0].isfinite()


class _Half(TorchDispatchMode):
    """Notes the operations on numbers of half precision, forwards and backwards."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if any(isinstance(one, torch.Tensor) and one.dtype == torch.bfloat16 for one in args):
            self.seen.add(func.overloadpacket.__name__)
        return func(*args, **(kwargs or {}))


OF_NETWORKS = {
    "_to_copy", "add", "addmm", "alias", "detach", "leaky_relu", "leaky_relu_backward", "mm", "mul", "native_layer_norm",
    "native_layer_norm_backward", "sum", "t", "view",
}  # fmt: skip


def test_mixed_precision_is_for_networks_alone(here: Path) -> None:
    """Every prior, hidden and labelled joints, a student of any camera: the losses are those of full precision."""
    names = ("bones", "pairwise", "handedness", "consistency", "symmetry", "critic", "labelled", "fill")
    priors = {**dict.fromkeys(names, 1.0), "flow": {"weight": 1.0, "steps": 3}}
    data = data_of(here, labelled=0.5)
    teacher = module_of(priors=priors, hide=0.2)
    student = uplift.StudentModule("h36m17", teacher=teacher, refine={"iterations": 2}, cameras="any")
    for module, clip in ((teacher, 1.0), (student, None)):
        before = weights(module)
        fit(module, data, precision="bf16-mixed", gradient_clip_val=clip, max_steps=3)
        after = weights(module)
        assert all(value.dtype == before[name].dtype and value.isfinite().all() for name, value in after.items())
        assert not same(before, after)
        with seeded(0):
            expected = module.objective(16)[1]
        with seeded(0), _Half() as half:
            with torch.autocast("cpu", torch.bfloat16):
                loss, found = module.objective(16)
            loss.backward()
        assert half.seen <= OF_NETWORKS and {"addmm", "mm"} <= half.seen
        for name, value in expected.items():
            assert float(found[name]) == pytest.approx(float(value), rel=0.05, abs=0.02), name


def test_mixed_precision_around_a_lifter_in_a_larger_module_and_of_masks(here: Path) -> None:
    module = Detector()
    module.lifting.prepare(data_of(here))
    loader = torch.utils.data.DataLoader(torch.randn(16, 10, generator=torch.Generator().manual_seed(0)), batch_size=8)
    L.Trainer(**QUIET, max_epochs=1, precision="bf16-mixed").fit(module, loader)
    masks = uplift.MaskDataModule(20, family="chairs", side=32, batch_size=8, shape=SHAPE)
    shapes = uplift.ShapeModule(views_found(masks), shape=SHAPE, priors={"smoothness": 1.0})
    L.Trainer(**QUIET, max_steps=2, precision="bf16-mixed").fit(shapes, masks)
    for part in (module.detector, shapes):
        assert all(value.isfinite().all() and value.dtype == torch.float32 for value in part.parameters())


def test_numbers_of_numpy_and_priors_with_weights(here: Path) -> None:
    from uplift.priors.bones import Bones

    priors = {"bones": {"use": Bones, "weight": np.float64(3)}, "symmetry": np.float32(0.5)}
    module = module_of(priors=priors, learning_rate=np.float32(1e-3))
    assert module.terms.weights == {"bones": 3.0, "symmetry": 0.5}
    with pytest.raises(uplift.UserError, match="cannot be set beside a class"):
        module_of(priors={"bones": {"use": Bones, "labels": False}})
    assert len(uplift.KeypointData(np.int64(40), "h36m17", val=0, batch_size=np.int64(8)).train_samples) == 40


def test_a_checkpoint_of_a_stranger_runs_no_file_that_lies_nearby(here: Path) -> None:
    fit(module_of(), data_of(here), max_steps=1).save_checkpoint("a.ckpt")
    state = torch.load("a.ckpt", weights_only=True)
    state["hyper_parameters"]["lifter"]["network"] = "net.py:Net"
    torch.save(state, "b.ckpt")
    (here / "net.py").write_text("open('ran', 'w')\n" + NET)
    with pytest.raises(uplift.UserError, match=r"b\.ckpt: .*add trust=net\.py"):
        uplift.LiftingModule.load_from_checkpoint("b.ckpt")
    assert not (here / "ran").exists()
    with pytest.raises(uplift.UserError, match="load_from_checkpoint"):
        uplift.load("a.ckpt")


class Thin(uplift.ShapePrior):
    """Little volume."""

    def loss(self, lift: Any) -> Any:
        return lift.occupancy.mean()


def test_labelled_masks_load_again_and_priors_of_ones_own_go_on(here: Path) -> None:
    data = uplift.MaskDataModule(40, family="chairs", side=32, batch_size=16, shape=SHAPE, val=0, labelled=0.5)
    thin = {"thin": {"use": Thin, "weight": 2.0}}
    views = uplift.MixtureModule(shape=SHAPE, priors=thin)
    fit(views, data, max_steps=2).save_checkpoint("views.ckpt")
    assert {"truth", "thin"} <= views.logged.keys()
    assert same(weights(uplift.MixtureModule.load_from_checkpoint("views.ckpt", priors={"thin": Thin})), weights(views))
    more = views.split(2)
    fit(more, data, max_steps=1)
    assert more.terms.weights == {"thin": 2.0} and "thin" in more.logged and len(more.lifter.logits) == 2
    module = uplift.ShapeModule(more, shape=SHAPE, priors=thin)
    fit(module, data, max_steps=2).save_checkpoint("a.ckpt")
    assert "truth" in module.logged
    loaded = uplift.ShapeModule.load_from_checkpoint("a.ckpt", priors={"thin": Thin})
    assert same(weights(loaded), weights(module))
    finer = module.go_on(16)
    fit(finer, data, max_steps=2)
    assert finer.terms.weights == {"thin": 2.0} and "thin" in finer.logged
