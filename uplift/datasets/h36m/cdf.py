"""The official CDF poses: 2D in pixels, 3D in mm in the room or in each camera's frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uplift.datasets.base import WantedFile
from uplift.datasets.h36m.cameras import Camera, published
from uplift.datasets.h36m.clips import Clip, Family, in_order, in_room, playable, points_of
from uplift.datasets.h36m.names import OF_32, SUBJECTS
from uplift.errors import UserError

__all__ = ["OfficialCdf"]

_ROOM, _MONO, _SEEN = (f"MyPoseFeatures/{name}" for name in ("D3_Positions", "D3_Positions_mono", "D2_Positions"))


class OfficialCdf(Family):
    """As the archives Poses_D2_Positions_S*.tgz and Poses_D3_Positions(_mono)_S*.tgz unpack."""

    name = "cdf"

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether any 3D is there."""
        return any(any(folder.glob(f"S*/{place}/*.cdf")) for place in (_MONO, _ROOM))

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether these keypoints are there: the ground truth, of a file or projected."""
        return keypoints in ("gt", "projected")

    def files(self, split: str) -> list[WantedFile]:
        """Return every file of the split; of a subject without any, the one that should be there first."""
        wanted = []
        for subject in SUBJECTS[split]:
            wanted += self._in(f"{subject}/{self._place()}", f"3D joints (Poses_D3_Positions_{subject}.tgz)")
            if self._has_2d():
                wanted += self._in(f"{subject}/{_SEEN}", f"2D joints (Poses_D2_Positions_{subject}.tgz)")
        return wanted

    def _in(self, place: str, what: str) -> list[WantedFile]:
        example = "Directions 1.cdf" if place.endswith(_ROOM) else "Directions 1.54138969.cdf"
        found = sorted(path for path in (self.folder / place).glob("*.cdf") if not path.name.startswith("_"))
        return [WantedFile(path, what) for path in found or [self.folder / place / example]]

    def _place(self) -> str:
        return _MONO if any(self.folder.glob(f"S*/{_MONO}/*.cdf")) else _ROOM

    def _has_2d(self) -> bool:
        return self.keypoints == "gt" and any(self.folder.glob(f"S*/{_SEEN}/*.cdf"))

    def clips(self, split: str) -> list[Clip]:
        """Return the clips that the 3D has."""
        points = lru_cache(maxsize=1)(lambda path: _read(path, 3))  # the clips of one sequence follow one another
        mono = self._place() == _MONO
        clips = []
        for subject in SUBJECTS[split]:
            folder = self.folder / subject / self._place()
            stems = {path.stem.rpartition(".")[0] if mono else path.stem for path in folder.glob("*.cdf")}
            for name, action, sequence in in_order(sorted(stems), subject, str(folder), partial=self.partial):
                for camera_id in playable(subject, sequence):
                    camera = published(subject, camera_id)
                    path = folder / (f"{name}.{camera_id}.cdf" if mono else f"{name}.cdf")
                    positions = _in_camera(path) if mono else _lazily(points, path, camera)
                    look = self._look(subject, name, camera_id) if self._has_2d() else None
                    clips.append(
                        Clip(subject, action, sequence, camera_id, camera, str(path), _shape(path)[-2], positions, look)
                    )
        return clips

    def _look(self, subject: str, name: str, camera_id: str) -> Callable[[], np.ndarray]:
        path = self.folder / subject / _SEEN / f"{name}.{camera_id}.cdf"
        return lambda: _read(path, 2)[:, OF_32]


def _lazily(points: Callable[[Path], np.ndarray], path: Path, camera: Camera) -> Callable[[int], np.ndarray]:
    return lambda step: in_room(points(path), camera)(step)


def _in_camera(path: Path) -> Callable[[int], np.ndarray]:
    return lambda step: _read(path, 3)[::step, OF_32].astype(np.float32)


def _read(path: Path, size: int) -> np.ndarray:
    """Return (frames, 32, size)."""
    _shape(path)
    values = np.asarray(_cdf(path, lambda file: file.varget("Pose")))
    values = values[0] if values.ndim == 3 and len(values) == 1 else values
    return points_of(values, f"{path}, 'Pose'", (32,), (size,))


def _shape(path: Path) -> tuple[int, ...]:
    """Return the shape that the file claims for its poses: (frames, 64 or 96), with a 1 before it or not."""
    shape = _cdf(path, lambda file: (file.varinq("Pose").Last_Rec + 1, *file.varinq("Pose").Dim_Sizes))
    shape = tuple(int(n) for n in shape)
    if len(shape) not in (2, 3) or shape[-1] not in (64, 96) or (len(shape) == 3 and shape[0] != 1):
        raise UserError(f"{path}: 'Pose' has shape {shape}, expected (frames, 64 or 96): 32 joints in 2D or 3D.")
    if np.prod(shape, dtype=object) * 4 > 1000 * path.stat().st_size:
        raise UserError(f"{path}: 'Pose' claims {shape} numbers: damaged file.")
    return shape


def _cdf(path: Path, take: Callable[[Any], Any]) -> Any:
    """Return what ``take`` makes of a file; raises UserError where it cannot."""
    try:
        import cdflib
    except ImportError:
        raise UserError(f'{path} is a CDF file: pip install "uplift3d[h36m]" to read it.') from None
    if not path.is_file():
        raise UserError(f"No file {path}, which the others beside it lead to expect.")
    try:
        return take(cdflib.CDF(path))
    except UserError:
        raise
    except Exception as error:  # the reader raises whatever it stumbles over in a damaged file
        raise UserError(f"{path} cannot be read as CDF ({error}): truncated, or another format?") from error
