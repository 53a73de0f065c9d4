"""The verb predict: keypoints in, poses out, in the format of the output's ending."""

from __future__ import annotations

from pathlib import Path

from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.model import load
from uplift.prediction import Prediction
from uplift.writers import write, writer_for

__all__ = ["predict"]


def predict(run: str | Path, input: str | Path, output: str | Path | None = None, *, refine: bool = True) -> Prediction:
    """Lift the keypoints of ``input`` with the model of ``run`` and write them to ``output``, if given.

    The frames of a clip are lifted together unless ``refine`` is off.

    Raises:
        UserError: no such run or input, joints that do not fit the model's skeleton, an output that
            exists already or has an unknown ending.
    """
    if output is not None:
        writer_for(output)
        if Path(output).exists():
            raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
        if not Path(output).absolute().parent.is_dir():
            raise UserError(f"output={output}: no folder {Path(output).absolute().parent}. Create it first.")
    model = load(run)
    data = load_file(input, model.skeleton)
    clean(data, model.skeleton)  # refuses a file with nothing to lift, before any work
    prediction = model.predict(data, title=Path(input).stem, refine=refine)
    if output is not None:
        write(prediction, output)
    return prediction
