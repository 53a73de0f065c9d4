"""Of the files that DeepLabCut writes of a video those with its keypoints are read, once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from tracker_files_tables import deeplabcut_frame, tracked

from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.data.load import load_file
from uplift.skeleton import Skeleton

PARTS = ("nose", "left ear", "tail")
CHAIN = Skeleton("chain", PARTS, "nose", (("nose", "left ear"), ("left ear", "tail")))


def film(path: Path, rows: int = 12, seed: int = 0) -> pd.DataFrame:
    table = deeplabcut_frame(tracked(rows, 3, missing=0) + (seed, seed, 0), PARTS)
    table.to_csv(path)
    return table


VIDEO = "vid1DLC_resnet50_x"


def test_a_filtered_file_stands_for_the_unfiltered_one(tmp_path: Path):
    film(tmp_path / f"{VIDEO}.csv")
    filtered = film(tmp_path / f"{VIDEO}_filtered.csv", seed=5)
    film(tmp_path / "vid2DLC_resnet50_x.csv", rows=7)
    found = load_file(tmp_path / "*.csv", CHAIN)
    assert len(found) == 12 + 7
    np.testing.assert_array_equal(found.keypoints[:12, 0, 0], filtered.iloc[:, 0].to_numpy(np.float32))
    assert f"{VIDEO}.csv left out: the same as in {VIDEO}_filtered.csv" in found.notes


def test_by_products_do_not_stop_a_fit(tmp_path: Path):
    film(tmp_path / f"{VIDEO}.csv")
    film(tmp_path / f"{VIDEO}_el.csv")
    film(tmp_path / f"{VIDEO}.h5")
    (tmp_path / f"{VIDEO}_skeleton.csv").write_text(",nose_tail,nose_tail\n,length,likelihood\n0,3.5,0.9\n")
    (tmp_path / f"{VIDEO}_meta.pickle").write_bytes(b"\x80\x04.")
    (tmp_path / f"{VIDEO}_labeled.mp4").write_bytes(b"video")
    (tmp_path / "vid1.mp4").write_bytes(b"video")
    assert len(load_file(tmp_path / "*.csv", CHAIN)) == 12
    found = load_file(tmp_path / "*", CHAIN)
    assert len(found) == 12
    assert any(f"{VIDEO}_meta.pickle" in note and "no keypoints" in note for note in found.notes)


def test_files_that_nothing_stands_for_stay(tmp_path: Path):
    alone = [tmp_path / f"{VIDEO}_el.csv"]
    assert keypoint_files(alone) == (alone, [])
    others = [tmp_path / "a_filtered.csv", tmp_path / "b_el.h5", tmp_path / "c.json"]
    assert keypoint_files(others) == (others, [])
    apart = [tmp_path / "one" / "a.csv", tmp_path / "two" / "a_filtered.csv"]
    assert keypoint_files(apart) == (apart, [])
