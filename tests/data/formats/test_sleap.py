"""SLEAP's projects and analysis files are read as sleap-io reads them, and nothing hostile gets through."""

from __future__ import annotations

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from tracker_files_hdf5 import (
    ANALYSIS_ORDERS,
    NODES,
    instance,
    outcomes,
    skeleton_json,
    some_points,
    write_analysis,
    write_slp,
)

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData
from uplift.errors import UserError

SLP_FILES = (
    "minimal_instance.slp",
    "small_robot_minimal.slp",
    "clip.2node.slp",
    "predictions_1.2.7_provenance_and_tracking.slp",
)


def at(data: PoseData, joint: str, **where: object) -> tuple[float, float, float]:
    """Return x, y and confidence of the joint in the one row where identity is as given."""
    rows = np.logical_and.reduce([data.identity[key] == value for key, value in where.items()])
    (row,) = np.flatnonzero(rows)
    column = data.joint_names.index(joint)
    return (*data.keypoints[row, column].tolist(), float(data.confidence[row, column]))


def close(*expected: float) -> object:
    return pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "joint", "where", "expected"),
    [
        ("minimal_instance.slp", "A", {"frame": 0, "instance": "0"}, (92.65221, 202.726, 1)),
        ("clip.2node.slp", "head", {"frame": 0, "instance": "male"}, (335.25, 444.75, 1)),
        ("clip.2node.slp", "head", {"frame": 1499, "instance": "male"}, (722.75, 428.25, 1)),
        ("small_robot_minimal.slp", "A", {"frame": 0}, (316.4897, 47.69157, 1)),
        ("small_robot_minimal.slp", "A", {"frame": 79}, (316.4897, 47.52269, 1)),
    ],
)
def test_real_projects(benchmark_data, name, joint, where, expected) -> None:
    assert at(read(benchmark_data(f"trackers/sleap/{name}")), joint, **where) == close(*expected)


def test_real_predictions(benchmark_data) -> None:
    data = read(benchmark_data("trackers/sleap/predictions_1.2.7_provenance_and_tracking.slp"))
    assert at(data, "head", frame=0, instance="track_0")[:2] == close(196.7331, 480.9383)
    assert at(data, "head", frame=100, instance="track_0")[:2] == close(616.2084, 432.2501)
    assert (len(data), len(data.joint_names), len(data.bones)) == (201, 13, 12)
    assert set(data.identity["sequence"]) == {"20190128_113421"}
    assert data.confidence.max() == 1 and 0.99 < (data.confidence > 0).mean() < 1


def test_real_analysis_files(benchmark_data) -> None:
    data = read(benchmark_data("trackers/sleap/centered_pair_standard.analysis.h5"))
    assert at(data, "head", frame=0, instance="1")[0] == 201
    assert at(data, data.joint_names[22], frame=1099, instance="27")[1] == 192
    assert 2 * int((data.confidence == 0).sum()) == 1328360 - 2 * 24 * (1100 * 27 - len(data))
    assert len(data.joint_names) == 24 and len(data.mirror) == 10
    old = read(benchmark_data("trackers/sleap/small_robot.000_small_robot_3_frame.analysis.h5"))
    assert old.joint_names == ("top", "front", "rear") and "instance" not in old.identity
    assert at(old, "top", frame=0)[0] == pytest.approx(322.87601, rel=1e-6)
    assert at(old, "rear", frame=2)[1] == pytest.approx(181.86606, rel=1e-6)
    assert at(old, "top", frame=1)[2] == pytest.approx(0.74868906) and at(old, "top", frame=0)[2] == 1


@pytest.mark.parametrize("name", SLP_FILES)
def test_projects_as_sleap_io_reads_them(benchmark_data, name) -> None:
    path = benchmark_data(f"trackers/sleap/{name}")
    assert_as_sleap_io(read(path), path)


