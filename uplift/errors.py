"""The one error that means "the user can mend this", and the nearest-name hint that goes into it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["NotForThisSkeleton", "UserError", "did_you_mean", "nearest"]


class UserError(Exception):
    """A mistake in what the user gave: a file, a setting, a name.

    The message says what was found, what was expected, where, and what to do. The command line
    prints it without a traceback and exits with status 2.
    """


class NotForThisSkeleton(UserError):
    """A prior cannot judge this skeleton; one that is on ``if_possible`` is then left out."""


def did_you_mean(found: str, valid: Iterable[str]) -> str:
    """Return a hint such as ``" Did you mean 'rknee'?"``, or the valid names where none is near."""
    names = [str(name) for name in valid]
    shown = ", ".join(names[:30]) + (", ..." if len(names) > 30 else "")
    return nearest(found, names) or (f" Valid: {shown}." if names else "")


def nearest(found: str, valid: Iterable[str]) -> str:
    """Return a hint such as ``" Did you mean 'rknee'?"``, or nothing: for messages that list the valid names."""
    by_folded = {str(name).casefold(): str(name) for name in valid}
    near = difflib.get_close_matches(str(found).casefold(), by_folded, n=1, cutoff=0.6)
    return f" Did you mean '{by_folded[near[0]]}'?" if near else ""
