"""Calibrated cameras of one scene: Pose2Sim's and Anipose's .toml, and the same as .json; read, matched by name, written."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.config.files import replacing
from uplift.data.parsers.files import existing_file, read_bytes, reason_of
from uplift.data.parsers.json import load_json
from uplift.errors import UserError
from uplift.geometry.lens import Lens
from uplift.geometry.rigid import rotation_by

__all__ = ["SceneCamera", "match_cameras", "read_cameras", "write_cameras"]

_FAR_M = 100.0
"""Cameras of one scene are no farther from each other, metres; in millimetres they are no nearer."""
_MOST = 1000


@dataclass(frozen=True)
class SceneCamera:
    """A camera of a scene: its lens, and where it is if that is known."""

    name: str
    lens: Lens
    rotation: Float[np.ndarray, "3 3"] | None = None
    """From the world to the camera: x right, y down, z away."""
    translation: Float[np.ndarray, " 3"] | None = None
    """A point X of the world is at R X + t in the camera's frame."""
    error_px: float | None = None
    """Median distance of its keypoints from where the body is seen, where that was measured."""

    @property
    def position(self) -> Float[np.ndarray, " 3"] | None:
        """Where the camera is in the world."""
        return None if self.rotation is None else -self.rotation.T @ self.translation

    @property
    def focal_px(self) -> float:
        """The mean focal length."""
        return float(np.mean(self.lens.focal_px))


def read_cameras(path: str | Path, unit: str | None = None) -> tuple[list[SceneCamera], str]:
    """Return the cameras of a calibration file, places in mm, and a note on how it was read.

    Each camera is a table with ``name``, ``size``, ``matrix`` (3 x 3) and ``distortions`` (k1, k2, p1, p2, k3 as OpenCV
    has them), and for its place ``rotation`` (a vector of Rodrigues, or 3 x 3) and ``translation``, both from the world
    to the camera. Cameras without a place have only their lens known. In .json they are the list ``cameras``, or an
    object of tables by name.

    Args:
        path: .toml or .json.
        unit: of translations, ``mm`` or ``m``; None: metres where all cameras are within 100 of each other, else mm.

    Raises:
        UserError: another or a damaged file, no camera, fisheye lenses, a table that lacks something.
    """
    path = existing_file(path, "calibrated cameras (.toml or .json)")
    if path.suffix.lower() not in (".toml", ".json"):
        raise UserError(f"{path}: expected calibrated cameras as .toml (Pose2Sim, Anipose) or .json.")
    content = load_json(path) if path.suffix.lower() == ".json" else _toml(path)
    found = content.get("cameras", content) if isinstance(content, dict) else content
    tables = found.items() if isinstance(found, dict) else enumerate(found) if isinstance(found, list) else []
    tables = [(str(key), table) for key, table in tables if isinstance(table, dict) and key != "metadata"]
    if not 0 < len(tables) <= _MOST:
        raise UserError(f"{path}: holds {len(tables)} cameras, expected a table for each, with matrix and size.")
    cameras = [_camera(f"{path}: camera {key}", key, table) for key, table in tables]
    names = [one.name for one in cameras]
    if len(set(names)) < len(names):
        raise UserError(
            f"{path}: two cameras have the name {max(names, key=names.count)}, expected each to have its own."
        )
    unit, note = _unit_of(cameras, unit, path.name)
    factor = 1000.0 if unit == "m" else 1.0
    placed = [one if one.translation is None else _at(one, one.translation * factor) for one in cameras]
    return placed, note


def _at(camera: SceneCamera, translation: np.ndarray) -> SceneCamera:
    return SceneCamera(camera.name, camera.lens, camera.rotation, translation, camera.error_px)


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_bytes(path).decode("utf-8-sig"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise UserError(f"{path} cannot be read as TOML ({reason_of(error)}): truncated, or another format?") from None


def _unit_of(cameras: Sequence[SceneCamera], unit: str | None, name: str) -> tuple[str, str]:
    """Return the unit of places, given or guessed, and a note where it was guessed."""
    places = np.array([one.position for one in cameras if one.rotation is not None])
    if unit is not None or not len(places):
        return unit or "mm", ""
    unit = "m" if np.ptp(places, axis=0).max() <= _FAR_M else "mm"
    return unit, f"places of cameras in {name} are taken as {'metres' if unit == 'm' else 'mm'} (cameras_unit=mm|m)"


def _camera(where: str, key: str, table: dict[str, Any]) -> SceneCamera:
    """Return the camera of one table; raises UserError for what it lacks or has in another shape."""
    if table.get("fisheye") is True:
        raise UserError(f"{where}: a fisheye lens, which is not supported: undistort its keypoints first.")
    matrix = _numbers(where, table, "matrix", (3, 3))
    size = _numbers(where, table, "size", (2,))
    assert matrix is not None and size is not None
    bends = _numbers(where, table, "distortions", None)
    bends = np.zeros(5) if bends is None else np.concatenate([bends.ravel(), np.zeros(5)])
    if bends[5:].any():
        raise UserError(
            f"{where}: 'distortions' has {np.flatnonzero(bends)[-1] + 1} numbers, expected k1, k2, p1, p2, k3."
        )
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and (size > 0).all() and (size < 1e6).all()):
        raise UserError(f"{where}: focal lengths {matrix[0, 0]:g}, {matrix[1, 1]:g} and size {size}, expected pixels.")
    k1, k2, p1, p2, k3 = bends[:5].tolist()
    lens = Lens(
        (float(matrix[0, 0]), float(matrix[1, 1])), (float(matrix[0, 2]), float(matrix[1, 2])), (k1, k2, k3),
        (p2, p1), (round(float(size[0])), round(float(size[1]))), opencv=True,
    )  # fmt: skip
    given = {"rotation", "translation"} & set(table)
    if not given:
        return SceneCamera(str(table.get("name", key)), lens)
    translation = _numbers(where, table, "translation", (3,))
    rotation = _numbers(where, table, "rotation", None)
    if rotation is None or rotation.shape not in ((3,), (3, 3)):
        raise UserError(
            f"{where}: 'rotation' is a vector of Rodrigues (3 numbers) or 3 x 3, and goes with 'translation'."
        )
    rotation = rotation if rotation.shape == (3, 3) else rotation_by(rotation)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise UserError(f"{where}: 'rotation' is no rotation: its rows are not at right angles, or it mirrors.")
    return SceneCamera(str(table.get("name", key)), lens, rotation, translation)


