"""A picture of lifted and true shapes: ``python -m benchmarks.shapes.picture RUN OUTPUT.png``.

Each row is a test item: its mask, the lifted shape as the camera sees it and rotated about gravity, and the true shape
in the same views. Rows are ordered from the best overlap of unseen silhouettes to the worst, evenly spaced by rank.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped
from PIL import Image
from scipy.ndimage import gaussian_filter
from torch import Tensor

from uplift.config.run import RunFolder
from uplift.data.load_masks import load_masks
from uplift.data.masks import MaskData
from uplift.geometry.rotation import about_y
from uplift.geometry.surface import written_surface
from uplift.geometry.voxels import fill
from uplift.metrics.evaluate_shapes import evaluate_shapes
from uplift.models.model import load
from uplift.models.prediction import ShapePrediction

__all__ = ["main", "shaded"]

_SIDE, _DEPTHS, _GAP, _GRID = 112, 240, 6, 128
_TURNS_DEG = (0, 60, 120, 180)
_WIDE = 1.25
"""Half the width of a picture, in half sides of the crop."""


def shaded(
    occupied: Float[Tensor, "depth height width"], view: Float[Tensor, "3 3"], scale: float
) -> Float[np.ndarray, "side side"]:
    """Return the shaded surface of a grid at level 0.5 as seen along z, 0 to 1, with 1 for the background."""
    at = ((2 * torch.arange(_SIDE) + 1) / _SIDE - 1) * _WIDE / scale
    z = ((2 * torch.arange(_DEPTHS) + 1) / _DEPTHS - 1) * 1.75
    z, y, x = torch.meshgrid(z, at, at, indexing="ij")
    points = torch.stack([x, y, z], -1) @ view
    seen = torch.nn.functional.grid_sample(occupied[None, None], points[None], align_corners=False)[0, 0] > 0.5
    near = torch.where(seen.any(0), seen.float().argmax(0) / _DEPTHS * 3.5, torch.nan).numpy()
    step = 2 * _WIDE / scale / _SIDE
    down, right = np.gradient(np.nan_to_num(near, nan=np.nanmax(near) if seen.any() else 0.0), step)
    light = (1 + 0.5 * right - 0.8 * down) / np.sqrt(1 + right**2 + down**2) / 1.4
    return np.where(np.isnan(near), 1.0, np.clip(light, 0.15, 0.9))


def _turned(grid: Shaped[np.ndarray, "depth height width"], view: np.ndarray, scale: float) -> list[np.ndarray]:
    occupied = torch.from_numpy(gaussian_filter(np.asarray(grid, np.float32), 1))
    seen_from = torch.from_numpy(np.asarray(view, np.float32))
    turns = about_y(torch.deg2rad(torch.tensor(_TURNS_DEG, dtype=torch.float32)))
    # Rotated about the object's down axis, seen by the same camera.
    return [shaded(occupied, seen_from @ turn, scale) for turn in turns]


def _row(prediction: ShapePrediction, data: MaskData, item: int) -> np.ndarray:
    assert data.truth is not None
    mask = Image.fromarray(255 - data.masks[item]).resize((_SIDE, _SIDE))
    surface = written_surface(prediction.occupancy[item], prediction.level).mesh
    lifted = np.zeros((_GRID,) * 3) if surface is None else fill(surface, _GRID)
    true = fill(data.truth.meshes[data.truth.shape[item]], _GRID)
    cells = [np.asarray(mask) / 255, *_turned(lifted, prediction.view[item], float(prediction.scale[item]))]
    cells += _turned(true, data.truth.view[item], float(data.truth.scale[item]))
    gap = np.ones((_SIDE, _GAP))
    return np.concatenate([part for cell in cells for part in (cell, gap)], 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shapes.picture", description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--rows", type=int, default=6, help="default 6")
    parser.add_argument("--items", type=int, default=100, help="number of test items to score, default 100")
    given = parser.parse_args(arguments)
    data = load_masks(RunFolder(given.run).settings()).test
    if data.truth is None:
        parser.error(f"{given.run}: its test masks have no true shapes")
    data = data.select(np.arange(min(given.items, len(data))))
    prediction = load(given.run / "lifter.pt").predict(data.without_truth())
    scores = evaluate_shapes(prediction, data.truth, data.masks, "test").per_item["silhouette_iou_unseen"]
    ranked = np.argsort(-scores)
    chosen = ranked[np.round(np.linspace(0.03, 0.97, given.rows) * (len(ranked) - 1)).astype(int)]
    rows = [_row(prediction, data, int(item)) for item in chosen]
    Image.fromarray((255 * np.concatenate(rows)).astype(np.uint8)).save(given.output, optimize=True)
    print(
        f"wrote {given.output}: unseen silhouettes {', '.join(f'{scores[item]:.2f}' for item in chosen)}, from top to bottom"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
