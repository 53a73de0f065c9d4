"""Poses as trackers with several cameras write theirs: 3D of DeepLabCut, Anipose and sleap-anipose."""

from __future__ import annotations

import csv
import json
import warnings
from io import StringIO
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, replacing, replacing_by_name
from uplift.export.clips import Clip, evenly, one_body, one_clip
from uplift.export.scene import known_points
from uplift.export.tables import labels, lines_of
from uplift.models.prediction import Prediction

__all__ = ["write_anipose", "write_dlc_csv", "write_dlc_h5", "write_sleap"]

_NUMBER = "%.7g"
_SCORER = "uplift"


def _places(prediction: Prediction, clip: Clip) -> Float[np.ndarray, "frames individuals joints 3"]:
    return clip.by_moment(known_points(prediction.points, None))


def _remark(prediction: Prediction) -> str:
    """Return what these formats have no place for."""
    zero = "the root joint" if prediction.root is None else "the camera"
    return f"lengths are in {prediction.unit} from {zero}, axes {prediction.axes}: the format itself does not say so"


# DeepLabCut, as its triangulation writes: a column for each of scorer, individual where there are several, body part, coordinate.


def _dlc_columns(prediction: Prediction, clip: Clip) -> dict[str, list[str]]:
    """Return the levels of the columns' names, from the outermost."""
    bodies, parts = labels(clip.individual_names), labels(prediction.joint_names)
    levels = {"scorer": [_SCORER], "individuals": bodies, "bodyparts": parts, "coords": ["x", "y", "z"]}
    if len(bodies) == 1:
        del levels["individuals"]
    return levels


def write_dlc_csv(prediction: Prediction, path: str | Path) -> str:
    """Write one clip with all its individuals; a row for each frame, empty cells where a joint is missing.

    Raises UserError for several clips, and for an individual that is in a frame twice.
    """
    clip, _ = evenly(one_clip(prediction, path), path)
    levels = _dlc_columns(prediction, clip)
    head = [[level, *of] for level, of in zip(levels, zip(*product(*levels.values()), strict=True), strict=True)]
    _write_table(path, head, ["%d", *[_NUMBER] * (len(head[0]) - 1)], np.array(clip.frames), _places(prediction, clip))
    return _remark(prediction)


_ROWS = 512


def _write_table(path: str | Path, head: list[list[str]], cells: list[str], *columns: np.ndarray) -> None:
    """Write rows of names, then as CSV a row of ``cells`` for each frame, filled in out of arrays (frames ...)."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(head)
    with replacing(path) as handle:
        handle.write(as_bytes(text.getvalue()))
        for start in range(0, len(columns[0]), _ROWS):
            rows = lines_of(",".join(cells), *(column[start : start + _ROWS] for column in columns))
            handle.write(("\n".join(rows) + "\n").encode())


def write_dlc_h5(prediction: Prediction, path: str | Path) -> str:
    """Write the same table as `write_dlc_csv` for ``pandas.read_hdf``; raises UserError as that."""
    import pandas

    clip, _ = evenly(one_clip(prediction, path), path)
    levels, places = _dlc_columns(prediction, clip), _places(prediction, clip)
    columns = pandas.MultiIndex.from_product(list(levels.values()), names=list(levels))
    table = pandas.DataFrame(places.reshape(len(places), -1).astype(np.float64), index=clip.frames, columns=columns)
    with replacing_by_name(path) as written, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # names that are no names of Python's
        # Its own kind, "table", keeps the names of columns in 64 KB: too little for a crowd of whole bodies.
        table.to_hdf(written, key="df_with_missing", format="fixed", mode="w")
    return _remark(prediction)


# SLEAP has no 3D of its own: this is the points3d.h5 of sleap-anipose.


def write_sleap(prediction: Prediction, path: str | Path) -> str:
    """Write one clip: ``tracks`` (frames tracks nodes 3), NaN where missing, and ``frames``, the first and the one after the last.

    ``node_names``, ``track_names`` and ``edges`` stand beside them. Raises UserError as `write_dlc_csv`.
    """
    import h5py

    clip, start = evenly(one_clip(prediction, path), path)
    places = _places(prediction, clip)
    with replacing_by_name(path) as written, h5py.File(written, "w") as file:
        file.create_dataset("tracks", data=places, dtype="f8", chunks=True, compression="gzip", compression_opts=1)
        file["tracks"].attrs["Description"] = "Shape: (n_frames, n_tracks, n_nodes, 3)."
        file["frames"] = np.array([start, start + len(places)])
        file["frames"].attrs["Description"] = "Range, inclusive to exclusive, of frames."
        file["node_names"] = labels(prediction.joint_names)
        file["track_names"] = labels(clip.individual_names)
        file["edges"] = prediction.bone_indices
        file.attrs["uplift"] = json.dumps({"unit": prediction.unit, "axes": prediction.axes, "fps": prediction.fps})
    return ""


# Anipose: a table of one body, as its triangulation writes, which turns points by M and center into those of its cameras.

_ANIPOSE = {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER, "error": "", "ncams": "%d", "score": _NUMBER}
"""The columns of a joint, and how they are written."""


def write_anipose(prediction: Prediction, path: str | Path, individual: str | None = None) -> str:
    """Write one body of one clip, ``individual`` of several: x, y, z, score and cameras of each joint, and the frame.

    A row for each frame of the clip, of others' too, so that all bodies keep one time. ``NAME_error`` is that of a
    reprojection into several cameras, which there is none of: empty. ``NAME_ncams`` is 1 where the joint was seen. Raises
    UserError for several clips or bodies.
    """
    clip, _ = evenly(one_body(prediction, path, individual), path)
    score = np.nan_to_num(clip.by_moment(np.asarray(prediction.confidence, float))[:, 0, :, None])
    joints = np.concatenate([_places(prediction, clip)[:, 0], score > 0, score], -1)
    head = [f"{name}_{kind}" for name in labels(prediction.joint_names) for kind in _ANIPOSE]
    head += [f"M_{row}{column}" for row in range(3) for column in range(3)] + [f"center_{axis}" for axis in "012"]
    cells = [cell for _ in prediction.joint_names for cell in _ANIPOSE.values()] + [*"100010001", *"000", "%d"]
    _write_table(path, [[*head, "fnum"]], cells, joints, np.array(clip.frames))
    return _remark(prediction)
