"""`KeypointData` and `MaskDataModule`: the data of a training as Lightning takes it, split and labelled."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, Generic, TypeVar

import lightning as L
import numpy as np
import torch

from uplift.config.files import absolute
from uplift.config.loading import settings_from
from uplift.config.settings import DataSettings, LifterSettings, Settings, ShapeSettings
from uplift.config.trust import consents, granted
from uplift.data.clean import clean
from uplift.data.confidence import Calibration, calibrated
from uplift.data.datasets import DATA_SETS
from uplift.data.far import without_far
from uplift.data.formats import checked
from uplift.data.individuals import by_individuals
from uplift.data.load import Loaded, in_joints_of, load_data, load_split, read_options
from uplift.data.load_masks import LoadedMasks, load_mask_split, load_masks
from uplift.data.mask_tensors import MaskSet, to_mask_set
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.data.samples import Samples
from uplift.data.select import choice_of
from uplift.data.stream import Resident, Streamed, load_training
from uplift.data.tensors import TrainingSet, mean_bones, to_training_set, with_labels
from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["KeypointData", "MaskDataModule", "depends_on_seed", "skeleton_of"]

SamplesT = TypeVar("SamplesT", bound=Samples)
LoadedT = TypeVar("LoadedT", Loaded, LoadedMasks)


class _Steps(Iterable[int]):
    """A loader of ``steps`` steps, each the number of samples to draw; the data stay on the device.

    What a step draws depends on its number alone, so there is no state to resume from.
    """

    def __init__(self, batch_size: int, steps: int):
        self.batch_size, self.steps = batch_size, steps

    def __len__(self) -> int:
        return self.steps

    def __iter__(self) -> Iterator[int]:
        return repeat(self.batch_size, self.steps)

    def state_dict(self) -> dict[str, Any]:
        """Return nothing: see above."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take nothing."""


class _Once(Iterable[SamplesT]):
    """A loader of one batch."""

    def __init__(self, samples: SamplesT):
        self.samples = samples

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[SamplesT]:
        return iter([self.samples])


