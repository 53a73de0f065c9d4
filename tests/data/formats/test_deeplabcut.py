"""DeepLabCut's and Lightning Pose's tables come back as pandas has them, in csv and HDF5, and run nothing."""

from __future__ import annotations

import pickle
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from tracker_files_tables import damaged, deeplabcut_frame, tracked

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData
from uplift.errors import UserError

PARTS = ("nose", "left ear", "tail")
THREE = ["snout", "leftear", "rightear", "tailbase"]
FIVE = ["bodypart1", "bodypart2", "bodypart3", "corner1", "corner2"]

REAL = [  # file, joints, rows, (instance or None, frame or image, joint, x, y, confidence)
    ("deeplabcut/DLC_sample_poses.csv", ["head", "stinger"], [
        (None, 0, "head", 1086.238, 421.5013, 0.05305099), (None, 672, "stinger", 206.4777, 105.515, 0.9156575)]),
    ("deeplabcut/DLC_sample_poses.h5", ["head", "stinger"], [
        (None, 0, "head", 1086.238, 421.5013, 0.05305099), (None, 672, "stinger", 206.4777, 105.515, 0.9156575)]),
    ("deeplabcut/CollectedData_Pranav.csv", THREE, [
        (None, "labeled-data/m4s1/img0000.png", "snout", 21.521, 265.428, 1),
        (None, "labeled-data/m4s1/img0071.png", "tailbase", 117.854, 176.269, 1)]),
    ("deeplabcut/CollectedData_Pranav.h5", THREE, [
        (None, "labeled-data/m4s1/img0000.png", "snout", 21.521, 265.428, 1),
        (None, "labeled-data/m4s1/img0071.png", "tailbase", 117.854, 176.269, 1)]),
    ("deeplabcut/m3v1mp4shortDLC_effnet_b0_multi_mouseApr12shuffle1_5_el.h5", FIVE, [
        ("single", 0, "corner1", 135.268, 139.63, 0.761), ("single", 19, "corner2", 595.459, 436.769, 0.348)]),
    ("deeplabcut/m3v1mp4shortDLC_effnet_b0_multi_mouseApr12shuffle1_5_el_filtered.csv", FIVE, [
        ("single", 0, "corner1", 135.268, 139.63, 0.761), ("single", 19, "corner2", 595.459, 436.769, 0.348)]),
    ("deeplabcut/CollectedData_dlc_team.csv", FIVE, [
        ("individual1", "labeled-data/m3v1mp4/img1029.png", "bodypart1", 50, 50, 1),
        ("single", "labeled-data/m3v1mp4/img1004.png", "corner2", 550, 550, 1)]),
    ("deeplabcut/CollectedData_dlc_team.h5", FIVE, [
        ("individual1", "labeled-data/m3v1mp4/img1029.png", "bodypart1", 50, 50, 1),
        ("single", "labeled-data/m3v1mp4/img1004.png", "corner2", 550, 550, 1)]),
    ("lightning_pose/CollectedData.csv", 17, [
        (None, "labeled-data/img01.png", "paw1LH_top", 77.25, 36.25, 1),
        (None, "labeled-data/img56.png", "obsLow_bot", 143.25, 384.75, 1)]),
    ("lightning_pose/3f859b5c-e73a-4044-b49e-34bb81e96715.left.rng=0.csv", ["paw_l", "paw_r"], [
        (None, 0, "paw_l", 37.33697, 71.90368, 0.9982467), (None, 620, "paw_r", 54.67484, 67.63524, 0.9998065)]),
    ("lightning_pose/180607_004.train_frames=75.rng=0.bot.csv", ["paw1LH", "paw2LF", "paw3RF", "paw4RH"], [
        (None, 0, "paw1LH", 82.89681, 78.68898, 0.9999894), (None, 310, "paw4RH", 200.1007, 180.9064, 0.9994085)]),
    ("nwb/m3v1mp4DLC_resnet50_openfieldAug20shuffle1_30000.h5", THREE, [
        (None, 0, "snout", 77.29781, 88.87558, 0.9954453), (None, 1444, "tailbase", 303.3607, 366.0633, 0.9989645)]),
]  # fmt: skip


