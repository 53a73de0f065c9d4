"""What all pages share: one shell with its policy, tables, charts, packed arrays and photos; no network, no WebGL."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsFloat

import numpy as np

from uplift.config.files import as_bytes, inside, replacing, without_folders
from uplift.errors import UserError

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = [
    "Curve", "Photos", "Section", "Term", "curve_charts", "fill_page", "jpeg_address", "number_text", "pack", "read_html",
    "report_html", "scripted_page", "unpack", "write_text",
]  # fmt: skip


class Term(NamedTuple):
    """A cell of a table that says what it is: a plain text, and small below it the term of the field."""

    text: str
    term: str
    meaning: str = ""
    """A line for who points at it."""


Rows = Sequence[Sequence[object]]
Section = tuple[str, Rows] | tuple[str, Rows, Sequence[object]]
"""(title, rows) or (title, rows, header); without a header, a first row of three or more texts above rows that each
hold a number is taken for one."""
Curve = Sequence[tuple[SupportsFloat, SupportsFloat]]
"""(step, value) points."""

_ASSETS = Path(__file__).resolve().parent / "assets"


def fill_page(
    main: str,
    *,
    title: str,
    facts: Sequence[str],
    styles: Sequence[str],
    notes: Sequence[str],
    beside: str,
    attributes: str = "",
    end: str = "",
    script: str | None = None,
    connect: str = "",
    **parts: str,
) -> str:
    """Return a page: the shell around the asset ``main``, whose placeholders ``parts`` fill.

    ``beside`` goes beside the title and ``end`` behind the main part; the page's policy allows ``script`` alone, and
    ``connect``, a part of it. A page is
    passed on: title, facts and notes name files without their folders.
    """
    style = "".join(map(_asset, styles))
    allowed = "" if script is None else f"script-src {_policy_hash(script)}; "
    parts |= {
        "policy": f"default-src 'none'; {allowed}{connect}style-src {_policy_hash(style)}; img-src data:",
        "title": escape(without_folders(title)),
        "facts": " · ".join(f"<span>{escape(without_folders(fact))}</span>" for fact in facts),
        "style": style,
        "notes": "".join(f"<li>{escape(without_folders(note))}</li>" for note in notes),
        "script": script or "",
    }
    shell = _asset("shell.htm")
    for name, text in {"main": _asset(main), "beside": beside, "attributes": attributes, "end": end}.items():
        shell = shell.replace("{{" + name + "}}", text)
    # One pass: text that came from the data is never searched for placeholders again.
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], shell)


def scripted_page(
    main: str,
    *,
    data: Mapping[str, Any],
    scripts: Sequence[str],
    sections: Sequence[Section],
    curves: Mapping[str, Curve] | None,
    **parts: Any,
) -> str:
    """Return a page that a script draws from ``data``, with tables and curves below; ``parts`` are those of `fill_page`."""
    return fill_page(
        main,
        beside=_asset("theme.htm").strip(),
        end=_asset("end.htm"),
        script="(() => {\n'use strict';\n" + "\n".join(_asset(f"{name}.js") for name in scripts) + "})();\n",
        data=json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        report=report_html(sections, curves),
        **parts,
    )


def write_text(text: str, path: str | Path) -> None:
    """Write a page; the file is complete or absent."""
    with replacing(path) as handle:
        handle.write(as_bytes(text))


def read_html(path: str | Path) -> dict[str, Any]:
    """Return the data embedded in a page: its description, and ``arrays`` by name (absent values NaN)."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', Path(path).read_text("utf-8"), re.S)
    if not found:
        raise UserError(f"{path}: not a page written by uplift (no embedded data). Give the page of a run or predict.")
    data = json.loads(found[1])
    data["arrays"] = unpack(data.pop("packed"), data.pop("layout"))
    return data


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _policy_hash(text: str) -> str:
    """Return how a page's Content-Security-Policy names an inline script or style that it allows."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


# Tables and curves of a run.

_WIDTH, _HEIGHT, _MOST_POINTS = 240, 84, 240


_CURVES = "Losses and measures of each stage over its steps, each on its own scale; names are those of metrics.csv."
_NO_CURVES = "The fit ended before anything was logged (every trainer.log_every steps): there are no curves."


def report_html(sections: Sequence[Section], curves: Mapping[str, Curve] | None) -> str:
    """Return a card for each section and one for all curves; without any curves of a fit it says so."""
    card = ""
    if curves is not None:
        charts = curve_charts(curves)
        about = f"<p>{_CURVES}</p>" if "<figure" in charts else "" if charts else f"<p>{_NO_CURVES}</p>"
        card = f'<section class="card broad"><h2>Training</h2>{about}{charts}</section>'
    alone = len(sections) == 1
    return "".join(_table_html(section, broad=alone) for section in sections) + card


def curve_charts(curves: Mapping[str, Curve]) -> str:
    """Return one small chart per curve of (step, value) points; a single point, which makes no line, in words.

    Values that are not finite are left out.
    """
    numbers = {name: [(float(x), float(y)) for x, y in points] for name, points in curves.items()}
    finite = {name: [point for point in of if all(map(math.isfinite, point))] for name, of in numbers.items()}
    charts = [_chart(name, points) for name, points in finite.items() if len(points) > 1]
    alone = [
        f"{escape(name)}: {number_text(of[0][1])}, at step {number_text(of[0][0])}"
        for name, of in finite.items()
        if len(of) == 1
    ]
    words = f"<p>Logged once: {'; '.join(alone)}.</p>" if alone else ""
    return (f'<div class="charts">{"".join(charts)}</div>' if charts else "") + words


def number_text(value: object) -> str:
    """Return a table cell's text: numbers to four figures, everything else as it is."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if not math.isfinite(value):
        return "–"
    if float(value).is_integer() and abs(value) < 1e9:
        return f"{int(value):,}"
    return f"{value:.3f}" if abs(value) < 10 else f"{value:,.1f}"


