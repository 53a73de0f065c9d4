"""Human3.6M out of each kind of its files: what was written comes back, and what is wrong is told."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path

import h36m_files as written
import numpy as np
import pytest
from bodies import refusal

from uplift.config.loading import load_settings
from uplift.data.datasets import read_cached
from uplift.data.datasets.h36m import Human36M
from uplift.data.datasets.h36m_files import ACTIONS, CAMERAS, OF_32, published
from uplift.data.formats.layouts import H36M_JOINTS as JOINTS
from uplift.data.formats.layouts import HOURGLASS_JOINTS
from uplift.data.load import load_data
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

TEST = ("S9", "S11")
FAMILIES = ("videopose3d", "pickles", "martinez", "cdf")


def of(subjects=TEST, numbers: bool = True) -> written.World:
    """Return the simulated world of some subjects, with the numbered sequences or without."""
    return {
        s: {n: p for n, p in written.world()[s].items() if numbers or not n.endswith("1")} for s in subjects
    }  # fmt: skip


@pytest.fixture(scope="module")
def there(tmp_path_factory) -> Callable[[str], Path]:
    """Return a function from a kind of files to a folder with the test split in it, written once."""
    made: dict[str, Path] = {}

    def folder(family: str) -> Path:
        if family not in made:
            made[family] = tmp_path_factory.mktemp(family)
            if family in ("martinez", "cdf"):
                pytest.importorskip("h5py" if family == "martinez" else "cdflib")
            write = {
                "videopose3d": lambda at: written.write_videopose3d(at, ("gt", "cpn", "sh"), of()),
                "pickles": lambda at: written.write_pickles(at, of()),
                "martinez": lambda at: written.write_martinez(at, of(numbers=False)),
                "cdf": lambda at: written.write_cdf(at, of(numbers=False)),
            }
            write[family](made[family])
        return made[family]

    return folder


def rows(data, subject: str, sequence: str, camera: str) -> np.ndarray:
    keys = data.identity
    return np.flatnonzero(
        (keys["subject"] == subject) & (keys["sequence"] == sequence) & (keys["camera"] == camera)
    )  # fmt: skip


def reprojected(data) -> np.ndarray:
    seen = np.empty_like(data.keypoints)
    for number, lens in enumerate(data.lenses):
        mine = data.lens == number
        seen[mine] = lens.project((data.pose + data.root[:, None])[mine])
    return seen


@pytest.mark.parametrize("family", FAMILIES)
def test_what_was_written_comes_back(there, family):
    data = Human36M(there(family), fps=50, source=family).read("test")
    assert data.joint_names == JOINTS == load_skeleton("h36m17").joints
    assert (data.fps, data.unit) == (50, "mm")
    assert data.keypoints.dtype == data.pose.dtype == data.root.dtype == data.confidence.dtype == np.float32
    assert (data.confidence == 1).all()
    for subject, sequence, camera in (("S9", "Walking", CAMERAS[0]), ("S11", "SittingDown", CAMERAS[3])):
        mine = rows(data, subject, sequence, camera)
        points = written.world()[subject][sequence][:, OF_32]
        assert (
            np.abs(data.pose[mine] + data.root[mine][:, None] - written.in_camera(points, subject, camera)).max() < 0.01
        )
        assert (data.pose[mine][:, 0] == 0).all()
        seen = written.project(points, subject, camera, swapped=family == "videopose3d")
        assert np.abs(data.keypoints[mine] - seen).max() < 0.002
        assert list(data.identity["frame"][mine]) == list(range(len(points)))
    assert np.abs(reprojected(data) - data.keypoints).max() < 0.002  # the lenses are those of the files
    assert f"({family}, " in data.source and str(there(family)) in data.source


@pytest.mark.parametrize("family", FAMILIES)
def test_who_what_and_when(there, family):
    data = Human36M(there(family), fps=10, source=family).read("test")
    every = Human36M(there(family), fps=50, source=family).read("test")
    keys = data.identity
    assert list(dict.fromkeys(keys["subject"])) == ["S9", "S11"]
    assert tuple(dict.fromkeys(keys["action"][keys["subject"] == "S9"])) == ACTIONS
    assert set(keys["camera"]) == set(CAMERAS)
    assert all(s.split(" ")[0] == a for s, a in zip(keys["sequence"], keys["action"], strict=True))
    assert data.fps == 10 and set(np.unique(keys["frame"] % 5)) == {0}
    fifth = every.identity["frame"] % 5 == 0
    assert np.array_equal(every.keypoints[fifth], data.keypoints) and np.array_equal(every.pose[fifth], data.pose)
    starts = np.flatnonzero(np.diff(data.clips())) + 1
    assert len(starts) + 1 == len(np.unique(data.clips()))  # a clip stands together
    assert (~data.follows()[starts]).all() and data.follows().sum() == len(data) - len(starts) - 1


@pytest.mark.parametrize("family", FAMILIES)
def test_the_corrupt_video_is_left_out(there, family):
    data = Human36M(there(family), source=family).read("test")
    left = {c: len(rows(data, "S11", "Directions", c)) > 0 for c in CAMERAS}
    # VideoPose3D leaves the whole sequence out, and the authors of 2018 its second take by that camera as well.
    assert left == {c: c != CAMERAS[0] and family != "videopose3d" for c in CAMERAS}
    assert all(len(rows(data, "S9", "Directions", c)) for c in CAMERAS)
    if family in ("videopose3d", "pickles"):
        assert (len(rows(data, "S11", "Directions 1", CAMERAS[0])) == 0) == (family == "pickles")


def test_gravity_is_where_the_tilt_says(there):
    data = Human36M(there("pickles")).read("test")
    for subject in TEST:
        for camera in CAMERAS:
            tilt = np.radians(data.tilt_deg[rows(data, subject, "Eating", camera)[0]])
            down = written.rotation(subject, camera) @ [0, 0, -1]
            assert np.degrees(np.arccos(down @ [0, np.cos(tilt), np.sin(tilt)])) < 4.5  # the cameras roll a little
            assert down[1] > 0.9


@pytest.mark.parametrize("family", ["videopose3d", "pickles", "martinez"])
def test_the_hourglass_network_has_no_nose(there, family):
    data = Human36M(there(family), "sh", 50, family).read("test")
    nose = JOINTS.index("nose")
    assert (data.confidence[:, nose] == 0).all() and (data.keypoints[:, nose] == 0).all()
    assert (np.delete(data.confidence, nose, 1) == 1).all()
    mine = rows(data, "S9", "Smoking", CAMERAS[1])
    points = written.world()["S9"]["Smoking"]
    more = 1 if family == "videopose3d" else 0
    seen = written.detections(points, "S9", CAMERAS[1], more)[: len(points)]
    assert np.array_equal(np.delete(data.keypoints[mine], nose, 1), np.delete(seen, nose, 1))
    off = np.abs(reprojected(data) - data.keypoints)[data.confidence > 0]
    assert 1 < off.mean() < 4


def test_a_nose_that_the_pickles_did_not_make_up_is_kept(tmp_path, there):
    for name in ("points_3d.pkl", "cameras.pkl"):
        os.symlink(there("pickles") / name, tmp_path / name)
    seen = pickle.loads((there("pickles") / "sh_detect_2d.pkl").read_bytes())
    for views in (views for of_one in seen.values() for views in of_one.values()):
        for view in views.values():
            view.reshape(-1, 17, 2)[:, 9] += 7
    (tmp_path / "sh_detect_2d.pkl").write_bytes(pickle.dumps(seen))
    assert (Human36M(tmp_path, "sh").read("test").confidence == 1).all()


def test_the_network_of_mpii_has_its_own_thorax(there):
    data = Human36M(there("martinez"), "sh_mpii", 50).read("test")
    mine = rows(data, "S9", "Posing", CAMERAS[2])
    seen = written.detections(written.world()["S9"]["Posing"], "S9", CAMERAS[2])[:, written.HOURGLASS]
    at = {joint: data.keypoints[mine, number] for number, joint in enumerate(JOINTS)}
    assert np.array_equal(at["thorax"], seen[:, 7]) and np.allclose(at["spine"], (seen[:, 6] + seen[:, 7]) / 2)
    assert np.array_equal(at["headtop"], seen[:, 9]) and np.array_equal(at["rknee"], seen[:, 1])
    assert HOURGLASS_JOINTS[7] == "spine"  # of the network that was trained on Human3.6M


def test_detections_that_are_longer_are_cut(there):
    data = Human36M(there("videopose3d"), "cpn", 50).read("test")
    for number, camera in enumerate(CAMERAS):
        points = written.world()["S9"]["Eating"]
        mine = rows(data, "S9", "Eating", camera)
        assert len(mine) == len(points)
        seen = written.detections(points, "S9", camera, more=number)[: len(points)]
        assert np.array_equal(data.keypoints[mine], seen)


def edited(there, tmp_path: Path, name: str, change: Callable, family: str = "videopose3d") -> Path:
    """Return a folder with the files of a kind, one of them changed: an npz's dict or a pickle."""
    for path in there(family).iterdir():
        if path.name != name:
            os.symlink(path, tmp_path / path.name)
    if name.endswith(".pkl"):
        value = pickle.loads((there(family) / name).read_bytes())
        (tmp_path / name).write_bytes(pickle.dumps(change(value) or value))
    else:
        with np.load(there(family) / name, allow_pickle=True) as file:
            arrays = {key: file[key].item() for key in file.files}
        arrays = change(arrays) or arrays
        np.savez(tmp_path / name, **{key: written.boxed(value) for key, value in arrays.items()})
    return tmp_path


