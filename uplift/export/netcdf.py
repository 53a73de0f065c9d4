"""A clip as an xarray data set with labelled axes, and as netCDF (``.nc``): the layout of poses in movement."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uplift.config.files import replacing_by_name
from uplift.config.run import version_of
from uplift.errors import UserError
from uplift.export.clips import Clip, evenly, frame_rate, one_clip
from uplift.export.scene import AXES, known_points
from uplift.export.tables import labels
from uplift.models.prediction import Prediction

if TYPE_CHECKING:
    import xarray  # type: ignore

__all__ = ["to_xarray", "write_netcdf"]


def to_xarray(prediction: Prediction, name: str | Path = "to_xarray") -> xarray.Dataset:
    """Return one clip as a data set of poses as movement has them; ``name`` is what errors call it.

    ``position`` (time space keypoints individuals) is in its ``space_unit``, ``confidence`` (time keypoints individuals)
    from 0 to 1, NaN where an individual is not there; ``uncertainty`` and ``filled`` are there where they are known.
    ``time`` is in seconds, in frames where the rate is not known, and has no gaps. Raises UserError without xarray, for
    several clips, and for an individual that is in a frame twice.
    """
    try:
        import xarray  # type: ignore
    except ImportError as error:
        raise UserError(f'{name} needs xarray: pip install "uplift3d[xarray]".') from error
    clip, start = evenly(one_clip(prediction, name), name)
    rate = frame_rate(prediction, None)
    frames = np.arange(start, start + len(clip.frames))
    coordinates = {
        "time": frames if rate is None else frames / rate,
        "space": ["x", "y", "z"],
        "keypoints": labels(prediction.joint_names),
        "individuals": labels(who or "id_0" for who in clip.individual_names),
    }
    known = {
        "ds_type": "poses",
        "source_software": "uplift",
        "source_software_version": version_of("uplift3d") or "unknown",
    }
    known |= {"time_unit": "frames"} if rate is None else {"time_unit": "seconds", "fps": rate}
    known |= {"skeleton": _text(prediction.skeleton.name), "bones": json.dumps(prediction.skeleton.bones)}
    known |= {"title": _text(prediction.title or clip.name)}
    return xarray.Dataset(_variables(prediction, clip), coordinates, known)


def _variables(prediction: Prediction, clip: Clip) -> dict[str, tuple]:
    """Return dimensions, values and what is known of each variable."""
    over = ("time", "keypoints", "individuals")

    def by_time(values: np.ndarray) -> np.ndarray:
        return np.moveaxis(clip.by_moment(np.asarray(values, np.float32)), 1, -1).astype(np.float32)

    about = {"space_unit": prediction.unit, "axes": f"{prediction.axes}: {AXES[prediction.axes]}"}
    about["origin"] = f"the joint '{_text(prediction.skeleton.root)}'" if prediction.root is None else "the camera"
    places = by_time(known_points(prediction.points).transpose(0, 2, 1))
    found = {
        "position": (("time", "space", *over[1:]), places, about),
        "confidence": (over, by_time(prediction.confidence)),
    }
    if prediction.uncertainty is not None:
        found["uncertainty"] = (over, by_time(prediction.uncertainty), {"space_unit": prediction.unit})
    if prediction.filled is not None:
        found["filled"] = (over, np.nan_to_num(by_time(prediction.filled)).astype(bool))
    return found


def write_netcdf(prediction: Prediction, path: str | Path) -> None:
    """Write one clip as netCDF 4, the data set of `to_xarray`; raises UserError as that."""
    found = to_xarray(prediction, path)
    with replacing_by_name(path) as written:
        found.to_netcdf(written, engine="h5netcdf")


def _text(text: str) -> str:
    """Return a text that HDF5 can hold."""
    return labels([text])[0]
