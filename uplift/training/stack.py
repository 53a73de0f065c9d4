"""Many small fits as one stacked network: `train_stack` trains fits that differ in seed and numbers with shared kernels.

A small network leaves most of a GPU idle, and most of a processor's time goes into calling small kernels. The parameters
of all networks are stacked along a new first axis, and `torch.func.vmap` computes the steps of all of them at once. They
share nothing, so that the gradient of the sum of their losses is each network's own, and Adam, which acts on every number
alone, is each network's own too.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from typing import Any, cast

import lightning as L
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.func import functional_call, vmap
from torch.overrides import TorchFunctionMode

from uplift.config.device import fast_products
from uplift.config.files import read_torch, save_torch
from uplift.config.plugins import blame
from uplift.config.run import RunFolder
from uplift.config.settings import Settings, TrainerSettings
from uplift.data.stream import Streamed
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.models.model import Model
from uplift.priors.base import Lift
from uplift.training.augmentation import ShownViews
from uplift.training.base import TrainingModule, seeded
from uplift.training.callbacks import MetricsFile
from uplift.training.lifting import LiftingModule
from uplift.training.objective import Logged, Objective
from uplift.training.pose_recipe import PoseRecipe
from uplift.training.stages import first_device, run_stage
from uplift.training.student import BATCHES_AT_ONCE, StudentModule

__all__ = ["NotStackable", "StackedModule", "StackedStudents", "StackedTeachers", "stackable", "train_stack"]


class NotStackable(UserError):
    """Fits that cannot be trained as one stack; as single fits they can, and go on where the stack stopped."""


# Which fits can be stacked, as far as settings say.

_NUMBERS = ("learning_rate", "prior_learning_rate")
"""Of stages: what may differ between the networks of a stack, beside the seed and numbers of priors."""
_OF_VIEWS = (
    "occlude", "mix", "mix_limb", "stretch", "any_way", "tilt_deg", "roll_deg", "distance", "own_share", "unknown_focal",
)  # fmt: skip
"""Of students: numbers of the views, which are made for each network."""


def stackable(settings: Sequence[Settings]) -> str | None:
    """Return why fits with these settings cannot be trained as one stack, in one sentence; None where they can.

    What only a step can show (a prior of a user's that looks at single numbers) is said by `train_stack`.
    """
    first = settings[0]
    trainer = first.trainer
    flags, devices = trainer.flags, trainer.devices
    refused = {
        f"lifts={first.lifts}: only lifters of keypoints are stacked": first.lifts != "keypoints",
        f"module={first.module} has steps of its own": first.module is not None,
        f"student.module={first.student.module} has steps of its own": first.student.module is not None,
        "views.use: views of your own are checked number by number": first.views.use is not None,
        "callbacks watch one fit": bool(first.callbacks),
        "loggers log one fit": bool(first.loggers) or trainer.logger not in (None, "", "none"),
        "priors.critic.gate decides in every step whether a network learns": bool(
            first.priors.get("critic", {}).get("gate")
        ),
        f"trainer.devices={devices}: a stack is one process on one device": devices not in ("auto", "1"),
        "trainer.num_nodes: a stack is one process on one device": flags.get("num_nodes", 1) != 1,
        "trainer.precision=16-mixed scales the losses of all networks alike": str(trainer.precision).startswith("16"),
        "trainer.gradient_clip_val clips one network": bool(flags.get("gradient_clip_val")),
    }
    for reason, holds in refused.items():
        if holds:
            return reason
    return _difference(settings)


def _difference(settings: Sequence[Settings]) -> str | None:
    """Return the first setting that networks of a stack cannot differ in; None without any."""
    plain = [dict(_leaves(dataclasses.asdict(one))) for one in settings]
    for key in dict.fromkeys(name for one in plain for name in one):
        values = [one.get(key) for one in plain]
        if any(value != values[0] for value in values) and not _may_differ(key, values):
            found = sorted({str(value) for value in values})
            return f"{key} differs ({', '.join(found[:3])}): only the seed and numbers of priors, learning rates and views may"
    return None


def _leaves(plain: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in plain.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def _may_differ(key: str, values: Sequence[Any]) -> bool:
    if key in ("seed", "description", "task"):
        return True
    group, *rest = key.split(".")
    if group in ("teacher", "student") and rest[0] in _NUMBERS + _OF_VIEWS * (group == "student"):
        return True
    # Whole numbers are sizes and steps, unless some are not whole; None is not set.
    numbers = all(
        value is None or (isinstance(value, (int, float)) and not isinstance(value, bool)) for value in values
    )
    return group == "priors" and numbers and (rest[-1] == "weight" or any(isinstance(value, float) for value in values))


# Random numbers: each network draws those of its own lone fit.


class _Streams(TorchFunctionMode):
    """Within a step under vmap, torch's random functions give every network the numbers of its own stream.

    Args:
        index: of the network, under vmap.
        seeds: of the streams; None: one stream for all, which vmap shares out. A GPU draws for all networks at once, and
            the numbers are then other ones than those of a lone fit.
    """

    def __init__(self, index: Int[Tensor, ""], seeds: Sequence[int] | None):
        super().__init__()
        self.index, self.seeds = index, seeds
        self._generators: dict[torch.device, list[torch.Generator]] = {}

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if kwargs.get("generator") is not None:
            return func(*args, **kwargs)
        if func is torch.randperm and self.seeds is None:  # vmap's own takes one kernel after another for each network
            return torch.rand(args[0], device=kwargs.get("device")).argsort()
        if self.seeds is None:
            return func(*args, **kwargs)
        if func in (torch.rand, torch.randn, torch.randint, torch.randperm):
            return self.draw(lambda generator: func(*args, **kwargs, generator=generator), kwargs.get("device"))
        if func in (torch.rand_like, torch.randn_like):
            like, draw = args[0], torch.rand if func is torch.rand_like else torch.randn
            given = {"dtype": like.dtype, "device": like.device, **kwargs}
            return self.draw(lambda generator: draw(like.shape, generator=generator, **given), given["device"])
        if func is nn.functional.dropout:
            return self._dropout(*args, **kwargs)
        return func(*args, **kwargs)

    def draw(self, one: Callable[[torch.Generator], Tensor], device: Any = None) -> Tensor:
        """Return what ``one`` draws with each network's generator, as a tensor under vmap."""
        assert self.seeds is not None
        device = torch.device(device or "cpu")
        if device not in self._generators:
            self._generators[device] = [torch.Generator(device).manual_seed(seed) for seed in self.seeds]
        return torch.stack([one(generator) for generator in self._generators[device]])[self.index]

    def _dropout(self, value: Tensor, p: float = 0.5, training: bool = True, inplace: bool = False) -> Tensor:
        if not training or p == 0:
            return value
        empty = torch.empty(value.shape, dtype=value.dtype, device=value.device)
        kept = self.draw(lambda generator: empty.bernoulli(1 - p, generator=generator), value.device)
        return value * (kept / (1 - p))


class _Rows:
    """Draws rows of the training frames of a network, under vmap, where some networks have more of them than others."""

    def __init__(self, frames: Sequence[int], streams: _Streams, device: torch.device):
        self.frames, self.streams, self.device, self.share = frames, streams, device, 0.0

    def __call__(self, count: int) -> Int[Tensor, " count"]:
        """Return ``count`` random rows."""
        if self.streams.seeds is None:
            most = torch.tensor(self.frames, device=self.device)[self.streams.index]
            return (torch.rand(count, device=self.device, dtype=torch.float64) * most).long()
        left, device = iter(self.frames), self.device
        return self.streams.draw(
            lambda generator: torch.randint(next(left), (count,), generator=generator, device=device), device
        )


@dataclasses.dataclass
class _Found:
    """What a step gives: of one network under vmap, of all with a first axis of networks after it."""

    loss: Float[Tensor, " *networks"]
    terms: dict[str, Tensor]
    """To log, by name."""
    judged: dict[str, Tensor]
    """The losses of priors, with gradients."""
    lifted: dict[str, Tensor]
    """The fields of the `Lift` that priors judged."""


# A stack.


def _stacked(modules: Sequence[nn.Module]) -> nn.Module:
    """Return a copy of the first module whose parameters and buffers are those of all, along a new first axis.

    Fixed indices, which are the same for all, stay as they are.
    """
    made = copy.deepcopy(modules[0])
    for place, module in made.named_modules():
        alike = [one.get_submodule(place) for one in modules]
        for name, value in module._parameters.items():
            if value is not None:
                every = torch.stack([cast(Tensor, one._parameters[name]).detach() for one in alike])
                module._parameters[name] = nn.Parameter(every, requires_grad=value.requires_grad)
        for name, value in module._buffers.items():
            if value is not None and not _is_fixed(module, name, value):
                module._buffers[name] = torch.stack([cast(Tensor, one._buffers[name]) for one in alike])
    return made


def _is_fixed(module: nn.Module, name: str, value: Tensor) -> bool:
    return name in module._non_persistent_buffers_set and not value.is_floating_point()


def _share(stack: nn.Module, modules: Sequence[nn.Module]) -> None:
    """Let the parameters and buffers of each module be its part of the stack's, in the same memory."""
    for place, module in stack.named_modules():
        for number, one in enumerate(modules):
            own = one.get_submodule(place)
            for name, value in module._parameters.items():
                if value is not None:
                    cast(Tensor, own._parameters[name]).data = value.data[number]
            for name, value in module._buffers.items():
                if value is not None and not _is_fixed(module, name, value):
                    own._buffers[name] = value[number]


@contextmanager
def _fixed(modules: Sequence[nn.Module]) -> Iterator[None]:
    """Let no gradient reach the modules' parameters."""
    owners = [
        (part, name, value)
        for module in modules
        for part in module.modules()
        for name, value in part._parameters.items()
    ]
    for part, name, value in owners:
        part._parameters[name] = None if value is None else cast(Any, value.detach())
    try:
        yield
    finally:
        for part, name, value in owners:
            part._parameters[name] = value


class _StackedTerms(Objective):
    """The priors of one network under vmap, where no number can be looked at: the stack checks them after the step."""

    def __init__(self, terms: Objective):
        super().__init__(terms.priors, terms.weights)
        self.judged: dict[str, Tensor] = {}
        """The loss of each prior, with its gradient."""

    def judge(self, lift: Any, step: int) -> tuple[Tensor, Logged]:
        """Return the weighted sum of the priors' losses, and each loss by name."""
        with _fixed([self.priors[name] for name in self.adversarial]):
            self.judged = {name: self._loss(name, lift) for name in self.priors}
        total = torch.stack([self.weights[name] * loss for name, loss in self.judged.items()]).sum()
        return total, {name: loss.detach() for name, loss in self.judged.items()}

    def _loss(self, name: str, lift: Any) -> Tensor:
        with blame(f"priors.{name}: loss", type(self.priors[name])):
            value = self.priors[name].loss(lift)
            return value.mean() if value.is_floating_point() else value.float().mean()

    def train_adversaries(self, real: Tensor, reprojected: Tensor) -> tuple[Tensor, Logged]:
        """Return the sum of the losses that adversarial priors are trained on, and each of them by name."""
        total, losses = real.new_zeros(()), Logged()
        for name in self.adversarial:
            with blame(f"priors.{name}: critic_loss", type(self.priors[name])):
                own = self.priors[name].critic_loss(real, reprojected)
            if own is not None:
                total, losses[f"{name}_own"] = total + own, own.detach()
        return total, losses


class _Step(nn.Module):
    """Calls ``compute`` with a module whose tensors `functional_call` replaces."""

    def __init__(self, module: TrainingModule, compute: Callable[..., Any]):
        super().__init__()
        self.module, self.compute = module, compute

    def forward(self, *given: Any) -> Any:
        """Return what ``compute`` makes of the module."""
        return self.compute(self.module, *given)


class StackedModule(TrainingModule[Any, Any]):
    """Trains modules of one kind together: their parameters and buffers are parts of this module's, in the same memory.

    So each of them is trained when the stack is, and can be used, saved and evaluated as if it had been trained alone.
    Which of them a loss is not finite in is noted in `failed`; the others go on.

    Args:
        alone: the modules, prepared with their data, on one device, with networks of the same sizes and the same priors.
        exact: whether every network draws the random numbers of its lone fit. On a GPU that takes a kernel for each
            network wherever numbers are drawn.
    """

    last_step: dict[str, Tensor]
    """The terms of the last step, each (networks,)."""

    def __init__(self, alone: Sequence[Any], *, exact: bool = True):
        super().__init__()
        self.alone, self.exact, first = tuple(alone), exact, alone[0]
        self.failed: dict[int, str] = {}
        """What went wrong, by the number of the network."""
        priors = {name: _stacked([one.priors[name] for one in alone]) for name in first.priors}
        terms = Objective(cast(Any, priors), first.terms.weights)
        self.set_up(_stacked([one.lifter for one in alone]), first.settings, first.seed, terms)
        self.prior_rate, self.last_step, self._lifted = first.prior_rate, {}, {}
        self.loss = _stacked([one.loss for one in alone]) if isinstance(first, StudentModule) else None
        self.factors = _rate_factors(alone)
        self.share()

    # What a subclass writes.

    def inputs(self, batch: int) -> tuple[Any, Any]:
        """Return what the step of every network takes, as a tree of tensors, and the axis of the networks in each."""
        raise NotImplementedError

    def compute(self, one: Any, given: Any, streams: _Streams, batch: int) -> _Found:
        """Return what the step of one network gives, under vmap."""
        raise NotImplementedError

    # One memory for the tensors of the stack and of its modules.

    def share(self) -> None:
        """Let the modules' tensors be parts of this one's: at first, and where these have moved to another device."""
        parts = [(self.lifter, "lifter"), (self.priors, "priors"), *([(self.loss, "loss")] if self.loss else [])]
        for stack, name in parts:
            _share(stack, [getattr(one, name) for one in self.alone])
        if self.averaged is not None:
            _share(self.averaged.module, [one.averaged.module for one in self.alone])
            for one in self.alone:
                one.averaged.n_averaged = self.averaged.n_averaged

    def _state(self) -> tuple[dict[str, Tensor], dict[str, int | None]]:
        """Return the tensors that a step works with, by name, and the axis of the networks in each."""
        state: dict[str, Tensor] = {f"module.{name}": value for name, value in self.named_parameters()}
        axes: dict[str, int | None] = dict.fromkeys(state, 0)
        for place, module in self.named_modules():
            for name, value in module._buffers.items():
                if value is not None:
                    key = f"module.{place}.{name}"
                    state[key], axes[key] = value, None if _is_fixed(module, name, value) else 0
        used = [name for name in state if not name.startswith("module.averaged.")]
        return {name: state[name] for name in used}, {name: axes[name] for name in used}

    # Steps.

    def setup(self, stage: str) -> None:
        """Do nothing: the modules are prepared."""

    def on_fit_start(self) -> None:
        """Let the modules know of the trainer, and follow the stack to its device."""
        for one in self.alone:
            one.to(self.device)
            one.trainer = self.trainer
        self.share()

    def on_train_end(self) -> None:
        """Let go of the trainer."""
        super().on_train_end()
        for one in self.alone:
            one.trainer, one.last_lift = None, None

    def objective(self, batch: int) -> tuple[Tensor, Logged]:
        """Return the sum of the losses of all networks, and the mean of each term."""
        found = self._all_at_once(batch)
        self.last_step = {name: value.detach() for name, value in {**found.terms, "loss": found.loss}.items()}
        self._lifted = found.lifted
        self._watch(found.judged)
        if self.device.type == "cpu" or self.global_step % _SYNC_EVERY == 0:
            self._note_failures()
        terms = {name: self.last_step[name].mean() for name in found.terms}
        return found.loss.sum(), cast(Logged, terms)

    def _all_at_once(self, batch: int) -> _Found:
        for one in self.alone:
            one._accumulated, one._micro_batch = self._accumulated, self._micro_batch
        seeds = [one.step_seed for one in self.alone] if self.exact else None
        given, axes = self.inputs(batch)
        state, state_axes = self._state()
        step = _Step(self.alone[0], self.compute)

        def compute(index: Tensor, state: dict[str, Tensor], given: Any) -> tuple:
            streams = _Streams(index, seeds)
            with streams:
                return tuple(vars(functional_call(step, state, (given, streams, batch))).values())

        index = torch.arange(len(self.alone), device=self.device)
        random = "same" if self.exact else "different"
        return _Found(*vmap(compute, (0, state_axes, axes), randomness=random)(index, state, given))

    def _watch(self, judged: Mapping[str, Tensor]) -> None:
        """Look which priors move a network, until each has done so once in each."""
        for name, loss in judged.items():
            idle = [number for number, one in enumerate(self.alone) if name in one.terms.idle]
            moved: list[bool] = []
            for number in idle:

                def moves(
                    name: str = name, loss: Tensor = loss, number: int = number, moved: list[bool] = moved
                ) -> bool:
                    moved[:] = moved or self._moved(name, loss)
                    return moved[number]

                self.alone[number].terms.watch(name, moves)

    def _moved(self, name: str, loss: Tensor) -> list[bool]:
        """Return which networks, or their prior ``name``, a loss (networks,) has a gradient to."""
        trained = [p for p in (*self.lifter.parameters(), *self.priors[name].parameters()) if p.requires_grad]
        if not loss.requires_grad:
            return [False] * len(loss)
        gradients = torch.autograd.grad(loss.sum(), trained, retain_graph=True, allow_unused=True)
        moved = [part.flatten(1).any(1) for part in gradients if part is not None]
        return torch.stack(moved).any(0).tolist() if moved else [False] * len(loss)

    def _note_failures(self) -> None:
        """Note the first term that is not finite of networks that had none before."""
        for name, value in self.last_step.items():
            if bool(torch.isfinite(value).all()):
                continue
            for number in (~torch.isfinite(value)).nonzero()[:, 0].tolist():
                what = f"priors.{name}: loss" if name in self.terms.priors else name
                self.failed.setdefault(
                    number,
                    f"{what} is {float(value[number])} at step {self.global_step}. Look for a division by 0, a square root or "
                    "a norm of 0 (add a small number), or a learning rate that is too high.",
                )

    def each(self) -> Iterator[Any]:
        """Yield the modules, with the terms and the lifted poses of the last step in ``logged`` and ``last_lift``."""
        for number, one in enumerate(self.alone):
            one.logged = {name: value[number] for name, value in self.last_step.items() if name != "loss"}
            one.last_lift = self.lift_of(number)
            yield one
            one.last_lift = None

    def lift_of(self, number: int) -> Any:
        """Return what the priors judged of one network in the last step, if there are priors."""
        return None

    # Optimisation.

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups, as each module has them."""
        of_loss = [] if self.loss is None else list(self.loss.parameters())
        group = {"params": of_loss, "lr": self.settings.learning_rate, "name": "loss"}
        return [*super().parameter_groups(), *([group] if of_loss else [])]

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return one Adam over all networks, which steps with each one's own learning rate."""
        optimizer = super().configure_optimizers()
        if self.factors:
            kept: list[tuple[Tensor, Tensor, Tensor]] = []

            def keep(optimizer: torch.optim.Optimizer, *rest: Any) -> None:
                kept[:] = [
                    (
                        part,
                        part.detach().clone(),
                        self.factors[group["name"]].to(part).reshape(-1, *[1] * (part.ndim - 1)),
                    )
                    for group in optimizer.param_groups
                    for part in group["params"]
                    if group["name"] in self.factors
                ]

            def scale(*rest: Any) -> None:  # Adam's step is proportional to its rate
                for part, before, factor in kept:
                    part.data.copy_(torch.lerp(before, part.detach(), factor))

            optimizer.register_step_pre_hook(keep)
            optimizer.register_step_post_hook(scale)
        return optimizer

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep how much of the training is over, and of each network which priors had no gradient and what failed."""
        checkpoint["done"], checkpoint["failed"] = self.done, dict(self.failed)
        checkpoint["idle_priors"] = [dict(one.terms.idle) for one in self.alone]

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on watching."""
        self.failed = dict(checkpoint["failed"])
        for one, idle in zip(self.alone, checkpoint["idle_priors"], strict=True):
            one.terms.idle = dict(idle)

    # Before any training.

    def try_out(self, batch: int) -> None:
        """Compute a step of each module alone and of all as one, and compare; nothing is changed.

        Raises:
            NotStackable: a step that cannot be computed for all at once, or gives another loss than alone.
        """
        exact, idle = self.exact, [dict(one.terms.idle) for one in self.alone]
        with seeded(0), _kept_buffers(self):
            alone = [self._alone(one, batch) for one in self.alone]
            self.inputs(batch)
            self.exact, before = True, torch.get_rng_state()
            try:
                found = self._all_at_once(batch)
            except Exception as error:  # of any kind: what a user's prior does is not for us to know
                why = " ".join(str(error).split()).partition(". ")[0] or type(error).__name__
                raise NotStackable(f"a step cannot be computed for all fits at once: {why}.") from error
            finally:
                self.exact = exact
            if not torch.equal(before, torch.get_rng_state()):
                raise NotStackable(
                    "a step draws random numbers with another function than torch.rand, randn, randint, randperm, "
                    "rand_like, randn_like or dropout, so the fits of a stack would all have the same."
                )
        for one, was in zip(self.alone, idle, strict=True):
            one.terms.idle, one.last_lift = was, None
        self._compare(alone, found)

    def _alone(self, one: Any, batch: int) -> dict[str, float]:
        """Return the terms of a step of one module."""
        torch.manual_seed(one.step_seed)
        loss, terms = one.objective(batch)
        if any(prior.gate_itself or prior.gate_lifter for prior in one.priors.values()):
            raise NotStackable("a prior decides in every step whether a network learns (gate_itself, gate_lifter).")
        return {name: float(value) for name, value in {**terms, "loss": loss.detach()}.items()}

    def _compare(self, alone: Sequence[Mapping[str, float]], found: _Found) -> None:
        """Raise NotStackable where a network's terms are not those that it has alone."""
        for name, values in {**found.terms, "loss": found.loss}.items():
            for own, value in zip(alone, values.tolist(), strict=True):
                expected = own.get(name, math.nan)
                if not math.isclose(value, expected, rel_tol=_LIKE, abs_tol=_LIKE) and not math.isnan(expected):
                    raise NotStackable(
                        f"'{name}' is {value:.6g} in a stack and {expected:.6g} alone: the prior or the network of that name keeps "
                        "something of its own that is neither a parameter nor a buffer."
                    )


_SYNC_EVERY = 50
"""Steps between checks of the losses on an accelerator, where each one waits for the device."""
_LIKE = 1e-3
"""Relative difference of losses, alone and in a stack, that rounding explains."""


@contextmanager
def _kept_buffers(module: nn.Module) -> Iterator[None]:
    """Leave the module's buffers as they were."""
    before = [(buffer, buffer.clone()) for buffer in module.buffers()]
    try:
        yield
    finally:
        with torch.no_grad():
            for buffer, value in before:
                buffer.copy_(value)


def _rate_factors(alone: Sequence[Any]) -> dict[str, Tensor]:
    """Return each network's learning rate as a share of the first one's, for groups of parameters where they differ."""
    groups = [{group["name"]: group["lr"] for group in one.parameter_groups()} for one in alone]
    factors = {name: torch.tensor([one[name] / rate for one in groups]) for name, rate in groups[0].items()}
    return {name: factor for name, factor in factors.items() if not bool((factor == 1).all())}


class StackedTeachers(StackedModule):
    """Trains `LiftingModule` together: each lifts frames of its own data, and has its own priors and weights of them."""

    def __init__(self, alone: Sequence[LiftingModule], *, exact: bool = True):
        super().__init__(alone, exact=exact)
        if any(one.truth is not None for one in alone):
            raise NotStackable("labelled frames are shown from new sides: only fits without labels are stacked.")
        self._terms = _StackedTerms(alone[0].terms)
        self._given: tuple[dict[str, Any], dict[str, Any]] | None = None

    def inputs(self, batch: int) -> tuple[Any, Any]:
        """Return the training frames and the numbers in which the networks differ."""
        if self._given is None or self._given[0]["frames"]["keypoints"].device != self.device:
            frames, axes = _stacked_frames([cast(TrainingSet, one.frames).to(self.device) for one in self.alone])
            numbers = _differing_numbers(self.alone, self.device)
            self._given = (
                {"frames": frames, "numbers": numbers},
                {"frames": axes, "numbers": dict.fromkeys(numbers, 0)},
            )
        return self._given

    def compute(self, one: LiftingModule, given: Any, streams: _Streams, batch: int) -> _Found:
        """Return what the objective of one network gives, with its own frames and numbers in place of the first one's."""
        counts = [len(cast(TrainingSet, other.frames)) for other in self.alone]
        own = {"frames": dataclasses.replace(cast(TrainingSet, one.frames), **given["frames"]), "terms": self._terms}
        if len(set(counts)) > 1:
            own["sampler"] = _Rows(counts, streams, self.device)
        with _replaced(one, own), _numbers(self._terms, given["numbers"]):
            loss, terms = one.objective(batch)
            lift = cast(Lift, one.last_lift)
        self._lift = lift
        lifted = {
            name: value.detach() for name, value in vars(lift).items() if name in _LIFT and isinstance(value, Tensor)
        }
        return _Found(loss, _as_tensors(terms, loss), self._terms.judged, lifted)

    def lift_of(self, number: int) -> Lift:
        """Return what the priors judged of one network in the last step."""
        own = {name: value[number] for name, value in self._lifted.items()}
        return dataclasses.replace(self._lift, lifter=self.alone[number].lifter, **own)


_LIFT = {field.name for field in dataclasses.fields(Lift)}


def _as_tensors(terms: Logged, like: Tensor) -> dict[str, Tensor]:
    return {name: torch.as_tensor(value, device=like.device) for name, value in terms.items()}


@contextmanager
def _replaced(one: Any, attributes: Mapping[str, Any]) -> Iterator[None]:
    """Let an object have other attributes for a while."""
    before = {name: getattr(one, name) for name in attributes}
    try:
        for name, value in attributes.items():
            setattr(one, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(one, name, value)


def _stacked_frames(every: Sequence[TrainingSet]) -> tuple[dict[str, Tensor], dict[str, int | None]]:
    """Return the tensors of training sets by field, and the axis of the networks in each: None where all are the same.

    Those with fewer frames than others are filled up with their last one, which is not drawn.
    """
    most = max(map(len, every))
    found: dict[str, Tensor] = {}
    axes: dict[str, int | None] = {}
    for field in dataclasses.fields(TrainingSet):
        values = [getattr(frames, field.name) for frames in every]
        if not any(isinstance(value, Tensor) for value in values):
            continue
        if not all(isinstance(value, Tensor) and value.shape[1:] == values[0].shape[1:] for value in values):
            raise NotStackable(
                f"some of the fits have '{field.name}' in their training frames, or others than the rest."
            )
        alike = all(value.shape == values[0].shape and torch.equal(value, values[0]) for value in values)
        full = [torch.cat([value, value[-1:].expand(most - len(value), *value.shape[1:])]) for value in values]
        found[field.name], axes[field.name] = (values[0], None) if alike else (torch.stack(full), 0)
    return found, axes


def _differing_numbers(alone: Sequence[LiftingModule], device: torch.device) -> dict[str, Tensor]:
    """Return the weights of priors, and the numbers and tensors that priors hold, in which networks differ, by name."""
    found: dict[str, Tensor] = {}
    for name, prior in alone[0].priors.items():
        weights = [one.terms.weights[name] for one in alone]
        if len(set(weights)) > 1:
            found[f"{name}:"] = torch.tensor(weights, device=device)
        for attribute, value in vars(prior).items():
            values = [getattr(one.priors[name], attribute) for one in alone]
            if isinstance(value, Tensor) and all(
                isinstance(one, Tensor) and one.shape == value.shape for one in values
            ):
                found[f"{name}:{attribute}"] = torch.stack(values).to(device)
            elif isinstance(value, float) and len(set(values)) > 1:
                found[f"{name}:{attribute}"] = torch.tensor(values, device=device)
    return found


@contextmanager
def _numbers(terms: Objective, numbers: Mapping[str, Tensor]) -> Iterator[None]:
    """Let priors have the numbers of one network, by their names in `_differing_numbers`."""
    weights, restored = dict(terms.weights), []
    try:
        for key, value in numbers.items():
            name, _, attribute = key.partition(":")
            if attribute:
                restored.append((terms.priors[name], attribute, getattr(terms.priors[name], attribute)))
                setattr(terms.priors[name], attribute, value)
            else:
                terms.weights[name] = cast(float, value)
        yield
    finally:
        terms.weights.update(weights)
        for prior, attribute, value in restored:
            setattr(prior, attribute, value)


class StackedStudents(StackedModule):
    """Trains `StudentModule` together, each on the views of its own teacher's poses."""

    _made: tuple[int, int, dict[str, Tensor]] | None = None

    def inputs(self, batch: int) -> tuple[Any, Any]:
        """Return the views of this step, which each network makes of its own poses with its own random numbers."""
        chunk, place = divmod(self.stream_step, BATCHES_AT_ONCE)
        if self._made is None or self._made[:2] != (chunk, batch):
            every = [vars(one.make_views(chunk, batch)) for one in self.alone]
            self._made = (chunk, batch, {name: torch.stack([views[name] for views in every]) for name in every[0]})
        views = {name: value[:, place * batch : (place + 1) * batch] for name, value in self._made[2].items()}
        return views, dict.fromkeys(views, 0)

    def compute(self, one: StudentModule, given: Any, streams: _Streams, batch: int) -> _Found:
        """Return the loss of one network's views."""
        loss, terms = one.judge(ShownViews(**given))
        return _Found(loss, _as_tensors(terms, loss), {}, {})


# Fits.


def train_stack(recipes: Sequence[PoseRecipe], runs: Sequence[RunFolder], folder: Path) -> list[Model | UserError]:
    """Train fits together, stage by stage; return the model of each, or what went wrong in it alone.

    Every fit leaves in its run folder what it leaves when it is trained alone: ``metrics.csv`` and the checkpoints of its
    finished stages. The stack's own checkpoints are in ``folder``, from which a stack that was killed goes on. Where
    ``trainer.max_time`` is set it is the time of all fits together.

    Args:
        recipes: of the fits, whose settings are `stackable`, each with its data.
        runs: their folders.
        folder: of the stack.

    Raises:
        NotStackable: fits that cannot be trained together: train them alone, in the same run folders.
        Interrupted: Ctrl-C, with everything saved.
    """
    reason = stackable([recipe.settings for recipe in recipes])
    if reason is not None:
        raise NotStackable(reason)
    loaded = [recipe.data.given["train"] for recipe in recipes]
    if any(isinstance(one, Streamed) and one.stream is not None for one in loaded):
        raise NotStackable("the training frames are more than memory holds, and each fit reads its own.")
    if any(recipe.budgets != recipes[0].budgets for recipe in recipes):
        raise NotStackable("the fits have different numbers of steps: set trainer.max_steps, or the same data for all.")
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    fits = _Fits(recipes, runs, folder)
    with fast_products(recipes[0].settings.trainer.products, training=True):
        modules: list[Any] = [recipe.teacher for recipe in recipes]
        if not recipes[0].supervised:
            fits.stage("teacher", modules, StackedTeachers, recipes[0].settings.teacher.batch_size)
        for number, students in enumerate(zip(*(recipe.students for recipe in recipes), strict=True), 1):
            for student, module in zip(students, modules, strict=True):
                student.learn_from(module)
            modules = list(students)
            fits.stage(f"student_{number}", modules, StackedStudents, recipes[0].settings.student.batch_size)
    return [
        UserError(fits.failed[number]) if number in fits.failed else recipe.finished(module)
        for number, (recipe, module) in enumerate(zip(recipes, modules, strict=True))
    ]


@dataclasses.dataclass
class _Fits:
    """The fits of a stack and their folders."""

    recipes: Sequence[PoseRecipe]
    runs: Sequence[RunFolder]
    folder: Path
    failed: dict[int, str] = dataclasses.field(default_factory=dict)
    first_step: int = 0

    def stage(self, name: str, modules: Sequence[Any], kind: type[StackedModule], batch_size: int) -> None:
        """Train one stage of all fits, and write the checkpoint of each."""
        start, trainer, first = time.monotonic(), self.recipes[0].settings.trainer, self.recipes[0]
        device = first_device(trainer)
        for module, recipe in zip(modules, self.recipes, strict=True):
            module.prepare_on(device, recipe.data)
        stack = kind(modules, exact=device.type == "cpu")
        stack.log_prefix, stack.first_step = name, self.first_step
        path = self.folder / "checkpoints" / f"{name}.ckpt"
        if not path.exists():
            stack.try_out(batch_size)
        before = time.monotonic() - start
        record = run_stage(
            name,
            stack,
            _Batches(batch_size),
            trainer,
            first.budgets[name],
            self.folder,
            before=before,
            metrics=_MetricsFiles([run.path for run in self.runs], name, trainer),
        )
        for module in modules:
            module.to(stack.device)
        stack.share()
        self.first_step += record.steps
        self.failed |= {number: f"{name}: {why}" for number, why in stack.failed.items() if number not in self.failed}
        _split_checkpoint(path, stack, [run.checkpoints / path.name for run in self.runs])
        for module, recipe in zip(modules, self.recipes, strict=True):
            recipe.spent[name], recipe.steps[name] = record.spent / len(modules), record.steps
            recipe.idle_priors |= module.terms.idle


class _Batches(L.LightningDataModule):
    """Tells every step how many frames each network draws; an epoch never ends."""

    val = None

    def __init__(self, batch_size: int):
        super().__init__()
        self.batch_size = batch_size

    def train_dataloader(self) -> Any:
        """Return a loader of batch sizes."""
        return repeat(self.batch_size)


class _MetricsFiles(L.Callback):
    """Writes the metrics.csv of every network of a stack."""

    def __init__(self, runs: Sequence[Path], stage: str, settings: TrainerSettings):
        self.every = settings.log_every
        self.files = [MetricsFile(run / "metrics.csv", stage, settings.log_every) for run in runs]

    def on_train_start(self, trainer: L.Trainer, module: Any) -> None:
        """Do as each file does."""
        for file in self.files:
            file.on_train_start(trainer, module)

    def on_train_batch_end(self, trainer: L.Trainer, module: Any, *rest: Any) -> None:
        """Append rows when it is time to."""
        if trainer.global_step % self.every == 0:
            for file, one in zip(self.files, module.each(), strict=True):
                file.on_train_batch_end(trainer, one, *rest)


def _split_checkpoint(path: Path, stack: StackedModule, places: Sequence[Path]) -> None:
    """Write the checkpoint of each network of a stack that is trained, as its lone fit leaves it."""
    state = read_torch(path, "checkpoint")
    for number, (one, place) in enumerate(zip(stack.alone, places, strict=True)):
        optimizers = [
            {
                **optimizer,
                "state": {
                    key: {name: _own(name, value, number) for name, value in values.items()}
                    for key, values in optimizer["state"].items()
                },
                "param_groups": [
                    {**group, **{rate: group[rate] * _factor(stack, group["name"], number) for rate in ("lr", "peak")}}
                    for group in optimizer["param_groups"]
                ],
            }
            for optimizer in state["optimizer_states"]
        ]
        kept = {key: value for key, value in state.items() if key != "failed"}
        place.parent.mkdir(parents=True, exist_ok=True)
        save_torch(
            {
                **kept,
                "state_dict": {name: value.detach().cpu().clone() for name, value in one.state_dict().items()},
                "optimizer_states": optimizers,
                "idle_priors": dict(one.terms.idle),
                "hparams_name": "kwargs",
                "hyper_parameters": dict(one.hparams),
            },
            place,
        )


def _own(name: str, value: Any, number: int) -> Any:
    """Return one network's part of Adam's state; steps are counted for all."""
    return value if name == "step" else value[number].clone()


def _factor(stack: StackedModule, group: str, number: int) -> float:
    return float(stack.factors[group][number]) if group in stack.factors else 1.0
