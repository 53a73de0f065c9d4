"""A clip as a script that Blender runs (``.blend.py``): empties that move, and an armature that follows them."""

from __future__ import annotations

import base64
import json
from pathlib import Path

from uplift.config.files import replacing
from uplift.data.poses import USUAL_FPS
from uplift.export.clips import evenly, frame_rate, one_clip
from uplift.export.scene import in_metres, known_points, row_places
from uplift.export.tables import labels
from uplift.models.prediction import Prediction

__all__ = ["write_blender"]

_SCRIPT = Path(__file__).resolve().parent / "assets" / "blender.py"
_LONGEST_BYTES = 60  # Blender cuts names after 63, and sets one of two that are the same apart by three more


def write_blender(prediction: Prediction, path: str | Path) -> str:
    """Write one clip with all its individuals, the data inside the script; it needs nothing but Blender.

    The script sets the scene's frame rate (30 where none is known) and range; frame n is frame n of the video. Metres
    where the prediction is in mm, else a body is about 1.7 large. A joint has no keyframe where it is missing. Without a
    known place individuals stand side by side as in the image. Raises UserError for several clips, and for an individual
    that is in a frame twice.
    """
    clip, start = evenly(one_clip(prediction, path), path)
    rate = frame_rate(prediction, None)
    scale, body = in_metres(prediction)
    points = known_points(prediction.pose) + row_places(prediction, clip)[:, None]
    places = clip.by_moment(points * scale).astype("<f4")
    bodies = _short([name or prediction.skeleton.name for name in clip.individual_names])
    data = {
        "fps": rate or USUAL_FPS,
        "start": start,
        "frames": len(clip.frames),
        "size": body,
        "joints": _short(prediction.joint_names),
        "bones": prediction.bone_indices.tolist(),
        "bodies": [
            {"name": name, "places": base64.b64encode(places[:, who].tobytes()).decode()}
            for who, name in enumerate(bodies)
        ],
    }
    script = _SCRIPT.read_text(encoding="utf-8").replace('"@data@"', ascii(json.dumps(data)))
    with replacing(path) as handle:
        handle.write(script.encode())
    notes = ["frames a second are not known: 30"] * (rate is None)
    notes += [f"1 px is {scale:.3g} m: the size is not known"] * (prediction.unit != "mm")
    return "; ".join(notes)


def _short(names: list[str] | tuple[str, ...]) -> list[str]:
    """Return names that Blender keeps as they are."""
    return labels(name.encode("utf-8", "replace")[:_LONGEST_BYTES].decode(errors="ignore") for name in names)
