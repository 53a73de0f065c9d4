"""MPII Human Pose: 2D annotations of single in-the-wild images, in the forms that people have them."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.datasets.base import DataSet, WantedFile, first_file
from uplift.data.formats.npz import read_npz
from uplift.data.names import Names
from uplift.data.parsers.files import read_bytes
from uplift.data.parsers.json import JsonText, objects
from uplift.data.parsers.matlab import load_mat5
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["AUTHORS_JOINTS", "MPII_JOINTS", "Mpii", "person_in_image"]

# The common .json, and the .npy of Kudo et al. 2018.

MPII_JOINTS = (
    "rankle", "rknee", "rhip", "lhip", "lknee", "lankle", "hip", "thorax", "upper_neck", "headtop", "rwrist", "relbow",
    "rshoulder", "lshoulder", "lelbow", "lwrist",
)  # fmt: skip
AUTHORS_JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "thorax", "upper_neck", "head_middle", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip
"""The 17 slots of mpii_poses.npy; head_middle is not annotated but the midpoint of its neighbours."""

_JOINTS = len(MPII_JOINTS)


def person_in_image(image: np.ndarray | Names) -> np.ndarray:
    """Return (frames,) numbers that count the people of each image from 0, in the order of the file."""
    _, code = np.unique(image, return_inverse=True)
    order = np.argsort(code, kind="stable")
    first = np.flatnonzero(np.diff(code[order], prepend=-1))
    number = np.empty(len(image), np.int64)
    number[order] = np.arange(len(image)) - np.repeat(first, np.diff(np.append(first, len(image))))
    return number


def _people(points: np.ndarray, confidence: np.ndarray, image: list[str]) -> PoseData:
    """Return people (people 16 2) in MPII's joints, with the names of their images."""
    names = np.array(image, dtype=str)
    return PoseData(
        keypoints=np.where(confidence[..., None] > 0, points, 0).astype(np.float32),
        confidence=confidence.astype(np.float32),
        joint_names=MPII_JOINTS,
        identity={"image": names, "instance": person_in_image(names)} if image else {},
    )


def _read_json(path: Path, occluded: float) -> PoseData:
    """Return the people of a train.json or valid.json: joints, joints_vis, image, of 16 joints each.

    A joint at (-1, -1) or (0, 0) is missing; one with a place and joints_vis 0 was annotated though hidden.

    Raises:
        UserError: damaged JSON, other records, another number of joints.
    """
    points, visible, image = [], [], []
    text = JsonText(path)
    if text.next_sign() != "[":
        raise UserError(f"{path} is not a list of people, expected MPII's as in train.json.")
    for count, person in enumerate(objects(text, "the people")):
        where = f"{path}: person {count}"
        absent = [key for key in ("image", "joints", "joints_vis") if key not in person]
        if absent:
            raise UserError(
                f"{where} has no '{absent[0]}' (found: {', '.join(map(str, list(person)[:6]))}). Expected MPII's train.json "
                "or valid.json; those of its test images have no joints."
            )
        points.append(_floats(person["joints"], (_JOINTS, 2), f"{where}: 'joints'"))
        visible.append(_floats(person["joints_vis"], (_JOINTS,), f"{where}: 'joints_vis'"))
        image.append(str(person["image"]))
    places = np.array(points, np.float32).reshape(-1, _JOINTS, 2)
    placed = np.isfinite(places).all(-1) & (places != -1).any(-1) & (places != 0).any(-1)
    seen = np.array(visible).reshape(-1, _JOINTS) > 0
    return _people(places, np.where(placed, np.where(seen, 1, occluded), 0), image)


