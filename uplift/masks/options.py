"""What a user says of masks: how they are read, and which are taken."""

from __future__ import annotations

from dataclasses import dataclass

from uplift.config import MAX_SIDE, MIN_SIDE
from uplift.errors import UserError, did_you_mean

__all__ = ["CleanOptions", "MaskOptions"]


@dataclass(frozen=True)
class CleanOptions:
    """How masks are cut out, and which are refused."""

    side: int = 64
    """Pixels along a crop."""
    border: str = "skip"
    """Objects that touch the border of the image: skip or keep."""
    pieces: str = "skip"
    """Objects in several pieces of similar size: skip, or take the largest."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if isinstance(self.side, bool) or not isinstance(self.side, int) or not MIN_SIDE <= self.side <= MAX_SIDE:
            raise UserError(f"side={self.side}: expected a whole number of pixels from {MIN_SIDE} to {MAX_SIDE}.")
        for name, valid in (("border", ("skip", "keep")), ("pieces", ("skip", "largest"))):
            value = getattr(self, name)
            if value not in valid:
                raise UserError(f"{name}={value}: expected {' or '.join(valid)}.{did_you_mean(value, valid)}")


@dataclass(frozen=True)
class MaskOptions(CleanOptions):
    """What a user says of a file of masks."""

    format: str | None = None
    """Name of the format; unset: guessed."""
    category: tuple[str, ...] = ()
    """Which categories are taken; none named: all."""
    most: int | None = None
    """How many masks are taken at most, spread over the file."""
    images: str | None = None
    """Folder of the photos that the masks belong to."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        super().__post_init__()
        if self.most is not None and (isinstance(self.most, bool) or not isinstance(self.most, int) or self.most < 1):
            raise UserError(f"most={self.most}: expected a whole number of masks from 1 up.")
