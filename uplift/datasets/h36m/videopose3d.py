"""The npz files of VideoPose3D: 3D in metres in the room, ground truth and detections in pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.datasets.base import WantedFile
from uplift.datasets.h36m.cameras import CAMERAS, published
from uplift.datasets.h36m.clips import Clip, Family, in_order, in_room, points_of, table_of
from uplift.datasets.h36m.names import SUBJECTS
from uplift.errors import UserError
from uplift.readers.pickled import load_object_npz

__all__ = ["VideoPose3D"]

_POSES = "data_3d_h36m.npz"
_MM = 1000.0
# By number of joints and the places of the left ones, which every file tells in its 'metadata'.
_LEFT = {(17, (4, 5, 6, 11, 12, 13)): "h36m", (17, (1, 3, 5, 7, 9, 11, 13, 15)): "coco", (16, (3, 4, 5, 13, 14, 15)): "hourglass"}  # fmt: skip


class VideoPose3D(Family):
    """As written by the scripts of facebookresearch/VideoPose3D (data/prepare_data_h36m.py and beside it)."""

    name = "videopose3d"
    files_of: ClassVar[dict[str, str]] = {
        "gt": "data_2d_h36m_gt.npz",
        "cpn": "data_2d_h36m_cpn_ft_h36m_dbb.npz",
        "detectron": "data_2d_h36m_detectron_ft_h36m.npz",
        "sh": "data_2d_h36m_sh_ft_h36m.npz",
        "sh_mpii": "data_2d_h36m_sh_pt_mpii.npz",
    }

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether the 3D is there."""
        return (folder / _POSES).is_file()

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether these keypoints are there; the ground truth can be projected without its file."""
        return keypoints in ("gt", "projected") or (folder / cls.files_of.get(keypoints, _POSES + "?")).is_file()

    def files(self, split: str) -> list[WantedFile]:
        """Return the 3D, and the 2D unless it is projected."""
        wanted = [WantedFile(self.folder / _POSES, "3D joints of all subjects, as VideoPose3D prepares them")]
        file = self._keypoints_file()
        if file:
            wanted.append(WantedFile(self.folder / file, f"2D keypoints ({self.keypoints}), as VideoPose3D has them"))
        return wanted

    def _keypoints_file(self) -> str | None:
        file = self.files_of.get(self.keypoints)
        if self.keypoints == "gt" and not (self.folder / str(file)).is_file():
            return None
        return file

    def clips(self, split: str) -> list[Clip]:
        """Return the clips that the 3D has; 2D of other sequences is left out, as VideoPose3D does."""
        path = self.folder / _POSES
        poses = table_of(_array(path, "positions_3d"), f"{path}, 'positions_3d'", SUBJECTS[split])
        file = self._keypoints_file()
        seen, layout = self._seen(self.folder / file, split) if file else (None, "h36m")
        clips = []
        for subject in SUBJECTS[split]:
            where = f"{path}, '{subject}'"
            names = list(table_of(poses[subject], where))
            for name, action, sequence in in_order(
                names, subject, where, partial=self.partial, skip=[("S11", "Directions")]
            ):
                points = points_of(poses[subject][name], f"{where}, '{name}'", (32,), (3,))
                views = None
                if seen is not None:
                    views = _views(seen[subject], name, f"{self.folder / str(file)}, '{subject}'")
                clips += self._of_one(points, views, layout, subject, action, sequence, f"{where}, '{name}'")
        return clips

    def _of_one(self, points, views, layout, subject, action, sequence, where) -> list[Clip]:
        clips = []
        for number, camera_id in enumerate(CAMERAS):
            if views is not None and views[number] is None:
                continue
            camera = published(subject, camera_id, swapped=self.keypoints == "gt")
            look = None if views is None else _look(views[number], layout, where, camera_id)
            clips.append(
                Clip(subject, action, sequence, camera_id, camera, f"{where}, camera {camera_id}",
                     len(points), in_room(points, camera, _MM), look, layout)
            )  # fmt: skip
        return clips

    def _seen(self, path: Path, split: str) -> tuple[dict[str, Any], str]:
        """Return the 2D by subject, sequence and camera, and its layout."""
        arrays = load_object_npz(path, ["positions_2d", "metadata"])
        for name in ("positions_2d", "metadata"):
            if name not in arrays:
                raise UserError(f"{path} has no array '{name}': another data set's file?")
        told = table_of(arrays["metadata"], f"{path}, 'metadata'", ["num_joints", "keypoints_symmetry"])
        try:
            left = tuple(int(place) for place in told["keypoints_symmetry"][0])
            layout = _LEFT[int(told["num_joints"]), left]
        except (KeyError, TypeError, ValueError, IndexError):
            raise UserError(
                f"{path}: unknown layout of keypoints (metadata: {str(told)[:200]}), expected that of Human3.6M "
                "(17 joints), COCO (17) or the stacked hourglass (16)."
            ) from None
        if layout == "hourglass" and self.keypoints == "sh_mpii":
            layout = "hourglass_mpii"
        return table_of(arrays["positions_2d"], f"{path}, 'positions_2d'", SUBJECTS[split]), layout


def _array(path: Path, name: str) -> Any:
    arrays = load_object_npz(path, [name])
    if name not in arrays:
        raise UserError(f"{path} has no array '{name}': another file under this name?")
    return arrays[name]


def _views(sequences: Any, name: str, where: str) -> list[Any]:
    """Return the four cameras' keypoints of a sequence."""
    sequences = table_of(sequences, where, [name])
    views = sequences[name]
    if not isinstance(views, (list, tuple, np.ndarray)) or len(views) != len(CAMERAS):
        raise UserError(f"{where}, '{name}' is no list of {len(CAMERAS)} cameras' keypoints.")
    return list(views)


def _look(view: Any, layout: str, where: str, camera_id: str):
    count = 16 if layout.startswith("hourglass") else 17
    array = points_of(view, f"the 2D of {where}, camera {camera_id}", (count,), (2, 3))
    return lambda: array
