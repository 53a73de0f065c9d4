"""The cameras of MPI-INF-3DHP: calibration files of the training set, the two known cameras of the test set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.lens import Lens

__all__ = [
    "CAMERA_SETS",
    "FAR_PX",
    "Camera",
    "best_lens",
    "camera_numbers",
    "published_cameras",
    "read_calibration",
    "reprojection_px",
]

CAMERA_SETS = {
    "chest": (0, 2, 4, 7, 8),
    "vnect": (0, 1, 2, 4, 5, 6, 7, 8),
    "relevant": tuple(range(11)),
    "ceiling": (11, 12, 13),
    "all": tuple(range(14)),
}
"""The set's own groups: chest height; these with one at the knee and two angled down; all but the ceiling; ..."""

_HEADER = "Skeletool Camera Calibration File"
_SAMPLE = 4000
_CLOSE_PX = 2.0
FAR_PX = 50.0
"""Farther than this from what was seen, points were not seen by that camera."""


@dataclass(frozen=True)
class Camera:
    """A lens and how far the camera looks down."""

    lens: Lens
    tilt_deg: float


def camera_numbers(cameras: str) -> tuple[int, ...]:
    """Return the numbers that ``cameras`` means: a name of `CAMERA_SETS`, or numbers with commas.

    Raises:
        UserError: neither, or a number that no camera has.
    """
    if cameras in CAMERA_SETS:
        return CAMERA_SETS[cameras]
    parts = [part.strip() for part in str(cameras).strip("[]").split(",") if part.strip()]
    if not parts or any(not part.isdigit() or int(part) > 13 for part in parts):
        raise UserError(
            f"data.options.cameras={cameras!r}: expected one of {', '.join(CAMERA_SETS)}, or numbers from 0 to 13: 0,2,4."
        )
    return tuple(sorted({int(part) for part in parts}))


def read_calibration(path: Path) -> dict[int, Camera]:
    """Return the cameras of a camera.calibration file by number.

    Raises:
        UserError: no such file, another format, or numbers that are missing.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read as a camera calibration: {error}") from None
    if not lines or not lines[0].startswith(_HEADER):
        raise UserError(f"{path} does not begin with '{_HEADER} V1.0': no camera.calibration of MPI-INF-3DHP.")
    blocks: list[dict[str, tuple[int, str]]] = []
    for number, line in enumerate(lines[1:], start=2):
        key, _, rest = line.strip().partition(" ")
        if key == "name":
            blocks.append({})
        if key and blocks:
            blocks[-1][key] = (number, rest)
    return dict(_camera(path, block) for block in blocks)


def _camera(path: Path, block: dict[str, tuple[int, str]]) -> tuple[int, Camera]:
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
    return int(name), Camera(lens, down_tilt_deg(-turn[:, 1]))  # the world's y is up


def _numbers(path: Path, block: dict[str, tuple[int, str]], key: str, count: int) -> list[float]:
    line, text = block.get(key, (block["name"][0], ""))
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise UserError(f"{path}, line {line}: expected '{key}' with {count} number(s) for this camera: cut short?")
    return values


def down_tilt_deg(gravity: np.ndarray) -> float:
    """Return the tilt of a camera that sees gravity along (x, y, z)."""
    return float(np.degrees(np.arctan2(gravity[2], gravity[1])))


def _test_camera(
    focal_mm, aspect, offset_mm, sensor_mm, size, up, right, radial=(0.0, 0.0, 0.0), tangential=(0.0, 0.0)
):
    per_mm = np.array(size) / np.array(sensor_mm) * (1, aspect)
    centre = (np.array(sensor_mm) / 2 + offset_mm) * per_mm
    lens = Lens(tuple(focal_mm * per_mm), tuple(centre), radial, tangential, size)
    turn = np.stack([right, -np.array(up), np.cross(up, right)])
    return Camera(lens, down_tilt_deg(-turn[:, 1]))


def published_cameras(number: int) -> list[Camera]:
    """Return what the camera of TS1..TS6 may be: as published, and for TS5 and TS6 also without its distortion.

    The figures are those of the calibration files that come with the test set, in mm on the sensor.
    """
    if number <= 4:
        return [
            _test_camera(
                7.32506, 1.00044, (-0.0322884, 0.0929296), (10, 10), (2048, 2048),
                (-0.208215, 0.976233, 0.06014), (0.000575281, 0.0616098, -0.9981),
            )
        ]  # fmt: skip
    outdoors = (
        8.770747185, 0.993236423, (-0.104908645, 0.104899704), (10, 5.625), (1920, 1080),
        (0.025272345, 0.995038509, 0.096227370), (-0.939647257, -0.009210289, 0.342020929),
    )  # fmt: skip
    # OpenCV's p2, p1: its terms 2 p1 x y and 2 p2 x x are twice what `Lens` has, here by less than a pixel.
    bent = _test_camera(*outdoors, (-0.276859611, 0.131125256, -0.049318332), (-0.001149441, -0.000360494))
    return [bent, _test_camera(*outdoors)]


def best_lens(
    cameras: list[Camera], points: Float[np.ndarray, "frames joints 3"], seen: Float[np.ndarray, "frames joints 2"]
) -> tuple[Camera, float]:
    """Return the camera that projects ``points`` nearest to ``seen``, and by how many pixels it is off.

    Where none of ``cameras`` is within two pixels, but one is near, a pinhole fitted to the points is tried, too.
    """
    found = [(reprojection_px(camera.lens, points, seen), camera) for camera in cameras]
    error, best = min(found, key=lambda pair: pair[0])
    if not _CLOSE_PX < error <= FAR_PX:
        return best, error
    fitted = Camera(_fit(points, seen, best.lens.image_size), best.tilt_deg)
    fitted_error = reprojection_px(fitted.lens, points, seen)
    return (fitted, fitted_error) if fitted_error < error else (best, error)


def reprojection_px(lens: Lens, points: np.ndarray, seen: np.ndarray) -> float:
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
    """Return the pinhole that fits best by linear least squares, each axis for itself."""
    points, seen = _sample(points, seen)
    solved = []
    for axis in (0, 1):
        known = np.stack([points[:, axis] / points[:, 2], np.ones(len(points))], 1)
        solved.append(np.linalg.lstsq(known, seen[:, axis], rcond=None)[0] if len(points) else np.ones(2))
    (fx, cx), (fy, cy) = solved
    return Lens((float(max(fx, 1)), float(max(fy, 1))), (float(cx), float(cy)), image_size=size)
