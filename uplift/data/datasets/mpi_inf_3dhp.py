"""MPI-INF-3DHP: markerless motion capture of eight people by 14 cameras, and six test sequences."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from uplift.data.datasets.base import DataSet, Rows, WantedFile, first_file
from uplift.data.parsers.matlab import load_mat
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean, listed
from uplift.geometry.lens import Lens

__all__ = ["ACTIVITIES", "MpiInf3dhp", "published_cameras"]

# The cameras of MPI-INF-3DHP: calibration files of the training set, the two known cameras of the test set.

_CAMERA_SETS = {
    "chest": (0, 2, 4, 7, 8),
    "vnect": (0, 1, 2, 4, 5, 6, 7, 8),
    "relevant": tuple(range(11)),
    "ceiling": (11, 12, 13),
    "all": tuple(range(14)),
}
"""The groups of the data set: chest height; these with one at the knee and two angled down; all but the ceiling; ..."""

_HEADER = "Skeletool Camera Calibration File"
_SAMPLE = 4000
_CLOSE_PX = 2.0
_FAR_PX = 50.0
"""Farther than this from what was seen, points were not seen by that camera."""


@dataclass(frozen=True)
class _Camera:
    """A lens and how far the camera looks down."""

    lens: Lens
    tilt_deg: float


def _camera_numbers(cameras: str) -> tuple[int, ...]:
    """Return the numbers that ``cameras`` means: a name of `_CAMERA_SETS`, or numbers with commas.

    Raises:
        UserError: neither, or a number that no camera has.
    """
    if cameras in _CAMERA_SETS:
        return _CAMERA_SETS[cameras]
    parts = [part.strip() for part in str(cameras).strip("[]").split(",") if part.strip()]
    if not parts or any(not part.isdigit() or int(part) > 13 for part in parts):
        raise UserError(
            f"data.options.cameras={cameras!r}: expected one of {', '.join(_CAMERA_SETS)}, or numbers from 0 to 13: 0,2,4."
        )
    return tuple(sorted({int(part) for part in parts}))


def _read_calibration(path: Path) -> dict[int, _Camera]:
    """Return the cameras of a camera.calibration file by number.

    Raises:
        UserError: no such file, another format, or numbers that are missing.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read as a camera calibration: {error}") from None
    if not lines or not lines[0].startswith(_HEADER):
        raise UserError(f"{path} does not begin with '{_HEADER} V1.0': not a camera.calibration of MPI-INF-3DHP.")
    blocks: list[dict[str, tuple[int, str]]] = []
    for number, line in enumerate(lines[1:], start=2):
        key, _, rest = line.strip().partition(" ")
        if key == "name":
            blocks.append({})
        if key and blocks:
            blocks[-1][key] = (number, rest)
    return dict(_camera(path, block) for block in blocks)


def _camera(path: Path, block: dict[str, tuple[int, str]]) -> tuple[int, _Camera]:
    (name,), size = _numbers(path, block, "name", 1), _numbers(path, block, "size", 2)
    inside = np.reshape(_numbers(path, block, "intrinsic", 16), (4, 4))
    outside = np.reshape(_numbers(path, block, "extrinsic", 16), (4, 4))
    turn = outside[:3, :3]
    if min(inside[0, 0], inside[1, 1]) <= 0 or np.abs(turn @ turn.T - np.eye(3)).max() > 0.01:
        raise UserError(
            f"{path}, line {block['name'][0]}: camera {name:g} has no focal length or no rotation: damaged?"
        )
    lens = Lens(
        focal_px=(float(inside[0, 0]), float(inside[1, 1])),
        centre_px=(float(inside[0, 2]), float(inside[1, 2])),
        image_size=(int(size[0]), int(size[1])),
    )
    return int(name), _Camera(lens, _down_tilt_deg(-turn[:, 1]))  # the world's y is up


def _numbers(path: Path, block: dict[str, tuple[int, str]], key: str, count: int) -> list[float]:
    line, text = block.get(key, (block["name"][0], ""))
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise UserError(f"{path}, line {line}: expected '{key}' with {count} number(s) for this camera: cut short?")
    return values


def _down_tilt_deg(gravity: np.ndarray) -> float:
    """Return the tilt of a camera that sees gravity along (x, y, z)."""
    return float(np.degrees(np.arctan2(gravity[2], gravity[1])))