GT, POSES = "data_2d_h36m_gt.npz", "data_3d_h36m.npz"


def test_detections_that_are_shorter_cut_the_truth(there, tmp_path):
    def change(arrays):
        views = arrays["positions_2d"]["S9"]["Eating"]
        views[2] = views[2][:-3]
        views[3] = None

    data = Human36M(edited(there, tmp_path, GT, change), fps=50).read("test")
    length = len(written.world()["S9"]["Eating"])
    assert [len(rows(data, "S9", "Eating", c)) for c in CAMERAS] == [length, length, length - 3, 0]
    assert np.abs(reprojected(data) - data.keypoints).max() < 0.002


def test_confidence_is_read_where_there_is_any(there, tmp_path):
    def change(arrays):
        for subject in arrays["positions_2d"].values():
            for views in subject.values():
                views[:] = [np.concatenate([v, np.full_like(v[..., :1], 0.25)], -1) for v in views]
        arrays["positions_2d"]["S9"]["Eating"][0][0, 5, 0] = np.nan

    data = Human36M(edited(there, tmp_path, GT, change), fps=50).read("test")
    first = rows(data, "S9", "Eating", CAMERAS[0])[0]
    assert data.confidence[first, 5] == 0 and (data.keypoints[first, 5] == 0).all()
    data.confidence[first, 5] = 0.25
    assert (data.confidence == 0.25).all()


