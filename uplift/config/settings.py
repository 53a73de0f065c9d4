"""Every setting with its default, description, range and choices; a task file or ``key=value`` overrides them."""

# ruff: noqa: RUF009 (`_setting` returns a dataclass field)

from __future__ import annotations

import copy
import functools
import math
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import timedelta
from typing import Any, NamedTuple, Optional, TypeVar

from uplift.config.device import PRODUCTS
from uplift.errors import UserError, nearest

__all__ = [
    "MAX_SIDE", "MIN_SIDE", "PRIOR_SETTINGS", "RENAMED", "TRAINER_FLAGS", "TRAINER_FLAGS_OF_FIT", "ChoiceSettings", "DataSettings", "LifterSettings",
    "RefineSettings", "Setting", "Settings", "ShapeSettings", "StageSettings", "StudentSettings", "SweepSettings", "TeacherSettings",
    "TrainerSettings", "ViewSettings", "all_groups", "all_settings", "check_settings", "range_text", "rename_old",
    "seconds_of", "settings_of",
]  # fmt: skip

MIN_SIDE, MAX_SIDE = 8, 1024
"""Pixels along the crop of a mask."""

# OmegaConf reads these annotations at run time, where "X | None" of a string is not resolved.


def _setting(default: Any, help: str = "", **limits: Any) -> Any:
    """Return a field with its description.

    ``low`` and ``high`` bound a number and each of a list, or one by one where they are tuples; ``choices`` are the
    valid texts. ``only`` is "keypoints" or "masks" where the setting does not go with the other.
    """
    limits["help"] = help
    if isinstance(default, (list, dict)):
        return field(default_factory=default.copy, metadata=limits)
    return field(default=default, metadata=limits)


def _group(make: Callable[[], Any], help: str = "", only: str | None = None) -> Any:
    """Return a field of settings; ``help`` follows the description of each, and ``only`` holds for all of them."""
    return field(default_factory=make, metadata={"help": help, "only": only})


@dataclass
class ChoiceSettings:
    """Which frames: all that match every key given. Values are compared as text."""

    subjects: list[str] = _setting([], "subjects to take", only="keypoints")
    actions: list[str] = _setting([], "actions to take", only="keypoints")
    sequences: list[str] = _setting([], "sequences to take", only="keypoints")
    cameras: list[str] = _setting([], "cameras to take", only="keypoints")
    categories: list[str] = _setting([], "categories of masks to take", only="masks")
    fraction: Optional[float] = _setting(
        None, "share of those frames, as complete clips in seeded order; of masks by shape", low=1e-9, high=1
    )
    of_each_clip: bool = _setting(
        False, "take the fraction from every clip, frames in a row, in place of complete clips", only="keypoints"
    )


@dataclass
class _LabelledSettings(ChoiceSettings):
    """Which training frames may be learned from with their true pose; none unless something here is set."""

    file: Optional[str] = _setting(None, "other frames with poses: FILE, or SET:SPLIT of a published set")
    only: bool = _setting(False, "leave all other frames out: supervised training")
    rest: str = _setting(
        "2d",
        "what the fraction leaves of the chosen frames: learn from their 2D, or leave them out",
        choices=("2d", "leave_out"),
    )
    share: Optional[float] = _setting(
        0.9, "most of a batch that is labelled; unset: as many as there are among the frames", low=0.001, high=0.999
    )


