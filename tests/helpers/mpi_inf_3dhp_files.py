"""MPI-INF-3DHP's files, from simulated motion seen by its published cameras."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.io import savemat

from uplift.data.datasets.mpi_inf_3dhp import published_cameras
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton

SCALE = 1.07  # of the universal body
JOINTS = load_skeleton("mpi_inf_3dhp28").joints
TEST_JOINTS = load_skeleton("mpi_inf_3dhp17").joints

# camera.calibration of S1/Seq1: fx, fy, cx, cy of its 14 cameras, and the extrinsics of the first.
_LENSES = (
    (1497.693, 1497.103, 1024.704, 1051.394), (1495.217, 1495.52, 1030.519, 1052.626),
    (1495.587, 1497.828, 983.8873, 987.5902), (1495.886, 1496.033, 1029.06, 1041.409),
    (1490.952, 1491.108, 987.6075, 1019.069), (1500.414, 1499.971, 1012.331, 998.5009),
    (1498.471, 1498.8, 999.7319, 1010.251), (1498.831, 1499.674, 987.2716, 976.8773),
    (1500.172, 1500.837, 1017.387, 1043.032), (1501.554, 1501.9, 1010.423, 1037.096),
    (1498.423, 1498.585, 1041.614, 997.0433), (1495.779, 1493.703, 1009.802, 999.9984),
    (1501.326, 1501.491, 1000.56, 1014.975), (1496.961, 1497.378, 1005.702, 1004.214),
)  # fmt: skip
_TURN = np.array(
    [[0.9650164, 0.00488022, 0.262144], [-0.004488356, -0.9993728, 0.0351275], [0.262151, -0.03507521, -0.9643893]]
)
_PLACE = np.array([-562.8666, 1398.138, 3852.623])


@lru_cache
def world_motion(frames: int, seed: int) -> np.ndarray:
    """Return (frames, 28, 3) mm in the data set's world: y up, the floor at 0, people near the origin."""
    data = simulate(load_skeleton("mpi_inf_3dhp28"), frames, seed=seed, clip_seconds=frames / 10)
    points = data.pose + data.root[:, None]
    tilt = np.radians(data.tilt_deg)
    flat = np.zeros((frames, 3, 3))
    flat[:, 0, 0] = 1
    flat[:, 1, 1], flat[:, 1, 2] = -np.cos(tilt), -np.sin(tilt)
    flat[:, 2, 1], flat[:, 2, 2] = np.sin(tilt), -np.cos(tilt)
    world = np.einsum("fij,fkj->fki", flat, points)
    world -= [*world[..., :1].mean((0, 1)), world[..., 1].min(), *world[..., 2:].mean((0, 1))]
    return world


def extrinsics(camera: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and translation: the first camera as published, the others placed around the studio."""
    angle = 2 * np.pi * camera / 14
    around = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return _TURN @ around, _PLACE


def calibration_text() -> str:
    """Return a camera.calibration file of 14 cameras."""
    lines = ["Skeletool Camera Calibration File V1.0"]
    for camera, (fx, fy, cx, cy) in enumerate(_LENSES):
        turn, place = extrinsics(camera)
        outside = " ".join(f"{value:.9g}" for value in np.c_[turn, place].ravel())
        lines += [
            f"name          {camera}",
            "  sensor      10 10",
            "  size        2048 2048",
            "  animated    0",
            f"  intrinsic   {fx} 0 {cx} 0 0 {fy} {cy} 0 0 0 1 0 0 0 0 1 ",
            f"  extrinsic   {outside} 0 0 0 1 ",
            "  radial      0",
        ]
    return "\n".join(lines) + "\n"


def train_arrays(frames: int, seed: int, joints: int = 28) -> dict:
    """Return the variables of an annot.mat, cells as lists."""
    world = world_motion(frames, seed)[:, :joints]
    annot2, annot3, univ = [], [], []
    for camera, (fx, fy, cx, cy) in enumerate(_LENSES):
        turn, place = extrinsics(camera)
        points = world @ turn.T + place
        annot2.append((points[..., :2] / points[..., 2:] * (fx, fy) + (cx, cy)).reshape(frames, -1))
        annot3.append(points.reshape(frames, -1))
        # Its own place, not on the rays: the published universal annotations do not project to the 2D.
        univ.append((points * SCALE + [0, 50, -300]).reshape(frames, -1))
    counts = {"cameras": np.arange(14, dtype=np.uint8)[None], "frames": np.arange(frames, dtype=float)[:, None]}
    return {"annot2": annot2, "annot3": annot3, "univ_annot3": univ, **counts}


def write_train(folder: Path, subject: str, frames: int = 30, seed: int = 0, modern: bool = False, **changes) -> None:
    """Write both sequences of a subject; ``changes`` replace variables of annot.mat, None leaves one out."""
    for number in (1, 2):
        place = folder / subject / f"Seq{number}"
        place.mkdir(parents=True, exist_ok=True)
        (place / "camera.calibration").write_text(calibration_text())
        arrays = {**train_arrays(frames, seed + number), **changes}
        save(place / "annot.mat", {k: v for k, v in arrays.items() if v is not None}, modern)


def arrays_of_test(number: int, frames: int, seed: int, bent: bool = False) -> dict:
    """Return the variables of the annot_data.mat of TS1..TS6: every other frame valid, the activities in turn."""
    world = world_motion(frames, seed)[:, [JOINTS.index(joint) for joint in TEST_JOINTS]]
    turn, place = extrinsics(0)
    points = world @ turn.T + place
    lens = published_cameras(number)[0 if number <= 4 or bent else 1].lens
    valid = np.arange(frames) % 2 == 0
    activity = np.where(valid, 1 + np.arange(frames) // 2 % 7, 0)
    shaped = {
        "annot2": lens.project(points),
        "annot3": points,
        "univ_annot3": points * SCALE + [0, 50, -300],
    }
    return {
        **{name: np.ascontiguousarray(value.transpose(2, 1, 0)[:, :, None]) for name, value in shaped.items()},
        "valid_frame": valid[None].astype(float),
        "activity_annotation": activity[None].astype(float),
        "bb_crop": np.zeros((frames, 4)),
    }


def write_test(
    folder: Path, number: int, frames: int = 28, seed: int = 9, modern: bool = True, bent: bool = False, **changes
) -> Path:
    """Write TS1..TS6; ``changes`` replace variables, None leaves one out."""
    path = folder / f"TS{number}" / "annot_data.mat"
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {**arrays_of_test(number, frames, seed + number, bent), **changes}
    save(path, {k: v for k, v in arrays.items() if v is not None}, modern)
    return path


def save(path: Path, arrays: dict, modern: bool) -> None:
    """Write a MATLAB file: v7.3 (HDF5 behind a header, axes reversed, cells as references), or v7."""
    if not modern:
        savemat(path, {name: _cells(value) for name, value in arrays.items()}, do_compression=True)
        return
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in arrays.items():
            if not isinstance(value, list):
                file.create_dataset(name, data=np.asarray(value).T, compression="gzip")
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
                continue
            store = file.require_group("#refs#")
            places = []
            for number, cell in enumerate(value):
                places.append(store.create_dataset(f"{name}{number}", data=np.asarray(cell).T).ref)
            file.create_dataset(name, data=np.array([places], dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
            file[name].attrs["MATLAB_class"] = np.bytes_("cell")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created by a test".ljust(124, b" ") + b"\x00\x02IM")


def _cells(value):
    if not isinstance(value, list):
        return value
    cells = np.empty((len(value), 1), object)
    for number, cell in enumerate(value):
        cells[number, 0] = cell
    return cells
