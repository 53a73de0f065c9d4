"""The annotations of MPII Human Pose as published: mpii_human_pose_v1_u12_1.mat."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.datasets.mpii_files import MPII_JOINTS, people
from uplift.errors import UserError
from uplift.readers.mat import load_mat5

__all__ = ["read_mat"]

_JOINTS = len(MPII_JOINTS)
_HEAD = (MPII_JOINTS.index("upper_neck"), MPII_JOINTS.index("headtop"))


def read_mat(path: Path, occluded: float) -> PoseData:
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
    points, confidence, image = [], [], []
    for number in np.flatnonzero(img_train == 1):
        here = f"{where}.annolist({number + 1})"
        name = None
        for person in _structs(annolist[number], "annorect", here):
            found = _person(person, occluded, here)
            if found is None:
                continue
            name = name or _image_name(annolist[number], here)
            points.append(found[0])
            confidence.append(found[1])
            image.append(name)
    if not image:
        raise UserError(f"{where}: no person in it has annotated points.")
    return people(np.array(points), np.array(confidence), image)


def _person(person: np.void, occluded: float, where: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the joints and confidence of one person; None without annotated points."""
    place, sure = np.zeros((_JOINTS, 2), np.float32), np.zeros(_JOINTS, np.float32)
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
        sure[int(joint)] = occluded if hidden else 1
    return (place, sure) if sure.any() or place.any() else None


def _field(struct: np.void, key: str, where: str) -> np.ndarray:
    if struct.dtype.names is None or key not in struct.dtype.names:
        found = ", ".join((struct.dtype.names or ())[:8]) or "none"
        raise UserError(f"{where}: no field '{key}' (found: {found}). Expected MPII's mpii_human_pose_v1_u12_1.mat.")
    return np.asarray(struct[key])


def _structs(struct: np.void, key: str, where: str) -> np.ndarray:
    """Return the structs that a field holds: one, several, or none where it is absent or empty."""
    if struct.dtype.names is None or key not in struct.dtype.names:
        return np.empty(0)
    value = np.asarray(struct[key]).ravel()
    if value.size and value.dtype.names is None:
        if value.dtype.kind in "fiub" or value.dtype.kind == "O":
            return np.empty(0)  # an empty struct is stored as an array of numbers
        raise UserError(f"{where}: '{key}' is {value.dtype}, expected structs.")
    return value if value.dtype.names is not None else np.empty(0)


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