@dataclass
class DataSettings:
    """Where the 2D keypoints or masks come from."""

    name: str = _setting("", "name of the data set; its folder is $UPLIFT_DATA/<name>, else data/<name>")
    root: Optional[str] = _setting(None, "folder of the data set's own files, in place of data.name's")
    use: Optional[str] = _setting(
        None, "reader of a published data set: h36m, mpii, ..., or file.py:Class; unset: files", only="keypoints"
    )
    options: dict[str, Any] = _setting({}, "options of the reader data.use", only="keypoints")
    train: Optional[str] = _setting(None, "file or folder to train on, several with commas or *, or the set's split")
    val: Optional[str] = _setting(
        None, "file, folder or split to validate on during the fit, or a share of the training data such as 0.1"
    )
    test: Optional[str] = _setting(None, "file, folder or split to evaluate on after the fit")
    format: Optional[str] = _setting(
        None, "format of the files: deeplabcut, openpose, coco, ..., or file.py:Class; unset: guessed"
    )
    layout: Optional[str] = _setting(
        None, "skeleton whose joints name the keypoints of files without names", only="keypoints"
    )
    image_size: Optional[str] = _setting(None, "image size of files that do not give it: 1920x1080", only="keypoints")
    fps: Optional[float] = _setting(
        None, "frames per second of files that do not give it", low=1e-9, high=1e9, only="keypoints"
    )
    focal_px: Optional[str] = _setting(
        None, "focal length in pixels, where known; of several cameras left:1145,right:1200", only="keypoints"
    )
    min_confidence: float = _setting(
        0.0, "keypoints of less confidence count as missing", low=0, high=1, only="keypoints"
    )
    flip_x: bool = _setting(False, "x counts from the right, as in mirror images: turn it round", only="keypoints")
    flip_y: bool = _setting(False, "y counts from the bottom of the image: turn it round", only="keypoints")
    rotate: int = _setting(
        0, "degrees clockwise that put turned images upright: 0, 90, 180 or 270", low=0, high=270, only="keypoints"
    )
    buffer: int = _setting(
        500_000,
        "frames of shards (uplift data shard) that are in memory at a time, where there are more; others take their "
        "place as training goes on",
        low=64,
        high=10**9,
        only="keypoints",
    )
    simulate: int = _setting(0, "frames, or masks, to simulate instead of reading a file", low=0, high=10**7)
    family: str = _setting("chairs", "family of synthetic shapes whose masks are simulated", only="masks")
    side: int = _setting(64, "pixels along a mask's crop", low=MIN_SIDE, high=MAX_SIDE, only="masks")
    border: str = _setting(
        "skip", "masks that touch the border of their image: skip or keep them", choices=("skip", "keep"), only="masks"
    )
    pieces: str = _setting(
        "skip",
        "masks in several pieces of similar size: skip them, or take the largest piece",
        choices=("skip", "largest"),
        only="masks",
    )
    category: Optional[str] = _setting(None, "only masks of this category, several with commas", only="masks")
    most: Optional[int] = _setting(None, "masks at most, spread over the files", low=1, high=10**8, only="masks")
    images: Optional[str] = _setting(None, "folder of the photos that masks belong to", only="masks")
    unit: Optional[str] = _setting(
        None, "unit of poses and roots in the files, whatever they say", choices=("mm", "relative"), only="keypoints"
    )
    get: str = _setting("", "how to get the files, for the message when they are not there")
    select: ChoiceSettings = _group(ChoiceSettings, "training frames to use")
    hold_out: ChoiceSettings = _group(ChoiceSettings, "training frames kept for the test")
    labelled: _LabelledSettings = _group(_LabelledSettings, "training frames whose truth may be used")


@dataclass
class RefineSettings:
    """How the lifted poses of a clip are refined together."""

    iterations: int = _setting(50, "steps of gradient descent; 0 leaves the poses as they are", low=0, high=100_000)
    rate: float = _setting(0.03, "first step size, in mean 2D radii of the body", low=0, high=10)
    bones: float = _setting(8.0, "weight of constant bone lengths over a clip", low=0, high=1e6)
    smooth: float = _setting(2.0, "weight of little acceleration", low=0, high=1e6)
    near: float = _setting(0.2, "weight of the lifted depths", low=0, high=1e6)
    seen: float = _setting(100.0, "weight of doubtful keypoints; those of confidence 1 do not move", low=1e-6, high=1e6)


@dataclass
class LifterSettings:
    """The network and the geometry around it."""

    network: str = _setting("residual", "the network: kudo, residual, or file.py:Class")
    options: dict[str, Any] = _setting({}, "options of lifter.network")
    camera: str = _setting("perspective", "camera model", choices=("orthographic", "perspective"))
    intrinsics: str = _setting(
        "auto", "auto: use the file's focal_px and image_size where it has them; off: never", choices=("auto", "off")
    )
    distance: float = _setting(
        10.0, "distance of the perspective camera without intrinsics, in mean 2D radii of the body", low=2, high=1e4
    )
    tilt: str = _setting(
        "predicted",
        "camera tilt: predicted (per pose), learned (one for all), level",
        choices=("predicted", "learned", "level"),
    )
    radius: str = _setting("without_root", "joints the normalising mean runs over", choices=("all", "without_root"))
    root_free: bool = _setting(False, "leave the root's own depth in")
    confidence_input: bool = _setting(True, "the network sees confidence beside the keypoints")
    confidence: str = _setting(
        "calibrated",
        "calibrated: refinement knows errors by how keypoints of each confidence jump in time, the network whether a joint is "
        "seen; given: both see that of the file",
        choices=("calibrated", "given"),
    )
    fill: bool = _setting(True, "the network predicts where missing joints are")
    uncertainty: bool = _setting(
        True, "the student predicts how far off each depth, or the place of a hidden joint, may be"
    )
    signs: int = _setting(
        0,
        "units of a second network of the student, which says how likely each bone points away from the camera; 0: none",
        low=0,
        high=16_384,
    )
    denoise: Optional[bool] = _setting(
        None, "the student moves seen joints too; unset: where student.noise adds errors to them"
    )
    both_ways: bool = _setting(True, "predict as the mean over the keypoints and their mirror image")
    refine: RefineSettings = _group(lambda: RefineSettings(smooth=1.0, near=0.5), "predicted clips")
    cameras: str = _setting(
        "own", "set from student.cameras for the last student; not yours to set", choices=("own", "any")
    )


