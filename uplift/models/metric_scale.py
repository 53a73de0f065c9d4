"""Millimetres from what a user knows: a length of the body, its height, or how high the camera stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton

__all__ = ["CameraHeight", "KnownLength", "Size", "mm_by_camera_height", "mm_per_unit", "size_from", "size_of_skeleton"]


@dataclass(frozen=True)
class KnownLength:
    """The length of a way from joint to joint."""

    along: tuple[str, ...]
    mm: float


@dataclass(frozen=True)
class CameraHeight:
    """How high the camera is over the ground that the lowest joints stand on."""

    mm: float


Size = KnownLength | CameraHeight


def size_of_skeleton(skeleton: Skeleton) -> Size | None:
    """Return the size that the skeleton's file gives in mm; None where it gives none."""
    if "mm" not in skeleton.size:
        return None
    return KnownLength(tuple(skeleton.size["along"]), skeleton.size["mm"])


def size_from(
    skeleton: Skeleton,
    *,
    height_mm: float | None = None,
    bone: tuple[str, ...] | None = None,
    bone_mm: float | None = None,
    camera_height_mm: float | None = None,
) -> Size | None:
    """Return the size that a user gives, else the skeleton's own; None where neither is known.

    Raises:
        UserError: more than one size, a bone without its length, joints that are not there, no height to go by.
    """
    given = [
        n for n, v in (("height_mm", height_mm), ("bone", bone or bone_mm), ("camera_height_mm", camera_height_mm)) if v
    ]
    if len(given) > 1:
        raise UserError(f"{' and '.join(given)} are all given: one of them says how large the body is.")
    for name, value in (("height_mm", height_mm), ("bone_mm", bone_mm), ("camera_height_mm", camera_height_mm)):
        if value is not None and not 0 < value < 1e9:
            raise UserError(f"{name}={value}: expected a positive length in mm.")
    if height_mm is not None:
        if "of_height" not in skeleton.size:
            raise UserError(
                f"height_mm={height_mm:g}: skeleton '{skeleton.name}' does not say how height shows in its joints "
                "(size: {along: [...], of_height: SHARE} in its YAML). Give a length: bone=JOINT,JOINT bone_mm=..."
            )
        return KnownLength(tuple(skeleton.size["along"]), height_mm * skeleton.size["of_height"])
    if camera_height_mm is not None:
        if not skeleton.gravity:
            raise UserError(f"camera_height_mm={camera_height_mm:g}: skeleton '{skeleton.name}' knows no ground.")
        return CameraHeight(camera_height_mm)
    if (bone is None) != (bone_mm is None):
        raise UserError("bone=JOINT,JOINT and bone_mm=LENGTH go together.")
    if bone is None or bone_mm is None:
        return size_of_skeleton(skeleton)
    for joint in bone:
        if joint not in skeleton.joints:
            raise UserError(
                f"bone={','.join(bone)}: skeleton '{skeleton.name}' has no joint '{joint}'."
                + did_you_mean(joint, skeleton.joints)
            )
    if len(bone) < 2 or len(set(bone)) < len(bone):
        raise UserError(f"bone={','.join(bone)}: expected two or more different joints, such as bone=rhip,rknee.")
    return KnownLength(tuple(bone), bone_mm)


def mm_per_unit(
    pose: Float[np.ndarray, "frames joints 3"],
    skeleton: Skeleton,
    body: Int[np.ndarray, " frames"],
    size: KnownLength,
) -> Float[np.ndarray, " frames"]:
    """Return how many mm one unit of each pose is, if every body is as large as ``size`` says.

    Frames of one ``body`` share its proportions: the median over them of each length as a share of
    all bones, so that no frame goes by one bone alone. A way that has a mirror image counts as the
    mean of both.
    """
    total = _lengths(pose, skeleton.bone_indices).sum(1)
    places = np.array([skeleton.index(joint) for joint in size.along])
    ways = [places, skeleton.mirror_permutation[places]]
    length = np.mean([_lengths(pose, np.stack([way[:-1], way[1:]], 1)).sum(1) for way in ways], 0)
    share = length / np.maximum(total, 1e-9)
    known = share.copy()
    for one in np.unique(body):
        rows = body == one
        if np.isfinite(share[rows]).any():
            known[rows] = np.nanmedian(share[rows])
    with np.errstate(divide="ignore", invalid="ignore"):
        return size.mm / (known * total)


def mm_by_camera_height(
    pose: Float[np.ndarray, "frames joints 3"],
    places: Float[np.ndarray, "frames joints 3"],
    gravity: Float[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    body: Int[np.ndarray, " frames"],
    size: CameraHeight,
) -> Float[np.ndarray, " frames"]:
    """Return how many mm one unit of each pose is, if the lowest joint of a frame mostly stands on the ground.

    ``places`` are the joints in front of the camera in the pose's unit, ``gravity`` unit vectors, both
    in the camera frame. The frames of one ``body`` share its size: the median of what each frame says.

    Raises:
        UserError: bodies that are mostly not below the camera.
    """
    below = np.einsum("fjc,fc->fj", places, gravity)
    lowest = np.nanmax(np.where(np.isfinite(below), below, -np.inf), axis=1)
    total = _lengths(pose, skeleton.bone_indices).sum(1)
    by_frame = np.where(lowest > 0, size.mm / np.maximum(lowest, 1e-9) * total, np.nan)
    if not np.isfinite(by_frame).any() or np.mean(np.isfinite(by_frame)) < 0.5:
        raise UserError(
            f"camera_height_mm={size.mm:g}: the lowest joints are above the camera in most frames: is focal_px right, "
            "and does the camera look at the ground they stand on?"
        )
    of_body = np.full(len(total), np.nanmedian(by_frame))
    for one in np.unique(body):
        rows = body == one
        if np.isfinite(by_frame[rows]).any():
            of_body[rows] = np.nanmedian(by_frame[rows])
    return of_body / np.maximum(total, 1e-9)


def _lengths(pose: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    return np.linalg.norm(pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]], axis=-1)
