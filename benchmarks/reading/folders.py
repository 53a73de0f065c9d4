"""Folders with a file a frame, as OpenPose and Ultralytics write them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Chunk, Walk
from benchmarks.reading.lines import GAP, decimals, filled
from benchmarks.reading.records import Cells, each, gaps, together, xyc

__all__ = ["openpose", "ultralytics"]


def openpose(path: Path, walk: Walk) -> None:
    """A folder with a file a frame: people of 25 keypoints, without numbers."""
    empty = ", ".join(f'"{part}_keypoints_2d": []' for part in ("face", "hand_left", "hand_right"))
    person = f'{{"person_id": [-1], "pose_keypoints_2d": [{gaps(3 * walk.joints, GAP)}], {empty}}}'
    template = f'{{"version": 1.3, "people": [{", ".join([person] * walk.bodies)}]}}\n'
    cells = each(walk, lambda chunk, one: together(*xyc(chunk, one, 3, 6)), numbers=0)
    _folder(path, walk, template, cells, "video_%012d_keypoints.json")


def ultralytics(path: Path, walk: Walk) -> None:
    """A folder with a file of predictions a frame: class, box, keypoints as shares, score, track."""
    row = f"0 {' '.join([GAP] * (4 + 3 * walk.joints))} 0.873124 %d\n"
    template = "".join(row % (body + 1) for body in range(walk.bodies)) + "\n"

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        shares = chunk.xy[:, one] / SIZE_PX
        low = np.where(lost[..., None], 1, shares).min(1)
        high = np.where(lost[..., None], 0, shares).max(1)
        box = decimals(np.concatenate([(low + high) / 2, high - low], -1), 6)
        xy = (decimals(shares[..., axis], 6, lost, "0") for axis in (0, 1))
        return [box, *together(*xy, decimals(chunk.score[:, one], 6, lost, "0"))]

    (path / "labels").mkdir(parents=True)
    _folder(path / "labels", walk, template, each(walk, body, numbers=0), "video_%d.txt", between=b"\n\n")


def _folder(
    path: Path, walk: Walk, template: str, cells: Callable[[Chunk], Cells], name: str, between: bytes = b"\n"
) -> None:
    path.mkdir(parents=True, exist_ok=True)
    for chunk in walk.chunks():
        texts = filled(template, cells(chunk)).split(between)[:-1]
        for number, text in zip(chunk.frame.tolist(), texts, strict=True):
            (path / (name % number)).write_bytes(text + b"\n")
