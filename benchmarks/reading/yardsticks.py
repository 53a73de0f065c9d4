"""How others read the same file; what they make of it is not yet keypoints."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

__all__ = ["YARDSTICKS"]


def _json(path: Path) -> object:
    return [json.loads(file.read_bytes()) for file in (path.iterdir() if path.is_dir() else [path])]


def _pandas(path: Path) -> object:
    import pandas as pd

    return pd.read_csv(
        path, header=[0, 1, 2] if "DLC_one" in path.name else [0, 1, 2, 3] if "DLC_two" in path.name else 0
    )


def _pandas_h5(path: Path) -> object:
    import pandas as pd

    return pd.read_hdf(path)


def _sleap_io(path: Path) -> object:
    from sleap_io.io.main import load_slp

    return load_slp(str(path), open_videos=False).numpy()


YARDSTICKS: dict[str, Callable[[Path], object]] = {
    "json": _json,
    "pandas": _pandas,
    "pandas h5": _pandas_h5,
    "sleap-io": _sleap_io,
}
"""Name -> reads a file whole."""
