"""The verb fit: from settings to a run folder with a trained lifter of keypoints or masks, its errors and a page."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from uplift.cli.failures import RUN_VARIABLE
from uplift.cli.kinds import KINDS
from uplift.cli.report import Training, report
from uplift.config import ranks
from uplift.config.loading import classes_of, load_settings
from uplift.config.progress import say
from uplift.config.run import RunFolder
from uplift.config.settings import Settings
from uplift.config.trust import Trust, consents, require
from uplift.data.datasets import DATA_SETS
from uplift.errors import UserError
from uplift.models.networks import NETWORKS
from uplift.priors import PRIORS
from uplift.training import launch
from uplift.training.callbacks import Interrupted
from uplift.training.stages import CALLBACKS, LOGGERS, check_trainer

if TYPE_CHECKING:
    from uplift.data.module import KeypointData

__all__ = ["Prepared", "fit", "fit_settings", "fit_stack", "prepare_keypoints", "prepare_masks"]


_OF_THE_MACHINE = ("accelerator", "devices", "num_nodes", "threads", "wait")
"""Settings of a trainer that another machine may need changed."""


@consents
def fit(task: str | None = None, *overrides: str, resume: str | Path | None = None, trust: Trust = None) -> RunFolder:
    """Train a lifter and return its run folder, as ``uplift fit`` does.

    ``overrides`` are ``key=value`` texts. With ``resume`` an interrupted run goes on with the settings it was started
    with, but those of the machine: any number of devices, computers and threads may go on with it. ``trust`` are files and modules of code that may run where a task file or a run
    names it, such as ``"my_priors.py"``.

    Raises:
        UserError: anything wrong with settings, data or skeleton.
        uplift.training.callbacks.Interrupted: Ctrl-C; the run can be resumed.
    """
    if resume is not None:
        other = [word for word in overrides if word.partition("=")[0].removeprefix("trainer.") not in _OF_THE_MACHINE]
        if task or other:
            raise UserError(
                "resume=RUN goes on with the run's settings: give it no others but those of the machine "
                f"(trainer.{', trainer.'.join(_OF_THE_MACHINE)}), or start from init=RUN."
            )
        run = RunFolder.open(resume)
        return fit_settings(run.settings(*overrides), run)
    return fit_settings(load_settings(task, overrides))


@dataclass(frozen=True)
class Prepared:
    """What a fit starts from, whatever it lifts."""

    about: str
    """What it lifts, for the first line."""
    loaded: Any
    """The data, with `notes`."""
    recipe: Any
    """With `notes`, `spent`, `steps`, `idle_priors` and `train(run)`, which returns a model with `save(path)`."""
    settings: Settings
    """Of the fit, its networks as those that it starts from."""
    facts: dict[str, Any] = field(default_factory=dict)
    """What run.json is to keep."""


def fit_settings(
    settings: Settings, run: RunFolder | None = None, *, place: Path | None = None, command: str | None = None
) -> RunFolder:
    """Train as ``settings`` say, going on in ``run`` or in a new run folder, at ``place`` if given, by ``command``."""
    _require(settings)
    with launch.as_one():
        launch.join(settings.trainer)
        launch.start(check_trainer(settings.trainer), settings.trainer)  # before any data is read
    with launch.as_one():
        return _fit(settings, run, place, command)


def _fit(settings: Settings, run: RunFolder | None, place: Path | None, command: str | None) -> RunFolder:
    fit: Prepared = KINDS[settings.lifts].fit(settings, run)
    settings = fit.settings
    run = _run_of_all_ranks(run, settings, place, command)
    try:
        if rank_zero_only.rank == 0:
            if fit.facts:
                run.add_facts(**fit.facts)
            first = f"uplift fit: {settings.task or 'own data'}, {fit.about}, seed {settings.seed}"
            say("\n".join([first, *fit.loaded.notes, *fit.recipe.notes, f"run: {run.path}"]))
        model = fit.recipe.train(run)
    except KeyboardInterrupt:  # between stages, where nothing watches for it; checkpoints are complete
        raise Interrupted(run.path) from None
    except BaseException:
        run.discard_if_empty()
        raise
    _keep(run, model, fit)
    return run


def fit_stack(settings: Sequence[Settings], runs: Sequence[RunFolder], folder: Path) -> Iterator[UserError | None]:
    """Train fits together as one stacked network, each in its run folder; yield what went wrong in each, None for nothing.

    Args:
        settings: of the fits, which must be `stackable`.
        runs: their folders, new, or those of a stack that was interrupted.
        folder: of the stack's own checkpoints, from which it goes on; not needed when all fits have ended.

    Raises:
        uplift.training.stack.NotStackable: fits that cannot be trained together. Train each alone, going on in its run.
        uplift.training.callbacks.Interrupted: Ctrl-C; the same call goes on.
    """
    from uplift.data.module import depends_on_seed
    from uplift.training.stack import NotStackable, stackable, train_stack

    reason = stackable(settings)
    if reason is not None:
        raise NotStackable(reason)
    for one in settings:
        _require(one)
    check_trainer(settings[0].trainer)
    fits: list[Prepared] = []
    for one, run in zip(settings, runs, strict=True):
        data = None if depends_on_seed(settings[0]) or not fits else fits[0].recipe.data
        fits.append(prepare_keypoints(one, run, data))
        if fits[-1].facts:
            run.add_facts(**fits[-1].facts)
    try:
        models = train_stack([fit.recipe for fit in fits], runs, folder)
    except KeyboardInterrupt:  # between stages
        raise Interrupted(folder) from None
    for run, model, fit in zip(runs, models, fits, strict=True):
        if not isinstance(model, UserError):
            _keep(run, model, fit)
        yield model if isinstance(model, UserError) else None


def _require(settings: Settings) -> None:
    """Raise UserError for code that the user did not consent to; use as many threads as are set."""
    # What a task file names is asked for together, before any work; the built-in ones are not.
    builtin = {*PRIORS.values(), *NETWORKS.values(), *DATA_SETS.values(), *CALLBACKS.values(), *LOGGERS.values()}
    require({name: use for name, use in classes_of(asdict(settings)).items() if use not in builtin})
    if settings.trainer.threads:
        torch.set_num_threads(settings.trainer.threads)


def _keep(run: RunFolder, model: Any, fit: Prepared) -> None:
    """Write the trained model and the report of a fit into its run; all ranks evaluate the same clips together."""
    first = rank_zero_only.rank == 0
    if first:
        model.save(run.weights)
        run.link_last()
    with ranks.work_shared():
        found = KINDS[fit.settings.lifts].report(model, fit.settings, fit.loaded, fit.recipe)
    if first:
        took = Training(fit.recipe.spent, fit.recipe.steps, fit.recipe.idle_priors)
        report(run, found, fit.settings, fit.loaded, took)


def prepare_keypoints(settings: Settings, run: RunFolder | None, data: KeypointData | None = None) -> Prepared:
    """Load keypoints, unless ``data`` has them, and their recipe, which goes on from the checkpoints of ``run``."""
    from uplift.data.module import KeypointData
    from uplift.data.stream import load_training
    from uplift.skeleton import load_skeleton
    from uplift.training.pose_recipe import PoseRecipe
    from uplift.training.warm_start import WarmStart

    if not settings.skeleton:
        raise UserError("No skeleton: set skeleton=NAME (`uplift skeletons` lists them) or skeleton=FILE.yaml.")
    skeleton = load_skeleton(settings.skeleton)
    start = None
    if settings.init and not (run and any(run.checkpoints.glob("*.ckpt"))):  # what is resumed has its weights
        start = WarmStart.load(settings.init)
        settings = start.settings(settings)
    data = data or KeypointData.of(load_training(settings, skeleton), skeleton, settings)
    loaded = data.given["train"]
    recipe = PoseRecipe(settings, data, run, start)
    init = start.facts() if start else run.facts().get("init", {}) if run else {}
    loaded = replace(loaded, train=data.train_samples, notes=[*data.notes, *init.get("notes", [])])
    return Prepared(f"skeleton {skeleton.name}", loaded, recipe, settings, {"init": init} if init else {})


def prepare_masks(settings: Settings, run: RunFolder | None) -> Prepared:
    """Load masks and their recipe, which finds the checkpoints of a run itself."""
    from uplift.data.load_masks import load_masks
    from uplift.data.module import MaskDataModule
    from uplift.training.shape_recipe import ShapeRecipe

    loaded = load_masks(settings)
    data = MaskDataModule.of(loaded, settings)
    recipe = ShapeRecipe(settings, data)
    return Prepared("masks", replace(loaded, notes=data.notes), recipe, settings)


def _run_of_all_ranks(run: RunFolder | None, settings: Settings, place: Path | None, command: str | None) -> RunFolder:
    """Return one folder for all processes: rank 0 makes it."""
    if rank_zero_only.rank != 0:
        path = Path(launch.from_rank_0(""))
        if not path.is_dir():
            raise UserError(
                f"process {rank_zero_only.rank} does not see the run {path}: computers need one file system."
            )
        return RunFolder.open(path)
    if run is None:
        started = Path(sys.argv[0])
        ours = started.stem == "uplift" or started.parts[-2:] == ("cli", "main.py")
        words = sys.argv[1:] if ours else [f"({started.name})"]
        run = RunFolder.create(settings, command or shlex.join(["uplift", *words]), place)
    os.environ[RUN_VARIABLE] = launch.from_rank_0(str(run.path.absolute()))
    return run
