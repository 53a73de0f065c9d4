"""The verb predict: keypoints in, poses out, in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uplift.data.clean import clean
from uplift.data.container import PoseData
from uplift.data.load import load_file, load_split
from uplift.datasets import DATA_SETS
from uplift.errors import UserError, did_you_mean
from uplift.model import load
from uplift.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.task import load_settings
from uplift.writers import write, writer_for
from uplift.writers.gallery import check_options

__all__ = ["predict"]


def predict(
    run: str | Path,
    input: str | Path,
    output: str | Path | None = None,
    *overrides: str,
    refine: bool = True,
    page: str | None = None,
    **options: Any,
) -> Prediction:
    """Lift the keypoints of ``input`` with the model of ``run`` and write them to ``output``, if given.

    ``input`` is a file, or ``SET:SPLIT`` of a published data set (``file.py:Class:SPLIT`` of one's own), whose
    ``data.root`` and ``data.options.*`` are ``overrides`` such as a fit takes. The frames of a clip are lifted
    together unless ``refine`` is off. ``page`` is the kind of an .html, ``viewer`` or ``gallery``, and ``options``
    are those of its writer.

    Raises:
        UserError: no such run or input, joints that do not fit the model's skeleton, an output that
            exists already or has an unknown ending.
    """
    if output is not None:
        writer_for(output, page)
        if options and page != "gallery":
            raise UserError(f"{next(iter(options))}= goes with page=gallery.")
        if page == "gallery":
            check_options(**options)
        if Path(output).exists():
            raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
        if not Path(output).absolute().parent.is_dir():
            raise UserError(f"output={output}: no folder {Path(output).absolute().parent}. Create it first.")
    model = load(run)
    data = _read(input, overrides, model.skeleton)
    clean(data, model.skeleton)  # refuses a file with nothing to lift, before any work
    prediction = model.predict(data, title=Path(input).stem, refine=refine)
    if output is not None:
        write(prediction, output, page, **options)
    return prediction


def _read(input: str | Path, overrides: Sequence[str], skeleton: Skeleton) -> PoseData:
    """Return the keypoints of a file, or of a split of a data set."""
    use, colon, split = str(input).rpartition(":")
    if not colon or Path(input).exists():
        if overrides:
            raise UserError(
                f"'{overrides[0]}' goes with a data set, input=SET:SPLIT; input={input} is a file, which needs no more."
            )
        return load_file(input, skeleton)
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
