"""3D files of DeepLabCut, Anipose and sleap-anipose, read back by their own rules and by movement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
from writers_samples import pair, places_of, prediction

from uplift.data.formats import read
from uplift.errors import UserError
from uplift.export import write
from uplift.models.prediction import Prediction

ENDINGS = (".dlc.csv", ".dlc.h5", ".anipose.csv", ".sleap.h5")


def tracks(sample: Prediction, *people: str) -> np.ndarray:
    """Return where a pair is (frames people joints 3), from frame 100 on."""
    return np.array([[places_of(sample, who, frame) for who in people] for frame in range(100, 120)])


@pytest.mark.parametrize("ending", [".dlc.csv", ".dlc.h5"])
def test_deeplabcuts_table_of_two(ending: str, tmp_path: Path) -> None:
    if ending == ".dlc.h5":
        pytest.importorskip("tables")
    sample, path = pair(), tmp_path / f"walk{ending}"
    assert list(write(sample, path)) == [path]
    found = pandas.read_hdf(path) if ending == ".dlc.h5" else pandas.read_csv(path, header=[0, 1, 2, 3], index_col=0)
    assert isinstance(found, pandas.DataFrame)
    assert found.columns.names == ["scorer", "individuals", "bodyparts", "coords"]
    assert found.index.tolist() == list(range(100, 120))
    np.testing.assert_allclose(
        found.to_numpy().reshape(20, 2, 7, 3), tracks(sample, "Anna", "Ben"), rtol=2e-6, atol=1e-3
    )
    np.testing.assert_allclose(found["uplift", "Ben", "neck", "y"], tracks(sample, "Ben")[:, 0, 1, 1], rtol=2e-6)


def test_deeplabcuts_table_of_one_has_no_individuals(tmp_path: Path) -> None:
    remark = write(replace(prediction(3), unit="px"), tmp_path / "a.dlc.csv")[tmp_path / "a.dlc.csv"]
    assert "lengths are in px from the root joint, axes camera" in remark
    found = pandas.read_csv(tmp_path / "a.dlc.csv", header=[0, 1, 2], index_col=0)
    assert found.columns.names == ["scorer", "bodyparts", "coords"]
    np.testing.assert_allclose(found.to_numpy().reshape(3, 7, 3), prediction(3).pose, rtol=1e-6, atol=1e-3)


def test_anipose_has_a_file_for_each_in_one_time(tmp_path: Path) -> None:
    sample = pair()
    files = list(write(sample, tmp_path / "walk.anipose.csv"))
    assert [file.name for file in files] == ["walk_walk-Anna.anipose.csv", "walk_walk-Ben.anipose.csv"]
    for who, file in zip(("Anna", "Ben"), files, strict=True):
        found = pandas.read_csv(file)
        assert found["fnum"].tolist() == list(range(100, 120))
        names = [f"{joint}_{axis}" for joint in sample.joint_names for axis in "xyz"]
        expected = tracks(sample, who).reshape(20, 21)
        np.testing.assert_allclose(found[names], expected, rtol=2e-6, atol=1e-3)
        assert found["neck_error"].isna().all() and set(found["neck_ncams"]) == {0, 1}
        np.testing.assert_array_equal(found["neck_score"] > 0, np.isfinite(expected[:, 3]))
        turn = found[[f"M_{row}{column}" for row in range(3) for column in range(3)]].to_numpy()
        assert (turn == np.eye(3).ravel()).all() and (found[["center_0", "center_1", "center_2"]] == 0).to_numpy().all()


def test_sleap_anipose_has_frames_tracks_nodes(tmp_path: Path) -> None:
    sample = pair()
    write(sample, tmp_path / "walk.sleap.h5")
    with h5py.File(tmp_path / "walk.sleap.h5") as file:
        np.testing.assert_allclose(file["tracks"][:], tracks(sample, "Anna", "Ben"), rtol=1e-6)
        assert file["frames"][:].tolist() == [100, 120]
        assert file["node_names"].asstr()[:].tolist() == list(sample.joint_names)
        assert file["track_names"].asstr()[:].tolist() == ["Anna", "Ben"]


@pytest.mark.parametrize(("ending", "software"), [(".dlc.csv", "DeepLabCut"), (".dlc.h5", "DeepLabCut"), (".anipose.csv", "Anipose")])  # fmt: skip
def test_movement_opens_them(ending: str, software: str, tmp_path: Path) -> None:
    load_dataset = pytest.importorskip("movement.io").load_dataset
    sample = pair()
    file = list(write(sample, tmp_path / f"walk{ending}"))[-1]
    found = load_dataset(file, source_software=software, fps=25).isel(individuals=-1)
    for joint, name in enumerate(sample.joint_names):
        expected = tracks(sample, "Ben")[:, 0, joint]
        np.testing.assert_allclose(found.position.sel(keypoints=name), expected, rtol=2e-6, atol=1e-3)


@pytest.mark.parametrize("ending", ENDINGS)
def test_they_are_not_taken_for_keypoints(ending: str, tmp_path: Path) -> None:
    file = next(iter(write(pair(), tmp_path / f"walk{ending}")))
    with pytest.raises(UserError, match="3D p"):
        read(file)


def test_a_plain_h5_is_asked_for_its_kind(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"more than one kind of '.h5'. Name it walk.dlc.h5 or walk.sleap.h5"):
        write(pair(), tmp_path / "walk.h5")
    with pytest.raises(UserError, match="2 rows are frame 5"):
        write(prediction(2, identity={"frame": np.array([5, 5])}), tmp_path / "walk.dlc.csv")
