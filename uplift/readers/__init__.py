"""One keypoint file format per file; `read` picks the one that fits."""

from __future__ import annotations

from pathlib import Path

from uplift.data.container import PoseData
from uplift.errors import UserError

__all__ = ["read"]


def read(path: str | Path) -> PoseData:
    """Read a keypoint file into a `PoseData`; the ending says which format it is.

    Raises:
        UserError: no such file, an unknown ending, or a file that is not what its ending says.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise UserError(f"{path}: unknown format '{path.suffix}'. Readable: .npz (docs/your-data.md).")
    from uplift.readers.npz import read_npz

    return read_npz(path)