def _floats(values: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    try:
        found = np.array(values, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise UserError(f"{where} are no numbers of shape {shape}.") from None
    if found.shape != shape:
        raise UserError(f"{where} has shape {found.shape}, expected {shape}: MPII has {_JOINTS} joints.")
    return found


def _read_npy(path: Path, occluded: float) -> PoseData:
    """Return the people of mpii_poses.npy, without its interpolated joint; image names from mpii_image_name.txt beside it.

    Raises:
        UserError: no array of 34 or 17 x 2 numbers a person, or another number of image names.
    """
    try:
        array = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise UserError(f"{path} cannot be read as .npy: {error}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.shape[1:] not in ((34,), (17, 2)):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise UserError(f"{path} is {found}, expected numbers of shape (people, 34): x, y of 17 joints.")
    points = array.reshape(-1, 17, 2)[:, [AUTHORS_JOINTS.index(name) for name in MPII_JOINTS]].astype(np.float32)
    names, image = path.with_name("mpii_image_name.txt"), []
    if names.is_file():
        try:
            image = names.read_text(encoding="utf-8").split()
        except UnicodeDecodeError as error:
            raise UserError(f"{names} is not text: {error}") from None
        if len(image) != len(points):
            raise UserError(f"{names} names {len(image):,} images for {len(points):,} people in {path.name}.")
    return _people(points, np.asarray(np.isfinite(points).all(-1), np.float32), image)


# The annotations as published: mpii_human_pose_v1_u12_1.mat.

_HEAD = (MPII_JOINTS.index("upper_neck"), MPII_JOINTS.index("headtop"))


def _read_mat(path: Path, occluded: float) -> PoseData:
    """Return the annotated people of the training images of mpii_human_pose_v1_u12_1.mat.

    Raises:
        UserError: no such MATLAB file, another structure, no annotated person.
    """
    release = load_mat5(path, ["RELEASE"]).get("RELEASE")
    if release is None or release.dtype.names is None or not release.size:
        raise UserError(f"{path}: no struct 'RELEASE' in it: not MPII's annotations (mpii_human_pose_v1_u12_1.mat).")
    where = f"{path}: RELEASE"
    annolist, img_train = (_field(release.flat[0], key, where).ravel() for key in ("annolist", "img_train"))
    if len(annolist) != len(img_train):
        raise UserError(f"{where} has {len(annolist):,} images and {len(img_train):,} 'img_train': damaged?")
    people, image = [], []
    for number in np.flatnonzero(img_train == 1):
        here = f"{where}.annolist({number + 1})"
        found = [_person(person, occluded, here) for person in _structs(annolist[number], "annorect", here)]
        found = [person for person in found if person is not None]
        people += found
        image += [_image_name(annolist[number], here)] * len(found) if found else []
    if not image:
        raise UserError(f"{where}: no person in it has annotated points.")
    points, confidence = map(np.array, zip(*people, strict=True))
    return _people(points, confidence, image)


def _person(person: np.void, occluded: float, where: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the joints and confidence of one person; None without annotated points."""
    place, confidence = np.zeros((_JOINTS, 2), np.float32), np.zeros(_JOINTS, np.float32)
    holder = _structs(person, "annopoints", where)
    for point in _structs(holder[0], "point", where) if len(holder) else []:
        joint, x, y = (_number(point, key, where) for key in ("id", "x", "y"))
        if joint is None or x is None or y is None:
            continue
        if joint not in range(_JOINTS):
            raise UserError(f"{where}: a point has id {joint:g}, expected 0 to {_JOINTS - 1}.")
        place[int(joint)] = x, y
        # Upper neck and head top have no visibility: they were taken from the box of the head.
        hidden = _number(point, "is_visible", where) == 0 and joint not in _HEAD
        confidence[int(joint)] = occluded if hidden else 1
    return (place, confidence) if confidence.any() or place.any() else None


def _field(struct: np.void, key: str, where: str) -> np.ndarray:
    if key not in (struct.dtype.names or ()):
        found = ", ".join((struct.dtype.names or ())[:8]) or "none"
        raise UserError(f"{where}: no field '{key}' (found: {found}). Expected MPII's mpii_human_pose_v1_u12_1.mat.")
    return np.asarray(struct[key])


def _structs(struct: np.void, key: str, where: str) -> np.ndarray:
    """Return the structs that a field holds: one, several, or none where it is absent or empty."""
    value = np.asarray(struct[key]).ravel() if key in (struct.dtype.names or ()) else np.empty(0)
    if value.dtype.names is not None:
        return value
    if value.size and value.dtype.kind not in "fiubO":  # an empty struct is stored as an array of numbers
        raise UserError(f"{where}: '{key}' is {value.dtype}, expected structs.")
    return np.empty(0)


def _number(struct: np.void, key: str, where: str) -> float | None:
    """Return the number in a field, which may be text; None where it is absent or empty."""
    if key not in (struct.dtype.names or ()):
        return None
    value = np.asarray(struct[key])
    while value.dtype.kind == "O" and value.size == 1:
        value = np.asarray(value.flat[0])
    if not value.size:
        return None
    try:
        return float(value.flat[0])
    except (TypeError, ValueError):
        raise UserError(f"{where}: a point's '{key}' is {value.flat[0]!r}, expected a number.") from None


def _image_name(entry: np.void, where: str) -> str:
    holder = _structs(entry, "image", where)
    name = np.asarray(_field(holder[0], "name", where)).ravel() if len(holder) else np.empty(0)
    if not name.size or name.dtype.kind not in "US":
        raise UserError(f"{where}: an annotated image has no name.")
    return str(name[0])


# The data set.

_NAMES = {
    "train": (
        "mpii_human_pose_v1_u12_1.mat", "trainval.json", "mpii_trainval.json", "train.json", "mpii_train.json",
        "mpii.npz", "mpii_poses.npy",
    ),
    "valid": ("valid.json", "val.json", "mpii_val.json", "mpii_valid.json"),
}  # fmt: skip
_FOLDERS = ("", "annot", "annotations", "mpii_human_pose_v1_u12_2")


class Mpii(DataSet):
    """Everyone who is annotated; joints that were annotated though hidden have a lower confidence.

    Args:
        folder: with the files.
        file: name of the file to read; the first that is there if empty.
        occluded: confidence of joints that were annotated though hidden.
    """

    title = "MPII Human Pose"
    about = """\
From human-pose.mpi-inf.mpg.de (annotations, version 1.2; no images are needed), for research and under its own terms.
Put one of these into the folder: mpii_human_pose_v1_u12_1.mat as published; train.json or trainval.json (and valid.json)
as the 2D pose estimators have them; mpii_poses.npy (and mpii_image_name.txt) of Kudo et al. 2018; mpii.npz.
data.options.file=NAME chooses where several are there."""
    splits = ("train", "valid")

    def __init__(self, folder: Path, file: str = "", occluded: float = 0.5):
        super().__init__(folder)
        self.file = file
        self.occluded = float(occluded)
        if not 0 <= self.occluded <= 1:
            raise UserError(f"data.options.occluded={occluded}: expected a confidence from 0 to 1.")

    def files(self, split: str) -> list[WantedFile]:
        self.check_split(split)
        path = self._file(split)
        names = path.with_name("mpii_image_name.txt")
        extra = [WantedFile(names, "names of images")] if path.suffix == ".npy" and names.is_file() else []
        first = "the annotations as published" if split == "train" else "the validation people of the common split"
        return [WantedFile(path, f"{first}; or, in its place, {', '.join(_NAMES[split][1:])}"), *extra]

    def read(self, split: str) -> PoseData:
        path = self._file(split)
        reader = {".mat": _read_mat, ".json": _read_json, ".npy": _read_npy}.get(path.suffix.lower())
        if reader:
            data = reader(path, self.occluded)
        elif path.suffix.lower() == ".npz":
            data = _single_images(read_npz(path))
        else:
            raise UserError(f"{path}: expected a .mat, .json, .npy or .npz file of MPII.")
        if not len(data):
            raise UserError(f"{path} holds no annotated person.")
        return replace(data, source=f"{self.title} {split}, {path} (occluded joints of confidence {self.occluded:g})")

    def _file(self, split: str) -> Path:
        if self.file and split == "train":
            return self.folder / Path(self.file).expanduser()
        return first_file(self.folder / folder / name for name in _NAMES[split] for folder in _FOLDERS)


def _single_images(data: PoseData) -> PoseData:
    """Return the frames with image names as `image`: people in one image are not a clip."""
    missing = [name for name in AUTHORS_JOINTS if name != "head_middle" and name not in data.joint_names]
    if missing:
        raise UserError(
            f"{data.source}: no joint {missing[0]!r} in it, expected MPII's 16: {', '.join(AUTHORS_JOINTS)}."
        )
    identity = dict(data.identity)
    if "image" not in identity and "sequence" in identity:
        identity["image"] = identity.pop("sequence")
    identity.pop("sequence", None)
    if "image" in identity and "instance" not in identity:
        identity["instance"] = person_in_image(identity["image"])
    return replace(data, identity=identity)
