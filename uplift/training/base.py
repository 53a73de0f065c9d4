"""`TrainingModule`, the base of all training: random streams, schedule, optimiser, averaged weights, validation."""

from __future__ import annotations

import dataclasses
import math
import weakref
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar, cast

import lightning as L
import torch
from lightning.pytorch.callbacks import Timer
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from uplift.config import ranks
from uplift.config.device import mixed_precision
from uplift.config.files import read_torch
from uplift.config.loading import settings_from
from uplift.config.settings import Settings, StageSettings
from uplift.config.trust import Trust, consents
from uplift.data.samples import Samples
from uplift.errors import UserError, did_you_mean
from uplift.models.lifter import mixed_networks
from uplift.priors.base import Lift, Prior, ShapeLift
from uplift.training.objective import Logged, Objective

__all__ = [
    "TrainingModule",
    "add_given",
    "plain_settings",
    "prior_specs",
    "saved_priors",
    "seeded",
    "stage_settings",
    "stream_seed",
]


def stream_seed(seed: int, step: int) -> int:
    """Return the seed of the random stream of one step, different for every seed and step; all ranks have the same.

    It needs no saved state: a resumed fit draws the same numbers as an uninterrupted one.
    """
    mixed = 0x9E3779B97F4A7C15
    for part in (seed, 0, step):
        mixed = (mixed ^ (part & 0xFFFFFFFFFFFFFFFF)) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 29
    return mixed >> 1


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw from the stream of ``seed`` on the CPU, and leave the user's random numbers as they were."""
    before = torch.get_rng_state()
    torch.default_generator.manual_seed(seed)
    try:
        yield
    finally:
        torch.set_rng_state(before)


class _Average(AveragedModel):
    """An exponential moving average, with a shorter memory over the first steps; it counts them where no GPU has to wait."""

    def __init__(self, model: nn.Module, decay: float):
        super().__init__(model)
        self.decay, self._updates = decay, -1

    @torch.no_grad()
    def update_parameters(self, model: nn.Module) -> None:
        """Take the parameters of ``model`` into the average."""
        if self._updates < 0:  # new, or loaded
            self._updates = int(self.n_averaged)
        share = 1.0
        if self._updates:
            share = 1 - min(self.decay, (1 + self._updates) / (10 + self._updates))
        torch._foreach_lerp_([*self.module.parameters()], [*model.parameters()], share)
        self._updates += 1
        self.n_averaged += 1

    def _load_from_state_dict(self, *state: Any) -> None:
        self._updates = -1
        super()._load_from_state_dict(*state)


LifterT = TypeVar("LifterT", bound=nn.Module)
DataT = TypeVar("DataT", bound=Samples)


