"""MPI-INF-3DHP: markerless motion capture of eight people by 14 cameras, and six test sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.datasets.base import DataSet, WantedFile
from uplift.datasets.mpi_inf_3dhp_cameras import (
    FAR_PX,
    Camera,
    best_lens,
    camera_numbers,
    published_cameras,
    read_calibration,
    reprojection_px,
)
from uplift.datasets.mpi_inf_3dhp_files import ACTIVITIES, TEST_JOINTS, TRAIN_JOINTS, Sequence, read_test, read_train
from uplift.datasets.mpi_inf_3dhp_rows import Rows
from uplift.errors import UserError, did_you_mean
from uplift.lens import Lens

__all__ = ["MpiInf3dhp"]

_SEQUENCES = {
    "S1": ((6416, 25), (12430, 50)),
    "S2": ((6502, 25), (6081, 25)),
    "S3": ((12488, 50), (12283, 50)),
    "S4": ((6171, 25), (6675, 25)),
    "S5": ((12820, 50), (12312, 50)),
    "S6": ((6188, 25), (6145, 25)),
    "S7": ((6239, 25), (6320, 25)),
    "S8": ((6468, 25), (6054, 25)),
}
"""Frames that have images, and frames a second, of Seq1 and Seq2."""
_TEST = tuple(f"TS{number}" for number in range(1, 7))
_FOLDERS = {
    "train": ("", "train", "mpi_inf_3dhp"),
    "test": ("", "mpi_inf_3dhp_test_set", "test", "mpi_inf_3dhp_test_set/mpi_inf_3dhp_test_set"),
}


class MpiInf3dhp(DataSet):
    """Training sequences seen by some of the 14 cameras, and the valid frames of the test set."""

    title = "MPI-INF-3DHP"
    about = """\
From vcai.mpi-inf.mpg.de/3dhp-dataset (scripts get_dataset.sh and get_testset.sh), for research alone, not to be passed
on. Videos are not needed. Put S1/Seq1/annot.mat and S1/Seq1/camera.calibration ... S8/Seq2/... into the folder, and
TS1/annot_data.mat ... TS6/annot_data.mat beside them or in mpi_inf_3dhp_test_set/.
data.options.subjects=S1,S2 reads some of them."""
    splits = ("train", "test")

    def __init__(self, folder: Path, cameras: str = "chest", universal: bool = True, fps: int = 25, subjects: str = ""):
        super().__init__(folder)
        self.cameras = cameras
        self.universal = universal
        self.fps = int(fps)
        self.subjects = subjects
        camera_numbers(cameras)
        if self.fps < 1 or 25 % self.fps or fps != self.fps:
            raise UserError(f"data.options.fps={fps}: expected 25, 5 or 1: sequences have 25 or 50 frames a second.")
        known = (*_SEQUENCES, *_TEST)
        for name in self._wanted():
            if name not in known:
                raise UserError(f"data.options.subjects={subjects}: no subject '{name}'.{did_you_mean(name, known)}")

    def _wanted(self) -> list[str]:
        return [name.strip() for name in self.subjects.split(",") if name.strip()]

    def _subjects(self, split: str) -> list[str]:
        known = _TEST if split == "test" else tuple(_SEQUENCES)
        return [name for name in known if name in self._wanted()] or list(known)

    def files(self, split: str) -> list[WantedFile]:
        self.check_split(split)
        files = []
        for subject in self._subjects(split):
            if split == "test":
                path = self._place(split, f"{subject}/annot_data.mat")
                files.append(WantedFile(path, f"annotations of {subject} ({subject}/annot_data.mat)"))
                continue
            for sequence in ("Seq1", "Seq2"):
                for name, what in (("annot.mat", "annotations"), ("camera.calibration", "cameras")):
                    path = f"{subject}/{sequence}/{name}"
                    files.append(WantedFile(self._place(split, path), f"{what} of {subject} {sequence} ({path})"))
        return files

    def _place(self, split: str, path: str) -> Path:
        places = [self.folder / folder / path for folder in _FOLDERS[split]]
        return next((place for place in places if place.is_file()), places[0])

    def read(self, split: str) -> PoseData:
        self.check_split(split)
        data = self._read_test() if split == "test" else self._read_train()
        poses = "univ_annot3" if self.universal else "annot3"
        seen = f"cameras {self.cameras}, {self.fps} frames a second" if split == "train" else "valid frames"
        who = f"{', '.join(self._subjects(split))}, " if self.subjects else ""
        data.source = f"{self.title} {split} in {self.folder} ({who}{seen}, {poses})"
        return data

    def _read_train(self) -> PoseData:
        cameras = camera_numbers(self.cameras)
        subjects = self._subjects("train")
        most = sum(-(-count * self.fps // rate) for name in subjects for count, rate in _SEQUENCES[name])
        rows = Rows(most * len(cameras), TRAIN_JOINTS)
        for subject in subjects:
            for place, (count, rate) in enumerate(_SEQUENCES[subject]):
                name = f"Seq{place + 1}"
                path, known = self._known_cameras(subject, name, cameras)
                step = rate // self.fps
                for camera, sequence in read_train(path, cameras, self.universal).items():
                    _check_camera(path, known[camera].lens, camera, sequence)
                    thin = sequence.rows(slice(0, count, step))
                    frames = np.arange(len(thin.seen))
                    rows.add(thin, known[camera], frames, {"subject": subject, "sequence": name, "camera": camera})
        data = rows.finish()
        data.fps, data.image_size = float(self.fps), (2048, 2048)
        return data

    def _known_cameras(self, subject: str, name: str, cameras: tuple[int, ...]) -> tuple[Path, dict[int, Camera]]:
        path = self._place("train", f"{subject}/{name}/annot.mat")
        calibration = self._place("train", f"{subject}/{name}/camera.calibration")
        known = read_calibration(calibration)
        absent = [str(camera) for camera in cameras if camera not in known]
        if absent:
            raise UserError(f"{calibration} has no camera {', '.join(absent)} (found {len(known)}): cut short?")
        return path, known

    def _read_test(self) -> PoseData:
        found = []
        for subject in self._subjects("test"):
            path = self._place("test", f"{subject}/annot_data.mat")
            sequence, frames, activity = read_test(path, self.universal)
            number = int(subject[2:])
            camera, off = best_lens(published_cameras(number), sequence.points, sequence.seen)
            if off > FAR_PX:
                raise UserError(_apart(path, off))
            identity = {"subject": subject, "sequence": subject, "camera": int(number > 4)}
            found.append((sequence, camera, frames, {**identity, "action": np.array(ACTIVITIES)[activity - 1]}))
        rows = Rows(sum(len(sequence.seen) for sequence, *_ in found), TEST_JOINTS)
        for each in found:
            rows.add(*each)
        return rows.finish()


def _check_camera(path: Path, lens: Lens, camera: int, sequence: Sequence) -> None:
    off = reprojection_px(lens, sequence.points, sequence.seen)
    if off > FAR_PX:
        raise UserError(f"camera.calibration beside {_apart(path, off)} (camera {camera})")


def _apart(path: Path, off: float) -> str:
    return (
        f"{path}: 'annot3' lies {off:,.0f} px from 'annot2' when seen by the known camera: damaged, or arrays of "
        "different sequences, or another sequence's file?"
    )