@dataclass
class ViewSettings:
    """How lifted poses are turned. Without gravity views are uniform on SO(3)."""

    azimuth_deg: tuple[float, float] = _setting(
        (-180.0, 180.0), "from,to: degrees that a view is turned about gravity", low=-360, high=360
    )
    elevation: str = _setting(
        "batch",
        "tilt of new views: batch (another pose's), normal (batch mean and sd), same",
        choices=("batch", "normal", "same"),
    )
    use: Optional[str] = _setting(None, "views of your own: file.py:Class; unset: as these settings say")
    options: dict[str, Any] = _setting({}, "options of that class")
    renormalise: bool = _setting(True, "bring views to mean radius 1, as real keypoints are")
    count_root: bool = _setting(True, "set from lifter.radius; not yours to set")


@dataclass
class ShapeSettings:
    """What is lifted from masks, with ``lifts: masks``."""

    resolution: int = _setting(32, "voxels along the grid of a shape", low=8, high=256)
    gravity: bool = _setting(True, "shapes stand upright; false: seen from anywhere, views uniform on SO(3)")
    symmetric: bool = _setting(True, "shapes are their own mirror image, left and right")
    elevation_deg: tuple[float, float] = _setting(
        (15.0, 10.0), "mean,sd: degrees that the cameras look down", low=(-90, 0), high=(90, 90)
    )
    distance: float = _setting(6.0, "distance of the camera, in half sides of a shape's box", low=2, high=1e4)
    detail: int = _setting(32, "voxels along the grids that are learned; even", low=8, high=128)
    code: int = _setting(64, "numbers that a shape is described by", low=1, high=4096)
    hidden: int = _setting(512, "units of the decoder's layers", low=1, high=16384)
    pixels: int = _setting(24, "pixels along the silhouettes that are compared with masks", low=8, high=256)
    refine: int = _setting(
        40, "steps in which code and view are refined as a mask is lifted; 0: as the encoder says", low=0, high=10_000
    )
    parts: int = _setting(1, "shapes that views are found with at first", low=1, high=64)
    splits: list[int] = _setting([4, 4], "how many shapes each of them becomes, in each later stage", low=2, high=64)
    coarse: int = _setting(16, "voxels along the grids that views are found with; even", low=8, high=64)
    crop: int = _setting(20, "pixels along the crops that views are found with", low=12, high=64)
    proportions: float = _setting(
        0.15,
        "how much the width over height of a mask and its shape may differ, sd of the logarithm",
        low=0.01,
        high=100,
    )
    temperature_start: float = _setting(
        0.1, "temperature of the likelihood at the start of the first stage: how uncertain views are", low=1e-4, high=10
    )
    temperature_again: float = _setting(
        0.04, "temperature at the start of the later stages that find views", low=1e-4, high=10
    )
    temperature_end: float = _setting(0.02, "temperature from four fifths of such a stage on", low=1e-4, high=10)
    rounds: int = _setting(4, "times that views are looked for again with the space of shapes", low=0, high=100)
    views: Optional[str] = _setting(
        None, "table of the known views of a few training masks, name and azimuth_deg: they say which side is the front"
    )


@dataclass
class StageSettings:
    """One stage of training and its optimiser."""

    share: float = _setting(1.0, "share of the fit's budget; 0 leaves the stage out", low=0, high=1e6)
    batch_size: int = _setting(512, "frames per step, of all processes together", low=2, high=1 << 17)
    learning_rate: float = _setting(5e-4, "Adam's learning rate", low=1e-12, high=10)
    beta1: float = _setting(0.5, "Adam's beta 1", low=0, high=0.99999)
    beta2: float = _setting(0.99, "Adam's beta 2", low=0, high=0.9999999)
    weight_decay: float = _setting(0.0, "L2, in Adam's gradient", low=0, high=10)
    decay_from: float = _setting(
        0.6, "share of the stage after which the rate falls to 2 % (half a cosine)", low=0, high=1
    )
    average: Optional[float] = _setting(0.999, "decay of the averaged weights; none if unset", low=0, high=0.999999)
    warm_up: float = _setting(0.0, "share of the stage over which the rate rises from 0", low=0, high=1)
    mirror: bool = _setting(True, "show each frame mirrored half the time")


def _with_default(name: str, default: Any) -> Any:
    return field(default=default, metadata=StageSettings.__dataclass_fields__[name].metadata)