class TrainingModule(L.LightningModule, Generic[LifterT, DataT]):
    """Train a lifter with automatic optimisation: one optimiser, one backward pass per step.

    A subclass writes `prepare`, which takes the training data from a data module before the first step, and
    `objective`, the loss of a batch. The learning rate follows `schedule` over `done`, the share of the training that
    is over: of ``max_steps`` or ``max_epochs`` of the trainer, or of the time of a `lightning` ``Timer``, whichever
    is further.
    """

    settings: StageSettings
    lifter: LifterT
    averaged: AveragedModel | None
    terms: Objective
    """The priors that judge the lifter, if any."""
    frames: DataT | None = None
    """The training data on the module's device, in the lifter's units; None before `prepare`."""
    prepared_with: weakref.ref[Any] | None = None
    """The data module that `prepare` took the training data from; None where `frames` were set directly."""
    logged: Logged
    """The terms of the last step."""
    last_lift: Lift | ShapeLift | None = None
    """What priors judged in the last step."""
    done: float = 0.0
    """Share of the training that is over, 0..1."""
    log_prefix: str = "train"
    """Terms are logged as ``train/NAME``."""
    first_step: int = 0
    """Steps of earlier stages, which loggers count on from."""
    prepares_anywhere: ClassVar[bool] = False
    """Whether `prepare` works on the module's device, whatever that is."""
    prior_rate: float | None = None
    """The learning rate of the priors' own parameters; the lifter's where it is None."""
    _total_steps: float = math.inf
    _timers: tuple[Timer, ...] = ()
    _clocks_agree: bool = False
    _accumulated: int = 1
    _micro_batch: int = 0
    _clips_in_mixed_precision: bool = False
    _log_every: int = 0

    def set_up(self, lifter: LifterT, settings: StageSettings, seed: int, terms: Objective | None = None) -> None:
        """Set what the training works on; the last call of a subclass's ``__init__``."""
        self.lifter, self.settings, self.seed, self.logged = lifter, settings, seed, {}
        self.averaged = None
        if settings.average:
            self.averaged = _Average(lifter, settings.average)
            # Nothing trains them, and ranks must not wait for their gradients.
            self.averaged.requires_grad_(False)
        self.terms = terms or Objective({}, {})
        self.priors = nn.ModuleDict(self.terms.priors)

    @property
    def final(self) -> LifterT:
        """The lifter to evaluate and predict with: its averaged weights where `StageSettings.average` is set."""
        return self.lifter if self.averaged is None else cast(LifterT, self.averaged.module)

    # What a subclass writes.

    def prepare(self, data: Any) -> None:
        """Take the training data from the data module ``data``, before the first step and before a checkpoint is loaded."""
        raise NotImplementedError

    def objective(self, batch: Any) -> tuple[Tensor, Logged]:
        """Return the loss of ``batch`` and the numbers to log.

        Args:
            batch: what the data loader gave: how many frames to draw from `frames`, or a batch of data.
        """
        raise NotImplementedError

    def figures(self, batch: Any) -> dict[str, float]:
        """Return the metrics of validation or test data by name."""
        raise NotImplementedError

    # Data and steps.

    def setup(self, stage: str) -> None:
        """Prepare for training with the trainer's data module, unless that was done before."""
        clips = bool(self.trainer.gradient_clip_val)
        self._clips_in_mixed_precision = clips and "mixed" in str(self.trainer.precision)
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        other = self.prepared_with is not None and data is not None and data is not self.prepared_with()
        if stage == "fit" and (self.frames is None or other):
            self.prepare_on(self.trainer.strategy.root_device, data)

    def prepare_on(self, device: torch.device, data: Any) -> None:
        """Call `prepare` where the module is then trained, if it can: fitting priors and lifting poses take long."""
        if self.prepares_anywhere:
            self.to(device)
        self.prepare(data)

    def on_fit_start(self) -> None:
        """Move the training data to the module's device."""
        if self.frames is not None:
            self.frames = self.frames.to(self.device)

    def on_train_start(self) -> None:
        """Look up what ends the training, and set the learning rate of the first step."""
        steps = self.trainer.estimated_stepping_batches
        self._total_steps = steps if steps > 0 else math.inf  # not known: a loader without a length
        callbacks: list[L.Callback] = self.trainer.callbacks  # type: ignore[attr-defined]
        self._timers = tuple(c for c in callbacks if isinstance(c, Timer) and c.time_remaining() is not None)
        self._clocks_agree = all(getattr(timer, "agrees", False) for timer in self._timers)
        self._random = torch.get_rng_state()
        self._log_every = max(1, self.trainer.log_every_n_steps)  # type: ignore[attr-defined]
        self._set_rates()

    def on_train_end(self) -> None:
        """Log no more, give the user's random numbers back, and let go of the last step's graph."""
        self._log_every, self.last_lift = 0, None
        torch.set_rng_state(self._random)

    def on_train_batch_end(self, *rest: Any) -> None:
        """Set the learning rate of the next step."""
        self._set_rates()

    def _set_rates(self) -> None:
        """Set the learning rate for the share of the training that is over; not that of a subclass's own optimisers."""
        self.update_done()
        factor, optimizers = self.schedule(self.done), self.optimizers()
        for optimizer in optimizers if isinstance(optimizers, list) else [optimizers]:
            for group in optimizer.param_groups:
                if "peak" in group:
                    group["lr"] = group["peak"] * factor

    def update_done(self) -> None:
        """Set `done` for the steps and the time so far."""
        shares = [0.0, self.trainer.global_step / self._total_steps]
        for timer in self._timers:
            spent = timer.time_elapsed()
            shares.append(spent / (spent + (timer.time_remaining() or 0.0)))
        self.done = min(1.0, max(shares))
        if self._timers and not self._clocks_agree:  # ranks must agree on the learning rate
            (self.done,) = ranks.largest([self.done])

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        """Seed this step's random stream and return the loss of ``batch``, or of a batch drawn from the stream."""
        self._accumulated = self.trainer.accumulate_grad_batches if self._log_every else 1
        self._micro_batch = batch_idx % self._accumulated
        torch.manual_seed(self.step_seed)
        with self.sharing(batch), self.mixed_networks():
            loss, self.logged = self.objective(batch)
            if self._log_every and ((self.global_step + 1) % self._log_every == 0 or self.trainer.is_last_batch):
                self._log_terms(loss)
        return loss

    def sharing(self, batch: Any) -> AbstractContextManager[None]:
        """Return a context in which `objective` computes this rank's part of ``batch``, a number of samples or data."""
        count = self.rows_of(batch) if ranks.world() > 1 else None
        if count is None:
            return ranks.alone()
        share = ranks.Share.of if isinstance(batch, int) else ranks.Share.of_given
        return ranks.sharing(share(count, ranks.rank(), ranks.world()))

    def rows_of(self, batch: Any) -> int | None:
        """Return how many samples are in a batch; None where every rank computes the whole of it."""
        return None

    @property
    def stream_step(self) -> int:
        """The number of this step's random stream: of the optimiser's step and of the batch within it."""
        return self.global_step * self._accumulated + self._micro_batch

    @property
    def step_seed(self) -> int:
        """The seed of this step's random stream."""
        return stream_seed(self.seed, self.stream_step)

    def _log_terms(self, loss: Tensor) -> None:
        """Log every term, what the priors measure, and the loss."""
        values: Mapping[str, Any] = {**self.logged, "loss": loss.detach()}
        if self.last_lift is not None:
            values = {**values, **self.terms.metrics(self.last_lift)}
        self.log_dict({f"{self.log_prefix}/{name}": value for name, value in values.items()}, batch_size=1)  # type: ignore[arg-type]
        if self.first_step:
            self.log("step", float(self.first_step + self.global_step), batch_size=1)

    # Validation and test.

    def validation_step(self, batch: Any, batch_idx: int) -> None:
        """Log the figures of validation data as ``val/NAME``."""
        self._log_figures("val", batch)

    def test_step(self, batch: Any, batch_idx: int) -> None:
        """Log the figures of test data as ``test/NAME``."""
        self._log_figures("test", batch)

    def _log_figures(self, prefix: str, batch: Any) -> None:
        with self.inference(), ranks.work_shared():  # every rank computes the same
            found = self.figures(batch)
        values = {f"{prefix}/{name}": float(value) for name, value in found.items()}
        if self.first_step and self.trainer.state.fn == "fit":
            values["step"] = float(self.first_step + self.global_step - 1)
        self.log_dict(values, batch_size=1)

    @contextmanager
    def inference(self) -> Iterator[None]:
        """Compute as ``uplift evaluate`` and ``uplift predict`` do: in full precision, whatever mode the trainer is in."""
        with torch.inference_mode(False), torch.no_grad(), self.full_precision():
            yield

    @contextmanager
    def mixed_networks(self) -> Iterator[None]:
        """Compute the lifter's networks in the trainer's mixed precision, if it has one, and nothing else."""
        given = mixed_precision(self.device)
        if given is None:
            yield
            return
        with self.full_precision(), mixed_networks(given):
            yield

    def full_precision(self) -> Any:
        """Return a context without mixed precision: geometry needs all digits."""
        return torch.autocast(self.device.type, enabled=False)

    @classmethod
    @consents
    def load_from_checkpoint(  # type: ignore[override]
        cls, checkpoint_path: Any, map_location: Any = None, *, trust: Trust = None, **given: Any
    ) -> Any:
        """Return the module of a checkpoint, as Lightning does; nothing but tensors and plain data is read from it.

        Args:
            checkpoint_path: a file.
            map_location: as Lightning's.
            trust: files and modules of code that may run, such as ``"my_priors.py"``, where the checkpoint names classes.
            given: arguments of the module in place of those of the checkpoint.

        Raises:
            UserError: not a checkpoint, or one that names a class of code that is not in ``trust``.
        """
        state = read_torch(Path(checkpoint_path), "checkpoint")
        kept = state.get("hyper_parameters")
        if isinstance(kept, Mapping) and "_instantiator" in kept:  # Lightning would import what it names
            raise UserError(
                f"{checkpoint_path} names a function that is to make the module: not loaded, as it would run it."
            )
        try:
            return super().load_from_checkpoint(checkpoint_path, map_location, **{**given, "weights_only": True})
        except UserError as error:
            raise UserError(f"{checkpoint_path}: {error}") from error

    # Optimisation.

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups: the lifter's, and one for each prior that has parameters."""
        lifter = {"params": list(self.lifter.parameters()), "lr": self.settings.learning_rate, "name": "lifter"}
        return [lifter, *self.terms.parameter_groups(self.prior_rate or self.settings.learning_rate)]

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return one Adam over all groups; each keeps its peak rate for the schedule."""
        groups = [{**group, "peak": group["lr"]} for group in self.parameter_groups()]
        s = self.settings
        # The fused kernel unscales gradients itself, which Lightning refuses to clip in mixed precision.
        fused = not self._clips_in_mixed_precision
        return torch.optim.Adam(groups, betas=(s.beta1, s.beta2), weight_decay=s.weight_decay, fused=fused)

    def schedule(self, done: float) -> float:
        """Return the learning rate's factor: warm up, constant to `decay_from`, half a cosine down to 2 %."""
        warm = min(1.0, (done + 1e-3) / self.settings.warm_up) if self.settings.warm_up else 1.0
        if self.settings.decay_from >= 1:
            return warm
        over = max(0.0, (done - self.settings.decay_from) / (1 - self.settings.decay_from))
        return warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(1.0, over))))

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """Remove the gradients of gated parameters: Adam then skips them, momentum and decay included."""
        for parameter in self.terms.gated_parameters(self.lifter):
            parameter.grad = None

    def optimizer_step(self, *arguments: Any, **options: Any) -> None:
        """Take the step and update the average, so that a checkpoint of this step holds both."""
        super().optimizer_step(*arguments, **options)
        if self.averaged is not None:
            self.averaged.update_parameters(self.lifter)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep how much of the training is over, and which priors had no gradient so far."""
        checkpoint["done"], checkpoint["idle_priors"] = self.done, dict(self.terms.idle)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on watching the priors that had no gradient so far."""
        self.terms.idle = dict(checkpoint.get("idle_priors", self.terms.idle))


