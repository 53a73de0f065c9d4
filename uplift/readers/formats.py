"""All formats that keypoints come in, the most telling first: the first that fits a file reads it."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from uplift.readers.base import Format

__all__ = ["FORMATS", "format_named"]

FORMATS: dict[str, str] = {
    # JSON, folders of it, and labels in text files
    "coco": "uplift.readers.coco",
    "openpose": "uplift.readers.openpose",
    "mmpose": "uplift.readers.mmpose",
    "kinetics_skeleton": "uplift.readers.kinetics",
    "alphapose": "uplift.readers.alphapose",
    "coco_results": "uplift.readers.coco_results",
    "mpii_json": "uplift.readers.mpii_json",
    "alphatracker": "uplift.readers.alphatracker",
    "ultralytics_json": "uplift.readers.ultralytics_json",
    "ultralytics": "uplift.readers.ultralytics",
    # tables, HDF5, and npz files of others
    "deeplabcut": "uplift.readers.deeplabcut",
    "mediapipe": "uplift.readers.mediapipe",
    "videopose3d": "uplift.readers.videopose3d",
    "csv": "uplift.readers.csv",
    "sleap_slp": "uplift.readers.sleap_slp",
    "sleap_h5": "uplift.readers.sleap_h5",
    "nwb": "uplift.readers.nwb",
    "jabs": "uplift.readers.jabs",
    "npz": "uplift.readers.npz",
}
"""Name of a format -> the module whose ``FORMAT`` it is."""


@cache
def format_named(name: str) -> Format:
    """Return a format of `FORMATS`."""
    return import_module(FORMATS[name]).FORMAT