@dataclass
class TeacherSettings(StageSettings):
    """The first stage: priors judge lifted poses and their turned views."""

    hide: float = _setting(0.0, "share of known joints hidden from the network in each step", low=0, high=0.9)
    prior_learning_rate: Optional[float] = _setting(
        None, "learning rate of the priors' parameters; the same if unset", low=1e-12, high=10
    )
    same_real: bool = _setting(False, "adversarial priors see the batch's own keypoints as real, not another draw")


@dataclass
class StudentSettings(StageSettings):
    """The second stage: learn from the teacher's own poses, turned everywhere."""

    share: float = _with_default("share", 0.0)
    learning_rate: float = _with_default("learning_rate", 1e-3)
    beta1: float = _with_default("beta1", 0.9)
    warm_up: float = _with_default("warm_up", 0.05)
    decay_from: float = _with_default("decay_from", 0.0)
    rounds: list[float] = _setting(
        [0.35, 0.65],
        "share of the stage for each round; each trains a new student on the poses of the last",
        low=1e-6,
        high=1e6,
    )
    network: Optional[str] = _setting(None, "the student's network, where it is not lifter.network")
    options: dict[str, Any] = _setting({}, "options of the student's network, over lifter.options")
    last_options: dict[str, Any] = _setting({}, "options over student.options, in the last round")
    warm: bool = _setting(False, "a round goes on with the last round's weights where its network is the same")
    occlude: float = _setting(0.0, "share of views in which joints are hidden: some of them, or a limb", low=0, high=1)
    noise: bool = _setting(False, "add to the views what refinement found wrong in the keypoints")
    refine: RefineSettings = _group(RefineSettings, "poses to learn from")
    frames: int = _setting(
        60_000, "frames at most that are lifted and refined for a round, complete clips at random", low=1, high=10**12
    )
    turn: bool = _setting(True, "show poses from everywhere; off: each from where it was seen")
    any_way: float = _setting(
        0.15, "share of views turned any way, not about gravity alone: depth signs are learned from them", low=0, high=1
    )
    cameras: str = _setting(
        "any",
        "cameras that the last student learns: any, as the settings below say, with tilt, roll and distance estimated "
        "for every frame; own: those of the training data",
        choices=("any", "own"),
    )
    own_share: float = _setting(
        0.7, "of any cameras: the share of views from those of the training data", low=0, high=1
    )
    tilt_deg: tuple[float, float] = _setting((-30.0, 60.0), "from,to: tilts of any cameras", low=-90, high=90)
    roll_deg: float = _setting(30.0, "largest roll of any cameras, either way", low=0, high=180)
    distance: tuple[float, float] = _setting(
        (4.0, 25.0), "from,to: distances of any cameras, in mean 2D radii of the body", low=2, high=1e4
    )
    unknown_focal: float = _setting(
        0.6, "share of the views of any cameras whose focal length is hidden and guessed", low=0, high=1
    )
    mix: float = _setting(0.7, "share of poses that take limbs of others", low=0, high=1)
    mix_limb: float = _setting(0.4, "chance of each limb of such a pose", low=0, high=1)
    stretch: float = _setting(
        0.03,
        "standard deviation of the log of a view's bone lengths, left and right alike; short bones vary more",
        low=0,
        high=1,
    )
    loss: Optional[str] = _setting(None, "loss of your own: file.py:Class; unset: absolute errors")
    loss_options: dict[str, Any] = _setting({}, "options of that class")
    module: Optional[str] = _setting(None, "module of your own, a subclass of uplift.StudentModule: file.py:Class")


@dataclass
class TrainerSettings:
    """How long, on what, and what is kept."""

    max_time: Optional[str] = _setting(
        "00:10:00", "length of the training: seconds or hours:minutes:seconds; schedules stretch to it"
    )
    max_steps: Optional[int] = _setting(None, "optimiser steps of the fit", low=1, high=10**12)
    max_epochs: Optional[float] = _setting(
        None, "length of the fit in passes over the training frames", low=1e-9, high=1e9
    )
    checkpoint_every: float = _setting(60.0, "seconds between checkpoints", low=0, high=1e9)
    checkpoint_steps: Optional[int] = _setting(
        None, "optimiser steps between checkpoints, in place of seconds", low=1, high=10**12
    )
    log_every: int = _setting(50, "steps between rows of metrics.csv", low=1, high=10**9)
    threads: Optional[int] = _setting(
        None, "CPU threads; unset: all, or one where a crowded machine makes that faster", low=1, high=1024
    )
    accelerator: str = _setting("auto", "accelerator of Lightning's Trainer")
    devices: str = _setting("auto", "devices of Lightning's Trainer")
    wait: float = _setting(
        1800.0, "seconds that the processes of a fit wait for one another before it ends with an error", low=1, high=1e6
    )
    precision: str = _setting(
        "32-true",
        "precision of Lightning's Trainer: 16 and bf16 are of networks alone; auto: bf16 on processors made for it",
        choices=("auto", "32-true", "16-mixed", "bf16-mixed", "32", "16", "bf16"),
    )
    products: str = _setting(
        "auto",
        "float32 matrix products, as torch.set_float32_matmul_precision; auto: the fastest that is exact, TF32 on CUDA",
        choices=PRODUCTS,
    )
    logger: Optional[str] = _setting(None, "loggers beside metrics.csv, several with commas: tensorboard, wandb, csv")
    flags: dict[str, Any] = _setting({}, "any other flag of Lightning's Trainer, given as trainer.NAME")


