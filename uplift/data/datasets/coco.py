"""COCO person keypoints: 2D annotations of single images, to train on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.datasets.base import DataSet, WantedFile, first_file
from uplift.data.formats.layouts import COCO_JOINTS
from uplift.data.parsers.json import records
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["Coco"]

_TORSO = [COCO_JOINTS.index(name) for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip")]
_MANY = 4096


class Coco(DataSet):
    """Everyone with enough annotated joints; crowds and unannotated people are left out.

    Args:
        folder: with the files.
        year: of the files, 2017 or 2014.
        min_keypoints: annotated joints that a person needs.
        torso: whether a person needs both shoulders and both hips.
        occluded: confidence of joints that were annotated though hidden.
    """

    title = "COCO person keypoints"
    about = """\
From cocodataset.org ("Train/Val annotations", person_keypoints_*.json); no images are needed. The annotations are
CC BY 4.0; the images, not read here, are Flickr's under their own terms. Put person_keypoints_train2017.json and
person_keypoints_val2017.json into the folder, or into annotations/ below it (data.options.year=2014 for those of 2014)."""
    splits = ("train", "val")

    def __init__(
        self, folder: Path, year: int = 2017, min_keypoints: int = 8, torso: bool = True, occluded: float = 0.5
    ):
        super().__init__(folder)
        self.year = int(year)
        self.min_keypoints = int(min_keypoints)
        self.torso = torso
        self.occluded = float(occluded)
        if not 0 <= self.occluded <= 1:
            raise UserError(f"data.options.occluded={occluded}: expected a confidence from 0 to 1.")
        if not 1 <= self.min_keypoints <= len(COCO_JOINTS):
            raise UserError(f"data.options.min_keypoints={min_keypoints}: expected 1 to {len(COCO_JOINTS)}.")

    def files(self, split: str) -> list[WantedFile]:
        self.check_split(split)
        name = f"person_keypoints_{split}{self.year}.json"
        path = first_file([self.folder / name, self.folder / "annotations" / name])
        return [WantedFile(path, f"the keypoints of {split}{self.year} (Train/Val annotations of COCO)")]

    def read(self, split: str) -> PoseData:
        path = self.files(split)[0].path
        people = _People(path)
        names: dict[int, str] = {}
        for key, record in records(path, ("annotations", "images", "categories")):
            if key == "annotations":
                people.add(record)
            elif key == "images":
                number, name = record.get("id"), record.get("file_name")
                if not isinstance(number, int) or not isinstance(name, str):
                    raise UserError(
                        f"{path}: an image has id {number!r} and file_name {name!r}, expected a number and a name."
                    )
                names[number] = name
            else:
                people.category(record)
        data = people.finish(names, self.occluded, self.min_keypoints, self.torso)
        torso = ", shoulders and hips annotated" if self.torso else ""
        choices = f"{self.min_keypoints} or more keypoints{torso}; occluded ones of confidence {self.occluded:g}"
        data.source = f"{self.title} {split}{self.year} in {self.folder} ({choices})"
        return data


class _People:
    """The annotations read so far, as arrays that grow."""

    def __init__(self, path: Path):
        self.path = path
        self.count = self.seen = 0
        self.flat = np.zeros((_MANY, 3 * len(COCO_JOINTS)), np.float32)
        self.numbers = np.zeros((_MANY, 3), np.int64)
        """Category, image and annotation."""
        self.people: set[int] = set()
        self.others: list[str] = []
        self.wrong: dict[int, str] = {}
        """Category -> the first annotation that has another number of keypoints."""

    def add(self, record: dict[str, Any]) -> None:
        """Take one annotation, unless it is a crowd or has no keypoint."""
        self.seen += 1
        values = record.get("keypoints")
        if record.get("iscrowd") or (values is not None and record.get("num_keypoints") == 0):
            return
        where = f"{self.path}: annotation {record.get('id', self.seen)}"
        if not isinstance(values, list):
            kind = "captions" if "caption" in record else "instances" if "segmentation" in record else ""
            found = f": these are {kind}" if kind else ""
            raise UserError(f"{where} has no 'keypoints'{found}. Expected person_keypoints_*.json.")
        if self.count == len(self.flat):
            self.flat = np.concatenate([self.flat, np.zeros_like(self.flat)])
            self.numbers = np.concatenate([self.numbers, np.zeros_like(self.numbers)])
        if len(values) != self.flat.shape[1]:
            self.wrong.setdefault(record.get("category_id", 1), f"{where} has {len(values)} numbers in 'keypoints'")
            return
        try:
            self.flat[self.count] = values
            self.numbers[self.count] = [record.get("category_id", 1), record["image_id"], record["id"]]
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise UserError(f"{where} is damaged: {type(error).__name__}: {error}.") from None
        self.count += 1

    def category(self, record: dict[str, Any]) -> None:
        """Note a category, and check that a person's keypoints are the 17 by name."""
        name, number, joints = record.get("name"), record.get("id"), record.get("keypoints")
        if not isinstance(number, int):
            raise UserError(f"{self.path}: category {name!r} has id {number!r}, expected a number.")
        if name != "person":
            self.others.append(str(name))
            return
        if joints is None:
            raise UserError(
                f"{self.path}: its category 'person' has no keypoints: annotations of another kind (instances, "
                "captions?). Expected person_keypoints_*.json."
            )
        if not isinstance(joints, list) or tuple(joints) != COCO_JOINTS:
            shown = ", ".join(map(str, joints[:5])) if isinstance(joints, list) else repr(joints)
            raise UserError(
                f"{self.path}: the keypoints of 'person' are {shown}, ...; expected COCO's {len(COCO_JOINTS)}."
            )
        self.people.add(number)

    def finish(self, names: dict[int, str], occluded: float, least: int, torso: bool) -> PoseData:
        """Return the people that are annotated well enough, as `PoseData`."""
        if not self.people:
            found = ", ".join(self.others[:5]) or "none"
            raise UserError(
                f"{self.path}: no category 'person' in it (found: {found}). Expected person_keypoints_*.json."
            )
        for wrong in (self.wrong[person] for person in self.people if person in self.wrong):
            raise UserError(f"{wrong}, expected {self.flat.shape[1]}: x, y, v of {len(COCO_JOINTS)} joints.")
        category, image, number = self.numbers[: self.count].T
        values = self.flat[: self.count].reshape(-1, len(COCO_JOINTS), 3)
        valid = (np.isin(values[..., 2], (0, 1, 2)) & np.isfinite(values).all(-1)).all(1)
        if not valid.all():
            raise UserError(
                f"{self.path}: annotation {number[~valid][0]} has visibilities other than 0, 1, 2, or no numbers. "
                "Scores of a detector? Expected annotations."
            )
        labelled = values[..., 2] > 0
        enough = labelled.sum(1) >= least
        if torso:
            enough &= labelled[:, _TORSO].all(1)
        kept = np.flatnonzero(enough & np.isin(category, sorted(self.people)))
        if not len(kept):
            raise UserError(
                f"{self.path}: none of its {self.seen:,} annotations is of a person with {least} keypoints"
                f"{' and both shoulders and hips' if torso else ''} annotated (data.options.min_keypoints, torso)."
            )
        confidence = np.array([0, occluded, 1], np.float32)[values[kept, :, 2].astype(int)]
        keypoints = np.where(labelled[kept][..., None], values[kept, :, :2], 0).astype(np.float32)
        return PoseData(
            keypoints=keypoints,
            confidence=confidence,
            joint_names=COCO_JOINTS,
            identity={"image": self._images(image[kept], names), "instance": number[kept]},
        )

    def _images(self, image: np.ndarray, names: dict[int, str]) -> np.ndarray:
        missing = [int(number) for number in np.unique(image) if int(number) not in names]
        if missing:
            raise UserError(
                f"{self.path}: annotations name image {missing[0]}, which is not among its images: cut short?"
            )
        return np.array([names[int(number)] for number in image])
