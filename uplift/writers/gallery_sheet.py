"""The frames of a gallery: each with its name, its input and its pose from all sides."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.writers.charts import number_text
from uplift.writers.gallery_photos import Photos
from uplift.writers.gallery_views import HIGH, WIDE, Body, crop_of, drawn_input, drawn_views, filled_points, turned
from uplift.writers.staging import level_rotations, matched_truth, scaled_error

__all__ = ["Sheet"]

_ANGLES_DEG = tuple(range(0, 360, 30))
_NAMED = ("image", "sequence")


class Sheet:
    """The chosen frames of a prediction, ready to be drawn."""

    def __init__(self, prediction: Prediction, rows: np.ndarray, photos: Photos | None):
        self.prediction, self.rows, self.photos = prediction, rows, photos
        self.body = Body.of(prediction)
        self.pose = np.asarray(prediction.pose, np.float64)[rows]
        self.pose[~np.isfinite(self.pose).all(-1)] = np.nan
        level_pose = np.asarray(prediction.level_pose, np.float64)[rows]
        known = np.isfinite(self.pose) & np.isfinite(level_pose).all(-1, keepdims=True)
        self.level, _ = level_rotations(np.where(known, self.pose, 0), np.where(known, level_pose, 0))
        self.points = np.asarray(prediction.keypoints, np.float64)[rows]
        self.seen = np.isfinite(self.points).all(-1) & (np.nan_to_num(np.asarray(prediction.confidence)[rows]) > 0)
        self.truth = self.error = None
        if prediction.truth is not None:
            truth = np.asarray(prediction.truth, np.float64)[rows]
            metric = prediction.unit == prediction.truth_unit == "mm"
            known = np.isfinite(truth).all((1, 2))
            self.error = np.where(known, scaled_error(self.pose, truth), np.nan)
            self.truth = truth if metric else matched_truth(self.pose, truth)
        self.name_key = next((key for key in _NAMED if key in prediction.identity), None)
        if photos is not None and self.name_key is None:
            raise UserError(
                "images=...: the input does not say which photo a frame is from. It needs the array 'image' "
                "(or 'sequence') with their file names (docs/your-data.md)."
            )

    def frame(self, place: int) -> str:
        """Return one frame: its name, its input, its views."""
        row, name = self.rows[place], escape(self._name(place))
        unseen = [joint for joint, seen in zip(self.prediction.joint_names, self.seen[place], strict=True) if not seen]
        about = [f"row {row:,}"]
        if unseen:
            about.append(f"not seen: {', '.join(unseen)}")
        if self.error is not None and np.isfinite(self.error[place]):
            unit = "" if self.prediction.truth_unit == "relative" else f" {self.prediction.truth_unit}"
            about.append(f"error at the best scale (n_mpjpe) {number_text(float(self.error[place]))}{unit}")
        facts = "".join(f"<span>{escape(fact)}</span>" for fact in about)
        turns = "".join(self._turns(place, name))
        return (
            f'<article class="frame" id="row-{row}" aria-labelledby="name-{row}"><div class="name">'
            f'<h2 id="name-{row}">{name}</h2>{facts}</div>'
            f'<div class="strip">{self._input(place, name)}<div>{turns}</div></div></article>'
        )

    def _input(self, place: int, name: str) -> str:
        seen = self.seen[place]
        points = filled_points(self.points[place], seen, self.pose[place])
        crop = crop_of(points)
        photo = self.photos.cropped(self._photo(place), crop) if self.photos else ""
        drawing = drawn_input(points, ~seen, self.body, crop)
        label = f"Input of {name}: {seen.sum()} of {len(seen)} joints seen" + (", on the photo" if photo else "")
        return (
            f'<figure class="input"><svg viewBox="0 0 {WIDE} {WIDE}" role="img" aria-label="{label}">{photo}{drawing}</svg>'
            "</figure>"
        )

    def _turns(self, place: int, name: str) -> list[str]:
        pose, level = self.pose[place], self.level[place]
        centre = np.nanmean(pose, 0)
        shown = [("Lifted", pose, ~self.seen[place])]
        if self.truth is not None and np.isfinite(self.truth[place]).all(-1).any():
            shown.append(("Truth", self.truth[place], np.zeros(len(pose), bool)))
        views = [turned(found, level, centre, _ANGLES_DEG) for _, found, _ in shown]
        drawings = drawn_views(views, [missing for *_, missing in shown], self.body)
        named = len(shown) > 1
        return [_turned_row(title, name, drawn, named) for (title, *_), drawn in zip(shown, drawings, strict=True)]

    def _name(self, place: int) -> str:
        row, identity = self.rows[place], self.prediction.identity
        if "image" in identity:
            return str(identity["image"][row])
        told = [str(identity[key][row]) for key in ("subject", "action", "sequence", "camera") if key in identity]
        told += [f"frame {identity['frame'][row]}"] if "frame" in identity else []
        return " · ".join(told) or f"row {row:,}"

    def _photo(self, place: int) -> str:
        assert self.name_key is not None  # or it was refused
        return str(self.prediction.identity[self.name_key][self.rows[place]])

    def refuse_without_photos(self) -> None:
        """Raise UserError where none of the photos that were asked for could be shown."""
        photos = self.photos
        if photos is None or photos.shown:
            return
        why = (
            f"cannot be read: {photos.unreadable[0]}" if photos.unreadable else f"are not there: no {photos.absent[0]}"
        )
        raise UserError(f"images={photos.folder}: the photos of these frames {why}.")

    def facts(self) -> list[str]:
        """Return what stands under the title."""
        prediction = self.prediction
        return [
            *(["/".join(Path(prediction.source).parts[-2:])] if prediction.title and prediction.source else []),
            prediction.skeleton.name,
            f"{len(prediction.joint_names)} joints",
            f"{len(self.rows):,} of {len(prediction):,} frames",
        ]

    def notes(self) -> list[str]:
        """Return what a reader should know, a sentence each."""
        about = "gravity" if self.prediction.skeleton.gravity else "the image's vertical"
        notes = [
            f"Each pose is turned about {about} in steps of 30°, as if the camera walked round it; 0° is what the "
            "camera itself saw. Far limbs are paler.",
        ]
        if len(self.rows) < len(self.prediction):
            notes.append("The frames are spread over the whole input, one at random out of each part of it.")
        if self.prediction.unit != "mm":
            truth = ", and the truth is drawn at the size of each pose" if self.truth is not None else ""
            notes.append(f"The scale is not metric: every frame is drawn as large as it fits{truth}.")
        photos = self.photos
        if photos and photos.absent:
            notes.append(self._told(photos.absent, f"not in {photos.folder.name}"))
        if photos and photos.unreadable:
            notes.append(self._told(photos.unreadable, "no use"))
        return notes

    def _told(self, names: list[str], what: str) -> str:
        are = "is" if len(names) == 1 else "are"
        few = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        return f"{len(names)} of {len(self.rows)} photos {are} {what}: {few}."


def _turned_row(title: str, name: str, drawn: list[str], named: bool) -> str:
    label = f"{title} pose of {name}, seen from {len(drawn)} sides, 30 degrees apart"
    views = "".join(
        f'<svg viewBox="0 0 {WIDE} {HIGH + 50}">{view}<text x="{WIDE // 2}" y="{HIGH + 40}">{angle}°</text></svg>'
        for angle, view in zip(_ANGLES_DEG, drawn, strict=True)
    )
    caption = f"<figcaption>{title}</figcaption>" if named else ""
    return f'<figure class="turns">{caption}<div class="views" role="img" aria-label="{label}">{views}</div></figure>'
