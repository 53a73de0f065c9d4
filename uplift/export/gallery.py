"""Poses as a page to leaf through: each frame's input beside its pose from all sides, drawn without a script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from uplift.config.files import without_folders
from uplift.config.progress import progress
from uplift.errors import UserError, listed
from uplift.export.clips import titled
from uplift.export.html import Photos, fill_page, jpeg_address, number_text, write_text
from uplift.export.scene import Body, body_of, known_points, level_rotations, scaled_error, shown_truth
from uplift.geometry.rigid import rotation_about
from uplift.models.prediction import Prediction

__all__ = [
    "Crop", "check_options", "chosen_rows", "crop_of", "filled_points", "gallery_text", "photo_svg", "turned",
    "write_gallery",
]  # fmt: skip

_MOST_FRAMES = 500


def write_gallery(prediction: Prediction, path: str | Path, **options: Any) -> None:
    """Write the page of `gallery_text` to ``path`` with these options."""
    write_text(gallery_text(prediction, **options), path)


def gallery_text(prediction: Prediction, *, frames: int = 40, seed: int = 0, images: str | Path | None = None) -> str:
    """Return the page with ``frames`` frames spread over the prediction, drawn with ``seed``.

    Every frame shows its 2D keypoints, the pose turned about gravity in steps of 30 degrees, and the truth in the
    same way where there is one. ``images`` is the folder of the photos that ``image`` (or ``sequence``) names:
    what they show of the body goes into the page.

    Raises:
        UserError: no frame to show, an invalid count, a folder that holds none of the photos.
    """
    photos = check_options(frames=frames, seed=seed, images=images)
    rows = chosen_rows(prediction, frames, seed)
    sheet = _Sheet(prediction, rows, photos)
    drawn = "\n".join(sheet.frame(place) for place in progress(range(len(rows)), "drawing frames"))
    sheet.refuse_without_photos()
    return fill_page(
        "gallery.htm",
        title=prediction.title or Path(prediction.source).name or "Poses",
        facts=sheet.facts(),
        styles=["gallery.css"],
        notes=sheet.notes(),
        attributes=' data-ready="1"',
        beside=f'<p class="legend">{_legend()}</p>',
        frames=drawn,
    )


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
    kinds = {"left": "l0", "right": "r0", "middle": "m0"}
    drawings = {text: f'<path class="{kind}" d="M10 24H94"/>' for text, kind in kinds.items()}
    unseen = '<path class="m0 u" d="M10 24H80"/><circle class="om" cx="86" cy="24" r="11"/>'
    drawings |= {"not seen in 2D, filled in": unseen}
    swatch = '<span><svg viewBox="0 0 104 48" aria-hidden="true">{}</svg>{}</span>'
    return "".join(swatch.format(drawing, text) for text, drawing in drawings.items())


# The frames of a gallery: each with its name, its input and its pose from all sides.

_ANGLES_DEG = tuple(range(0, 360, 30))
_NAMED = ("image", "sequence")


class _Sheet:
    """The chosen frames of a prediction, ready to be drawn."""

    def __init__(self, prediction: Prediction, rows: np.ndarray, photos: Photos | None):
        self.prediction, self.rows, self.photos = prediction, rows, photos
        self.body, self.pose = body_of(prediction), known_points(prediction.pose[rows])
        level_pose = np.asarray(prediction.level_pose, np.float64)[rows]
        known = np.isfinite(self.pose) & np.isfinite(level_pose).all(-1, keepdims=True)
        self.level, _ = level_rotations(np.where(known, self.pose, 0), np.where(known, level_pose, 0))
        self.points = np.asarray(prediction.keypoints, np.float64)[rows]
        self.seen = np.isfinite(self.points).all(-1) & (np.nan_to_num(np.asarray(prediction.confidence)[rows]) > 0)
        self.truth = self.error = None
        if prediction.truth is not None:
            truth = np.asarray(prediction.truth, np.float64)[rows]
            known = np.isfinite(truth).all((1, 2))
            self.error = np.where(known, scaled_error(self.pose, truth), np.nan)
            self.truth = shown_truth(prediction, self.pose, truth)
        self.name_key = next((key for key in _NAMED if key in prediction.identity), None)
        if photos is not None and self.name_key is None:
            raise UserError(
                "images=...: the input does not name the photo of a frame. It needs the array 'image' "
                "(or 'sequence') with their file names (docs/your-data.md)."
            )

    def frame(self, place: int) -> str:
        row, name = self.rows[place], escape(self._name(place))
        unseen = [joint for joint, seen in zip(self.prediction.joint_names, self.seen[place], strict=True) if not seen]
        about = [f"row {row:,} of the input", *([f"not seen: {listed(unseen)}"] if unseen else [])]
        if self.error is not None and np.isfinite(self.error[place]):
            unit = "" if self.prediction.truth_unit == "relative" else f" {self.prediction.truth_unit}"
            about.append(f"error at the best scale (n_mpjpe) {number_text(float(self.error[place]))}{unit}")
        facts = "".join(f"<span>{escape(fact)}</span>" for fact in about)
        return (
            f'<article class="frame" id="row-{row}" aria-labelledby="name-{row}"><div class="name">'
            f'<h2 id="name-{row}">{name}</h2>{facts}</div>'
            f'<div class="strip">{self._input(place, name)}<div>{self._turns(place, name)}</div></div></article>'
        )

    def _input(self, place: int, name: str) -> str:
        seen = self.seen[place]
        points = filled_points(self.points[place], seen, self.pose[place])
        crop = crop_of(points)
        photo = ""
        if self.photos:
            assert self.name_key is not None  # refused otherwise
            photo = photo_svg(self.photos, str(self.prediction.identity[self.name_key][self.rows[place]]), crop)
        drawing = _drawn_input(points, ~seen, self.body, crop)
        label = f"Input of {name}: {seen.sum()} of {len(seen)} joints seen" + (", on the photo" if photo else "")
        return (
            f'<figure class="input"><svg viewBox="0 0 {WIDE} {WIDE}" role="img" aria-label="{label}">{photo}{drawing}</svg>'
            "</figure>"
        )

    def _turns(self, place: int, name: str) -> str:
        pose, level = self.pose[place], self.level[place]
        shown = [("Lifted", pose, ~self.seen[place])]
        if self.truth is not None and np.isfinite(self.truth[place]).all(-1).any():
            shown.append(("Truth", self.truth[place], np.zeros(len(pose), bool)))
        titles, poses, missing = zip(*shown, strict=True)
        views = [turned(found, level, np.nanmean(pose, 0), _ANGLES_DEG) for found in poses]
        drawings = _drawn_views(views, missing, self.body)
        named = len(shown) > 1
        return "".join(_turned_row(title, name, drawn, named) for title, drawn in zip(titles, drawings, strict=True))

    def _name(self, place: int) -> str:
        row, identity = self.rows[place], self.prediction.identity
        if "image" in identity:
            return without_folders(str(identity["image"][row]))
        keys = ("subject", "action", "sequence", "camera", "instance", "frame")
        parts = [titled(key, without_folders(str(identity[key][row]))) for key in keys if key in identity]
        return " · ".join(part for part in parts if part) or f"row {row:,}"

    def refuse_without_photos(self) -> None:
        """Raise UserError where none of the photos that were asked for could be shown."""
        photos = self.photos
        if photos is None or photos.shown:
            return
        unreadable, absent = photos.unreadable, photos.absent
        why = f"cannot be read: {unreadable[0]}" if unreadable else f"are not there: no {absent[0]}"
        raise UserError(f"images={photos.folder}: the photos of these frames {why}.")

    def facts(self) -> list[str]:
        prediction = self.prediction
        return [
            *([Path(prediction.source).name] if prediction.title and prediction.source else []),
            prediction.skeleton.name,
            f"{len(prediction.joint_names)} joints",
            f"{len(self.rows):,} of {len(prediction):,} frames",
        ]

    def notes(self) -> list[str]:
        """Return notes for the reader, a sentence each."""
        about = "gravity" if self.prediction.skeleton.gravity else "the image's vertical"
        notes = [
            f"Each pose is turned about {about} in steps of 30°, as if the camera walked round it; 0° is what the "
            "camera itself saw. Far limbs are paler."
        ]
        if len(self.rows) < len(self.prediction):
            notes.append("The frames are spread over the input, one at random out of each part of it.")
        if self.prediction.unit != "mm":
            truth = ", and the truth is drawn at the size of each pose" if self.truth is not None else ""
            notes.append(f"The scale is not metric: every frame is drawn as large as it fits{truth}.")
        photos = self.photos
        where = photos and Path(str(photos.folder)).name
        for what, names in ((f"not in {where}", photos.absent), ("unusable", photos.unreadable)) if photos else ():
            are = "is" if len(names) == 1 else "are"
            notes += [f"{len(names)} of {len(self.rows)} photos {are} {what}: {listed(names, 3)}."] if names else []
        return notes


def _turned_row(title: str, name: str, drawn: list[str], named: bool) -> str:
    label = f"{title} pose of {name}, seen from {len(drawn)} sides, 30 degrees apart"
    views = "".join(
        f'<svg viewBox="0 0 {WIDE} {HIGH + 50}">{view}<text x="{WIDE // 2}" y="{HIGH + 40}">{angle}°</text></svg>'
        for angle, view in zip(_ANGLES_DEG, drawn, strict=True)
    )
    caption = f"<figcaption>{title}</figcaption>" if named else ""
    return f'<figure class="turns">{caption}<div class="views" role="img" aria-label="{label}">{views}</div></figure>'


# A pose from all sides, and its keypoints, as small SVG drawings.

WIDE, HIGH = 400, 480
"""Of a turned view, in drawing units; the input is ``WIDE`` squared."""
_DISTANCE = 10.0
_SIDES = "mlr"
_MARGIN = 0.03


@dataclass(frozen=True)
class Crop:
    """A square of the image, in pixels: its left top corner and its side."""

    left: float
    top: float
    side: float

    def place(self, points: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Return pixels as drawing units."""
        return (points - [self.left, self.top]) * (WIDE / self.side)


