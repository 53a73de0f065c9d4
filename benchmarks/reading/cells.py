"""What is measured: a file of every format, some formats in several forms."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from benchmarks.reading.bodies import Walk

__all__ = ["CELLS", "FOLDER_FILES", "Cell"]

FOLDER_FILES = 20_000
"""Files of a folder that has one a frame, at most; seconds a million rows are scaled from them."""


@dataclass(frozen=True)
class Cell:
    """A file to write and read."""

    name: str
    format: str
    """Of `uplift.data.formats.KEYPOINT_FORMATS`."""
    file: str
    write: str
    """module:function under benchmarks.reading, which takes a path and a `Walk`."""
    bodies: int = 1
    joints: int = 17
    most: int | None = None
    """Rows at most."""
    yardstick: str = ""
    """How another program reads the same file: a name of `benchmarks.reading.yardsticks`."""

    def walk(self, rows: int) -> Walk:
        """Return the bodies of a file of so many rows, or as many as it can have."""
        rows = min(rows, self.most or rows)
        return Walk(max(rows // self.bodies, 1) * self.bodies, self.joints, self.bodies)

    def make(self, path: Path, walk: Walk) -> None:
        """Write the file."""
        module, _, name = self.write.partition(":")
        getattr(import_module(f"benchmarks.reading.{module}"), name)(path, walk)


CELLS = (
    Cell("coco", "coco", "coco.json", "json_files:coco", 2, yardstick="json"),
    Cell("openpose", "openpose", "openpose", "folders:openpose", 2, 25, 2 * FOLDER_FILES, "json"),
    Cell("mmpose", "mmpose", "mmpose.json", "json_files:mmpose", yardstick="json"),
    Cell("mmpose, 2 tracks", "mmpose", "mmpose_tracked.json", "json_files:mmpose_tracked", 2, yardstick="json"),
    Cell("mmpose, 2 unnamed", "mmpose", "mmpose_unnamed.json", "json_files:mmpose", 2, yardstick="json"),
    Cell("kinetics_skeleton", "kinetics_skeleton", "kinetics.json", "json_files:kinetics", 2, 18, yardstick="json"),
    Cell("alphapose", "alphapose", "alphapose.json", "json_files:alphapose", yardstick="json"),
    Cell("alphapose, 2 tracks", "alphapose", "alphapose_two.json", "json_files:alphapose", 2, yardstick="json"),
    Cell("coco_results", "coco_results", "results.json", "json_files:coco_results", yardstick="json"),
    Cell("mpii_json", "mpii_json", "mpii.json", "json_files:mpii", joints=16, yardstick="json"),
    Cell("alphatracker", "alphatracker", "alphatracker.json", "json_files:alphatracker", 2, yardstick="json"),
    Cell("ultralytics_json", "ultralytics_json", "ultralytics.json", "json_files:ultralytics_json", yardstick="json"),
    Cell("ultralytics", "ultralytics", "ultralytics", "folders:ultralytics", most=FOLDER_FILES),
    Cell("deeplabcut csv", "deeplabcut", "walkDLC_one.csv", "table_files:deeplabcut_csv", yardstick="pandas"),
    Cell("deeplabcut csv, 2", "deeplabcut", "walkDLC_two.csv", "table_files:deeplabcut_csv", 2, yardstick="pandas"),
    Cell("deeplabcut h5", "deeplabcut", "walkDLC.h5", "table_files:deeplabcut_h5", yardstick="pandas h5"),
    Cell("mediapipe csv", "mediapipe", "mediapipe.csv", "table_files:mediapipe_csv", joints=33, yardstick="pandas"),
    Cell("mediapipe json", "mediapipe", "mediapipe.json", "json_files:mediapipe_json", 1, 33, 200_000, "json"),
    Cell("mediapipe npz", "mediapipe", "mediapipe.npz", "array_files:mediapipe_npz", joints=33),
    Cell("videopose3d", "videopose3d", "data_2d_custom_walk.npz", "array_files:videopose3d"),
    Cell("csv", "csv", "wide.csv", "table_files:csv_wide", yardstick="pandas"),
    Cell("csv, 2 named", "csv", "named.csv", "table_files:csv_named", 2, yardstick="pandas"),
    Cell("csv, 2 unnamed", "csv", "unnamed.csv", "table_files:csv_unnamed", 2, yardstick="pandas"),
    Cell("csv, a row a joint", "csv", "long.csv", "table_files:csv_long", yardstick="pandas"),
    Cell("sleap_slp", "sleap_slp", "walk.slp", "array_files:sleap_slp", 2, yardstick="sleap-io"),
    Cell("sleap_slp, 2 unnamed", "sleap_slp", "unnamed.slp", "array_files:sleap_slp_unnamed", 2, yardstick="sleap-io"),
    Cell("sleap_h5", "sleap_h5", "walk.analysis.h5", "array_files:sleap_h5", 2),
    Cell("nwb", "nwb", "walk.nwb", "array_files:nwb", 2),
    Cell("jabs", "jabs", "walk_pose_est_v5.h5", "array_files:jabs", 2, 12),
    Cell("npz", "npz", "walk.npz", "array_files:npz"),
)
