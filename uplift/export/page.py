"""Predictions as one self-contained page: 2D beside 3D on a canvas, no network, no WebGL."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from uplift.config.files import replacing
from uplift.errors import UserError
from uplift.export.clips import Clip, arrange, choose, photos
from uplift.export.scene import beside, level_rotations, matched_truth, rotations_to, scaled_error, standing
from uplift.models.prediction import Prediction
from uplift.skeleton.core import bone_sides, joint_sides

__all__ = [
    "Curve",
    "curve_charts",
    "curves_html",
    "number_text",
    "pack",
    "page_part",
    "page_text",
    "policy_hash",
    "read_html",
    "table_html",
    "unpack",
    "write_html",
]

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


# Curves of a run as small inline SVG charts.

Curve = Sequence[tuple[SupportsFloat, SupportsFloat]]

_WIDTH, _HEIGHT, _MOST_POINTS = 240, 84, 240


def curve_charts(curves: Mapping[str, Curve]) -> str:
    """Return one small chart per curve of (step, value) points; values that are not finite are left out."""
    charts = []
    for name, points in curves.items():
        numbers = [(float(x), float(y)) for x, y in points]
        finite = [point for point in numbers if all(map(math.isfinite, point))]
        if finite:
            charts.append(_chart(name, finite))
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


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


# The data a page carries: chosen clips, names, and the packed arrays.

_ROWS_PER_MOMENT = 3
_STEPS_PER_SIZE = 4096


def _page_data(prediction: Prediction, moments: int) -> dict[str, Any]:
    """Return what the page's script reads, and ``facts`` and ``remarks`` for its text.

    At most ``moments`` moments and three rows for each, whole clips evenly chosen. Raises UserError
    where there is no frame, or where the poses were turned to other axes than the camera's.
    """
    if not len(prediction):
        raise UserError("there is no frame to show on a page: the prediction is empty. Check the input file.")
    if prediction.axes not in ("camera", "opencv"):
        raise UserError(
            f"a page shows poses as the camera sees them; these were turned to the axes '{prediction.axes}'. "
            "Leave axes out for a page."
        )
    clips = arrange(prediction.identity, len(prediction))
    chosen = choose(clips, max(1, moments), _ROWS_PER_MOMENT * max(1, moments))
    rows = np.concatenate([clip.rows for clip in chosen])
    arrays, departure = _arrays(prediction, chosen, rows)
    packed, layout = pack(arrays)
    bones = prediction.bone_indices.tolist()
    sides = joint_sides(prediction.skeleton, prediction.joint_names)
    return {
        "unit": prediction.unit,
        "truthUnit": prediction.truth_unit,
        "joints": list(prediction.joint_names),
        "root": prediction.joint_names.index(prediction.skeleton.root),
        "bones": bones,
        "jointSides": sides,
        "boneSides": bone_sides(sides, bones),
        "rooted": prediction.root is not None,
        "noun": "photo" if photos(prediction.identity) else "clip",
        "gravity": bool(prediction.skeleton.gravity),
        "fps": _positive(prediction.fps),
        "imageSize": [int(side) for side in prediction.image_size] if prediction.image_size is not None else None,
        "clips": _described(chosen),
        "layout": layout,
        "packed": packed,
        "facts": _facts(prediction, clips),
        "remarks": _remarks(prediction, clips, chosen, departure),
    }


def _arrays(
    prediction: Prediction, chosen: list[Clip], rows: np.ndarray
) -> tuple[dict[str, tuple[np.ndarray, float]], float]:
    pose = np.asarray(prediction.pose, np.float64)[rows]
    points = np.asarray(prediction.keypoints, np.float64)[rows]
    confidence = np.nan_to_num(np.asarray(prediction.confidence, np.float64)[rows])
    confidence[~np.isfinite(points).all(-1)] = 0
    confidence = np.where(confidence > 0, np.maximum(confidence, 1 / 255), 0)
    rotation, departure = level_rotations(pose, np.asarray(prediction.level_pose, np.float64)[rows])
    points = np.where(confidence[..., None] > 0, points, np.nan)
    fine = _size(pose) / _STEPS_PER_SIZE
    fine_px = _size(points - np.nan_to_num(points).mean((0, 1))) / _STEPS_PER_SIZE
    arrays = {
        "moment": (_stacked(chosen, "moment"), 1.0),
        "individual": (_stacked(chosen, "individual"), 1.0),
        "pose": (pose, fine),
        "keypoints": (points, fine_px),
        "confidence": (confidence, 1 / 255),
        "filled": (confidence <= 0 if prediction.filled is None else np.asarray(prediction.filled, bool)[rows], 1.0),
        "level": (rotation, 1 / _STEPS_PER_SIZE),
    }
    if prediction.root is not None:
        root = np.asarray(prediction.root, np.float64)[rows]
        level = rotations_to(prediction, "level")[rows]
        stood = [standing(root[part], level[part], clip) for part, clip in _parts(chosen)]
    elif any(len(clip.individual_names) > 1 for clip in chosen):
        stood = [beside(pose[part], points[part], confidence[part] > 0) for part, _ in _parts(chosen)]
    else:
        stood = []
    if stood:
        place, level_place = map(np.concatenate, zip(*stood, strict=True))
        arrays |= {"place": (place, fine), "levelPlace": (level_place, fine)}
    if prediction.spread is not None:
        arrays["spread"] = (np.asarray(prediction.spread, np.float64)[rows], fine)
    if prediction.truth is not None:
        truth = np.asarray(prediction.truth, np.float64)[rows]
        same = prediction.unit == prediction.truth_unit == "mm"
        error = scaled_error(pose, truth)
        arrays["truth"] = (truth if same else matched_truth(pose, truth), fine)
        arrays["error"] = (error, _size(truth) / _STEPS_PER_SIZE / 4)
    return arrays, departure


def _parts(chosen: list[Clip]) -> list[tuple[slice, Clip]]:
    ends = np.cumsum([len(clip.rows) for clip in chosen]).tolist()
    return [(slice(end - len(clip.rows), end), clip) for end, clip in zip(ends, chosen, strict=True)]


def _stacked(chosen: list[Clip], name: str) -> np.ndarray:
    return np.concatenate([getattr(clip, name) for clip in chosen])


def _size(values: np.ndarray) -> float:
    """Return the median over frames of the farthest joint's distance; 1 where there is none."""
    far = np.nan_to_num(np.linalg.norm(np.nan_to_num(values, posinf=0, neginf=0), axis=-1)).max(1, initial=0)
    size = float(np.median(far)) if far.size else 0.0
    return size if size > 0 else 1.0


