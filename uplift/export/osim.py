"""One body as OpenSim takes it: the scaled model, its markers, the inverse kinematics and what runs them again."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, refuse_existing, replacing
from uplift.config.progress import progress
from uplift.errors import UserError
from uplift.export.clips import one_body
from uplift.export.human_model import Coordinate, HumanModel, human_model, model_xml
from uplift.export.markers import Trial, trial_of, write_trc
from uplift.export.scene import held
from uplift.models.prediction import Prediction

__all__ = ["beside_model", "check_beside", "write_opensim"]

_NOISE_MM = 20.0
"""Of a joint that is seen: joints that are less sure than this weigh less."""
_KEEP_STILL = 1e-7
"""Weight, m2/rad2, that holds angles near 0 where markers do not show them: the turn of a straight limb about itself."""
_ACCURACY = 1e-6
_MASS_KG = 70.0


def beside_model(path: str | Path) -> list[Path]:
    """Return the files that are written beside a model ``path``: markers, motion, errors of the markers, set-up."""
    path = Path(path)
    return [path.with_name(f"{path.stem}{end}") for end in (".trc", "_ik.mot", "_ik_marker_errors.sto", "_ik.xml")]


def check_beside(path: str | Path) -> None:
    """Raise UserError where a file that goes beside the model ``path`` exists."""
    for file in beside_model(path):
        refuse_existing(file)


def write_opensim(
    prediction: Prediction, path: str | Path, individual: str | None = None, mass_kg: float | None = None
) -> str:
    """Write the scaled model of one body, run OpenSim's inverse kinematics, and return how near the markers come.

    ``path`` is the model, ``.osim``; beside it go the files of `beside_model`. Poses are in mm with y up, a clip of one
    body, ``individual`` of several. The model is `uplift.export.human_model.human_model`, ``mass_kg`` heavy. Frames
    without a pose are blank in the markers and left out of the motion. Angles are in degrees, places in metres.

    Raises:
        UserError: as `uplift.export.markers.write_trc` and `human_model`, one of the files exists, or
            OpenSim cannot solve it.
    """
    check_beside(path)
    trial = trial_of(prediction, path, individual, "OpenSim's model")
    path = Path(path)
    model = _model_of(prediction, trial, path, mass_kg or _MASS_KG)
    weights = _weights(prediction, one_body(prediction, path, individual).rows, trial)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / file.name for file in (path, *beside_model(path))]
        about = f"{prediction.skeleton.name}: lengths by uplift from 2D keypoints; masses: de Leva 1996, J Biomech 29"
        files[0].write_bytes(model_xml(model, path.stem, about))
        write_trc(prediction, files[1], individual)
        motion = _solve(model, files, weights, trial, path)
        files[2].write_bytes(_motion_text(model, motion))
        files[3].write_bytes(_errors_text(motion))
        files[4].write_bytes(_setup(model, files, weights, motion))
        with ExitStack() as stack:
            for file, target in zip(files, (path, *beside_model(path)), strict=True):
                stack.enter_context(replacing(target)).write(file.read_bytes())
    return _remark(path, motion, len(trial.points), model)


def _model_of(prediction: Prediction, trial: Trial, path: Path, mass_kg: float) -> HumanModel:
    """Return the model with its markers by the names of the marker file; raises UserError for a name that none can have."""
    if odd := [name for name in trial.names if set(name) & set("\\*+/")]:
        raise UserError(
            f"{path}: the joint {odd[0]!r} cannot be a marker of OpenSim, whose names have no \\ * + or /. Rename it in the "
            "skeleton's YAML, and add its old name under `from:`."
        )
    model = human_model(prediction.skeleton, prediction.joint_names, trial.points, mass_kg)
    names = dict(zip(prediction.joint_names, trial.names, strict=True))
    return replace(model, markers={names[joint]: place for joint, place in model.markers.items()})


def _weights(prediction: Prediction, rows: np.ndarray, trial: Trial) -> dict[str, float]:
    """Return the weight of each marker, 1 for the surest: by the median of its uncertainty and the noise of any."""
    if prediction.uncertainty is None:
        return dict.fromkeys(trial.names, 1.0)
    sigma = np.nan_to_num(prediction.uncertainty[rows].astype(float), nan=np.inf)
    found = 1 / (_NOISE_MM**2 + np.median(sigma, axis=0) ** 2)
    found = found / found.max() if found.max() > 0 else np.ones(len(found))
    return dict(zip(trial.names, found.tolist(), strict=True))


# Inverse kinematics.


class _Motion(NamedTuple):
    """What was solved: ``values`` are radians and metres in the order of ``names``, ``errors`` metres, NaN of blank markers."""

    time: Float[np.ndarray, " frames"]
    names: tuple[str, ...]
    values: Float[np.ndarray, "frames coordinates"]
    errors: Float[np.ndarray, "frames markers"]
    markers: tuple[str, ...]


def _coordinates(model: HumanModel) -> list[Coordinate]:
    """Return all coordinates of the model, those of the pelvis's place first."""
    return [*model.shifts, *(turn for segment in model.segments for turn in segment.turns if turn)]