def test_coco_detections_are_built_into_our_joints(there, tmp_path):
    coco = {"num_joints": 17, "keypoints_symmetry": [[1, 3, 5, 7, 9, 11, 13, 15], [2, 4, 6, 8, 10, 12, 14, 16]]}

    def change(arrays):
        arrays["metadata"] = coco
        for subject in arrays["positions_2d"].values():
            for views in subject.values():
                for view in views:  # nose, eyes, ears, shoulders, elbows, wrists, hips, knees, ankles; left first
                    view[:] = view[:, [9, 9, 9, 9, 9, 11, 14, 12, 15, 13, 16, 4, 1, 5, 2, 6, 3]]

    data = Human36M(edited(there, tmp_path, GT, change), fps=50).read("test")
    whole = Human36M(there("videopose3d"), fps=50).read("test")
    for joint in ("lknee", "rwrist", "rshoulder", "nose"):
        at = JOINTS.index(joint)
        assert np.array_equal(data.keypoints[:, at], whole.keypoints[:, at])
    assert (data.confidence[:, JOINTS.index("headtop")] == 0).all()
    hips = whole.keypoints[:, [JOINTS.index("lhip"), JOINTS.index("rhip")]]
    assert np.allclose(data.keypoints[:, 0], hips.mean(1), atol=1e-3)


