"""DeepLabCut and Lightning Pose: tables in csv or HDF5, of one or several individuals."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek
from uplift.data.formats.csv import write_table
from uplift.data.formats.rows import by_appearance, frame_numbers, rows_of
from uplift.data.parsers.files import check_claim, check_memory, damage_as_error
from uplift.data.parsers.hdf5 import h5py_missing
from uplift.data.parsers.pickles import Source, Unpickler
from uplift.data.parsers.table import Table, first_lines, first_rows, header_of
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean, listed

__all__ = ["FORMAT", "write_deeplabcut_csv"]

# What DeepLabCut's columns mean: a scorer, an individual, a body part and a coordinate each.

_LEVELS = (("scorer", "bodyparts", "coords"), ("scorer", "individuals", "bodyparts", "coords"))
_LOCATION = {"x": 0, "y": 1, "likelihood": 2}
_VIDEO = re.compile(r"(.+?)(DLC_|DeepCut_).*")


@dataclass(frozen=True)
class _Layout:
    """Where the numbers of each body part are."""

    bodyparts: tuple[str, ...]
    individuals: tuple[str, ...]
    columns: np.ndarray
    """The columns that hold them, in order."""
    places: np.ndarray
    """(individuals bodyparts 3) place in ``columns`` of x, y and likelihood; -1 without any."""
    notes: tuple[str, ...]


def _layout_of(path: Path, columns: Sequence[tuple[str, ...]]) -> _Layout:
    """Return what ``columns``, a tuple of `_LEVELS` each, hold.

    Raises:
        UserError: several scorers, 3D, a coordinate twice, or x without y.
    """
    others = tuple(dict.fromkeys(c[-1] or c[0] for c in columns if c[-1] not in _LOCATION))
    columns = [column if len(column) == 4 else (column[0], "", *column[1:]) for column in columns]
    known = [column for column in columns if column[3] in _LOCATION]
    if any(column[3] == "z" for column in columns):
        raise UserError(f"{path} has x, y and z: 3D poses, which cannot be lifted; expected 2D keypoints.")
    if not known:
        near = did_you_mean(others[0], _LOCATION) if others else ""
        raise UserError(f"{path}: no coords x and y in it (found {listed(others) or 'nothing'}).{near}")
    scorers = tuple(dict.fromkeys(column[0] for column in known))
    if len(scorers) > 1:
        raise UserError(f"{path}: columns of {len(scorers)} scorers ({listed(scorers)}), expected one.")
    individuals = tuple(dict.fromkeys(column[1] for column in known))
    bodyparts = tuple(dict.fromkeys(column[2] for column in known))
    if not all(bodyparts):
        raise UserError(f"{path}: a column without the name of a body part.")
    places = np.full((len(individuals), len(bodyparts), 3), -1)
    for place, (_, individual, bodypart, coord) in enumerate(columns):
        if coord in _LOCATION:
            at = individuals.index(individual), bodyparts.index(bodypart), _LOCATION[coord]
            if places[at] >= 0:
                raise UserError(f"{path}: '{bodypart}' has '{coord}' twice; body parts must differ.")
            places[at] = place
    half = (places[..., :2] >= 0).sum(-1) == 1
    if half.any():
        raise UserError(f"{path}: '{bodyparts[int(np.argwhere(half)[0, 1])]}' has x or y and not the other.")
    notes = (f"left out: {listed(others)}",) if others else ()
    used = np.unique(places[places >= 0])
    places = np.where(places >= 0, np.searchsorted(used, places), -1)
    return _Layout(bodyparts, individuals, used, places, notes)


def _pose_data(
    path: Path, layout: _Layout, numbers: np.ndarray, index: np.ndarray, lines: np.ndarray | None = None
) -> PoseData:
    """Return the rows of a table: the numbers of `Layout.columns`, and (rows,) frame numbers or names of images.

    Raises:
        UserError: no frame numbers, one twice, or numbers that are not keypoints.
    """
    values = numbers[:, layout.places]
    values[:, layout.places < 0] = np.nan
    scores = values[..., 2] if (layout.places[..., 2] >= 0).any() else None
    if scores is not None and np.isnan(scores).all():  # a column that labels by hand have and do not fill
        scores = None
    if index.dtype.kind == "U":
        identity = {"image": index}
    else:
        video = _VIDEO.fullmatch(path.stem)
        frame = frame_numbers(path, index, lines, once=True)
        identity = {"sequence": np.full(len(frame), video[1] if video else path.stem), "frame": frame}
    bodies = layout.individuals if layout.individuals != ("",) else ()
    return rows_of(
        path, np.ascontiguousarray(values[..., :2]), scores, layout.bodyparts, identity, bodies, notes=layout.notes
    )


# Read the csv files of DeepLabCut and Lightning Pose: three or four header rows, then a row per frame or image.


def _read_deeplabcut_csv(peek: Peek) -> PoseData:
    """Read predictions (frames of a video) or labels (images) of one or several individuals.

    Raises:
        UserError: another header, rows of different lengths, text where numbers must be, 3D.
    """
    path, levels = peek.path, _csv_levels(peek)
    if levels is None:
        raise UserError(
            f"{path} begins {peek.text[:60]!r}, expected the header rows of DeepLabCut: {', '.join(_LEVELS[0])} "
            f"({', '.join(_LEVELS[1])} for several individuals)."
        )
    rows = len(levels)
    header, _ = header_of(path, rows)
    numbered = int(header[0][0] != levels[0])  # pandas wrote its own numbers of the rows before the file's
    header = [row[numbered:] for row in header]
    indices = next((at for at in range(1, len(header[0])) if any(row[at] for row in header)), len(header[0]))
    names = [_unnumbered(header[0]), *header[1:]]
    layout = _layout_of(path, list(zip(*(row[indices:] for row in names), strict=True)))
    below = first_rows(path, rows + 1)[0][-1][numbered:] or [""]
    if not any(below[indices:]):  # the name of the index, or an image without labels: no keypoints either way
        rows += 1
        below = first_rows(path, rows + 1)[0][-1][numbered:] or [""]
    by_image = indices > 1 or not below[0].replace(".", "", 1).isdecimal()
    places = range(numbered, numbered + indices)
    table = Table.read(
        path,
        rows,
        (layout.columns + numbered + indices).tolist(),
        exact=() if by_image else (numbered,),
        words=places if by_image else (),
    )
    index = _images(table, places) if by_image else table.exact[numbered]
    layout = replace(layout, notes=(*layout.notes, *table.notes))
    return _pose_data(path, layout, table.numbers, index, table.lines)


def _unnumbered(cells: Sequence[str]) -> list[str]:
    """Return names without the numbers that pandas gives to those it has read before: S, S.1, S.2 are S, S, S."""
    times: Counter[str] = Counter()
    names = []
    for cell in cells:
        name, dot, number = cell.rpartition(".")
        again = dot and number.isdecimal() and times[name] == int(number) > 0
        names.append(name if again else cell)
        times[names[-1]] += 1
    return names


_NUMBERED = re.compile(r"(Unnamed: 0)?[,;\t]")
"""What begins the header where pandas wrote its own numbers of the rows before the file's."""


