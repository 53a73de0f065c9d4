"""The h5 files of Martinez et al. 2017: 3D in mm in the room, hourglass detections in pixels, cameras."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.datasets.base import WantedFile
from uplift.datasets.h36m.cameras import CAMERAS, Camera, published
from uplift.datasets.h36m.clips import Clip, Family, in_order, in_room, playable, points_of
from uplift.datasets.h36m.names import SUBJECTS, sequence_name
from uplift.datasets.h36m.pickles import camera_of
from uplift.errors import UserError

__all__ = ["Martinez"]


class Martinez(Family):
    """As read by una-dinosauria/3d-pose-baseline, src/data_utils.py and src/cameras.py."""

    name = "martinez"
    files_of: ClassVar[dict[str, str]] = {"sh": "StackedHourglassFineTuned240", "sh_mpii": "StackedHourglass"}

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether any 3D is there."""
        return any(folder.glob("S*/MyPoses/3D_positions/*.h5"))

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether these keypoints are there; the ground truth is projected."""
        if keypoints in ("gt", "projected"):
            return True
        return keypoints in cls.files_of and any(folder.glob(f"S*/{cls.files_of[keypoints]}/*.h5"))

    def files(self, split: str) -> list[WantedFile]:
        """Return every file of the split; of a subject without any, the one that should be there first."""
        wanted = []
        for subject in SUBJECTS[split]:
            wanted += self._in(f"{subject}/MyPoses/3D_positions", "Directions 1.h5", "3D joints (h36m.zip)")
            if self.keypoints in self.files_of:
                place = f"{subject}/{self.files_of[self.keypoints]}"
                wanted += self._in(place, "Directions_1.54138969.h5", "2D detections of the stacked hourglass")
        if (self.folder / "cameras.h5").is_file():
            wanted.append(WantedFile(self.folder / "cameras.h5", "the cameras"))
        return wanted

    def _in(self, place: str, example: str, what: str) -> list[WantedFile]:
        found = sorted((self.folder / place).glob("*.h5"))
        return [WantedFile(path, what) for path in found or [self.folder / place / example]]

    def clips(self, split: str) -> list[Clip]:
        """Return the clips that the 3D has."""
        cameras = self._cameras(split)
        points = lru_cache(maxsize=1)(_points)  # the clips of one sequence follow one another
        clips = []
        for subject in SUBJECTS[split]:
            folder = self.folder / subject / "MyPoses" / "3D_positions"
            looks = self._looks(subject) if self.keypoints in self.files_of else None
            for name, action, sequence in in_order(
                sorted(path.stem for path in folder.glob("*.h5")), subject, str(folder), partial=self.partial
            ):
                path = folder / f"{name}.h5"
                for camera_id in playable(subject, sequence):
                    camera = cameras[subject, camera_id]
                    look = None if looks is None else self._look(looks, subject, sequence, camera_id)
                    clips.append(
                        Clip(subject, action, sequence, camera_id, camera, f"{path}, camera {camera_id}",
                             _frames(path), _lazily(points, path, camera), look, self._layout())
                    )  # fmt: skip
        return clips

    def _layout(self) -> str:
        return {"sh": "hourglass", "sh_mpii": "hourglass_mpii"}.get(self.keypoints, "h36m")

    def _looks(self, subject: str) -> dict[tuple[str, str], Path]:
        """Return the files of detections by sequence and camera."""
        folder = self.folder / subject / self.files_of[self.keypoints]
        found = {}
        for path in sorted(folder.glob("*.h5")):
            name, _, camera_id = path.stem.rpartition(".")
            parsed = sequence_name(name, str(path))
            if parsed:
                found[parsed[1], camera_id] = path
        return found

    def _look(self, looks: dict, subject: str, sequence: str, camera_id: str) -> Callable[[], np.ndarray]:
        path = looks.get((sequence, camera_id))
        if path is None:
            folder = self.folder / subject / self.files_of[self.keypoints]
            raise UserError(f"{folder} has no detections of '{sequence}' by camera {camera_id}.")
        return lambda: points_of(_read(path, "poses"), f"{path}, 'poses'", (16,), (2, 3))

    def _cameras(self, split: str) -> dict[tuple[str, str], Camera]:
        path = self.folder / "cameras.h5"
        if not path.is_file():
            return {(s, c): published(s, c) for s in SUBJECTS[split] for c in CAMERAS}
        cameras = {}
        for subject in SUBJECTS[split]:
            for number in range(1, 5):
                told = {
                    key: _read(path, f"subject{subject[1:]}/camera{number}/{key}").astype(float).squeeze()
                    for key in ("R", "T", "f", "c", "k", "p", "Name")
                }
                camera_id = "".join(chr(int(letter)) for letter in np.atleast_1d(told.pop("Name")))
                if camera_id not in CAMERAS or told["R"].shape != (3, 3) or any(
                    told[key].shape != (size,) for key, size in zip("Tfckp", (3, 2, 2, 3, 2), strict=True)
                ):  # fmt: skip
                    raise UserError(f"{path}: subject{subject[1:]}/camera{number} is no camera of Human3.6M.")
                told["R"] = told["R"].T  # stored by column
                cameras[subject, camera_id] = camera_of(**told)
        return cameras


def _lazily(points: Callable[[Path], np.ndarray], path: Path, camera: Camera) -> Callable[[int], np.ndarray]:
    return lambda step: in_room(points(path), camera)(step)


def _points(path: Path) -> np.ndarray:
    """Return (frames, 32, 3): the file has a column a frame."""
    values = _read(path, "3D_positions")
    if values.ndim != 2 or values.shape[0] != 96:
        raise UserError(f"{path}: '3D_positions' has shape {values.shape}, expected (96, frames): 32 joints in 3D.")
    return values.T.reshape(-1, 32, 3)


def _frames(path: Path) -> int:
    return _h5(path, "3D_positions", lambda array: array.shape[-1] if array.shape else 0)


def _read(path: Path, name: str) -> np.ndarray:
    array = _h5(path, name, lambda found: found[()])
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise UserError(f"{path}: '{name}' holds no numbers.")
    return array


def _h5(path: Path, name: str, take: Callable[[Any], Any]) -> Any:
    """Return what ``take`` makes of an array of a file; raises UserError where there is none."""
    try:
        import h5py
    except ImportError:
        raise UserError(f'{path} is an HDF5 file: pip install "uplift3d[h36m]" to read it.') from None
    try:
        with h5py.File(path, "r") as file:
            found = file.get(name)
            if not isinstance(found, h5py.Dataset):
                raise UserError(f"{path} has no '{name}' (found: {', '.join(list(file)[:10]) or 'nothing'}).")
            if found.nbytes > 4 * max(path.stat().st_size, 1 << 20) * 1000:
                raise UserError(f"{path}: '{name}' claims {found.nbytes:,} bytes: damaged file.")
            return take(found)
    except (OSError, ValueError, TypeError, KeyError, RuntimeError, MemoryError) as error:
        raise UserError(f"{path} cannot be read as HDF5 ({error}): truncated, or another format?") from error
