"""The verb predict for a run that lifts masks: masks in, shapes out, in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uplift.errors import UserError
from uplift.masks.reading import read
from uplift.model import load
from uplift.run import RunFolder
from uplift.shapes.prediction import ShapePrediction
from uplift.words import number, one_of, whole
from uplift.writers.shapes import shape_writer_for, write_shapes

__all__ = ["predict_shapes", "predict_shapes_lines"]

_READING = ("format", "border", "pieces", "category", "most", "images", "side")
_OF_MESHES = ("axes", "unit", "height_mm", "length_mm", "smooth", "together")


def predict_shapes(
    run: str | Path,
    input: str | Path,
    output: str | Path | None = None,
    *,
    page: str | None = None,
    written: dict[Path, str] | None = None,
    **options: Any,
) -> ShapePrediction:
    """Lift the masks of ``input`` with the model of ``run`` and write the shapes to ``output``, if given.

    ``input`` is a file or folder of masks in any format that is read, several with commas or a pattern. ``page``
    and ``options`` are those of `uplift.writers.shapes.write_shapes` and `uplift.masks.read`. The files written, with a word on each, are added to ``written``.

    Raises:
        UserError: no such input, no mask that can be used, an output that exists or cannot be written.
    """
    reading = {key: options.pop(key) for key in _READING if key in options}
    if output is not None:
        _check_output(output, page, options)
    model = load(run)
    data = read(input, **{"side": _side_of(run), **reading})
    title = Path(str(input).split(",")[0]).stem
    prediction = model.predict(data.without_truth(), title=title)
    notes = tuple(note for note in data.notes if note not in prediction.notes)
    prediction.notes = (*notes, *prediction.notes)
    if output is not None:
        files = write_shapes(prediction, output, page, **options)
        if written is not None:
            written |= files
    return prediction


def predict_shapes_lines(keys: dict[str, str]) -> list[str]:
    """Lift what the words of the command name, write it, and return what to say of it."""
    verb = "predict"
    options: dict[str, Any] = {key: keys[key] for key in ("axes", "unit") if key in keys}
    options |= {key: number(verb, keys, key) for key in ("height_mm", "length_mm") if key in keys}
    options |= {key: whole(verb, keys, key) for key in ("smooth", "items", "most") if key in keys}
    if "together" in keys:
        options["together"] = one_of(verb, keys, "together", ("true", "false"), "true") == "true"
    options |= {key: keys[key] for key in _READING if key in keys and key != "most"}
    written: dict[Path, str] = {}
    found = predict_shapes(
        keys["run"], keys["input"], keys["output"], page=keys.get("page"), written=written, **options
    )
    return _told(found, written)


def _check_output(output: str | Path, page: str | None, options: Mapping[str, Any]) -> None:
    """Refuse an output that cannot be written, before any work."""
    writer, ending = shape_writer_for(output, page), Path(output).suffix.lower()
    for key in options:
        if key in _OF_MESHES and writer.holds == "all":
            raise UserError(f"{key}= goes with the formats of meshes (.glb .obj .ply .stl), not with {output}.")
        if key not in _OF_MESHES and ending != ".html":
            raise UserError(f"{key}= is for a page (.html), not for {ending}.")
    if options.get("smooth", 0) < 0:
        raise UserError(f"smooth={options['smooth']}: expected rounds of smoothing, 0 or more.")
    if options.get("items", 1) < 1:
        raise UserError(f"items={options['items']}: a page shows at least one shape.")
    if Path(output).exists():
        raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
    if not Path(output).absolute().parent.is_dir():
        raise UserError(f"output={output}: no folder {Path(output).absolute().parent}. Create it first.")


def _side_of(run: str | Path) -> int:
    """Return the pixels along a crop that the run was trained with; the default where only its weights are there."""
    path = Path(run)
    if path.is_file():
        path = path.parent
        if not (path / "config.yaml").is_file():
            return 64
    return RunFolder.open(path).settings().data.side


def _told(found: ShapePrediction, written: Mapping[Path, str]) -> list[str]:
    lines = [
        *found.notes,
        f"lifted {len(found):,} masks, {found.resolution} x {found.resolution} x {found.resolution} voxels each",
    ]
    empty = sum(not (grid > found.level).any() for grid in found.occupancy)
    if empty:
        lines.append(
            f"{empty:,} of {len(found):,} shapes are empty: nothing of them is above the level {found.level:g}"
        )
    lines += [f"wrote {path}" + (f": {word}" if word else "") for path, word in list(written.items())[:5]]
    lines += [f"and {len(written) - 5} more"] * (len(written) > 5)
    lines += [f"look: open {path} in a browser" for path in written if path.suffix.lower() == ".html"]
    return lines
