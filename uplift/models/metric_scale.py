"""Metric scale from a known length: of the body, of its height, or of the camera above the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton

__all__ = [
    "CameraHeight",
    "KnownLength",
    "Size",
    "median_by_body",
    "mm_by_camera_height",
    "mm_per_unit",
    "segment_lengths",
    "size_from",
    "size_of_skeleton",
]


@dataclass(frozen=True)
class KnownLength:
    """The length of a path from joint to joint."""

    along: tuple[str, ...]
    mm: float


@dataclass(frozen=True)
class CameraHeight:
    """The height of the camera above the ground that the lowest joints stand on."""

    mm: float


Size = KnownLength | CameraHeight


def size_of_skeleton(skeleton: Skeleton) -> Size | None:
    """Return the size in mm that the skeleton's file gives, if any."""
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
    """Return the size that a user gives, else the skeleton's; None if neither is known.

    Raises:
        UserError: more than one size, a bone without its length, unknown joints, or a height that the skeleton
            does not relate to its joints.
    """
    choices = {"height_mm": height_mm, "bone": bone or bone_mm, "camera_height_mm": camera_height_mm}
    given = [name for name, value in choices.items() if value]
    if len(given) > 1:
        raise UserError(f"{' and '.join(given)} are given: use only one of them.")
    for name, value in (("height_mm", height_mm), ("bone_mm", bone_mm), ("camera_height_mm", camera_height_mm)):
        if value is not None and not 0 < value < 1e9:
            raise UserError(f"{name}={value}: expected a positive length in mm.")
    if height_mm is not None:
        if "of_height" not in skeleton.size:
            raise UserError(
                f"height_mm={height_mm:g}: skeleton '{skeleton.name}' does not relate height to its joints "
                "(size: {along: [...], of_height: SHARE} in its YAML). Give a length: bone=JOINT,JOINT bone_mm=..."
            )
        return KnownLength(tuple(skeleton.size["along"]), height_mm * skeleton.size["of_height"])
    if camera_height_mm is not None:
        if not skeleton.gravity:
            raise UserError(
                f"camera_height_mm={camera_height_mm:g}: skeleton '{skeleton.name}' has no gravity, and so no ground."
            )
        return CameraHeight(camera_height_mm)
    if (bone is None) != (bone_mm is None):
        raise UserError("bone=JOINT,JOINT and bone_mm=LENGTH go together.")
    if bone is None or bone_mm is None:
        return size_of_skeleton(skeleton)
    where = f"bone={','.join(bone)}"
    for joint in bone:
        if joint not in skeleton.joints:
            hint = did_you_mean(joint, skeleton.joints)
            raise UserError(f"{where}: skeleton '{skeleton.name}' has no joint '{joint}'.{hint}")
    if len(bone) < 2 or len(set(bone)) < len(bone):
        raise UserError(f"{where}: expected two or more different joints, such as bone=rhip,rknee.")
    return KnownLength(tuple(bone), bone_mm)


def mm_per_unit(
    pose: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, body: Int[np.ndarray, " frames"], size: KnownLength
) -> Float[np.ndarray, " frames"]:
    """Return mm per unit of each pose, if every body has the length ``size``.

    Frames of one ``body`` share its proportions: the length as a share of all bones is the median over them, so
    that no frame depends on one bone alone. A path with a mirror image counts as the mean of both.
    """
    total = segment_lengths(pose, skeleton.bone_indices).sum(1)
    places = np.array([skeleton.index(joint) for joint in size.along])
    paths = [places, skeleton.mirror_permutation[places]]
    length = np.mean([segment_lengths(pose, np.stack([path[:-1], path[1:]], 1)).sum(1) for path in paths], 0)
    share = length / np.maximum(total, 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        return size.mm / (median_by_body(share, body) * total)


def median_by_body(
    values: Float[np.ndarray, "frames *rest"], body: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames *rest"]:
    """Return for every frame the median of ``values`` over the frames of its body; NaN is left out."""
    median = values.copy()
    for one in np.unique(body):
        rows = body == one
        if np.isfinite(values[rows]).any():
            median[rows] = np.nanmedian(values[rows], axis=0)
    return median


def mm_by_camera_height(
    pose: Float[np.ndarray, "frames joints 3"],
    positions: Float[np.ndarray, "frames joints 3"],
    gravity: Float[np.ndarray, "frames 3"],
    skeleton: Skeleton,
    body: Int[np.ndarray, " frames"],
    size: CameraHeight,
) -> Float[np.ndarray, " frames"]:
    """Return mm per unit of each pose, if the lowest joint of a frame mostly stands on the ground.

    The frames of one ``body`` share its size, the median over them. ``positions`` are the joints of ``pose``
    relative to the camera, ``gravity`` unit vectors; all are in the camera frame.

    Raises:
        UserError: bodies that are mostly not below the camera.
    """
    below = np.einsum("fjc,fc->fj", positions, gravity)
    lowest = np.nanmax(np.where(np.isfinite(below), below, -np.inf), axis=1)
    total = segment_lengths(pose, skeleton.bone_indices).sum(1)
    by_frame = np.where(lowest > 0, size.mm / np.maximum(lowest, 1e-9) * total, np.nan)
    if not np.isfinite(by_frame).any() or np.mean(np.isfinite(by_frame)) < 0.5:
        raise UserError(
            f"camera_height_mm={size.mm:g}: the lowest joints are above the camera in most frames: is focal_px right, "
            "and does the camera look at the ground they stand on?"
        )
    of_body = median_by_body(by_frame, body)
    of_body = np.where(np.isfinite(of_body), of_body, np.nanmedian(by_frame))
    return of_body / np.maximum(total, 1e-9)


def segment_lengths(
    pose: Float[np.ndarray, "frames joints 3"], pairs: Int[np.ndarray, "segments 2"]
) -> Float[np.ndarray, "frames segments"]:
    """Return the distance between each pair of joints."""
    return np.linalg.norm(pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]], axis=-1)