def row_of(data: PoseData, instance: str | None, at: int | str) -> int:
    key = "frame" if isinstance(at, int) else "image"
    found = data.identity[key] == at
    if instance is not None:
        found &= data.identity["instance"] == instance
    (row,) = np.flatnonzero(found)
    return int(row)


@pytest.mark.parametrize(("name", "joints", "spots"), REAL, ids=[row[0].split("/")[-1][:40] for row in REAL])
def test_real_files_hold_what_is_known_of_them(benchmark_data, name, joints, spots):
    path = benchmark_data(f"trackers/{name}")
    data = read(path)
    assert KEYPOINT_FORMATS.guess(path).name == "deeplabcut"
    assert len(data.joint_names) == joints if isinstance(joints, int) else list(data.joint_names) == joints
    for instance, at, joint, x, y, confidence in spots:
        row, place = row_of(data, instance, at), data.joint_names.index(joint)
        np.testing.assert_allclose(data.keypoints[row, place], (x, y), rtol=1e-6)
        assert data.confidence[row, place] == pytest.approx(confidence, rel=1e-6)


@pytest.mark.parametrize("name", [row[0] for row in REAL], ids=[row[0].split("/")[-1][:40] for row in REAL])
def test_real_files_are_as_pandas_reads_them(benchmark_data, name):
    path = benchmark_data(f"trackers/{name}")
    if path.suffix == ".csv":
        rows = next(n for n, line in enumerate(path.read_text().splitlines()) if line.startswith("coords")) + 1
        table = pd.read_csv(path, header=list(range(rows)), index_col=0)
    else:
        table = pd.read_hdf(path)
    assert isinstance(table, pd.DataFrame)
    check_equal(read(path), table)


def check_equal(data: PoseData, table: pd.DataFrame) -> None:
    """Hold every number of ``data`` against pandas', and every visible row of pandas' against ``data``."""
    seen = 0
    several = table.columns.nlevels == 4
    for instance in table.columns.get_level_values(1).unique() if several else [None]:
        part = table.droplevel(0, axis=1) if instance is None else table.droplevel(0, axis=1)[instance]
        values = np.full((len(part), len(data.joint_names), 3), np.nan, np.float32)
        for place, joint in enumerate(data.joint_names):
            for at, what in enumerate(("x", "y", "likelihood")):
                if (joint, what) in part.columns:
                    values[:, place, at] = part[joint, what].to_numpy(np.float64)
        scored = "likelihood" in table.columns.get_level_values(-1)
        visible = np.isfinite(values[..., :2]).all(-1) & ((values[..., 2] > 0) if scored else True)
        index = np.array([int(n) if not isinstance(n, str) else -1 for n in part.index])
        rows = np.flatnonzero(visible.any(1))
        seen += len(rows)
        mine = np.ones(len(data), bool) if instance is None else data.identity["instance"] == instance
        np.testing.assert_array_equal(data.keypoints[mine], values[rows][..., :2])
        np.testing.assert_array_equal(data.confidence[mine] > 0, visible[rows])
        if scored:
            kept = data.confidence[mine] > 0
            np.testing.assert_array_equal(data.confidence[mine][kept], np.clip(values[rows][..., 2][kept], 0, 1))
        if "frame" in data.identity:
            np.testing.assert_array_equal(data.identity["frame"][mine], index[rows])
    assert seen == len(data)


def test_rows_without_likelihood_are_missing(benchmark_data):
    data = read(benchmark_data("trackers/deeplabcut/DLC_sample_poses.csv"))
    assert len(data) == 1076  # of 1085 rows: nine are 0, 0, 0
    assert (data.confidence > 0).any(1).all()


@pytest.mark.parametrize("individuals", [(), ("mouse1", "mouse2")])
@pytest.mark.parametrize(
    ("kind", "key"),
    [("csv", ""), *((k, key) for k in ("table", "fixed") for key in ("df_with_missing", "tracks", "my"))],
)
def test_what_pandas_writes_comes_back(tmp_path: Path, individuals, kind, key):
    count = max(len(individuals), 1)
    table = deeplabcut_frame(tracked(40, 3 * count), PARTS, individuals)
    path = tmp_path / f"walkDLC_resnet50.{'csv' if kind == 'csv' else 'h5'}"
    if kind == "csv":
        table.to_csv(path)
    else:
        table.to_hdf(path, key=key, format=kind, mode="w")
    data = read(path)
    check_equal(data, table)
    assert data.joint_names == PARTS
    assert set(data.identity["sequence"]) == {"walk"}
    assert data.clips().max() == count - 1
    assert data.follows().sum() > len(data) / 2  # the frames of one individual stand together