def test_without_the_ground_truth_it_is_projected(there, tmp_path):
    os.symlink(there("videopose3d") / POSES, tmp_path / POSES)
    whole = Human36M(there("videopose3d")).read("test")
    made = Human36M(tmp_path).read("test")
    assert np.abs(whole.keypoints - made.keypoints).max() < 0.002
    assert "projected from the 3D" in made.source and "projected" not in whole.source
    assert [file.path.name for file in Human36M(tmp_path).files("test")] == [POSES]
    real = Human36M(tmp_path, "projected").read("test")
    assert 0.05 < np.abs(real.keypoints - made.keypoints).max() < 2  # VideoPose3D has p1 and p2 in the other order


def test_cdf_in_the_room_and_in_the_cameras_are_the_same(there, tmp_path):
    pytest.importorskip("cdflib")
    written.write_cdf(tmp_path, of(numbers=False), ("D3_Positions",))
    room = Human36M(tmp_path).read("test")
    mono = Human36M(there("cdf")).read("test")
    assert np.abs(room.pose - mono.pose).max() < 0.01 and np.abs(room.root - mono.root).max() < 0.01
    assert np.abs(room.keypoints - mono.keypoints).max() < 0.002
    assert all("D3_Positions/" in str(file.path) for file in Human36M(tmp_path).files("test"))


def test_martinez_without_cameras_takes_the_published_ones(there, tmp_path):
    for path in there("martinez").iterdir():
        if path.name != "cameras.h5":
            os.symlink(path, tmp_path / path.name)
    ours, theirs = (Human36M(at).read("test") for at in (tmp_path, there("martinez")))
    assert np.abs(ours.pose - theirs.pose).max() < 0.01 and np.abs(ours.keypoints - theirs.keypoints).max() < 0.002


def test_the_first_kind_that_is_there_with_such_keypoints_is_read(there, tmp_path):
    for family in ("videopose3d", "pickles"):
        for path in there(family).iterdir():
            os.symlink(path, tmp_path / path.name)

    def chosen(**options) -> str:
        return Human36M(tmp_path, **options).read("test").source.rpartition("(")[2]

    assert chosen().startswith("videopose3d, keypoints gt,")
    assert chosen(source="pickles").startswith("pickles, keypoints gt, projected")
    assert chosen(keypoints="detected").startswith("videopose3d, keypoints sh,")
    (tmp_path / "data_2d_h36m_sh_ft_h36m.npz").unlink()
    assert chosen(keypoints="detected").startswith("pickles, keypoints sh,")
    assert chosen(keypoints="sh").startswith("pickles, keypoints sh,")
    assert chosen(keypoints="detected", source="videopose3d").startswith("videopose3d, keypoints cpn,")
    for keypoints, trained in (("detectron", "ft_h36m"), ("detectron_coco", "pt_coco")):
        missing = Human36M(tmp_path, keypoints).missing("test")
        assert [file.path.name for file in missing] == [f"data_2d_h36m_detectron_{trained}.npz"]


