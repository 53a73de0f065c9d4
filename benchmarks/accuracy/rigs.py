"""The same motions seen by other cameras, and the same cameras without some of the subjects.

``mixed`` has mixed tilts, ``fixed30`` looks down by 30 degrees, ``wide`` is what strangers' videos are like: any tilt,
roll, distance and focal length, the last unknown. ``unseen`` are the files of the home rig, three subjects of the
training set held out as its test.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import replacing
from uplift.errors import UserError
from uplift.geometry.gravity import gravity_at

__all__ = ["MADE", "RIGS", "Rig", "build_rigs", "cached_folder", "cached_rigs", "film"]

TEST_SUBJECTS = ("S5", "S16", "S127", "S135")
"""Subjects of the test split of the motion capture data."""
UNSEEN_SUBJECTS = ("S2", "S9", "S17")
"""Subjects of the training split that are held out where strangers are tested."""
_CAMERAS = 3
_MARGIN_PX = 200.0
"""How far outside the image a joint may lie."""
_STEP = 3
"""Every third frame of 30 Hz is used: 10 Hz."""
_FEWEST = 3
"""Clips with fewer frames are dropped."""
_SPLITS = ("train", "test", "unseen")


@dataclass(frozen=True)
class Rig:
    """Cameras, one per clip; tilt, roll, distance and focal length uniform between two bounds."""

    lowest_deg: float
    highest_deg: float
    seed: int
    roll_deg: float = 0.0
    """Largest roll, either way."""
    distance_mm: tuple[float, float] = (5000.0, 5000.0)
    """From the hip of a random frame, which the camera aims at."""
    nearest_mm: float = 2000.0
    """Frames with a joint nearer than that are dropped."""
    focal_px: tuple[float, float] = (1145.0, 1145.0)
    """Not written to the file where it varies: unknown."""
    image_px: tuple[int, int] = (1000, 1000)
    splits: tuple[str, ...] = ("train", "test")


RIGS = {
    "mixed": Rig(0.0, 40.0, 1),
    "fixed30": Rig(30.0, 30.0, 2),
    "wide": Rig(
        -20.0, 50.0, 3, roll_deg=25.0, distance_mm=(2200.0, 8000.0), nearest_mm=1000.0, focal_px=(800.0, 2400.0),
        image_px=(1920, 1080), splits=("test", "unseen"),
    ),
}  # fmt: skip
_UNSEEN = "unseen"
MADE = (*RIGS, _UNSEEN)
"""The folders of `cached_rigs`."""


def camera_axes(tilt: float, azimuth: float, roll: float = 0.0) -> Float[np.ndarray, "3 3"]:
    """Return the camera's right, down and forward as rows, in a world with y up; angles in radians.

    With a positive ``roll`` "up" leans to the right in the image.
    """
    forward = np.array(
        [np.sin(azimuth) * np.cos(tilt), -np.sin(tilt), np.cos(azimuth) * np.cos(tilt)], dtype=np.float64
    )
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll), np.sin(roll)
    return np.stack([cos * right - sin * down, sin * right + cos * down, forward])


def _drawn(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two bounds; equal ones draw nothing, so that older rigs keep their cameras."""
    return low if low == high else float(rng.uniform(low, high))


def film(world: dict[str, np.ndarray], rig: Rig, split: str) -> dict[str, np.ndarray]:
    """Return the arrays of a data file: every sequence of the split's subjects seen by three cameras.

    ``world`` holds `joints` (frames joints 3) in metres with y up at 30 Hz, `joint_names`, `subject`,
    `action` and `sequence`. Each camera aims at the hip of a random frame. Frames with a joint too near or
    more than 200 px outside the image are dropped. Poses are in mm, relative to the first joint, the root. Of the
    subjects that are not tested, ``unseen`` are `UNSEEN_SUBJECTS`, ``train`` all.
    """
    rng = np.random.default_rng([rig.seed, _SPLITS.index(split)])
    tested = np.isin(world["subject"], TEST_SUBJECTS)
    wanted = {"test": tested, "train": ~tested, "unseen": np.isin(world["subject"], UNSEEN_SUBJECTS)}[split]
    clips = list(_clips(world, wanted, rig, rng))
    found = {key: np.concatenate([clip[key] for clip in clips]) for key in clips[0]}
    known = {"focal_px": np.asarray(rig.focal_px[0], np.float32)} if rig.focal_px[0] == rig.focal_px[1] else {}
    return {
        "keypoints": found.pop("keypoints").astype(np.float32),
        "joint_names": world["joint_names"],
        **found,
        "fps": np.asarray(world["fps"] / _STEP, np.float32),
        "image_size": np.array(rig.image_px),
        **known,
    }