def turned(
    pose: Float[np.ndarray, "joints 3"],
    level: Float[np.ndarray, "3 3"],
    centre: Float[np.ndarray, "3"],
    angles_deg: Sequence[int],
) -> Float[np.ndarray, "views joints 3"]:
    """Return the pose as cameras see it that walked round it, as high and as tilted as the real one.

    ``level`` takes the camera frame to one whose y is gravity. At 0 degrees it is the real camera's view; at 90
    the camera is on the image's right.
    """
    about = rotation_about("y", np.radians(np.asarray(angles_deg, float)))
    return np.einsum("vik,jk->vji", level.T @ about @ level, pose - centre)


def _drawn_views(
    poses: Sequence[Float[np.ndarray, "views joints 3"]], missing: Sequence, body: Body
) -> list[list[str]]:
    """Return one SVG drawing per pose and view, all of them at one scale.

    ``missing`` holds, for each pose, which of its joints were not seen (joints,).
    """
    size = float(np.nanmean(np.abs(poses[0]))) or 1.0
    seen = [_projected(views, _DISTANCE * 3 * size) for views in poses]
    flat = np.concatenate([points[..., :2].reshape(-1, 2) for points in seen])
    flat = flat[np.isfinite(flat).all(1)]
    half = np.abs(flat[:, 0]).max(initial=1e-9)
    low, high = (flat[:, 1].min(), flat[:, 1].max()) if len(flat) else (-1.0, 1.0)
    scale = (1 - 2 * _MARGIN) * min(WIDE / 2 / half, HIGH / max(high - low, 1e-9))
    for points in seen:
        points[..., 0] = WIDE / 2 + scale * points[..., 0]
        points[..., 1] = HIGH / 2 + scale * (points[..., 1] - (low + high) / 2)
    return [[_figure(view, unseen, body) for view in points] for points, unseen in zip(seen, missing, strict=True)]


