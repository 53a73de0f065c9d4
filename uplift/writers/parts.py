"""What goes into which file, for formats that hold one clip or one body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.writers.clips import arrange

__all__ = ["parts_of", "paths_of"]

_MOST_FILES = 500


def parts_of(prediction: Prediction, holds: str) -> list[tuple[str, np.ndarray | None]]:
    """Return (name, rows) of each file: one with all rows (None), one a clip, or one a body of a clip.

    Raises:
        UserError: more files than anybody wants.
    """
    if holds == "all":
        return [("", None)]
    parts: list[tuple[str, np.ndarray | None]] = []
    for clip in arrange(prediction.identity, len(prediction)):
        if holds == "clip":
            parts.append((clip.name, np.sort(clip.rows)))
            continue
        for number, name in enumerate(clip.individual_names):
            told = f"{clip.name} {name}".strip()
            parts.append((told, np.sort(clip.rows[clip.individual == number])))
    if len(parts) > _MOST_FILES:
        raise UserError(
            f"the prediction has {len(parts):,} {'clips' if holds == 'clip' else 'bodies'}, and this format needs a file "
            f"for each; the most is {_MOST_FILES}. Give fewer files at a time, or write .npz, .json or .csv."
        )
    return parts


def paths_of(path: str | Path, names: Sequence[str]) -> list[Path]:
    """Return the path of each part: ``path`` itself for one, else its stem with each name behind it.

    Raises:
        UserError: one of several is there already.
    """
    path = Path(path)
    if len(names) == 1:
        return [path]
    used: set[str] = set()
    paths = []
    for name in names:
        slug = re.sub(r"[^\w.-]+", "-", name).strip("-.")[:80] or "part"
        number, told = 2, slug
        while told.lower() in used:  # not every file system tells capitals apart
            number, told = number + 1, f"{slug}_{number}"
        used.add(told.lower())
        paths.append(path.with_name(f"{path.stem}_{told}{path.suffix}"))
    for one in paths:
        if one.exists():
            raise UserError(f"{one} exists already and is not overwritten: remove it or choose another name.")
    return paths