def _solve(model: HumanModel, files: list[Path], weights: dict[str, float], trial: Trial, path: Path) -> _Motion:
    """Return the solution of every frame that has a pose; raises UserError with OpenSim's reason.

    In a process of its own: OpenSim's libraries and torch's end in a crash when one process has both.
    """
    coordinates = _coordinates(model)
    # A frame without a pose has no solution; one that lacks a joint starts there as the frame before.
    start = np.concatenate([held(one.start[:, None]) * (1.0 if one.metres else np.pi / 180) for one in coordinates], 1)
    posed = np.flatnonzero(np.isfinite(trial.points).all(2).sum(1))
    # Times are rounded as in the marker file: OpenSim refuses one that is a fraction of a microsecond after the last.
    job = {
        "model": files[0].name, "markers": files[1].name, "accuracy": _ACCURACY,
        "weights": {marker: weights[marker] for marker in model.markers},
        "still": {one.name: _KEEP_STILL for one in coordinates if not one.name.startswith("pelvis")},
        "coordinates": [one.name for one in coordinates],
        "start": start[posed].tolist(), "times": np.round((trial.start + posed) / trial.fps, 6).tolist(),
    }  # fmt: skip
    _run(job, files[0].parent, path)
    values, errors = (np.load(files[0].with_name(f"{name}.npy")) for name in ("values", "errors"))
    return _Motion(np.array(job["times"]), tuple(job["coordinates"]), values, errors, tuple(model.markers))