# What modules are built from: settings as plain data, and priors in any form.

_OF_DATA = {
    "batch_size": "batch_size=... of the data module",
    "share": "the length of the trainer's fit",
    "rounds": "as many modules, each the teacher of the next",
    **dict.fromkeys(("network", "options", "last_options"), "lifter={'network': ..., 'options': ...}"),
    "module": "the class itself",
}


def stage_settings(group: str, training: Mapping[str, Any], task: str = "default", **plain: Any) -> Settings:
    """Return the settings of a module: those of the recipe ``task`` with ``training``, of the group ``teacher`` or ``student``.

    Raises UserError: an option that there is not, an invalid value.
    """
    known = [one.name for one in dataclasses.fields(getattr(Settings(), group)) if one.name not in _OF_DATA]
    for name in training:
        if name in _OF_DATA:
            raise UserError(f"{name} is not an option of a module: it is set by {_OF_DATA[name]}.")
        if name not in known:
            raise UserError(f"'{name}' is not an option of a module.{did_you_mean(name, known)}")
    return settings_from({**plain, group: dict(training)}, task)


def plain_settings(settings: Any) -> dict[str, Any]:
    """Return settings as plain data, without what belongs to the data module or the fit."""
    return {key: value for key, value in dataclasses.asdict(settings).items() if key not in _OF_DATA}


