"""Human3.6M's files in each published format, from simulated motion seen by its real cameras."""

from __future__ import annotations

import pickle
from functools import lru_cache
from pathlib import Path

import numpy as np

from uplift.data.datasets.h36m_files import _LENSES, _STANDS, ACTIONS, CAMERAS, OF_32
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton

SUBJECTS = ("S1", "S5", "S6", "S7", "S8", "S9", "S11")
HOURGLASS = (3, 2, 1, 4, 5, 6, 0, 7, 8, 10, 16, 15, 14, 11, 12, 13)  # of the 17, in the network's order

World = dict[str, dict[str, np.ndarray]]


@lru_cache
def world(frames: int = 11, seed: int = 0) -> World:
    """Return (frames, 32, 3) mm in the world by subject and sequence: two sequences per action, of increasing length."""
    names = [name for action in ACTIONS for name in (action, f"{action} 1")]
    poses = standing(
        simulate(load_skeleton("h36m17"), 7 * 30 * (frames + 6), seed, fps=50.0, clip_seconds=(frames + 6) / 50)
    )
    poses = poses.reshape(7, 30, frames + 6, 32, 3)
    return {
        subject: {name: poses[s, n, : frames + n % 7] for n, name in enumerate(names)}
        for s, subject in enumerate(SUBJECTS)
    }  # fmt: skip


def standing(data) -> np.ndarray:
    """Return simulated poses as (frames, 32, 3) mm in a world with z up, feet on the floor."""
    pose, tilt = data.pose.astype(float), np.radians(data.tilt_deg.astype(float))[:, None]
    down = np.cos(tilt) * pose[..., 1] + np.sin(tilt) * pose[..., 2]
    away = np.cos(tilt) * pose[..., 2] - np.sin(tilt) * pose[..., 1]
    room = np.stack([pose[..., 0], away, down.max(1, keepdims=True) - down], -1)
    all_joints = np.repeat(room[:, :1], 32, 1)
    all_joints[:, OF_32] = room
    return all_joints


