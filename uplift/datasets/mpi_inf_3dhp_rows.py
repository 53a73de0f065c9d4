"""The frames of many sequences of MPI-INF-3DHP in arrays made once, filled one sequence after the other."""

from __future__ import annotations

import numpy as np

from uplift.data.container import PoseData
from uplift.datasets.mpi_inf_3dhp_cameras import Camera
from uplift.datasets.mpi_inf_3dhp_files import Sequence
from uplift.lens import Lens

__all__ = ["Rows"]


class Rows:
    """Room for all frames of a split, filled sequence by sequence."""

    def __init__(self, most: int, joints: tuple[str, ...]):
        self.joints = joints
        self.used = 0
        self.keypoints = np.empty((most, len(joints), 2), np.float32)
        self.pose = np.empty((most, len(joints), 3), np.float32)
        self.root = np.empty((most, 3), np.float32)
        self.tilt_deg = np.empty(most, np.float32)
        self.lens = np.empty(most, np.int16)
        self.frame = np.empty(most, np.int32)
        self.lenses: list[Lens] = []
        self.parts: list[tuple[int, dict]] = []

    def add(self, sequence: Sequence, camera: Camera, frames: np.ndarray, identity: dict) -> None:
        """Put the frames of one sequence seen by one camera behind the others."""
        here = slice(self.used, self.used + len(sequence.seen))
        pelvis = self.joints.index("pelvis")
        if camera.lens not in self.lenses:
            self.lenses.append(camera.lens)
        self.keypoints[here] = sequence.seen
        root = sequence.points[:, pelvis]
        if sequence.universal is None:
            self.pose[here] = sequence.points - root[:, None]
            self.root[here] = root
        else:
            # The universal pose is not where the camera saw it; at this root it projects to what was seen.
            self.pose[here] = sequence.universal - sequence.universal[:, pelvis, None]
            self.root[here] = root * _scale(sequence.points - root[:, None], self.pose[here])
        self.tilt_deg[here] = camera.tilt_deg
        self.lens[here] = self.lenses.index(camera.lens)
        self.frame[here] = frames
        self.parts.append((len(sequence.seen), identity))
        self.used = here.stop

    def finish(self) -> PoseData:
        """Return what was filled."""
        here = slice(0, self.used)
        keys = list(self.parts[0][1])
        values = {key: [np.broadcast_to(part[key], count) for count, part in self.parts] for key in keys}
        known = np.isfinite(self.keypoints[here]).all(-1)
        self.keypoints[here][~known] = 0
        return PoseData(
            keypoints=self.keypoints[here],
            confidence=np.asarray(known, np.float32),
            joint_names=self.joints,
            pose=self.pose[here],
            root=self.root[here],
            tilt_deg=self.tilt_deg[here],
            identity={**{key: np.concatenate(parts) for key, parts in values.items()}, "frame": self.frame[here]},
            lenses=tuple(self.lenses),
            lens=self.lens[here],
        )


def _scale(measured: np.ndarray, universal: np.ndarray) -> float:
    """Return how much larger the universal body is, one number a sequence (least squares)."""
    known = np.isfinite(measured) & np.isfinite(universal)
    measured, universal = np.where(known, measured, 0), np.where(known, universal, 0)
    size = float((measured * measured).sum())
    return float((measured * universal).sum()) / size if size else 1.0
