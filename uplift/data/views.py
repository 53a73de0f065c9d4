"""Tables of views by the name of a mask: those that a fit finds and `uplift predict` writes, and those that one knows."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import as_bytes, replacing
from uplift.data.parsers.table import Table, header_of
from uplift.errors import UserError, did_you_mean

__all__ = ["KnownViews", "write_views"]

_ANGLES = ("azimuth_deg", "elevation_deg", "roll_deg")


@dataclass(frozen=True)
class KnownViews:
    """Where some of the masks of a data set are seen from."""

    rows: Int[np.ndarray, " known"]
    """Of the data set."""
    angles_deg: Float[np.ndarray, "known 3"]
    """Azimuth, elevation and roll; NaN where the table does not say."""

    @classmethod
    def read(cls, path: str | Path, names: Sequence[str], *, all_angles: bool) -> KnownViews:
        """Return the views of masks called ``names``; with ``all_angles`` all three must be there, else the azimuth.

        Raises:
            UserError: no such file, a column that lacks, a name that no mask has or that several have, an angle that
                is no number.
        """
        path, needed = Path(path), ("name", *(_ANGLES if all_angles else _ANGLES[:1]))
        if not path.is_file():
            raise UserError(f"shape.views={path}: no such file. A table (.csv) with columns {', '.join(needed)}.")
        columns = header_of(path, 1)[0][0]
        missing = [name for name in needed if name not in columns]
        if missing:
            why = ": without gravity a view is all three angles" if all_angles else ""
            raise UserError(f"{path} has no column {missing[0]}, expected {', '.join(needed)}{why}.")
        there = [name for name in _ANGLES if name in columns]
        places = [columns.index(name) for name in there]
        table = Table.read(path, 1, places, words=[columns.index("name")])
        angles = np.full((len(table), len(_ANGLES)), np.nan)
        angles[:, [_ANGLES.index(name) for name in there]] = table.numbers
        for number, name in enumerate(needed[1:]):
            wrong = ~np.isfinite(angles[:, number])
            if wrong.any():
                raise UserError(f"{path}, line {table.lines[wrong][0]}: {name} is missing, expected degrees.")
        return cls(_rows_of(table.words[columns.index("name")].values(), table, names), angles)


def _rows_of(wanted: np.ndarray, table: Table, names: Sequence[str]) -> Int[np.ndarray, " known"]:
    """Return the row of each name; raises UserError for one that no mask has, or several have."""
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(str(name).strip(), []).append(row)
    for name, line in zip(wanted.tolist(), table.lines.tolist(), strict=True):
        found = len(rows.get(name, ()))
        if not found:
            hint = did_you_mean(name, rows) if len(rows) <= 100_000 else ""
            raise UserError(f"{table.path}, line {line}: no training mask is called '{name}'.{hint}")
        if found > 1:
            raise UserError(f"{table.path}, line {line}: {found:,} training masks are called '{name}', expected one.")
    return np.array([rows[name][0] for name in wanted.tolist()], np.int64)


def write_views(path: str | Path, names: Sequence[str], columns: Mapping[str, Float[np.ndarray, " items"]]) -> None:
    """Write a table: a row for each mask, its name first; what is not finite is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["name", *columns])
    for name, *values in zip(names, *(np.asarray(one).tolist() for one in columns.values()), strict=True):
        writer.writerow([name, *(f"{value:.6g}" if np.isfinite(value) else "" for value in values)])
    with replacing(path) as file:
        file.write(as_bytes(text.getvalue()))