@pytest.mark.parametrize("columns", [1, 3])
@pytest.mark.parametrize("kind", ["csv", "h5"])
def test_labels_by_hand_have_images(tmp_path: Path, columns, kind):
    parts = [("labeled-data", f"video{n % 2}", f"img{n:04}.png") for n in range(6)]
    index = pd.MultiIndex.from_tuples(parts) if columns == 3 else ["\\".join(part) for part in parts]
    table = deeplabcut_frame(tracked(6, 3, missing=0.3)[..., :2], PARTS, index=index)
    path = tmp_path / f"CollectedData_me.{kind}"
    table.to_csv(path) if kind == "csv" else table.to_hdf(path, key="df_with_missing", mode="w")
    data = read(path)
    seen = np.isfinite(table.to_numpy()).any(1)
    assert data.identity["image"].tolist() == ["/".join(part) for part, one in zip(parts, seen, strict=True) if one]
    assert "frame" not in data.identity
    np.testing.assert_array_equal(data.keypoints.reshape(len(data), -1), table.to_numpy(np.float32)[seen])
    np.testing.assert_array_equal(data.confidence, np.isfinite(data.keypoints).all(-1))
    assert len(set(data.clips())) == len(data)


def test_columns_beside_the_keypoints_are_left_out_with_a_note(tmp_path: Path):
    table = deeplabcut_frame(tracked(9, 3), PARTS)
    for joint in PARTS:
        table[table.columns[0][0], joint, "x_ens_median"] = 1.0
        table[table.columns[0][0], joint, "y_posterior_var"] = 2.0
    table["set", "", ""] = "train"
    table.to_csv(tmp_path / "predictions.csv")
    data = read(tmp_path / "predictions.csv")
    check_equal(data, table[[c for c in table.columns if c[-1] in ("x", "y", "likelihood")]])
    assert "left out: x_ens_median, y_posterior_var, set" in data.notes


def test_a_name_of_the_index_is_no_row(tmp_path: Path):
    table = deeplabcut_frame(tracked(5, 3, missing=0), PARTS)
    table.index.name = "frame"
    table.to_csv(tmp_path / "a.csv")
    check_equal(read(tmp_path / "a.csv"), table)


