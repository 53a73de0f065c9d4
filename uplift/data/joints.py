"""Keypoints in the joints of a skeleton, matched by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.match import WrongJoints, build_joints, build_pose

__all__ = ["in_joints_of"]


def in_joints_of(data: PoseData, skeleton: Skeleton) -> PoseData:
    """Return ``data`` with the skeleton's joints in its order, poses relative to its root.

    Raises UserError: the joints do not fit the skeleton.
    """
    keypoints, confidence, pose, notes = data.keypoints, data.confidence, data.pose, data.notes
    complete = (confidence > 0).all() and np.isfinite(keypoints).all()
    if data.joint_names != skeleton.joints or not complete:  # a full-size data set is not copied for nothing
        try:
            keypoints, confidence, match = build_joints(keypoints, confidence, data.joint_names, skeleton)
            notes = (*notes, str(match)) if match.layout is not None or match.missing else notes
            pose = None if pose is None else build_pose(pose, data.joint_names, skeleton)
        except WrongJoints as error:
            raise WrongJoints(f"{data.source}: {error}" if data.source else str(error), error.names) from None
        except UserError as error:
            raise UserError(f"{data.source}: {error}" if data.source else str(error)) from None
    root = data.root
    if pose is not None and pose[:, skeleton.root_index].any():
        shift = pose[:, skeleton.root_index]
        root = None if root is None else (root + np.nan_to_num(shift)).astype(np.float32)
        pose = pose - shift[:, None]
    return replace(
        data,
        keypoints=keypoints.astype(np.float32, copy=False),
        confidence=confidence.astype(np.float32, copy=False),
        pose=None if pose is None else pose.astype(np.float32, copy=False),
        **{"joint_names": skeleton.joints, "root": root, "bones": (), "mirror": (), "notes": notes},
    )
