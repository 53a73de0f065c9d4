"""The verb predict: keypoints in, poses out (or masks in, shapes out), in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uplift.cli.parsing import (
    POSE_KEYS,
    PREDICT_KEYS,
    SHAPE_KEYS,
    SIZE_KEYS,
    keyed,
    number,
    one_of,
    read_options,
    whole,
)
from uplift.config.loading import load_settings
from uplift.config.run import Weights, read_weights
from uplift.data.clean import clean
from uplift.data.datasets import DATA_SETS
from uplift.data.formats import read_masks
from uplift.data.formats.base import ReadOptions
from uplift.data.load import load_file, load_split
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.export import shape_writer_for, write, write_shapes, writer_for
from uplift.export.gallery import check_options
from uplift.export.scene import AXES, in_axes
from uplift.metrics.pose_metrics import bone_cv, bone_lengths, never_seen_so_long
from uplift.models.metric_scale import size_from
from uplift.models.model import load_poses, load_shapes
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.skeleton import Skeleton

__all__ = ["predict", "predict_command", "predict_shapes"]

# The verb predict for a run that lifts masks: masks in, shapes out, in the format of the output's ending.

_READING = ("format", "border", "pieces", "category", "most", "images", "side")
_OF_MESHES = ("axes", "unit", "height_mm", "length_mm", "smooth", "together")


def predict_shapes(
    run: str | Path | Weights,
    input: str | Path,
    output: str | Path | None = None,
    *,
    page: str | None = None,
    written: dict[Path, str] | None = None,
    **options: Any,
) -> ShapePrediction:
    """Lift the masks of ``input`` with the model of ``run`` and write the shapes to ``output``, if given.

    ``input`` is a file or folder of masks in any format that is read, several with commas or a pattern. ``page``
    and ``options`` are those of `uplift.export.write_shapes` and `uplift.data.formats.read_masks`. The files written, with a word on each, are added to ``written``.

    Raises:
        UserError: no such input, no mask that can be used, an output that exists or cannot be written.
    """
    reading = {key: options.pop(key) for key in _READING if key in options}
    if output is not None:
        _check_mesh_output(output, page, options)
    weights = run if isinstance(run, Weights) else read_weights(run)
    model, trained = load_shapes(weights), weights.settings()
    data = read_masks(input, **{**({"side": trained.data.side} if trained else {}), **reading})
    title = Path(str(input).split(",")[0]).stem
    prediction = model.predict(data.without_truth(), title=title)
    notes = tuple(note for note in data.notes if note not in prediction.notes)
    prediction.notes = (*notes, *prediction.notes)
    if output is not None:
        files = write_shapes(prediction, output, page, **options)
        if written is not None:
            written |= files
    return prediction


def _predict_shapes_lines(weights: Weights, keys: dict[str, str]) -> list[str]:
    """Lift what the words of the command name, write it, and return what to say of it."""
    verb = "predict"
    options: dict[str, Any] = {key: keys[key] for key in ("axes", "unit") if key in keys}
    options |= {key: number(verb, keys, key) for key in ("height_mm", "length_mm") if key in keys}
    options |= {key: whole(verb, keys, key) for key in ("smooth", "items", "most") if key in keys}
    if "together" in keys:
        options["together"] = one_of(verb, keys, "together", ("true", "false"), "true") == "true"
    options |= {key: keys[key] for key in _READING if key in keys and key != "most"}
    written: dict[Path, str] = {}
    found = predict_shapes(weights, keys["input"], keys["output"], page=keys.get("page"), written=written, **options)
    return _shape_summary(found, written)


def _check_mesh_output(output: str | Path, page: str | None, options: Mapping[str, Any]) -> None:
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


def _shape_summary(found: ShapePrediction, written: Mapping[Path, str]) -> list[str]:
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


# The verb predict: keypoints in, poses out (or masks in, shapes out), in the format of the output's ending.


def predict(
    run: str | Path | Weights,
    input: str | Path,
    output: str | Path | None = None,
    *overrides: str,
    refine: bool = True,
    constant_bones: bool = False,
    size: Mapping[str, Any] | None = None,
    reading: ReadOptions | None = None,
    axes: str | None = None,
    page: str | None = None,
    written: dict[Path, str] | None = None,
    **options: Any,
) -> Prediction | ShapePrediction:
    """Lift the keypoints of ``input`` with the model of ``run`` and write them to ``output``, if given.

    ``input`` is a file or folder in any format that is read, several with commas or a pattern, or ``SET:SPLIT`` of
    a published data set (``file.py:Class:SPLIT`` of one's own), whose ``data.root`` and ``data.options.*`` are
    ``overrides`` such as a fit takes; ``reading`` is what the files do not say. The frames of a clip are lifted
    together unless ``refine`` is off. ``size`` are arguments of `uplift.models.metric_scale.size_from`. ``axes`` are those of
    `uplift.export.scene`, those usual for the format where not given. ``page`` is the kind of an .html, ``viewer`` or
    ``gallery``, and ``options`` are those of its writer. The files written, with a word on each, are added to ``written``.
    With a run that lifts masks this is `uplift.cli.predict.predict_shapes`, ``size`` among its options.

    Raises:
        UserError: no such run or input, joints that do not fit the model's skeleton, an output that
            exists already or has an unknown ending.
    """
    weights = run if isinstance(run, Weights) else read_weights(run)
    if weights.lifts == "masks":
        if overrides or not refine or constant_bones or reading is not None:
            raise UserError(
                f"{weights.run} lifts masks: overrides, refine, constant_bones and reading go with keypoints."
            )

        told = {**options, **(size or {}), **({} if axes is None else {"axes": axes})}
        return predict_shapes(weights, input, output, page=page, written=written, **told)
    if axes is not None and axes not in AXES:
        raise UserError(f"axes={axes}: no such axes.{did_you_mean(axes, AXES)}")
    if output is not None:
        _check_output(output, page, options)
    model = load_poses(weights)
    known = size_from(model.skeleton, **(size or {}))
    data = _read(input, overrides, model.skeleton, reading)
    clean(data, model.skeleton)  # refuses a file with nothing to lift, before any work
    title = Path(str(input).split(",")[0]).stem
    prediction = model.predict(data, title=title, refine=refine, size=known, constant_bones=constant_bones)
    if output is not None:
        files = write(prediction, output, page, axes, **options)
        if written is not None:
            written |= files
    return prediction if axes is None else in_axes(prediction, axes)


def _check_output(output: str | Path, page: str | None, options: Mapping[str, Any]) -> None:
    """Refuse an output that cannot be written, before any work."""
    writer_for(output, page)
    if options and page != "gallery":
        raise UserError(f"{next(iter(options))}= goes with page=gallery.")
    if page == "gallery":
        check_options(**options)
    if Path(output).exists():
        raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
    if not Path(output).absolute().parent.is_dir():
        raise UserError(f"output={output}: no folder {Path(output).absolute().parent}. Create it first.")


def _read(
    input: str | Path, overrides: Sequence[str], skeleton: Skeleton, reading: ReadOptions | None = None
) -> PoseData:
    """Return the keypoints of files, or of a split of a data set."""
    use, colon, split = str(input).rpartition(":")
    if not colon or Path(input).exists():
        if overrides:
            raise UserError(
                f"'{overrides[0]}' goes with a data set, input=SET:SPLIT; input={input} is a file, which needs no more."
            )
        return load_file(input, skeleton, reading)
    if reading is not None and reading.set_names():
        raise UserError(f"{reading.set_names()[0]}= goes with files; a published set, input={input}, knows its own.")
    named = [f"data.name={use}"] if use in DATA_SETS else []
    if use not in DATA_SETS and ":" not in use:
        raise UserError(
            f"input={input}: no data set '{use}'.{did_you_mean(use, DATA_SETS)} Your own is file.py:Class:SPLIT; a "
            "file of keypoints has no colon in its name."
        )
    settings = load_settings(None, [*named, f"data.use={use}", *overrides])
    if not settings.data.name and settings.data.root is None:
        raise UserError(f"input={input}: say where its files are: data.root=FOLDER.")
    settings.data.train = split
    return load_split(settings, "train", skeleton)


# The command predict: its words, and what it says at the end.


def predict_command(words: Sequence[str]) -> None:
    """Lift what the words name, write it, and say what was done."""
    keys = keyed("predict", words, PREDICT_KEYS, ("run", "input", "output"), open_below=("data.options.",))
    weights = read_weights(keys["run"])
    _refuse_others(keys, weights.lifts == "masks")
    if weights.lifts == "masks":
        print("\n".join(_predict_shapes_lines(weights, keys)))
        return
    of_page: dict[str, Any] = {"images": keys["images"]} if "images" in keys else {}
    of_page |= {key: whole("predict", keys, key) for key in ("frames", "seed") if key in keys}
    size = {key: number("predict", keys, key) for key in SIZE_KEYS if key in keys and key != "bone"}
    if "bone" in keys:
        size["bone"] = tuple(name.strip() for name in keys["bone"].split(","))  # type: ignore[assignment]
    written: dict[Path, str] = {}
    found = predict(
        weights,
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