def _positive(fps: float | None) -> float | None:
    return float(fps) if fps is not None and np.isfinite(fps) and fps > 0 else None


def _described(chosen: list[Clip]) -> list[dict[str, Any]]:
    return [
        {"name": clip.name, "rows": len(clip.rows), "individuals": clip.individual_names, "frames": clip.frames}
        for clip in chosen
    ]


def _facts(prediction: Prediction, clips: list[Clip]) -> list[str]:
    count, stills = sum(len(clip.frames) for clip in clips), photos(prediction.identity)
    people = max((len(clip.individual_names) for clip in clips), default=1)
    facts = [
        _short(prediction.source) if prediction.title else "",
        prediction.skeleton.name,
        f"{len(prediction.joint_names)} joints",
        "" if stills else _counted(count, "frame"),
        _counted(len(clips), "photo" if stills else "clip") if len(clips) > 1 or stills else "",
        f"up to {people} individuals at once" if people > 1 else "",
        f"{_positive(prediction.fps):g} fps" if _positive(prediction.fps) else "",
    ]
    return [fact for fact in facts if fact]


def _remarks(prediction: Prediction, clips: list[Clip], chosen: list[Clip], departure: float) -> list[str]:
    total, shown = (sum(len(clip.frames) for clip in some) for some in (clips, chosen))
    remarks = []
    if shown < total:
        remarks.append(
            f"This page shows {shown:,} of {total:,} frames ({len(chosen):,} of {len(clips):,} clips, evenly chosen); "
            f"{total - shown:,} were left out to keep it small."
        )
    if prediction.root is None and any(len(clip.individual_names) > 1 for clip in chosen):
        remarks.append("Individuals stand side by side as in the image; the depth between them is not estimated.")
    if prediction.root is not None and not np.isfinite(prediction.root).all():
        lost = int((~np.isfinite(prediction.root)).any(-1).sum())
        remarks.append(f"{_counted(lost, 'pose')} without a known place are drawn between the places before and after.")
    if prediction.unit != "mm":
        remarks.append("The scale is not metric: lengths can be compared with each other, not with a ruler.")
        if prediction.truth is not None:
            remarks.append("The truth is drawn at the size of each prediction.")
    if departure > 0.02:
        remarks.append(
            "The level view turns each pose as a whole; the level poses of the data differ from that "
            f"by up to {departure:.0%} of the pose's size."
        )
    return [*remarks, *prediction.notes]


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def _short(source: str) -> str:
    """Return the last two parts of a path: a page that is handed on need not tell where its maker keeps data."""
    return "/".join(Path(source).parts[-2:])


