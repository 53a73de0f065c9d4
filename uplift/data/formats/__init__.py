"""The formats of keypoint and mask files, one a file; `read` and `read_masks` tell which one a file is in and read it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.config.files import files_of
from uplift.config.trust import consents
from uplift.data.formats.base import Formats, Peek, ReadOptions
from uplift.data.formats.layouts import with_layout
from uplift.data.formats.scales import in_pixels, with_sure_confidence
from uplift.data.poses import PoseData
from uplift.data.turned import turned
from uplift.errors import UserError, listed

if TYPE_CHECKING:
    from uplift.data.clean_masks import MaskOptions
    from uplift.data.masks import MaskData

__all__ = ["KEYPOINT_FORMATS", "MASK_FORMATS", "as_read", "checked", "read", "read_masks", "with_options"]

KEYPOINT_FORMATS: Formats[ReadOptions, PoseData] = Formats(
    "keypoints",
    {
        "shards": "uplift.data.formats.shards:FORMAT",
        # JSON, folders of it, and labels in text files
        "coco": "uplift.data.formats.coco:ANNOTATIONS",
        "openpose": "uplift.data.formats.openpose:FORMAT",
        "mmpose": "uplift.data.formats.mmpose:FORMAT",
        "kinetics_skeleton": "uplift.data.formats.kinetics:FORMAT",
        "alphapose": "uplift.data.formats.alphapose:FORMAT",
        "coco_results": "uplift.data.formats.coco:RESULTS",
        "mpii_json": "uplift.data.formats.mpii_json:FORMAT",
        "alphatracker": "uplift.data.formats.alphatracker:FORMAT",
        "ultralytics_json": "uplift.data.formats.ultralytics:RESULTS",
        "ultralytics": "uplift.data.formats.ultralytics:LABELS",
        # tables, HDF5, and npz files of others
        "deeplabcut": "uplift.data.formats.deeplabcut:FORMAT",
        "mediapipe": "uplift.data.formats.mediapipe:FORMAT",
        "videopose3d": "uplift.data.formats.videopose3d:FORMAT",
        "csv": "uplift.data.formats.csv:FORMAT",
        "sleap_slp": "uplift.data.formats.sleap:PROJECT",
        "sleap_h5": "uplift.data.formats.sleap:ANALYSIS",
        "nwb": "uplift.data.formats.nwb:FORMAT",
        "jabs": "uplift.data.formats.jabs:FORMAT",
        "npz": "uplift.data.formats.npz:FORMAT",
    },
    own="uplift.data.formats.own:own_keypoints",
)
MASK_FORMATS: Formats[MaskOptions, MaskData] = Formats(
    "masks",
    {
        "npz": "uplift.data.formats.masks_npz:FORMAT",
        "coco": "uplift.data.formats.masks_coco:FORMAT",
        "labels": "uplift.data.formats.masks_pictures:LABELS",
        "png_folder": "uplift.data.formats.masks_pictures:MASKS",
    },
    own="uplift.data.formats.masks_own:own_masks",
)


@consents
def read(path: str | Path, options: ReadOptions | None = None) -> PoseData:
    """Read a file or folder of keypoints in the format that is named or guessed.

    `PoseData.notes` say which format that was, and what was assumed.

    Raises:
        UserError: no such file, no known format, a file that is not what it looks like, or as `checked`.
    """
    options, peek = options or ReadOptions(), Peek(path)
    found = KEYPOINT_FORMATS.chosen(peek, options)
    return as_read(path, KEYPOINT_FORMATS.read(peek, options, found), options, found.coordinates)


def as_read(path: str | Path, data: PoseData, options: ReadOptions, coordinates: str = "px") -> PoseData:
    """Return what a reader made of the file at ``path`` as `read` returns it; raises UserError as `checked`."""
    return checked(with_layout(replace(data, source=data.source or str(path)), options), options, coordinates)


def checked(data: PoseData, options: ReadOptions, coordinates: str = "px") -> PoseData:
    """Return what was read or given as pixels with confidences from 0 to 1, and with what the user says about it.

    ``coordinates`` are those of `FileFormat`.

    Raises:
        UserError: coordinates or confidences on a scale that is not known (`uplift.data.formats.scales`).
    """
    return with_options(with_sure_confidence(data), options, coordinates)


def with_options(data: PoseData, options: ReadOptions, coordinates: str = "placed") -> PoseData:
    """Return ``data`` with what the user says about it in place of what the file says; in pixels, unless they are ``placed``."""
    given = {name: getattr(options, name) for name in ("image_size", "fps")}
    data = replace(data, **{name: value for name, value in given.items() if value is not None})
    if options.focal_px is not None:
        data = data.with_focal_px(_focal_px_of(data, options.focal_px))
    if options.min_confidence > 0:
        weak = (data.confidence > 0) & ~(data.confidence >= options.min_confidence)
        data = replace(data, confidence=np.where(weak, np.float32(0), data.confidence))
        if weak.any():
            note = f"{int(weak.sum()):,} keypoints of confidence below {options.min_confidence:g} are taken as missing"
            data = replace(data, notes=(*data.notes, note))
    if coordinates != "placed":  # before they are turned, in an image whose size is one in pixels
        data = in_pixels(data, square=coordinates == "shares")
    return turned(data, flip_x=options.flip_x, flip_y=options.flip_y, rotate=options.rotate)


def _focal_px_of(data: PoseData, focal_px: Any) -> np.ndarray:
    """Return the focal length of each frame: that of its camera's, sequence's or file's name where there are several."""
    if not isinstance(focal_px, Mapping):
        return np.full(len(data), focal_px, float)
    file = Path(data.source)
    found = np.full(len(data), np.nan)
    columns = [data.identity[key].astype(str) for key in ("camera", "sequence") if key in data.identity]
    for column in [*columns, *(np.full(len(data), name) for name in (file.name, file.stem))]:
        for name in np.unique(column).tolist():
            value = next((value for camera, value in focal_px.items() if fnmatchcase(name, camera)), np.nan)
            found = np.where(np.isnan(found) & (column == name), value, found)
    if np.isnan(found).any():
        without = listed(dict.fromkeys(columns[0][np.isnan(found)].tolist())) if columns else file.name
        hint = "Name each camera, sequence or file, or give one number."
        raise UserError(f"{data.source}: focal_px= names {listed(focal_px)} and has none for {without}. {hint}")
    return found


@consents
def read_masks(
    path: str | Path,
    *,
    format: str | None = None,
    side: int = 64,
    border: str = "skip",
    pieces: str = "skip",
    category: str | Sequence[str] | None = None,
    most: int | None = None,
    images: str | Path | None = None,
) -> MaskData:
    """Read a file or folder of masks in the format that is named or guessed, and clean them.

    ``path`` may be several with commas, or a pattern. `MaskData.notes` say which format that was, what was
    assumed, and what was skipped, and why. ``category`` names those that are taken, ``most`` how many,
    ``images`` the folder of the photos.

    Raises:
        UserError: nothing there, no known format, files that are not what they look like, no mask that can be used.
    """
    from uplift.data.clean_masks import MaskOptions

    categories = category.split(",") if isinstance(category, str) else list(category or ())
    options = MaskOptions(
        side=side,
        border=border,
        pieces=pieces,
        format=format,
        category=tuple(one.strip() for one in categories if one.strip()),
        most=most,
        images=None if images is None else str(images),
    )
    return replace(MASK_FORMATS.read(Peek(files_of(path)), options), source=str(path))
