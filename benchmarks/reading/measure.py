"""What one fresh process measures; prints JSON.

``make CELL PATH ROWS`` writes a file, ``read CELL PATH`` reads it, ``other CELL PATH`` reads it with another program,
``write ENDING FOLDER FRAMES`` writes a prediction.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.reading.bodies import SIZE_PX
from benchmarks.reading.cells import CELLS, Cell
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData

if TYPE_CHECKING:  # reading is measured without what writing imports
    from uplift.models.prediction import Prediction

__all__ = ["YARDSTICKS", "check", "expected_file", "make", "read_file", "write_prediction"]

_NEAR_PX = 2e-3
_CLIP, _FPS = 1000, 25.0


def expected_file(path: Path) -> Path:
    """Return the file that describes the content of a generated file."""
    return path.with_name(f"{path.name}.expected.json")


def make(cell: str, path: Path, rows: int) -> dict[str, Any]:
    """Write the file of a cell, and beside it a description of its content."""
    found = _cell(cell)
    walk = found.walk(rows)
    seconds = _measured(lambda: found.make(path, walk))[1]
    size = sum(one.stat().st_size for one in (path.rglob("*") if path.is_dir() else [path]) if one.is_file())
    expected = {"rows": walk.rows, "joints": walk.joints, "bytes": size, "spots": walk.spots}
    expected |= {f"making_{name}": value for name, value in seconds.items()}
    expected_file(path).write_text(json.dumps(expected))
    return expected


def _cell(name: str) -> Cell:
    return next(cell for cell in CELLS if cell.name == name)


def read_file(cell: str, path: Path) -> dict[str, Any]:
    """Read the file as a user would, and check the format and the content."""
    data, found = _measured(lambda: read(path, ReadOptions(image_size=SIZE_PX)))
    check(data, json.loads(expected_file(path).read_text()))
    title, name = data.notes[0] if data.notes else "npz", _cell(cell).format
    if f"format={name})" not in title and name != "npz":
        raise SystemExit(f"{path} was {title}, expected {name}")
    return found | {"rows": len(data), "joints": len(data.joint_names)}


def check(data: PoseData, expected: dict[str, Any]) -> None:
    """Raise SystemExit unless all rows are there, and each remembered body exactly once, in its frame."""
    if len(data) != expected["rows"] or data.keypoints.shape[1] != expected["joints"]:
        raise SystemExit(
            f"read {data.confidence.shape}, expected {expected['rows']} rows of {expected['joints']} joints"
        )
    for spot in expected["spots"]:
        points, confidence = np.array(spot["keypoints"]), np.array(spot["confidence"])
        seen = confidence > 0
        first = int(np.argmax(seen))
        rows = np.flatnonzero(np.abs(data.keypoints[:, first] - points[first]).max(-1) < _NEAR_PX)
        near = [row for row in rows if np.abs(data.keypoints[row][seen] - points[seen]).max() < _NEAR_PX]
        good = [row for row in near if np.abs(data.confidence[row] - confidence).max() < 1e-3]
        if len(good) != 1:
            raise SystemExit(f"the body of frame {spot['frame']} was read {len(good)} times, expected once")
        frame = data.identity.get("frame")
        if frame is not None and frame[good[0]] != spot["frame"]:
            raise SystemExit(f"the body of frame {spot['frame']} was read as one of frame {frame[good[0]]}")


def _measured(work: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """Return the result of ``work``, its seconds, and the peak memory of this process."""
    start, before = time.perf_counter(), time.process_time()
    result = work()
    spent = {"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - before}
    return result, {**spent, "peak_gb": _peak_gb()}


def _peak_gb() -> float:
    """Return this process's peak memory; unlike getrusage on Linux, without that inherited from its parent."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e9
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9


# Other programs reading the same file; their result is not yet keypoints


def _json(path: Path) -> object:
    return [json.loads(file.read_bytes()) for file in (path.iterdir() if path.is_dir() else [path])]


def _pandas(path: Path) -> object:
    import pandas as pd

    return pd.read_csv(
        path, header=[0, 1, 2] if "DLC_one" in path.name else [0, 1, 2, 3] if "DLC_two" in path.name else 0
    )


def _pandas_h5(path: Path) -> object:
    import pandas as pd

    return pd.read_hdf(path)


def _sleap_io(path: Path) -> object:
    from sleap_io.io.main import load_slp

    return load_slp(str(path), open_videos=False).numpy()


YARDSTICKS: dict[str, Callable[[Path], object]] = {
    "json": _json,
    "pandas": _pandas,
    "pandas h5": _pandas_h5,
    "sleap-io": _sleap_io,
}
"""Name -> function that reads a file."""


# Writers


def write_prediction(ending: str, folder: Path, frames: int) -> dict[str, Any]:
    """Write a prediction and measure that."""
    from uplift.export import write

    prediction = _prediction(frames)
    files, found = _measured(lambda: write(prediction, folder / f"walk{ending}"))
    return found | {"frames": frames, "bytes": sum(file.stat().st_size for file in files)}


def _prediction(frames: int) -> Prediction:
    """Return a prediction of one simulated body that moves back and forth."""
    from uplift.data.synthetic.simulate import simulate
    from uplift.models.prediction import Prediction
    from uplift.skeleton import load_skeleton

    skeleton = load_skeleton("h36m17")
    length = min(frames, _CLIP)
    clip = simulate(skeleton, length, fps=_FPS, clip_seconds=length / _FPS, subjects=1)
    assert clip.pose is not None
    position = np.arange(frames) % max(2 * length - 2, 1)
    rows = np.minimum(position, 2 * length - 2 - position) if length > 1 else position
    rng = np.random.default_rng(0)
    pose = clip.pose[rows] + rng.normal(0, 1, (frames, *clip.pose.shape[1:]))  # mm; no two frames are equal
    return Prediction(
        pose=pose - pose[:, skeleton.root_index, None],
        level_pose=pose,
        unit=clip.unit,
        keypoints=clip.keypoints[rows],
        confidence=clip.confidence[rows],
        joint_names=clip.joint_names,
        skeleton=skeleton,
        tilt_deg=None,
        identity={"frame": np.arange(frames), "sequence": np.full(frames, "walk")},
        fps=_FPS,
        image_size=clip.image_size,
        root=None if clip.root is None else clip.root[rows],
        uncertainty=np.full(pose.shape[:2], 20.0),
        source="walk",
    )


def main() -> int:
    """Print what was measured as JSON."""
    what, name, path, *count = sys.argv[1:]
    if what == "make":
        found = make(name, Path(path), int(count[0]))
    elif what == "read":
        found = read_file(name, Path(path))
    elif what == "write":
        found = write_prediction(name, Path(path), int(count[0]))
    else:
        found = _measured(lambda: YARDSTICKS[_cell(name).yardstick](Path(path)))[1]
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