def test_training_subjects_and_their_old_names(tmp_path):
    written.write_pickles(tmp_path, of(("S1", "S5", "S6", "S7", "S8"), numbers=False))
    assert b"TakingPhoto" in (tmp_path / "points_3d.pkl").read_bytes()
    for keypoints in ("gt", "sh"):
        data = Human36M(tmp_path, keypoints).read("train")
        assert list(dict.fromkeys(data.identity["subject"])) == ["S1", "S5", "S6", "S7", "S8"]
        assert set(data.identity["action"]) == set(data.identity["sequence"]) == set(ACTIONS)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fps": 7}, "data.options.fps=7: Human3.6M has 50"),
        ({"fps": 0}, "fps=0"),
        ({"keypoints": "cnp"}, "Did you mean 'cpn'"),
        ({"source": "videopose"}, "Did you mean 'videopose3d'"),
        ({"source": "cdf", "keypoints": "cpn"}, "the files of this kind have none"),
    ],
)
def test_options_that_are_none(tmp_path, options, said):
    with pytest.raises(UserError, match=said):
        Human36M(tmp_path, **options).files("test")


def test_no_such_split(tmp_path):
    with pytest.raises(UserError, match="no split 'val'"):
        Human36M(tmp_path).files("val")


def drop(*keys: str) -> Callable:
    def change(value):
        for key in keys[:-1]:
            value = value[key]
        del value[keys[-1]]

    return change


def put(value, *keys) -> Callable:
    def change(inside):
        for key in keys[:-1]:
            inside = inside[key]
        inside[keys[-1]] = value(inside[keys[-1]]) if callable(value) else value

    return change


def renamed(old: str, new: str, *keys: str) -> Callable:
    def change(inside):
        for key in keys:
            inside = inside[key]
        inside[new] = inside.pop(old)

    return change


def swapped(*keys: str) -> Callable:
    def change(inside):
        for key in keys:
            inside = inside[key]
        inside["S9"], inside["S11"] = inside["S11"], inside["S9"]
        inside["S9"]["Directions"] = inside["S11"].pop("Directions")

    return change


def turned(arrays) -> None:
    """The cameras in another order."""
    for subject in arrays["positions_2d"].values():
        for name, views in subject.items():
            subject[name] = views[::-1]


class Runs:
    def __reduce__(self):
        return os.system, ("touch ran",)


