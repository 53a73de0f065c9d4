"""Files of tables as DeepLabCut, MediaPipe's users and others write them, of many frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Chunk, Walk
from benchmarks.reading.lines import GAP, decimals, filled, whole_numbers, words
from uplift.data.datasets.coco import COCO_JOINTS
from uplift.skeleton import load_skeleton

__all__ = ["csv_long", "csv_named", "csv_unnamed", "csv_wide", "deeplabcut_csv", "deeplabcut_h5", "mediapipe_csv"]

_POINT, _SCORE = 13, 16
_SCORER = "DLC_resnet50_walkJan1shuffle1_100000"
_LEVELS = ("scorer", "individuals", "bodyparts", "coords")


def _table(path: Path, walk: Walk, head: str, template: str, cells: Callable[[Chunk], list[np.ndarray]]) -> None:
    with path.open("wb") as file:
        file.write(head.encode())
        file.writelines(filled(template, cells(chunk)) for chunk in walk.chunks())


def _numbers(chunk: Chunk, bodies: slice, points: int, scores: int, instead: str = "") -> list[np.ndarray]:
    """Return x, y and score of each joint of the bodies, in turns."""
    lost = chunk.missing[:, bodies]
    parts = [decimals(chunk.xy[:, bodies, :, axis], points, lost, instead, axis) for axis in (0, 1)]
    parts.append(decimals(chunk.score[:, bodies], scores, lost, instead, 2))
    return [part[:, gap : gap + 1] for gap in range(parts[0].shape[1]) for part in parts]


def _columns(names: tuple[str, ...], parts: tuple[str, ...]) -> str:
    return ",".join(f"{name}_{part}" for name in names for part in parts)


def deeplabcut_csv(path: Path, walk: Walk) -> None:
    """Predictions; of several individuals where there are several bodies."""
    who = [f"ind{body + 1}" for body in range(walk.bodies)]
    columns = [(_SCORER, one, joint, part) for one in who for joint in _joints(walk) for part in _PARTS]
    levels = [at for at in range(4) if at != 1 or walk.bodies > 1]
    head = "".join(",".join([_LEVELS[at], *(column[at] for column in columns)]) + "\n" for at in levels)
    template = ",".join([GAP] * (1 + len(columns))) + "\n"
    _table(path, walk, head, template, lambda chunk: [
        whole_numbers(chunk.frame)[:, None], *_numbers(chunk, slice(None), _POINT, _SCORE)
    ])  # fmt: skip


_PARTS = ("x", "y", "likelihood")


def _joints(walk: Walk) -> tuple[str, ...]:
    return COCO_JOINTS[: walk.joints]


def deeplabcut_h5(path: Path, walk: Walk) -> None:
    """The same as a table of pandas."""
    import pandas as pd

    of = walk.whole()
    values = np.concatenate([of.xy, of.score[..., None]], -1)
    values[of.missing] = np.nan
    columns = pd.MultiIndex.from_product([[_SCORER], _joints(walk), _PARTS], names=["scorer", "bodyparts", "coords"])
    frame = pd.DataFrame(values.reshape(len(values), -1), columns=columns)
    frame.to_hdf(path, key="df_with_missing", mode="w", format="table")


def mediapipe_csv(path: Path, walk: Walk) -> None:
    """A row a frame of named landmarks: shares of the image, depth, visibility."""
    names = tuple(name.upper() for name in load_skeleton("mediapipe33").joints if name not in ("pelvis", "neck"))
    head = "frame," + _columns(names, ("x", "y", "z", "visibility")) + "\n"

    def cells(chunk: Chunk) -> list[np.ndarray]:
        lost = chunk.missing[:, 0]
        xy = [decimals(chunk.xy[:, 0, :, axis] / SIZE_PX[axis], _SCORE, lost, "", axis) for axis in (0, 1)]
        score = decimals(chunk.score[:, 0], _SCORE, lost, "", 2)
        parts = (*xy, score, score)
        numbers = [part[:, gap : gap + 1] for gap in range(walk.joints) for part in parts]
        return [whole_numbers(chunk.frame)[:, None], *numbers]

    _table(path, walk, head, ",".join([GAP] * (1 + 4 * walk.joints)) + "\n", cells)


def csv_wide(path: Path, walk: Walk) -> None:
    """A row a frame."""
    head = "frame," + _columns(_joints(walk), ("x", "y", "confidence")) + "\n"
    template = ",".join([GAP] * (1 + 3 * walk.joints)) + "\n"
    _table(path, walk, head, template, lambda chunk: [
        whole_numbers(chunk.frame)[:, None], *_numbers(chunk, slice(0, 1), 6, 6)
    ])  # fmt: skip


def csv_named(path: Path, walk: Walk) -> None:
    """A row a frame and individual."""
    _rows(path, walk, named=True)


def csv_unnamed(path: Path, walk: Walk) -> None:
    """A row a frame and body, which has no name."""
    _rows(path, walk, named=False)


def _rows(path: Path, walk: Walk, *, named: bool) -> None:
    lead = "frame,individual" if named else "frame"
    head = f"{lead},{_columns(_joints(walk), ('x', 'y', 'confidence'))}\n"
    row = ",".join([GAP] * (1 + named + 3 * walk.joints)) + "\n"

    def cells(chunk: Chunk) -> list[np.ndarray]:
        found = []
        for body in range(walk.bodies):
            name = [words([f"mouse{body + 1}"], len(chunk.frame))] * named
            numbers = _numbers(chunk, slice(body, body + 1), 6, 6)
            found += [whole_numbers(chunk.frame)[:, None], *name, *numbers]
        return found

    _table(path, walk, head, row * walk.bodies, cells)


def csv_long(path: Path, walk: Walk) -> None:
    """A row a frame and joint."""
    row = f"{GAP},%s,{GAP},{GAP},{GAP}\n"
    template = "".join(row % name for name in _joints(walk))

    def cells(chunk: Chunk) -> list[np.ndarray]:
        number = whole_numbers(chunk.frame)[:, None]
        numbers = _numbers(chunk, slice(0, 1), 6, 6)
        return [part for at, cell in enumerate(numbers) for part in ([number, cell] if at % 3 == 0 else [cell])]

    _table(path, walk, "frame,joint,x,y,confidence\n", template, cells)
