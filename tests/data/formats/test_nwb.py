"""Pose estimates of NWB files are read as pynwb and sleap-io write them, and nothing hostile gets through."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tracker_files_hdf5 import NODES, outcomes, some_points, write_nwb

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.nwb import frame_numbers
from uplift.data.poses import PoseData
from uplift.errors import UserError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
DLC = "trackers/nwb/m3v1mp4DLC_resnet50_openfieldAug20shuffle1_30000"


def at(data: PoseData, joint: str, **where: object) -> tuple[float, float, float]:
    """Return x, y and confidence of the joint in the one row where identity is as given."""
    rows = np.logical_and.reduce([data.identity[key] == value for key, value in where.items()])
    (row,) = np.flatnonzero(rows)
    column = data.joint_names.index(joint)
    return (*data.keypoints[row, column].tolist(), float(data.confidence[row, column]))


def body(*names: str, samples: int = 4, seed: int = 0, **more: object) -> dict:
    """Return a body for `write_nwb` with a series for each name."""
    points = some_points(samples, len(names), seed=seed).astype("f4")
    return {"series": {name: points[:, place] for place, name in enumerate(names)}, "score": 0.5, **more}


def test_a_real_file_of_deeplabcut(benchmark_data) -> None:
    data = read(benchmark_data(f"{DLC}.nwb"))
    close = {"rel": 1e-6}
    assert at(data, "ind1_leftear", frame=0) == pytest.approx((71.73615, 103.0062, 0.998528), **close)
    assert at(data, "ind1_tailbase", frame=2329) == pytest.approx((358.8535, 379.5098, 0.999484), **close)
    assert data.image_size is None and data.fps is None and set(data.identity["sequence"]) == {"fake_path"}
    assert "bottom left" in " ".join(data.notes)
    pandas = pytest.importorskip("pandas")
    table = pandas.read_hdf(benchmark_data(f"{DLC}.h5"))
    wanted = table.to_numpy().reshape(2330, 4, 3)
    parts = [column[-2] for column in table.columns[::3]]
    assert data.joint_names == tuple(f"ind1_{part}" for part in parts)
    np.testing.assert_array_equal(data.keypoints, wanted[..., :2].astype("f4"))
    np.testing.assert_array_equal(data.confidence, wanted[..., 2].astype("f4"))


def test_a_real_file_of_the_first_version(benchmark_data) -> None:
    path = benchmark_data("trackers/nwb/0.1.1_poseestimation_nodes_edges.nwb")  # of random shares of an image
    with pytest.raises(UserError, match="image_size=WIDTHxHEIGHT"):
        read(path)
    data = read(path, ReadOptions(image_size=(1000, 100)))
    assert at(data, "front_left_paw", frame=0) == pytest.approx((318.7111, 98.08701, 0.737818), rel=1e-6)
    assert at(data, "front_right_paw", frame=99) == pytest.approx((757.7127, 78.04109, 0.395285), rel=1e-6)
    assert data.bones == (("front_left_paw", "front_right_paw"),) and data.fps == 9.9
    assert "third coordinate" in " ".join(data.notes)


def test_a_real_file_of_two_tracks(benchmark_data) -> None:
    data = read(benchmark_data("trackers/nwb/minimal.pose.nwb"))
    assert at(data, "A", frame=0, instance="1") == pytest.approx((10, 20, 0.9))
    assert at(data, "A", frame=1, instance="2") == pytest.approx((51, 61, 0.7))
    assert at(data, "B", frame=1, instance="2")[2] == 0
    assert set(data.identity["sequence"]) == {"minimal"} and data.bones == (("A", "B"),) and len(data) == 5


def _pynwb_file():
    pynwb = pytest.importorskip("pynwb")
    ndx_pose = pytest.importorskip("ndx_pose")
    return pynwb, ndx_pose, pynwb.NWBFile("d", "i", datetime(2026, 1, 2, tzinfo=UTC))


def test_what_pynwb_writes(tmp_path) -> None:
    pynwb, ndx_pose, file = _pynwb_file()
    points, score = some_points(6, 3).astype("f4"), np.random.default_rng(0).random((6, 3)).astype("f4")
    skeleton = ndx_pose.Skeleton(name="mouse", nodes=list(NODES), edges=np.array([(1, 0), (1, 2)], "u1"))
    series = [
        ndx_pose.PoseEstimationSeries(
            name=name, data=points[:, place], confidence=score[:, place], reference_frame="top left", unit="pixels",
            **({"rate": 50.0, "starting_time": 10.0} if place else {"timestamps": 10 + np.arange(6) / 50}),
        )
        for place, name in reversed(list(enumerate(NODES)))
    ]  # fmt: skip
    estimate = ndx_pose.PoseEstimation(
        name="mouse", pose_estimation_series=series, skeleton=skeleton, original_videos=["day 1/open field.avi"],
        dimensions=np.array([[640, 480]], "u2"), scorer="s", source_software="DeepLabCut",
    )  # fmt: skip
    module = file.create_processing_module("behavior", "b")
    module.add(ndx_pose.Skeletons(skeletons=[skeleton]))
    module.add(estimate)
    with pynwb.NWBHDF5IO(str(tmp_path / "a.nwb"), "w") as io:
        io.write(file)
    assert KEYPOINT_FORMATS.guess(tmp_path / "a.nwb").name == "nwb"
    data = read(tmp_path / "a.nwb")
    np.testing.assert_array_equal(data.keypoints, points)
    np.testing.assert_array_equal(data.confidence, score)
    assert (data.joint_names, data.bones) == (NODES, (("neck", "nose"), ("neck", "tail")))
    assert (data.fps, data.image_size) == (50, (640, 480))
    assert data.identity["frame"].tolist() == [500, 501, 502, 503, 504, 505]
    assert set(data.identity["sequence"]) == {"open field"} and "instance" not in data.identity


@pytest.mark.parametrize("place", ["processing/behavior/mouse", "mouse", ""])
def test_poses_without_the_root_of_nwb_are_found(tmp_path, place: str) -> None:
    """Groups of ndx-pose that were copied into a file of their own: no session, no specifications, no attributes above."""
    write_nwb(tmp_path / "whole.nwb", {"behavior/mouse": body(*NODES)})
    with h5py.File(tmp_path / "whole.nwb") as whole, h5py.File(tmp_path / "part.h5", "w") as part:
        for name in whole["processing/behavior/mouse"] if not place else [""]:
            whole.copy(f"processing/behavior/mouse/{name}", part, name or place, expand_soft=True)
        if not place:
            part.attrs["neurodata_type"] = "PoseEstimation"
    assert KEYPOINT_FORMATS.guess(tmp_path / "part.h5").name == "nwb"
    data, whole = read(tmp_path / "part.h5"), read(tmp_path / "whole.nwb")
    np.testing.assert_array_equal(data.keypoints, whole.keypoints)
    assert (data.joint_names, data.bones, data.fps) == (whole.joint_names, whole.bones, 25) and len(data) == 4
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["processing/behavior/mouse/data"] = np.zeros((4, 2))
    with pytest.raises(UserError, match="not in a known format"):
        read(tmp_path / "other.h5")


def test_hand_labels_that_pynwb_writes(tmp_path) -> None:
    pynwb, ndx_pose, file = _pynwb_file()
    skeleton = ndx_pose.Skeleton(name="mouse", nodes=list(NODES), edges=np.array([(0, 1)], "u1"))
    points = some_points(3, 2, 3).astype("f4")
    points[1, 1, 2] = np.nan
    source = pynwb.image.ImageSeries(
        name="clip", description="d", unit="NA", format="external", external_file=["films/clip.avi"], rate=30.0,
        starting_frame=[0], dimension=[640, 480], num_samples=100,
    )  # fmt: skip
    frames = []
    for number in range(3):
        inside = [
            ndx_pose.SkeletonInstance(
                name=f"instance_{one}", node_locations=points[number, one], skeleton=skeleton,
                node_visibility=[True, number != 2, True],
            )
            for one in range(2)
        ]  # fmt: skip
        frames.append(
            ndx_pose.TrainingFrame(
                name=f"frame_{number}", skeleton_instances=ndx_pose.SkeletonInstances(skeleton_instances=inside),
                source_video=source, source_video_frame_index=np.uint16(300 + number),
            )
        )  # fmt: skip
    module = file.create_processing_module("behavior", "b")
    module.add(ndx_pose.Skeletons(skeletons=[skeleton]))
    module.add(
        ndx_pose.PoseTraining(
            training_frames=ndx_pose.TrainingFrames(training_frames=frames),
            source_videos=ndx_pose.SourceVideos(image_series=[source]),
        )
    )
    with pynwb.NWBHDF5IO(str(tmp_path / "a.nwb"), "w") as io:
        io.write(file)
    data = read(tmp_path / "a.nwb")
    assert data.identity["frame"].tolist() == [300, 300, 301, 301, 302, 302]
    assert set(data.identity["sequence"]) == {"clip"} and data.bones == (("nose", "neck"),)
    np.testing.assert_array_equal(data.keypoints, points.reshape(6, 3, 2))
    assert data.confidence[3].tolist() == [1, 1, 0] and data.confidence[5].tolist() == [1, 0.5, 1]
    assert len(set(data.identity["instance"])) >= 2


def test_what_sleap_io_writes(tmp_path) -> None:
    sio = pytest.importorskip("sleap_io")
    pytest.importorskip("pynwb")
    skeleton = sio.Skeleton(list(NODES), edges=[("neck", "nose")], name="fly")
    tracks, video, random = [sio.Track("him"), sio.Track("her")], sio.Video("films/a.mp4"), np.random.default_rng(0)
    points, score = random.random((3, 2, 3, 2)) * 99, random.random((3, 2, 3))
    frames = [
        sio.LabeledFrame(
            video=video,
            frame_idx=number,
            instances=[
                sio.PredictedInstance.from_numpy(points[number, n], skeleton, score[number, n], 0.5, track=track)
                for n, track in enumerate(tracks)
            ],
        )
        for number in range(3)
    ]
    sio.save_nwb(sio.Labels(frames), str(tmp_path / "a.nwb"))
    data = read(tmp_path / "a.nwb")
    assert data.bones == (("neck", "nose"),) and data.fps is None and len(data) == 6
    for number in range(3):
        for place, name in enumerate(("him", "her")):
            for joint, node in enumerate(NODES):
                wanted = (*points[number, place, joint], score[number, place, joint])
                assert at(data, node, frame=number, instance=name, sequence="a") == pytest.approx(wanted, rel=1e-5)


def test_frames_are_those_of_all_series_together(tmp_path) -> None:
    stamps = {"nose": [1.0, 1.04, 1.08, 1.2], "neck": [1.04, 1.08, 1.12, 1.1999999999]}
    one = body("nose", "neck", stamps=stamps)
    data = read(write_nwb(tmp_path / "a.nwb", {"behavior/pose": one}))
    assert data.joint_names == NODES and data.fps == 25
    assert (data.identity["frame"] - data.identity["frame"][0]).tolist() == [0, 1, 2, 3, 5]
    seen = data.confidence > 0
    assert seen[:, 0].tolist() == [True, True, True, False, True]
    assert seen[:, 1].tolist() == [False, True, True, True, True] and not seen[:, 2].any()
    np.testing.assert_array_equal(data.keypoints[seen[:, 1], 1], one["series"]["neck"])


def test_bodies_and_videos_and_cameras(tmp_path) -> None:
    bodies = {
        "one/track=a": body(*NODES, original_videos=["x/clip.mp4"], dimensions=np.array([[640, 480]])),
        "one/track=b": body(*NODES, original_videos=["x/clip.mp4"], dimensions=np.array([[640, 480]]), seed=1),
        "two/track=a": body(*NODES, original_videos=["y/clip.mp4"], dimensions=np.array([[320, 240]]), seed=2),
    }
    data = read(write_nwb(tmp_path / "a.nwb", bodies))
    found = sorted(set(zip(data.identity["sequence"].tolist(), data.identity["instance"].tolist(), strict=True)))
    assert found == [("clip", "a"), ("clip", "b"), ("clip#2", "a")] and data.image_size is None
    assert data.identity["frame"].tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 0, 1, 2, 3]
    np.testing.assert_array_equal(data.keypoints[1, 0], bodies["one/track=b"]["series"]["nose"][0])

    path = write_nwb(tmp_path / "b.nwb", {f"behavior/{side}": body(*NODES) for side in ("left", "right")})
    assert set(read(path).identity["instance"]) == {"left", "right"}
    with h5py.File(path, "a") as file:
        for side in ("left", "right"):
            file.create_group(f"general/devices/{side} eye").attrs["neurodata_type"] = "Device"
            file[f"processing/behavior/{side}/device"] = h5py.SoftLink(f"/general/devices/{side} eye")
    data = read(path)
    assert set(data.identity["camera"]) == {"left eye", "right eye"} and "instance" not in data.identity


def test_nodes_of_other_names_are_not_used(tmp_path) -> None:
    data = read(write_nwb(tmp_path / "a.nwb", {"behavior/pose": body("PawLeft", "PawRight", samples=2)}))
    assert data.joint_names == ("PawLeft", "PawRight") and data.bones == ()
    data = read(write_nwb(tmp_path / "b.nwb", {"behavior/pose": body("b", "a")}, skeleton=None))
    assert data.joint_names == ("a", "b")


def test_units_and_third_coordinates_are_told(tmp_path) -> None:
    one = body("nose", unit="cm", conversion=2.0)
    one["series"]["nose"] = np.concatenate([one["series"]["nose"], np.ones((4, 1), "f4")], 1)
    data = read(write_nwb(tmp_path / "a.nwb", {"behavior/pose": one}))
    np.testing.assert_array_equal(data.keypoints[:, 0], 2 * one["series"]["nose"][:, :2])
    assert "third coordinate" in " ".join(data.notes) and "'cm', not pixels" in " ".join(data.notes)


def test_points_without_confidence_are_sure(tmp_path) -> None:
    one = body("nose") | {"score": None}
    one["series"]["nose"][1] = np.nan
    data = read(write_nwb(tmp_path / "a.nwb", {"behavior/pose": one}))
    assert data.identity["frame"].tolist() == [0, 2, 3] and (data.confidence[:, 0] == 1).all()


def test_stamps_that_do_not_rise(tmp_path) -> None:
    one = body("nose", "neck", stamps=[0, 0.1, 0.1, np.nan])
    data = read(write_nwb(tmp_path / "a.nwb", {"behavior/pose": one}))
    assert data.identity["frame"].tolist() == [0, 1, 2, 3] and data.fps is None
    assert "do not rise" in " ".join(data.notes)
    one["stamps"] = {"nose": [0, 0, 0, 0], "neck": [0, 1, 2]}
    one["series"]["neck"] = one["series"]["neck"][:3]
    with pytest.raises(UserError, match="which of them are of one frame is unknown"):
        read(write_nwb(tmp_path / "b.nwb", {"behavior/pose": one}))


@settings(max_examples=40)
@given(
    counts=st.lists(st.integers(1, 3), min_size=8, max_size=60),
    rate=st.sampled_from([1.0, 25.0, 29.97, 30.0, 200.0]),
    start=st.floats(0, 1e4),
    jitter=st.floats(0, 0.05),
)
def test_frame_numbers_of_even_stamps(counts, rate, start, jitter) -> None:
    counts = [1] * len(counts) + counts
    frames = np.append(0, np.cumsum(counts))
    noise = np.random.default_rng(0).uniform(-jitter, jitter, len(frames))
    numbers, step, even = frame_numbers(start + (frames + noise) / rate)
    assert even and step == pytest.approx(1 / rate, rel=0.05)
    np.testing.assert_array_equal(np.diff(numbers), counts)


def test_frame_numbers_of_uneven_stamps() -> None:
    numbers, step, even = frame_numbers(np.array([0.0, 1.0, 2.0, 2.5, 4.0]))
    assert numbers.tolist() == [0, 1, 2, 3, 4] and step is None and not even
    assert frame_numbers(np.array([7.25]))[0].tolist() == [0]
    assert frame_numbers(np.array([2.0, 2.04, 2.08]))[0].tolist() == [50, 51, 52]
    assert frame_numbers(np.array([0.0, 1e-300, 1e300]))[2] is False


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"data": np.zeros((4, 4))}, "has shape (4, 4), expected (samples, 2) or (samples, 3)"),
        ({"data": np.array(["x"], "S")}, "not an array of numbers"),
        ({"data": None}, "no array 'processing/behavior/pose/nose/data'"),
        ({"confidence": np.zeros(3)}, "'processing/behavior/pose/nose/confidence' has shape (3,), expected (4,)"),
        ({"confidence": np.zeros(4)}, "no visible keypoint"),
        ({"timestamps": np.zeros(3)}, "'processing/behavior/pose/nose/timestamps' has shape (3,), expected (4,)"),
        ({"timestamps": None}, "has no time stamps and the rate None"),
        ({"data": np.zeros((0, 2)), "confidence": np.zeros(0), "timestamps": np.zeros(0)}, "estimates are empty"),
        ({"data": h5py.ExternalLink("other.nwb", "data")}, "is a link to another file"),
        ({"data": h5py.SoftLink("/processing/behavior/pose/nose/data")}, "leads back to itself"),
    ],
)
def test_a_wrong_file_is_told(tmp_path, change, says) -> None:
    path = write_nwb(tmp_path / "a.nwb", {"behavior/pose": body("nose")})
    with h5py.File(path, "a") as file:
        group = file["processing/behavior/pose/nose"]
        for name, value in change.items():
            del group[name]
            if value is not None:
                group[name] = value
    with pytest.raises(UserError) as caught:
        read(path)
    assert says in str(caught.value) and "a.nwb" in str(caught.value)


def test_files_without_poses_and_links_to_others(tmp_path) -> None:
    path = write_nwb(tmp_path / "a.nwb", {})
    with pytest.raises(UserError, match="without pose estimates"):
        read(path)
    path = write_nwb(tmp_path / "b.nwb", {"behavior/pose": body("nose", "neck")})
    with h5py.File(path, "a") as file:
        file["acquisition/raw"] = h5py.ExternalLink("no such.nwb", "raw")  # usual, and nothing to do with poses
        file["processing/again"] = h5py.SoftLink("/processing")
        file["processing/behavior/up"] = file["processing"]
        del file["processing/behavior/pose/neck"]
        file["processing/behavior/pose/neck"] = h5py.ExternalLink("no such.nwb", "neck")
    data = read(path)
    assert len(data) == 4 and "lies in another file and is left out" in " ".join(data.notes)


def test_damaged_files_are_refused_or_read(tmp_path) -> None:
    two = {f"behavior/{name}": body("nose", "neck", original_videos=["a.mp4"]) for name in ("a", "b")}
    whole = write_nwb(tmp_path / "whole.nwb", two)
    found = outcomes(whole, lambda path: read(path, ReadOptions(format="nwb")), 48)
    assert not found["wrong"] and found["refused"] >= 14 and found["read"] >= 5 and found["lost"] <= 3


def test_a_size_that_sends_the_library_round_in_circles_is_refused(tmp_path: Path) -> None:
    path = write_nwb(tmp_path / "a.nwb", {"behavior/pose": body("nose")})
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL")
    content[heap + 24 : heap + 32] = (2**64 - 16).to_bytes(8, "little")  # size of its first text
    path.write_bytes(content)
    with pytest.raises(UserError, match="longer than the space"):
        read(path)