WRONG = [
    (POSES, drop("positions_3d"), "has no array 'positions_3d'"),
    (POSES, renamed("S9", "S09", "positions_3d"), "has no S9 .found: S09, S11"),
    (POSES, lambda a: {"positions_3d": {f"Train/{s}": t for s, t in a["positions_3d"].items()}}, "has no S9, S11"),
    (POSES, put([1, 2], "positions_3d"), "is a list, expected a dict"),
    (POSES, drop("positions_3d", "S9", "Smoking"), None),  # its second take is there
    (POSES, renamed("Smoking", "Smokin", "positions_3d", "S9"), "'Smokin' is not an action.*Did you mean 'Smoking'"),
    (POSES, renamed("Smoking", "Smoking  1", "positions_3d", "S9"), "is not an action"),
    (POSES, renamed("Photo", "TakingPhoto 1", "positions_3d", "S9"), "'Photo 1' twice"),
    (POSES, put(lambda p: p[:, :17], "positions_3d", "S9", "Eating"), r"shape \(\d+, 17, 3\), expected \(frames, 32, 3\)"),
    (POSES, put(lambda p: p[..., :2], "positions_3d", "S9", "Eating"), r"shape \(\d+, 32, 2\)"),
    (POSES, put(lambda p: p.astype(str), "positions_3d", "S9", "Eating"), "an array of <U"),
    (POSES, put(lambda p: p[:5], "positions_3d", "S9", "Eating"), None),  # 2D that is a bit longer
    (POSES, put(lambda p: np.repeat(p, 9, 0), "positions_3d", "S9", "Eating"), "99 frames of 3D and 11 of 2D|frames of 3D"),
    (POSES, put(lambda p: p * np.nan, "positions_3d", "S9", "Eating"), "in front of the camera"),
    (POSES, put(lambda t: {n: p * 1000 for n, p in t.items()}, "positions_3d", "S9"), "in front of the camera"),
    (POSES, put(lambda t: {n: p / 1000 for n, p in t.items()}, "positions_3d", "S9"), "from hip to head S9 measures"),
    (POSES, swapped("positions_3d"), "keypoints of S9 are .* px off"),
    (GT, drop("metadata"), "no array 'metadata'"),
    (GT, put({"num_joints": 17, "keypoints_symmetry": [[1], [2]]}, "metadata"), "unknown layout"),
    (GT, put({"num_joints": 17}, "metadata"), "has no keypoints_symmetry"),
    (GT, drop("positions_2d", "S11"), "has no S11"),
    (GT, drop("positions_2d", "S11", "Eating 1"), "has no Eating 1"),
    (GT, put(lambda v: v[:3], "positions_2d", "S9", "Eating"), "list of 4 cameras"),
    (GT, put(lambda v: [x[:, :16] for x in v], "positions_2d", "S9", "Eating"), r"shape \(\d+, 16, 2\)"),
    (GT, put(lambda v: [x[:0] for x in v], "positions_2d", "S9", "Eating"), "and 0 of 2D"),
    (GT, turned, "px off the projected 3D.*cameras"),
    (GT, put(Runs(), "positions_2d", "S9"), "wants to import '.*system'"),
    ("points_3d.pkl", drop("S9"), "has no S9"),
    ("points_3d.pkl", put(lambda p: p[:, :51], "S9", "Eating"), r"shape \(\d+, 51\), expected \(frames, 32, 3\)"),
    ("points_3d.pkl", put(lambda t: {n: p / 10 for n, p in t.items()}, "S9"), "from hip to head S9 measures .*another unit"),
    ("cameras.pkl", drop("S9", "60457274"), "has no 60457274"),
    ("cameras.pkl", drop("S9", "60457274", "k"), "has no k"),
    ("cameras.pkl", put(lambda r: r[:2], "S9", "60457274", "R"), r"'R' is float64 of shape \(2, 3\)"),
    ("cameras.pkl", put(lambda r: -r, "S9", "60457274", "R"), "in front of the camera"),
    ("sh_detect_2d.pkl", drop("S9", "Eating"), "has no Eating"),
    ("sh_detect_2d.pkl", put(lambda p: p[:, :32], "S9", "Eating", "60457274"), r"\(\d+, 32\), expected \(frames, 17"),
    ("sh_detect_2d.pkl", put(lambda t: {n: {c: v + 400 for c, v in s.items()} for n, s in t.items()}, "S9"), "px off"),
    ("points_3d.pkl", put(Runs(), "S9", "Eating"), "wants to import '.*system'"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "said"), WRONG, ids=[f"{n}-{s}"[:60] for n, _, s in WRONG])
def test_wrong_files_give_one_clear_error(there, tmp_path, monkeypatch, name, change, said):
    monkeypatch.chdir(tmp_path)
    family = "pickles" if name.endswith(".pkl") else "videopose3d"
    folder = edited(there, tmp_path, name, change, family)
    read = Human36M(folder, "sh" if name.startswith("sh") else "gt")
    if said is None:
        assert len(read.read("test"))
        return
    with pytest.raises(UserError, match=f"(?s){said}") as told:
        read.read("test")
    assert str(folder) in str(told.value)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.98])