def _projected(views: Float[np.ndarray, "views joints 3"], distance: float) -> Float[np.ndarray, "views joints 3"]:
    """Return x and y in mild perspective, and the depth from -1 (near) to 1."""
    depth = views[..., 2:]
    radius = np.nanmax(np.abs(views), initial=1e-9)
    flat = views[..., :2] / np.maximum(1 + depth / distance, 0.2)
    return np.concatenate([flat, depth / radius], -1)


def _figure(points: Float[np.ndarray, "joints 3"], missing: Bool[np.ndarray, " joints"], body: Body) -> str:
    """Return bones from far to near, each with a rim that parts it from what it hides."""
    depth = points[body.bones, 2].mean(1)
    tones = np.digitize(depth, (-0.12, 0.12))
    parts = []
    for bone in np.argsort(-depth, kind="stable").tolist():
        start, end = body.bones[bone]
        if not np.isfinite(points[[start, end]]).all():
            continue
        line = _line(points[start], points[end])
        tone = f"{_SIDES[body.bone_sides[bone]]}{tones[bone]}"
        if missing[start] or missing[end]:
            parts.append(f'<path class="{tone} u" d="{line}"/>')
        else:
            parts.append(f'<path class="k" d="{line}"/><path class="{tone}" d="{line}"/>')
    dots = [joint for joint in np.flatnonzero(missing).tolist() if np.isfinite(points[joint]).all()]
    return "".join(parts + [_ring(points[joint], _SIDES[body.joint_sides[joint]]) for joint in dots])


