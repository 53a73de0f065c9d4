"""Tables of DeepLabCut that pandas or a spreadsheet saved again hold the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tracker_files_tables import deeplabcut_frame, tracked

from uplift.data.formats import read
from uplift.data.formats.csv import write_table
from uplift.errors import UserError

PARTS = ("nose", "left ear", "tail")


@pytest.mark.parametrize("opened", [{}, {"index_col": 0}, {"header": [0, 1, 2]}, {"header": [0, 1, 2], "index_col": 0}])
@pytest.mark.parametrize("individuals", [(), ("mouse1", "mouse2")])
@pytest.mark.parametrize("index", [True, False])
def test_what_pandas_saves_again_is_the_same(tmp_path: Path, opened, individuals, index):
    if "index_col" in opened and not index:
        pytest.skip("the frame numbers are gone from such a file")
    if individuals and "header" in opened:
        opened = opened | {"header": [0, 1, 2, 3]}
    table = deeplabcut_frame(tracked(12, 3 * max(1, len(individuals)), missing=0), PARTS, individuals)
    (tmp_path / "first").mkdir()
    table.to_csv(tmp_path / "first" / "walk.csv")
    pd.read_csv(tmp_path / "first" / "walk.csv", **opened).to_csv(tmp_path / "walk.csv", index=index)
    found, before = read(tmp_path / "walk.csv"), read(tmp_path / "first" / "walk.csv")
    assert found.joint_names == PARTS
    np.testing.assert_array_equal(found.keypoints, before.keypoints)
    np.testing.assert_array_equal(found.confidence, before.confidence)
    np.testing.assert_array_equal(found.identity["frame"], before.identity["frame"])


def test_scorers_whose_names_end_in_numbers_stay_apart(tmp_path: Path):
    columns = [["s", "s", "s.1", "s.1"], ["nose", "nose", "tail", "tail"], ["x", "y", "x", "y"]]
    header = [[level, *cells] for level, cells in zip(("scorer", "bodyparts", "coords"), columns, strict=True)]
    write_table(tmp_path / "a.csv", header, [[0]], np.ones((1, 4), np.float32))
    with pytest.raises(UserError, match="columns of 2 scorers"):
        read(tmp_path / "a.csv")


def test_rows_without_their_empty_last_cells_are_as_pandas_reads_them(tmp_path: Path):
    table = deeplabcut_frame(tracked(12, 3, missing=0), PARTS)
    table.iloc[0, -3:] = table.iloc[4, -6:] = np.nan
    table.to_csv(tmp_path / "a.csv")
    lines = [line.rstrip(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    found, pandas = read(tmp_path / "a.csv"), pd.read_csv(tmp_path / "a.csv", names=range(10), skiprows=3)
    np.testing.assert_array_equal(found.keypoints[:, 2, 0], pandas[7].to_numpy(np.float32))
    assert (found.confidence == 0).sum() == 3
    assert "2 of 12 rows end early (first in line 4): their last cells are empty" in found.notes


def test_short_rows_of_other_tables(tmp_path: Path):
    (tmp_path / "long.csv").write_text("frame,joint,x,y,action\n0,nose,1,2,walk\n0,tail,3,4\n0,paw,5,6,walk\n")
    found = read(tmp_path / "long.csv")
    assert found.keypoints[0].tolist() == [[1, 2], [3, 4], [5, 6]]
    assert any("1 of 3 rows end early (first in line 3)" in note for note in found.notes)
