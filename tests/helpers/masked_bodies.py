"""Random bodies with masks: their bones drawn as thick lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from lifts import H36M, bodies
from PIL import Image, ImageDraw

from uplift.data.poses import PoseData

SIDE = 32
THICK_PX = 24


def masked(data: PoseData, side: int = SIDE) -> PoseData:
    """Return the frames with masks: their bones drawn as thick lines."""
    masks, box = [], []
    for keypoints in data.keypoints:
        low, high = keypoints.min(0) - THICK_PX, keypoints.max(0) + THICK_PX
        size = float((high - low).max())
        picture = Image.new("L", (side * 4, side * 4))
        draw = ImageDraw.Draw(picture)
        scale = side * 4 / size
        for bone in H36M.bone_indices:
            a, b = ((keypoints[j] - low) * scale for j in bone)
            draw.line([*a, *b], fill=255, width=max(1, round(2 * THICK_PX * scale)))
        masks.append(np.asarray(picture.reduce(4)))
        box.append([*low, size])
    return replace(data, masks=np.stack(masks), mask_box=np.array(box, np.float32))


def hiding(data: PoseData, share: float = 0.3, seed: int = 0) -> PoseData:
    """Return the frames with missing joints, never the root."""
    confidence = (np.random.default_rng(seed).random(data.confidence.shape) >= share).astype(np.float32)
    confidence[:, H36M.root_index] = 1
    return replace(data, confidence=confidence, keypoints=data.keypoints * (confidence[..., None] > 0))


WHOLE = masked(bodies(24))
HIDDEN = hiding(WHOLE)
