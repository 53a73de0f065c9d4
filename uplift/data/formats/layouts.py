"""Names of keypoints by their number, for files of trackers that write none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton.propose import TOO_LONG

__all__ = [
    "ALPHAPOSE", "COCO", "COCO_JOINTS", "H36M_JOINTS", "HAND21", "HANDS", "HOURGLASS_JOINTS", "KINETICS", "MMPOSE",
    "MPII16", "OPENPOSE", "OPENPOSE_FACE70", "POSE33", "WHOLEBODY133", "Layouts", "is_nameless", "likely_layout", "names_for",
    "pairs_by_name", "swapped_names", "with_layout",
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
POSE33 = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
"""MediaPipe's landmarks of a body, in its order."""
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
OPENPOSE25B = (
    "Nose", "LEye", "REye", "LEar", "REar", "LShoulder", "RShoulder", "LElbow", "RElbow", "LWrist", "RWrist", "LHip",
    "RHip", "LKnee", "RKnee", "LAnkle", "RAnkle", "UpperNeck", "HeadTop", "LBigToe", "LSmallToe", "LHeel", "RBigToe",
    "RSmallToe", "RHeel",
)  # fmt: skip
BODY135 = (*OPENPOSE25B, *HANDS["left"][1:], *HANDS["right"][1:], *OPENPOSE_FACE70)
"""OpenPose's joint model of body, hands without their roots, and face."""
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
    **COCO,
    25: ("OpenPose's BODY_25", OPENPOSE25),
    135: ("OpenPose's BODY_135", BODY135),
    136: ("Halpe", HALPE136),
    18: ("OpenPose's COCO model", OPENPOSE18),
    15: ("OpenPose's MPI model", OPENPOSE15),
}
KINETICS: Layouts = {**COCO, 18: ("OpenPose's COCO model", OPENPOSE18)}


SHIPPED: dict[int, tuple[tuple[str, str], ...]] = {
    16: (("MPII", "mpii16"),),
    17: (("COCO", "coco17"), ("Human3.6M", "h36m17"), ("AP-10K", "ap10k17"), ("MPI-INF-3DHP", "mpi_inf_3dhp17")),
    21: (("a hand", "hand21"), ("InterHand2.6M", "interhand21")),
    25: (("OpenPose's BODY_25", "openpose25"), ("OpenPose's BODY_25B", "openpose25b")),
    26: (("Halpe", "halpe26"), ("Animal3D", "animal3d26")),
    33: (("MediaPipe's pose", "mediapipe33"),),
    68: (("300-W faces", "face68"),),
    133: (("COCO-WholeBody", "coco_wholebody133"),),
}
"""Number of keypoints -> the layouts that have so many, the usual one first, and their shipped skeletons."""
_OTHERS: dict[int, tuple[str, tuple[str, ...], str]] = {
    15: ("OpenPose's MPI model", OPENPOSE15, "mpii16"),
    16: ("the stacked hourglass", HOURGLASS_JOINTS, "h36m17"),
    18: ("OpenPose's COCO model", OPENPOSE18, "coco17"),
    68: ("Halpe without a face", HALPE68, "halpe26"),
    135: ("OpenPose's BODY_135", BODY135, "openpose25b"),
    136: ("Halpe", HALPE136, "halpe26"),
}
"""Number of keypoints -> a layout without a shipped skeleton of its own, its names, and one whose bones it has."""


