"""Names of keypoints by their number, for files of trackers that write none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError

__all__ = [
    "ALPHAPOSE", "COCO", "COCO_JOINTS", "H36M_JOINTS", "HAND21", "HANDS", "HOURGLASS_JOINTS", "KINETICS", "MMPOSE",
    "MPII16", "OPENPOSE", "OPENPOSE_FACE70", "WHOLEBODY133", "Layouts", "likely_layout", "names_for", "pairs_by_name",
    "swapped_names",
]  # fmt: skip

COCO_JOINTS = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle",
)  # fmt: skip
H36M_JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "spine", "thorax", "nose", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip
"""Those of the skeleton h36m17."""
HOURGLASS_JOINTS = (
    "rankle", "rknee", "rhip", "lhip", "lknee", "lankle", "hip", "spine", "thorax", "headtop",
    "rwrist", "relbow", "rshoulder", "lshoulder", "lelbow", "lwrist",
)  # fmt: skip
HALPE26 = (
    *COCO_JOINTS, "head", "neck", "hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
    "left_heel", "right_heel",
)  # fmt: skip
FEET6 = ("left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel")
_FACE68 = tuple(f"face-{number}" for number in range(68))
OPENPOSE_FACE70 = tuple(f"face-{number}" for number in range(70))
_FINGERS = ("thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger")
HANDS = {
    side: (f"{side}_hand_root", *(f"{side}_{finger}{number}" for finger in _FINGERS for number in (1, 2, 3, 4)))
    for side in ("left", "right")
}
"""The two hands, 21 keypoints each, by the names that MMPose gives those of COCO-WholeBody."""
HAND21 = (
    "wrist", "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip", "index_mcp", "index_pip", "index_dip", "index_tip",
    "middle_mcp", "middle_pip", "middle_dip", "middle_tip", "ring_mcp", "ring_pip", "ring_dip", "ring_tip",
    "little_mcp", "little_pip", "little_dip", "little_tip",
)  # fmt: skip
WHOLEBODY133 = (*COCO_JOINTS, *FEET6, *_FACE68, *HANDS["left"], *HANDS["right"])
HALPE136 = (*HALPE26, *_FACE68, *HANDS["left"], *HANDS["right"])
HALPE68 = (*HALPE26, *HANDS["left"], *HANDS["right"])
OPENPOSE25 = (
    "Nose", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist", "MidHip", "RHip", "RKnee",
    "RAnkle", "LHip", "LKnee", "LAnkle", "REye", "LEye", "REar", "LEar", "LBigToe", "LSmallToe", "LHeel", "RBigToe",
    "RSmallToe", "RHeel",
)  # fmt: skip
OPENPOSE18 = tuple(name for name in OPENPOSE25[:19] if name != "MidHip")
OPENPOSE15 = (
    "Head", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist", "RHip", "RKnee", "RAnkle",
    "LHip", "LKnee", "LAnkle", "Chest",
)  # fmt: skip
MPII16 = (
    "rankle", "rknee", "rhip", "lhip", "lknee", "lankle", "hip", "thorax", "upper_neck", "headtop", "rwrist",
    "relbow", "rshoulder", "lshoulder", "lelbow", "lwrist",
)  # fmt: skip

Layouts = Mapping[int, tuple[str, tuple[str, ...]]]
"""Number of keypoints -> what the layout is called, and its names."""

_COCO17 = ("COCO", COCO_JOINTS)
_HAND = ("a hand", HAND21)
COCO: Layouts = {17: _COCO17, 26: ("Halpe", HALPE26), 133: ("COCO-WholeBody", WHOLEBODY133)}
ALPHAPOSE: Layouts = {
    **COCO,
    18: ("OpenPose's 18", OPENPOSE18),
    21: _HAND,
    68: ("Halpe without a face", HALPE68),
    136: ("Halpe", HALPE136),
}
MMPOSE: Layouts = {**COCO, 16: ("MPII", MPII16), 21: _HAND}
OPENPOSE: Layouts = {
    25: ("OpenPose's BODY_25", OPENPOSE25),
    18: ("OpenPose's COCO model", OPENPOSE18),
    15: ("OpenPose's MPI model", OPENPOSE15),
}
KINETICS: Layouts = {17: _COCO17, 18: ("OpenPose's COCO model", OPENPOSE18)}


SHIPPED: dict[int, tuple[tuple[str, str], ...]] = {
    25: (("OpenPose's BODY_25", "openpose25"), ("OpenPose's BODY_25B", "openpose25b")),
    17: (("COCO", "coco17"), ("Human3.6M", "h36m17"), ("AP-10K", "ap10k17"), ("MPI-INF-3DHP", "mpi_inf_3dhp17")),
    26: (("Halpe", "halpe26"), ("Animal3D", "animal3d26")),
    21: (("a hand", "hand21"), ("InterHand2.6M", "interhand21")),
}
"""Number of keypoints -> the layouts that have so many, the usual one first, and their shipped skeletons."""


def names_for(
    path: Path, count: int, layouts: Layouts, options: ReadOptions, points: np.ndarray | None = None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of ``count`` keypoints that a file does not name, and the notes that say so.

    With ``points`` (rows count 2, or 3 with a score) another layout of as many keypoints than the usual is
    taken where its bones are clearly shorter (`likely_layout`).

    Raises:
        UserError: the layout that the user names does not have that many.
    """
    if options.layout is not None:
        return _names_of_layout(path, count, options.layout), ()
    if count in layouts:
        what, names = layouts[count]
        shipped = SHIPPED.get(count, ())
        if points is not None and shipped and shipped[0][0] == what:
            other = _likely(points, names, shipped)
            if other:
                note = (
                    f"keypoints have no names in the file: {count} of them are taken as {shipped[other][0]}, not as "
                    f"{what}, whose bones would be far too long (layout={shipped[0][1]} overrules)"
                )
                return _names_of(shipped[other][1]), (note,)
        return names, (f"keypoints have no names in the file: {count} of them are taken as {what}",)
    note = (
        f"keypoints have no names in the file, and no known layout has {count}: named keypoint_0 to "
        f"keypoint_{count - 1}; say layout=SKELETON, or use a skeleton with these names"
    )
    return tuple(f"keypoint_{number}" for number in range(count)), (note,)


