"""Tables of angles and gait: read back, laid beside what is measured, and refused where there is nothing to measure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from walks import FPS, HIP, SKELETON, TILT, walk
from writers_samples import prediction

from uplift.biomechanics.angles import joint_angles
from uplift.errors import UserError
from uplift.export import check_measure, open_stream, write, writer_for
from uplift.models.prediction import Prediction


def walker(frames: int = 100, **more: object) -> Prediction:
    """Return an exact walk, seen by a camera that looks down."""
    points = walk(frames).points
    pose = points - points[:, [HIP]]
    level = Rotation.from_euler("x", -TILT).apply(pose.reshape(-1, 3)).reshape(pose.shape)
    flat = np.zeros((frames, 17, 2)), np.ones((frames, 17))
    values = {"fps": FPS, "uncertainty": np.full((frames, 17), 20.0) * (np.arange(17) != HIP)}
    return Prediction(pose, level, "mm", *flat, SKELETON.joints, SKELETON, **{**values, **more})


def test_a_name_says_what_is_measured() -> None:
    measured = {
        name: writer_for(name).where.rpartition(":")[2]
        for name in ("angles.csv", "walk_angles.csv", "Walk.Angles.CSV", "gait.csv", "a.mot")
    }
    assert list(measured.values()) == ["write_angles_csv"] * 3 + ["write_gait_csv", "write_mot"]
    assert {
        writer_for(name).where.rpartition(":")[2] for name in ("poses.csv", "triangles.csv", "angles_of_view.csv")
    } == {"write_csv"}


def test_angles_come_back(tmp_path: Path) -> None:
    sample = walker(identity={"sequence": np.repeat(["a", "b"], 50), "frame": np.tile(np.arange(50) * 2 + 10, 2)})
    sample.pose[3] = sample.level_pose[3] = np.nan
    write(sample, tmp_path / "angles.csv")
    found, table = joint_angles(sample), pd.read_csv(tmp_path / "angles.csv")
    assert list(table.columns[:3]) == ["sequence", "frame", "time_s"]
    assert np.allclose(table["time_s"][:50], (np.arange(50) + 5) / FPS)  # every second number is a frame
    assert found.uncertainty is not None
    for ending, values in (("_deg", found.values), ("_uncertainty_deg", found.uncertainty)):
        read = table[[f"{name}{ending}" for name in found.names]].to_numpy()
        assert np.allclose(read, values, rtol=1e-5, atol=1e-4, equal_nan=True)
        assert np.isnan(read[3]).all()


def test_a_motion_file_is_one_that_opensim_reads(tmp_path: Path) -> None:
    sample = walker()
    sample.pose[7] = sample.level_pose[7] = np.nan
    remark = next(iter(write(sample, tmp_path / "walk.mot").values()))
    lines = (tmp_path / "walk.mot").read_text().splitlines()
    end = lines.index("endheader")
    facts = dict(line.split("=") for line in lines[1:end])
    rows = np.array([list(map(float, line.split("\t"))) for line in lines[end + 2 :]])
    names = lines[end + 1].split("\t")
    assert names[0] == "time" and facts == {
        "version": "1",
        "nRows": "99",
        "nColumns": str(len(names)),
        "inDegrees": "yes",
    }
    assert rows.shape == (99, len(names)) and np.isfinite(rows).all()
    assert np.allclose(rows[:, 0], np.delete(np.arange(100), 7) / FPS, atol=1e-6)
    knee = joint_angles(sample).values[:, joint_angles(sample).names.index("right_knee_flexion")]
    assert np.allclose(rows[:, names.index("right_knee_flexion")], np.delete(knee, 7), atol=1e-3)
    assert "right_shoulder_plane" not in names and "right_shoulder_plane" in remark  # its arms hang
    opensim = pytest.importorskip("opensim")
    assert opensim.Storage(str(tmp_path / "walk.mot")).getSize() == 99


def test_gait_has_strides_means_and_deviations(tmp_path: Path) -> None:
    remark = next(iter(write(walker(150), tmp_path / "gait.csv").values()))
    table = pd.read_csv(tmp_path / "gait.csv")
    strides = table[pd.to_numeric(table["stride"], errors="coerce").notna()]
    assert remark == "gait of a body" and len(strides) >= 6 and set(strides["foot"]) == {"rankle", "lankle"}
    mean = table[(table["foot"] == "all") & (table["stride"] == "mean")].iloc[0]
    assert mean["speed_m_per_s"] == pytest.approx(strides["speed_m_per_s"].mean(), rel=1e-4)
    assert (table["stride"] == "asymmetry_percent").sum() == 1
    write(replace(walker(150), unit="px"), tmp_path / "px_gait.csv")
    assert not {"step_length_mm", "speed_m_per_s"} & set(pd.read_csv(tmp_path / "px_gait.csv").columns)


def test_walks_that_come_one_after_another_are_the_table_of_both(tmp_path: Path) -> None:
    """What clips are called depends on all of them."""
    sample = walker(150)
    two = [replace(sample, identity=_of(sample, "walk", take)) for take in ("1", "2")]
    write(Prediction.concat(two), tmp_path / "whole_gait.csv")
    with open_stream(tmp_path / "parts_gait.csv") as stream:
        for part in two:
            stream.append(part)
    assert (tmp_path / "parts_gait.csv").read_bytes() == (tmp_path / "whole_gait.csv").read_bytes()
    table = pd.read_csv(tmp_path / "parts_gait.csv")
    assert set(table["clip"]) == {1, 2} and len(table) > 8 and stream.remark.startswith("gait of 2 bodies")


def _of(sample: Prediction, action: str, take: str) -> dict[str, np.ndarray]:
    names = {"action": np.full(len(sample), action), "sequence": np.full(len(sample), take)}
    return {**names, "frame": np.arange(len(sample))}


def test_a_body_that_stands_has_no_gait(tmp_path: Path) -> None:
    still = walker()
    still = replace(still, pose=still.pose[[0] * 100], level_pose=still.level_pose[[0] * 100])
    remark = next(iter(write(still, tmp_path / "gait.csv").values()))
    assert remark.startswith("no rows: no two feet that take turns") and len(pd.read_csv(tmp_path / "gait.csv")) == 0


@pytest.mark.parametrize(
    ("name", "sample", "message"),
    [
        ("angles.csv", prediction(frames=20), "'figure' names no joint angles"),
        ("gait.csv", prediction(frames=20), "'figure' has none: it names no contacts"),
        ("gait.csv", walker(fps=None), "gait needs the frame rate, which is not known. Give it: fps=30"),
        ("walk.mot", walker(fps=None), "MOT needs the frame rate, which is not known. Give it: fps=30"),
    ],
)
def test_what_cannot_be_measured_is_one_line(name: str, sample: Prediction, message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        write(sample, tmp_path / name)
    assert not (tmp_path / name).exists()


def test_angles_have_no_axes(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the same in all axes"):
        write(walker(), tmp_path / "angles.csv", axes="blender")
    check_measure("poses.csv", prediction(frames=2).skeleton)
    with pytest.raises(UserError, match="names no joint angles"):
        check_measure("angles.csv", prediction(frames=2).skeleton)