def names_for(
    path: Path,
    count: int,
    layouts: Layouts,
    options: ReadOptions,
    points: np.ndarray | None = None,
    name: str = "keypoint",
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of ``count`` keypoints that a file does not name, and the notes that say so.

    They are those of the tracker's usual layout (``layouts``) or of another with as many keypoints. With
    ``points`` (rows count 2, or 3 with a score) that is the one whose bones fit; one that is not
    the tracker's is taken only where they do. Without any, ``name`` and a number.

    Raises:
        UserError: the layout that the user names does not have that many.
    """
    if options.layout is not None:
        return _names_of_layout(path, count, options.layout), ()
    known = _known(count, layouts)
    if not known:
        return _numbered(name, count, f"no known layout has {count}")
    usual = count in layouts
    fits = _fits_of(points, known) if points is not None and (usual or _mostly_seen(points)) else []
    taken = _taken(fits, usual=usual)
    if taken is None:
        return _numbered(name, count, f"the bones of no known layout with {count} clearly fit ({_listed(known)})")
    text = f"keypoints have no names in the file: {count} of them are taken as {known[taken].what}"
    return known[taken].names, (text + _doubts(taken, known, fits),)


def _numbered(name: str, count: int, why: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    note = (
        f"keypoints have no names in the file, and {why}: named {name}_0 to {name}_{count - 1}; say layout=SKELETON, "
        "or use a skeleton with these names"
    )
    return tuple(f"{name}_{number}" for number in range(count)), (note,)


@dataclass(frozen=True)
class _Layout:
    """A layout that unnamed keypoints may be in."""

    what: str
    names: tuple[str, ...]
    skeleton: str
    """Shipped, with bones between some of these joints."""
    own: bool
    """The skeleton's joints are these, so that ``layout=`` may name it."""


def _known(count: int, layouts: Layouts) -> list[_Layout]:
    """Return all layouts of ``count`` keypoints, the tracker's usual first."""
    found = [_Layout(what, _names_of(skeleton), skeleton, True) for what, skeleton in SHIPPED.get(count, ())]
    if count in _OTHERS:
        found.append(_Layout(*_OTHERS[count], False))
    usual = layouts.get(count)
    if usual is None:
        return found
    first = [replace(one, what=usual[0]) for one in found if one.names == usual[1]]
    return [*(first or [_Layout(*usual, "", False)]), *(one for one in found if one.names != usual[1])]


def _listed(known: Sequence[_Layout]) -> str:
    return ", ".join(one.what for one in known)


# How well the bones of layouts fit unnamed keypoints.

_AS_SHORT = 1.15
"""Bones of two layouts that differ by less fit equally well."""
_ENOUGH = 0.75
_SURELY = 1.5
"""Rings and chains of points that are no bodies come near `TOO_LONG` in some layout or other."""


@dataclass(frozen=True)
class _Fit:
    """How long the bones of a layout are; infinite where none can be seen."""

    share: float
    """Of the body's size."""
    stretch: float
    """Of the shortest lines that join the joints; 0 where that is not known."""

    @property
    def good(self) -> bool:
        """Whether the joints can have these names."""
        return bool(np.isfinite(self.share)) and self.stretch < TOO_LONG


def _fits_of(points: np.ndarray, known: Sequence[_Layout]) -> list[_Fit]:
    points = points[:: max(1, len(points) // _MOST_ROWS)]
    return [_fit(points[..., :2].astype(np.float32), _scores(points), one) for one in known]


def _scores(points: np.ndarray) -> np.ndarray:
    """Return (rows, keypoints) scores, 0 for keypoints that are missing, 1 where there are none."""
    seen = np.isfinite(points).all(-1) & (points[..., :2] != 0).any(-1)
    return np.where(seen, points[..., 2] if points.shape[-1] > 2 else 1, 0).astype(np.float32)


def _mostly_seen(points: np.ndarray) -> bool:
    """Return whether most rows show enough of their keypoints for bones alone to tell the layout."""
    shown = (_scores(points) > 0).mean(1) if len(points) else np.zeros(1)
    return bool(np.median(shown) >= _ENOUGH)


def _fit(keypoints: np.ndarray, confidence: np.ndarray, layout: _Layout) -> _Fit:
    from uplift.skeleton import load_skeleton
    from uplift.skeleton.match import build_joints
    from uplift.skeleton.propose import stretch_of

    if not layout.skeleton:
        return _Fit(float("inf"), 0)
    share = _bone_share(keypoints, confidence, layout.skeleton, layout.names)
    skeleton = load_skeleton(layout.skeleton)
    points, found, _ = build_joints(keypoints, confidence, layout.names, skeleton)
    return _Fit(share, stretch_of(points, found, skeleton))


def _taken(fits: Sequence[_Fit], *, usual: bool) -> int | None:
    """Return which layout is taken: the first unless another's bones are clearly shorter; None for none that surely fits.

    The tracker's ``usual`` one is taken even where its bones are too long, or cannot be seen; where the tracker
    has none, nothing but the bones speaks for a layout.
    """
    if not fits:
        return 0 if usual else None
    best = min(range(len(fits)), key=lambda place: fits[place].share)
    best = best if fits[best].share < _CLEARLY * fits[0].share else 0
    return best if usual or (fits[best].good and fits[best].stretch < _SURELY) else None


def _doubts(taken: int, known: Sequence[_Layout], fits: Sequence[_Fit]) -> str:
    """Return what a note on the layout adds: how to name another, and whether others fit as well, or none does."""
    if taken and fits[taken].good:
        overrules = known[0].skeleton if known[0].own else "SKELETON"
        return f", not as {known[0].what}, whose bones would be far too long (layout={overrules} overrules)"
    another = "; layout=SKELETON names another"
    if not fits or not np.isfinite(fits[taken].share):
        return another
    alike = [
        f"{one.what} (layout={one.skeleton})" if one.own else one.what
        for place, (one, fit) in enumerate(zip(known, fits, strict=True))
        if place != taken and fit.good and fit.share < _AS_SHORT * fits[taken].share
    ]
    fitting = f"the bones of {' and of '.join(alike)} fit"
    if not fits[taken].good:
        count = len(known[taken].names)
        return (
            f". WARNING: its bones are {fits[taken].stretch:.1f} times as long as the shortest lines that join the "
            f"joints; {fitting if alike else f'no known layout with {count} fits ({_listed(known)})'}: layout=SKELETON "
            "names the right one"
        )
    return f"; {fitting} as well: layout= says which it is" if alike else another


# Names by number, and pairs of them.

_NUMBERED = re.compile(r"(?:(?:keypoint|kpt|kp|joint|landmark|point|marker|part|node|p|j)[_ ]?)?\d+", re.IGNORECASE)


def is_nameless(names: Sequence[str]) -> bool:
    """Return whether the names are numbers and no more."""
    return all(_NUMBERED.fullmatch(name) for name in names)


def with_layout(data: PoseData, options: ReadOptions) -> PoseData:
    """Return keypoints that are only numbered by the names of ``layout=``; a note where it has no effect on a file.

    Raises:
        UserError: no such skeleton, or one of another number of joints.
    """
    if options.layout is None:
        return data
    names = data.joint_names
    if any(names[: len(given)] == given for given in _joints_of(options.layout)):
        return data
    if not is_nameless(names):
        shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        note = f"layout={options.layout} has no effect: the file names its joints ({shown})"
        return replace(data, notes=(*data.notes, note))
    given = _names_of_layout(Path(data.source), len(names), options.layout)
    new = dict(zip(names, given, strict=True))
    pairs = {kind: tuple((new[a], new[b]) for a, b in getattr(data, kind)) for kind in ("bones", "mirror")}
    return replace(data, joint_names=given, **pairs)


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


def _names_of(skeleton: str) -> tuple[str, ...]:
    from uplift.skeleton import load_skeleton

    shipped = load_skeleton(skeleton)
    return tuple(joint for joint in shipped.joints if joint not in shipped.midpoints)


def _joints_of(layout: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints of a skeleton, all and without midpoints."""
    from uplift.skeleton import load_skeleton

    return load_skeleton(layout).joints, _names_of(layout)


def _names_of_layout(path: Path, count: int, layout: str) -> tuple[str, ...]:
    found = _joints_of(layout)
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
