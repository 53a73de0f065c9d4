"""Predictions as a page to leaf through: each frame's input beside its pose from all sides, drawn without a script."""

from __future__ import annotations

import base64
import hashlib
import re
from html import escape
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.gallery_photos import Photos
from uplift.writers.gallery_sheet import Sheet

__all__ = ["check_options", "chosen_rows", "gallery_text", "write_gallery"]

_MOST_FRAMES = 500
_PAGE = Path(__file__).resolve().parent / "page"


def write_gallery(
    prediction: Prediction, path: str | Path, *, frames: int = 40, seed: int = 0, images: str | Path | None = None
) -> None:
    """Write the page of `gallery_text` to ``path``."""
    text = gallery_text(prediction, frames=frames, seed=seed, images=images)
    with replacing(path) as handle:
        handle.write(text.encode("utf-8"))


def gallery_text(prediction: Prediction, *, frames: int = 40, seed: int = 0, images: str | Path | None = None) -> str:
    """Return the page with ``frames`` frames spread over the prediction, drawn with ``seed``.

    Every frame shows its 2D keypoints, the pose turned about gravity in steps of 30 degrees, and the truth in the
    same way where there is one. ``images`` is the folder of the photos that ``image`` (or ``sequence``) names:
    what they show of the body goes into the page.

    Raises:
        UserError: no frame to show, a count that is none, a folder that holds none of the photos.
    """
    photos = check_options(frames=frames, seed=seed, images=images)
    rows = chosen_rows(prediction, frames, seed)
    sheet = Sheet(prediction, rows, photos)
    drawn = "\n".join(sheet.frame(place) for place in range(len(rows)))
    sheet.refuse_without_photos()
    title = prediction.title or Path(prediction.source).name or "Poses"
    style = (_PAGE / "gallery.css").read_text(encoding="utf-8")
    parts = {
        "policy": f"default-src 'none'; style-src {_hash(style)}; img-src data:",
        "title": escape(title),
        "subtitle": " · ".join(f"<span>{escape(fact)}</span>" for fact in sheet.facts()),
        "style": style,
        "legend": _legend(),
        "frames": drawn,
        "notes": "".join(f"<li>{escape(note)}</li>" for note in sheet.notes()),
    }
    # One pass: text that came from the data is never searched for placeholders again.
    shell = (_PAGE / "gallery.htm").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], shell)


def check_options(*, frames: int = 40, seed: int = 0, images: str | Path | None = None) -> Photos | None:
    """Return where the photos are, if anywhere; raises UserError for what `gallery_text` does not take."""
    if seed < 0:
        raise UserError(f"seed={seed}: expected a whole number of at least 0.")
    if not 1 <= frames <= _MOST_FRAMES:
        raise UserError(f"frames={frames}: a gallery shows 1 to {_MOST_FRAMES} frames.")
    return None if images is None else Photos(images)


def chosen_rows(prediction: Prediction, count: int, seed: int) -> np.ndarray:
    """Return ``count`` rows that have a pose, one out of each of as many equal parts of the prediction."""
    lifted = np.flatnonzero(np.isfinite(prediction.pose).all(-1).any(-1))
    if not len(lifted):
        raise UserError("there is no pose to show in a gallery: no frame of the input could be lifted.")
    if count >= len(lifted):
        return lifted
    edges = np.arange(count + 1) * len(lifted) // count
    return lifted[np.random.default_rng(seed).integers(edges[:-1], edges[1:])]


def _legend() -> str:
    kinds = (("l0", "left"), ("r0", "right"), ("m0", "middle"))
    swatch = '<svg viewBox="0 0 104 48" aria-hidden="true">{}</svg>'
    lines = [(swatch.format(f'<path class="{kind}" d="M10 24H94"/>'), text) for kind, text in kinds]
    unseen = '<path class="m0 u" d="M10 24H80"/><circle class="om" cx="86" cy="24" r="11"/>'
    return "".join(
        f"<span>{drawing}{text}</span>"
        for drawing, text in [*lines, (swatch.format(unseen), "not seen in 2D, filled in")]
    )


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"
