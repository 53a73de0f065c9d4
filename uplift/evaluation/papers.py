"""The actions in the order and by the names that papers have in their tables."""

from __future__ import annotations

from collections.abc import Collection

__all__ = ["are_activities", "paper_order"]

_H36M_COLUMNS = {
    "Direct.": ("directions", "direction"),
    "Discuss": ("discussion", "discuss"),
    "Eating": ("eating",),
    "Greet": ("greeting", "greet"),
    "Phone": ("phoning", "phone"),
    "Photo": ("photo", "takingphoto"),
    "Pose": ("posing", "pose"),
    "Purch.": ("purchases", "purchase"),
    "Sitting": ("sitting",),
    "SittingD": ("sittingdown", "sittingd"),
    "Smoke": ("smoking", "smoke"),
    "Wait": ("waiting", "wait"),
    "WalkD": ("walkdog", "walkingdog", "walkd"),
    "Walk": ("walking", "walk"),
    "WalkT": ("walktogether", "walkingtogether", "walkt"),
}
_ACTIVITY_COLUMNS = {
    "Stand/Walk": ("standingwalking",),
    "Exercise": ("exercising",),
    "Sit": ("sitting",),
    "Reach/Crouch": ("reachingcrouching",),
    "Floor": ("onthefloor",),
    "Sports": ("sports",),
    "Misc": ("miscellaneous",),
}
"""Of MPI-INF-3DHP's test set, in its order."""
_PAPERS = (_H36M_COLUMNS, _ACTIVITY_COLUMNS)


def paper_order(actions: list[str]) -> dict[str, str] | None:
    """Return a paper's column -> our action, in its order; None where an action is in none of the papers."""
    plain = {"".join(letter for letter in action.casefold() if letter.isalpha()): action for action in actions}
    for columns in _PAPERS:
        found = {column: plain[name] for column, known in columns.items() for name in known if name in plain}
        if len(found) == len(actions) and len(plain) == len(actions):
            return found
    return None


def are_activities(columns: Collection[str]) -> bool:
    """Return whether the columns are those of MPI-INF-3DHP, which reports all frames beside the actions."""
    return set(columns) <= set(_ACTIVITY_COLUMNS)
