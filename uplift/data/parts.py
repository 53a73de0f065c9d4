"""Keypoint files of any size, read in parts of whole clips: no more than a part is in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from uplift.data.far import without_far
from uplift.data.formats import KEYPOINT_FORMATS, as_read, read
from uplift.data.formats.base import Peek, ReadOptions
from uplift.data.formats.npz import KNOWN, poses_of, read_npz
from uplift.data.formats.shards import Shards
from uplift.data.individuals import by_individuals
from uplift.data.joints import in_joints_of
from uplift.data.parsers.npz import array_headers, iterate_rows, read_arrays, refuse_unknown
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.pieces import cuts, pieces_of
from uplift.data.poses import IDENTITY_KEYS, PoseData
from uplift.skeleton import Skeleton

__all__ = ["frames_of", "iterate_parts"]

_CLIP = ("subject", "sequence", "camera", "instance")
_BY_FRAME = (
    "keypoints", "confidence", "pose", "root", "tilt_deg", "roll_deg", "gravity", "masks", "mask_box", "focal_px",
    *IDENTITY_KEYS,
)  # fmt: skip


def frames_of(path: str | Path, options: ReadOptions | None = None) -> int | None:
    """Return how many frames a file has where that is known without reading it: an npz of ours, or shards; else None.

    Raises:
        UserError: no such file, no known format, or damaged.
    """
    format = _format_of(path, options or ReadOptions())
    if format == "shards":
        return len(Shards(path))
    shape = array_headers(path).get("keypoints", ((),))[0] if format == "npz" else ()
    return shape[0] if shape else None


def iterate_parts(
    path: str | Path, frames: int = 200_000, options: ReadOptions | None = None, skeleton: Skeleton | None = None
) -> Iterator[PoseData]:
    """Yield the frames of a keypoint file in order, in parts of whole clips of ``frames`` at most, or one longer clip.

    An npz of ours and a folder of shards are read part by part; a file of another format as a whole. Where clips take
    turns row by row, what they span is one part.

    Args:
        path: one file or folder.
        frames: of a part.
        options: what the user says of the file.
        skeleton: parts are in its joints, as `uplift.data.load.load_file` returns them; None: in the file's.

    Raises:
        UserError: as `uplift.data.formats.read`, and joints that do not fit the skeleton.
    """
    options = options or ReadOptions()
    format = _format_of(path, options)
    if format == "npz":
        parts = _npz_parts(Path(path), frames, options)
    elif format == "shards":
        parts = (as_read(path, part, options, "placed") for part in Shards(path).parts(frames))
    else:
        parts = pieces_of(read(path, options), frames)
    for part in parts:
        part = without_far(by_individuals(part, skeleton))
        yield part if skeleton is None else in_joints_of(part, skeleton)


def _format_of(path: str | Path, options: ReadOptions) -> str:
    return KEYPOINT_FORMATS.chosen(Peek(path), options).name


# An npz of ours: the rows of its arrays, one part after the other.

_FACTS = ("joint_names", "unit", "fps", "image_size", "axes")
_SCANNED = 1 << 18
"""Rows of identity that are looked at together."""


def _npz_parts(path: Path, frames: int, options: ReadOptions) -> Iterator[PoseData]:
    headers = array_headers(path)
    refuse_unknown(path, headers, KNOWN)
    shapes = {name: shape for name, (shape, _) in headers.items()}
    rows = (*shapes.get("keypoints", ()), 0)[0]
    by_frame = [name for name in _BY_FRAME if shapes.get(name) and (name != "focal_px" or shapes[name] == (rows,))]
    if rows <= frames or any(shapes[name][0] != rows for name in by_frame):  # wrong lengths: the reader says so
        yield from pieces_of(as_read(path, read_npz(path, options.image_size), options), frames)
        return
    given = [name for name in headers if name in (*_FACTS, *_BY_FRAME) and name not in by_frame]
    facts = read_arrays(path, given)
    clips = _Clips.of(path, [name for name in by_frame if name in IDENTITY_KEYS], rows)
    ends = cuts(clips.starts, clips.number, rows, frames) if clips.are_named else [*range(0, rows, frames), rows]
    focal_px = np.unique(read_arrays(path, ("focal_px",))["focal_px"]) if "focal_px" in by_frame else None
    counts = [end - start for start, end in pairwise(ends)]
    extremes: list[PoseData] = []
    for arrays in iterate_rows(path, by_frame, counts):
        part = clips.renamed(poses_of(str(path), facts | arrays, options.image_size))
        if focal_px is not None:  # of all frames: keypoints in pixels are those of their mean
            part = part.with_focal_px(arrays["focal_px"], among=focal_px)
        # Where confidences are no shares, that shows in the largest of them so far.
        both = as_read(path, PoseData.concat([*extremes, part], notes=part.notes), options)
        extremes = [_extremes(PoseData.concat([*extremes, part]))]
        yield both.select(slice(len(both) - len(part), None))


def _extremes(part: PoseData) -> PoseData:
    """Return the frames of the lowest and the highest confidence."""
    confidence = np.nan_to_num(part.confidence)
    return part.select([int(confidence.min(1).argmin()), int(confidence.max(1).argmax())])


@dataclass(frozen=True)
class _Clips:
    """Where the clips of an npz file are."""

    starts: np.ndarray
    """First row of each run of rows of one clip."""
    number: np.ndarray
    """Its clip's."""
    are_named: bool
    """Whether the file has sequences; without, each frame stands alone."""
    no_photos: bool
    """Whether any sequence is not named as a photo is."""

    @classmethod
    def of(cls, path: Path, columns: Sequence[str], rows: int) -> _Clips:
        """Return those of the file's identity ``columns``."""
        keys = [key for key in _CLIP if key in columns]
        if "sequence" not in keys:
            return cls(np.zeros(0, int), np.zeros(0, int), False, False)
        numbers: dict[tuple, int] = {}
        starts, number, last = [], [], None
        counts = [min(_SCANNED, rows - start) for start in range(0, rows, _SCANNED)]
        for start, block in zip(range(0, rows, _SCANNED), iterate_rows(path, keys, counts), strict=True):
            changed = np.zeros(len(block["sequence"]), bool)
            for values in block.values():
                changed[1:] |= values[1:] != values[:-1]
            changed[0] = last != tuple(values[0] for values in block.values())
            found = np.flatnonzero(changed)
            starts.append(found + start)
            names = zip(*(values[found].tolist() for values in block.values()), strict=True)
            number.append(np.array([numbers.setdefault(name, len(numbers)) for name in names], int))
            last = tuple(values[-1] for values in block.values())
        place = keys.index("sequence")
        text = (str(name[place]).lower() for name in numbers)
        photos = not {"frame", "image"} & set(columns) and all(name.endswith(PHOTO_ENDINGS) for name in text)
        return cls(np.concatenate(starts), np.concatenate(number), not photos, not photos)

    def renamed(self, part: PoseData) -> PoseData:
        """Return a part whose sequences happen to be named as photos all, as the sequences that the others are."""
        if not self.no_photos or "sequence" in part.identity:
            return part
        names = {"image": "sequence"}
        return replace(part, identity={names.get(key, key): values for key, values in part.identity.items()})