def _csv_levels(peek: Peek) -> tuple[str, ...] | None:
    """Return the rows of the header; None where it is not one of DeepLabCut."""
    start = peek.text.lstrip('\r\n "')
    numbered = _NUMBERED.match(start)
    if not start[numbered.end() if numbered else 0 :].lstrip('" ').startswith(_LEVELS[0][0]):
        return None
    place = 1 if numbered else 0
    for levels in _LEVELS:
        try:
            lines = first_lines(peek.path, len(levels))
        except (UserError, OSError):
            return None
        cells = [re.split("[,;\t]", line, maxsplit=place + 1) for line in lines]
        if all(len(row) > place for row in cells) and tuple(row[place].strip(' "') for row in cells) == levels:
            return levels
    return None


def _images(table: Table, columns: Sequence[int]) -> np.ndarray:
    """Return (rows,) paths of images, whose folders may stand in separate columns."""
    values = [table.words[place].values().tolist() for place in columns]
    paths = ["/".join(part for part in parts if part).replace("\\", "/") for parts in zip(*values, strict=True)]
    if not all(paths):
        raise UserError(f"{table.path}, line {table.lines[paths.index('')]}: no name of an image.")
    return np.array(paths, np.str_)


# Read the HDF5 files of DeepLabCut: a table that pandas wrote, of frames or images by body parts.