def prior_specs(priors: Mapping[str, Any] | None) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Return the settings of the priors, and those that were given as classes or objects.

    Raises UserError: a checkpoint's priors, where some were given as objects, which it does not hold.
    """
    if priors is None:
        return None, {}
    specs: dict[str, Any] = {}
    given: dict[str, Any] = {}
    for name, spec in priors.items():
        if isinstance(spec, Mapping) and _OBJECT in spec:
            raise UserError(
                f"the prior '{name}' was given as a Python object ({spec[_OBJECT]}), which a checkpoint does not hold: "
                "pass priors=... again, as the module had them."
            )
        use = spec.get("use") if isinstance(spec, Mapping) else spec
        if isinstance(use, (type, Prior)):
            more = dict(spec) if isinstance(spec, Mapping) else {}
            given[name] = (use, float(more.pop("weight", 1.0)))
            if set(more) - {"use"}:
                raise UserError(
                    f"priors.{name}: {', '.join(set(more) - {'use'})} cannot be set beside a class or an object: "
                    "give an object with its options, or name the class as file.py:Class."
                )
        elif isinstance(spec, Mapping):
            specs[name] = dict(spec)
        else:
            specs[name] = {"use": spec} if isinstance(spec, str) else {"weight": spec}
    return specs, given


_OBJECT = "given_as_object"


def add_given(priors: dict[str, Prior], weights: dict[str, float], given: Mapping[str, Any], *skeleton: Any) -> None:
    """Add priors that were given as classes or objects, in place; classes are made with ``skeleton``, if any."""
    for name, (one, weight) in given.items():
        priors[name], weights[name] = one if isinstance(one, Prior) else one(*skeleton), weight


def saved_priors(specs: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a checkpoint keeps of the priors: their settings, and a note of each that was an object."""
    names = {name: getattr(one, "__name__", type(one).__name__) for name, (one, _) in given.items()}
    return {**specs, **{name: {_OBJECT: named} for name, named in names.items()}}
