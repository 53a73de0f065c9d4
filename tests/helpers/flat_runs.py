"""A lifter that knows nothing, and a walk across the image that it is not far off with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from walks import SKELETON, walk

from uplift.config.settings import LifterSettings
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.skeleton import Skeleton

__all__ = ["across_the_image", "flat_run"]


def flat_run(folder: Path, skeleton: Skeleton = SKELETON, cameras: str = "own") -> Path:
    """Save a lifter that says that all joints are as far away as the root, and that the camera is level."""
    settings = LifterSettings(options={"units": 16, "blocks": 1}, cameras=cameras)
    lifter = Lifter(skeleton, settings).eval()
    with torch.no_grad():
        for weight in lifter.parameters():
            weight.zero_()
    Model(lifter, skeleton, settings).save(folder / "lifter.pt")
    return folder / "lifter.pt"


def across_the_image() -> dict[str, Any]:
    """Return the arrays of a file of keypoints."""
    points = walk(80, heading_deg=90.0).points + [1000, 0, 0]
    return {
        "keypoints": (points[..., :2] / points[..., 2:] * 1145 + 500).astype(np.float32),
        "joint_names": np.array(SKELETON.joints),
        "sequence": np.full(80, "walk"),
        "frame": np.arange(80),
        "fps": np.array(25.0),
        "image_size": np.array([1000, 1000]),
    }
