"""MPII's annotations in each of the files that people have them in, visibility and all."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from uplift.config.loading import load_settings
from uplift.data.datasets.mpii import AUTHORS_JOINTS, MPII_JOINTS, Mpii, person_in_image
from uplift.data.load import in_joints_of, load_data
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

SKELETON = load_skeleton("mpii16")
MAT = "mpii_human_pose_v1_u12_1.mat"
IMAGES = ["015601864.jpg", "015601864.jpg", "005808361.jpg", "086617615.jpg"]


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """Four people, (people 16 2) in MPII's order, in whole pixels as annotators set them."""
    data = simulate(SKELETON, 4, seed=3)
    return np.round(data.keypoints[:, [SKELETON.index(joint) for joint in MPII_JOINTS]])


def struct(**fields) -> np.ndarray:
    """Return a 1 x 1 MATLAB struct."""
    made = np.empty((1, 1), dtype=[(name, object) for name in fields])
    for name, value in fields.items():
        made[name][0, 0] = value
    return made


def row(structs: list[np.ndarray]) -> np.ndarray:
    """Return a 1 x n MATLAB struct array of 1 x 1 structs, fields of the first."""
    if not structs:
        return np.empty((0, 0))
    made = np.empty((1, len(structs)), dtype=structs[0].dtype)
    for place, each in enumerate(structs):
        made[0, place] = each[0, 0]
    return made


def annopoints(person: np.ndarray, visible: list, missing: tuple[int, ...] = ()) -> np.ndarray:
    placed = [
        struct(x=float(x), y=float(y), id=float(joint), is_visible=visible[joint])
        for joint, (x, y) in enumerate(person)
        if joint not in missing
    ]
    return struct(point=row(placed))


def as_published(points: np.ndarray) -> dict:
    """Return RELEASE with two people in one image, one in another, test images, and people without points.

    Visibility is a number, text, or nothing (head), as in the published file.
    """
    nothing = np.empty((0, 0))
    numbers: list = [1.0] * 8 + [nothing, nothing] + [1.0] * 6
    text: list = ["1"] * 8 + [nothing, nothing] + ["0"] * 6
    box = {"x1": 1.0, "y1": 2.0, "x2": 3.0, "y2": 4.0, "scale": 1.5, "objpos": struct(x=5.0, y=6.0)}
    first = [
        struct(**box, annopoints=annopoints(points[0], numbers)),
        struct(**box, annopoints=annopoints(points[1], text, missing=(0, 5))),
        struct(**box, annopoints=nothing),  # seen, but not annotated
    ]
    image = lambda name: struct(name=name)  # noqa: E731
    entries = [
        struct(image=image(IMAGES[0]), annorect=row(first), frame_sec=nothing, vididx=nothing),
        struct(image=image("test.jpg"), annorect=row([struct(scale=2.0, objpos=struct(x=1.0, y=1.0))]), frame_sec=nothing, vididx=nothing),
        struct(image=image("nobody.jpg"), annorect=nothing, frame_sec=nothing, vididx=nothing),
        struct(image=image(IMAGES[2]), annorect=row([struct(**box, annopoints=annopoints(points[2], numbers))]), frame_sec=nothing, vididx=nothing),
        struct(image=image("no_points.jpg"), annorect=row([struct(x1=1.0, scale=1.0)]), frame_sec=nothing, vididx=nothing),
    ]  # fmt: skip
    train = np.array([[1, 0, 1, 1, 1]], np.uint8)
    return {"RELEASE": struct(annolist=row(entries), img_train=train, version="1.2")}


def people_json(points: np.ndarray) -> list[dict]:
    people = []
    for number, person in enumerate(points):
        joints, visible = person.tolist(), [1] * 16
        if number == 1:
            joints[0], visible[0] = [-1.0, -1.0], 0
            visible[10] = 0
        people.append(
            {"joints_vis": visible, "joints": joints, "image": IMAGES[number], "scale": 2.1, "center": [600.0, 300.0]}
        )
    return people


def test_the_published_file(tmp_path: Path, points: np.ndarray) -> None:
    savemat(tmp_path / MAT, as_published(points), do_compression=True)
    data = Mpii(tmp_path).read("train")
    assert data.joint_names == MPII_JOINTS
    np.testing.assert_array_equal(data.keypoints[[0, 2]], points[[0, 2]])
    assert data.identity["image"].tolist() == IMAGES[:3]
    assert data.identity["instance"].tolist() == [0, 1, 0]
    assert (data.confidence[[0, 2]] == 1).all()
    np.testing.assert_array_equal(data.confidence[1], [0] + [1] * 4 + [0] + [1] * 4 + [0.5] * 6)
    assert (data.keypoints[1, [0, 5]] == 0).all()
    left_out = Mpii(tmp_path, occluded=0.0).read("train")
    np.testing.assert_array_equal(left_out.confidence[1, 10:], 0)


