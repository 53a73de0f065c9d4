"""The verb predict: keypoints in, poses out (or masks in, shapes out), in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uplift.axes import AXES, in_axes
from uplift.data.clean import clean
from uplift.data.container import PoseData
from uplift.data.load import load_file, load_split
from uplift.datasets import DATA_SETS
from uplift.errors import UserError, did_you_mean
from uplift.model import load_poses
from uplift.prediction import Prediction
from uplift.readers import ReadOptions
from uplift.sizing import size_from
from uplift.skeleton import Skeleton
from uplift.task import load_settings
from uplift.weights import lifts_masks
from uplift.writers import write, writer_for
from uplift.writers.gallery import check_options

if TYPE_CHECKING:
    from uplift.shapes.prediction import ShapePrediction

__all__ = ["predict"]


def predict(
    run: str | Path,
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
    together unless ``refine`` is off. ``size`` are arguments of `uplift.sizing.size_from`. ``axes`` are those of
    `uplift.axes`, those usual for the format where not given. ``page`` is the kind of an .html, ``viewer`` or
    ``gallery``, and ``options`` are those of its writer. The files written, with a word on each, are added to ``written``.
    With a run that lifts masks this is `uplift.verbs.predict_shapes.predict_shapes`, ``size`` among its options.

    Raises:
        UserError: no such run or input, joints that do not fit the model's skeleton, an output that
            exists already or has an unknown ending.
    """
    if lifts_masks(run):
        if overrides or not refine or constant_bones or reading is not None:
            raise UserError(f"{run} lifts masks: overrides, refine, constant_bones and reading go with keypoints.")
        from uplift.verbs.predict_shapes import predict_shapes

        told = {**options, **(size or {}), **({} if axes is None else {"axes": axes})}
        return predict_shapes(run, input, output, page=page, written=written, **told)
    if axes is not None and axes not in AXES:
        raise UserError(f"axes={axes}: no such axes.{did_you_mean(axes, AXES)}")
    if output is not None:
        _check_output(output, page, options)
    model = load_poses(run)
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