def test_a_cut_file_is_told(there, tmp_path, family, share):
    name = {
        "videopose3d": POSES, "pickles": "cameras.pkl", "martinez": "S9/MyPoses/3D_positions/Eating.h5",
        "cdf": "S9/MyPoseFeatures/D2_Positions/Eating.55011271.cdf",
    }[family]  # fmt: skip
    linked(there(family), tmp_path, name)
    content = (there(family) / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(UserError, match=name.rpartition("/")[2]):
        Human36M(tmp_path, source=family).read("test")


def linked(source: Path, target: Path, but: str) -> None:
    """Link every file of a folder into another one, but for one."""
    for path in source.rglob("*"):
        name = path.relative_to(source)
        if path.is_file() and str(name) != but:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            os.symlink(path, target / name)
    (target / but).parent.mkdir(parents=True, exist_ok=True)


def test_wrong_h5_files(there, tmp_path):
    import h5py

    name = "S9/MyPoses/3D_positions/Eating.h5"
    linked(there("martinez"), tmp_path, name)
    read = Human36M(tmp_path)
    with pytest.raises(UserError, match=r"S9 has no Eating \(14 of 15 actions\).*partial=true"):
        read.read("test")
    assert "Eating" in Human36M(tmp_path, partial=True).read("test").identity["action"]  # of S11
    for content, said in (
        ({"other": np.zeros((96, 4))}, "no '3D_positions' .found: other"),
        ({"3D_positions": np.zeros((51, 4))}, r"shape \(51, 4\), expected \(96, frames\)"),
        ({"3D_positions": np.zeros((96, 4, 2))}, "shape"),
        ({"3D_positions/a": np.zeros(3)}, "no '3D_positions'"),
        ({"3D_positions": "text"}, "no numbers|shape"),
    ):
        with h5py.File(tmp_path / name, "w") as file:
            for key, value in content.items():
                file[key] = value
        with pytest.raises(UserError, match=f"(?s)Eating.h5.*{said}"):
            read.read("test")
    with h5py.File(tmp_path / name, "w") as file:
        file.create_dataset("3D_positions", (96, 10**10), "f8", chunks=(96, 1000))  # eight terabytes of nothing
    with pytest.raises(UserError, match=r"Eating.h5.*would take"):
        read.read("test")
    for path in (tmp_path / "S9/StackedHourglassFineTuned240").glob("Posing.55011271.h5"):
        path.unlink()
    (tmp_path / name).unlink()
    with pytest.raises(UserError, match="no detections of 'Posing' by camera 55011271"):
        Human36M(tmp_path, "sh", partial=True).read("test")


def test_wrong_cdf_files(there, tmp_path):
    from cdflib.cdfwrite import CDF

    name = "S9/MyPoseFeatures/D2_Positions/Eating.55011271.cdf"
    linked(there("cdf"), tmp_path, name)
    with pytest.raises(UserError, match=r"No file .*Eating.55011271.cdf"):
        Human36M(tmp_path).read("test")
    written.write_one_cdf(tmp_path / name, np.zeros((11, 17, 2)))
    with pytest.raises(UserError, match=r"Eating.55011271.cdf: 'Pose' has shape .*34"):
        Human36M(tmp_path).read("test")
    (tmp_path / name).unlink()
    file = CDF(tmp_path / name, {})
    file.write_var({"Variable": "Angles", "Data_Type": 44, "Num_Elements": 1, "Rec_Vary": True, "Dim_Sizes": [2],
                    "Var_Type": "zVariable"}, var_data=np.zeros((3, 2), np.float32))  # fmt: skip
    file.close()
    with pytest.raises(UserError, match=r"Eating.55011271.cdf"):
        Human36M(tmp_path).read("test")


@pytest.mark.parametrize(("family", "package"), [("martinez", "h5py"), ("cdf", "cdflib")])
def test_without_the_package_the_extra_is_named(there, monkeypatch, family, package):
    folder = there(family)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UserError, match=r'pip install "uplift3d\[h36m\]"'):
        Human36M(folder).read("test")