@dataclass
class SweepSettings:
    """A sweep: a setting with several values, as in seed=0..7, is a fit for each value."""

    how: str = _setting(
        "auto",
        "how its fits run: as processes of this machine, as one stacked network that trains them together, as jobs of a SLURM "
        "cluster, as tasks of a Ray cluster; auto: a stack on a GPU, else processes",
        choices=("auto", "processes", "stack", "slurm", "ray"),
    )
    workers: Optional[int] = _setting(
        None,
        "fits at a time; unset: one for each core that trainer.threads leaves, or for each GPU; 64 in a stack; on a cluster as "
        "many as it runs",
        low=1,
        high=100_000,
    )
    most: int = _setting(1000, "fits at most: a larger grid is refused before it starts", low=1, high=10**6)
    options: dict[str, Any] = _setting(
        {},
        "of a cluster: parameters of a SLURM job as submitit has them, such as timeout_min or slurm_partition, or options "
        "of a Ray task, such as num_cpus",
    )


@dataclass
class Settings:
    """All settings of a fit."""

    task: str = _setting("", "name of the task file")
    description: str = _setting("", "one line about the task; shown by uplift tasks and in the report")
    lifts: str = _setting(
        "keypoints",
        "what is lifted to 3D; settings that go with the other kind are refused",
        choices=("keypoints", "masks"),
    )
    skeleton: str = _setting("", "a shipped name, or a YAML file", only="keypoints")
    seed: int = _setting(0, "seed of everything random", low=0, high=2**31 - 1)
    init: Optional[str] = _setting(
        None,
        "run, lifter's file or ready lifter that the fit starts from: with its network, and its weights by the names of joints",
    )
    module: Optional[str] = _setting(
        None, "module of your own, a subclass of uplift.LiftingModule or uplift.ShapeModule: file.py:Class"
    )
    data: DataSettings = _group(DataSettings)
    lifter: LifterSettings = _group(LifterSettings)
    shape: ShapeSettings = _group(ShapeSettings, only="masks")
    views: ViewSettings = _group(ViewSettings)
    priors: dict[str, Any] = _setting({}, "name: {use, weight, if_possible, the prior's own options}")
    teacher: TeacherSettings = _group(TeacherSettings)
    student: StudentSettings = _group(StudentSettings)
    trainer: TrainerSettings = _group(TrainerSettings)
    sweep: SweepSettings = _group(SweepSettings)
    callbacks: dict[str, Any] = _setting({}, "name: {use, the callback's own options}; Lightning's own by their names")
    loggers: dict[str, Any] = _setting({}, "name: {use, the logger's own options}; see trainer.logger")


TRAINER_FLAGS = (
    "accumulate_grad_batches", "benchmark", "check_val_every_n_epoch", "detect_anomaly", "deterministic",
    "enable_autolog_hparams", "enable_model_summary", "enable_progress_bar", "fast_dev_run", "gradient_clip_algorithm",
    "gradient_clip_val", "inference_mode", "limit_predict_batches", "limit_test_batches", "limit_train_batches",
    "limit_val_batches", "min_epochs", "min_steps", "num_nodes", "num_sanity_val_steps",
    "overfit_batches", "profiler", "reload_dataloaders_every_n_epochs", "strategy", "sync_batchnorm",
    "use_distributed_sampler", "val_check_interval",
)  # fmt: skip
"""Flags of Lightning's Trainer that a user may set beside `TrainerSettings`, as ``trainer.NAME``."""
TRAINER_FLAGS_OF_FIT = {
    "callbacks": "name them as callbacks.NAME.use=file.py:Class",
    "log_every_n_steps": "set trainer.log_every",
    "default_root_dir": "a fit writes into its run folder",
    "enable_checkpointing": "checkpoints make a fit resumable; see trainer.checkpoint_every",
    "plugins": "a fit uses its own",
    "barebones": "a fit needs its callbacks",
    "model_registry": "a fit writes lifter.pt",
}
"""Flags that a fit sets itself, and what to do instead."""


# The settings as a list: what checks, command-line completion and help read.


