"""Poses as one self-contained page: 2D beside 3D on a canvas, no network, no WebGL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uplift.biomechanics.angles import angles_of, joint_angles
from uplift.errors import UserError
from uplift.export.behind import pictures_behind
from uplift.export.clips import Clip, arrange, frame_rate, photos, titled
from uplift.export.html import Curve, Section, pack, scripted_page, write_text
from uplift.export.scene import (
    beside,
    body_of,
    level_rotations,
    rotations_to,
    scaled_error,
    shown_truth,
    standing,
)
from uplift.models.prediction import Prediction
from uplift.skeleton.core import CENTRE, LEFT, RIGHT, without_side

__all__ = ["choose", "page_text", "write_html"]

_SCRIPTS = (
    "decode", "colours", "scene", "figures", "floor", "draw3d", "labels", "behind", "draw2d", "strip", "angles", "state",
    "motion", "keys", "pointer", "clips", "controls",
)  # fmt: skip


def write_html(prediction: Prediction, path: str | Path, **options: Any) -> None:
    """Write the page of `page_text` to ``path`` with these options."""
    write_text(page_text(prediction, **options), path)


def page_text(
    prediction: Prediction,
    *,
    frames: int = 2000,
    sections: Sequence[Section] = (),
    curves: Mapping[str, Curve] | None = None,
    notes: Sequence[str] = (),
    video: str | Path | None = None,
) -> str:
    """Return the page with at most ``frames`` moments of complete clips, tables, curves and notes.

    ``sections`` and ``curves`` (name -> points, a small chart each) are those of `uplift.export.html`. ``video``, what
    `uplift.export.footage.Footage` takes, is shown behind the 2D, in small pictures that are part of the page.
    """
    data = _page_data(prediction, frames, video)
    return scripted_page(
        "viewer.htm",
        title=prediction.title or Path(prediction.source).name or "Poses",
        facts=data.pop("facts"),
        styles=["page.css"],
        notes=[*data.pop("remarks"), *notes],
        data=data,
        scripts=_SCRIPTS,
        sections=sections,
        curves=curves,
        noun=str(data["noun"]),
        things="poses",
    )


# The data a page carries: chosen clips, names, and the packed arrays.

_ROWS_PER_MOMENT = 3
_STEPS_PER_SIZE = 4096
_STEP_DEG = 0.25


def _page_data(prediction: Prediction, moments: int, video: str | Path | None) -> dict[str, Any]:
    """Return what the page's script reads, and ``facts`` and ``remarks`` for its text.

    At most ``moments`` moments and three rows for each, complete clips evenly chosen. Raises UserError
    where there is no frame, or where the poses were turned to other axes than the camera's.
    """
    if not len(prediction):
        raise UserError("there is no frame to show on a page: the prediction is empty. Check the input file.")
    if prediction.axes not in ("camera", "opencv"):
        raise UserError(f"a page shows poses in the camera's axes, these are in '{prediction.axes}': leave axes out.")
    clips = arrange(prediction.identity, len(prediction))
    chosen = choose(clips, max(1, moments), _ROWS_PER_MOMENT * max(1, moments))
    rows = np.concatenate([clip.rows for clip in chosen])
    behind, shared = (None, "") if video is None else pictures_behind(prediction, clips, chosen, video)
    arrays, departure = _arrays(prediction, chosen, rows)
    angles = _angles(prediction.select(rows), arrays)
    packed, layout = pack(arrays)
    body = body_of(prediction)
    return {
        "unit": prediction.unit,
        "truthUnit": prediction.truth_unit,
        "joints": list(prediction.joint_names),
        "root": prediction.joint_names.index(prediction.skeleton.root),
        "bones": body.bones.tolist(),
        "jointSides": body.joint_sides,
        "boneSides": body.bone_sides,
        "rooted": prediction.root is not None,
        "noun": "photo" if photos(prediction.identity) else "clip",
        "angles": angles,
        "gravity": bool(prediction.skeleton.gravity),
        "fps": frame_rate(prediction, None),
        "imageSize": [int(side) for side in prediction.image_size] if prediction.image_size is not None else None,
        "clips": [
            {
                "name": clip.title,
                "rows": len(clip.rows),
                "individuals": [titled("individual", name) for name in clip.individual_names],
                "frames": clip.frames,
            }
            for clip in chosen
        ],
        "behind": behind,
        "layout": layout,
        "packed": packed,
        "facts": _facts(prediction, clips),
        "remarks": [*filter(None, [shared]), *_remarks(prediction, clips, chosen, departure)],
    }


def choose(clips: Sequence[Clip], moments: int, rows: int) -> list[Clip]:
    """Return complete clips, evenly chosen, with at most so many moments and rows; a lone long clip is cut."""
    for count in range(min(len(clips), moments, rows), 0, -1):  # a clip has a frame at least
        picked = [clips[index] for index in np.linspace(0, len(clips) - 1, count).round().astype(int)]
        if sum(len(clip.frames) for clip in picked) <= moments and sum(len(clip.rows) for clip in picked) <= rows:
            return picked
    if not clips:
        return []
    crowd = np.cumsum(np.bincount(clips[0].moment))
    return [clips[0].first(max(1, min(moments, int(np.searchsorted(crowd, rows, side="right")))))]


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
        "moment": (np.concatenate([clip.moment for clip in chosen]), 1.0),
        "individual": (np.concatenate([clip.individual for clip in chosen]), 1.0),
        "pose": (pose, fine),
        "keypoints": (points, fine_px),
        "confidence": (confidence, 1 / 255),
        "filled": (confidence <= 0 if prediction.filled is None else np.asarray(prediction.filled, bool)[rows], 1.0),
        "level": (rotation, 1 / _STEPS_PER_SIZE),
    }
    ends = np.cumsum([len(clip.rows) for clip in chosen]).tolist()
    parts = [(slice(end - len(clip.rows), end), clip) for end, clip in zip(ends, chosen, strict=True)]
    stood = []
    if prediction.root is not None:
        root = np.asarray(prediction.root, np.float64)[rows]
        level = rotations_to(prediction, "level")[rows]
        stood = [standing(root[part], level[part], clip) for part, clip in parts]
    elif any(len(clip.individual_names) > 1 for clip in chosen):
        stood = [beside(pose[part], points[part], confidence[part] > 0) for part, _ in parts]
    if stood:
        place, level_place = map(np.concatenate, zip(*stood, strict=True))
        arrays |= {"place": (place, fine), "levelPlace": (level_place, fine)}
    if prediction.ground is not None:
        point = np.einsum("fk,fk->f", rotations_to(prediction, "level")[:, 1], prediction.ground.point)
        arrays["floor"] = (point[rows], fine)
    if prediction.uncertainty is not None:
        arrays["uncertainty"] = (np.asarray(prediction.uncertainty, np.float64)[rows], fine)
    if prediction.truth is not None:
        truth = np.asarray(prediction.truth, np.float64)[rows]
        arrays["truth"] = (shown_truth(prediction, pose, truth), fine)
        arrays["error"] = (scaled_error(pose, truth), _size(truth) / _STEPS_PER_SIZE / 4)
    return arrays, departure


def _angles(prediction: Prediction, arrays: dict[str, tuple[np.ndarray, float]]) -> list[dict[str, Any]]:
    """Add the joint angles to ``arrays``, where the skeleton names some; return their names, both sides together."""
    if not angles_of(prediction.skeleton):
        return []
    found = joint_angles(prediction)
    arrays["angles"] = (found.values, _STEP_DEG)
    if found.uncertainty is not None:
        arrays["angleErrors"] = (found.uncertainty, _STEP_DEG)
    groups: dict[str, list[dict[str, int]]] = {}
    for place, name in enumerate(found.names):
        plain, side = without_side(name)
        shown = {"left": LEFT, "right": RIGHT, "": CENTRE}[side]
        groups.setdefault(plain.replace("_", " "), []).append({"place": place, "side": shown})
    return [{"name": name, "parts": parts} for name, parts in groups.items()]


def _size(values: np.ndarray) -> float:
    """Return the median over frames of the farthest joint's distance; 1 where there is none."""
    far = np.nan_to_num(np.linalg.norm(np.nan_to_num(values, posinf=0, neginf=0), axis=-1)).max(1, initial=0)
    size = float(np.median(far)) if far.size else 0.0
    return size if size > 0 else 1.0


def _facts(prediction: Prediction, clips: list[Clip]) -> list[str]:
    count, stills = sum(len(clip.frames) for clip in clips), photos(prediction.identity)
    people = max((len(clip.individual_names) for clip in clips), default=1)
    rate = frame_rate(prediction, None)
    facts = [
        Path(prediction.source).name if prediction.title else "",
        prediction.skeleton.name,
        f"{len(prediction.joint_names)} joints",
        "" if stills else _counted(count, "frame"),
        _counted(len(clips), "photo" if stills else "clip") if len(clips) > 1 or stills else "",
        f"up to {people} individuals at once" if people > 1 else "",
        f"{rate:g} fps" if rate else "",
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
        size = f"by up to {departure:.0%} of the pose's size"
        remarks.append(
            f"The level view turns each pose as a whole; the level poses of the data differ from that {size}."
        )
    return [*remarks, *prediction.notes]


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