def _chart(name: str, points: list[tuple[float, float]]) -> str:
    points = _thinned(points)
    (first, last), values = (points[0][0], points[-1][0]), [y for _, y in points]
    low, high = min(values), max(values)
    wide, tall = (last - first) or 1.0, (high - low) or 1.0
    xy = [((x - first) / wide * _WIDTH, _HEIGHT - (y - low) / tall * _HEIGHT) for x, y in points]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
    label = escape(name)
    final = number_text(points[-1][1])
    return (
        f'<figure class="chart"><figcaption><span>{label}</span><b>{escape(final)}</b></figcaption>'
        f'<svg viewBox="-5 -5 {_WIDTH + 10} {_HEIGHT + 10}" role="img" '
        f'aria-label="{label}, from {number_text(points[0][1])} to {final}">'
        f'<path class="axis" d="M0 {_HEIGHT}H{_WIDTH}"/><polyline class="curve" points="{line}"/>'
        f'<circle class="end" cx="{xy[-1][0]:.1f}" cy="{xy[-1][1]:.1f}" r="3"/></svg>'
        f'<div class="range"><span>steps {number_text(first)} to {number_text(last)}</span>'
        f"<span>{number_text(low)} to {number_text(high)}</span></div></figure>"
    )


def _thinned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return at most so many points, each the mean of its neighbours, ends kept."""
    if len(points) <= _MOST_POINTS:
        return points
    edges = [round(n * len(points) / _MOST_POINTS) for n in range(_MOST_POINTS + 1)]
    parts = [points[a:b] for a, b in pairwise(edges)]
    means = [(sum(x for x, _ in part) / len(part), sum(y for _, y in part) / len(part)) for part in parts]
    return [points[0], *means[1:-1], points[-1]]


def _table_html(section: Section, broad: bool) -> str:
    title, rows, header = section if len(section) == 3 else (*section, ())
    texts = [all(isinstance(cell, str) for cell in row) for row in rows]
    if not header and len(rows) > 1 and len(rows[0]) > 2 and texts[0] and not any(texts[1:]):
        header, rows = rows[0], rows[1:]
    head = f"<thead>{_row(header, 'th')}</thead>" if header else ""
    body = "".join(_row(row, "td") for row in rows)
    wide = " broad" if broad or max(map(len, rows), default=0) > 6 else ""
    return (
        f'<section class="card{wide}"><h2>{escape(title)}</h2><div class="wide"><table>{head}'
        f"<tbody>{body}</tbody></table></div></section>"
    )


def _row(cells: Sequence[object], tag: str) -> str:
    first, *others = [cell.item() if isinstance(cell, np.generic) else cell for cell in cells] or [""]
    scope, of_others = ("col", ' scope="col"') if tag == "th" else ("row", "")
    rest = "".join(f"<{tag}{of_others}>{escape(number_text(cell))}</{tag}>" for cell in others)
    if not isinstance(first, Term):
        return f'<tr><th scope="{scope}">{escape(number_text(first))}</th>{rest}</tr>'
    text, term, meaning = map(escape, first)
    return f'<tr><th scope="{scope}" title="{meaning}">{text}<small>{term}</small></th>{rest}</tr>'


# Arrays as a short text for a page: quantised to steps, differenced over rows, deflated, base64.

_ABSENT = -32768
_LARGEST = 32767


def _quantise(values: np.ndarray, finest: float) -> tuple[np.ndarray, float, float]:
    """Return int16 codes, step and offset with ``codes * step + offset`` near ``values``.

    The step is ``finest`` or what the range of the values needs, whichever is larger; the error is
    at most half a step. A value that is not finite becomes ``_ABSENT``.
    """
    values = np.asarray(values, np.float64)
    finite = np.isfinite(values)
    known = values[finite]
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    step = max((high - low) / 2 / (_LARGEST - 1), finest, np.finfo(np.float32).tiny)
    # A whole number of steps keeps zeros and whole numbers exact.
    offset = np.rint((low + high) / 2 / step) * step
    codes = np.full(values.shape, _ABSENT, np.int16)
    codes[finite] = np.clip(np.rint((known - offset) / step), -_LARGEST, _LARGEST).astype(np.int16)
    return codes, float(step), float(offset)


def pack(arrays: dict[str, tuple[np.ndarray, float]]) -> tuple[str, list[dict[str, Any]]]:
    """Return the text and its description of ``{name: (values, finest step)}``, rows first."""
    planes, described = [], []
    for name, (values, finest) in arrays.items():
        codes, step, offset = _quantise(values, finest)
        rows = codes.reshape(len(codes), -1).view(np.uint16)
        changes = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint16))
        planes += [(changes & 0xFF).astype(np.uint8).T.tobytes(), (changes >> 8).astype(np.uint8).T.tobytes()]
        described.append({"name": name, "shape": list(np.shape(values)), "step": step, "offset": offset})
    return base64.b64encode(zlib.compress(b"".join(planes), 6)).decode("ascii"), described


def unpack(text: str, described: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the arrays of ``pack``; absent values are NaN."""
    data = zlib.decompress(base64.b64decode(text))
    arrays, at = {}, 0
    for item in described:
        rows = item["shape"][0]
        size = int(np.prod(item["shape"], dtype=np.int64))
        low, high = (np.frombuffer(data, np.uint8, size, at + part * size) for part in (0, 1))
        at += 2 * size
        changes = (low.astype(np.uint16) | high.astype(np.uint16) << 8).reshape(-1, rows).T
        codes = np.cumsum(changes, axis=0, dtype=np.uint16).view(np.int16).reshape(item["shape"])
        values = codes * item["step"] + item["offset"]
        arrays[item["name"]] = np.where(codes == _ABSENT, np.nan, values)
    return arrays