def _numbers(where: str, table: dict[str, Any], key: str, shape: tuple[int, ...] | None) -> np.ndarray | None:
    """Return an array of the table; None without it where any ``shape`` will do. Raises UserError for another."""
    if key not in table and shape is None:
        return None
    try:
        values = np.asarray(table.get(key), np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not np.isfinite(values).all() or (shape is not None and values.shape != shape) or values.size > 100:
        expected = "numbers" if shape is None else f"{' x '.join(map(str, shape))} numbers"
        raise UserError(f"{where}: '{key}' is {str(table.get(key))[:40]}, expected {expected}.")
    return values


def _to_vector(rotation: np.ndarray) -> np.ndarray:
    """Return the vector that a rotation turns about, as long as its angle in radians."""
    from scipy.spatial.transform import Rotation  # slow to import

    return Rotation.from_matrix(rotation).as_rotvec()


# Names.


def match_cameras(cameras: Sequence[SceneCamera], names: Sequence[str]) -> list[SceneCamera]:
    """Return the camera of each view, by name: the same name, or the one whose name is part of the view's (``walk_cam01``).

    Capitals, separators and leading zeros do not count. Raises UserError where no or several cameras fit a view.
    """
    chosen = []
    for name in names:
        exact = [one for one in cameras if _plain(one.name) == _plain(name)]
        inside = [one for one in cameras if re.search(rf"(?<![a-z0-9]){_plain(one.name)}(?!\d)", _plain(name))]
        found = exact or inside
        if len(found) != 1:
            known = ", ".join(one.name for one in cameras)
            which = f"{len(found)} cameras fit" if found else "no camera fits"
            raise UserError(f"{which} the view '{name}': views and cameras go by name. Cameras: {known}.")
        chosen.append(found[0])
    if len({one.name for one in chosen}) < len(chosen):
        raise UserError(f"two of the views {', '.join(names)} are of one camera: each needs one of its own.")
    return chosen


def _plain(name: str) -> str:
    return re.sub(r"(?<!\d)0+(?=\d)", "", re.sub(r"(?<=[a-z])[\s_.-]+(?=\d)", "", name.casefold()))


# Writing.


def write_cameras(cameras: Sequence[SceneCamera], path: str | Path, *, unit: str) -> None:
    """Write placed cameras as Pose2Sim and Anipose read them; the places as they are, metres where ``unit`` is mm.

    Raises UserError for another ending than .toml, or a file that cannot be written.
    """
    if Path(path).suffix.lower() != ".toml":
        raise UserError(f"{path}: cameras are written as .toml, expected a name that ends so.")
    lines = []
    for number, one in enumerate(cameras):
        assert one.rotation is not None and one.translation is not None
        lens, place = one.lens, one.translation / (1000 if unit == "mm" else 1)
        (fx, fy), (cx, cy), (k1, k2, k3) = lens.focal_px, lens.centre_px, lens.radial
        p2, p1 = lens.tangential if lens.opencv else np.divide(lens.tangential, 2)  # as near as OpenCV's form comes
        values = {
            "name": json.dumps(one.name),
            "size": [float(side) for side in lens.image_size or (0, 0)],
            "matrix": [[float(fx), 0.0, float(cx)], [0.0, float(fy), float(cy)], [0.0, 0.0, 1.0]],
            "distortions": [float(k) for k in (k1, k2, p1, p2, *([k3] if k3 else []))],
            "rotation": _to_vector(one.rotation).tolist(),
            "translation": place.tolist(),
            "fisheye": "false",
        }
        lines += [f"[cam_{number + 1:02d}]", *(f"{key} = {value}" for key, value in values.items()), ""]
    metres = "metres" if unit == "mm" else "the unit of the poses, which is not known in metres"
    lines += ["[metadata]", "adjusted = false", "error = 0.0", f'unit = "{metres}"', ""]
    with replacing(path) as handle:
        handle.write("\n".join(lines).encode())
