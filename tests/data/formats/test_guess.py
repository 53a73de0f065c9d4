"""Every real file is taken for what it is, and what holds no keypoints for none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import Peek
from uplift.errors import UserError

FILES = {
    "deeplabcut": (
        "deeplabcut/DLC_sample_poses.csv",
        "deeplabcut/DLC_sample_poses.h5",
        "deeplabcut/CollectedData_Pranav.csv",
        "deeplabcut/CollectedData_Pranav.h5",
        "deeplabcut/m3v1mp4shortDLC_effnet_b0_multi_mouseApr12shuffle1_5_el.h5",
        "deeplabcut/m3v1mp4shortDLC_effnet_b0_multi_mouseApr12shuffle1_5_el_filtered.csv",
        "deeplabcut/CollectedData_dlc_team.csv",
        "deeplabcut/CollectedData_dlc_team.h5",
        "lightning_pose/CollectedData.csv",
        "lightning_pose/3f859b5c-e73a-4044-b49e-34bb81e96715.left.rng=0.csv",
        "lightning_pose/180607_004.train_frames=75.rng=0.bot.csv",
        "nwb/m3v1mp4DLC_resnet50_openfieldAug20shuffle1_30000.h5",
    ),
    "sleap_slp": (
        "sleap/minimal_instance.slp",
        "sleap/predictions_1.2.7_provenance_and_tracking.slp",
        "sleap/clip.2node.slp",
        "sleap/small_robot_minimal.slp",
    ),
    "sleap_h5": (
        "sleap/centered_pair_standard.analysis.h5",
        "sleap/small_robot.000_small_robot_3_frame.analysis.h5",
    ),
    "nwb": (
        "nwb/m3v1mp4DLC_resnet50_openfieldAug20shuffle1_30000.nwb",
        "nwb/0.1.1_poseestimation_nodes_edges.nwb",
        "nwb/minimal.pose.nwb",
    ),
    "jabs": ("jabs/example_pose_est_v2.h5",),
    "mediapipe": ("mediapipe/landmarks.csv",),
    "openpose": (
        "openpose/single_person_cam01_json",
        "openpose/single_person_cam01_json/cam01.0000.json",
        "openpose/two_persons_cam02_json",
        "openpose/two_persons_cam02_json/cam02.0011.json",
    ),
    "coco": ("coco/test_coco.json", "coco/test_fly.json", "ap10k/test_ap10k.json"),
    "coco_results": ("coco/person_keypoints_val2014_fakekeypoints100_results.json",),
    "mpii_json": ("mpii/test_mpii.json",),
    "mmpose": ("mmpose/test.json",),
    "kinetics_skeleton": ("kinetics_skeleton/baseball.json",),
    "ultralytics": (
        "ultralytics/labels",
        "ultralytics/labels/1_13_14_mp4-0003_jpg.rf.32646e00c9169450f3d746084bc537b5.txt",
        "ultralytics",
    ),
    "alphatracker": ("alphatracker/at_testdata.json",),
    "alphapose": ("alphapose/alphapose-results.json",),
}
NO_KEYPOINTS = (
    "trc/S00_P00_T01_BalancingTrial_0-100.trc",
    "trc/markers.trc",
    "c3d/runway03.c3d",
    "c3d/sample_probing_acromion_R.c3d",
    "bvh/cmu_12_01_walk.bvh",
    "bvh/09_03.bvh",
    "asf_amc/35.asf",
    "asf_amc/35_01.amc",
    "gltf/Fox.glb",
    "ultralytics/data.yaml",
    "README.md",
    "licences",
    "bvh",
)


@pytest.mark.parametrize(("name", "file"), [(name, file) for name, files in FILES.items() for file in files])
def test_real_files_are_guessed(benchmark_data, name: str, file: str) -> None:
    path = benchmark_data(f"trackers/{file}")
    if name not in KEYPOINT_FORMATS:
        pytest.skip(f"no reader of {name}")
    assert KEYPOINT_FORMATS.guess(path).name == name


def test_no_file_is_left_out(benchmark_data) -> None:
    root = benchmark_data("trackers")
    listed = {root / file for files in FILES.values() for file in files} | {root / file for file in NO_KEYPOINTS}
    folders = {path for path in listed if path.is_dir()} - {root / "ultralytics"}
    there = {path for path in root.rglob("*") if path.is_file()}
    assert not {path for path in there - listed if not folders & set(path.parents)}


@pytest.mark.parametrize("file", NO_KEYPOINTS)
def test_what_holds_no_keypoints_is_refused(benchmark_data, file: str) -> None:
    path = benchmark_data(f"trackers/{file}")
    with pytest.raises(UserError) as error:
        read(path)
    assert str(path) in str(error.value)


def test_licences_are_refused(benchmark_data) -> None:
    for path in sorted(benchmark_data("trackers/licences").iterdir()):
        with pytest.raises(UserError):
            KEYPOINT_FORMATS.guess(path)


@pytest.mark.parametrize("name", sorted(KEYPOINT_FORMATS))
def test_nothing_is_claimed_or_breaks_on_odd_content(tmp_path: Path, name: str) -> None:
    fits = KEYPOINT_FORMATS[name].fits
    odd = {
        "a.json": b"[[[[[[[[[[", "b.json": b"{", "c.json": b'{"a": [1, 2', "d.json": b"\xff\xfe\x00", "e.json": b"[]",
        "f.txt": b"hello", "g.txt": b"0 0.5 0.5 0.2 0.2", "h.csv": b"a,b,c\n1,2,3\n", "i.h5": b"\x89HDF\r\n\x1a\nxxxx",
        "j.npy": b"PK\x03\x04", "k.txt": b"nan nan nan nan nan nan nan", "l.txt": b"1e999 0 0 0 0 0 0",
        "m.json": b'{"\\ud800": 1}', "n.yaml": b"a: 1",  "o.json": b"", "p.csv": b"", "q.txt": b"",
    }  # fmt: skip
    for file, content in odd.items():
        (tmp_path / file).write_bytes(content)
        assert not fits(Peek(tmp_path / file)), file
    folder = tmp_path / "folder"
    folder.mkdir()
    assert not fits(Peek(folder))
    (folder / "x.json").mkdir()
    (folder / "y.json").write_bytes(b"")
    (folder / "y.txt").write_bytes(b"")
    os.symlink(folder / "nothing", folder / "z.json")
    assert not fits(Peek(folder))
    for file, content in odd.items():
        (folder / file).write_bytes(content)
    assert not fits(Peek(folder))