# Predictions as one self-contained page: 2D beside 3D on a canvas, no network, no WebGL.

Rows = Sequence[Sequence[object]]
Section = tuple[str, Rows] | tuple[str, Rows, Sequence[object]]

_PAGE = Path(__file__).resolve().parent / "assets"
_SCRIPTS = (
    *(
        "decode.js",
        "colours.js",
        "scene.js",
        "figures.js",
        "floor.js",
        "draw3d.js",
        "labels.js",
        "draw2d.js",
        "strip.js",
    ),
    *("state.js", "motion.js", "keys.js", "pointer.js", "clips.js", "controls.js"),
)


def write_html(prediction: Prediction, path: str | Path, **options: Any) -> None:
    """Write the page of ``page_text`` to ``path``; the options are its own."""
    text = page_text(prediction, **options)
    with replacing(path) as handle:
        handle.write(text.encode("utf-8"))


def page_text(
    prediction: Prediction,
    *,
    frames: int = 2000,
    sections: Sequence[Section] = (),
    curves: Mapping[str, Curve] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """Return the page with at most ``frames`` moments of whole clips, tables, curves and notes.

    ``sections`` are (title, rows) or (title, rows, header); without a header, a first row of three
    or more texts above rows that each hold a number is taken for one. ``curves`` are name -> (step, value) points, one small chart each.
    """
    data = _page_data(prediction, frames)
    title = prediction.title or Path(prediction.source).name or "Poses"
    script = "(() => {\n'use strict';\n" + "\n".join(page_part(name) for name in _SCRIPTS) + "})();\n"
    style = page_part("page.css")
    parts = {
        "policy": f"default-src 'none'; script-src {policy_hash(script)}; style-src {policy_hash(style)}; img-src data:",
        "title": escape(title),
        "subtitle": " · ".join(f"<span>{escape(fact)}</span>" for fact in data.pop("facts")),
        "style": style,
        "noun": str(data["noun"]),
        "report": "".join(table_html(section) for section in sections) + curves_html(curves or {}),
        "notes": "".join(f"<li>{escape(note)}</li>" for note in [*data.pop("remarks"), *notes]),
        "data": json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": script,
    }
    # One pass: text that came from the data is never searched for placeholders again.
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], page_part("shell.htm"))


def read_html(path: str | Path) -> dict[str, Any]:
    """Return the data embedded in a page: its description, and ``arrays`` by name (absent values NaN)."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', Path(path).read_text("utf-8"), re.S)
    if not found:
        raise UserError(f"{path}: not a page written by uplift (no embedded data). Give the page of a run or predict.")
    data = json.loads(found[1])
    data["arrays"] = unpack(data.pop("packed"), data.pop("layout"))
    return data


def page_part(name: str) -> str:
    """Return a script, style or skeleton that pages are put together of."""
    return (_PAGE / name).read_text(encoding="utf-8")


def policy_hash(text: str) -> str:
    """Return how a page's Content-Security-Policy names an inline script or style that it allows."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


def table_html(section: Section) -> str:
    """Return a section as a card with a table."""
    title, rows, header = section if len(section) == 3 else (*section, ())
    if not header and _has_header(rows):
        header, rows = rows[0], rows[1:]
    head = f"<thead>{_row(header, 'th')}</thead>" if header else ""
    body = "".join(_row(row, "td") for row in rows)
    broad = " broad" if max(map(len, rows), default=0) > 6 else ""
    return (
        f'<section class="card{broad}"><h2>{escape(title)}</h2><div class="wide"><table>{head}'
        f"<tbody>{body}</tbody></table></div></section>"
    )


def _has_header(rows: Rows) -> bool:
    texts = [all(isinstance(cell, str) for cell in row) for row in rows]
    return len(rows) > 1 and len(rows[0]) > 2 and texts[0] and not any(texts[1:])


def _row(cells: Sequence[object], tag: str) -> str:
    first, *others = [cell.item() if isinstance(cell, np.generic) else cell for cell in cells] or [""]
    rest = "".join(f"<{tag}>{escape(number_text(cell))}</{tag}>" for cell in others)
    return f'<tr><th scope="row">{escape(number_text(first))}</th>{rest}</tr>'


def curves_html(curves: Mapping[str, Curve]) -> str:
    """Return a card with a chart for each curve; nothing without any."""
    charts = curve_charts(curves)
    return f'<section class="card broad"><h2>Training</h2>{charts}</section>' if charts else ""
