"""Biovision files: CMU's conversions become the same joints; what was dropped is put back; others are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mocap_files import expected, motion, write_bvh
from scipy.spatial.transform import Rotation

from uplift.data.datasets.cmu import JOINTS, Rates, Trial, read_clip
from uplift.data.parsers.mocap import open_bvh
from uplift.errors import UserError

FULL = Rates(fps=120.0)
ARM = """HIERARCHY
ROOT trunk
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT arm
  {
    OFFSET 0 10 0
    CHANNELS 3 Yrotation Zrotation Xrotation
    JOINT hinge
    {
      OFFSET 4 0 1
      CHANNELS 1 Xrotation
      End Site
      {
        OFFSET 0 0 5
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
10 20 30 5 15 25 35 45 55 65
11 21 31 -5 -15 -25 -35 -45 -55 -65
"""


def clip_of(path: Path):
    return read_clip(Trial(path, "S12", "12_01"), FULL)


@pytest.mark.parametrize("seed", range(3))
def test_a_conversion_without_thorax_and_wrist_has_them_back(tmp_path: Path, seed: int):
    clip = clip_of(write_bvh(tmp_path / "12_01.bvh", motion(9, seed)))
    truth = expected(motion(9, seed), as_bvh=True)
    assert len(clip.joints) == 9  # the rest pose is gone
    for place, joint in enumerate(JOINTS):
        assert np.abs(clip.joints[:, place] - truth[joint]).max() < 0.01, joint


def test_channels_are_turned_in_the_order_of_the_file(tmp_path: Path):
    path = tmp_path / "arm.bvh"
    path.write_text(ARM)
    file = open_bvh(path)
    figure = file.figure(0, 1)
    rows = np.array([[5, 15, 25, 35, 45, 55, 65], [-5, -15, -25, -35, -45, -55, -65]])
    trunk = Rotation.from_euler("ZXY", rows[:, :3], degrees=True)
    arm = trunk * Rotation.from_euler("YZX", rows[:, 3:6], degrees=True)
    hinge = arm * Rotation.from_euler("X", rows[:, 6:], degrees=True)
    start = np.array([[10, 20, 30], [11, 21, 31]])
    at = start + trunk.apply([0, 10, 0]) + arm.apply([4, 0, 1])
    assert np.allclose(figure.at("hinge"), at)
    assert np.allclose(figure.beyond("hinge", file.tree.tips[2]), at + hinge.apply([0, 0, 5]))
    assert round(file.rate, 3) == 30.0


def test_a_first_frame_that_is_motion_stays(tmp_path: Path):
    assert len(clip_of(write_bvh(tmp_path / "12_01.bvh", motion(9), rest=False)).joints) == 9


def test_a_conversion_in_centimetres_is_told_by_its_legs(tmp_path: Path):
    values = motion(4)
    plain = clip_of(write_bvh(tmp_path / "12_01.bvh", values)).joints
    values["root"][:, :3] *= 5.6444444
    scaled = clip_of(write_bvh(tmp_path / "12_02.bvh", values, scale=5.6444444)).joints
    assert np.abs(scaled - plain).max() < 0.05


def test_bones_that_are_there_are_not_put_back(tmp_path: Path):
    path = write_bvh(tmp_path / "12_01.bvh", motion(4))
    text = path.read_text()
    for name in ("Neck", "LeftShoulder", "RightShoulder"):
        start = text.index(f"JOINT {name}\n")
        text = text[:start] + text[start:].replace("OFFSET 0.0 0.0 0.0", "OFFSET 0.0 1.0 0.0", 1)
    path.write_text(text)
    joints = clip_of(path).joints
    gap = np.linalg.norm(joints[:, JOINTS.index("thorax")] - joints[:, JOINTS.index("spine")], axis=-1)
    assert (gap < (2.03 + 1.01) * 56.4445).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIGHER", "line 1: found 'HIGHER', expected HIERARCHY"),
        ("OFFSET 0 10 0", "OFFSET 0 10", "line 8: OFFSET is '0 10', expected 3 numbers"),
        ("CHANNELS 1 Xrotation", "CHANNELS 2 Xrotation", "line 13: CHANNELS"),
        ("CHANNELS 1 Xrotation", "CHANNELS 1 Wrotation", "line 13: CHANNELS"),
        ("JOINT hinge", "JOINT arm", "line 10: a second joint is called 'arm'"),
        ("JOINT arm", "ROOT arm", "line 6: found 'ROOT arm', expected one ROOT"),
        ("Frames: 2", "Frames: 3", "2 frames, but the header says 3: the file is truncated"),
        ("Frames: 2", "Frames: 1", "2 frames, but the header says 1: there are too many lines"),
        ("Frames: 2", "Frames: many", "line 22: frames is 'many'"),
        ("Frame Time: 0.0333333", "Frame Time: 0", "line 23: .*above 0"),
        ("35 45 55 65\n", "35 45 55\n", "line 24: 9 values, expected 10"),
        ("35 45 55 65\n", "35 45 55 nan\n", "line 24: the frame is .*expected 10 numbers"),
        ("MOTION", "MOTIONLESS", "line 21: found 'MOTIONLESS'"),
        ("    OFFSET 0 10 0\n", "", "joint 'arm' has no OFFSET"),
    ],
)
def test_a_wrong_file_is_one_message_with_the_line(tmp_path: Path, old: str, new: str, message: str):
    path = tmp_path / "arm.bvh"
    assert old in ARM
    path.write_text(ARM.replace(old, new, 1))
    with pytest.raises(UserError, match=message):
        open_bvh(path).figure(0, 1)


@pytest.mark.parametrize("size", range(5, len(ARM) - 3, 23))
def test_a_truncated_file_is_one_message(tmp_path: Path, size: int):
    path = tmp_path / "arm.bvh"
    path.write_text(ARM[:size])
    with pytest.raises(UserError, match=r"arm\.bvh"):
        open_bvh(path).figure(0, 1)


def test_a_hierarchy_without_end_is_one_message(tmp_path: Path):
    path = tmp_path / "deep.bvh"
    rows = "".join(f"JOINT j{k}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for k in range(5000))
    path.write_text("HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 0\n" + rows)
    with pytest.raises(UserError, match=r"deep\.bvh, line"):
        open_bvh(path)


def test_another_skeleton_is_refused_with_its_joints(tmp_path: Path):
    path = tmp_path / "12_01.bvh"
    path.write_text(ARM)
    with pytest.raises(UserError, match="no known conversion of CMU's data: trunk, arm, hinge"):
        clip_of(path)
    text = write_bvh(path, motion(3)).read_text()
    path.write_text(text.replace("LeftForeArm", "LeftLowArm"))
    with pytest.raises(UserError, match="Nearest is cgspeed's conversion for MotionBuilder, without LeftForeArm"):
        clip_of(path)


def test_a_head_without_end_is_refused(tmp_path: Path):
    path = write_bvh(tmp_path / "12_01.bvh", motion(3))
    lines = path.read_text().split("\n")
    head = next(k for k, line in enumerate(lines) if line.strip() == "JOINT Head")
    end = next(k for k in range(head, len(lines)) if lines[k].strip() == "End Site")
    path.write_text("\n".join(lines[:end] + lines[end + 4 :]))
    with pytest.raises(UserError, match="joint 'Head' has no End Site"):
        clip_of(path)


def test_a_file_with_nothing_but_the_rest_pose_is_refused(tmp_path: Path):
    path = write_bvh(tmp_path / "12_01.bvh", motion(1))
    path.write_text(path.read_text().rstrip("\n").rpartition("\n")[0].replace("Frames: 2", "Frames: 1"))
    with pytest.raises(UserError, match="no frames after the rest pose"):
        clip_of(path)


def world(path: Path, sequence: str) -> np.ndarray:
    with np.load(path) as file:
        return file["joints"][file["sequence"] == sequence] * 1000


def test_the_real_clip_for_motionbuilder_is_exact(benchmark_data):
    """An independent conversion of the same motion at 30 Hz, with the same rules for what was dropped."""
    trial = Trial(benchmark_data("trackers/bvh/cmu_12_01_walk.bvh"), "S12", "12_01")
    found = read_clip(trial, Rates(fps=30.0)).joints
    truth = world(benchmark_data("cmu/world.npz"), "12_01")
    assert found.shape == truth.shape
    assert np.abs(found - truth).max() < 0.01


def test_the_real_clip_for_poser_is_the_same_motion_of_another_body(benchmark_data):
    file = open_bvh(benchmark_data("trackers/bvh/09_03.bvh"))
    assert (len(file.tree.names), file.frames) == (43, 129)
    assert file.row(128)[-1] == -0.654291
    found = clip_of(file.path).joints[1::4]  # row 5 of the file, the rest pose and the way out of it left out
    truth = world(benchmark_data("cmu/world.npz"), "09_03")[1:]
    assert len(found) == len(truth)
    error = np.linalg.norm((found - found[:, :1]) - (truth - truth[:, :1]), axis=-1)
    assert error.mean() < 75
    assert error.max() < 200
