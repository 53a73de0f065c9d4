"""The command predict: its words, and what it says at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.evaluation.plausibility import bone_cv, bone_lengths, never_seen_so_long
from uplift.prediction import Prediction
from uplift.verbs.predict import predict
from uplift.weights import lifts_masks
from uplift.words import POSE_KEYS, PREDICT_KEYS, SHAPE_KEYS, SIZE_KEYS, keyed, number, one_of, read_options, whole

__all__ = ["predict_command"]


def predict_command(words: Sequence[str]) -> None:
    """Lift what the words name, write it, and say what was done."""
    keys = keyed("predict", words, PREDICT_KEYS, ("run", "input", "output"), open_below=("data.options.",))
    masks = lifts_masks(keys["run"])
    _refuse_others(keys, masks)
    if masks:
        from uplift.verbs.predict_shapes import predict_shapes_lines

        print("\n".join(predict_shapes_lines(keys)))
        return
    of_page: dict[str, Any] = {"images": keys["images"]} if "images" in keys else {}
    of_page |= {key: whole("predict", keys, key) for key in ("frames", "seed") if key in keys}
    size = {key: number("predict", keys, key) for key in SIZE_KEYS if key in keys and key != "bone"}
    if "bone" in keys:
        size["bone"] = tuple(name.strip() for name in keys["bone"].split(","))  # type: ignore[assignment]
    written: dict[Path, str] = {}
    found = predict(
        keys["run"],
        keys["input"],
        keys["output"],
        *(f"{key}={value}" for key, value in keys.items() if key.startswith("data.")),
        refine=one_of("predict", keys, "refine", ("on", "off"), "on") == "on",
        constant_bones=one_of("predict", keys, "bones", ("free", "constant"), "free") == "constant",
        size=size,
        reading=read_options("predict", keys),
        axes=keys.get("axes"),
        page=keys.get("page"),
        written=written,
        **of_page,
    )
    assert isinstance(found, Prediction)
    for line in _told(found, written):
        print(line)


def _refuse_others(keys: Mapping[str, str], masks: bool) -> None:
    """Refuse words that go with the other kind of run."""
    for key in keys:
        if key in (POSE_KEYS if masks else SHAPE_KEYS) or (masks and key.startswith("data.")):
            own, other = ("masks", "keypoints") if masks else ("keypoints", "masks")
            raise UserError(f"predict: {key}= goes with a run that lifts {other}; {keys['run']} lifts {own}.")


def _motion(found: Prediction) -> list[str]:
    """Return how much bones vary over each clip, where there are clips."""
    clips = PoseData(found.keypoints, found.confidence, found.joint_names, identity=dict(found.identity)).clips()
    if not len(clips) or clips.max() + 1 == len(clips):
        return []
    lengths = bone_lengths(found.pose, found.skeleton)
    lengths = lengths / np.maximum(lengths.sum(1, keepdims=True), 1e-9) if found.unit != "mm" else lengths
    varies = bone_cv(lengths, np.unique(clips, return_inverse=True)[1])
    return (
        [f"bones vary by {varies:.1%} over a clip (bone_cv); bones=constant makes them the same"]
        if varies > 1e-4
        else []
    )


def _told(found: Prediction, written: Mapping[Path, str]) -> list[str]:
    """Return what to say of a prediction and its files."""
    lines = [*found.notes]
    blank = int((found.pose != found.pose).all((1, 2)).sum())
    lines.append(f"lifted {len(found) - blank:,} frames of {found.skeleton.name}, unit {found.unit}")
    if blank:
        lines.append(
            f"{blank:,} of {len(found):,} frames cannot be lifted (too few joints, or all in one point): their rows are NaN"
        )
    if found.filled is not None and found.filled.any():
        share = found.filled[np.isfinite(found.pose[..., 0])]
        lines.append(f"{share.mean():.1%} of joints were not seen and are filled in (`filled`)" if share.size else "")
    if found.root is not None and np.isfinite(found.root).any():
        lines.append(f"placed: the camera is {np.nanmedian(found.root[:, 2]) / 1000:.2f} m away (median)")
    lines += _motion(found)
    if never_seen_so_long(found.pose, found.skeleton) > 0.2:
        lines.append(
            "WARNING: many bones are twice as long as they ever look from the camera. Too little training, or a body that "
            "is only ever seen from one side (docs/how-it-works.md)"
        )
    if found.unit == "px":
        height = "height_mm=, or " if "of_height" in found.skeleton.size else ""
        lines.append(f"for millimetres give {height}bone=JOINT,JOINT bone_mm= (docs/output.md)")
    shown = [f"wrote {path}" + (f": {word}" if word else "") for path, word in list(written.items())[:5]]
    lines += shown + [f"and {len(written) - 5} more"] * (len(written) > 5)
    lines += [f"look: open {path} in a browser" for path in written if path.suffix.lower() == ".html"]
    return [line for line in lines if line]