class Setting(NamedTuple):
    """One setting as its field declares it."""

    name: str
    """In full, such as ``trainer.max_time``."""
    type: Any
    default: Any
    help: str
    low: Any
    high: Any
    choices: tuple[str, ...]
    only: str | None
    """What a fit must lift for the setting to count, "keypoints" or "masks"; None: either."""

    @property
    def kind(self) -> Any:
        """The type without "or None"."""
        kinds = [kind for kind in typing.get_args(self.type) if kind is not type(None)]
        return kinds[0] if typing.get_origin(self.type) in (typing.Union, types.UnionType) else self.type

    @property
    def parts(self) -> tuple[str, ...]:
        """The names of the numbers of a pair: its help may begin with them, as in "from,to: ..."."""
        named = re.match(r"(\w+),(\w+): ", self.help)
        return named.groups() if named else ("a", "b")

    @property
    def accepts(self) -> str:
        """What a value may be, in words that follow "expected", such as "a whole number from 1 to 64"."""
        if self.choices:
            return " or ".join(self.choices) if len(self.choices) < 3 else f"one of {', '.join(self.choices)}"
        form, parts = typing.get_origin(self.kind), typing.get_args(self.kind)
        if isinstance(self.low, tuple):
            ends = zip(self.parts, self.low, self.high, strict=True)
            return f"{','.join(self.parts)}: " + ", ".join(f"{part} {range_text(*pair)}" for part, *pair in ends)
        limits = range_text(self.low, self.high)
        if form is tuple:
            return f"{','.join(self.parts)}, {_SEVERAL.get(parts[0], 'values')} {limits}".rstrip()
        if form is list:
            return f"{_SEVERAL.get(parts[0], 'values')} {limits}".rstrip() + ", with commas"
        return f"{_ONE.get(form or self.kind, 'a value')} {limits}".rstrip()


_ONE = {
    bool: "true or false", int: "a whole number", float: "a number", str: "text", dict: "settings below it",
}  # fmt: skip
_SEVERAL = {int: "whole numbers", float: "numbers", str: "names"}


def range_text(low: Any, high: Any) -> str:
    """Return a range in words, such as "from 1 to 64", "above 0" or nothing where there are no limits."""
    nonsense = high is not None and high >= _HUGE and float(f"{high:g}") == high
    top = "" if high is None or nonsense else _number_text(high)
    if low is None:
        return f"of at most {top}" if top else ""
    if 0 < low < _TINY:
        return f"above 0 and at most {top}" if top else "above 0"
    return f"from {_number_text(low)} to {top}" if top else f"of at least {_number_text(low)}"


_HUGE, _TINY = 1e9, 1e-5
"""Round limits beyond these keep nonsense out and are not told."""


def _number_text(value: int | float) -> str:
    """Return a number as a person writes it: 1,024 or 0.001 or 1e6."""
    short = f"{value:g}"
    if float(short) != value:
        return f"{value:,}"
    if value == int(value) and abs(value) < 1e9:
        return f"{int(value):,}"
    return re.sub(r"e([+-])0*", lambda sign: f"e{sign[1].strip('+')}", short)


@functools.cache
def all_settings() -> dict[str, Setting]:
    """Return every setting by its full name, in the order of the fields."""
    return {one.name: one for one in _walk(Settings(), "", {})}


def _walk(group: Any, above: str, about: Mapping[str, Any]) -> Iterator[Setting]:
    hints = typing.get_type_hints(type(group))
    for one in fields(group):
        name, value, known = above + one.name, getattr(group, one.name), one.metadata
        if is_dataclass(value):
            yield from _walk(value, f"{name}.", known)
            continue
        help = known["help"] + (f" ({about['help']})" if about.get("help") else "")
        only, choices = known.get("only", about.get("only")), known.get("choices", ())
        yield Setting(name, hints[one.name], value, help, known.get("low"), known.get("high"), choices, only)


def all_groups() -> dict[str, str]:
    """Return what each group of settings is for, by its full name; that of the settings outside all groups is ""."""
    return dict(_walk_groups(Settings(), ""))


def _walk_groups(group: Any, name: str) -> Iterator[tuple[str, str]]:
    yield name, (type(group).__doc__ or "").splitlines()[0].rstrip(".")
    for one in fields(group):
        value = getattr(group, one.name)
        if is_dataclass(value):
            (below, help), *deeper = _walk_groups(value, f"{name}.{one.name}".lstrip("."))
            about = one.metadata["help"]
            yield below, f"{help} ({about})" if about else help
            yield from deeper


PRIOR_SETTINGS = {
    one.name: one
    for one in (
        Setting("use", Optional[str], None, "the class: a built-in prior, file.py:Class or package.module:Class; unset: "
                "the built-in prior of this name", None, None, (), None),
        Setting("weight", float, 1.0, "factor on its penalty; 0 leaves it out", 0, None, (), None),
        Setting("if_possible", bool, False, "leave it out, with a note, where the skeleton lacks what it needs",
                None, None, (), None),
    )
}  # fmt: skip
"""What each of ``priors`` takes beside the options of its class."""


