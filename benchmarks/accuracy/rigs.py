"""The same motions seen by other cameras: a rig with mixed tilts, and one that looks down by 30 degrees."""

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

__all__ = ["RIGS", "Rig", "build_rigs", "cached_rigs", "film"]

TEST_SUBJECTS = ("S5", "S16", "S127", "S135")
"""Subjects of the test split of the motion capture data."""
FOCAL_PX, CENTRE_PX, IMAGE_PX = 1145.0, 500.0, (1000, 1000)

_CAMERAS = 3
_DISTANCE_MM = 5000.0
_NEAREST_MM = 2000.0
_MARGIN_PX = 200.0
"""How far outside the image a joint may lie."""
_STEP = 3
"""Every third frame of 30 Hz is used: 10 Hz."""
_FEWEST = 3
"""Clips with fewer frames are dropped."""
_SPLITS = ("train", "test")


@dataclass(frozen=True)
class Rig:
    """Cameras without roll, one per clip, with a downward tilt uniform between two bounds."""

    lowest_deg: float
    highest_deg: float
    seed: int


RIGS = {"mixed": Rig(0.0, 40.0, 1), "fixed30": Rig(30.0, 30.0, 2)}


def camera_axes(tilt: float, azimuth: float) -> Float[np.ndarray, "3 3"]:
    """Return the camera's right, down and forward as rows, in a world with y up; angles in radians."""
    forward = np.array(
        [np.sin(azimuth) * np.cos(tilt), -np.sin(tilt), np.cos(azimuth) * np.cos(tilt)], dtype=np.float64
    )
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def film(world: dict[str, np.ndarray], rig: Rig, split: str) -> dict[str, np.ndarray]:
    """Return the arrays of a data file: every sequence of the split's subjects seen by three cameras.

    ``world`` holds `joints` (frames joints 3) in metres with y up at 30 Hz, `joint_names`, `subject`,
    `action` and `sequence`. Each camera aims at the hip of a random frame from 5 m. Frames with a
    joint nearer than 2 m or more than 200 px outside the image are dropped. Poses are in mm, relative
    to the first joint, the root.
    """
    rng = np.random.default_rng([rig.seed, _SPLITS.index(split)])
    tested = np.isin(world["subject"], TEST_SUBJECTS)
    wanted = tested if split == "test" else ~tested
    clips = list(_clips(world, wanted, rig, rng))
    found = {key: np.concatenate([clip[key] for clip in clips]) for key in clips[0]}
    return {
        "keypoints": found.pop("keypoints").astype(np.float32),
        "joint_names": world["joint_names"],
        **found,
        "fps": np.asarray(world["fps"] / _STEP, np.float32),
        "image_size": np.array(IMAGE_PX),
        "focal_px": np.asarray(FOCAL_PX, np.float32),
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
            axes = camera_axes(np.radians(tilt_deg), rng.uniform(0, 2 * np.pi))
            place = points[rng.integers(len(points)), 0] - _DISTANCE_MM * axes[2]
            seen = (points - place) @ axes.T
            keypoints = seen[..., :2] / seen[..., 2:] * FOCAL_PX + CENTRE_PX
            kept = np.flatnonzero(_in_view(seen, keypoints))
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
                }


def _in_view(seen: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    near = seen[..., 2].min(1) < _NEAREST_MM
    out = (keypoints < -_MARGIN_PX) | (keypoints > np.array(IMAGE_PX) + _MARGIN_PX)
    return ~near & ~out.any((1, 2))


def build_rigs(folder: str | Path) -> list[Path]:
    """Write ``<rig>/train.npz`` and ``<rig>/test.npz`` into ``folder`` from ``cmu/world.npz`` of UPLIFT_DATA."""
    base = os.environ.get("UPLIFT_DATA")
    path = Path(base or "").expanduser() / "cmu" / "world.npz"
    if not base or not path.is_file():
        raise UserError(f"The rigs are made from cmu/world.npz in UPLIFT_DATA={base or ''}, which does not exist.")
    with np.load(path, allow_pickle=False) as file:
        world = {key: file[key] for key in ("joints", "joint_names", "subject", "action", "sequence", "fps")}
    written = []
    for name, rig in RIGS.items():
        (Path(folder) / name).mkdir(parents=True, exist_ok=True)
        for split in _SPLITS:
            written.append(Path(folder) / name / f"{split}.npz")
            with replacing(written[-1]) as handle:
                np.savez_compressed(handle, **film(world, rig, split))  # type: ignore[arg-type]
    return written


def cached_rigs() -> Path:
    """Return the folder of the rigs, built on first use: UPLIFT_BENCHMARK_CACHE or ``~/.cache/uplift/rigs``."""
    folder = Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift/rigs").expanduser()
    if not all((folder / name / f"{split}.npz").is_file() for name in RIGS for split in _SPLITS):
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