def test_the_common_json(tmp_path: Path, points: np.ndarray) -> None:
    (tmp_path / "annot").mkdir()
    (tmp_path / "annot" / "train.json").write_text(json.dumps(people_json(points)))
    (tmp_path / "annot" / "valid.json").write_text(json.dumps(people_json(points[:1])))
    data = Mpii(tmp_path).read("train")
    assert len(Mpii(tmp_path).read("valid")) == 1
    np.testing.assert_array_equal(data.keypoints[[0, 2, 3]], points[[0, 2, 3]])
    np.testing.assert_array_equal(data.confidence[1], [0] + [1] * 9 + [0.5] + [1] * 5)
    assert data.identity["instance"].tolist() == [0, 1, 0, 0]


@pytest.mark.parametrize("flat", [True, False])
def test_the_authors_poses(tmp_path: Path, points: np.ndarray, flat: bool) -> None:
    slots = np.zeros((4, 17, 2))
    for slot, joint in enumerate(AUTHORS_JOINTS):
        if joint != "head_middle":
            slots[:, slot] = points[:, MPII_JOINTS.index(joint)]
    slots[:, 9] = (slots[:, 8] + slots[:, 10]) / 2
    np.save(tmp_path / "mpii_poses.npy", slots.reshape(4, 34) if flat else slots)
    assert not Mpii(tmp_path).read("train").identity
    (tmp_path / "mpii_image_name.txt").write_text("\n".join(IMAGES) + "\n")
    data = Mpii(tmp_path).read("train")
    assert data.joint_names == MPII_JOINTS
    np.testing.assert_array_equal(data.keypoints, points)
    assert data.identity["image"].tolist() == IMAGES
    (tmp_path / "mpii_image_name.txt").write_text("one.jpg\n")
    assert "names 1 images for 4 people" in refused(tmp_path)
    assert [file.path.name for file in Mpii(tmp_path).files("train")] == ["mpii_poses.npy", "mpii_image_name.txt"]


def test_people_in_one_image_are_no_clip(tmp_path: Path, points: np.ndarray) -> None:
    np.savez(tmp_path / "mpii.npz", keypoints=points, joint_names=MPII_JOINTS, sequence=IMAGES)
    data = Mpii(tmp_path).read("train")
    assert "sequence" not in data.identity
    assert data.identity["image"].tolist() == IMAGES
    assert data.identity["instance"].tolist() == [0, 1, 0, 0]
    assert len(set(data.clips())) == 4
    assert not data.follows().any()


def test_person_in_image_counts_people_that_stand_apart() -> None:
    image = np.array(["b", "a", "b", "c", "a", "b"])
    assert person_in_image(image).tolist() == [0, 0, 1, 0, 1, 2]
    assert person_in_image(image[:0]).tolist() == []


def test_which_file_is_taken(tmp_path: Path, points: np.ndarray) -> None:
    assert Mpii(tmp_path).missing("train")[0].path == tmp_path / MAT
    (tmp_path / "train.json").write_text(json.dumps(people_json(points)))
    np.savez(tmp_path / "mpii.npz", keypoints=points[:2], joint_names=MPII_JOINTS)
    assert len(Mpii(tmp_path).read("train")) == 4
    assert len(Mpii(tmp_path, file="mpii.npz").read("train")) == 2
    assert Mpii(tmp_path).missing("valid")
    with pytest.raises(UserError, match="no split 'test'"):
        Mpii(tmp_path).files("test")
    with pytest.raises(UserError, match="occluded=2"):
        Mpii(tmp_path, occluded=2.0)


def refused(folder: Path, **options) -> str:
    with pytest.raises(UserError) as error:
        Mpii(folder, **options).read("train")
    return str(error.value)


