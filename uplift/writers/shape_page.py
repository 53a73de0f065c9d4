"""Lifted shapes as one self-contained page: masks, silhouettes from all sides and meshes to turn; no network, no WebGL."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.masks.container import Placed
from uplift.meshes.surface import Surface
from uplift.saving import replacing
from uplift.shapes.prediction import ShapePrediction
from uplift.writers.charts import Curve
from uplift.writers.html import Section, curves_html, page_part, policy_hash, table_html
from uplift.writers.shape_data import Scores, chosen_items, shape_data
from uplift.writers.shape_photos import photos_of

__all__ = ["shape_page_text", "write_shape_gallery", "write_shape_page"]

_SCRIPTS = ("decode", "shape_mesh", "shape_raster", "shape_colours", "shape_state", "shape_flat", "shape_deep",
            "shape_sheet", "shape_controls")  # fmt: skip


def write_shape_page(prediction: ShapePrediction, path: str | Path, **options: Any) -> None:
    """Write the page of `shape_page_text` to ``path``; the options are its own."""
    text = shape_page_text(prediction, **options)
    with replacing(path) as handle:
        handle.write(text.encode("utf-8"))


def write_shape_gallery(prediction: ShapePrediction, path: str | Path, **options: Any) -> None:
    """Write the same page, opened at the sheet of all items."""
    write_shape_page(prediction, path, **{"sheet": True, **options})


def shape_page_text(
    prediction: ShapePrediction,
    *,
    truth: Placed | None = None,
    items: int = 100,
    scores: Scores | None = None,
    images: str | Path | None = None,
    sheet: bool = False,
    smooth: int = 2,
    sections: Sequence[Section] = (),
    curves: Mapping[str, Curve] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """Return the page of at most ``items`` shapes, with the true ones beside them where ``truth`` has one for each item.

    ``scores`` are name -> a number for each item, shown with it and to sort the sheet by; ``images`` is the folder
    of the photos; ``sheet`` opens the page at all items. ``sections``, ``curves`` and ``notes`` are as in
    `uplift.writers.html.page_text`.

    Raises:
        UserError: no item, a truth or score that is not one for each item, a folder of photos that is none.
    """
    scores = scores or {}
    _check(prediction, truth, scores)
    rows = chosen_items(len(prediction), items)
    shown, true = prediction.select(rows), None if truth is None else truth.select(rows)
    data, cut = shape_data(shown, true, {name: np.asarray(of, float)[rows] for name, of in scores.items()}, smooth)
    photos, wrong = photos_of(shown, images)
    for entry, photo in zip(data["items"], photos, strict=True):
        entry |= {"photo": photo} if photo else {}
    data["sheet"] = sheet and len(rows) > 1
    script = "(() => {\n'use strict';\n" + "\n".join(page_part(f"{name}.js") for name in _SCRIPTS) + "})();\n"
    style = page_part("page.css") + page_part("shape.css")
    told = [*_remarks(cut, len(prediction)), *wrong, *prediction.notes, *notes]
    parts = {
        "policy": f"default-src 'none'; script-src {policy_hash(script)}; style-src {policy_hash(style)}; img-src data:",
        "title": escape(prediction.title or "Shapes"),
        "subtitle": " · ".join(f"<span>{escape(fact)}</span>" for fact in _facts(prediction, truth)),
        "style": style,
        "report": "".join(table_html(section) for section in sections) + curves_html(curves or {}),
        "notes": "".join(f"<li>{escape(note)}</li>" for note in told),
        "data": json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": script,
    }
    # One pass: text that came from the data is never searched for placeholders again.
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], page_part("shape.htm"))


def _check(prediction: ShapePrediction, truth: Placed | None, scores: Scores) -> None:
    if not len(prediction):
        raise UserError("there is no shape to show: no mask was lifted.")
    given = {"truth": truth, **scores}
    for name, values in given.items():
        if values is not None and len(values) != len(prediction):
            raise UserError(f"{name} has {len(values)} rows, expected {len(prediction)}, one for each shape.")


def _facts(prediction: ShapePrediction, truth: Placed | None) -> list[str]:
    count, side = len(prediction), prediction.resolution
    facts = [f"{count:,} shape{'s' * (count > 1)}", f"{side} × {side} × {side} voxels"]
    return [*facts, "true shapes known"] if truth is not None else facts


def _remarks(cut: Sequence[Surface], count: int) -> list[str]:
    """Return what the reader of the page should know of the surfaces."""
    remarks = [] if len(cut) == count else [f"{len(cut)} of {count:,} shapes are shown, spread evenly."]
    empty = sum(one.mesh is None for one in cut)
    if empty:
        remarks.append(f"{empty} of {len(cut)} shapes have no surface: their occupancy is below the level everywhere.")
    return [*remarks, "Meshes are drawn with fewer triangles than the files of shapes have."]