def rotation(subject: str, camera: str) -> np.ndarray:
    """Return R of X_camera = R (X - T), from the published quaternion, by SciPy."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = _STANDS[subject][CAMERAS.index(camera)][:4]
    return Rotation.from_quat([x, y, z, w]).as_matrix().T


def place(subject: str, camera: str) -> np.ndarray:
    return np.array(_STANDS[subject][CAMERAS.index(camera)][4:])


def in_camera(points: np.ndarray, subject: str, camera: str) -> np.ndarray:
    return (points - place(subject, camera)) @ rotation(subject, camera).T


def project(points: np.ndarray, subject: str, camera: str, swapped: bool = False) -> np.ndarray:
    """Return pixels as projected by the data set's code; ``swapped``: by VideoPose3D's."""
    focal, centre, (k1, k2, k3), (p1, p2), _ = _LENSES[camera]
    seen = in_camera(points, subject, camera)
    x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    if swapped:
        p1, p2 = p2, p1
    r2 = x**2 + y**2
    bend = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + p1 * y + p2 * x
    return np.stack([focal[0] * (x * bend + p2 * r2) + centre[0], focal[1] * (y * bend + p1 * r2) + centre[1]], -1)


def detections(points: np.ndarray, subject: str, camera: str, more: int = 0) -> np.ndarray:
    """Return simulated detections of the 17 joints: with noise of some pixels, and a few more frames."""
    seen = project(points[:, OF_32], subject, camera)
    seen = np.concatenate([seen, np.repeat(seen[-1:], more, 0)])
    return (seen + np.random.default_rng(len(seen)).normal(0, 3, seen.shape)).astype(np.float32)


METADATA = {
    "h36m": {"layout_name": "h36m", "num_joints": 17, "keypoints_symmetry": [[4, 5, 6, 11, 12, 13], [1, 2, 3, 14, 15, 16]]},
    "hourglass": {"num_joints": 16, "keypoints_symmetry": [[3, 4, 5, 13, 14, 15], [0, 1, 2, 10, 11, 12]]},
}  # fmt: skip
VIDEOPOSE3D = {
    "gt": "data_2d_h36m_gt.npz",
    "cpn": "data_2d_h36m_cpn_ft_h36m_dbb.npz",
    "detectron": "data_2d_h36m_detectron_ft_h36m.npz",
    "sh": "data_2d_h36m_sh_ft_h36m.npz",
}


def write_videopose3d(folder: Path, kinds=("gt", "cpn", "sh"), poses: World | None = None) -> None:
    """Write data_3d_h36m.npz and the 2D of each kind, without S11's Directions, like VideoPose3D's scripts."""
    folder.mkdir(parents=True, exist_ok=True)
    poses = world() if poses is None else poses
    kept = {s: {n: p for n, p in of.items() if (s, n) != ("S11", "Directions")} for s, of in poses.items()}
    metres = {s: {n: (p / 1000).astype(np.float32) for n, p in of.items()} for s, of in kept.items()}
    np.savez_compressed(folder / "data_3d_h36m.npz", positions_3d=boxed(metres))
    for kind in kinds:
        seen = {s: {n: _views(kind, p, s) for n, p in of.items()} for s, of in kept.items()}
        metadata = METADATA["hourglass" if kind == "sh" else "h36m"]
        np.savez_compressed(folder / VIDEOPOSE3D[kind], positions_2d=boxed(seen), metadata=boxed(metadata))


def boxed(value: object) -> np.ndarray:
    box = np.empty((), object)
    box[()] = value
    return box


def _views(kind: str, points: np.ndarray, subject: str) -> list[np.ndarray]:
    if kind == "gt":
        return [project(points[:, OF_32], subject, camera, swapped=True).astype(np.float32) for camera in CAMERAS]
    seen = [detections(points, subject, camera, more=number) for number, camera in enumerate(CAMERAS)]
    return [view[:, HOURGLASS] for view in seen] if kind == "sh" else seen


def write_pickles(folder: Path, poses: World | None = None, protocol: int = 2) -> None:
    """Write points_3d.pkl, cameras.pkl and sh_detect_2d.pkl; two actions of S1 have other names in the 3D file."""
    folder.mkdir(parents=True, exist_ok=True)
    poses = world() if poses is None else poses
    points = {s: {old_name(s, n): p.reshape(len(p), 96) for n, p in of.items()} for s, of in poses.items()}
    cameras = {s: {c: _parameters(s, c) for c in CAMERAS} for s in poses}
    seen = {
        s: {
            n: {c: _with_made_up_nose(detections(p, s, c)).reshape(len(p), 34) for c in CAMERAS if (s, n, c) != GONE}
            for n, p in of.items()
        }
        for s, of in poses.items()
    }
    for name, value in (("points_3d", points), ("cameras", cameras), ("sh_detect_2d", seen)):
        (folder / f"{name}.pkl").write_bytes(pickle.dumps(value, protocol))


GONE = ("S11", "Directions", "54138969")


def old_name(subject: str, name: str) -> str:
    return name.replace("Photo", "TakingPhoto").replace("WalkDog", "WalkingDog") if subject == "S1" else name


def _with_made_up_nose(seen: np.ndarray) -> np.ndarray:
    seen[:, 9] = (seen[:, 8] + seen[:, 10]) / 2
    return seen


def _parameters(subject: str, camera: str) -> dict[str, np.ndarray]:
    focal, centre, radial, tangential, _ = _LENSES[camera]
    column = {"T": place(subject, camera), "f": focal, "c": centre, "k": radial, "p": tangential}
    return {"R": rotation(subject, camera), **{key: np.array(value)[:, None] for key, value in column.items()}}


def write_martinez(folder: Path, poses: World | None = None, cameras: bool = True, hourglass: bool = True) -> None:
    """Write S*/MyPoses/3D_positions/*.h5, the detections of both networks, and cameras.h5."""
    import h5py

    for subject, of in (world() if poses is None else poses).items():
        for place_name in (
            "MyPoses/3D_positions",
            *(("StackedHourglass", "StackedHourglassFineTuned240") if hourglass else ()),
        ):
            (folder / subject / place_name).mkdir(parents=True, exist_ok=True)
        for name, points in of.items():
            with h5py.File(folder / subject / "MyPoses/3D_positions" / f"{name}.h5", "w") as file:
                file["3D_positions"] = points.reshape(len(points), 96).T
            for camera in CAMERAS if hourglass else ():
                if (subject, name, camera) == GONE:
                    continue
                for network in ("StackedHourglass", "StackedHourglassFineTuned240"):
                    at = folder / subject / network / f"{name.replace(' ', '_')}.{camera}.h5"
                    with h5py.File(at, "w") as file:
                        file["poses"] = detections(points, subject, camera)[:, HOURGLASS]
    if cameras:
        _write_cameras(folder / "cameras.h5")


def _write_cameras(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for subject in SUBJECTS:
            for number, camera in enumerate(CAMERAS, 1):
                told = _parameters(subject, camera)
                told["R"] = told["R"].T
                told["Name"] = np.array([[ord(letter)] for letter in camera], np.uint16)
                for key, value in told.items():
                    file[f"subject{subject[1:]}/camera{number}/{key}"] = value


def write_cdf(
    folder: Path, poses: World | None = None, kinds=("D2_Positions", "D3_Positions", "D3_Positions_mono")
) -> None:
    """Write S*/MyPoseFeatures/*/*.cdf: one record of (frames, joints times 2 or 3) each."""
    for subject, of in (world() if poses is None else poses).items():
        for kind in kinds:
            (folder / subject / "MyPoseFeatures" / kind).mkdir(parents=True, exist_ok=True)
        for name, points in of.items():
            named = old_name(subject, name)
            if "D3_Positions" in kinds:
                write_one_cdf(folder / subject / "MyPoseFeatures/D3_Positions" / f"{named}.cdf", points)
            for camera in CAMERAS:
                end = f"{named}.{camera}.cdf"
                if "D2_Positions" in kinds:
                    write_one_cdf(
                        folder / subject / "MyPoseFeatures/D2_Positions" / end, project(points, subject, camera)
                    )
                if "D3_Positions_mono" in kinds:
                    seen = in_camera(points, subject, camera)
                    write_one_cdf(folder / subject / "MyPoseFeatures/D3_Positions_mono" / end, seen)


def write_one_cdf(path: Path, points: np.ndarray, majority: str = "column_major") -> None:
    from cdflib.cdfwrite import CDF

    values = points.reshape(1, len(points), -1).astype(np.float32)
    stored = values if majority == "row_major" else values.transpose(0, 2, 1).reshape(values.shape)  # as MATLAB's are
    path.unlink(missing_ok=True)
    file = CDF(path, {"Majority": majority})
    file.write_var(
        {"Variable": "Pose", "Data_Type": 44, "Num_Elements": 1, "Rec_Vary": True, "Dim_Sizes": list(values.shape[1:]),
         "Var_Type": "zVariable", "Compress": 6},
        var_data=stored,
    )  # fmt: skip
    file.close()