def _drawn_input(
    points: Float[np.ndarray, "joints 2"], missing: Bool[np.ndarray, " joints"], body: Body, crop: Crop
) -> str:
    """Return the keypoints as an SVG drawing; joints that were not seen as rings, with dashed bones."""
    placed = crop.place(points)
    rims, lines = [], []
    for (start, end), side in zip(body.bones, body.bone_sides, strict=True):
        if not np.isfinite(placed[[start, end]]).all():
            continue
        line = _line(placed[start], placed[end])
        unseen = " u" if missing[start] or missing[end] else ""
        rims.append("" if unseen else f'<path class="k" d="{line}"/>')
        lines.append(f'<path class="{_SIDES[side]}0{unseen}" d="{line}"/>')
    for joint in np.flatnonzero(np.isfinite(placed).all(1)).tolist():
        side = _SIDES[body.joint_sides[joint]]
        x, y = np.rint(placed[joint]).astype(int)
        dot = f'<circle class="d{side}" cx="{x}" cy="{y}" r="8"/>'
        lines.append(_ring(placed[joint], side) if missing[joint] else dot)
    return "".join(rims + lines)


def filled_points(
    keypoints: Float[np.ndarray, "joints 2"], seen: Bool[np.ndarray, " joints"], pose: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "joints 2"]:
    """Return keypoints with those that were not seen where the lifted pose has them (scale and place by least squares)."""
    points = np.where(seen[:, None], keypoints, np.nan).astype(float)
    known = seen & np.isfinite(pose).all(1)
    if known.sum() < 2:
        return points
    flat, target = pose[known, :2].astype(float), points[known]
    flat_mean, target_mean = flat.mean(0), target.mean(0)
    spread = ((flat - flat_mean) ** 2).sum()
    if spread <= 0:
        return points
    scale = ((flat - flat_mean) * (target - target_mean)).sum() / spread
    return np.where(seen[:, None], points, (pose[:, :2] - flat_mean) * scale + target_mean)


def crop_of(points: Float[np.ndarray, "joints 2"]) -> Crop:
    """Return the square around points that are known, with a margin."""
    known = points[np.isfinite(points).all(1)]
    if not len(known):
        return Crop(0.0, 0.0, 1.0)
    low, high = known.min(0), known.max(0)
    side = max(float((high - low).max()), 1e-6) * 1.3
    left, top = (low + high) / 2 - side / 2
    return Crop(float(left), float(top), side)


_SIDE_PX = 320  # of a photo's part, at most


def photo_svg(photos: Photos, name: str, crop: Crop) -> str:
    """Return an SVG image of what ``crop`` shows of the photo ``name``; nothing where there is none."""
    found = photos.cut(name, crop.left, crop.top, crop.side, min(1.0, _SIDE_PX / (crop.side + 1)))
    if found is None:
        return ""
    picture, corners = found
    (x, y), (x1, y1) = crop.place(corners)
    return (
        f'<image x="{x:.1f}" y="{y:.1f}" width="{x1 - x:.1f}" height="{y1 - y:.1f}" preserveAspectRatio="none" '
        f'href="{jpeg_address(picture)}"/>'
    )


def _line(start: np.ndarray, end: np.ndarray) -> str:
    x0, y0, x1, y1 = (round(float(value)) for value in (start[0], start[1], end[0], end[1]))
    return f"M{x0} {y0}L{x1} {y1}"


def _ring(point: np.ndarray, side: str) -> str:
    return f'<circle class="o{side}" cx="{round(float(point[0]))}" cy="{round(float(point[1]))}" r="9"/>'
