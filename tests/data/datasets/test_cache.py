"""What is kept of a data set's files is a cache: damage to it costs time, never the data nor a fit."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uplift.data.datasets import DataSet, WantedFile, read_cached
from uplift.data.datasets.base import cached_facts
from uplift.data.poses import PoseData

_FRAMES = 50


class Told(DataSet):
    """A set of one file, which counts how often it is read."""

    reads = 0

    def files(self, split: str) -> list[WantedFile]:
        return [WantedFile(self.folder / "all.txt", "all")]

    def read(self, split: str) -> PoseData:
        type(self).reads += 1
        rng = np.random.default_rng(3)
        return PoseData(
            keypoints=rng.normal(size=(_FRAMES, 4, 2)).astype(np.float32),
            confidence=np.ones((_FRAMES, 4), np.float32),
            joint_names=("a", "b", "c", "d"),
            unit="mm",
            fps=10.0,
            source="told",
            pose=rng.normal(size=(_FRAMES, 4, 3)).astype(np.float32),
            identity={"subject": np.repeat(["S1", "S2"], _FRAMES // 2), "frame": np.arange(_FRAMES)},
        )


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Told:
    monkeypatch.setenv("UPLIFT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(Told, "reads", 0)
    (tmp_path / "all.txt").write_text("x")
    return Told(tmp_path)


def place_of() -> Path:
    (place,) = (Path(os.environ["UPLIFT_CACHE"]) / "data").iterdir()
    return place


def truncated(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flipped(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[-5] ^= 1  # a number, and not the header
    file.write_bytes(content)


def emptied(file: Path) -> None:
    file.write_bytes(b"")


def folder_instead(file: Path) -> None:
    file.unlink()
    file.mkdir()


def gone(file: Path) -> None:
    file.unlink()


def file_instead_of_all(file: Path) -> None:
    shutil.rmtree(file.parent)
    file.parent.write_bytes(b"x")


def earlier_layout(file: Path) -> None:
    (file.parent / "facts.json").write_text('{"frames": 50, "joint_names": ["a"], "identity": []}')


@pytest.mark.parametrize(
    "damage", [truncated, flipped, emptied, folder_instead, gone, file_instead_of_all, earlier_layout]
)
@pytest.mark.parametrize("name", ["keypoints.npy", "identity_subject.npz", "facts.json"])
def test_a_damaged_cache_is_made_anew(damage: Callable[[Path], None], name: str, source: Told) -> None:
    whole = source.read("train")
    read_cached(source, "train")
    read_cached(source, "train")
    assert Told.reads == 2, "the second time it comes from the cache"
    assert cached_facts(source, "train") is not None
    damage(place_of() / name)
    for _ in range(2):
        found = read_cached(source, "train")
        assert np.array_equal(found.keypoints, whole.keypoints) and np.array_equal(found.pose, whole.pose)  # pyright: ignore
        assert found.identity["subject"].tolist() == whole.identity["subject"].tolist()
    assert Told.reads == 3, "it was read once more, and is kept again"


def test_a_cache_that_cannot_be_written_costs_time_alone(source: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    Path(os.environ["UPLIFT_CACHE"]).write_text("a file where the folder should be")
    assert len(read_cached(source, "train")) == len(read_cached(source, "train")) == _FRAMES
    assert Told.reads == 2 and cached_facts(source, "train") is None
