"""The plain files that MPII Human Pose comes in: the common .json, and the .npy of Kudo et al. 2018."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.container import PoseData
from uplift.datasets.coco_json import JsonText
from uplift.errors import UserError

__all__ = ["AUTHORS_JOINTS", "MPII_JOINTS", "people", "person_in_image", "read_json", "read_npy"]

MPII_JOINTS = (
    "rankle", "rknee", "rhip", "lhip", "lknee", "lankle", "hip", "thorax", "upper_neck", "headtop", "rwrist", "relbow",
    "rshoulder", "lshoulder", "lelbow", "lwrist",
)  # fmt: skip
AUTHORS_JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "thorax", "upper_neck", "head_middle", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip
"""The 17 slots of mpii_poses.npy; head_middle is no annotation but the midpoint of its neighbours."""

_JOINTS = len(MPII_JOINTS)


def person_in_image(image: np.ndarray) -> np.ndarray:
    """Return (frames,) numbers that count the people of each image from 0, in the order of the file."""
    _, code = np.unique(image, return_inverse=True)
    order = np.argsort(code, kind="stable")
    first = np.flatnonzero(np.diff(code[order], prepend=-1))
    number = np.empty(len(image), np.int64)
    number[order] = np.arange(len(image)) - np.repeat(first, np.diff(np.append(first, len(image))))
    return number


def people(points: np.ndarray, confidence: np.ndarray, image: list[str]) -> PoseData:
    """Return people (people 16 2) in MPII's joints, with the names of their images."""
    names = np.array(image, dtype=str)
    return PoseData(
        keypoints=np.where(confidence[..., None] > 0, points, 0).astype(np.float32),
        confidence=confidence.astype(np.float32),
        joint_names=MPII_JOINTS,
        identity={"image": names, "instance": person_in_image(names)},
    )


def read_json(path: Path, occluded: float) -> PoseData:
    """Return the people of a train.json or valid.json: joints, joints_vis, image, of 16 joints each.

    A joint at (-1, -1) or (0, 0) is missing; one with a place and joints_vis 0 was annotated though hidden.

    Raises:
        UserError: damaged JSON, other records, another number of joints.
    """
    points, visible, image = [], [], []
    text = JsonText(path)
    if text.next_sign() != "[":
        raise UserError(f"{path} is no list of people, expected MPII's as train.json has them.")
    for count, person in enumerate(text.records("the people")):
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
    return people(places, np.where(placed, np.where(seen, 1, occluded), 0), image)


def _floats(values: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    try:
        found = np.array(values, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise UserError(f"{where} are no numbers of shape {shape}.") from None
    if found.shape != shape:
        raise UserError(f"{where} has shape {found.shape}, expected {shape}: MPII has {_JOINTS} joints.")
    return found


def read_npy(path: Path, occluded: float) -> PoseData:
    """Return the people of mpii_poses.npy, without its made-up joint; image names from mpii_image_name.txt beside it.

    Raises:
        UserError: no array of 34 or 17 x 2 numbers a person, or another number of image names.
    """
    try:
        content = path.read_bytes()
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise UserError(f"{path} cannot be read as .npy: {error}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.shape[1:] not in ((34,), (17, 2)):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise UserError(f"{path} is {found}, expected numbers of shape (people, 34): x, y of 17 joints.")
    points = array.reshape(-1, 17, 2)[:, [AUTHORS_JOINTS.index(name) for name in MPII_JOINTS]].astype(np.float32)
    seen = np.isfinite(points).all(-1)
    names = path.with_name("mpii_image_name.txt")
    if not names.is_file():
        data = people(points, np.asarray(seen, np.float32), [""] * len(points))
        data.identity.clear()
        return data
    try:
        image = names.read_text(encoding="utf-8").split()
    except UnicodeDecodeError as error:
        raise UserError(f"{names} is no text: {error}") from None
    if len(image) != len(points):
        raise UserError(f"{names} names {len(image):,} images for {len(points):,} people in {path.name}.")
    return people(points, np.asarray(seen, np.float32), image)