def assert_as_sleap_io(data: PoseData, path: Path) -> None:
    """Hold rows, names and lines of a project against what sleap-io says."""
    sleap_io = pytest.importorskip("sleap_io")
    labels = sleap_io.load_slp(str(path), open_videos=False)
    skeleton = labels.skeletons[0]
    assert data.joint_names == tuple(skeleton.node_names)
    assert data.bones == tuple((edge.source.name, edge.destination.name) for edge in skeleton.edges)
    assert {frozenset(pair) for pair in data.mirror} == {
        frozenset(node.name for node in pair.nodes) for pair in skeleton.symmetries
    }
    found = list(zip(data.identity["frame"].tolist(), np.nan_to_num(data.keypoints).tolist(), strict=True))
    expected = [
        (frame.frame_idx, np.nan_to_num(one.numpy().astype(np.float32)).tolist())
        for frame in labels
        for one in [*frame.user_instances, *frame.unused_predictions]
        if one.n_visible
    ]
    assert len(found) and sorted(found) == sorted(expected)


@pytest.fixture
def labels():
    """Return labels of two videos with labelled and predicted instances, as sleap-io holds them."""
    sio = pytest.importorskip("sleap_io")
    skeleton = sio.Skeleton(list(NODES), edges=[("neck", "nose"), ("neck", "tail")], symmetries=[("nose", "tail")])
    tracks = [sio.Track("him"), sio.Track("her")]
    videos = [sio.Video(filename="films/one.mp4"), sio.Video(filename="films/two.avi")]
    random, frames = np.random.default_rng(0), []
    for video in videos:
        for number in range(4):
            made = [
                sio.PredictedInstance.from_numpy(
                    random.random((3, 2)) * 100, skeleton, point_scores=random.random(3), score=0.5, track=track
                )
                for track in tracks
            ]
            made[0].points["visible"][1] = made[0].points["xy"][1, 0] < 50
            if number % 2:
                made.append(
                    sio.Instance.from_numpy(random.random((3, 2)), skeleton, track=tracks[0], from_predicted=made[0])
                )
            frames.append(sio.LabeledFrame(video=video, frame_idx=3 * number, instances=made))
    return sio.Labels(frames)


def test_what_sleap_io_writes_as_project(labels, tmp_path) -> None:
    labels.save(str(tmp_path / "a.slp"))
    data = read(tmp_path / "a.slp")
    assert_as_sleap_io(data, tmp_path / "a.slp")
    assert set(data.identity["sequence"]) == {"one", "two"} and set(data.identity["instance"]) == {"him", "her"}
    assert "4 predicted instances are left out" in " ".join(data.notes)
    predicted = labels[0].instances[1]
    x, y, score = at(data, "nose", sequence="one", frame=0, instance="her")
    assert (x, y, score) == close(*predicted.numpy()[0], predicted.points["score"][0])


@pytest.mark.parametrize("preset", ["matlab", "standard"])
def test_what_sleap_io_writes_as_analysis(labels, tmp_path, preset) -> None:
    sio = pytest.importorskip("sleap_io")
    labels.save(str(tmp_path / "a.slp"))
    sio.save_analysis_h5(labels, str(tmp_path / "a.h5"), video=labels.videos[0], preset=preset)
    whole, data = read(tmp_path / "a.slp"), read(tmp_path / "a.h5")
    of_one = whole.select(whole.identity["sequence"] == "one")
    assert data.joint_names == NODES and data.bones == whole.bones and data.mirror == whole.mirror
    for frame, name in zip(of_one.identity["frame"], of_one.identity["instance"], strict=True):
        for joint in NODES:
            where = {"frame": frame, "instance": name, "sequence": "one"}
            np.testing.assert_array_equal(at(data, joint, **where), at(of_one, joint, **where))