# Photos: found by the name of a frame or mask, cut to what is shown of them, small.

_MOST_PIXELS = 120_000_000
_QUALITY = 72
_ENDINGS = ("", ".jpg", ".jpeg", ".png")


class Photos:
    """The photos of one folder, or without a folder those that are named by where they are."""

    def __init__(self, folder: str | Path | None):
        self.folder = None if folder is None else Path(folder).expanduser()
        if self.folder is not None and not self.folder.is_dir():
            raise UserError(f"images={folder}: no such folder. Expected the folder with the photos of the input.")
        self.shown = 0
        self.absent: list[str] = []
        self.unreadable: list[str] = []

    def cut(self, name: str, left: float, top: float, side: float, scale: float) -> tuple[Image, np.ndarray] | None:
        """Return what of a photo is in a square, at ``scale``, and its corners (left top, right bottom) in the photo.

        The square is in pixels of the photo as it is stored, as keypoints count them: a camera's note on how it was
        held is not applied. None where there is no such photo, or none that can be shown.
        """
        from PIL.Image import DecompressionBombError

        path = self._find(name)
        if path is None:
            self.absent.append(name)
            return None
        try:
            found = _cut(path, left, top, side, scale)
        except (OSError, ValueError, SyntaxError, DecompressionBombError) as error:
            self.unreadable.append(f"{name} ({error})")
            return None
        self.shown += 1
        return found

    def _find(self, name: str) -> Path | None:
        """Return the photo's file: as it is named, or by its last part, never outside of the folder.

        Without a folder the names are paths that readers have looked at (`uplift.data.parsers.pictures.Photos`).
        """
        named = PurePosixPath(name)
        if not named.name:
            return None
        if self.folder is None:
            return Path(name) if Path(name).is_file() else None
        paths = (inside(self.folder, f"{part}{ending}") for part in (named, named.name) for ending in _ENDINGS)
        return next((path for path in paths if path is not None and path.is_file()), None)


def _cut(path: Path, left: float, top: float, side: float, scale: float) -> tuple[Image, np.ndarray]:
    from PIL import Image

    with Image.open(path) as photo:
        size = f"is {photo.width} x {photo.height} px"
        if photo.width * photo.height > _MOST_PIXELS:
            raise ValueError(f"{size}, more than is opened for a small picture")
        low = max(0, round(left)), max(0, round(top))
        high = min(photo.width, round(left + side)), min(photo.height, round(top + side))
        if high[0] - low[0] < 2 or high[1] - low[1] < 2:
            raise ValueError(f"{size} and what is to be shown is not in it")
        small = max(1, round((high[0] - low[0]) * scale)), max(1, round((high[1] - low[1]) * scale))
        part = photo.convert("RGB").resize(small, Image.Resampling.BILINEAR, (*low, *high), reducing_gap=2)
    return part, np.array([low, high], float)


def jpeg_address(picture: Image) -> str:
    """Return a picture as a data address."""
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
