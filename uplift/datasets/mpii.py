"""MPII Human Pose: 2D annotations of single in-the-wild images, in the forms that people have them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from uplift.data.container import PoseData
from uplift.datasets.base import DataSet, WantedFile
from uplift.datasets.mpii_files import AUTHORS_JOINTS, person_in_image, read_json, read_npy
from uplift.datasets.mpii_mat import read_mat
from uplift.errors import UserError
from uplift.readers.npz import read_npz

__all__ = ["Mpii"]

_NAMES = {
    "train": (
        "mpii_human_pose_v1_u12_1.mat", "trainval.json", "mpii_trainval.json", "train.json", "mpii_train.json",
        "mpii.npz", "mpii_poses.npy",
    ),
    "valid": ("valid.json", "val.json", "mpii_val.json", "mpii_valid.json"),
}  # fmt: skip
_FOLDERS = ("", "annot", "annotations", "mpii_human_pose_v1_u12_2")


class Mpii(DataSet):
    """Everyone who is annotated; joints that were annotated though hidden have a lower confidence."""

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
        return [WantedFile(path, _what(split)), *extra]

    def read(self, split: str) -> PoseData:
        path = self._file(split)
        reader = {".mat": read_mat, ".json": read_json, ".npy": read_npy}.get(path.suffix.lower())
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
        places = [self.folder / folder / name for name in _NAMES[split] for folder in _FOLDERS]
        return next((place for place in places if place.is_file()), places[0])


def _what(split: str) -> str:
    others = ", ".join(_NAMES[split][1:])
    first = "the annotations as published" if split == "train" else "the validation people of the common split"
    return f"{first}; or, in its place, {others}"


def _single_images(data: PoseData) -> PoseData:
    """Return the frames with image names as `image`: people in one image are no clip."""
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