@pytest.mark.parametrize("order", ANALYSIS_ORDERS)
@pytest.mark.parametrize("say", [True, False])
def test_axes_of_an_analysis_file_in_any_order(tmp_path, order, say) -> None:
    points = some_points(4, 5, 3)
    points[1, 2], points[2, 3, 1] = np.nan, np.nan
    score = np.random.default_rng(1).random((4, 5, 3)).astype("f4") + 0.1
    data = read(write_analysis(tmp_path / "a.analysis.h5", points, score, order, say))
    assert len(data) == 19 and data.joint_names == NODES and data.bones == (("nose", "neck"), ("neck", "tail"))
    assert set(data.identity["sequence"]) == {"mouse.one"}
    for row, (frame, name) in enumerate(zip(data.identity["frame"], data.identity["instance"], strict=True)):
        expected = points[frame, int(name)].astype("f4")
        np.testing.assert_array_equal(data.keypoints[row], expected)
        seen = np.isfinite(expected[:, 0])
        np.testing.assert_array_equal(data.confidence[row], np.where(seen, score[frame, int(name)].clip(0, 1), 0))


def test_points_without_a_score_were_set_by_hand(tmp_path) -> None:
    score = np.array([[[np.nan] * 3], [[0.5, 0, 1.25]]])
    data = read(write_analysis(tmp_path / "a.h5", some_points(2, 1, 3), score))
    assert data.confidence.tolist() == [[1, 1, 1], [0.5, 0, 1]]
    data = read(write_analysis(tmp_path / "b.h5", some_points(2, 1, 3), np.zeros((2, 1, 3))))
    assert (data.confidence == 1).all() and "all scores are 0" in " ".join(data.notes)


def test_tracks_of_one_name_are_told_apart(tmp_path) -> None:
    named = np.array(["a", "a"], "S")
    data = read(write_analysis(tmp_path / "a.h5", some_points(2, 2, 3), np.ones((2, 2, 3)), track_names=named))
    assert sorted(set(data.identity["instance"])) == ["a", "a#2"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"node_names": np.array(["a", "b"], "S")}, "expected 2 along 'xy' and 2 along 'node'"),
        ({"node_names": np.array(["a", "b", "a"], "S")}, "each once"),
        ({"node_names": None}, "no array 'node_names'"),
        ({"tracks": None}, "no array 'tracks'"),
        ({"tracks": np.zeros((2, 2))}, "'tracks' has shape (2, 2)"),
        ({"tracks": np.array(["x"], "S")}, "not an array of numbers"),
        ({"tracks": np.full((2, 2, 3, 2), np.nan)}, "no visible keypoint"),
        ({"point_scores": np.zeros((2, 3, 3))}, "'point_scores' has shape (2, 3, 3)"),
        ({"track_names": np.array(["a"], "S")}, "1 names in 'track_names' for 2 tracks"),
    ],
)
def test_a_wrong_analysis_file_is_told(tmp_path, change, says) -> None:
    path = write_analysis(tmp_path / "a.h5", some_points(2, 2, 3), np.ones((2, 2, 3)), **change)
    with pytest.raises(UserError) as caught:
        read(path, ReadOptions(format="sleap_h5"))
    assert says in str(caught.value) and "a.h5" in str(caught.value)


def test_nodes_are_in_the_order_of_their_skeleton(tmp_path) -> None:
    body = skeleton_json(2, 0, 1, links=((1, 0, 2), (2, 2, 1), (1, 0, 1), (2, 1, 2)))
    points = some_points(3)
    data = read(write_slp(tmp_path / "a.slp", [(0, 7, [instance(points)])], [{"nx_graph": body}]))
    assert data.joint_names == ("tail", "nose", "neck")
    assert data.bones == (("nose", "tail"), ("nose", "neck")) and data.mirror == (("tail", "neck"),)
    np.testing.assert_array_equal(data.keypoints[0], points)
    assert data.identity["frame"].tolist() == [7] and "instance" not in data.identity


