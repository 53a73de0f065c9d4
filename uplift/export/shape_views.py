"""Where masks were seen from: views, places and how far each is to be trusted, as a table or as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, refuse_existing, replacing
from uplift.data.views import write_views
from uplift.metrics.evaluate_shapes import silhouettes_seen
from uplift.models.prediction import ShapePrediction, view_angles_deg

__all__ = ["view_columns", "write_views_csv", "write_views_json"]


def view_columns(prediction: ShapePrediction) -> dict[str, Float[np.ndarray, " items"]]:
    """Return what is known of each mask's view, by the name of the column; NaN where nothing is.

    Angles are those of `ShapePrediction`, lengths have the units of its fields. ``silhouette_iou`` is the overlap of the
    lifted shape's silhouette and the mask.
    """
    azimuth, elevation, roll = view_angles_deg(prediction.view)
    found = {"azimuth_deg": azimuth, "elevation_deg": elevation, "roll_deg": roll}
    if prediction.probability is not None:
        found["probability"] = prediction.probability
    found |= {
        "scale": prediction.scale,
        "offset_x": prediction.offset[:, 0],
        "offset_y": prediction.offset[:, 1],
        "distance": prediction.distance,
        "centre_x_px": np.asarray(prediction.centre_px)[:, 0],
        "centre_y_px": np.asarray(prediction.centre_px)[:, 1],
        "scale_px": np.asarray(prediction.scale_px),
        "silhouette_iou": silhouettes_seen(prediction, prediction.masks),
    }
    if prediction.second_view is not None and prediction.second_probability is not None:
        other = view_angles_deg(prediction.second_view)
        names = ("second_azimuth_deg", "second_elevation_deg", "second_roll_deg")
        found |= dict(zip(names, other, strict=True)) | {"second_probability": prediction.second_probability}
    return {name: np.asarray(values, np.float64) for name, values in found.items()}


def write_views_csv(prediction: ShapePrediction, path: str | Path) -> None:
    """Write a row for each mask: its name and `view_columns`; what is infinite or unknown is an empty cell."""
    refuse_existing(Path(path))
    write_views(path, prediction.names, view_columns(prediction))


def write_views_json(prediction: ShapePrediction, path: str | Path) -> None:
    """Write the same as `write_views_csv`, and the ``view`` of each mask as a rotation; null for an empty cell."""
    refuse_existing(Path(path))
    columns = view_columns(prediction)
    items = [
        {
            "name": name,
            **{key: _rounded(values[row]) for key, values in columns.items()},
            "view": np.round(np.asarray(prediction.view[row], float), 6).tolist(),
        }
        for row, name in enumerate(prediction.names)
    ]
    with replacing(path) as file:
        file.write(as_bytes(json.dumps({"title": prediction.title, "items": items}, indent=1) + "\n"))


def _rounded(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None
