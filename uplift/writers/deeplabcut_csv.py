"""Write the 2D of a `PoseData` in DeepLabCut's csv layout: one video, or labelled images."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.saving import replacing
from uplift.writers.keypoints_csv import as_text

__all__ = ["write_deeplabcut_csv"]

_SCORER = "uplift"


def write_deeplabcut_csv(data: PoseData, path: str | Path) -> None:
    """Write scorer, individuals (where there are any), bodyparts and coords x, y, likelihood.

    The index is the frame, or the image where rows are images. The layout holds nothing else: no
    rate, no subject, no action; the video's name is that of the file.

    Raises:
        UserError: more than one video, or one individual twice in a frame.
    """
    index, order = _index(data, path)
    who, bodies = _bodies(data)
    joints = len(data.joint_names)
    place = index * len(bodies) + who
    if len(place) and np.bincount(place).max() > 1:
        row = int(np.flatnonzero(np.bincount(place)[place] > 1)[0])
        raise UserError(f"cannot write {path}: '{bodies[who[row]]}' is in '{order[index[row]]}' twice.")
    cells = np.full((len(order) * len(bodies), joints, 3), np.nan, np.float32)
    cells[place, :, :2] = data.keypoints
    cells[place, :, 2] = data.confidence
    text = as_text(cells.reshape(len(order), -1))
    columns = [
        (body, joint, what) for body in bodies for joint in data.joint_names for what in ("x", "y", "likelihood")
    ]
    head = zip(*columns, strict=True)
    with replacing(path) as handle:
        stream = io.TextIOWrapper(handle, encoding="utf-8", newline="")
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(["scorer", *[_SCORER] * len(columns)])
        for name, row in zip(("individuals", "bodyparts", "coords"), head, strict=True):
            if name != "individuals" or "instance" in data.identity:
                lines.writerow([name, *row])
        lines.writerows([first, *row] for first, row in zip(order, text.tolist(), strict=True))
        stream.flush()
        stream.detach()


def _index(data: PoseData, path: str | Path) -> tuple[np.ndarray, list]:
    """Return (rows,) places in the index, and the index: images as they come, frames going up."""
    identity = data.identity
    keys = [key for key in ("subject", "sequence", "camera") if key in identity and "image" not in identity]
    clips = {tuple(values) for values in zip(*(identity[key].tolist() for key in keys), strict=True)} if keys else set()
    if len(clips) > 1:
        shown = ", ".join(" ".join(map(str, clip)) for clip in sorted(clips, key=str)[:3])
        raise UserError(
            f"cannot write {path}: {len(clips)} videos ({shown}, ...), and DeepLabCut's csv holds one. "
            "Write one file each, or a plain csv."
        )
    if "image" in identity:
        names = list(dict.fromkeys(identity["image"].tolist()))
        place = {name: at for at, name in enumerate(names)}
        return np.array([place[name] for name in identity["image"].tolist()], np.int64), names
    frame = identity.get("frame", np.arange(len(data)))
    frames, index = np.unique(frame, return_inverse=True)
    return index, frames.tolist()


def _bodies(data: PoseData) -> tuple[np.ndarray, list[str]]:
    """Return (rows,) places among the individuals, and their names by first appearance."""
    if "instance" not in data.identity:
        return np.zeros(len(data), np.int64), [""]
    names = data.identity["instance"].astype(np.str_).tolist()
    known = {name: at for at, name in enumerate(dict.fromkeys(names))}
    return np.array([known[name] for name in names], np.int64), list(known)
