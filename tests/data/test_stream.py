"""Training on shards larger than the buffer: what is resident depends on the step alone, and everything comes round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import lightning as L
import numpy as np
import pytest
import torch

import uplift
from uplift.config.loading import settings_from
from uplift.config.settings import LifterSettings
from uplift.data.formats.npz import write_keypoints
from uplift.data.formats.shards import write_shards
from uplift.data.load import load_data
from uplift.data.module import KeypointData
from uplift.data.poses import PoseData
from uplift.data.stream import Streamed, load_training
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

H36M = load_skeleton("h36m17")
FRAMES = 6000
LIFTER = LifterSettings()


@pytest.fixture(scope="module")
def people() -> PoseData:
    return simulate(H36M, FRAMES, seed=5, missing=0.05)


@pytest.fixture(scope="module")
def folder(people: PoseData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return shards of 1,500 frames, and the same frames as people.npz in them."""
    folder = tmp_path_factory.mktemp("people")
    write_shards([people], folder, frames=1500)
    write_keypoints(people, folder / "people.npz")
    return folder


def data_of(folder: Path, buffer: int = 1300, **options) -> KeypointData:
    return KeypointData(str(folder), H36M, val=options.pop("val", 0), buffer=buffer, **options)


def rows_of(frames) -> set[bytes]:
    return {row.numpy().tobytes() for row in frames.keypoints}


def test_what_fits_is_what_any_file_gives(folder: Path):
    one, other = data_of(folder, FRAMES), data_of(folder / "people.npz")
    assert not isinstance(one._load_once(), Streamed)
    for name in ("keypoints", "confidence", "scale", "distance", "clip", "follows", "body", "rotation"):
        torch.testing.assert_close(
            getattr(one.frames(LIFTER), name), getattr(other.frames(LIFTER), name), rtol=0, atol=0
        )


def test_resident_frames_depend_on_the_step_alone_and_all_come_round(folder: Path):
    data = data_of(folder)
    every = rows_of(data_of(folder / "people.npz").frames(LIFTER))
    first = rows_of(data.frames(LIFTER))  # what priors are prepared with
    assert len(data.frames(LIFTER)) < 1400 < FRAMES == data.sample_count
    resident = data.resident(LIFTER, torch.device("cpu"), batch=16, step=0)
    assert resident is not None
    assert rows_of(resident.frames) == first
    assert first < every
    size, seen, step = len(resident.frames), set(first), 0
    while len(seen) < FRAMES and step < 4000:
        step += resident.every
        resident.advance(step)
        seen |= rows_of(resident.frames)
        if step == 5 * resident.every:
            later = data.resident(LIFTER, torch.device("cpu"), batch=16, step=step + resident.every - 1)
            assert later is not None
            torch.testing.assert_close(later.frames.keypoints, resident.frames.keypoints, rtol=0, atol=0)
            torch.testing.assert_close(later.frames.scale, resident.frames.scale, rtol=0, atol=0)
            later.close()
    resident.close()
    assert seen == every
    assert step < 1.2 * FRAMES / 16  # each frame once while each was drawn once
    assert len(resident.frames) == size
    assert resident.frames.draw(torch.arange(4)).row is None


def test_blocks_without_a_body_are_passed_over(people: PoseData, tmp_path: Path):
    empty = np.arange(FRAMES) % 600 < 300
    confidence = people.confidence * ~empty[:, None]
    write_shards([replace(people, confidence=confidence)], tmp_path, frames=1500)
    resident = data_of(tmp_path).resident(LIFTER, torch.device("cpu"), batch=64, step=300)
    assert resident is not None
    assert (resident.frames.confidence > 0).any(1).all()
    resident.close()