@pytest.mark.parametrize(("format_id", "shift"), [(None, 0.5), (1.0, 0.5), (1.1, 0), (1.9, 0)])
def test_old_projects_measure_from_the_corner_of_pixels(tmp_path, format_id, shift) -> None:
    points = some_points(3)
    made = [instance(points), instance(points + 90, kind=1)]
    data = read(write_slp(tmp_path / "a.slp", [(0, 0, made)], format_id=format_id))
    np.testing.assert_array_equal(data.keypoints, np.stack([points, points + 90]) - shift)


def test_what_cannot_be_seen_is_missing(tmp_path) -> None:
    points = some_points(3)
    points[2] = np.nan
    frames = [
        (0, 0, [instance(points, visible=[True, False, True])]),
        (0, 1, [instance(points, visible=False)]),
        (0, 2, []),
    ]
    data = read(write_slp(tmp_path / "a.slp", frames))
    assert data.identity["frame"].tolist() == [0] and data.confidence.tolist() == [[1, 0, 0]]


def test_labels_stand_in_the_place_of_predictions(tmp_path) -> None:
    a, b, c, d = (some_points(3, seed=seed) for seed in range(4))
    frames = [
        (0, 0, [instance(a, kind=1, track=0), instance(b, kind=1, track=1), instance(c, track=0)]),
        (0, 1, [instance(a, kind=1, track=-1), instance(d, **{"from": 3})]),
        (0, 2, [instance(a, track=0), instance(b, track=0)]),
    ]
    data = read(write_slp(tmp_path / "a.slp", frames, tracks=("x", "y")))
    found = list(zip(data.identity["frame"].tolist(), data.identity["instance"].tolist(), strict=True))
    assert found == [(0, "y"), (0, "x"), (1, "untracked 0"), (2, "x")]
    np.testing.assert_array_equal(data.keypoints, np.stack([b, c, d, a]))
    assert "2 predicted instances are left out" in data.notes[1] and "only the first" in data.notes[2]


def test_bodies_without_tracks_are_linked_by_place(tmp_path) -> None:
    left, right = some_points(3), some_points(3) + 5000
    frames = [(0, n, [instance(left + n), instance(right + n)][:: 1 - 2 * (n % 2)]) for n in range(4)]
    data = read(write_slp(tmp_path / "a.slp", frames))
    for name in "01":
        assert len(set(data.keypoints[data.identity["instance"] == name][:, 0, 0] > 4000)) == 1
    assert "linked by place" in " ".join(data.notes)


def test_several_videos_are_several_sequences(tmp_path) -> None:
    shape = {"shape": [9, 480, 640, 1], "fps": 25}
    videos = [
        {"backend": {"filename": "day 1/a.mp4", **shape}},
        {"backend": {"filename": "day 2\\a.mp4", **shape}},
        {"filename": "x", "backend": {"filename": ["p/stills/0.png", "p/stills/1.png"], **shape}},
    ]
    frames = [(video, 3, [instance(some_points(3, seed=video))]) for video in (2, 0, 1)]
    data = read(write_slp(tmp_path / "a.slp", frames, videos=videos))
    assert data.identity["sequence"].tolist() == ["day 1/a", "day 2/a", "stills"]
    assert (data.image_size, data.fps) == ((640, 480), 25)
    videos[1]["backend"].pop("shape")
    data = read(write_slp(tmp_path / "a.slp", frames, videos=videos))
    assert (data.image_size, data.fps) == (None, 25)


def test_pictures_inside_a_project_are_named_after_their_video(tmp_path) -> None:
    videos = [{"backend": {"filename": ".", "dataset": f"video{n}/video"}} for n in (4, 9)]
    frames = [(video, 3, [instance(some_points(3, seed=video))]) for video in (4, 9)]
    path = write_slp(tmp_path / "a.pkg.slp", frames, videos=videos)
    with h5py.File(path, "a") as file:
        source = file.create_group("video9/source_video")
        source.attrs["json"] = json.dumps({"backend": {"filename": "/films/open field.avi"}})
    assert read(path).identity["sequence"].tolist() == ["a.pkg_video4", "open field"]


