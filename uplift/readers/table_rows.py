"""From the numbers of a table to rows of keypoints: what is missing, how sure, and who is seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData, codes_of
from uplift.errors import UserError

__all__ = ["by_appearance", "check_names", "confidence_of", "frame_numbers", "rows_of"]

_FARTHEST_PX = 1e7
_MOST_CONFIDENT = 2.0  # heat maps peak a little over 1
_LAST_FRAME = 2**53


def rows_of(
    path: Path,
    keypoints: np.ndarray,
    scores: np.ndarray | None,
    names: Sequence[str],
    identity: dict[str, np.ndarray],
    bodies: Sequence[str] = (),
    **known: object,
) -> PoseData:
    """Return (frames bodies joints 2) keypoints and (frames bodies joints) scores as rows, without bodies unseen.

    ``identity`` has (frames,) values; ``bodies`` names the bodies, and nothing where there is one
    without a name; ``known`` goes into the `PoseData` as it is. Missing are coordinates that are NaN,
    scores that are NaN or at most 0, and, where the file has no scores, keypoints at exactly (0, 0).

    Raises:
        UserError: coordinates beyond any image, scores that are no shares, a name twice, no visible joint.
    """
    check_names(path, names, "joint")
    check_names(path, bodies, "individual")
    confidence = confidence_of(path, keypoints, scores)
    _check_distance(path, keypoints, confidence, names)
    seen: np.ndarray = np.any(confidence > 0, axis=-1)
    if not seen.any():
        raise UserError(f"{path}: no visible joint in any of {len(keypoints):,} frames.")
    body, frame = np.nonzero(seen.T)  # one body after the other: its frames stand together
    rows = {key: values[frame] for key, values in identity.items()}
    if len(bodies):
        rows["instance"] = np.array(bodies, np.str_)[body]
    order = _clips_together(rows)
    if order is not None:
        frame, body = frame[order], body[order]
        rows = {key: values[order] for key, values in rows.items()}
    whole = seen.shape[1] == 1 and len(frame) == seen.size and order is None
    return PoseData(
        keypoints=keypoints[:, 0] if whole else keypoints[frame, body],
        confidence=confidence[:, 0] if whole else confidence[frame, body],
        joint_names=tuple(names),
        identity=rows,
        source=str(path),
        **known,  # type: ignore[arg-type]
    )


def _clips_together(rows: dict[str, np.ndarray]) -> np.ndarray | None:
    """Return the order in which the rows of each clip, clips by first appearance, go up in time; None for as it is."""
    if "frame" not in rows or "sequence" not in rows:
        return None
    count = len(rows["frame"])
    parts = [rows[key] for key in ("subject", "sequence", "camera", "instance") if key in rows]
    order = np.lexsort((rows["frame"], by_appearance(parts, count)[0]))
    return None if (np.diff(order) == 1).all() else order


def by_appearance(parts: Sequence[np.ndarray], rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (rows,) numbers, equal where all of ``parts`` are, by first appearance, and the row of each of those."""
    code = np.zeros(rows, np.int64)
    for part in parts:
        _, one = codes_of(part)
        _, code = codes_of(code * (one.max(initial=0) + 1) + one)
    starts = np.flatnonzero(np.diff(code, prepend=-1))  # equal rows mostly stand together
    kinds, at = np.unique(code[starts], return_index=True)
    first = starts[at]
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(kinds), np.int64)
    rank[order] = np.arange(len(kinds))
    return rank[code], first[order]


def check_names(path: Path, names: Sequence[str], what: str) -> None:
    """Raise UserError where a name comes twice or is empty."""
    if not all(names):
        raise UserError(f"{path}: {what} {list(names).index('') + 1} has no name.")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(f"{path}: {what} '{twice[0]}' is there {Counter(names)[twice[0]]} times; names must differ.")


def frame_numbers(
    path: Path, numbers: np.ndarray, lines: np.ndarray | None = None, *, once: bool = False
) -> np.ndarray:
    """Return frame numbers as int64; with ``once`` none may come twice. Raises UserError for what is none."""
    whole = np.isfinite(numbers) & (numbers >= 0) & (numbers < _LAST_FRAME) & (np.floor(numbers) == numbers)
    if not whole.all():
        row = int(np.argmin(whole))
        raise UserError(f"{_place(path, lines, row)}: {numbers[row]:g} is no frame number, expected 0, 1, 2, ...")
    frame = numbers.astype(np.int64)
    if once and len(frame) > 1 and not (np.diff(frame) > 0).all():
        order = np.argsort(frame, kind="stable")
        again = np.flatnonzero(np.diff(frame[order]) == 0)
        if len(again):
            row = int(order[again[0] + 1])
            raise UserError(f"{_place(path, lines, row)}: frame {frame[row]} is there twice: two files in one?")
    return frame


def _place(path: Path, lines: np.ndarray | None, row: int) -> str:
    return f"{path}, row {row}" if lines is None else f"{path}, line {lines[row]}"


def confidence_of(path: Path, keypoints: np.ndarray, scores: np.ndarray | None) -> np.ndarray:
    """Return how sure each keypoint is, 0..1, 0 where it is missing. Raises UserError for scores that are no shares."""
    finite = ~np.isnan(keypoints).any(-1)
    if scores is None:
        return (finite & (keypoints != 0).any(-1)).astype(np.float32)
    scores = np.where(finite & ~np.isnan(scores), scores, np.float32(0))
    most = scores.max(initial=0)
    if most > _MOST_CONFIDENT:
        raise UserError(f"{path}: confidence goes up to {most:g}, expected 0..1: divide percentages by 100.")
    return np.clip(scores, 0, 1).astype(np.float32)


def _check_distance(path: Path, keypoints: np.ndarray, confidence: np.ndarray, names: Sequence[str]) -> None:
    far = (np.abs(keypoints).max(-1) > _FARTHEST_PX) & (confidence > 0)
    if far.any():
        frame, body, joint = np.argwhere(far)[0].tolist()
        x, y = keypoints[frame, body, joint].tolist()
        raise UserError(
            f"{path}: '{names[joint]}' in row {frame} is at ({x:g}, {y:g}), expected pixels within an image: damaged?"
        )
