"""The quadruped data with masks and with joints missing: one row of each pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.quadruped_masks.rendering import masks_of_rows
from uplift.config.files import replacing

__all__ = ["LIMBS", "VIEWS", "Frames", "drawn_frames", "hidden_joints", "write_case"]

VIEWS = 3
"""Rows of one pose in the data."""
LIMBS = (
    *((f"{side}_{joint}" for joint in joints) for side in "LR" for joints in (
        ("carpus", "front_fetlock", "front_toe"), ("stifle", "hock", "hind_fetlock", "hind_toe"))),
    ("nose", "head", "neck_mid"), ("tail_1", "tail_2", "tail_3"),
)  # fmt: skip
LIMBS = tuple(tuple(limb) for limb in LIMBS)
_FEWEST = 8
_OFF_PX = 4.0  # of most: between two frames of a fast motion the files differ a little more


@dataclass(frozen=True)
class Frames:
    """Rows of one of the quadruped files, with their masks."""

    arrays: dict[str, np.ndarray]
    """As an npz of the documented layout has them."""

    def __len__(self) -> int:
        return len(self.arrays["keypoints"])


def drawn_frames(folder: Path, split: str, cache: Path, every: int = VIEWS) -> Frames:
    """Return every third row of ``folder``/quadruped/``split``.npz with its mask; kept in ``cache``.

    Raises:
        ValueError: joints that are not where the meshes have them.
    """
    path = cache / f"quadruped_masks_{split}_{every}.npz"
    with np.load(folder / "quadruped" / f"{split}.npz") as file:
        data = {name: file[name] for name in file.files}
    rows = np.arange(0, len(data["keypoints"]), every)
    if not path.is_file():
        masks, box, off_px = masks_of_rows(data, rows, folder / "animal_meshes")
        if np.quantile(off_px, 0.99) > _OFF_PX:
            raise ValueError(f"{split}.npz: joints are up to {off_px.max():.1f} px from the nodes of the meshes")
        cache.mkdir(parents=True, exist_ok=True)
        with replacing(path) as out:
            np.savez_compressed(out, masks=masks, mask_box=box)
    frames = len(data["keypoints"])
    kept = {name: value[rows] if value.shape[:1] == (frames,) else value for name, value in data.items()}
    with np.load(path) as file:
        kept |= {name: file[name] for name in file.files}
    return Frames(kept)


def hidden_joints(names: tuple[str, ...], frames: int, share: float, seed: int) -> np.ndarray:
    """Return (frames joints) bool: about ``share`` of the joints, half of them by whole limbs, some left in every frame."""
    rng = np.random.default_rng(seed)
    limbs = np.array([[name in limb for name in names] for limb in LIMBS])
    hidden = np.zeros((frames, len(names)), bool)
    most = len(names) - _FEWEST
    for row in range(frames):
        wanted = min(rng.binomial(len(names), share), most)
        for limb in rng.permutation(limbs):
            if hidden[row].sum() + limb.sum() > wanted / 2 + 1:
                break
            hidden[row] |= limb
        left = np.flatnonzero(~hidden[row])
        hidden[row, rng.permutation(left)[: max(0, wanted - int(hidden[row].sum()))]] = True
    return hidden


def write_case(path: Path, frames: Mapping[str, np.ndarray], hidden: np.ndarray, *, masks: bool) -> None:
    """Write an npz of the documented layout with ``hidden`` joints missing."""
    arrays = {name: value for name, value in frames.items() if masks or name not in ("masks", "mask_box")}
    arrays["confidence"] = (~hidden).astype(np.float32)
    arrays["keypoints"] = np.where(hidden[..., None], 0, frames["keypoints"]).astype(np.float32)
    with replacing(path) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
