"""Read hand-labelled frames (PoseTraining of ndx-pose) from an NWB file."""

from __future__ import annotations

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.hdf5 import Hdf5
from uplift.readers.hdf5_own import check_room
from uplift.readers.nwb_parts import linked, skeleton_of
from uplift.readers.tidy import video_name, visible_only
from uplift.readers.tracks import link_bodies

__all__ = ["read_training"]


def read_training(file: Hdf5, places: list[str]) -> PoseData:
    """Return the instances of all training frames.

    Raises:
        UserError: no instance, or one that does not fit its skeleton.
    """
    return _Labels(file, places).data()


class _Labels:
    """Collects instance after instance."""

    def __init__(self, file: Hdf5, places: list[str]):
        self.file = file
        self.names: list[str] = []
        self.bones: dict[tuple[str, str], None] = {}
        self.found: list[tuple[list[str], np.ndarray, np.ndarray]] = []
        self.of: list[tuple[str, int, str]] = []
        """Video, frame in it (-1: not known) and name of the training frame of each instance."""
        self.skeletons: dict[int, list[str]] = {}
        self.videos: dict[int, str] = {}
        for place in places:
            frames = f"{place}/training_frames"
            for name in file.names(frames):
                if file.attribute(f"{frames}/{name}", "neurodata_type") == "TrainingFrame":
                    self._frame(f"{frames}/{name}", name)

    def _frame(self, place: str, name: str) -> None:
        file = self.file
        number = file.attribute(place, "source_video_frame_index")
        known = isinstance(number, (int, np.integer)) and 0 <= number < 2**40
        video = self._video(f"{place}/source_video") if file.is_group(f"{place}/source_video") else ""
        for instance in file.names(f"{place}/skeleton_instances"):
            where = f"{place}/skeleton_instances/{instance}"
            nodes = self._skeleton(where)
            points = file.array(f"{where}/node_locations")
            if points.ndim != 2 or points.shape[0] != len(nodes) or points.shape[1] not in (2, 3):
                raise UserError(
                    f"{file.path}: '{where}/node_locations' has shape {points.shape}, expected ({len(nodes)}, 2)."
                )
            seen = np.ones(len(nodes))
            if file.has(f"{where}/node_visibility"):
                seen = file.array(f"{where}/node_visibility").astype(float)
                if seen.shape != (len(nodes),):
                    raise UserError(f"{file.path}: '{where}/node_visibility' has shape {seen.shape}.")
            self.found.append((nodes, points[:, :2].astype(float), np.where(seen > 0, 1.0, 0.5)))
            self.of.append((video, int(number) if known else -1, name))

    def _video(self, place: str) -> str:
        key = self.file.place(place)
        if key not in self.videos:
            paths = self.file.texts(f"{place}/external_file") if self.file.has(f"{place}/external_file") else []
            self.videos[key] = video_name(paths[0]) if paths else str(len(self.videos))
        return self.videos[key]

    def _skeleton(self, place: str) -> list[str]:
        where = linked(self.file, place, "Skeleton")
        if where is None:
            raise UserError(f"{self.file.path}: '{place}' has no Skeleton, expected one with the names of its nodes.")
        key = self.file.place(where)
        if key not in self.skeletons:
            nodes, bones = skeleton_of(self.file, where)
            self.skeletons[key] = nodes
            self.names = list(dict.fromkeys([*self.names, *nodes]))
            self.bones.update(dict.fromkeys(bones))
        return self.skeletons[key]

    def data(self) -> PoseData:
        """Return the instances as rows."""
        check_room(self.file.path, "the labels", 64 * len(self.found) * len(self.names))
        keypoints = np.full((len(self.found), len(self.names), 2), np.nan)
        score = np.zeros(keypoints.shape[:2])
        for row, (nodes, points, seen) in enumerate(self.found):
            columns = [self.names.index(node) for node in nodes]
            keypoints[row, columns], score[row, columns] = points, seen
        points, confidence = visible_only(keypoints, score)
        rows = np.flatnonzero(np.any(confidence > 0, axis=-1))
        if not len(rows):
            raise UserError(f"{self.file.path}: no visible keypoint in the training frames.")
        points, confidence = points[rows], confidence[rows]
        identity, notes = self._identity(rows, points, confidence)
        return PoseData(
            keypoints=points,
            confidence=confidence,
            joint_names=tuple(self.names),
            identity=identity,
            bones=tuple(self.bones),
            notes=notes,
        )

    def _identity(
        self, rows: np.ndarray, points: np.ndarray, confidence: np.ndarray
    ) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
        videos, frames, names = (np.array([self.of[row][item] for row in rows.tolist()]) for item in range(3))
        if (frames < 0).any() or (videos == "").any():
            return {"image": names}, ()
        identity = {"frame": frames, "sequence": videos}
        if len(set(zip(videos.tolist(), frames.tolist(), strict=True))) == len(rows):
            return identity, ()
        body = np.zeros(len(rows), np.int64)
        for video in np.unique(videos):
            mine = videos == video
            body[mine] = link_bodies(points[mine], confidence[mine], frames[mine])
        return identity | {"instance": body.astype(str)}, ("individuals have no names: they are linked by place",)
