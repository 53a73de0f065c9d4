"""The pickles that the authors of Kudo et al. 2018 published: 3D in mm in the room, cameras, detections."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.datasets.base import WantedFile
from uplift.datasets.h36m.cameras import CAMERAS, Camera
from uplift.datasets.h36m.clips import Clip, Family, in_order, in_room, points_of, table_of
from uplift.datasets.h36m.names import SUBJECTS, sequence_name
from uplift.errors import UserError
from uplift.lens import Lens
from uplift.readers.pickled import load_pickle

__all__ = ["Pickles"]

_SHAPES = {"R": (3, 3), "T": (3,), "f": (2,), "c": (2,), "k": (3,), "p": (2,)}


class Pickles(Family):
    """As read by DwangoMediaVillage/3dpose_gan, projection_gan/pose/dataset/pose_dataset.py."""

    name = "pickles"
    files_of: ClassVar[dict[str, str]] = {"sh": "sh_detect_2d.pkl"}

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether the 3D is there."""
        return (folder / "points_3d.pkl").is_file()

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether these keypoints are there; the ground truth is projected."""
        return keypoints in ("gt", "projected") or (keypoints == "sh" and (folder / cls.files_of["sh"]).is_file())

    def files(self, split: str) -> list[WantedFile]:
        """Return the 3D, the cameras and the detections."""
        wanted = [
            WantedFile(self.folder / "points_3d.pkl", "3D joints of all subjects, as the authors of 2018 have them"),
            WantedFile(self.folder / "cameras.pkl", "the cameras, from the same place"),
        ]
        if self.keypoints == "sh":
            wanted.append(WantedFile(self.folder / self.files_of["sh"], "2D detections, from the same place"))
        return wanted

    def clips(self, split: str) -> list[Clip]:
        """Return the clips without S11's Directions seen by 54138969, as the authors' code leaves them out."""
        path, cameras_path = self.folder / "points_3d.pkl", self.folder / "cameras.pkl"
        poses = table_of(load_pickle(path), str(path), SUBJECTS[split])
        cameras = table_of(load_pickle(cameras_path), str(cameras_path), SUBJECTS[split])
        seen = None
        if self.keypoints == "sh":
            seen_path = self.folder / self.files_of["sh"]
            seen = table_of(load_pickle(seen_path), str(seen_path), SUBJECTS[split])
        clips = []
        for subject in SUBJECTS[split]:
            where = f"{path}, '{subject}'"
            stands = table_of(cameras[subject], f"{cameras_path}, '{subject}'", CAMERAS)
            stood = {c: _camera(stands[c], f"{cameras_path}, '{subject}', '{c}'") for c in CAMERAS}
            looks = None if seen is None else self._by_sequence(seen[subject], subject)
            names = list(table_of(poses[subject], where))
            for name, action, sequence in in_order(names, subject, where, partial=self.partial):
                points = points_of(poses[subject][name], f"{where}, '{name}'", (32,), (3,))
                for camera_id, camera in stood.items():
                    if (subject, action, camera_id) == ("S11", "Directions", CAMERAS[0]):
                        continue
                    look = None if looks is None else self._look(looks, subject, sequence, camera_id)
                    at = f"{where}, '{name}', camera {camera_id}"
                    positions = in_room(points, camera)
                    clips.append(Clip(subject, action, sequence, camera_id, camera, at, len(points), positions, look))
        return clips

    def _look(self, looks: dict[str, Any], subject: str, sequence: str, camera_id: str):
        where = f"{self.folder / self.files_of['sh']}, '{subject}'"
        views = table_of(table_of(looks, where, [sequence])[sequence], f"{where}, '{sequence}'", [camera_id])
        return _look_up(views[camera_id], f"{where}, '{sequence}', '{camera_id}'")

    def _by_sequence(self, looks: Any, subject: str) -> dict[str, Any]:
        where = f"{self.folder / self.files_of['sh']}, '{subject}'"
        return {parsed[1]: v for name, v in table_of(looks, where).items() if (parsed := sequence_name(name, where))}


def _look_up(view: Any, where: str):
    """Return keypoints whose nose, where it is the middle of thorax and head, counts as missing."""
    array = points_of(view, where, (17,), (2, 3))

    def seen() -> np.ndarray:
        between = (array[:, 8, :2] + array[:, 10, :2]) / 2
        if len(array) and np.abs(array[:, 9, :2] - between).max() > 0.01:
            return array
        marked = array.astype(np.float32)
        marked[:, 9, :2] = np.nan  # the network behind these detections has no nose: it was made up
        return marked

    return seen


def _camera(told: Any, where: str) -> Camera:
    told = table_of(told, where, list(_SHAPES))
    values = {}
    for name, shape in _SHAPES.items():
        value = np.asarray(told[name])
        if value.dtype.kind not in "fiu" or value.size != np.prod(shape) or not np.isfinite(value).all():
            raise UserError(f"{where}: '{name}' is {value.dtype} of shape {value.shape}, expected {shape} numbers.")
        values[name] = value.astype(float).reshape(shape)
    return camera_of(**values)


def camera_of(R, T, f, c, k, p) -> Camera:
    """Return the camera whose parameters have the names of Martinez' code, in which p1 goes with y."""
    lens = Lens(tuple(f.tolist()), tuple(c.tolist()), tuple(k.tolist()), (float(p[1]), float(p[0])), _image_size(c))
    return Camera(lens, R, T)


def _image_size(centre: np.ndarray) -> tuple[int, int]:
    """Return the size of the videos, which the files do not tell: two of the cameras have 1002 rows."""
    from uplift.datasets.h36m.cameras import CAMERAS, published

    known = [published("S1", camera).lens for camera in CAMERAS]
    nearest = min(known, key=lambda lens: float(np.abs(np.array(lens.centre_px) - centre).sum()))
    return nearest.image_size or (1000, 1000)