def test_wrong_mat_files_are_refused(tmp_path: Path, points: np.ndarray) -> None:
    path = tmp_path / MAT

    def written(content: dict) -> str:
        savemat(path, content, do_compression=True)
        return refused(tmp_path)

    assert "no struct 'RELEASE'" in written({"annot2": np.zeros(3)})
    assert "no struct 'RELEASE'" in written({"RELEASE": np.zeros(3)})
    assert "no field 'img_train' (found: annolist)" in written({"RELEASE": struct(annolist=row([struct(a=1.0)]))})
    whole = as_published(points)["RELEASE"]
    some = whole.copy()
    some["img_train"][0, 0] = np.ones((1, 3))
    assert "has 5 images and 3 'img_train'" in written({"RELEASE": some})
    some = whole.copy()
    some["img_train"][0, 0] = np.zeros((1, 5))
    assert "no person in it has annotated points" in written({"RELEASE": some})
    many = np.concatenate([points[0], points[0]])
    entry = struct(image=struct(name="a.jpg"), annorect=row([struct(annopoints=annopoints(many, [1.0] * 32))]))
    assert "expected 0 to 15" in written({"RELEASE": struct(annolist=row([entry]), img_train=np.ones((1, 1)))})
    savemat(path, as_published(points))
    content = path.read_bytes()
    for share in (0.0, 0.01, 0.2, 0.6, 0.95):
        path.write_bytes(content[: int(len(content) * share)])
        assert str(path) in refused(tmp_path)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n")
    assert "v7.3" in refused(tmp_path)


def test_wrong_json_files_are_refused(tmp_path: Path, points: np.ndarray) -> None:
    path = tmp_path / "train.json"

    def written(content) -> str:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return refused(tmp_path)

    whole = people_json(points)
    text = json.dumps(whole)
    assert "truncated" in written(text[:-1])
    for share in (0.1, 0.5, 0.9):
        assert "damaged at character" in written(text[: int(len(text) * share)])
    assert "is empty" in written("")
    assert "not a list of people" in written({"annotations": []})
    assert "no 'joints'" in written([{"image": "a.jpg", "center": [1, 2], "scale": 1}])
    assert "expected an object" in written([1, 2])
    assert "no annotated person" in written([])
    assert "expected (16, 2)" in written([{**whole[0], "joints": whole[0]["joints"][:14]}])
    assert "are no numbers" in written([{**whole[0], "joints": "none"}])
    assert "damaged at character" in written("[" * 100_000)


def test_wrong_arrays_are_refused(tmp_path: Path, points: np.ndarray) -> None:
    path = tmp_path / "mpii_poses.npy"
    for array in (np.zeros((5, 32)), np.zeros(34), np.zeros((2, 34), complex)):
        np.save(path, array)
        assert "expected numbers of shape (people, 34)" in refused(tmp_path)
    np.save(path, np.zeros((5, 34)))
    path.write_bytes(path.read_bytes()[:-9])
    assert "cannot be read as .npy" in refused(tmp_path)
    path.write_bytes(pickle.dumps(Runs(tmp_path / "ran")))
    assert "cannot be read as .npy" in refused(tmp_path)
    np.save(path, np.array([Runs(tmp_path / "ran")], object), allow_pickle=True)
    assert "cannot be read as .npy" in refused(tmp_path)
    assert not (tmp_path / "ran").exists()
    np.savez(tmp_path / "mpii.npz", keypoints=np.zeros((2, 17, 2)), joint_names=load_skeleton("h36m17").joints)
    assert "no joint 'upper_neck'" in refused(tmp_path)
    (tmp_path / "a.txt").write_text("x")
    assert "expected a .mat, .json, .npy or .npz" in refused(tmp_path, file="a.txt")


class Runs:
    """Pickles to code that makes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_the_task_says_what_is_missing(here: Path) -> None:
    with pytest.raises(UserError) as error:
        load_data(load_settings("mpii"), SKELETON)
    for part in (MAT, "mpii.npz", "human-pose.mpi-inf.mpg.de", str(here / "data/mpii")):
        assert part in str(error.value)


def test_the_authors_data_are_single_images(benchmark_data) -> None:
    folder = benchmark_data("mpii/mpii.npz").parent
    data = Mpii(folder).read("train")
    assert len(data) == 19919
    assert data.identity["instance"].max() == 15
    built = in_joints_of(data, SKELETON)
    assert built.keypoints.shape == (19919, 16, 2)
    assert load_settings("mpii").data.use == "mpii"


def test_a_real_json(benchmark_data) -> None:
    path = benchmark_data("trackers/mpii/test_mpii.json")
    data = Mpii(path.parent, file=path.name).read("train")
    assert data.keypoints[0, 0].tolist() == [804, 711]
    np.testing.assert_allclose(data.keypoints[4, 9], [591.3663, 117.4341], atol=1e-4)
    np.testing.assert_array_equal(data.confidence.sum(1), [16, 16, 14, 14, 16])
