"""OpenSim's model and inverse kinematics: people posed by known angles come back, in files that OpenSim opens."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from posed_people import angles_of, person, read_table
from writers_samples import prediction

from uplift.cli.outputs import check_outputs
from uplift.errors import UserError
from uplift.export import write
from uplift.export.human_model import human_model
from uplift.export.osim import beside_model
from uplift.skeleton import load_skeleton

DOCS = Path(__file__).resolve().parents[2] / "docs"
FRAMES = 12
PLACE = np.linspace([300, 900, -3000], [900, 950, -3500], FRAMES)


@pytest.fixture(name="opensim")
def opensim_is_installed():
    if find_spec("opensim") is None:
        pytest.skip('opensim is not installed: pip install "uplift3d[opensim]"')


def known(skeleton: str, seed: int, **more):
    """Return a person in twelve poses, four a second, and its angles."""
    angles = {name: values[:: len(values) // FRAMES][:FRAMES] for name, values in angles_of(90, seed).items()}
    if (
        skeleton != "h36m17"
    ):  # no joint in the trunk and at the base of the neck: nothing shows about which points these bend
        angles |= {name: np.zeros(FRAMES) for name in angles if name.startswith(("lumbar", "neck"))}
    return person(skeleton, angles, PLACE, **more), angles


@pytest.mark.parametrize("skeleton", ["h36m17", "mediapipe33"])
def test_known_angles_come_back(opensim, skeleton: str, tmp_path: Path) -> None:
    sample, angles = known(skeleton, seed=1)
    (remark,) = write(sample, tmp_path / "walk.osim").values()
    assert "marker errors" in remark and ("ankle_angle" in remark) == (skeleton == "h36m17")
    assert {file.name for file in tmp_path.iterdir()} == {
        "walk.osim",
        *(file.name for file in beside_model(tmp_path / "walk.osim")),
    }
    found = read_table(tmp_path / "walk_ik.mot")
    np.testing.assert_allclose(found.pop("time"), np.arange(FRAMES) / 30, atol=1e-6)
    shift = [found.pop(f"pelvis_t{axis}") for axis in "xyz"]
    np.testing.assert_allclose(np.stack(shift, 1), PLACE / 1000, atol=2e-3)
    for name, values in found.items():
        np.testing.assert_allclose(values, angles[name], atol=1 if name == "neck_extension" else 0.5, err_msg=name)
    assert len(found) == (25 if skeleton == "h36m17" else 34)
    assert read_table(tmp_path / "walk_ik_marker_errors.sto")["marker_error_max"].max() < 5e-3


AGAIN = """
import opensim, sys
opensim.Logger.setLevelString("Warn")
model = opensim.Model("walk.osim")
state = model.initSystem()
print(model.getTotalMass(state), model.getMarkerSet().getSize(), model.calcMassCenterPosition(state)[1])
print(opensim.TimeSeriesTable("walk_ik.mot").getNumRows(), opensim.TimeSeriesTableVec3("walk.trc").getNumColumns())
sys.exit(not opensim.InverseKinematicsTool("walk_ik.xml").run())
"""


def test_opensim_opens_the_files_and_runs_the_set_up_again(opensim, tmp_path: Path) -> None:
    sample, _ = known("coco17", seed=2)
    write(sample, tmp_path / "walk.osim", mass_kg=61.5)
    done = subprocess.run([sys.executable, "-c", AGAIN], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    mass, markers, height, rows, columns = map(float, done.stdout.split()[:5])
    assert (mass, markers, rows, columns) == (pytest.approx(61.5), 19, FRAMES, 19)
    assert 0.85 < height < 1.1  # near the hips, which are at 0.9 m
    ours, theirs = read_table(tmp_path / "walk_ik.mot"), read_table(tmp_path / "walk_again_ik.mot")
    page: dict = {}
    exec(re.findall(r"```python\n(.*?)```", (DOCS / "opensim.md").read_text(), re.S)[0], page)
    assert page["read_motion"](tmp_path / "walk_ik.mot")["knee_angle_r"].tolist() == ours["knee_angle_r"].tolist()
    for name, values in ours.items():
        np.testing.assert_allclose(
            theirs[name], values, atol=0.5 if name.startswith(("pelvis_t", "time")) else 1, err_msg=name
        )


def test_blank_frames_and_a_joint_that_is_missing(opensim, tmp_path: Path) -> None:
    sample, angles = known("h36m17", seed=3)
    pose = sample.pose.copy()
    pose[[4, 5]] = np.nan
    pose[8, sample.skeleton.index("rwrist")] = np.nan
    identity = {"frame": 1001 + np.arange(FRAMES)}  # the last at 33.7333333 s
    sample = replace(sample, pose=pose, level_pose=pose, identity=identity)
    (remark,) = write(sample, tmp_path / "walk.osim").values()
    assert "which are not in the motion: 2" in remark
    found = read_table(tmp_path / "walk_ik.mot")
    kept = np.delete(np.arange(FRAMES), [4, 5])
    np.testing.assert_allclose(found["time"], (1001 + kept) / 30, atol=1e-6)
    np.testing.assert_allclose(found["knee_angle_r"], angles["knee_angle_r"][kept], atol=0.5)
    np.testing.assert_allclose(
        np.delete(found["elbow_flex_r"], 6), np.delete(angles["elbow_flex_r"][kept], 6), atol=0.5
    )


def test_the_model_has_the_lengths_of_the_body_the_same_on_both_sides() -> None:
    sample, _ = known("halpe26", seed=4, stature_mm=1500.0)
    pose = sample.points * [1, -1, -1]
    right, knee = sample.skeleton.index("right_ankle"), sample.skeleton.index("right_knee")
    pose[:, right] += 0.1 * (pose[:, right] - pose[:, knee])  # a shank that is longer by a tenth
    model = human_model(sample.skeleton, sample.joint_names, pose, mass_kg=50.0)
    at = {segment.name: segment.at for segment in model.segments}
    # The simulator's shank is 0.2493 of the height, its thigh 0.2425, its hips 0.1 apart.
    np.testing.assert_allclose(at["calcn_r"], [0, -1.5 * 0.2493 * 1.05, 0], atol=1e-3)
    np.testing.assert_allclose(at["calcn_l"], at["calcn_r"], atol=1e-6)
    np.testing.assert_allclose(at["tibia_l"], [0, -1.5 * 0.2425, 0], atol=1e-3)
    np.testing.assert_allclose(at["femur_r"] - at["femur_l"], [0, 0, 1.5 * 0.1], atol=1e-3)
    assert sum(segment.mass for segment in model.segments) == pytest.approx(50)
    assert set(model.markers) == set(sample.joint_names)
    forearm = next(segment for segment in model.segments if segment.name == "forearm_l")
    np.testing.assert_allclose(2 * forearm.middle, [0, -1.5 * 0.154, 0], atol=1e-3)  # drawn from elbow to wrist


@pytest.mark.parametrize(
    "skeleton", ["coco_wholebody133", "openpose25", "openpose25b", "mpii16", "mpi_inf_3dhp17", "mpi_inf_3dhp28"]
)
def test_every_shipped_person_has_a_model(skeleton: str) -> None:
    made = load_skeleton(skeleton)
    if skeleton == "coco_wholebody133":  # says no places on the body: its names are those of others that do
        like, _ = known("halpe26", seed=5)
        points = np.full((FRAMES, len(made.joints), 3), np.nan)
        for joint in set(made.joints) & set(like.joint_names):
            points[:, made.index(joint)] = like.points[:, like.skeleton.index(joint)] * [1, -1, -1]
    else:
        points = known(skeleton, seed=5)[0].points * [1, -1, -1]
    model = human_model(made, made.joints, points)
    names = {segment.name for segment in model.segments}
    assert {"pelvis", "torso", "head", "femur_r", "tibia_l", "humerus_r", "forearm_l"} <= names
    assert ("calcn_r" in names) == (skeleton not in ("mpii16", "mpi_inf_3dhp17"))
    assert all(np.isfinite(place).all() for _, place in model.markers.values())


def test_what_is_no_person_has_no_size_or_is_there_already(opensim, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"of a person, and skeleton 'figure' has no left_hip, right_hip, left_knee"):
        write(prediction(frames=9), tmp_path / "a.osim")
    sample, _ = known("coco17", seed=2)
    with pytest.raises(UserError, match="these poses are in px. Give the size"):
        write(replace(sample, unit="px"), tmp_path / "a.osim")
    with pytest.raises(UserError, match="stands with y up"):
        write(sample, tmp_path / "a.osim", axes="camera")
    (tmp_path / "a_ik.mot").touch()
    with pytest.raises(UserError, match=r"a_ik.mot exists already"):
        write(sample, tmp_path / "a.osim")
    assert [file.name for file in tmp_path.iterdir()] == ["a_ik.mot"]


def test_what_the_command_refuses_before_any_work(opensim, tmp_path: Path) -> None:
    model, markers = str(tmp_path / "a.osim"), str(tmp_path / "a.trc")
    check_outputs([model, str(tmp_path / "a.csv")], None, None, {"mass_kg": 60.0}, 0)
    with pytest.raises(UserError, match=r"a\.trc is written beside .*a\.osim: leave it out"):
        check_outputs([model, markers], None, None, {}, 0)
    with pytest.raises(UserError, match=r"mass_kg= goes with output=FILE\.osim"):
        check_outputs([markers], None, None, {"mass_kg": 60.0}, 0)
