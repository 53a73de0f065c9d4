"""Calibration files: as OpenCV means them, by name, in metres or mm, and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uplift.data.calibration import SceneCamera, match_cameras, read_cameras, write_cameras
from uplift.errors import UserError
from uplift.geometry.lens import Lens

MATRIX = [[1000.0, 0.0, 320.0], [0.0, 1010.0, 240.0], [0.0, 0.0, 1.0]]
TABLE = {
    "name": "cam_01", "size": [640.0, 480.0], "matrix": MATRIX, "distortions": [-0.2, 0.05, 0.01, -0.02],
    "rotation": [0.3, -0.2, 0.1], "translation": [0.1, 0.2, 4.0],
}  # fmt: skip


def toml(tables: list[dict]) -> str:
    lines = []
    for at, table in enumerate(tables):
        lines += [f"[cam_{at}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0"])


@pytest.mark.parametrize("kind", ["toml", "json list", "json by name"])
def test_a_point_is_seen_where_opencv_says(tmp_path: Path, kind: str):
    path = tmp_path / f"calib.{kind[:4].strip()}"
    path.write_text(toml([TABLE]) if kind == "toml" else json.dumps([TABLE] if "list" in kind else {"a": TABLE}))
    (camera,), note = read_cameras(path)
    assert camera.name == "cam_01" and "metres" in note
    assert camera.rotation is not None and camera.translation is not None
    point = np.array([0.4, -0.3, 0.5])
    there = Rotation.from_rotvec(TABLE["rotation"]).apply(point) + TABLE["translation"]
    # https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, "detailed description"
    x, y = there[:2] / there[2]
    (k1, k2, p1, p2), r2 = TABLE["distortions"], x * x + y * y
    bent_x = x * (1 + k1 * r2 + k2 * r2**2) + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * (1 + k1 * r2 + k2 * r2**2) + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixel = [1000 * bent_x + 320, 1010 * bent_y + 240]
    found = camera.lens.project((camera.rotation @ (1000 * point) + camera.translation)[None])
    np.testing.assert_allclose(found, [pixel], atol=1e-6)
    np.testing.assert_allclose(camera.lens.rays(np.array([pixel])), [[x, y]], atol=1e-6)


def test_what_is_written_reads_back(tmp_path: Path):
    lens = Lens((900.0, 905.0), (330.0, 250.0), (0.1, -0.05, 0.01), (0.01, -0.02), (640, 480), opencv=True)
    cameras = [
        SceneCamera(
            f"cam {at}", lens, Rotation.from_rotvec([0.1 * at, 3.0, 0.2]).as_matrix(), np.array([1.0, at, 3000.0])
        )
        for at in range(3)
    ]
    write_cameras(cameras, tmp_path / "found.toml", unit="mm")
    found, _ = read_cameras(tmp_path / "found.toml")
    for one, other in zip(cameras, found, strict=True):
        assert (one.name, one.lens) == (other.name, other.lens)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-9)
        np.testing.assert_allclose(one.translation, other.translation, atol=1e-6)


def test_units_are_told_apart(tmp_path: Path):
    far = [{**TABLE, "name": f"c{at}", "translation": [2500.0 * at, 0.0, 4000.0]} for at in range(2)]
    (tmp_path / "mm.toml").write_text(toml(far))
    found, note = read_cameras(tmp_path / "mm.toml")
    assert "taken as mm" in note and found[0].translation is not None and found[0].translation[2] == 4000
    found, note = read_cameras(tmp_path / "mm.toml", "m")
    assert not note and found[0].translation is not None and found[0].translation[2] == 4e6


def test_cameras_go_by_name():
    cameras = [SceneCamera(name, Lens.ideal(1.0, (2, 2))) for name in ("cam_01", "cam_10", "Left")]
    names = [one.name for one in match_cameras(cameras, ["walk_cam1", "CAM10", "left view"])]
    assert names == ["cam_01", "cam_10", "Left"]
    with pytest.raises(UserError, match="no camera fits the view 'cam100'"):
        match_cameras(cameras, ["cam100"])
    with pytest.raises(UserError, match="of one camera"):
        match_cameras(cameras, ["a_cam1", "b_cam1"])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a = [", "cannot be read as TOML"),
        ("[metadata]\nerror = 0.0", "holds 0 cameras"),
        (toml([{**TABLE, "fisheye": True}]), "fisheye"),
        (toml([{**TABLE, "matrix": [[1.0, 2.0], [3.0, 4.0]]}]), "expected 3 x 3 numbers"),
        (toml([{key: value for key, value in TABLE.items() if key != "size"}]), "'size' is None"),
        (toml([{**TABLE, "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]}]), "no rotation"),
        (toml([{key: value for key, value in TABLE.items() if key != "rotation"}]), "goes with 'translation'"),
        (toml([TABLE, TABLE]), "two cameras have the name cam_01"),
        (toml([{**TABLE, "distortions": [0.1] * 8}]), "8 numbers"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, text: str, expected: str):
    (tmp_path / "calib.toml").write_text(text)
    with pytest.raises(UserError, match=expected):
        read_cameras(tmp_path / "calib.toml")