# pandas reads these files through PyTables, which unpickles each attribute of each node that looks like a
# pickle, and each object array: a file could run what it likes. h5py unpickles nothing. The few attributes
# that are pickles, lists of names, go through the unpickler that runs nothing; arrays of objects are refused.
_KEYS = ("df_with_missing", "tracks")
_MOST_PACKED = 1100  # zlib makes data a thousandth at best


def _read_deeplabcut_h5(path: Path) -> PoseData:
    """Read predictions (frames of a video) or labels (images) of one or several individuals.

    Raises:
        UserError: no table of pandas, several, one with pickled objects, or damaged.
    """
    try:
        import h5py
    except ImportError:
        raise h5py_missing(path) from None
    with damage_as_error(path, "a table of pandas"), h5py.File(path, "r") as file:
        group: Any = file[_key(path, _tables(file))]
        columns, numbers, index = _appendable(path, group) if "table" in group else _fixed(path, group)
    if not columns or len({len(column) for column in columns}) != 1 or len(columns[0]) not in (3, 4):
        raise UserError(
            f"{path}: columns of {len(columns[0]) if columns else 0} levels, expected {', '.join(_LEVELS[0])}, "
            "with individuals for several."
        )
    layout = _layout_of(path, columns)
    with np.errstate(over="ignore", invalid="ignore"):
        used = np.ascontiguousarray(numbers[:, layout.columns], np.float32)
    return _pose_data(path, layout, used, index)


def _tables(file: Any) -> list[str]:
    """Return the groups at the root that hold a DataFrame."""
    import h5py

    found = []
    for name in file:
        if isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group):
            kind = file[name].attrs.get("pandas_type", b"")
            if _as_text(kind) in ("frame_table", "frame"):
                found.append(name)
    return found


def _key(path: Path, keys: list[str]) -> str:
    chosen = [key for key in _KEYS if key in keys] or keys
    if not chosen:
        raise UserError(f"{path}: no table of pandas in it, expected one such as 'df_with_missing'.")
    if len(chosen) > 1:
        raise UserError(f"{path}: {len(chosen)} tables ({listed(chosen)}), expected one.")
    return chosen[0]


def _appendable(path: Path, group: Any) -> tuple[list[tuple[str, ...]], np.ndarray, np.ndarray]:
    """Return columns, (rows, columns) numbers and the index of pandas' format "table"."""
    table = _array(path, group, "table", records=True)
    axes = _unpickled(path, group, "non_index_axes")
    columns = [_names(path, column) for column in axes[0][1]]
    place = {column: at for at, column in enumerate(columns)}
    rows = table[()]
    numbers = _empty(path, len(rows), len(columns))
    for field in rows.dtype.names:
        if field.startswith("values_block_"):
            _check_numbers(path, rows[field].dtype)
            kinds = [_names(path, column) for column in _unpickled(path, table, f"{field}_kind")]
            numbers[:, [place[kind] for kind in kinds]] = rows[field].reshape(len(rows), len(kinds))
    return columns, numbers, _index(path, rows["index"], _as_text(group.attrs.get("encoding", b"utf-8")))


