"""Predictions as one self-contained page: 2D beside 3D on a canvas, no network, no WebGL."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.charts import Curve, curve_charts, number_text
from uplift.writers.packing import unpack
from uplift.writers.page_data import page_data

__all__ = ["curves_html", "page_part", "page_text", "policy_hash", "read_html", "table_html", "write_html"]

Rows = Sequence[Sequence[object]]
Section = tuple[str, Rows] | tuple[str, Rows, Sequence[object]]

_PAGE = Path(__file__).resolve().parent / "page"
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
    data = page_data(prediction, frames)
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