def test_headers_of_many_individuals_are_read_beyond_the_first_look(tmp_path: Path):
    individuals = [f"individual_with_a_rather_long_name_{n}" for n in range(250)]
    table = deeplabcut_frame(tracked(3, 750), PARTS, individuals)
    table.to_csv(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().index("coords") > 70_000
    check_equal(read(tmp_path / "a.csv"), table)


def wrong(tmp_path: Path, text: str) -> str:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        read(path, ReadOptions(format="deeplabcut"))
    assert str(path) in str(caught.value)
    return str(caught.value)


HEAD = "scorer,s,s,s\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n"


def test_wrong_tables_are_told(tmp_path: Path):
    assert "line 5: 3 cells, expected 4" in wrong(tmp_path, HEAD + "0,1,2,1\n1,2,3")
    assert "line 5: 5 cells, expected 4" in wrong(tmp_path, HEAD + "0,1,2,1\n1,2,3,1,4\n")
    assert "line 5: 'abc' in the column 's nose y' is not a number" in wrong(tmp_path, HEAD + "0,1,2,1\n1,2,abc,1\n")
    assert "line 6: frame 0 is there twice" in wrong(tmp_path, HEAD + "0,1,2,1\n1,2,3,1\n0,1,2,1\n")
    assert "x, y and z: 3D" in wrong(tmp_path, HEAD.replace("likelihood", "z") + "0,1,2,1\n")
    assert "confidence goes from 0 to 870" in wrong(tmp_path, HEAD + "0,1,2,870\n")
    assert "-1 is not a frame number" in wrong(tmp_path, HEAD + "0,1,2,1\n-1,1,2,1\n")
    assert "0.5 is not a frame number" in wrong(tmp_path, HEAD + "0.5,1,2,1\n")
    assert "twice" in wrong(tmp_path, HEAD.replace("likelihood", "x") + "0,1,2,1\n")
    assert "columns of 2 scorers" in wrong(tmp_path, HEAD.replace("s,s,s", "s,s,t") + "0,1,2,1\n")
    assert "no visible joint" in wrong(tmp_path, HEAD + "0,0,0,0\n1,,,\n")
    assert "expected pixels within an image" in wrong(tmp_path, HEAD + "0,1e300,2,1\n")
    assert "has x or y and not the other" in wrong(tmp_path, "scorer,s\nbodyparts,nose\ncoords,x\n0,1\n")
    assert "expected the header rows of DeepLabCut" in wrong(tmp_path, "a,b\n1,2\n")
    wrong(tmp_path, HEAD)


class Payload:
    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_pickles_in_an_hdf5_file_never_run(tmp_path: Path):
    marker, path = tmp_path / "marker", tmp_path / "a.h5"
    table = deeplabcut_frame(tracked(5, 3), PARTS)
    for kind, where, name in (("table", "df_with_missing", "non_index_axes"),
                              ("table", "df_with_missing/table", "values_block_0_kind"),
                              ("fixed", "df_with_missing", "encoding")):  # fmt: skip
        table.to_hdf(path, key="df_with_missing", format=kind, mode="w")
        with h5py.File(path, "r+") as file:
            file[where].attrs[name] = np.bytes_(pickle.dumps(Payload(marker), 0))
        try:
            read(path)
        except UserError as error:
            assert str(path) in str(error)
        assert not marker.exists()
    pd.read_hdf(path) if kind == "fixed" else None
    assert marker.exists()  # which is why pandas does not read these files here


@pytest.mark.filterwarnings("ignore::pandas.errors.PerformanceWarning")
def test_objects_are_refused(tmp_path: Path):
    table = deeplabcut_frame(tracked(5, 3), PARTS).astype(object)
    table.to_hdf(tmp_path / "a.h5", key="df", format="fixed")
    with pytest.raises(UserError, match="pickled Python objects"):
        read(tmp_path / "a.h5")


def test_an_hdf5_file_gives_only_what_is_in_it(tmp_path: Path):
    path = tmp_path / "a.h5"
    table = deeplabcut_frame(tracked(5, 3), PARTS)
    table.to_hdf(tmp_path / "other.h5", key="df", format="fixed")
    table.to_hdf(path, key="df", format="fixed", mode="w")
    with h5py.File(path, "r+") as file:
        del file["df/block0_values"]
        file["df/block0_values"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/df/block0_values")
    with pytest.raises(UserError, match="not an array in the file itself"):
        read(path)
    with h5py.File(path, "r+") as file:
        del file["df/block0_values"]
        file["df"].create_dataset("block0_values", (10**12, 9), chunks=(100, 9), dtype="f8").attrs["transposed"] = 1
    with pytest.raises(UserError, match="more than (the file can hold|half of this)"):
        read(path)
    table.to_hdf(path, key="a", mode="w")
    table.to_hdf(path, key="b")
    with pytest.raises(UserError, match="2 tables \\(a, b\\), expected one"):
        read(path)


@pytest.mark.parametrize("kind", ["csv", "table", "fixed"])
def test_a_damaged_file_is_refused_or_read_in_full(tmp_path: Path, kind):
    table = deeplabcut_frame(tracked(12, 6), PARTS, ("a", "b"))
    path = tmp_path / f"a.{'csv' if kind == 'csv' else 'h5'}"
    table.to_csv(path) if kind == "csv" else table.to_hdf(path, key="tracks", format=kind, mode="w")
    for content in damaged(path.read_bytes(), 1, 25):
        path.write_bytes(content)
        try:
            data = read(path)
        except UserError as error:
            assert "a.csv" in str(error) or "a.h5" in str(error)
        else:
            assert np.isfinite(data.keypoints[data.confidence > 0]).all()