def test_several_skeletons_are_several_categories(tmp_path) -> None:
    bodies = [skeleton_json(0, 1, name="fly"), skeleton_json(2, 1, name="mouse")]
    frames = [(0, 0, [instance(some_points(2, seed=1)), instance(some_points(2, seed=2), skeleton=1, track=0)])]
    data = read(write_slp(tmp_path / "a.slp", frames, bodies, tracks=("t",)))
    assert data.joint_names == NODES and data.identity["category"].tolist() == ["fly", "mouse"]
    assert (data.confidence > 0).tolist() == [[True, True, False], [False, True, True]]
    np.testing.assert_array_equal(data.keypoints[1, ::-1][:2], some_points(2, seed=2))


def test_tables_as_columns_of_one_array(tmp_path) -> None:
    frames = [(0, n, [instance(some_points(3, seed=n), kind=n % 2, track=0)]) for n in range(5)]
    table, columns = (
        read(write_slp(tmp_path / f"{how}.slp", frames, tracks=("a",), columns=how)) for how in (False, True)
    )
    np.testing.assert_array_equal(table.keypoints, columns.keypoints)
    np.testing.assert_array_equal(table.confidence, columns.confidence)
    assert table.identity.keys() == columns.identity.keys()


def broken(path: Path, **change: object) -> Path:
    """Write a project of two frames, and change arrays, columns ("table.column") or attributes ("metadata@key")."""
    frames = [(0, n, [instance(some_points(3, seed=n), track=0)]) for n in range(2)]
    write_slp(path, frames, tracks=("a",))
    with h5py.File(path, "a") as file:
        for name, value in change.items():
            if name.startswith("metadata_"):
                file["metadata"].attrs[name.removeprefix("metadata_")] = value
            elif "__" in name:
                table, column = name.split("__")
                rows = file[table][()]
                rows[column] = value
                file[table][()] = rows
            else:
                del file[name]
                if value is not None:
                    file[name] = value
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"frames__instance_id_end": [1, 9]}, "instances that are not among the 2"),
        ({"frames__instance_id_start": [1, 3]}, "instances that are not among the 2"),
        ({"frames__instance_id_end": [2, 2]}, "instances that are not among the 2"),
        ({"frames__frame_idx": [0, 2**63]}, "'frame_idx' of 'frames' holds 9223372036854775808"),
        ({"frames__frame_idx": [0, 2**61]}, "column 'frame' goes"),
        ({"frames__video": [0, 5]}, "frames are of video 5"),
        ({"instances__skeleton": 1}, "column 'skeleton' goes"),
        ({"instances__track": 7}, "column 'track' goes"),
        ({"instances__instance_type": 3}, "column 'instance_type' goes"),
        ({"instances__point_id_end": 4}, "an instance has 4 points, its skeleton 3 nodes"),
        ({"instances__point_id_start": 60, "instances__point_id_end": 63}, "points that are not among the 6"),
        ({"points__visible": False}, "no visible keypoint"),
        ({"points": np.zeros(3)}, "'points' is not a table"),
        ({"instances": None}, "no array 'instances'"),
        ({"videos_json": np.array(["{"], "S")}, "entry 0 of 'videos_json' is not valid JSON"),
        ({"videos_json": np.array(["[" * 10**5], "S")}, "entry 0 of 'videos_json' is not valid JSON"),
        ({"videos_json": np.array(["[]"], "S")}, "'videos_json' is not as SLEAP writes it"),
        ({"tracks_json": np.array(["3"], "S")}, "'tracks_json' is not as SLEAP writes it"),
        ({"metadata_json": "{}"}, "skeletons in the metadata are not as SLEAP writes them"),
        ({"metadata_json": '{"nodes": [], "skeletons": [{"nodes": [{"id": 0}], "links": []}]}'}, "skeletons in the"),
        ({"metadata_format_id": 3.0}, "SLEAP's format 3"),
    ],
)
def test_a_wrong_project_is_told(tmp_path, change, says) -> None:
    with pytest.raises(UserError) as caught:
        read(broken(tmp_path / "a.slp", **change), ReadOptions(format="sleap_slp"))
    assert says in str(caught.value) and "a.slp" in str(caught.value)