def _test_camera(
    focal_mm, aspect, offset_mm, sensor_mm, size, up, right, radial=(0.0, 0.0, 0.0), tangential=(0.0, 0.0)
) -> _Camera:
    per_mm = np.array(size) / np.array(sensor_mm)
    centre = (np.array(sensor_mm) / 2 + offset_mm) * per_mm  # the sensor's middle is the image's, whatever the aspect
    lens = Lens(tuple(focal_mm * per_mm * (1, aspect)), tuple(centre), radial, tangential, size)
    down, forward = -np.array(up), np.cross(up, right)
    return _Camera(lens, _down_tilt_deg(np.array([-right[1], -down[1], -forward[1]])))


def published_cameras(number: int) -> list[_Camera]:
    """Return what the camera of TS1..TS6 may be: as published, and for TS5 and TS6 also without its distortion.

    The figures are those of the calibration files that come with the test set, in mm on the sensor.
    """
    if number <= 4:
        return [_test_camera(
            7.32506, 1.00044, (-0.0322884, 0.0929296), (10, 10), (2048, 2048),
            (-0.208215, 0.976233, 0.06014), (0.000575281, 0.0616098, -0.9981),
        )]  # fmt: skip
    outdoors = (
        8.770747185, 0.993236423, (-0.104908645, 0.104899704), (10, 5.625), (1920, 1080),
        (0.025272345, 0.995038509, 0.096227370), (-0.939647257, -0.009210289, 0.342020929),
    )  # fmt: skip
    # OpenCV's p2, p1: its terms 2 p1 x y and 2 p2 x x are twice what `Lens` has, here by less than a pixel.
    bent = _test_camera(*outdoors, (-0.276859611, 0.131125256, -0.049318332), (-0.001149441, -0.000360494))
    return [bent, _test_camera(*outdoors)]


def _best_lens(
    cameras: list[_Camera], points: Float[np.ndarray, "frames joints 3"], seen: Float[np.ndarray, "frames joints 2"]
) -> tuple[_Camera, float]:
    """Return the camera that projects ``points`` nearest to ``seen``, and by how many pixels it is off.

    Where none of ``cameras`` is within two pixels, but one is near, a pinhole fitted to the points is tried, too.
    """
    found = [(camera, _reprojection_px(camera.lens, points, seen)) for camera in cameras]
    best, error = min(found, key=itemgetter(1))
    if _CLOSE_PX < error <= _FAR_PX:
        fitted = _Camera(_fit(points, seen, best.lens.image_size), best.tilt_deg)
        return min([(best, error), (fitted, _reprojection_px(fitted.lens, points, seen))], key=itemgetter(1))
    return best, error


def _reprojection_px(lens: Lens, points: np.ndarray, seen: np.ndarray) -> float:
    """Return the median distance of projected points to where they were seen, over a sample of frames."""
    points, seen = _sample(points, seen)
    if not len(points):
        return float("inf")
    return float(np.median(np.linalg.norm(lens.project(points) - seen, axis=-1)))