def _clips(
    world: dict[str, np.ndarray], wanted: np.ndarray, rig: Rig, rng: np.random.Generator
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the arrays of each clip: one sequence seen by one camera."""
    names, first = np.unique(world["sequence"][wanted], return_index=True)
    for name in names[np.argsort(first)]:
        rows = np.flatnonzero(wanted & (world["sequence"] == name))[::_STEP]
        points = world["joints"][rows].astype(np.float64) * 1000
        for camera in range(_CAMERAS):
            tilt_deg = rng.uniform(rig.lowest_deg, rig.highest_deg)
            azimuth, roll_deg = rng.uniform(0, 2 * np.pi), _drawn(rng, -rig.roll_deg, rig.roll_deg)
            axes = camera_axes(np.radians(tilt_deg), azimuth, np.radians(roll_deg))
            place = points[rng.integers(len(points)), 0] - _drawn(rng, *rig.distance_mm) * axes[2]
            seen = (points - place) @ axes.T
            keypoints = seen[..., :2] / seen[..., 2:] * _drawn(rng, *rig.focal_px) + np.array(rig.image_px) / 2
            kept = np.flatnonzero(_in_view(seen, keypoints, rig))
            gravity = gravity_at(np.full(len(kept), tilt_deg), roll_deg).astype(np.float32)
            if len(kept) >= _FEWEST:
                identity = {key: world[key][rows[kept]] for key in ("subject", "action", "sequence")}
                yield {
                    "keypoints": keypoints[kept],
                    **identity,
                    "camera": np.full(len(kept), camera, np.int8),
                    "frame": (kept * _STEP).astype(np.int32),
                    "pose": (seen[kept] - seen[kept, :1]).astype(np.float32),
                    "root": seen[kept, 0].astype(np.float32),
                    "tilt_deg": np.full(len(kept), tilt_deg, np.float32),
                    **({"gravity": gravity} if rig.roll_deg else {}),
                }


def _in_view(seen: np.ndarray, keypoints: np.ndarray, rig: Rig) -> np.ndarray:
    near = seen[..., 2].min(1) < rig.nearest_mm
    out = (keypoints < -_MARGIN_PX) | (keypoints > np.array(rig.image_px) + _MARGIN_PX)
    return ~near & ~out.any((1, 2))


def build_rigs(folder: str | Path) -> list[Path]:
    """Write the files of `_files` into ``folder``, from ``cmu/world.npz`` and ``cmu/train.npz`` of UPLIFT_DATA.

    Those that are there already are left as they are.
    """
    with np.load(_source("world"), allow_pickle=False) as file:
        world = {key: file[key] for key in ("joints", "joint_names", "subject", "action", "sequence", "fps")}
    for path in (files := _files(Path(folder))):
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            name = path.parent.name
            arrays = _held_out(path.stem) if name == _UNSEEN else film(world, RIGS[name], path.stem)
            with replacing(path) as handle:
                np.savez_compressed(handle, **arrays)  # type: ignore[arg-type]
    return files


def _files(folder: Path) -> list[Path]:
    """Return the files of all rigs, and ``unseen/train.npz`` and ``unseen/test.npz``."""
    splits = {name: rig.splits for name, rig in RIGS.items()} | {_UNSEEN: ("train", "test")}
    return [folder / name / f"{split}.npz" for name, of in splits.items() for split in of]


def _source(name: str) -> Path:
    base = os.environ.get("UPLIFT_DATA")
    path = Path(base or "").expanduser() / "cmu" / f"{name}.npz"
    if not base or not path.is_file():
        raise UserError(f"The rigs are made from cmu/{name}.npz in UPLIFT_DATA={base or ''}, which does not exist.")
    return path


def _held_out(split: str) -> dict[str, np.ndarray]:
    """Return the arrays of ``cmu/train.npz`` without `UNSEEN_SUBJECTS` (train), or of these alone (test)."""
    with np.load(_source("train"), allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    frames = len(arrays["keypoints"])
    rows = np.isin(arrays["subject"], UNSEEN_SUBJECTS) == (split == "test")
    return {key: values[rows] if values.shape[:1] == (frames,) else values for key, values in arrays.items()}


def cached_folder() -> Path:
    """Return the folder of what the benchmark makes and keeps: UPLIFT_BENCHMARK_CACHE or ``~/.cache/uplift/rigs``."""
    return Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift/rigs").expanduser()


def cached_rigs() -> Path:
    """Return `cached_folder` with the rigs in it, built on first use."""
    folder = cached_folder()
    if not all(path.is_file() for path in _files(folder)):
        build_rigs(folder)
    return folder


def main() -> int:
    """Build the rigs in the folder given on the command line, or in the cache."""
    try:
        for path in build_rigs(sys.argv[1]) if len(sys.argv) > 1 else [cached_rigs()]:
            print(f"wrote {path}")
    except UserError as error:
        print(f"rigs: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