def pairs_by_name(pairs: Any, names: tuple[str, ...], first: int = 0) -> tuple[tuple[str, str], ...]:
    """Return pairs of keypoints, numbered from ``first`` on, by name; without what are not such pairs."""
    places = range(first, first + len(names))
    return tuple(
        (names[pair[0] - first], names[pair[1] - first])
        for pair in (pairs if isinstance(pairs, list) else [])
        if isinstance(pair, list) and len(pair) == 2 and all(type(place) is int and place in places for place in pair)
    )


def swapped_names(partners: Any, names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of names that a list with the number of each one's partner swaps; none for anything else."""
    if not isinstance(partners, list) or len(partners) != len(names):
        return ()
    good = [(a, b) for a, b in enumerate(partners) if type(b) is int and a < b < len(names) and partners[b] == a]
    return tuple((names[a], names[b]) for a, b in good)


def _likely(points: np.ndarray, names: tuple[str, ...], shipped: tuple[tuple[str, str], ...]) -> int:
    """Return which of the ``shipped`` layouts the points are in; ``names`` are those of the first."""
    seen = np.isfinite(points).all(-1) & (points[..., :2] != 0).any(-1)
    score = np.where(seen, points[..., 2] if points.shape[-1] > 2 else 1, 0)
    layouts = [(shipped[0][1], names), *((skeleton, _names_of(skeleton)) for _, skeleton in shipped[1:])]
    return likely_layout(points[..., :2].astype(np.float32), score.astype(np.float32), layouts)


def _names_of(skeleton: str) -> tuple[str, ...]:
    from uplift.skeleton import load_skeleton

    shipped = load_skeleton(skeleton)
    return tuple(joint for joint in shipped.joints if joint not in shipped.midpoints)


def _names_of_layout(path: Path, count: int, layout: str) -> tuple[str, ...]:
    from uplift.skeleton import load_skeleton

    found = [load_skeleton(layout).joints, _names_of(layout)]
    for names in found:
        if len(names) == count:
            return names
    raise UserError(
        f"{path} has {count} keypoints; layout={layout} has {len(found[1])} joints that are not midpoints. Expected a "
        "skeleton whose joints are the file's keypoints, in its order."
    )


# The likely layout of unnamed keypoints: the one whose bones are short.

_CLEARLY = 0.65
"""Another layout than the usual is taken where its bones are this much of the usual one's."""
_MOST_ROWS = 500


def likely_layout(
    keypoints: Float[np.ndarray, "rows keypoints 2"],
    confidence: Float[np.ndarray, "rows keypoints"],
    layouts: Sequence[tuple[str, tuple[str, ...]]],
) -> int:
    """Return which of ``layouts``, (shipped skeleton, names in order), the keypoints are in; the first unless another is clearly better.

    Names in a wrong order join a knee to an ear: the bones of the right layout are much the shortest,
    counted in sizes of the body.
    """
    step = max(1, len(keypoints) // _MOST_ROWS)
    shares = [_bone_share(keypoints[::step], confidence[::step], *layout) for layout in layouts]
    best = int(np.argmin(shares))
    return best if shares[best] < _CLEARLY * shares[0] else 0


def _bone_share(
    keypoints: Float[np.ndarray, "rows keypoints 2"],
    confidence: Float[np.ndarray, "rows keypoints"],
    skeleton: str,
    names: tuple[str, ...],
) -> float:
    """Return the median over bodies of the mean bone that is seen, as a share of the body's size; infinite where none is."""
    from uplift.skeleton import load_skeleton
    from uplift.skeleton.match import build_joints

    shipped = load_skeleton(skeleton)
    points, found, _ = build_joints(keypoints, confidence, names, shipped)
    one, other = shipped.bone_indices.T
    seen = (found[:, one] > 0) & (found[:, other] > 0)
    length = np.where(seen, np.linalg.norm(points[:, one] - points[:, other], axis=-1), 0)
    shown = np.isfinite(keypoints).all(-1) & (confidence > 0)
    low = np.where(shown[..., None], keypoints, np.inf).min(1)
    high = np.where(shown[..., None], keypoints, -np.inf).max(1)
    with np.errstate(invalid="ignore"):
        size = np.linalg.norm(high - low, axis=-1)
    usable = (seen.sum(1) >= 3) & np.isfinite(size) & (size > 0)
    if not usable.any():
        return float("inf")
    return float(np.median(length[usable].sum(1) / seen[usable].sum(1) / size[usable]))
