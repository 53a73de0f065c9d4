"""A bone of an Acclaim skeleton and how it turns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from uplift.mocap.figure import turns

__all__ = ["Bone"]


@dataclass
class Bone:
    """A bone of an ASF file, angles in degrees, lengths in the file's unit."""

    name: str = ""
    line: int = 0
    direction: list[float] = field(default_factory=list)
    length: float = float("nan")
    axis: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    order: str = "xyz"
    dof: list[str] = field(default_factory=list)

    @property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """The bone's own axes in the rest pose."""
        return _turned_in(np.array([self.axis]), self.order)[0]

    def turned(self, degrees: Float[np.ndarray, "frames angles"]) -> Float[np.ndarray, "frames 3 3"]:
        """Return the rotations of the bone in its parent's frame for angles in the order of `dof`."""
        full = np.zeros((len(degrees), 3))
        for column, name in enumerate(self.dof):
            full[:, self.order.index(name[1])] = degrees[:, column]
        return self.frame @ _turned_in(full, self.order) @ self.frame.T


def _turned_in(degrees: np.ndarray, order: str) -> np.ndarray:
    # "XYZ" is first about X, then about the world's Y, then its Z: about the turned axes that is Z, Y, X.
    return turns(degrees[:, ::-1], order[::-1])
