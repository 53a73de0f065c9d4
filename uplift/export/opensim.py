"""One body as OpenSim takes it: the scaled model, its markers, the inverse kinematics and what runs them again."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import refuse_existing, replacing
from uplift.config.progress import progress
from uplift.errors import UserError
from uplift.export.clips import one_body
from uplift.export.human_model import HumanModel, human_model, model_xml
from uplift.export.markers import Trial, trial_of, write_trc
from uplift.models.prediction import Prediction

__all__ = ["beside_model", "write_opensim"]

_NOISE_MM = 20.0
"""Of a joint that is seen: joints that are less sure than this weigh less."""
_KEEP_STILL = 1e-6
"""Weight, m2/rad2, that holds angles near 0 where markers do not show them: the turn of a stretched limb about itself."""


def beside_model(path: str | Path) -> list[Path]:
    """Return the files that are written beside a model ``path``: markers, set-up, motion, and errors of the markers."""
    path = Path(path)
    return [path.with_name(f"{path.stem}{end}") for end in (".trc", "_ik.xml", "_ik.mot", "_ik_marker_errors.sto")]


def write_opensim(
    prediction: Prediction, path: str | Path, individual: str | None = None, mass_kg: float | None = None
) -> str:
    """Write the scaled model of one body, run OpenSim's inverse kinematics, and return how near the markers come.

    ``path`` is the model, ``.osim``; beside it go the files of `beside_model`. Poses are in mm with y up, a clip of one
    body, ``individual`` of several. The model is `uplift.export.human_model.human_model`, ``mass_kg`` heavy. Frames without a pose are blank in the
    markers and left out of the motion. Angles are in degrees, places in metres.

    Raises:
        UserError: without opensim, as `uplift.export.markers.write_trc` and `human_model`, one of the files exists, or
            OpenSim cannot solve it.
    """
    _refuse_without_library(path)
    trial = trial_of(prediction, path, individual, "OpenSim's model")
    path = Path(path)
    for file in beside_model(path):
        refuse_existing(file)
    clip = one_body(prediction, path, individual)
    model = human_model(prediction.skeleton, prediction.joint_names, trial.points, mass_kg or 70.0)
    model = _renamed(model, dict(zip(prediction.joint_names, trial.names, strict=True)))
    weights = _weights(prediction, clip.rows, trial)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / file.name for file in (path, *beside_model(path))]
        about = f"{prediction.skeleton.name}: lengths by uplift from 2D keypoints; masses: de Leva 1996, J Biomech 29"
        files[0].write_bytes(model_xml(model, path.stem, about))
        write_trc(prediction, files[1], individual)
        files[2].write_bytes(_setup(model, files, weights, trial))
        _run(files, path, len(trial.points))
        blank = _without_blanks(files[3], trial)
        _without_blanks(files[4], trial)
        errors = _errors_mm(files[4])
        with ExitStack() as stack:
            for file, target in zip(files, (path, *beside_model(path)), strict=True):
                handle = stack.enter_context(replacing(target))
                with file.open("rb") as written:
                    shutil.copyfileobj(written, handle)
    return _remark(path, errors, blank, model)


def _refuse_without_library(path: str | Path) -> None:
    if importlib.util.find_spec("opensim") is None:
        raise UserError(f'{path}: inverse kinematics needs OpenSim: pip install "uplift3d[opensim]".')


def _renamed(model: HumanModel, names: dict[str, str]) -> HumanModel:
    """Return the model with its markers by the names of the marker file."""
    markers = {names[joint]: place for joint, place in model.markers.items()}
    return HumanModel(model.segments, model.shifts, markers, model.unseen)


def _weights(prediction: Prediction, rows: np.ndarray, trial: Trial) -> dict[str, float]:
    """Return the weight of each marker, 1 for the surest: by the median of its uncertainty and the noise of any."""
    if prediction.uncertainty is None:
        return dict.fromkeys(trial.names, 1.0)
    sigma = np.nan_to_num(prediction.uncertainty[rows].astype(float), nan=np.inf)
    found = 1 / (_NOISE_MM**2 + np.median(sigma, axis=0) ** 2)
    found = found / found.max() if found.max() > 0 else np.ones(len(found))
    return dict(zip(trial.names, found.tolist(), strict=True))


# Inverse kinematics.


def _setup(model: HumanModel, files: list[Path], weights: dict[str, float], trial: Trial) -> bytes:
    """Return the set-up of OpenSim's Inverse Kinematics Tool, with the names of files in the same folder."""
    root = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(root, "InverseKinematicsTool", name=f"{files[0].stem}")
    ends = trial.start / trial.fps, (trial.start + len(trial.points) - 1) / trial.fps
    facts = {
        "results_directory": "./", "model_file": files[0].name, "constraint_weight": "Inf", "accuracy": "1e-6",
        "time_range": f"{ends[0]:.6f} {ends[1]:.6f}", "output_motion_file": files[3].name, "report_errors": "true",
        "marker_file": files[1].name,
    }  # fmt: skip
    for tag, text in facts.items():
        ET.SubElement(tool, tag).text = text
    tasks = ET.SubElement(ET.SubElement(tool, "IKTaskSet"), "objects")
    for marker in model.markers:
        task = ET.SubElement(tasks, "IKMarkerTask", name=marker)
        ET.SubElement(task, "apply").text = "true"
        ET.SubElement(task, "weight").text = f"{weights[marker]:.4g}"
    for segment in model.segments:
        for turn in filter(None, segment.turns if segment.parent else ()):
            task = ET.SubElement(tasks, "IKCoordinateTask", name=turn.name)
            ET.SubElement(task, "apply").text = "true"
            ET.SubElement(task, "weight").text = f"{_KEEP_STILL:g}"
            ET.SubElement(task, "value_type").text = "default_value"
    ET.indent(root, "\t")
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


