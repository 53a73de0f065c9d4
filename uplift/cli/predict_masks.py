"""Masks in, shapes out: what predict does with a run that lifts masks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from uplift.cli.outputs import refuse_outputs
from uplift.cli.parsing import Keys
from uplift.cli.request import Request
from uplift.cli.verbs import SHAPE_KEYS
from uplift.data.formats import read_masks
from uplift.data.load import format_of_run
from uplift.errors import UserError, did_you_mean
from uplift.export import write, writer_for
from uplift.export.meshes import NO_COLOURS
from uplift.models.likely_size import small_size
from uplift.models.model import load_shapes
from uplift.models.prediction import ShapePrediction
from uplift.video.detect import Detection

__all__ = ["groups_of", "lift_masks", "mask_arguments", "shape_summary"]

_READING = ("format", "border", "pieces", "category", "most", "images", "side")
_OF_MESHES = ("axes", "unit", "height_mm", "length_mm", "smooth", "together", "texture")


def mask_arguments(keys: Keys) -> dict[str, Any]:
    """Return the arguments of `predict` that the command line gives for masks."""
    options = keys.given("format", "images", "height_mm", "together", *SHAPE_KEYS)
    return options | {key: options[key] == "true" for key in ("together", "texture") if key in options}


def lift_masks(request: Request) -> tuple[ShapePrediction, dict[Path, str]]:
    """Lift masks and write the shapes, if there is an output; return the files with a remark on each."""
    others = (
        request.overrides,
        request.refine is not True,
        request.hypotheses,
        request.constant_bones,
        request.reading,
        request.camera,
        request.ground,
        request.detection != Detection(),
        request.keypoints,
        not request.check,
    )
    if any(others):
        of_keypoints = (
            "overrides, refine, hypotheses, constant_bones, reading, camera, ground, check, keypoints and detectors"
        )
        raise UserError(f"{request.weights.run} lifts masks: {of_keypoints} go with keypoints.")
    options = {**request.options, **request.size, **({} if request.axes is None else {"axes": request.axes})}
    reading = {key: options.pop(key) for key in _READING if key in options}
    by, front, steps = (options.pop(key, None) for key in ("group", "front", "refine_steps"))
    for output in request.outputs:
        _check_mesh_output(output, request.page, options)
    refuse_outputs(request.outputs)
    model, trained = load_shapes(request.weights), request.weights.settings()
    if trained is not None:
        reading = {"side": trained.data.side, "format": format_of_run(trained, request.input), **reading}
    model = model if front is None else model.facing(front)
    data = read_masks(request.input, **reading)
    group = None if by is None else groups_of(data.names, by)
    prediction = model.predict(data.without_truth(), title=request.title, refine=steps, group=group)
    notes = tuple(note for note in data.notes if note not in prediction.notes)
    small = small_size({key: options.get(key) for key in ("height_mm", "length_mm")})
    prediction.notes = (*notes, *prediction.notes, *([small] if small else []))
    files: dict[Path, str] = {}
    for output in request.outputs:
        files |= write(prediction, output, request.page, **options)
    return prediction, files


_LAST_NUMBER, _ENDING = re.compile(r"\d+(?=\D*$)"), re.compile(r"\.[A-Za-z]\w{1,4}$")


def groups_of(names: Sequence[str], by: str) -> list[str]:
    """Return the object that each mask is a view of: one for ``all``, by ``folder``, or by ``name`` but for its last number.

    Objects of a label image have numbers, ``frame_001.png:3``: those with other numbers are other objects, in all frames.
    Raises UserError for another way, or where no two masks would be of one object.
    """
    if by not in _GROUPS:
        raise UserError(f"group={by}: expected {', '.join(_GROUPS)}.{did_you_mean(by, _GROUPS)}")
    parts = [name.partition(":") for name in names]
    found = ["" if by == "all" else f"{_GROUPS[by](file)}{colon}{number}" for file, colon, number in parts]
    if len(found) > 1 and len(set(found)) == len(found):
        alike = {"folder": "lie in one folder", "name": "have names that differ in the last number alone"}[by]
        raise UserError(f"group={by}: no two of {len(found):,} masks {alike}, such as {names[0]}, {names[1]}.")
    return found


_GROUPS: dict[str, Callable[[str], str]] = {
    "all": lambda name: "",
    "folder": lambda name: name.rpartition("/")[0],
    "name": lambda name: _LAST_NUMBER.sub("#", _ENDING.sub("", name)),
}


def _check_mesh_output(output: str | Path, page: str | None, options: Mapping[str, Any]) -> None:
    """Refuse an output that cannot be written, before any work."""
    writer, ending = writer_for(output, page, "shapes"), Path(output).suffix.lower()
    for key in options:
        if key in _OF_MESHES and writer.holds == "all":
            raise UserError(f"{key}= goes with the formats of meshes (.glb .obj .ply .stl), not with {output}.")
        if key not in _OF_MESHES and ending != ".html":
            raise UserError(f"{key}= is for a page (.html), not for {ending}.")
    if ending == ".stl" and options.get("texture"):
        raise UserError(NO_COLOURS)
    if options.get("smooth", 0) < 0:
        raise UserError(f"smooth={options['smooth']}: expected rounds of smoothing, 0 or more.")
    if options.get("items", 1) < 1:
        raise UserError(f"items={options['items']}: a page shows at least one shape.")


def shape_summary(found: ShapePrediction) -> list[str]:
    """Return what to print about shapes."""
    side = found.resolution
    lines = [*found.notes, f"lifted {len(found):,} masks, {side} x {side} x {side} voxels each"]
    empty = sum(not (grid > found.level).any() for grid in found.occupancy)
    note = f"{empty:,} of {len(found):,} shapes are empty: nothing of them is above the level {found.level:g}"
    return [*lines, note] if empty else lines