def _sample(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    step = max(1, len(points) // (_SAMPLE // points.shape[1] + 1))
    points, seen = points[::step].reshape(-1, 3).astype(np.float64), seen[::step].reshape(-1, 2).astype(np.float64)
    known = np.isfinite(points).all(-1) & np.isfinite(seen).all(-1) & (points[:, 2] > 1)
    return points[known], seen[known]


def _fit(points: np.ndarray, seen: np.ndarray, size: tuple[int, int] | None) -> Lens:
    """Return the pinhole that fits best by linear least squares, each axis on its own."""
    points, seen = _sample(points, seen)
    solved = []
    for axis in (0, 1):
        known = np.stack([points[:, axis] / points[:, 2], np.ones(len(points))], 1)
        solved.append(np.linalg.lstsq(known, seen[:, axis], rcond=None)[0] if len(points) else np.ones(2))
    (fx, cx), (fy, cy) = solved
    return Lens((float(max(fx, 1)), float(max(fy, 1))), (float(cx), float(cy)), image_size=size)


# The annotation files of MPI-INF-3DHP: annot.mat of a training sequence, annot_data.mat of a test sequence.

_TRAIN_JOINTS = (
    "spine3", "spine4", "spine2", "spine", "pelvis", "neck", "head", "head_top", "left_clavicle", "left_shoulder",
    "left_elbow", "left_wrist", "left_hand", "right_clavicle", "right_shoulder", "right_elbow", "right_wrist",
    "right_hand", "left_hip", "left_knee", "left_ankle", "left_foot", "left_toe", "right_hip", "right_knee",
    "right_ankle", "right_foot", "right_toe",
)  # fmt: skip
_TEST_JOINTS = (
    "head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "pelvis", "spine", "head",
)  # fmt: skip
ACTIVITIES = (
    "Standing/Walking", "Exercising", "Sitting", "Reaching/Crouching", "On The Floor", "Sports", "Miscellaneous",
)  # fmt: skip
"""Of the test set, in the order of their numbers from 1."""


_ANNOTATIONS = ("annot2", "annot3", "univ_annot3")


class _Sequence(NamedTuple):
    """What one camera saw in one sequence."""

    seen: np.ndarray
    """(frames joints 2) px."""
    points: np.ndarray
    """(frames joints 3) mm in the camera frame."""
    universal: np.ndarray | None
    """(frames joints 3) mm: the same scaled to a universal height; None where it was not requested."""

    def rows(self, rows: slice | np.ndarray) -> _Sequence:
        """Return some of its frames."""
        return _Sequence(self.seen[rows], self.points[rows], None if self.universal is None else self.universal[rows])


def read_train(path: Path, cameras: Collection[int], universal: bool) -> dict[int, _Sequence]:
    """Return what each of ``cameras`` saw, from an annot.mat of 28 joints.

    Raises:
        UserError: a file that is damaged or another one, a camera that it does not have.
    """
    names = _ANNOTATIONS if universal else _ANNOTATIONS[:2]
    found = load_mat(path, [*names, "cameras"], cells=cameras)
    _check_names(path, names, found, "annot.mat of a training sequence")
    numbers = np.asarray(found.get("cameras", np.arange(14))).ravel()
    sequences = {}
    for camera in sorted(cameras):
        place = np.flatnonzero(numbers == camera)
        if not len(place):
            shown = ", ".join(f"{number:g}" for number in numbers)
            raise UserError(f"{path} has no camera {camera} (found: {shown}).")
        arrays = {name: _cell(path, name, found[name], int(place[0])) for name in names}
        sequences[camera] = _sequence(path, arrays, f"camera {camera}")
    return sequences


def read_test(path: Path, universal: bool) -> tuple[_Sequence, np.ndarray, np.ndarray]:
    """Return the valid frames of an annot_data.mat of 17 joints, their numbers, and their activities' numbers.

    Raises:
        UserError: a file that is damaged or another one.
    """
    names = _ANNOTATIONS if universal else _ANNOTATIONS[:2]
    of_frames = ("valid_frame", "activity_annotation")
    found = load_mat(path, [*names, *of_frames])
    _check_names(path, (*names, *of_frames), found, "annot_data.mat of a test sequence")
    sequence = _sequence(path, {name: _of_frames(path, name, found[name]) for name in names}, "the test sequence")
    flags, activity = (np.asarray(found[name]).ravel() for name in of_frames)
    frames = len(sequence.seen)
    for name, values in zip(of_frames, (flags, activity), strict=True):
        if len(values) != frames:
            raise UserError(f"{path}: '{name}' has {len(values):,} values for {frames:,} frames of 'annot2'.")
    valid = np.flatnonzero(flags == 1)
    if not len(valid):
        raise UserError(f"{path}: no frame of it is marked valid.")
    activity = activity[valid]
    if not np.isin(activity, np.arange(1, len(ACTIVITIES) + 1)).all():
        raise UserError(
            f"{path}: 'activity_annotation' goes from {activity.min():g} to {activity.max():g}, expected 1 to 7."
        )
    return sequence.rows(valid), valid, activity.astype(np.int64)


def _check_names(path: Path, names: Sequence[str], found: dict, expected: str) -> None:
    absent = [name for name in names if name not in found]
    if absent:
        have = listed(found) or "none of what was looked for"
        raise UserError(f"{path}: no '{absent[0]}' in it (found: {have}). Expected the {expected}.")


def _cell(path: Path, name: str, cells: np.ndarray | list[np.ndarray], place: int) -> np.ndarray:
    """Return one camera's (frames joints axes) of a cell array of (frames, joints * axes)."""
    axes = 2 if name == "annot2" else 3
    columns = len(_TRAIN_JOINTS) * axes
    if not isinstance(cells, list):
        raise UserError(f"{path}: '{name}' is an array of shape {cells.shape}, expected a cell for each camera.")
    if place >= len(cells):
        raise UserError(f"{path}: '{name}' has {len(cells)} cells, expected one for each camera.")
    array = cells[place]
    if array.ndim != 2 or array.shape[1] != columns:
        raise UserError(
            f"{path}: '{name}' of camera cell {place} has shape {array.shape}, expected (frames, {columns}): "
            f"{len(_TRAIN_JOINTS)} joints of {axes} numbers."
        )
    return array.reshape(len(array), len(_TRAIN_JOINTS), axes)


def _of_frames(path: Path, name: str, array: np.ndarray | list[np.ndarray]) -> np.ndarray:
    """Return (frames joints axes) of an array that MATLAB has as (axes, joints, 1, frames)."""
    axes = 2 if name == "annot2" else 3
    shape = () if isinstance(array, list) else array.shape
    if len(shape) not in (3, 4) or shape[:2] != (axes, len(_TEST_JOINTS)) or (len(shape) == 4 and shape[2] != 1):
        found = "a cell array" if isinstance(array, list) else f"of shape {shape}"
        raise UserError(f"{path}: '{name}' is {found}, expected ({axes}, {len(_TEST_JOINTS)}, 1, frames).")
    assert isinstance(array, np.ndarray)
    return np.ascontiguousarray(array.reshape(axes, len(_TEST_JOINTS), -1).transpose(2, 1, 0))


def _sequence(path: Path, arrays: dict[str, np.ndarray], where: str) -> _Sequence:
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) != 1:
        shown = ", ".join(f"{name} {count:,}" for name, count in counts.items())
        raise UserError(f"{path}: {where} has arrays of different lengths: {shown}. Damaged, or of different files?")
    if not next(iter(counts.values())):
        raise UserError(f"{path}: {where} has no frames.")
    return _Sequence(arrays["annot2"], arrays["annot3"], arrays.get("univ_annot3"))


def _add(rows: Rows, sequence: _Sequence, camera: _Camera, frames: np.ndarray, identity: dict) -> None:
    """Append the frames of one sequence seen by one camera."""
    identity = {**identity, "frame": frames.astype(np.int32)}
    keypoints, pose, confidence, root = rows.next(len(frames), camera.tilt_deg, identity, camera.lens)
    keypoints[:] = sequence.seen
    confidence[:] = np.isfinite(keypoints).all(-1)
    keypoints[confidence == 0] = 0
    pelvis = rows.joints.index("pelvis")
    pose[:], root[:] = sequence.points - sequence.points[:, pelvis, None], sequence.points[:, pelvis]
    if sequence.universal is not None:
        # The universal pose is not where the camera saw it; at this root it projects to what was seen.
        pose[:] = sequence.universal - sequence.universal[:, pelvis, None]
        root[:] = sequence.points[:, pelvis] * _scale(sequence.points - sequence.points[:, pelvis, None], pose)


def _scale(measured: np.ndarray, universal: np.ndarray) -> float:
    """Return how much larger the universal body is, one number a sequence (least squares)."""
    known = np.isfinite(measured) & np.isfinite(universal)
    measured, universal = np.where(known, measured, 0), np.where(known, universal, 0)
    size = float((measured * measured).sum())
    return float((measured * universal).sum()) / size if size else 1.0


# The data set.

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
"""Number of frames that have images, and frames a second, of Seq1 and Seq2."""
_TEST = tuple(f"TS{number}" for number in range(1, 7))
_FOLDERS = {
    "train": ("", "train", "mpi_inf_3dhp"),
    "test": ("", "mpi_inf_3dhp_test_set", "test", "mpi_inf_3dhp_test_set/mpi_inf_3dhp_test_set"),
}


class MpiInf3dhp(DataSet):
    """Training sequences seen by some of the 14 cameras, and the valid frames of the test set.

    Args:
        folder: with the files.
        cameras: chest, vnect, relevant, ceiling, all, or numbers with commas.
        universal: whether poses are those of a body of one size.
        fps: frames a second of the training sequences, 25, 5 or 1.
        subjects: with commas; all if empty.
    """

    title = "MPI-INF-3DHP"
    about = """\
From vcai.mpi-inf.mpg.de/3dhp-dataset (scripts get_dataset.sh and get_testset.sh), for research alone, not to be passed
on. Videos are not needed. Put S1/Seq1/annot.mat and S1/Seq1/camera.calibration ... S8/Seq2/... into the folder, and
TS1/annot_data.mat ... TS6/annot_data.mat beside them or in mpi_inf_3dhp_test_set/.
data.options.subjects=S1,S2 reads some of them."""
    splits = ("train", "test")

    def __init__(self, folder: Path, cameras: str = "chest", universal: bool = True, fps: int = 25, subjects: str = ""):
        super().__init__(folder)
        self.cameras, self.universal, self.fps, self.subjects = cameras, universal, int(fps), subjects
        _camera_numbers(cameras)
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
                wanted = [(f"{subject}/annot_data.mat", f"annotations of {subject}")]
            else:
                wanted = [
                    (f"{subject}/{sequence}/{name}", f"{what} of {subject} {sequence}")
                    for sequence in ("Seq1", "Seq2")
                    for name, what in (("annot.mat", "annotations"), ("camera.calibration", "cameras"))
                ]
            files += [WantedFile(self._place(split, path), f"{what} ({path})") for path, what in wanted]
        return files

    def _place(self, split: str, path: str) -> Path:
        return first_file(self.folder / folder / path for folder in _FOLDERS[split])

    def read(self, split: str) -> PoseData:
        self.check_split(split)
        data = self._read_test() if split == "test" else self._read_train()
        poses = "univ_annot3" if self.universal else "annot3"
        seen = f"cameras {self.cameras}, {self.fps} frames a second" if split == "train" else "valid frames"
        who = f"{', '.join(self._subjects(split))}, " if self.subjects else ""
        data.source = f"{self.title} {split} in {self.folder} ({who}{seen}, {poses})"
        return data

    def _read_train(self) -> PoseData:
        cameras = _camera_numbers(self.cameras)
        subjects = self._subjects("train")
        most = sum(-(-count * self.fps // rate) for name in subjects for count, rate in _SEQUENCES[name])
        rows = Rows(most * len(cameras), _TRAIN_JOINTS)
        for subject in subjects:
            for place, (count, rate) in enumerate(_SEQUENCES[subject]):
                name = f"Seq{place + 1}"
                path = self._place("train", f"{subject}/{name}/annot.mat")
                known = self._known_cameras(subject, name, cameras)
                for camera, sequence in read_train(path, cameras, self.universal).items():
                    off = _reprojection_px(known[camera].lens, sequence.points, sequence.seen)
                    if off > _FAR_PX:
                        raise UserError(f"camera.calibration beside {_apart(path, off)} (camera {camera})")
                    thin = sequence.rows(slice(0, count, rate // self.fps))
                    identity = {"subject": subject, "sequence": name, "camera": camera}
                    _add(rows, thin, known[camera], np.arange(len(thin.seen)), identity)
        return rows.data(fps=float(self.fps), image_size=(2048, 2048))

    def _known_cameras(self, subject: str, name: str, cameras: tuple[int, ...]) -> dict[int, _Camera]:
        calibration = self._place("train", f"{subject}/{name}/camera.calibration")
        known = _read_calibration(calibration)
        absent = [str(camera) for camera in cameras if camera not in known]
        if absent:
            raise UserError(f"{calibration} has no camera {', '.join(absent)} (found {len(known)}): cut short?")
        return known

    def _read_test(self) -> PoseData:
        found = []
        for subject in self._subjects("test"):
            path = self._place("test", f"{subject}/annot_data.mat")
            sequence, frames, activity = read_test(path, self.universal)
            number = int(subject[2:])
            camera, off = _best_lens(published_cameras(number), sequence.points, sequence.seen)
            if off > _FAR_PX:
                raise UserError(_apart(path, off))
            identity = {"subject": subject, "sequence": subject, "camera": int(number > 4)}
            found.append((sequence, camera, frames, {**identity, "action": np.array(ACTIVITIES)[activity - 1]}))
        rows = Rows(sum(len(sequence.seen) for sequence, *_ in found), _TEST_JOINTS)
        for each in found:
            _add(rows, *each)
        return rows.data()


def _apart(path: Path, off: float) -> str:
    return (
        f"{path}: 'annot3' lies {off:,.0f} px from 'annot2' when seen by the known camera: damaged, or arrays of "
        "different sequences, or another sequence's file?"
    )