def test_values_that_are_no_numbers_are_missing(tmp_path) -> None:
    data = read(broken(tmp_path / "a.slp", points__x=[1, 1e300, np.inf, 3, -np.inf, np.nan]))
    assert (data.confidence > 0).tolist() == [[True, False, False], [True, False, False]]


def test_nothing_outside_the_file_is_read(tmp_path) -> None:
    other = write_analysis(tmp_path / "other.h5", some_points(2, 2, 3), np.ones((2, 2, 3)))
    path = write_analysis(tmp_path / "a.h5", some_points(2, 2, 3), np.ones((2, 2, 3)))
    with h5py.File(path, "a") as file:
        del file["tracks"]
        file["tracks"] = h5py.ExternalLink(other.name, "tracks")
    with pytest.raises(UserError, match="'/tracks' is a link to another file"):
        read(path, ReadOptions(format="sleap_h5"))
    with h5py.File(path, "a") as file:
        del file["tracks"]
        file.create_dataset("tracks", (2, 2, 3, 2), "f8", external=[(str(other), 0, 192)])
    with pytest.raises(UserError, match="no values in this file"):
        read(path)
    with h5py.File(path, "a") as file:
        del file["tracks"]
        layout = h5py.VirtualLayout((2, 2, 3, 2), "f8")
        layout[:] = h5py.VirtualSource(str(other), "tracks", (2, 2, 3, 2))
        file.create_virtual_dataset("tracks", layout)
    with pytest.raises(UserError, match="no values in this file"):
        read(path)
    with h5py.File(path, "a") as file:
        del file["tracks"]
        file["tracks"] = h5py.SoftLink("/tracks")
    with pytest.raises(UserError):
        read(path, ReadOptions(format="sleap_h5"))


def test_no_memory_is_taken_on_the_word_of_a_file(tmp_path) -> None:
    path = write_analysis(tmp_path / "a.h5", some_points(2, 2, 3), np.ones((2, 2, 3)))
    with h5py.File(path, "a") as file:
        del file["tracks"]
        file.create_dataset("tracks", (10**6, 50, 3, 2), "f8", chunks=(100, 50, 3, 2), compression="gzip")
    assert os.path.getsize(path) < 100_000
    with pytest.raises(UserError, match="claims 2,400,000,000 bytes but holds 0"):
        read(path)


@pytest.mark.parametrize("kind", ["slp", "h5"])
def test_damaged_files_are_refused_or_read(tmp_path, kind) -> None:
    whole = tmp_path / f"whole.{kind}"
    if kind == "slp":
        frames = [(0, n, [instance(some_points(3), track=0), instance(some_points(3), kind=1)]) for n in range(3)]
        write_slp(whole, frames, tracks=("a",))
    else:
        write_analysis(whole, some_points(5, 2, 3), np.ones((5, 2, 3)))
    assert KEYPOINT_FORMATS.guess(whole).name == f"sleap_{kind}"
    found = outcomes(whole, lambda path: read(path, ReadOptions(format=f"sleap_{kind}")), 48)
    assert not found["wrong"] and found["refused"] >= 14 and found["read"] >= 5 and found["lost"] <= 3


@pytest.mark.parametrize("content", [b"", b"no HDF5", b"\x89HDF\r\n\x1a\n" + b"\0" * 600])
@pytest.mark.parametrize("name", ["sleap_slp", "sleap_h5", "nwb", "jabs"])
def test_what_is_no_hdf5_is_refused(tmp_path, content, name) -> None:
    (tmp_path / "a.slp").write_bytes(content)
    with pytest.raises(UserError):
        read(tmp_path / "a.slp", ReadOptions(format=name))
    with pytest.raises(UserError):
        read(tmp_path, ReadOptions(format=name))