def _fixed(path: Path, group: Any) -> tuple[list[tuple[str, ...]], np.ndarray, np.ndarray]:
    """Return columns, (rows, columns) numbers and the index of pandas' format "fixed"."""
    encoding = _as_text(group.attrs.get("encoding", b"utf-8"))
    columns = list(zip(*_h5_levels(path, group, "axis0", encoding), strict=True))
    place = {column: at for at, column in enumerate(columns)}
    if _as_text(group.attrs.get("axis1_variety", b"regular")) == "multi":
        parts = _h5_levels(path, group, "axis1", encoding)
        index = np.array(["/".join(part for part in parts if part) for parts in zip(*parts, strict=True)], np.str_)
    else:
        index = _index(path, _array(path, group, "axis1")[()], encoding)
    numbers = _empty(path, len(index), len(columns))
    for block in range(int(group.attrs["nblocks"])):
        items = list(zip(*_h5_levels(path, group, f"block{block}_items", encoding), strict=True))
        values = _array(path, group, f"block{block}_values")
        _check_numbers(path, values.dtype)
        values = values[()] if values.attrs.get("transposed", 0) else values[()].T
        numbers[:, [place[item] for item in items]] = values.reshape(len(index), len(items))
    return columns, numbers, index


def _empty(path: Path, rows: int, columns: int) -> np.ndarray:
    """Return (rows, columns) NaN; raises UserError for very much more than the file has bytes."""
    check_memory(path, f"a table of {rows:,} rows and {columns:,} columns", rows * columns * 8, path.stat().st_size)
    return np.full((rows, columns), np.nan)


def _h5_levels(path: Path, group: Any, name: str, encoding: str) -> list[list[str]]:
    """Return the text of each level of a MultiIndex, one entry per column or row."""
    if _as_text(group.attrs.get(f"{name}_variety", b"")) != "multi":
        raise UserError(f"{path}: columns of one level, expected {', '.join(_LEVELS[0])}.")
    found = []
    for level in range(int(group.attrs[f"{name}_nlevels"])):
        texts = _index(path, _array(path, group, f"{name}_level{level}")[()], encoding).astype(np.str_).tolist()
        codes = _array(path, group, f"{name}_label{level}")[()].tolist()
        found.append([texts[code] if code >= 0 else "" for code in codes])
        if len(found[0]) != len(found[-1]):
            raise ValueError(f"levels of {len(found[0])} and {len(found[-1])} entries")
    return found


def _index(path: Path, values: np.ndarray, encoding: str) -> np.ndarray:
    """Return numbers as they are and bytes as text with ``/`` between folders."""
    if values.ndim != 1:
        raise ValueError(f"an index of shape {values.shape}")
    if values.dtype.kind == "S":
        texts = [text.decode(encoding, errors="replace").replace("\\", "/") for text in values.tolist()]
        return np.array(texts, np.str_)
    _check_numbers(path, values.dtype)
    return values.astype(np.float64)


def _array(path: Path, group: Any, name: str, *, records: bool = False) -> Any:
    """Return a dataset that is in the file itself, of numbers or text and no larger than the file can hold."""
    import h5py

    item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual:
        raise UserError(f"{path}: '{name}' is not an array in the file itself.")
    if item.dtype.hasobject:
        raise UserError(
            f"{path}: '{name}' holds pickled Python objects, which could run code and are never opened. "
            "Save numbers: DataFrame.astype(float).to_hdf(...), or DataFrame.to_csv(...)."
        )
    if (item.dtype.names is not None) != records or item.dtype.itemsize > 1 << 24:
        raise ValueError(f"'{name}' holds {str(item.dtype)[:60]}")
    claimed = check_claim(f"{path}: '{name}'", item.shape, item.dtype)
    if claimed > path.stat().st_size * _MOST_PACKED:
        raise UserError(f"{path}: '{name}' claims {claimed / 1e9:.3g} GB, more than the file can hold.")
    check_memory(path, f"'{name}'", claimed, path.stat().st_size)
    return item


