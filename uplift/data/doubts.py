"""Whether a file's keypoints can be lifted, and whether they carry the right names."""

from __future__ import annotations

from dataclasses import replace

from uplift.data.clean import MIN_VISIBLE
from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.proposal_bones import TOO_LONG, stretch_of

__all__ = ["doubted", "liftable"]


def liftable(data: PoseData) -> PoseData:
    """Return ``data``; raises UserError for files of fewer keypoints than anything can be lifted from."""
    if len(data.joint_names) < MIN_VISIBLE:
        raise UserError(
            f"{data.source}: holds {len(data.joint_names)} keypoints ({', '.join(data.joint_names)}). Nothing can be lifted "
            f"from fewer than {MIN_VISIBLE}: a pose needs a shape."
        )
    return data


def doubted(data: PoseData, skeleton: Skeleton) -> PoseData:
    """Return ``data`` with a note where its joints seem to have each other's names."""
    stretch = stretch_of(data.keypoints, data.confidence, skeleton)
    if stretch < TOO_LONG:
        return data
    note = (
        f"WARNING: the bones of {skeleton.name} are {stretch:.1f} times as long as the shortest lines that join its "
        f"joints: joints seem to have the names of others (uplift skeleton map {data.source} skeleton={skeleton.name})"
    )
    return replace(data, notes=(*data.notes, note))
