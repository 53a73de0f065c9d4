"""Errors that a user can fix, and what their messages share: the nearest name, and lists of names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["MissingFiles", "NotForThisSkeleton", "UserError", "did_you_mean", "listed", "nearest"]


class UserError(Exception):
    """A mistake in what the user gave: a file, a setting, a name.

    The message says what was found, what was expected, where, and what to do. The command line
    prints it without a traceback and exits with status 2.
    """


class MissingFiles(UserError):
    """Files of a published data set that are not there; lines below the first say how to get them."""


class NotForThisSkeleton(UserError):
    """A prior cannot judge this skeleton; with ``if_possible`` it is then left out."""


def listed(names: Iterable[object], most: int = 10) -> str:
    """Return names with commas, the first ``most`` of many: ``"nose, neck and 106 more"``."""
    texts = [str(name) for name in names]
    more = f" and {len(texts) - most:,} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


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
