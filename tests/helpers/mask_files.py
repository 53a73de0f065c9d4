"""Mask files in the formats that users have."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

__all__ = ["blob", "coco_file", "photo", "runs_of", "save", "text_of_counts"]


def blob(height: int = 60, width: int = 80, seed: int = 0, margin: int = 4) -> np.ndarray:
    """Return (height width) bool: one connected piece of discs and boxes, without holes, clear of the border."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width] + 0.5
    mask = np.zeros((height, width), bool)
    y, x = height / 2, width / 2
    for _ in range(4):
        radius = random.uniform(0.1, 0.25) * min(height, width)
        mask |= (rows - y) ** 2 + (columns - x) ** 2 <= radius**2
        mask |= (abs(rows - y) <= radius * 1.3) & (abs(columns - x) <= radius * 0.5)
        y, x = y + random.uniform(-1, 1) * radius, x + random.uniform(-1, 1) * radius
    mask[:margin] = mask[-margin:] = mask[:, :margin] = mask[:, -margin:] = False
    return mask


def save(path: Path, array: np.ndarray, palette: list[int] | None = None, **options: Any) -> Path:
    """Write an array as an image, creating its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(array)
    if palette is not None:
        image = Image.fromarray(array.astype(np.uint8), "L")
        image.putpalette(palette + [0] * (768 - len(palette)))
    image.save(path, **options)
    return path


def runs_of(mask: np.ndarray) -> list[int]:
    """Return COCO's run lengths of a mask: down the columns, uncovered pixels first."""
    flat = mask.T.reshape(-1).astype(int)
    turns = np.flatnonzero(np.diff(np.concatenate([[0], flat])))
    return np.diff(np.concatenate([[0], turns, [flat.size]])).tolist()


def text_of_counts(counts: list[int]) -> str:
    """Return run lengths in COCO's compressed form, written independently of the package."""
    text = ""
    for place, count in enumerate(counts):
        number = count - counts[place - 2] if place > 2 else count
        more = True
        while more:
            digit = number & 31
            number >>= 5
            more = number != (-1 if digit & 16 else 0)
            text += chr(48 + (digit | 32 if more else digit))
    return text


def coco_file(path: Path, segmentations: list[Any], size: tuple[int, int] = (80, 60), **more: Any) -> Path:
    """Write a COCO file with one image of ``size`` (width, height) and an annotation per segmentation, alternately horse and cow."""
    content = {
        "images": [{"id": 7, "file_name": "field.jpg", "width": size[0], "height": size[1]}],
        "annotations": [
            {"id": 100 + n, "image_id": 7, "category_id": 1 + n % 2, "iscrowd": 0, "segmentation": one}
            for n, one in enumerate(segmentations)
        ],
        "categories": [{"id": 1, "name": "horse"}, {"id": 2, "name": "cow"}],
    }
    path.write_text(json.dumps({**content, **more}))
    return path


def photo(height: int = 120, width: int = 160, colours: int = 3, seed: int = 0) -> np.ndarray:
    """Return a smooth image with noise."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width]
    light = 120 + 60 * np.sin(rows / 17) + 50 * np.cos(columns / 23)
    shades = light[..., None] + np.arange(colours) * 12 + random.normal(0, 4, (height, width, colours))
    return np.clip(shades, 0, 255).astype(np.uint8).squeeze()