def _run(job: dict[str, Any], folder: Path, path: Path) -> None:
    (folder / "job.json").write_text(json.dumps(job))
    # -P: its folder has files with the names of other modules, such as html.py.
    command = [sys.executable, "-P", str(Path(__file__).parent / "assets" / "osim_solver.py"), "job.json"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
    said: list[str] = []
    with subprocess.Popen(command, cwd=folder, **pipes) as program:
        try:
            for _ in progress(_solved(program.stdout or (), said), "inverse kinematics", len(job["times"])):
                pass
        except BaseException:
            program.kill()
            raise
    if program.returncode:
        raise UserError(
            f"{path}: OpenSim's inverse kinematics stopped (status {program.returncode}): "
            f"{' '.join(said[-3:])[:300] or 'it gave no reason'}"
        )


def _solved(output: Iterable[str], said: list[str]) -> Iterator[None]:
    """Yield for every frame that is solved, and put what else is said into ``said``."""
    for line in map(str.strip, output):
        if line == "solved":
            yield
        elif line.strip("^ "):  # no underlining of a traceback
            said.append(line)


# What is written beside the model and its markers.


def _motion_text(model: HumanModel, motion: _Motion) -> bytes:
    """Return OpenSim's motion file: degrees and metres."""
    unit = np.array([1.0 if one.metres else 180 / np.pi for one in _coordinates(model)])
    head = [
        "Coordinates",
        "version=1",
        *_size(motion, len(unit)),
        "inDegrees=yes",
        "",
        "Units are S.I. units (second, meters, Newtons, ...)",
    ]
    head += ["Angles are in degrees.", "", "endheader"]
    return _table(head, motion.names, motion.time, motion.values * unit)


def _errors_text(motion: _Motion) -> bytes:
    """Return the errors of the markers as OpenSim's tool writes them: metres."""
    squared = motion.errors**2
    columns = np.stack([np.nansum(squared, 1), np.sqrt(np.nanmean(squared, 1)), np.nanmax(motion.errors, 1)], 1)
    head = ["Model Marker Errors from IK", "version=1", *_size(motion, 3), "inDegrees=no", "endheader"]
    return _table(head, ("total_squared_error", "marker_error_RMS", "marker_error_max"), motion.time, columns)


def _size(motion: _Motion, columns: int) -> list[str]:
    return [f"nRows={len(motion.time)}", f"nColumns={columns + 1}"]


def _table(head: Sequence[str], names: Sequence[str], time: np.ndarray, columns: np.ndarray) -> bytes:
    rows = [
        "\t".join([f"{when:.6f}", *(f"{value + 0.0:.8f}" for value in row)])
        for when, row in zip(time, columns, strict=True)
    ]
    return as_bytes("\n".join([*head, "\t".join(["time", *names]), *rows, ""]))


def _setup(model: HumanModel, files: list[Path], weights: dict[str, float], motion: _Motion) -> bytes:
    """Return the set-up of OpenSim's Inverse Kinematics Tool, with the names of files in the same folder."""
    root = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(root, "InverseKinematicsTool", name=f"{files[0].stem}_again")
    facts = {
        "results_directory": "./", "model_file": files[0].name, "constraint_weight": "Inf", "accuracy": f"{_ACCURACY:g}",
        "time_range": f"{motion.time[0]:.6f} {motion.time[-1]:.6f}", "output_motion_file": f"{files[0].stem}_again_ik.mot",
        "report_errors": "true", "marker_file": files[1].name,
    }  # fmt: skip
    tasks = [("IKMarkerTask", marker, {"weight": f"{weights[marker]:.4g}"}) for marker in model.markers]
    still = {"weight": f"{_KEEP_STILL:g}", "value_type": "manual_value", "value": "0"}
    turns = [name for name in motion.names if not name.startswith("pelvis")]
    tasks += [("IKCoordinateTask", name, still) for name in turns]
    for tag, text in facts.items():
        ET.SubElement(tool, tag).text = text
    objects = ET.SubElement(ET.SubElement(tool, "IKTaskSet"), "objects")
    for kind, name, more in tasks:
        task = ET.SubElement(objects, kind, name=name)
        for tag, text in {"apply": "true", **more}.items():
            ET.SubElement(task, tag).text = text
    ET.indent(root, "\t")
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _remark(path: Path, motion: _Motion, moments: int, model: HumanModel) -> str:
    errors = 1000 * motion.errors
    worst = motion.markers[int(np.nanmax(errors, 0).argmax())]
    parts = [
        f"with {', '.join(file.name for file in beside_model(path))}",
        f"marker errors {np.sqrt(np.nanmean(errors**2)):.0f} mm RMS, {np.nanmax(errors):.0f} mm at most ({worst})",
    ]
    if blank := moments - len(motion.time):
        parts.append(f"frames without a pose, which are not in the motion: {blank:,}")
    if model.unseen:
        names = dict.fromkeys(name.removesuffix("_r").removesuffix("_l") for name in model.unseen)
        parts.append(f"left out, as these joints do not show them: {', '.join(names)}")
    return "; ".join(parts)
