"""The npz writer and the choice of writers: round trips, no pickle, whole or not at all."""

from __future__ import annotations

import errno
import zipfile
from dataclasses import replace
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from writers_samples import ENDINGS, figure, needed, prediction

from uplift.config.files import replacing
from uplift.data.formats.npz import read_npz, write_keypoints
from uplift.errors import UserError
from uplift.export import WRITERS, write
from uplift.geometry.gravity import gravity_at
from uplift.models.prediction import Prediction


@pytest.fixture
def sample() -> Prediction:
    return prediction(frames=7, individuals=2, tilt=True, uncertainty=True, truth=True)


def test_npz_gives_back_what_was_written(sample: Prediction, tmp_path: Path) -> None:
    write(sample, tmp_path / "poses.npz")
    with np.load(tmp_path / "poses.npz", allow_pickle=False) as file:
        found = {key: file[key] for key in file.files}
    for name in ("keypoints", "confidence", "pose", "level_pose", "tilt_deg", "uncertainty"):
        np.testing.assert_array_equal(found[name], np.float32(getattr(sample, name)))
    assert tuple(found["joint_names"]) == sample.joint_names
    assert found["unit"] == "mm" and found["fps"] == 30 and tuple(found["image_size"]) == (640, 480)
    assert set(sample.identity) <= set(found)
    for name, values in sample.identity.items():
        assert found[name].tolist() == values.tolist()
    named = {(sample.joint_names[a], sample.joint_names[b]) for a, b in found["bones"]}
    assert named == set(sample.skeleton.bones)
    assert "truth" not in found


def test_npz_gives_back_hypotheses_and_gravity_which_reads_as_truth(sample: Prediction, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    sample = replace(
        sample,
        hypotheses=np.stack([sample.pose, -sample.pose, 2 * sample.pose], 1),
        weights=random.dirichlet([3, 2, 1], len(sample)),
        tilt_deg=np.full(len(sample), 20.0),
        gravity=gravity_at(np.full(len(sample), 20.0), np.full(len(sample), -12.0)),
    )
    write(sample, tmp_path / "poses.npz")
    with np.load(tmp_path / "poses.npz", allow_pickle=False) as file:
        for name in ("hypotheses", "weights", "gravity", "roll_deg"):
            np.testing.assert_array_equal(file[name], np.float32(getattr(sample, name)))
    assert sample.roll_deg is not None and sample.gravity is not None
    np.testing.assert_allclose(sample.roll_deg, -12)
    back = read_npz(tmp_path / "poses.npz")
    assert back.tilt_deg is not None and back.gravity is not None
    np.testing.assert_allclose(back.gravity, sample.gravity, atol=1e-6)
    np.testing.assert_allclose(back.tilt_deg, 20)
    write_keypoints(back, tmp_path / "again.npz")
    np.testing.assert_array_equal(read_npz(tmp_path / "again.npz").gravity, back.gravity)


def test_npz_leaves_out_what_is_not_known(tmp_path: Path) -> None:
    write(prediction(frames=2, tilt=False), tmp_path / "poses.npz")
    with np.load(tmp_path / "poses.npz", allow_pickle=False) as file:
        assert {"tilt_deg", "uncertainty"}.isdisjoint(file.files)


def test_npz_of_object_identity_needs_no_pickle(tmp_path: Path) -> None:
    sample = prediction(frames=2)
    sample.identity["action"] = np.array(["walk", "sit"], dtype=object)
    write(sample, tmp_path / "poses.npz")
    assert np.load(tmp_path / "poses.npz", allow_pickle=False)["action"].tolist() == ["walk", "sit"]


def test_identity_cannot_replace_a_pose(tmp_path: Path) -> None:
    sample = prediction(frames=2)
    sample.identity["pose"] = np.zeros(2)
    with pytest.raises(ValueError, match="identity 'pose'"):
        write(sample, tmp_path / "poses.npz")
    assert not list(tmp_path.iterdir())


def test_same_prediction_gives_same_bytes(sample: Prediction, tmp_path: Path) -> None:
    write(sample, tmp_path / "a.npz")
    write(sample, tmp_path / "B.NPZ")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "B.NPZ").read_bytes()
    assert zipfile.ZipFile(tmp_path / "a.npz").testzip() is None


@pytest.mark.parametrize("name", ["poses.npx", "poses", "poses.csv.gz"])
def test_unknown_extension_names_the_valid_ones(sample: Prediction, tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError) as error:
        write(sample, tmp_path / name)
    assert all(extension in str(error.value) for extension in WRITERS["poses"])
    assert not list(tmp_path.iterdir())


def test_near_extension_is_suggested(sample: Prediction, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"Did you mean '\.html'"):
        write(sample, tmp_path / "page.htm")


@pytest.mark.parametrize("extension", sorted(ENDINGS))
def test_missing_folder_and_folder_in_the_way(sample: Prediction, tmp_path: Path, extension: str) -> None:
    needed(extension)
    with pytest.raises(UserError, match="does not exist"):
        write(sample, tmp_path / "nowhere" / f"poses{extension}")
    (tmp_path / f"poses{extension}").mkdir()
    sample = sample.select(
        sample.identity["instance"] == sample.identity["instance"][0]
    )  # more bodies than a file holds go into several files
    with pytest.raises(UserError, match="not an ordinary file"):
        write(sample, tmp_path / f"poses{extension}")


@pytest.mark.parametrize("extension", sorted(ENDINGS))
def test_full_disk_leaves_the_old_file(
    sample: Prediction, tmp_path: Path, extension: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / f"poses{needed(extension)}"
    target.write_bytes(b"what was there")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("uplift.config.files.os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write(sample, target)
    assert [path.name for path in tmp_path.iterdir()] == [target.name]
    assert target.read_bytes() == b"what was there"


def test_interrupted_file_never_appears(tmp_path: Path) -> None:
    def interrupted() -> None:
        with replacing(tmp_path / "file") as handle:
            handle.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(tmp_path.iterdir())


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with replacing(tmp_path / "link") as handle:
        handle.write(b"whole")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "file").read_bytes() == b"whole"


@pytest.mark.parametrize(
    "change",
    [
        {"confidence": np.ones((3, 2))},
        {"unit": "cm"},
        {"tilt_deg": np.ones(4)},
        {"identity": {"frame": np.ones(9)}},
        {"weights": np.ones((3, 5))},
        {"hypotheses": np.ones((3, 5, 7, 3)), "weights": np.ones((3, 4))},
    ],
)
def test_prediction_refuses_what_does_not_fit(change: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    good = prediction(frames=3)
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # what a user runs has no checks of annotations
    with pytest.raises(ValueError, match="prediction"):
        Prediction(**{**vars(good), **change})


def test_bones_are_matched_by_name() -> None:
    sample = prediction(frames=1)
    order = list(reversed(range(len(sample.joint_names))))
    turned = Prediction(**{**vars(sample), "joint_names": tuple(sample.joint_names[k] for k in order)})
    assert {(turned.joint_names[a], turned.joint_names[b]) for a, b in turned.bone_indices} == set(figure().bones)