class _Data(L.LightningDataModule, Generic[SamplesT, LoadedT]):
    """Loads once, when it is first needed; holds out ``val`` of the training samples; draws batches of ``batch_size``."""

    endless = False
    """Whether an epoch never ends, as in a fit by time."""

    def __init__(self, settings: Settings, given: Mapping[str, Any], val: float | Any | None, batch_size: Any):
        super().__init__()
        batch_size = _plain_number(batch_size)
        if isinstance(batch_size, bool) or not isinstance(batch_size, int) or batch_size < 2:
            raise UserError(f"batch_size={batch_size!r}: expected a whole number of at least 2.")
        if isinstance(val, bool) or (isinstance(val, (int, float)) and not 0 <= val < 1):
            raise UserError(f"val={val!r}: expected a share of the training data from 0 to below 1, a file, or data.")
        self.settings, self.given, self.val, self.batch_size = settings, dict(given), val, batch_size
        self.loaded: LoadedT | None = None
        """What was read, with `notes` on it; None before `setup`."""
        self._val: SamplesT | None = None
        self._test: Any = None
        with granted() as consent:
            self._consent = consent

    def __str__(self) -> str:
        """Return what the data are, without reading them."""
        read = "not read yet" if self.loaded is None else "; ".join(self.notes)
        return f"{type(self).__name__} of {self._source()}: {read}"

    def _source(self) -> str:
        given = self.given["train"]
        return str(given) if isinstance(given, (str, Path, int)) else type(given).__name__

    @abstractmethod
    def _load(self) -> LoadedT:
        """Return the training and test samples."""

    @abstractmethod
    def _read(self, given: Any, which: str) -> SamplesT:
        """Return the samples that a user gave as a file, arrays or data, ready to be lifted and compared."""

    @abstractmethod
    def _split(self, train: SamplesT, share: float) -> np.ndarray:
        """Return which of the training samples are held out."""

    def _for_training(self, loaded: LoadedT) -> LoadedT:
        """Return what training may see of ``loaded``."""
        return loaded

    def setup(self, stage: str) -> None:
        """Read what ``stage`` needs, once."""
        if stage in ("fit", "validate") or (stage == "test" and self.given.get("test") is None):
            self._load_once()

    def _load_once(self) -> LoadedT:
        if self.loaded is None:
            with granted(self._consent):
                self.loaded = self._loaded()
        return self.loaded

    def _loaded(self) -> LoadedT:
        train = self.given["train"]
        if train is None:
            raise UserError(
                f"There are no training data: give {type(self).__name__}(train=...) files, data or a number."
            )
        loaded = train if isinstance(train, (Loaded, LoadedMasks)) else self._load()
        self._test, share = self._test or loaded.test, self.val
        if isinstance(share, (int, float)) and share:
            samples: Any = loaded.train
            if len(samples) < 2:
                raise UserError(f"val={share}: there is one sample to train on, and none to hold out.")
            loaded, held = self._hold_out(loaded, float(share))  # type: ignore[arg-type]
            note = f"val: {len(held):,} of the training samples are held out"
            loaded = replace(loaded, notes=[*loaded.notes, note])  # type: ignore[type-var]
            self._val = held
        elif share is not None and not isinstance(share, (int, float)):
            self._val = self._read(share, "val")
            loaded = replace(loaded, notes=[*loaded.notes, f"val: {len(self._val):,} from {self._val.source}"])  # type: ignore[type-var, attr-defined]
        return self._for_training(loaded)  # type: ignore[arg-type]

    def _hold_out(self, loaded: LoadedT, share: float) -> tuple[LoadedT, SamplesT]:
        """Return what is left to train on without a ``share`` of the samples, and these."""
        samples: Any = loaded.train
        rows = self._split(samples, share)
        return replace(loaded, train=samples.select(~rows)), samples.select(rows)  # type: ignore[type-var]

    def _read_given(self, which: str) -> SamplesT:
        with granted(self._consent):
            return self._read(self.given[which], which)

    @property
    def train_samples(self) -> SamplesT:
        """What is trained on."""
        return self._load_once().train  # type: ignore[return-value]

    @property
    def sample_count(self) -> int:
        """How many samples there are to train on, in memory or not: an epoch."""
        return len(self.train_samples)

    @property
    def val_samples(self) -> SamplesT | None:
        """What is validated on; None without any."""
        self._load_once()
        return self._val

    @property
    def test_samples(self) -> SamplesT:
        """What is tested on; raises UserError where no test data were given."""
        if self._test is None and self.given.get("test") is not None:
            self._test = self._read_given("test")
        if self._test is None:
            self._load_once()
        if self._test is None:
            raise UserError("There are no test data: give test=FILE (or hold_out={'fraction': 0.1}).")
        return self._test

    @property
    def notes(self) -> list[str]:
        """What was read and assumed, one sentence each."""
        return self._load_once().notes

    # Loaders. Batches are drawn on the device, so that a loader gives no more than their size.

    def train_dataloader(self) -> Iterable[int]:
        """Return a loader of as many steps as an epoch has batches, each the number of samples to draw."""
        if self.endless:
            return repeat(self.batch_size)
        return _Steps(self.batch_size, max(1, -(-self.sample_count // self.batch_size)))

    def val_dataloader(self) -> Iterable[SamplesT]:
        """Return the validation samples as one batch, as figures need complete clips; nothing without any."""
        return [] if self.val_samples is None else _Once(self.val_samples)

    def test_dataloader(self) -> Iterable[SamplesT]:
        """Return the test samples as one batch."""
        return _Once(self.test_samples)

    def predict_dataloader(self) -> Iterable[SamplesT]:
        """Return the samples to lift as one batch; those of the test where there are no others."""
        return _Once(self.test_samples if self.given.get("predict") is None else self._read_given("predict"))

    @classmethod
    def load_from_checkpoint(cls, *given: Any, **options: Any) -> Any:
        """Do as Lightning does; nothing but tensors and plain data is read."""
        return super().load_from_checkpoint(*given, **{**options, "weights_only": True})


def _data_settings(train: Any, lifts: str, options: Mapping[str, Any], **plain: Any) -> Settings:
    """Return the settings of a fit that trains on ``train``; ``options`` are those of `DataSettings`.

    Raises UserError: an option that there is not.
    """
    known = [one.name for one in fields(DataSettings) if one.name not in ("train", "val", "test", "simulate", "get")]
    for name in options:
        if name not in known:
            raise UserError(f"'{name}' is not an option of the data.{did_you_mean(name, known)}")
    data = dict(options)
    if isinstance(train, int) and not isinstance(train, bool):
        data["simulate"] = train
    elif isinstance(train, (str, Path)):
        data |= _place(train, options, "train")
    return settings_from({"lifts": lifts, "data": data, **plain}, "default" if lifts == "keypoints" else "masks")


def _place(given: str | Path, options: Mapping[str, Any], which: str) -> dict[str, Any]:
    """Return the settings of files that ``given`` names: SET:SPLIT, or a path from ``root`` or the current folder."""
    use, colon, split = str(given).partition(":")
    if colon and use in DATA_SETS:
        return {"name": options.get("name") or use, "use": use, which: split}
    in_folder = options.get("root") or options.get("name")
    return {which: str(given) if in_folder else absolute(str(given))}


def _plain_number(value: Any) -> Any:
    """Return a number of numpy or torch as Python's; anything else as it is."""
    return value.item() if getattr(value, "ndim", None) == 0 and hasattr(value, "item") else value


def _labelled(labelled: float | Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the settings ``data.labelled`` of a share of the samples, or of settings by name."""
    if labelled is None:
        return {}
    return {"labelled": dict(labelled) if isinstance(labelled, Mapping) else {"fraction": labelled}}


def share_or_files(val: str | None) -> float | str | None:
    """Return the setting ``data.val`` as a number where it is one."""
    try:
        return None if val is None else float(val)
    except ValueError:
        return val


def depends_on_seed(settings: Settings) -> bool:
    """Return whether another seed means other training samples: simulated ones, or a random share of some."""
    data, val = settings.data, share_or_files(settings.data.val)
    shares = [choice_of(choice).get("fraction", 1) for choice in (data.select, data.hold_out, data.labelled)]
    return bool(data.simulate) or (isinstance(val, float) and val > 0) or any(share != 1 for share in shares)


# Keypoints.


def skeleton_of(given: Skeleton | str | Path | Mapping[str, Any]) -> Skeleton:
    """Return a skeleton that is given as one, by a shipped name, as a YAML file, or as `Skeleton.to_dict` returns it."""
    if isinstance(given, Skeleton):
        return given
    return Skeleton.from_dict(dict(given)) if isinstance(given, Mapping) else load_skeleton(str(given))


class KeypointData(_Data[PoseData, Loaded]):
    """2D keypoints to train, validate, test and predict on.

    Example::

        data = uplift.KeypointData("beetle.csv", skeleton="beetle.yaml")
        module = uplift.LiftingModule(data.skeleton)
        lightning.Trainer(max_epochs=20).fit(module, data)

    Args:
        train: files in any format (a path, several with commas, a pattern), a split of a published set such as
            ``"h36m:train"``, a number of frames to simulate, a `uplift.PoseData`, or arrays: keypoints
            (frames joints 2) in pixels with the joints in the skeleton's order, alone or as
            (keypoints, confidence); NaN is missing.
        skeleton: a shipped name, a YAML file, or a `uplift.Skeleton`.
        val: share of the training frames to hold out for validation, in complete clips; or files, data or
            arrays; 0 or None for no validation. Figures of poses are logged where it has true poses, and a score
            that needs none where it does not.
        test: files, data or arrays to test on, with true poses.
        predict: files, data or arrays to lift; those of ``test`` by default.
        batch_size: frames that a step draws at random, on several ranks all of them together. An epoch has as many draws
            as there are frames. Of shards (``uplift data shard``) with more frames than ``buffer``, so many are in memory
            at a time.
        labelled: share of the training frames whose true poses may be learned from, or the settings
            ``data.labelled`` by name; None: training from 2D alone.
        seed: of the splits and the simulator.
        options: settings ``data.NAME`` by name: ``format``, ``layout``, ``image_size``, ``fps``, ``focal_px``,
            ``min_confidence``, ``select``, ``hold_out``, ``root``, ...

    Raises:
        UserError: a file that is missing or wrong, an invalid option, no frames left; files are read in `setup`.
    """

    @consents
    def __init__(
        self,
        train: Any = None,
        skeleton: Skeleton | str | Path | Mapping[str, Any] = "",
        *,
        val: Any = 0.1,
        test: Any = None,
        predict: Any = None,
        batch_size: Any = 256,
        labelled: float | Mapping[str, Any] | None = None,
        seed: int = 0,
        **options: Any,
    ):
        if not skeleton:
            raise UserError(
                "KeypointData needs skeleton=NAME (`uplift skeletons` lists them), FILE.yaml or a Skeleton."
            )
        self.skeleton = skeleton_of(skeleton)
        options, train = {**options, **_labelled(labelled)}, _plain_number(train)
        settings = _data_settings(train, "keypoints", options, seed=seed)
        super().__init__(settings, {"train": train, "test": test, "predict": predict}, val, batch_size)
        self._frames: dict[tuple, TrainingSet] = {}

    @classmethod
    def of(cls, loaded: Loaded, skeleton: Skeleton, settings: Settings) -> KeypointData:
        """Return the data of a fit that were loaded already; epochs never end."""
        data = cls(loaded, skeleton, val=share_or_files(settings.data.val))
        data.settings, data.endless = settings, True
        return data

    @property
    def labelled_share(self) -> float | None:
        """The most of a batch that is labelled; None: as many as there are among the frames."""
        return self.settings.data.labelled.share

    def frames(self, settings: LifterSettings) -> TrainingSet:
        """Return the training frames in the units and the camera of ``settings``, with the labels that may be used."""
        used = ("camera", "intrinsics", "distance", "radius", "cameras")
        key = (*(getattr(settings, name) for name in used), settings.confidence == "given")
        if key not in self._frames:
            loaded = self._load_once()
            parts = [self._converted(part, settings) for part in (loaded.train, loaded.more) if part is not None]
            self._frames[key] = parts[0] if len(parts) == 1 else TrainingSet.concat(parts)
        return self._frames[key]

    def _converted(
        self, part: PoseData, settings: LifterSettings, calibration: Calibration | None = None
    ) -> TrainingSet:
        part = calibrated(part, self.skeleton, settings, calibration)
        return with_labels(to_training_set(part, self.skeleton, settings), part)

    def resident(self, settings: LifterSettings, device: torch.device, *, batch: int, step: int) -> Resident | None:
        """Return the frames that training draws from where these change as it goes on (shards larger than memory).

        Args:
            settings: units and camera of the frames.
            device: where they are.
            batch: frames that a step draws.
            step: the first step; the frames are those that an uninterrupted training has then.

        None where all frames are in memory.
        """
        loaded = self._load_once()
        if not isinstance(loaded, Streamed) or loaded.stream is None:
            return None
        calibration = None if settings.confidence == "given" else Calibration.of(loaded.train)
        more = None if loaded.more is None else self._converted(loaded.more, settings)
        convert = partial(self._converted, settings=settings, calibration=calibration)
        return Resident(loaded.stream, convert, more=more, device=device, batch=batch, step=step)

    @property
    def sample_count(self) -> int:
        """How many frames there are to train on, in memory or not."""
        loaded = self._load_once()
        return loaded.stream.frames if isinstance(loaded, Streamed) and loaded.stream else len(loaded.train)

    def _hold_out(self, loaded: Loaded, share: float) -> tuple[Loaded, PoseData]:
        return loaded.with_held_out(share) if isinstance(loaded, Streamed) else super()._hold_out(loaded, share)

    def bone_mm(self, settings: LifterSettings):
        """Return the mean length of each bone of the labelled bodies (bones,), mm; None where it is not known."""
        return mean_bones(self.frames(settings)) if self._load_once().unit == "mm" else None

    def _load(self) -> Loaded:
        train = self.given["train"]
        if isinstance(train, (str, Path, int)):
            return load_training(self.settings, self.skeleton)
        poses = self._in_joints(train)

        def load(settings: Settings, which: str) -> PoseData:
            named = settings.data.train if which == "train" else settings.data.test
            return load_split(settings, which, self.skeleton) if named else poses

        return load_data(self.settings, self.skeleton, load)

    def _in_joints(self, given: Any) -> PoseData:
        """Return samples in the skeleton's joints, as those of a file are read."""
        return in_joints_of(without_far(by_individuals(self._samples(given), self.skeleton)), self.skeleton)

    def _samples(self, given: Any) -> PoseData:
        """Return arrays or data as `PoseData`, in pixels and with what the options say of them."""
        return checked(self._as_poses(given), read_options(self.settings.data))

    def _as_poses(self, given: Any) -> PoseData:
        """Return arrays or data as `PoseData`, as they are."""
        if isinstance(given, PoseData):
            return given
        if isinstance(given, Mapping):
            return PoseData(**{"joint_names": self.skeleton.joints, **given})
        keypoints, *rest = given if isinstance(given, (tuple, list)) else (given,)
        keypoints = np.array(keypoints, np.float32)
        joints = len(self.skeleton.joints)
        if keypoints.ndim != 3 or keypoints.shape[1:] != (joints, 2):
            raise UserError(
                f"keypoints of shape {keypoints.shape}, expected (frames, {joints}, 2): {self.skeleton.joints}."
            )
        weight = (
            np.array(rest[0], np.float32) if rest and rest[0] is not None else np.ones(keypoints.shape[:2], np.float32)
        )
        return PoseData(keypoints, weight, self.skeleton.joints, source="arrays")

    def _read(self, given: Any, which: str) -> PoseData:
        if isinstance(given, (str, Path)):
            chosen = replace(self.settings.data, simulate=0)
            chosen = replace(chosen, **_place(given, vars(chosen), "test"))
            poses = load_split(replace(self.settings, data=chosen), "test", self.skeleton)
        else:
            poses = self._in_joints(given)
        return poses if which == "predict" else clean(poses, self.skeleton)[0]

    def _split(self, train: PoseData, share: float) -> np.ndarray:
        clip = train.clips()
        count, clips = max(1, round(share * len(train))), int(clip.max()) + 1
        if clips < 2:  # one film: its end
            return np.arange(len(train)) >= len(train) - count
        order = np.random.default_rng(self.settings.seed).permutation(clips)
        ends = np.cumsum(np.bincount(clip)[order])
        most = min(clips - 1, int(np.searchsorted(ends, count)) + 1)
        return np.isin(clip, order[:most])


# Masks.


class MaskDataModule(_Data[MaskData, LoadedMasks]):
    """Masks of objects of one kind to train, validate, test and predict on; `uplift.ShapeModule` trains on them.

    Args:
        train: a folder or file of masks in any format, a number of masks to simulate, or a
            `uplift.data.masks.MaskData`.
        shape: the settings ``shape.NAME`` that cameras of simulated masks follow, by name.
        val: share of the training masks to hold out for validation, by shape where shapes are known; or files or
            data; 0 or None for no validation.
        test: files or data to test on, with true shapes.
        predict: files or data to lift; those of ``test`` by default.
        batch_size: masks that priors are given in a step.
        labelled: share of the shapes that may be learned from, or the settings ``data.labelled`` by name.
        seed: of the splits and the simulator.
        options: settings ``data.NAME`` by name: ``side``, ``border``, ``pieces``, ``category``, ``most``, ``family``, ...

    Raises:
        UserError: a file that is missing or wrong, an invalid option, no masks left; files are read in `setup`.
    """

    @consents
    def __init__(
        self,
        train: Any = None,
        *,
        shape: Mapping[str, Any] | None = None,
        val: Any = 0.1,
        test: Any = None,
        predict: Any = None,
        batch_size: Any = 512,
        labelled: float | Mapping[str, Any] | None = None,
        seed: int = 0,
        **options: Any,
    ):
        options, train = {**options, **_labelled(labelled)}, _plain_number(train)
        settings = _data_settings(train, "masks", options, shape=shape, seed=seed)
        super().__init__(settings, {"train": train, "test": test, "predict": predict}, val, batch_size)
        self._sets: dict[tuple, MaskSet] = {}

    @classmethod
    def of(cls, loaded: LoadedMasks, settings: Settings) -> MaskDataModule:
        """Return the data of a fit that were loaded already; epochs never end."""
        data = cls(loaded, val=share_or_files(settings.data.val))
        data.settings, data.endless = settings, True
        return data

    @property
    def masks(self) -> MaskData:
        """The masks that are trained on: the labelled ones alone where ``data.labelled.only`` is set."""
        train = self.train_samples
        only = self.settings.data.labelled.only and train.labelled is not None
        return train.select(train.labelled) if only else train

    def mask_set(self, settings: ShapeSettings, detail: int) -> MaskSet:
        """Return the training masks as tensors, cropped as ``settings`` say, and known shapes at ``detail`` voxels."""
        key = (settings.crop, detail)
        if key not in self._sets:
            self._sets[key] = to_mask_set(self.masks, settings, detail)
        return self._sets[key]

    def _load(self) -> LoadedMasks:
        train = self.given["train"]
        if not isinstance(train, MaskData):
            return load_masks(self.settings)

        def load(settings: Settings, which: str) -> MaskData:
            named = settings.data.train if which == "train" else settings.data.test
            return load_mask_split(settings, which) if named else train

        return load_masks(self.settings, load)

    def _for_training(self, loaded: LoadedMasks) -> LoadedMasks:
        return loaded.for_training()

    def _read(self, given: Any, which: str) -> MaskData:
        if isinstance(given, MaskData):
            return given
        chosen = replace(self.settings.data, simulate=0)
        chosen = replace(chosen, **_place(given, vars(chosen), "test"))
        return load_mask_split(replace(self.settings, data=chosen), "test")

    def _split(self, train: MaskData, share: float) -> np.ndarray:
        shape = np.arange(len(train)) if train.truth is None else train.truth.shape
        names = np.unique(shape)
        count = min(len(names) - 1, max(1, round(share * len(names))))
        return np.isin(shape, np.random.default_rng(self.settings.seed).permutation(names)[:count])
