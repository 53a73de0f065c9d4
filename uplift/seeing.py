"""Data as a lifter sees it: through which camera, in which units."""

from __future__ import annotations

from uplift.config import LifterSettings
from uplift.data.container import PoseData
from uplift.data.tensors import TrainingSet
from uplift.normalise import Intrinsics
from uplift.skeleton import Skeleton

__all__ = ["as_seen", "frames_of", "intrinsics_of"]


def intrinsics_of(data: PoseData, settings: LifterSettings) -> Intrinsics | None:
    """Return the camera that ``data`` knows and the settings let be used, None otherwise."""
    if settings.intrinsics == "off" or settings.camera == "orthographic":
        return None
    if data.focal_px is None or data.centre_px is None:
        return None
    return Intrinsics(data.focal_px, data.centre_px)


def as_seen(data: PoseData, settings: LifterSettings) -> PoseData:
    """Return ``data`` as the lifter is to see it: through one ideal camera where its lenses are known and may be used."""
    use = settings.intrinsics != "off" and settings.camera != "orthographic"
    return data.straightened() if use else data


def frames_of(data: PoseData, skeleton: Skeleton, settings: LifterSettings) -> TrainingSet:
    """Return cleaned ``data`` in the units and the camera that ``settings`` say."""
    data = as_seen(data, settings)
    return TrainingSet.of(
        data,
        skeleton,
        count_root=settings.radius == "all",
        intrinsics=intrinsics_of(data, settings),
        distance=settings.distance,
    )