CHOICES = (
    {"select": {"subjects": ["S1", "S2", "S3", "S20", "S30"]}},
    {"select": {"fraction": 0.5}, "hold_out": {"subjects": ["S4"]}},
    {"hold_out": {"fraction": 0.3}},
    {"labelled": {"fraction": 0.1}},
    {"labelled": {"subjects": ["S2"], "only": True}},
)


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_choices_are_those_of_an_ordinary_file(folder: Path, choice: dict):
    """The same frames train, test and are labelled, however many of them are in memory."""

    def found(train: Path, load):
        settings = settings_from({"data": {"train": str(train), "buffer": 1300, **choice}, "seed": 3}, "default")
        return load(settings, H36M)

    whole, streamed = found(folder / "people.npz", load_data), found(folder, load_training)
    if whole.test is not None:
        np.testing.assert_array_equal(whole.test.keypoints, streamed.test.keypoints)
    labelled = whole.train.labelled
    if not isinstance(streamed, Streamed):
        np.testing.assert_array_equal(whole.train.keypoints, streamed.train.keypoints)
        np.testing.assert_array_equal(labelled, streamed.train.labelled) if labelled is not None else None
        return
    parts = [streamed.stream.read(number) for number in range(len(streamed.stream.blocks))]
    unlabelled = whole.train if labelled is None else whole.train.select(~labelled)
    np.testing.assert_array_equal(np.concatenate([part.confidence for part in parts]), unlabelled.confidence)
    assert len(unlabelled) == streamed.stream.frames
    if labelled is not None:
        np.testing.assert_array_equal(streamed.more.keypoints, whole.train.select(labelled).keypoints)
        assert streamed.more.labelled.all()


def test_too_many_labels_are_one_line(folder: Path):
    with pytest.raises(
        UserError, match=r"6,000 labelled frames, which stay in memory, are more than data\.buffer=1,300"
    ):
        data_of(folder, labelled=1.0).frames(LIFTER)


def test_a_share_is_held_out_for_validation(folder: Path):
    data = data_of(folder, val=0.1)
    held, kept = rows_of_poses(data.val_samples), set()
    stream = data._load_once().stream
    for number in range(len(stream.blocks)):
        kept |= rows_of_poses(stream.read(number))
    assert not held & kept
    assert 0.05 < len(held) / FRAMES < 0.15
    assert len(held) + stream.frames == FRAMES


def rows_of_poses(data) -> set[bytes]:
    return {row.tobytes() for row in data.confidence * 1000 + data.keypoints[..., 0]}


class SaveAt(L.Callback):
    """Saves the step after which a training might have been killed."""

    def __init__(self, step: int, path: Path):
        self.step, self.path = step, path

    def on_train_batch_end(self, trainer: L.Trainer, *rest: object) -> None:
        if trainer.global_step == self.step:
            trainer.save_checkpoint(self.path)


def trained(data: KeypointData, callbacks: list[L.Callback], resume: Path | None = None) -> dict:
    lifter = {"options": {"units": 16}}
    module = uplift.LiftingModule(H36M, priors={"bones": 1.0, "consistency": 1.0}, lifter=lifter, seed=1)
    data.batch_size = 32
    trainer = L.Trainer(max_steps=10, accelerator="cpu", logger=False, enable_checkpointing=False, enable_progress_bar=False,
                        enable_model_summary=False, limit_val_batches=0, num_sanity_val_steps=0, callbacks=callbacks)  # fmt: skip
    trainer.fit(module, data, ckpt_path=resume)
    assert trainer.num_training_batches == -(-FRAMES // 32)
    assert module.resident is not None
    assert module.resident.replaced > 3
    return module.state_dict()


def test_a_training_that_stopped_goes_on_with_the_same_frames(folder: Path, tmp_path: Path):
    """In a Trainer of one's own, after steps in which blocks were replaced."""
    stopped = tmp_path / "stopped.ckpt"
    whole = trained(data_of(folder), [SaveAt(7, stopped)])
    rest = trained(data_of(folder), [], stopped)
    for name, value in whole.items():
        torch.testing.assert_close(rest[name], value, rtol=0, atol=0, msg=name)