def test_a_task_reads_it_and_the_cache_gives_the_same(there, tmp_path, monkeypatch):
    monkeypatch.setenv("UPLIFT_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "h36m"
    written.write_videopose3d(folder, ("gt", "cpn"), of(written.SUBJECTS, numbers=False))
    skeleton = load_skeleton("h36m17")
    for task in ("h36m", "h36m_detected"):
        first = load_data(load_settings(task, (f"data.root={folder}",)), skeleton)
        again = load_data(load_settings(task, (f"data.root={folder}",)), skeleton)
        assert set(first.train.identity["subject"]) == {"S1", "S5", "S6", "S7", "S8"} and first.test is not None
        assert set(first.test.identity["action"]) == set(ACTIONS)
        for one, other in ((first.train, again.train), (first.test, again.test)):
            for name in ("keypoints", "confidence", "pose", "root", "tilt_deg", "lens"):
                assert np.array_equal(getattr(one, name), getattr(other, name)), name
            assert all(np.array_equal(one.identity[key], other.identity[key]) for key in one.identity)
            assert one.lenses == other.lenses and one.source == other.source
    assert "keypoints cpn" in first.train.source
    before = read_cached(Human36M(folder), "test")
    monkeypatch.setattr(Human36M, "read", lambda *_: pytest.fail("read anew"))
    assert np.array_equal(read_cached(Human36M(folder), "test").keypoints, before.keypoints)
    os.utime(folder / GT)
    with pytest.raises(pytest.fail.Exception, match="read anew"):
        read_cached(Human36M(folder), "test")


def test_without_files_it_is_said_what_to_get(here, capsys):
    message = refusal(capsys, "fit", "task=h36m")
    for part in (
        "1 file is not in",
        POSES,
        "registration",
        "docs/data-h36m.md",
        "UPLIFT_DATA=",
        "task=demo",
    ):
        assert part in message
    assert "data_2d_h36m_sh_ft_h36m.npz" in refusal(capsys, "fit", "task=h36m_detected")


def test_the_published_cameras_stand_about_the_room():
    for subject in written.SUBJECTS:
        for camera in CAMERAS:
            stands = published(subject, camera)
            assert np.allclose(stands.rotation, written.rotation(subject, camera), atol=1e-9)
            seen = stands.see(np.array([[0.0, 0.0, 900.0]]))
            assert 3500 < seen[0, 2] < 6500 and (np.abs(stands.lens.project(seen) - 500) < 200).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("camera", CAMERAS)
def test_the_lenses_are_undone(camera, kind):
    lens = published("S1", camera).lens
    across, down = np.meshgrid(np.linspace(-0.42, 0.42, 15), np.linspace(-0.42, 0.42, 11))
    rays = np.stack([across, down], -1).astype(kind)
    seen = lens.project(np.concatenate([rays, np.ones_like(rays[..., :1])], -1))
    assert seen.dtype == kind and seen.shape == rays.shape
    assert np.abs(lens.rays(seen) - rays).max() < (1e-6 if kind == np.float32 else 1e-9)
    assert lens.rays(seen[:0]).shape == (0, 15, 2)
    many = np.repeat(seen[3, :1], 100_000, 0)  # more than a block
    assert np.allclose(lens.rays(many), rays[3, 0], atol=1e-6)


@pytest.mark.parametrize("majority", ["row_major", "column_major"])
def test_cdf_of_either_majority(tmp_path, majority):
    pytest.importorskip("cdflib")
    from uplift.data.datasets.h36m_files import _read_cdf as _read

    points = np.random.default_rng(0).normal(size=(7, 32, 3)).astype(np.float32)
    written.write_one_cdf(tmp_path / "a.cdf", points, majority)
    assert np.array_equal(_read(tmp_path / "a.cdf", 3), points)


def test_files_of_full_size_are_as_the_real_ones(tmp_path):
    from benchmarks.loading.files import write_full_size

    write_full_size(tmp_path, 7 * 30 * 20, keypoints=("gt", "cpn"), compress=False)
    data = Human36M(tmp_path, fps=50).read("train")
    assert np.abs(reprojected(data) - data.keypoints).max() < 0.002
    assert 0.9 < len(data) / (5 * 30 * 20 * 4) < 1.1
    assert 2 < np.std(reprojected(data) - Human36M(tmp_path, "cpn", 50).read("train").keypoints) < 4
