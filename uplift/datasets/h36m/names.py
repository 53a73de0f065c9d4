"""What Human3.6M calls its subjects, actions and joints, and what the files made of it call them."""

from __future__ import annotations

from uplift.errors import UserError, did_you_mean

__all__ = ["ACTIONS", "HOURGLASS_JOINTS", "JOINTS", "LAYOUTS", "OF_32", "SUBJECTS", "is_corrupt", "sequence_name"]

SUBJECTS = {"train": ("S1", "S5", "S6", "S7", "S8"), "test": ("S9", "S11")}

ACTIONS = (
    "Directions", "Discussion", "Eating", "Greeting", "Phoning", "Photo", "Posing", "Purchases", "Sitting",
    "SittingDown", "Smoking", "Waiting", "WalkDog", "Walking", "WalkTogether",
)  # fmt: skip
"""In the order of the papers' tables."""

_OTHER_NAMES = {"TakingPhoto": "Photo", "WalkingDog": "WalkDog"}

JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "spine", "thorax", "nose", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip
"""Those of the skeleton h36m17."""

OF_32 = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
"""Which of the 32 joints of the motion capture these are: the others do not move, or are there twice."""

HOURGLASS_JOINTS = (
    "rankle", "rknee", "rhip", "lhip", "lknee", "lankle", "hip", "spine", "thorax", "headtop",
    "rwrist", "relbow", "rshoulder", "lshoulder", "lelbow", "lwrist",
)  # fmt: skip


def _places(joints: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    return {joint: (joints.index(joint),) for joint in JOINTS if joint in joints}


LAYOUTS: dict[str, dict[str, tuple[int, ...]]] = {
    "h36m": _places(JOINTS),
    "hourglass": _places(HOURGLASS_JOINTS),
    # Trained on MPII: there place 7 is the thorax and 8 the neck, and nothing marks the spine.
    "hourglass_mpii": {**_places(HOURGLASS_JOINTS), "thorax": (7,), "spine": (6, 7)},
    "coco": {
        "hip": (11, 12), "rhip": (12,), "rknee": (14,), "rankle": (16,), "lhip": (11,), "lknee": (13,),
        "lankle": (15,), "spine": (5, 6, 11, 12), "thorax": (5, 6), "nose": (0,), "lshoulder": (5,),
        "lelbow": (7,), "lwrist": (9,), "rshoulder": (6,), "relbow": (8,), "rwrist": (10,),
    },
}  # fmt: skip
"""Layouts of 2D keypoints: our joint to the places it is the mean of. The hourglass network has no nose."""


def sequence_name(name: str, where: str) -> tuple[str, str] | None:
    """Return action and sequence of a name such as ``WalkingDog 1`` or ``Photo_2``; None for ``_ALL``.

    Raises:
        UserError: no action of the set.
    """
    if name.startswith("_"):
        return None
    word, _, number = name.replace("_", " ").strip().partition(" ")
    action = _OTHER_NAMES.get(word, word)
    if action not in ACTIONS or (number and not number.isdigit()):
        raise UserError(f"{where}: '{name}' is no action of Human3.6M.{did_you_mean(word, (*ACTIONS, *_OTHER_NAMES))}")
    return action, f"{action} {number}".strip()


def is_corrupt(subject: str, sequence: str, camera: str) -> bool:
    """Return whether it is the one video that cannot be played."""
    return (subject, sequence, camera) == ("S11", "Directions", "54138969")
