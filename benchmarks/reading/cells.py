"""The files to measure: at least one of every format."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from benchmarks.reading.bodies import Walk

__all__ = ["CELLS", "FOLDER_FILES", "Cell"]

FOLDER_FILES = 20_000
"""At most, in a folder with a file per frame; seconds per million rows are extrapolated from them."""


@dataclass(frozen=True)
class Cell:
    """A file to write and read."""

    name: str
    format: str
    """Of `uplift.data.formats.KEYPOINT_FORMATS`."""
    file: str
    write: str
    """module:function in benchmarks.reading, which takes a path and a `Walk`."""
    bodies: int = 1
    joints: int = 17
    most: int | None = None
    """Maximum number of rows."""
    yardstick: str = ""
    """Another program that reads the same file: a key of `YARDSTICKS` in `benchmarks.reading.measure`."""

    def walk(self, rows: int) -> Walk:
        """Return the content of a file of ``rows`` rows, or of its maximum."""
        rows = min(rows, self.most or rows)
        return Walk(max(rows // self.bodies, 1) * self.bodies, self.joints, self.bodies)

    def make(self, path: Path, walk: Walk) -> None:
        """Write the file."""
        module, _, name = self.write.partition(":")
        getattr(import_module(f"benchmarks.reading.{module}"), name)(path, walk)


CELLS = (
    Cell("coco", "coco", "coco.json", "text_files:coco", 2, yardstick="json"),
    Cell("openpose", "openpose", "openpose", "text_files:openpose", 2, 25, 2 * FOLDER_FILES, "json"),
    Cell("mmpose", "mmpose", "mmpose.json", "text_files:mmpose", yardstick="json"),
    Cell("mmpose, 2 tracks", "mmpose", "mmpose_tracked.json", "text_files:mmpose_tracked", 2, yardstick="json"),
    Cell("mmpose, 2 unnamed", "mmpose", "mmpose_unnamed.json", "text_files:mmpose", 2, yardstick="json"),
    Cell("kinetics_skeleton", "kinetics_skeleton", "kinetics.json", "text_files:kinetics", 2, 18, yardstick="json"),
    Cell("alphapose", "alphapose", "alphapose.json", "text_files:alphapose", yardstick="json"),
    Cell("alphapose, 2 tracks", "alphapose", "alphapose_two.json", "text_files:alphapose", 2, yardstick="json"),
    Cell("coco_results", "coco_results", "results.json", "text_files:coco_results", yardstick="json"),
    Cell("mpii_json", "mpii_json", "mpii.json", "text_files:mpii", joints=16, yardstick="json"),
    Cell("alphatracker", "alphatracker", "alphatracker.json", "text_files:alphatracker", 2, yardstick="json"),
    Cell("ultralytics_json", "ultralytics_json", "ultralytics.json", "text_files:ultralytics_json", yardstick="json"),
    Cell("ultralytics", "ultralytics", "ultralytics", "text_files:ultralytics", most=FOLDER_FILES),
    Cell("deeplabcut csv", "deeplabcut", "walkDLC_one.csv", "text_files:deeplabcut_csv", yardstick="pandas"),
    Cell("deeplabcut csv, 2", "deeplabcut", "walkDLC_two.csv", "text_files:deeplabcut_csv", 2, yardstick="pandas"),
    Cell("deeplabcut h5", "deeplabcut", "walkDLC.h5", "array_files:deeplabcut_h5", yardstick="pandas h5"),
    Cell("mediapipe csv", "mediapipe", "mediapipe.csv", "text_files:mediapipe_csv", joints=33, yardstick="pandas"),
    Cell("mediapipe json", "mediapipe", "mediapipe.json", "text_files:mediapipe_json", 1, 33, 200_000, "json"),
    Cell("mediapipe npz", "mediapipe", "mediapipe.npz", "array_files:mediapipe_npz", joints=33),
    Cell("videopose3d", "videopose3d", "data_2d_custom_walk.npz", "array_files:videopose3d"),
    Cell("csv", "csv", "wide.csv", "text_files:csv_wide", yardstick="pandas"),
    Cell("csv, 2 named", "csv", "named.csv", "text_files:csv_named", 2, yardstick="pandas"),
    Cell("csv, 2 unnamed", "csv", "unnamed.csv", "text_files:csv_wide", 2, yardstick="pandas"),
    Cell("csv, a row a joint", "csv", "long.csv", "text_files:csv_long", yardstick="pandas"),
    Cell("sleap_slp", "sleap_slp", "walk.slp", "array_files:sleap_slp", 2, yardstick="sleap-io"),
    Cell("sleap_slp, 2 unnamed", "sleap_slp", "unnamed.slp", "array_files:sleap_slp_unnamed", 2, yardstick="sleap-io"),
    Cell("sleap_h5", "sleap_h5", "walk.analysis.h5", "array_files:sleap_h5", 2),
    Cell("nwb", "nwb", "walk.nwb", "array_files:nwb", 2),
    Cell("jabs", "jabs", "walk_pose_est_v5.h5", "array_files:jabs", 2, 12),
    Cell("npz", "npz", "walk.npz", "array_files:npz"),
)
