"""Acclaim files: joints are where forward kinematics has them, and every fault is one message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mocap_files import BONES, expected, motion, write_amc, write_asf

from uplift.data.datasets.cmu import JOINTS, Rates, Trial, read_clip
from uplift.data.parsers.mocap import read_amc, read_asf
from uplift.errors import UserError

FULL = Rates(fps=120.0)


def files(folder: Path, frames: int = 5, seed: int = 0, **asf) -> Trial:
    asf_path = write_asf(folder / "35.asf", **asf)
    return Trial(write_amc(folder / "35_01.amc", motion(frames, seed)), "S35", "35_01", asf_path)


@pytest.mark.parametrize("seed", range(3))
def test_joints_are_where_forward_kinematics_has_them(tmp_path: Path, seed: int):
    clip = read_clip(files(tmp_path, 9, seed), FULL)
    truth = expected(motion(9, seed))
    for place, joint in enumerate(JOINTS):
        assert np.abs(clip.joints[:, place] - truth[joint]).max() < 0.01, joint


def test_every_twelfth_frame_is_kept_whatever_number_the_first_has(tmp_path: Path):
    asf = read_asf(write_asf(tmp_path / "35.asf"))
    values = motion(50)
    figure = read_amc(write_amc(tmp_path / "35_01.amc", values, first=135), asf, 12)
    assert np.abs(figure.at("root") - values["root"][::12, :3]).max() < 1e-6
    assert len(figure.at("root")) == 5


def test_the_unit_is_the_one_that_the_skeleton_says(tmp_path: Path):
    near = read_clip(files(tmp_path), FULL)
    (tmp_path / "other").mkdir()
    far = read_clip(files(tmp_path / "other", unit=0.5), FULL)
    assert np.allclose(far.joints * 0.5, near.joints * 0.45, atol=0.01)


def test_line_ends_blank_lines_and_radians_change_nothing(tmp_path: Path):
    trial = files(tmp_path)
    plain = read_clip(trial, FULL).joints
    text = trial.path.read_text()
    trial.path.write_text(text.replace("\n2\n", "\n\n# a comment\n2\n").replace("\n", "\r\n") + "\r\n\r\n")
    assert np.array_equal(read_clip(trial, FULL).joints, plain)
    values = {name: np.deg2rad(rows) for name, rows in motion(5).items()}
    values["root"][:, :3] = motion(5)["root"][:, :3]
    write_amc(trial.path, values)
    trial.path.write_text(trial.path.read_text().replace(":DEGREES", ":RADIANS"))
    assert np.abs(read_clip(trial, FULL).joints - plain).max() < 0.01


def test_another_order_of_the_bones_in_the_motion_changes_nothing(tmp_path: Path):
    trial = files(tmp_path)
    plain = read_clip(trial, FULL).joints
    write_amc(trial.path, dict(reversed(motion(5).items())))
    assert np.allclose(read_clip(trial, FULL).joints, plain, atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (":hierarchy", ":tree", "no section :hierarchy"),
        ("     direction 0.6736 -0.7161 0.1829 ", "     direction 0.6736 -0.7161", "line 19: direction .* 3 numbers"),
        ("     length 7.41 ", "     length nan", "length .* 1 number"),
        ("axis 0 0 20  XYZ", "axis 0 0 20  XYY", "line .*order of axes"),
        ("dof rx ry rz", "dof rx ry l", "line .*dof is 'rx ry l'"),
        ("    lfemur ltibia", "    lfemur shin", "line .*bone 'shin' is not in :bonedata"),
        ("name ltibia", "name lfemur", "line .*called 'lfemur', expected a unique name"),
        ("  length 0.45", "  length 0", "line 6: length is 0"),
        ("orientation 0 0 0", "orientation 0 90 0", "line .*orientation"),
        ("order TX TY TZ RX RY RZ", "order TX TY TZ RX RY", "line .*order is"),
        ("name lfemur\n", "name lthigh\n", "bone 'lfemur' is not in :bonedata"),
    ],
)
def test_a_wrong_skeleton_is_one_message(tmp_path: Path, old: str, new: str, message: str):
    path = write_asf(tmp_path / "35.asf")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError, match=message):
        read_asf(path)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.97])
def test_a_truncated_skeleton_is_one_message(tmp_path: Path, share: float):
    path = write_asf(tmp_path / "35.asf")
    text = path.read_text()
    path.write_text(text[: int(share * len(text))])
    with pytest.raises(UserError, match=r"35\.asf"):
        read_asf(path)


@pytest.mark.parametrize("content", [b"", b"\0\0PK\3\4", b"HIERARCHY\nROOT Hips\n", b"\xff\xfe:version"])
def test_something_else_is_no_skeleton(tmp_path: Path, content: bytes):
    path = tmp_path / "35.asf"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"35\.asf"):
        read_asf(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\nltibia ", "\nlshin ", "line 7: found 'lshin .* which moves nothing in 35.asf"),
        ("\n3\n", "\n4\n", "line 64: frame 4 follows frame 2"),
        ("\n3\n", "\n", r"line \d+: found 'root"),
        ("\nroot ", "\nroot 1 ", "line 5: found 'root 1 .*expected 'root' and 6 numbers"),
        ("\nroot ", "\nroot inf ", "expected 'root' and 6 numbers"),
        (":DEGREES", "DEGREES", "line 3: found 'DEGREES', expected the number of the first frame"),
    ],
)
def test_a_wrong_motion_is_one_message_with_the_line(tmp_path: Path, old: str, new: str, message: str):
    trial = files(tmp_path)
    text = trial.path.read_text()
    assert old in text
    trial.path.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError, match=message):
        read_clip(trial, FULL)


def test_words_where_numbers_belong_are_one_message(tmp_path: Path):
    values = motion(3)
    trial = files(tmp_path, 3)
    lines = write_amc(trial.path, values).read_text().split("\n")
    place = next(k for k, line in enumerate(lines) if line.startswith("ltibia"))
    lines[place] = "ltibia here"
    trial.path.write_text("\n".join(lines))
    with pytest.raises(UserError, match=f"line {place + 1}: found 'ltibia here', expected 'ltibia' and 1 number "):
        read_clip(trial, FULL)


@pytest.mark.parametrize("lines", [1, 7, 29, 30])
def test_a_truncated_motion_is_seen_even_where_its_last_frame_is_not_kept(tmp_path: Path, lines: int):
    trial = files(tmp_path, 20)
    text = trial.path.read_text().rstrip("\n").split("\n")
    assert len(BONES) - 2 + 2 == 30  # two bones do not move; the root and the frame's number
    trial.path.write_text("\n".join(text[:-lines]))
    if lines == 30:  # a whole frame
        assert len(read_clip(trial, FULL).joints) == 19
        return
    with pytest.raises(UserError, match="truncated"):
        read_clip(trial, Rates(fps=10.0))
    trial.path.write_text("\n".join(text)[:-30])
    with pytest.raises(UserError, match="line"):
        read_clip(trial, Rates(fps=10.0))


def test_another_subjects_skeleton_with_fewer_bones_is_refused(tmp_path: Path):
    trial = files(tmp_path)
    text = trial.path.read_text()
    trial.path.write_text("\n".join(line for line in text.split("\n") if not line.startswith("lthumb")))
    with pytest.raises(UserError, match="without lthumb"):
        read_clip(trial, FULL)


def test_a_rate_that_cannot_be_thinned_out_is_refused(tmp_path: Path):
    trial = files(tmp_path)
    with pytest.raises(UserError, match=r"120 frames a second .* fps=50\. Nearest: fps=60"):
        read_clip(trial, Rates(fps=50.0))
    assert len(read_clip(trial, Rates(fps=10.0, own={"S35": 20.0})).joints) == 3
    assert len(read_clip(trial, Rates(fps=10.0, own={"S35": 20.0, "35_01": 10.0})).joints) == 5


def test_a_giant_is_refused(tmp_path: Path):
    with pytest.raises(UserError, match="thigh and shin are .* expected 550 to 1200"):
        read_clip(files(tmp_path, scale=3.0), FULL)


def test_the_real_clip_walks(benchmark_data):
    asf = benchmark_data("trackers/asf_amc/35.asf")
    skeleton = read_asf(asf)
    lengths = {bone.name: bone.length for bone in skeleton.bones}
    assert len(lengths) == 30
    assert lengths["lhipjoint"] == 2.63917
    assert lengths["rthumb"] == 0.768342
    figure = read_amc(benchmark_data("trackers/asf_amc/35_01.amc"), skeleton)
    assert np.allclose(figure.at("root")[[0, -1]], [[4.19723, 17.9451, 3.84436], [3.88699, 17.5779, 46.8227]])
    clip = read_clip(Trial(benchmark_data("trackers/asf_amc/35_01.amc"), "S35", "35_01", asf), FULL)
    speed = np.linalg.norm(np.diff(clip.joints, axis=0), axis=-1) * 120
    assert len(clip.joints) == 224
    assert 1000 < speed[:, JOINTS.index("hip")].mean() < 1600  # mm a second
    for ankle in ("lankle", "rankle"):  # the standing foot stands, near the ground
        place = JOINTS.index(ankle)
        assert np.percentile(speed[:, place], 5) < 100
        assert 30 < clip.joints[:, place, 1].min() < 100


REAL_FRAME = """:FULLY-SPECIFIED
:DEGREES
1
root 1.01254 16.5239 -34.8207 12.4295 1.23383 -0.941524
lowerback -4.15803 1.02589 -1.58627
upperback -3.23848 1.40983 -1.71542
thorax -0.989394 0.716381 -0.825246
lowerneck -14.5576 -3.43008 -1.94141
upperneck 39.1252 -7.25169 6.3994
head 17.0477 -2.3856 1.88663
rclavicle 0 0
rhumerus -41.533 -3.682 -79.3252
rradius 32.927
rwrist -19.8069
rhand -4.36991 16.2661
rfingers 7.12502
rthumb 21.3987 -12.5722
lclavicle 0 0
lhumerus -39.5666 24.8198 64.986
lradius 51.9591
lwrist -0.589217
lhand -0.913109 20.2969
lfingers 7.12502
lthumb 24.7155 48.7205
rfemur -32.982 -0.231072 22.4121
rtibia 61.0675
rfoot 0 0
rtoes 0
lfemur -23.3432 -9.63608 -22.465
ltibia 30.0825
lfoot -24.2814 21.2184
ltoes -4.32702
"""


def test_limbs_of_a_real_frame_point_where_an_independent_conversion_has_them(benchmark_data, tmp_path: Path):
    """CMU's 05_01, frame 1, on another subject's skeleton: lengths differ, the limbs' directions do not."""
    path = tmp_path / "05_01.amc"
    path.write_text(REAL_FRAME)
    found = read_clip(Trial(path, "S5", "05_01", benchmark_data("trackers/asf_amc/35.asf")), FULL).joints[0]
    with np.load(benchmark_data("cmu/world.npz")) as world:
        assert tuple(world["joint_names"]) == JOINTS
        truth = world["joints"][np.flatnonzero(world["sequence"] == "05_01")[0]]
    for start, end in (
        ("rhip", "rknee"), ("rknee", "rankle"), ("lhip", "lknee"), ("lknee", "lankle"), ("lshoulder", "lelbow"),
        ("lelbow", "lwrist"), ("rshoulder", "relbow"), ("relbow", "rwrist"),
    ):  # fmt: skip
        ours, theirs = (points[JOINTS.index(end)] - points[JOINTS.index(start)] for points in (found, truth))
        cosine = ours @ theirs / np.linalg.norm(ours) / np.linalg.norm(theirs)
        assert cosine > np.cos(np.deg2rad(0.1)), (start, end)