# What settings may be, beyond their types: choices, ranges, what goes with what is lifted, contradictions.

_MOST_BYTES = 4_000_000_000
_MOST_SHAPES = 4096
_MOST_VOXELS = 1 << 28
"""Of all shapes of a mixture: 1 GB, and three times as much with their optimiser."""
_MOST_BATCHES = 100_000
_MOST_ROUNDS = 100


def check_settings(settings: Settings) -> None:
    """Refuse what types cannot: unknown choices, numbers out of range, contradictions. Raises UserError."""
    for one in all_settings().values():
        value = functools.reduce(getattr, one.name.split("."), settings)
        if one.only not in (None, settings.lifts):
            _check_default(one, value, settings.lifts)
        elif value is not None:
            _check_value(one, value)
    settings.views.count_root = settings.lifter.radius == "all"
    for wrong, message in (*_contradictions(settings), *(_of_masks(settings) if settings.lifts == "masks" else ())):
        if wrong:
            raise UserError(message)
    if settings.trainer.max_time is not None:
        seconds_of(settings.trainer.max_time)


def _check_default(one: Setting, value: Any, lifts: str) -> None:
    """Refuse a value of a setting that only goes with the other kind of fit."""
    if value == one.default or (isinstance(value, list) and tuple(value) == one.default):
        return
    hint = " Start from task=masks for those." if one.only == "masks" else ""
    choice = {key.name: key.metadata.get("only", lifts) for key in fields(ChoiceSettings)}
    if one.name.split(".")[-1] in choice:
        hint = f" Choose by {', '.join(key for key, only in choice.items() if only == lifts)}."
    raise UserError(f"{one.name} is set, but this fit lifts {lifts}: it goes with {one.only}.{hint}")


def _check_value(one: Setting, value: Any) -> None:
    """Refuse an unknown choice, or a number out of range, alone or in a list."""
    if one.choices and value not in one.choices:
        hint = nearest(value, one.choices)
        raise UserError(f"{one.name}={value!r}: expected {one.accepts}.{hint}")
    if one.low is None:
        return
    several = isinstance(value, (list, tuple))
    for place, number in enumerate(value if several else [value]):
        low, high = (end[place] if isinstance(end, tuple) else end for end in (one.low, one.high))
        if not low <= number <= high:
            name = f"{one.name}[{place}]" if several else one.name
            raise UserError(f"{name}={number}: expected a number {range_text(low, high)}.")


def _contradictions(settings: Settings) -> Iterator[tuple[bool, str]]:
    student, trainer = settings.student, settings.trainer
    yield (
        student.share > 0 and not student.rounds,
        "student.rounds is empty: give a share for each round, or student.share=0 for no student.",
    )
    flags = trainer.flags
    unknown = next((name for name in flags if name not in TRAINER_FLAGS), "")
    yield bool(unknown), f"trainer.flags.{unknown}: no such flag for a fit.{nearest(unknown, TRAINER_FLAGS)}"
    count = flags.get("accumulate_grad_batches", 1)
    whole = isinstance(count, int) and not isinstance(count, bool) and 1 <= count <= _MOST_BATCHES
    yield not whole, f"trainer.accumulate_grad_batches={count!r}: expected a whole number from 1 to {_MOST_BATCHES:,}."
    rounds = len(student.rounds)
    yield rounds > _MOST_ROUNDS, f"student.rounds has {rounds:,} rounds, expected at most {_MOST_ROUNDS}."
    yield settings.teacher.share <= 0, "teacher.share is 0: the first stage cannot be left out."
    yield (
        trainer.max_time is None and trainer.max_steps is None and trainer.max_epochs is None,
        "Set one of trainer.max_time, trainer.max_steps, trainer.max_epochs: the fit would never end.",
    )


def _of_masks(settings: Settings) -> Iterator[tuple[bool, str]]:
    """Yield what must not be in a fit of masks, and the message for it."""
    data, shape = settings.data, settings.shape
    odd = f"shape.detail={shape.detail}: expected an even number, as the halves of a shape are grids too."
    yield shape.detail % 2 == 1, odd
    shapes = shape.parts * math.prod(shape.splits)
    many = f"shape.parts and shape.splits ask for {shapes:,} shapes, expected at most {_MOST_SHAPES:,}."
    yield shapes > _MOST_SHAPES, many
    voxels = shapes * shape.coarse**3
    fine = (
        f"{shapes:,} shapes of shape.coarse={shape.coarse} have {voxels:,} voxels, expected at most {_MOST_VOXELS:,}."
    )
    yield voxels > _MOST_VOXELS, fine
    size, masks = data.simulate * data.side**2, f"data.simulate={data.simulate} masks of data.side={data.side}"
    yield size > _MOST_BYTES, f"{masks} take {size / 1e9:,.0f} GB: ask for fewer."
    for key in ("category", "most", "images", "format"):
        message = f"data.{key} goes with files of masks, but data.simulate={data.simulate} simulates masks."
        yield bool(data.simulate) and getattr(data, key) is not None, message


