"""The quadruped data with masks and with missing joints: one row per pose.

The masks are rendered from the animated meshes that the data's joints come from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from uplift.config.files import replacing
from uplift.data.parsers.gltf import GltfFile

__all__ = [
    "LIMBS", "NODES", "Frames", "align", "draw_mask", "hidden_joints", "masks_of_rows", "rendered_frames", "write_case",
]  # fmt: skip

VIEWS = 3
"""Rows per pose in the data."""
LIMBS = (
    *((f"{side}_{joint}" for joint in joints) for side in "LR" for joints in (
        ("carpus", "front_fetlock", "front_toe"), ("stifle", "hock", "hind_fetlock", "hind_toe"))),
    ("nose", "head", "neck_mid"), ("tail_1", "tail_2", "tail_3"),
)  # fmt: skip
LIMBS = tuple(tuple(limb) for limb in LIMBS)
_FEWEST = 8
_OFF_PX = 4.0  # for nearly all joints: between two frames of a fast motion the files differ a little more

FPS = 30
"""Frames of the data per second of animation."""
SIDE = 64
_FINER = 2
_MARGIN = 1.15
_SPINE = {
    "head": "Head", "neck_mid": "Neck2", "neck_base": "Neck1", "withers": "Torso3", "back": "Torso", "croup": "Back",
    "tail_1": "Tail1", "tail_2": "Tail2", "tail_3": "Tail3",
}  # fmt: skip
_LEGS = {
    "shoulder": "FrontUpperLeg", "carpus": "FrontLowerLeg", "front_fetlock": "FrontLowerLeg.{}_end",
    "front_toe": "FF.{}_end", "hip": "BackLeg", "stifle": "BackUpperLeg", "hock": "BackLowerLeg",
    "hind_fetlock": "IKBackLeg", "hind_toe": "FFB.{}_end",
}  # fmt: skip
NODES = _SPINE | {
    f"{side}_{joint}": node.format(side) if "{" in node else f"{node}.{side}"
    for side in "LR"
    for joint, node in _LEGS.items()
}
"""The node in the animals' files of each joint of the data; the nose has none."""


@dataclass(frozen=True)
class Frames:
    """Rows of one of the quadruped files, with their masks."""

    arrays: dict[str, np.ndarray]
    """As in an npz of the documented layout."""

    def __len__(self) -> int:
        return len(self.arrays["keypoints"])


def rendered_frames(folder: Path, split: str, cache: Path, every: int = VIEWS) -> Frames:
    """Return every third row of ``folder``/quadruped/``split``.npz with its mask; masks are cached in ``cache``.

    Raises:
        ValueError: the joints do not match the meshes.
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
    arrays = {name: value[rows] if value.shape[:1] == (frames,) else value for name, value in data.items()}
    with np.load(path) as file:
        arrays |= {name: file[name] for name in file.files}
    return Frames(arrays)


def hidden_joints(names: tuple[str, ...], frames: int, share: float, seed: int) -> np.ndarray:
    """Return (frames joints) bool: about ``share`` of the joints, half of them as complete limbs, never all of a frame."""
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


def align(
    source: Float[np.ndarray, "points 3"], target: Float[np.ndarray, "points 3"]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the scale, rotation and shift that best map ``source`` to ``target``: scale * rotation @ point + shift.

    Source: Umeyama 1991, equations 40 to 42.
    """
    from_middle, to_middle = source.mean(0), target.mean(0)
    one, other = source - from_middle, target - to_middle
    u, s, vt = np.linalg.svd(other.T @ one)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * flip) @ vt
    scale = float((s * flip).sum() / np.square(one).sum())
    return scale, rotation, to_middle - scale * rotation @ from_middle


def draw_mask(corners_px: Float[np.ndarray, "faces 3 2"], box: Float[np.ndarray, " 3"], side: int = SIDE) -> np.ndarray:
    """Return (side side) uint8: how much of each pixel of the crop ``box`` the triangles cover."""
    fine = side * _FINER
    at = (corners_px - box[:2]) * (fine / box[2]) - 0.5
    picture = Image.new("L", (fine, fine))
    draw = ImageDraw.Draw(picture)
    for triangle in at.reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=255)
    return np.asarray(picture.reduce(_FINER))


def masks_of_rows(
    data: Mapping[str, np.ndarray], rows: np.ndarray, animals: Path
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return masks and boxes of some rows of a quadruped file, and the largest distance of joints to mesh nodes, px.

    ``animals`` is the folder of the meshes. Rows of one pose should be adjacent: the mesh is then posed once.
    """
    names = [str(name) for name in data["joint_names"]]
    joints = [names.index(name) for name in NODES]
    files: dict[str, GltfFile] = {}
    masks, boxes = np.zeros((len(rows), SIDE, SIDE), np.uint8), np.zeros((len(rows), 3), np.float32)
    off = np.zeros(len(rows))
    last, vertices, faces, nodes = None, np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    for place, row in enumerate(rows):
        now = (str(data["sequence"][row]), int(data["frame"][row]))
        if now != last:
            animal, clip = now[0].split("/")
            file = files.setdefault(animal, GltfFile.read(animals / f"{animal}.glb"))
            moment = (f"AnimalArmature|{clip}", now[1] / FPS)
            mesh, at = file.posed(*moment), file.node_positions(*moment)
            vertices, faces, last = mesh.vertices, mesh.faces, now
            nodes = np.array([at[node] for node in NODES.values()])
        pose = data["pose"][row].astype(np.float64) + data["root"][row]
        scale, rotation, shift = align(nodes, pose[joints])
        off[place] = np.abs(_project(data, scale * nodes @ rotation.T + shift) - data["keypoints"][row][joints]).max()
        seen = _project(data, scale * vertices @ rotation.T + shift)
        low, high = seen.min(0), seen.max(0)
        side = float((high - low).max()) * _MARGIN
        boxes[place] = (*((low + high - side) / 2), side)
        masks[place] = draw_mask(seen[faces], boxes[place].astype(np.float64))
    return masks, boxes, off


def _project(data: Mapping[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Project points of the camera frame into the image, px."""
    return points[:, :2] / points[:, 2:] * float(data["focal_px"]) + np.asarray(data["image_size"]) / 2
