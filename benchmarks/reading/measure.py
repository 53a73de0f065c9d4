"""What one fresh process finds: ``make CELL PATH ROWS``, ``read CELL PATH`` or ``other CELL PATH``; JSON on its last line."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reading.bodies import SIZE_PX
from benchmarks.reading.cells import CELLS
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData

__all__ = ["check", "make", "measured", "peak_gb", "read_file", "told_of"]

_NEAR_PX = 2e-3


def told_of(path: Path) -> Path:
    """Return the file that says what a made file has in it."""
    return path.with_name(f"{path.name}.told.json")


def make(cell: str, path: Path, rows: int) -> dict[str, Any]:
    """Write the file of a cell, and beside it what is in it."""
    found = next(one for one in CELLS if one.name == cell)
    walk = found.walk(rows)
    seconds = measured(lambda: found.make(path, walk))[1]
    size = sum(one.stat().st_size for one in (path.rglob("*") if path.is_dir() else [path]) if one.is_file())
    told = {"rows": walk.rows, "joints": walk.joints, "bytes": size, "spots": walk.spots, **_made(seconds)}
    told_of(path).write_text(json.dumps(told))
    return told


def _made(seconds: dict[str, float]) -> dict[str, float]:
    return {f"making_{name}": value for name, value in seconds.items()}


def read_file(cell: str, path: Path) -> dict[str, Any]:
    """Read the file as any user does, and look whether what was read is what was written."""
    told = json.loads(told_of(path).read_text())
    data, found = measured(lambda: read(path, ReadOptions(image_size=SIZE_PX)))
    of = next(one for one in CELLS if one.name == cell)
    check(data, told)
    title = data.notes[0] if data.notes else "npz"
    if f"format={of.format})" not in title and of.format != "npz":
        raise SystemExit(f"{path} was {title}, expected {of.format}")
    return found | {"rows": len(data), "joints": len(data.joint_names)}


def check(data: PoseData, told: dict[str, Any]) -> None:
    """Raise SystemExit unless all rows are there, and each body that was remembered once, in its frame."""
    if len(data) != told["rows"] or data.keypoints.shape[1] != told["joints"]:
        raise SystemExit(f"{data.confidence.shape} were read, expected {told['rows']} rows of {told['joints']}")
    for spot in told["spots"]:
        points, sure = np.array(spot["keypoints"]), np.array(spot["confidence"])
        seen = sure > 0
        first = int(np.argmax(seen))
        rows = np.flatnonzero(np.abs(data.keypoints[:, first] - points[first]).max(-1) < _NEAR_PX)
        near = [row for row in rows if np.abs(data.keypoints[row][seen] - points[seen]).max() < _NEAR_PX]
        good = [row for row in near if np.abs(data.confidence[row] - sure).max() < 1e-3]
        if len(good) != 1:
            raise SystemExit(f"the body of frame {spot['frame']} was read {len(good)} times, expected once")
        frame = data.identity.get("frame")
        if frame is not None and frame[good[0]] != spot["frame"]:
            raise SystemExit(f"the body of frame {spot['frame']} was read as one of frame {frame[good[0]]}")


def measured(work: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """Return what ``work`` returns, its seconds, and the most memory that the process ever had."""
    start, before = time.perf_counter(), time.process_time()
    result = work()
    spent = {"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - before}
    return result, {**spent, "peak_gb": peak_gb()}


def peak_gb() -> float:
    """Return this process' most memory; what its parent had before it does not count, as it does in getrusage on Linux."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e9
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9


def main() -> int:
    """Print what was measured as JSON."""
    what, cell, path, *rows = sys.argv[1:]
    if what == "make":
        found = make(cell, Path(path), int(rows[0]))
    elif what == "read":
        found = read_file(cell, Path(path))
    else:
        from benchmarks.reading.yardsticks import YARDSTICKS

        yardstick = YARDSTICKS[next(one.yardstick for one in CELLS if one.name == cell)]
        found = measured(lambda: yardstick(Path(path)))[1]
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