def seconds_of(value: Any) -> float:
    """Return the seconds of a duration as Lightning's Trainer and people write it.

    That is a number of seconds, ``hours:minutes:seconds``, ``days:hours:minutes:seconds``, or units by name such as
    ``{"minutes": 10}``, those of `datetime.timedelta`. Raises UserError for anything else.
    """
    span = value
    if isinstance(value, Mapping):
        with suppress(TypeError, OverflowError):
            span = timedelta(**value)
    seconds = span.total_seconds() if isinstance(span, timedelta) else _seconds_of_text(str(value).strip())
    if seconds is None:
        forms = "seconds, hours:minutes:seconds such as 00:10:00, or units such as {minutes: 10}"
        raise UserError(f"trainer.max_time={value!r}: expected {forms}.")
    if not 0 < seconds <= _HUGE:
        why = "no time to train in" if seconds <= 0 else f"expected at most {_HUGE:.0e} seconds"
        raise UserError(f"trainer.max_time={value!r}: {why}.")
    return seconds


def _seconds_of_text(text: str) -> float | None:
    if re.fullmatch(r"\d+(\.\d*)?|\.\d+", text):
        return float(text)
    if not re.fullmatch(r"(\d+:){2,3}\d+(\.\d+)?", text):
        return None
    parts = [float(part) for part in text.split(":")]
    return sum(part * unit for part, unit in zip(reversed(parts), (1, 60, 3600, 86400), strict=False))


# Settings under former names: an error where a user gives them, translated where an earlier fit wrote them.

RENAMED = {
    "lifter.spread": "lifter.uncertainty",
    "shape.hot": "shape.temperature_start",
    "shape.cold": "shape.temperature_end",
    **{
        f"data.{group}.{key}": f"data.{group}.{key}s"
        for group in ("select", "hold_out")
        for key in ("subject", "action", "sequence", "camera")
    },
}
"""The new full name of every setting that had another."""


def rename_old(plain: dict[str, Any]) -> None:
    """Give plain nested settings that an earlier version wrote their present names, in place."""
    for old, new in RENAMED.items():
        (*groups, old), new = old.split("."), new.split(".")[-1]  # the group is the same
        found: Any = plain
        for group in groups:
            found = found.get(group) if isinstance(found, dict) else None
        if isinstance(found, dict) and old in found:
            found.setdefault(new, found.pop(old))


Group = TypeVar("Group")


def settings_of(kind: type[Group], name: str, plain: dict[str, Any]) -> Group:
    """Return the settings called ``name``, such as "lifter", that a fit of this or an earlier version saved.

    Raises UserError for a value of another kind or out of range; TypeError, ValueError or AttributeError for anything else.
    """
    named = {name: copy.deepcopy(plain)}
    rename_old(named)
    found = _built(kind, named[name])
    for one in all_settings().values():
        if one.name.startswith(f"{name}."):
            value = functools.reduce(getattr, one.name.split(".")[1:], found)
            if not _is_of(one.type, value):
                raise UserError(f"{one.name}={value!r:.80}: expected {one.accepts}.")
            if value is not None:
                _check_value(one._replace(low=_earlier(one.low)), value)
    return found


def _earlier(low: Any) -> Any:
    """Return the least that an earlier version may have saved: lower bounds have been raised, signs have not changed."""
    if isinstance(low, tuple):
        return tuple(map(_earlier, low))
    return 1e-12 if low is not None and low > 0 else low


def _is_of(hint: Any, value: Any) -> bool:
    """Return whether a value is what the type hint of a setting says; a whole number is a number too."""
    parts = typing.get_args(hint)
    if hint is Any or (value is None and type(None) in parts):
        return True
    if typing.get_origin(hint) in (list, tuple):
        return isinstance(value, (list, tuple)) and all(_is_of(parts[0], part) for part in value)
    if parts and typing.get_origin(hint) is not dict:
        return any(_is_of(part, value) for part in parts)
    kinds = (int, float) if hint is float else (typing.get_origin(hint) or hint,)
    return isinstance(value, kinds) and (hint is bool or not isinstance(value, bool))


def _built(kind: Any, plain: dict[str, Any]) -> Any:
    hints, given = typing.get_type_hints(kind), dict(plain)
    for key in given.keys() & hints.keys():
        if is_dataclass(hints[key]):
            given[key] = _built(hints[key], given[key])
        elif typing.get_origin(hints[key]) is tuple:
            given[key] = tuple(given[key])
    return kind(**given)
