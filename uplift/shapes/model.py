"""A trained lifter of masks as people use it: masks in, shapes out; saved as one file that cannot run code."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from uplift.config import ShapeSettings
from uplift.errors import UserError
from uplift.masks.container import MaskData
from uplift.shapes.lifter import LiftedShapes, lift_masks
from uplift.shapes.mask_set import as_tensor
from uplift.shapes.mixture import ShapeMixture
from uplift.shapes.prediction import ShapePrediction
from uplift.torch_file import read_torch, save_torch

__all__ = ["ShapeModel"]

_FORMAT = 1
_CHUNK = 50
_SURE = 0.75
"""Temperature of lifting, in those of training: one mask is explained, the shapes no longer move."""


@dataclass
class ShapeModel:
    """A lifter of masks with its settings."""

    lifter: ShapeMixture
    settings: ShapeSettings

    def lift(self, masks: np.ndarray, resolution: int | None = None) -> LiftedShapes:
        """Return shapes of masks (items side side) of 0..255, cut out as `uplift.masks.container.MaskData` has them."""
        with torch.no_grad():
            drawn = self.lifter.crops()
            parts = [
                lift_masks(
                    self.lifter,
                    as_tensor(masks[start : start + _CHUNK]),
                    drawn,
                    resolution=resolution or self.settings.resolution,
                    temperature=_SURE * self.settings.cold,
                )
                for start in range(0, len(masks), _CHUNK)
            ]
        names = [part.name for part in dataclasses.fields(LiftedShapes)]
        return LiftedShapes(**{name: torch.cat([getattr(part, name) for part in parts]) for name in names})

    def predict(self, data: MaskData, title: str = "") -> ShapePrediction:
        """Return a shape for every mask.

        Occupancy is the expected one over the likeliest shapes and views, and `ShapePrediction.level` says
        where its surface is. Empty above that level where nothing explains a mask.

        Raises:
            UserError: no masks.
        """
        if not len(data):
            raise UserError("There is no mask to lift.")
        found = self.lift(data.masks)
        return ShapePrediction(
            found.occupancy.numpy(),
            found.view.numpy(),
            found.scale.numpy(),
            found.offset.numpy(),
            found.distance.numpy(),
            data.masks,
            list(data.names),
            data.centre_px,
            data.scale_px,
            level=float(self.lifter.level),
            title=title,
            images=data.images,
        )

    def save(self, path: Path) -> None:
        """Write the model to one file of tensors and plain data."""
        state = {
            "uplift_format": _FORMAT,
            "lifts": "masks",
            "shape": dataclasses.asdict(self.settings),
            "state": {key: value.detach().cpu() for key, value in self.lifter.state_dict().items()},
        }
        save_torch(state, path)

    @classmethod
    def load_file(cls, path: Path) -> ShapeModel:
        """Return the model of a file that `save` wrote; nothing in the file can run.

        Raises:
            UserError: not such a file, damaged, or inconsistent.
        """
        state = read_torch(path, "lifter")
        if state.get("uplift_format") != _FORMAT or state.get("lifts") != "masks":
            raise UserError(
                f"{path} is no lifter of masks of this version: uplift_format is {state.get('uplift_format')!r} and "
                f"lifts is {state.get('lifts')!r}, expected {_FORMAT} and 'masks'. Fit again, or use the version that wrote it."
            )
        try:
            settings = ShapeSettings(**{**state["shape"], "elevation_deg": tuple(state["shape"]["elevation_deg"])})
            parts, azimuths = state["state"]["azimuth_bias"].shape
            mixture = ShapeMixture(settings, parts, azimuths)
            mixture.load_state_dict(state["state"])
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise UserError(f"{path} is no whole lifter: {str(error).splitlines()[0]}") from error
        return cls(mixture.eval(), settings)