_TOOL = "import opensim, sys; sys.exit(not opensim.InverseKinematicsTool(sys.argv[1]).run())"


def _run(files: list[Path], path: Path, frames: int) -> None:
    """Run the tool as its set-up file says; raises UserError with OpenSim's reason.

    In a process of its own: OpenSim's libraries and torch's end in a crash when one process has both, and the tool
    logs into the folder that it runs in.
    """
    command = [sys.executable, "-c", _TOOL, files[2].name]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
    last = ""
    with subprocess.Popen(command, cwd=files[2].parent, **pipes) as tool:  # type: ignore[call-overload]
        try:
            for line in progress(_frames(tool.stdout), "inverse kinematics", frames):
                last = line
        except BaseException:
            tool.kill()
            raise
    if tool.returncode or not files[3].is_file():
        raise UserError(f"{path}: OpenSim's inverse kinematics stopped (status {tool.returncode}): {last[:300]}")


def _frames(output: Iterable[str]) -> Iterator[str]:
    """Yield what is said of each frame, and at the end what was said last of an error, or at all."""
    last = error = ""
    for line in map(str.strip, output):
        if line.startswith("[info] Frame "):
            yield line
        error = line if "rror" in line or "xception" in line else error
        last = line or last
    yield error or last


def _table(file: Path) -> tuple[list[str], list[str], Float[np.ndarray, "rows columns"]]:
    """Return the header, the names of the columns and the numbers of a ``.mot`` or ``.sto``."""
    lines = file.read_text().splitlines()
    start = lines.index("endheader") + 1
    numbers = [[float(cell) for cell in line.split()] for line in lines[start + 1 :] if line.strip()]
    return lines[:start], lines[start].split(), np.array(numbers)


def _without_blanks(file: Path, trial: Trial) -> int:
    """Take out the rows of moments without markers, in which OpenSim repeats what was before, and return how many."""
    blank = ~np.isfinite(trial.points).all(-1).any(1)
    if not blank.any():
        return 0
    head, columns, numbers = _table(file)
    moment = np.rint(numbers[:, 0] * trial.fps).astype(int) - trial.start
    kept = numbers[~blank[np.clip(moment, 0, len(blank) - 1)]]
    head = [f"nRows={len(kept)}" if line.startswith("nRows=") else line for line in head]
    rows = ["\t".join(f"{value:.8f}" for value in row) for row in kept]
    file.write_text("\n".join([*head, "\t".join(columns), *rows, ""]))
    return len(numbers) - len(kept)


def _errors_mm(file: Path) -> tuple[float, float]:
    """Return the RMS and the largest of the errors of all markers in all frames, mm."""
    _, columns, numbers = _table(file)
    rms, largest = (numbers[:, columns.index(name)] * 1000 for name in ("marker_error_RMS", "marker_error_max"))
    return float(np.sqrt(np.mean(rms**2))), float(largest.max())


def _remark(path: Path, errors: tuple[float, float], blank: int, model: HumanModel) -> str:
    files = ", ".join(file.name for file in beside_model(path))
    parts = [f"with {files}", f"marker errors {errors[0]:.0f} mm RMS, {errors[1]:.0f} mm at most"]
    if blank:
        parts.append(f"{blank:,} frames without a pose are not in the motion")
    if model.unseen:
        names = dict.fromkeys(name.removesuffix("_r").removesuffix("_l") for name in model.unseen)
        parts.append(f"left out, as these joints do not show them: {', '.join(names)}")
    return "; ".join(parts)
