"""Tables of views: what is written is read back, and says where masks are seen from."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from shape_samples import AZIMUTH, SCALE_PX, TILT, shapes

from uplift.data.views import KnownViews
from uplift.errors import UserError
from uplift.export import write


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    found = shapes(2, ["cow_001.png", "cow_002.png"])
    found.probability, found.second_probability = np.array([0.9, 1.0]), np.array([0.1, 0.0])
    found.second_view = np.stack([found.view[0] @ np.diag([-1.0, 1.0, -1.0]), np.full((3, 3), np.nan)])
    for name in ("views.csv", "views.json", "all.npz"):
        write(found, tmp_path / name)
    return tmp_path


def test_a_table_of_views(folder: Path) -> None:
    with (folder / "views.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["cow_001.png", "cow_002.png"]
    for row in rows:
        angles = [float(row[f"{name}_deg"]) for name in ("azimuth", "elevation", "roll")]
        assert angles == pytest.approx([np.degrees(AZIMUTH), np.degrees(TILT), 0], abs=1e-3)
        assert float(row["scale_px"]) == SCALE_PX
        assert float(row["silhouette_iou"]) > 0.9
        assert row["distance"] == "", "parallel rays"
    assert float(rows[0]["second_azimuth_deg"]) == pytest.approx(np.degrees(AZIMUTH) - 180, abs=1e-3)
    assert [row["second_probability"] for row in rows] == ["0.1", "0"]
    assert rows[1]["second_azimuth_deg"] == ""


def test_the_same_as_json_and_arrays(folder: Path) -> None:
    items = json.loads((folder / "views.json").read_text())["items"]
    assert items[0]["azimuth_deg"] == pytest.approx(np.degrees(AZIMUTH), abs=1e-3)
    assert items[1]["second_azimuth_deg"] is None
    np.testing.assert_allclose(items[0]["view"], shapes().view[0], atol=1e-5)
    with np.load(folder / "all.npz") as found:
        np.testing.assert_allclose(found["azimuth_deg"], np.degrees(AZIMUTH), rtol=1e-5)
        assert found["second_probability"].tolist() == pytest.approx([0.1, 0.0])


def test_a_written_table_is_read_as_known_views(folder: Path) -> None:
    names = ["other.png", "cow_002.png", "cow_001.png"]
    known = KnownViews.read(folder / "views.csv", names, all_angles=True)
    assert known.rows.tolist() == [2, 1]
    np.testing.assert_allclose(known.angles_deg[0], [np.degrees(AZIMUTH), np.degrees(TILT), 0], atol=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name,azimuth_deg\ncow_1.png,0\nhorse.png,90\n", "line 3: no training mask is called 'horse.png'"),
        ("name,azimuth_deg\ntwice,0\n", "2 training masks are called 'twice'"),
        ("name,azimuth\ncow_1.png,0\n", "has no column azimuth_deg, expected name, azimuth_deg"),
        ("name,azimuth_deg\ncow_1.png,\n", "line 2: azimuth_deg is missing, expected degrees"),
        ("name,azimuth_deg\ncow_1.png,left\n", "left"),
        ("name,azimuth_deg\n", "no row below the header"),
    ],
)
def test_tables_that_do_not_fit(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "known.csv").write_text(text)
    with pytest.raises(UserError, match=says):
        KnownViews.read(tmp_path / "known.csv", ["cow_1.png", "twice", "twice"], all_angles=False)


def test_tables_that_are_not_enough(tmp_path: Path) -> None:
    (tmp_path / "known.csv").write_text("name,azimuth_deg\ncow_1.png,0\n")
    with pytest.raises(UserError, match="has no column elevation_deg, .*: without gravity a view is all three angles"):
        KnownViews.read(tmp_path / "known.csv", ["cow_1.png"], all_angles=True)
    with pytest.raises(UserError, match="no such file"):
        KnownViews.read(tmp_path / "gone.csv", ["cow_1.png"], all_angles=False)
