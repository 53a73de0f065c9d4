"""A trained lifter of masks as people use it: masks in, shapes out; saved as one file that cannot run code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uplift.config import ShapeSettings
from uplift.masks.container import MaskData
from uplift.shapes.prediction import ShapePrediction

__all__ = ["ShapeModel"]


@dataclass
class ShapeModel:
    """A lifter of masks with its settings."""

    lifter: Any
    settings: ShapeSettings

    def predict(self, data: MaskData, title: str = "") -> ShapePrediction:
        """Return a shape for every mask."""
        raise NotImplementedError

    def save(self, path: Path) -> None:
        """Write the model to one file of tensors and plain data."""
        raise NotImplementedError

    @classmethod
    def load_file(cls, path: Path) -> ShapeModel:
        """Return the model of a file that `save` wrote; nothing in the file can run."""
        raise NotImplementedError
