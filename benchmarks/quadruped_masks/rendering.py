"""Masks of the animated animals whose joints are the quadruped data, drawn from the same posed meshes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from uplift.data.parsers.gltf import GltfFile

__all__ = ["FPS", "NODES", "SIDE", "draw_mask", "masks_of_rows", "placing"]

FPS = 30
"""Frames of the data a second of the animations."""
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
"""Which node of the animals' files each joint of the data is at; the nose is at none."""


def placing(
    source: Float[np.ndarray, "points 3"], target: Float[np.ndarray, "points 3"]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation and shift that take ``source`` to ``target`` best: scale * rotation @ point + shift.

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
    """Return (side side) uint8, how much of each pixel of the crop ``box`` the triangles cover."""
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
    """Return masks and boxes of some rows of a quadruped file, and how far its joints are from the meshes' nodes, px.

    ``animals`` is the folder of the files. Rows of one pose should stand together: it is posed once.
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
        scale, rotation, shift = placing(nodes, pose[joints])
        off[place] = np.abs(_seen(data, scale * nodes @ rotation.T + shift) - data["keypoints"][row][joints]).max()
        seen = _seen(data, scale * vertices @ rotation.T + shift)
        low, high = seen.min(0), seen.max(0)
        side = float((high - low).max()) * _MARGIN
        boxes[place] = (*((low + high - side) / 2), side)
        masks[place] = draw_mask(seen[faces], boxes[place].astype(np.float64))
    return masks, boxes, off


def _seen(data: Mapping[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Return where the data's camera sees points of its frame, px."""
    return points[:, :2] / points[:, 2:] * float(data["focal_px"]) + np.asarray(data["image_size"]) / 2