def _check_numbers(path: Path, dtype: np.dtype) -> None:
    if dtype.base.kind not in "fiu":
        raise UserError(f"{path}: a column of {dtype.base}, expected numbers.")


def _unpickled(path: Path, item: Any, name: str) -> Any:
    """Return a list that pandas keeps as a pickle in an attribute."""
    raw = item.attrs[name]
    raw = raw.tobytes() if isinstance(raw, np.ndarray) else bytes(raw)
    return Unpickler(Source(io.BytesIO(raw), len(raw)), f"{path}, '{name}'").load()


def _names(path: Path, column: Any) -> tuple[str, ...]:
    if not isinstance(column, tuple):
        raise UserError(f"{path}: columns of one level, expected {', '.join(_LEVELS[0])}.")
    return tuple(str(part) for part in column)


def _as_text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


# Which of the two a file is.


def _fits(peek: Peek) -> bool:
    if not peek.is_hdf5:
        return _csv_levels(peek) is not None
    with suppress(Exception):  # whatever h5py raises: then it is of another format
        import h5py

        with h5py.File(peek.path, "r") as file:
            return bool(_tables(file))
    return False


FORMAT = FileFormat(
    "deeplabcut",
    "DeepLabCut or Lightning Pose (csv, h5)",
    _fits,
    lambda peek, _: _read_deeplabcut_h5(peek.path) if peek.is_hdf5 else _read_deeplabcut_csv(peek),
)


# Write the 2D of a `PoseData` in DeepLabCut's csv layout: one video, or labelled images.


def write_deeplabcut_csv(data: PoseData, path: str | Path, *, csv_safe: bool = False) -> None:
    """Write scorer, individuals (where there are any), bodyparts and coords x, y, likelihood.

    The index is the frame, or the image where rows are images. The layout holds nothing else: no
    rate, no subject, no action; the video's name is that of the file. ``csv_safe`` is as in `write_table`.

    Raises:
        UserError: more than one video, or one individual twice in a frame.
    """
    index, order = _csv_index(data, path)
    who, bodies = np.zeros(len(data), np.int64), [""]
    if "instance" in data.identity:
        who, first = by_appearance([data.identity["instance"]], len(data))
        bodies = data.identity["instance"][first].astype(np.str_).tolist()
    place = index * len(bodies) + who
    again = np.bincount(place, minlength=1)[place] > 1
    if again.any():
        row = int(np.argmax(again))
        raise UserError(f"cannot write {path}: '{bodies[who[row]]}' is in '{order[index[row]]}' twice.")
    numbers = np.full((len(order) * len(bodies), len(data.joint_names), 3), np.nan, np.float32)
    numbers[place, :, :2], numbers[place, :, 2] = data.keypoints, data.confidence
    columns = list(product(["uplift"], bodies, data.joint_names, _LOCATION))
    header = [[level, *cells] for level, cells in zip(_LEVELS[1], zip(*columns, strict=True), strict=True)]
    if "instance" not in data.identity:
        del header[1]
    write_table(path, header, [order], numbers.reshape(len(order), -1), csv_safe)


def _csv_index(data: PoseData, path: str | Path) -> tuple[np.ndarray, list]:
    """Return (rows,) places in the index, and the index: images as they come, frames going up."""
    identity, rows = data.identity, len(data)
    if "image" in identity:
        index, first = by_appearance([identity["image"]], rows)
        return index, identity["image"][first].tolist()
    clips = [identity[key] for key in ("subject", "sequence", "camera") if key in identity]
    _, first = by_appearance(clips, rows)
    if len(first) > 1:
        shown = ", ".join(sorted(" ".join(str(values[row]) for values in clips) for row in first)[:3])
        raise UserError(
            f"cannot write {path}: {len(first)} videos ({shown}, ...), and DeepLabCut's csv holds one. "
            "Write one file each, or a plain csv."
        )
    frames, index = np.unique(identity.get("frame", np.arange(rows)), return_inverse=True)
    return index, frames.tolist()
