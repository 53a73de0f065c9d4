"""The CSV writer, read back by the csv module and by pandas."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from writers_samples import complete_prediction, prediction

from uplift.errors import UserError
from uplift.export.scene import in_axes
from uplift.export.tables import write_csv
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

AWKWARD = st.lists(st.text(st.sampled_from("ab,;\"\t\r\n\x1c\u2028 _é中'=%nan"), min_size=1), min_size=2, unique=True)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, strict=True))


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


@pytest.fixture
def sample() -> Prediction:
    return complete_prediction(frames=6)


def test_every_number_comes_back(sample: Prediction, tmp_path: Path) -> None:
    write_csv(sample, tmp_path / "poses.csv")
    rows = read(tmp_path / "poses.csv")
    assert len(rows) == len(sample)
    for joint, name in enumerate(sample.joint_names):
        found = np.stack([column(rows, f"{name}_{axis}") for axis in "xyz"], -1)
        np.testing.assert_allclose(found, sample.points[:, joint], rtol=5e-7, atol=1e-12)
        pixels = np.stack([column(rows, f"{name}_{axis}_px") for axis in "uv"], -1)
        np.testing.assert_allclose(pixels, sample.keypoints[:, joint], rtol=5e-6)
        assert sample.uncertainty is not None and sample.filled is not None
        np.testing.assert_allclose(column(rows, f"{name}_uncertainty"), sample.uncertainty[:, joint])
        np.testing.assert_array_equal(column(rows, f"{name}_filled"), sample.filled[:, joint])
        np.testing.assert_array_equal(column(rows, f"{name}_confidence"), 1)
    assert [row["instance"] for row in rows] == sample.identity["instance"].tolist()
    assert [int(row["frame"]) for row in rows] == sample.identity["frame"].tolist()
    assert {(row["unit"], row["axes"], row["origin"], row["fps"]) for row in rows} == {("mm", "camera", "camera", "30")}
    assert sample.tilt_deg is not None
    np.testing.assert_allclose(column(rows, "tilt_deg"), sample.tilt_deg, rtol=5e-6)


def test_pandas_reads_the_same(sample: Prediction, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    write_csv(in_axes(sample, "opensim"), tmp_path / "poses.csv")
    table = pandas.read_csv(tmp_path / "poses.csv")
    assert list(table.columns) == list(read(tmp_path / "poses.csv")[0])
    np.testing.assert_allclose(table["head_y"], in_axes(sample, "opensim").points[:, 2, 1], rtol=5e-7)
    assert set(table["axes"]) == {"opensim"}


def test_what_is_missing_is_an_empty_cell(tmp_path: Path) -> None:
    sample = prediction(frames=3)
    sample.pose[1, 2] = np.nan
    sample.pose[2, 2, 0] = np.inf
    sample.keypoints[0, 1], sample.confidence[0, 1] = 0, 0
    sample = replace(
        sample, fps=np.nan, identity={"action": np.array(["", "a", "b"]), "frame": np.array([1.0, np.nan, 3])}
    )
    write_csv(sample, tmp_path / "poses.csv")
    rows = read(tmp_path / "poses.csv")
    assert [rows[1][f"head_{axis}"] for axis in "xyz"] == ["", "", ""] and rows[2]["head_x"] == ""
    assert rows[0]["neck_u_px"] == rows[0]["neck_v_px"] == "" and rows[0]["neck_confidence"] == "0"
    assert [row["frame"] for row in rows] == ["1.0", "", "3.0"] and [row["action"] for row in rows] == ["", "a", "b"]
    assert {row["origin"] for row in rows} == {"root"}
    assert not {"neck_uncertainty", "neck_filled", "fps"} & set(rows[0])
    assert "nan" not in (tmp_path / "poses.csv").read_text() and "inf" not in (tmp_path / "poses.csv").read_text()


@given(names=AWKWARD, label=st.text(st.sampled_from('a,"\r\n é中nan')))
def test_no_name_breaks_the_table(names: list[str], label: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("csv")
    skeleton = Skeleton("odd", tuple(names), names[0], ())
    pose = np.arange(2 * len(names) * 3, dtype=float).reshape(2, len(names), 3)
    ones = np.ones(pose.shape[:2])
    identity = {"action": np.array([label, "b"], dtype=object)}
    odd = Prediction(pose, pose, "px", pose[..., :2], ones, tuple(names), skeleton, identity=identity)
    write_csv(odd, folder / "poses.csv")
    rows = read(folder / "poses.csv")
    assert len(rows) == 2 and rows[0]["action"] == label
    for joint, name in enumerate(names):
        np.testing.assert_array_equal(column(rows, f"{name}_z"), pose[:, joint, 2])


def test_same_poses_give_the_same_bytes_and_empty_ones_a_header(sample: Prediction, tmp_path: Path) -> None:
    write_csv(sample, tmp_path / "a.csv")
    write_csv(sample, tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    write_csv(sample.select(np.zeros(len(sample), bool)), tmp_path / "none.csv")
    text = (tmp_path / "a.csv").read_text().splitlines()
    assert (tmp_path / "none.csv").read_text().splitlines() == text[:1] and len(text) == 13


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    sample = replace(prediction(frames=2), identity={"unit": np.zeros(2)})
    with pytest.raises(ValueError, match="called unit"):
        write_csv(sample, tmp_path / "poses.csv")
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_named(sample: Prediction, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist"):
        write_csv(sample, tmp_path / "nowhere" / "poses.csv")
