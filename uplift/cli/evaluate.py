"""The verb evaluate: every metric of a run, or of poses from a file."""

from __future__ import annotations

import datetime
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.cli.kinds import KINDS
from uplift.cli.parsing import keyed, known_camera
from uplift.cli.verbs import CAMERA_KEYS, REFINE
from uplift.config.files import Existing, absolute, refuse_existing, replacing, shipped_names
from uplift.config.loading import load_settings
from uplift.config.progress import say
from uplift.config.run import RunFolder, Weights, data_id, read_weights
from uplift.config.trust import Trust, consents
from uplift.data.clean import clean
from uplift.data.formats.npz import camera_of, joint_names_of, refuse_other_axes, unit_of
from uplift.data.load import format_of_run, load_file, load_split
from uplift.data.load_masks import known_shapes, load_mask_split, load_masks
from uplift.data.masks import MaskData
from uplift.data.parsers.npz import CheckedArrays, read_arrays
from uplift.data.stream import load_training
from uplift.errors import UserError, listed
from uplift.metrics.baselines import score_with_baselines
from uplift.metrics.evaluate import evaluate as score
from uplift.metrics.evaluate import evaluate_model
from uplift.metrics.evaluate_shapes import evaluate_shapes
from uplift.metrics.report import AnyEvaluation, Evaluation, ShapeEvaluation
from uplift.metrics.scores import GivenPoses
from uplift.models.known_camera import KnownCamera
from uplift.models.prediction import ShapePrediction
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import match_joints

if TYPE_CHECKING:
    from uplift.models.model import Model, ShapeModel

__all__ = [
    "MOST", "evaluate", "evaluate_command", "evaluate_keypoints", "evaluate_masks",
    "evaluate_poses", "save_evaluation", "score_shapes",
]  # fmt: skip


@consents
def evaluate(
    run: str | Path | Weights,
    test: str | Path | None = None,
    *,
    refine: bool | str | None = None,
    hypotheses: int | None = None,
    items: int | None = None,
    camera: KnownCamera | None = None,
    accelerator: str | None = None,
    name: str | None = None,
    trust: Trust = None,
) -> Evaluation | ShapeEvaluation:
    """Evaluate a run on ``test``, or on the test data of its settings, and write evaluation.json into the run.

    A ready lifter, or a file without its run, needs ``test``, and nothing is written. The frames of a clip are lifted together unless ``refine`` is off. With ``hypotheses`` so many poses of each
    frame are judged beside the answer, with their probabilities. Of a run that lifts masks at most ``items`` are
    scored. ``camera`` is what is known of how the cameras stand, in place of estimates. ``accelerator`` is what computes, as for `predict`. The evaluation is kept in
    the run under ``name``, by default date and time. ``trust`` are
    files and modules of code that may run where the run names it.

    Raises:
        UserError: no such run, no truth to compare with, an argument that goes with the other kind of run, a name
            that is taken or cannot be one.
    """
    from uplift.models.model import load

    weights = run if isinstance(run, Weights) else read_weights(run)
    folder = weights.folder
    if name is not None:
        _check_name(folder, name, weights.run)
    if folder is None and test is None:
        raise UserError(f"{weights.run} is a lifter without a run, so without test data: give data.test=FILE.")
    kind = KINDS[weights.lifts]
    given = {"refine": refine, "hypotheses": hypotheses, "items": items, "camera": camera}
    given["accelerator"] = accelerator
    given = {key: value for key, value in given.items() if value is not None}
    kind.refuse_others("evaluate", given, weights.run)
    result = kind.evaluate(weights, load(weights), None if test is None else str(test), **given)
    if folder is not None:
        save_evaluation(result, folder, name)
    return result


def _check_name(folder: RunFolder | None, name: str, run: str) -> None:
    if folder is None:
        raise UserError(
            f"evaluation={name}: {run} is a lifter without a run, where evaluations are kept. Leave it out."
        )
    if not re.fullmatch(r"[^\W_][\w.-]{0,99}", name) or name.endswith(".json"):
        raise UserError(f"evaluation={name}: expected a name of letters, digits, '-', '_' and '.', such as stairs.")
    if (folder.evaluations / f"{name}.json").exists():
        raise UserError(f"evaluation={name}: {folder.path} has an evaluation of this name already. Choose another.")


def save_evaluation(result: AnyEvaluation, folder: RunFolder, name: str | None = None) -> None:
    """Write evaluation.json (always the newest), its CSV, and a copy under evaluations/, named by the time if unset."""
    text = json.dumps({**result.to_dict(), "data_id": data_id(result.data)}, indent=1).encode()
    older = folder.evaluations
    older.mkdir(exist_ok=True)
    stamp = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    for one in [name] if name else (f"{stamp}_{number}" for number in itertools.count(1)):
        try:
            refuse_existing(older / f"{one}.json")
            with replacing(older / f"{one}.json") as file:
                file.write(text)
            break
        except Existing:  # another evaluation of this second
            if name:
                raise
    with replacing(folder.path / "evaluation.json") as file:
        file.write(text)
    result.write_csv(folder.path / "evaluation.csv")


# A run that lifts keypoints: every protocol of poses.


def evaluate_keypoints(
    weights: Weights,
    model: Model,
    test: str | None,
    refine: bool | str = True,
    hypotheses: int = 0,
    camera: KnownCamera | None = None,
    accelerator: str = "auto",
) -> Evaluation:
    """Return the protocols of a run on ``test``, or on the test frames of its settings."""
    settings = weights.settings() or load_settings(None)
    if test is not None:
        settings.data.test = absolute(test)
        settings.data.format = format_of_run(settings, test)  # what is tested on may come from elsewhere
        settings.data.layout = None
    if test is not None or (settings.data.test and not settings.data.simulate):
        truth, _ = clean(load_split(settings, "test", model.skeleton), model.skeleton)
    else:
        truth = load_training(settings, model.skeleton).test
        if truth is None:
            raise UserError(f"{weights.run} has no test frames: give data.test=FILE.")
    name = truth.source if test is None else test
    return evaluate_model(model.on(accelerator), truth, name, refine=refine, hypotheses=hypotheses, camera=camera)


# A run that lifts masks: every metric of shapes, beside baselines where training shapes are known.

MOST = 100
"""Test items that are scored by default: each takes most of a second, with its baselines."""


def evaluate_masks(weights: Weights, model: ShapeModel, test: str | None, items: int = MOST) -> ShapeEvaluation:
    """Return the metrics of a run on at most ``items`` masks of ``test``, or of the test masks of its settings."""
    if items < 1:
        raise UserError(f"items={items}: expected how many masks are scored at most, 1 or more.")
    settings = weights.settings() or load_settings(None)
    if test is not None:
        format = format_of_run(settings, test)
        chosen = replace(settings.data, test=absolute(test), simulate=0, format=format, category=None)
        masks = load_mask_split(replace(settings, data=replace(chosen, images=None, most=None)), "test")
        settings.data.test = None
        train, why = None, ""
        try:
            train = load_mask_split(settings, "train")
        except UserError as error:
            why = f"the training masks could not be read: {str(error).splitlines()[0]}"
    else:
        loaded = load_masks(settings)
        if loaded.test is None:
            raise UserError(f"{weights.run} has no test masks: give data.test=FILE.")
        masks, train, why = loaded.test, loaded.train, ""
    *_, found = score_shapes(model, masks, train, most=items)
    return replace(found, notes=[*found.notes, why]) if why else found


def score_shapes(
    model: ShapeModel, test: MaskData, train: MaskData | None, title: str = "", most: int = MOST
) -> tuple[MaskData, ShapePrediction, ShapeEvaluation]:
    """Return at most ``most`` masks, their shapes and metrics, with baselines where ``train`` has true shapes.

    Raises UserError for test masks without true shapes.
    """
    if test.truth is None:
        where = test.source or "the test masks"
        raise UserError(f"{where}: no true shapes to compare with. `uplift data render` makes masks with truth.")
    notes = []
    if len(test) > most:
        rows = np.sort(np.random.default_rng(0).choice(len(test), most, replace=False))
        notes.append(f"{most:,} of {len(test):,} test masks were scored: a fixed random choice (items={most})")
        test = test.select(rows)
    prediction = model.predict(test.without_truth(), title=title)
    known = None if train is None else known_shapes(train)
    if known is None:
        notes.append("no baselines: they are made of true training shapes, and none are known")
        found = evaluate_shapes(prediction, test.truth, test.masks, test.source, test.category)  # type: ignore[arg-type]
    else:
        found = score_with_baselines(prediction, known, test, test.source)
    return test, prediction, replace(found, notes=[*found.notes, *notes])


# Poses of any origin, from a file.

_IDENTITY = ("subject", "action", "sequence", "camera", "frame")
_READ = (
    "pose", "joint_names", "unit", "tilt_deg", "roll_deg", "gravity", "uncertainty", "spread", "hypotheses", "weights",
    "axes", *_IDENTITY,
)  # fmt: skip


def evaluate_poses(poses: str | Path, test: str | Path, skeleton: str | None = None) -> Evaluation:
    """Evaluate poses of any origin: an npz with `pose` and `joint_names`, rows as in ``test``.

    Raises UserError for another file, or other joints or frames than the truth.
    """
    arrays = read_arrays(poses, _READ)
    refuse_other_axes(str(poses), arrays)
    for key in ("pose", "joint_names"):
        if key not in arrays:
            raise UserError(f"{poses}: no array '{key}' (found: {listed(sorted(arrays)) or 'none that is needed'}).")
    names = joint_names_of(str(poses), arrays)
    chosen = load_skeleton(skeleton) if skeleton else _skeleton_of(names, str(poses))
    pose = _numbers(str(poses), arrays, "pose", (None, len(names), 3))
    assert pose is not None
    tilt_deg, gravity = camera_of(CheckedArrays(str(poses), arrays), len(pose))
    uncertainty = "spread" if "spread" in arrays else "uncertainty"  # its name before
    given = GivenPoses(
        pose=pose.astype(np.float64),
        joint_names=names,
        unit=unit_of(str(poses), arrays, "relative"),
        tilt_deg=tilt_deg,
        gravity=gravity,
        hypotheses=arrays.get("hypotheses"),
        weights=arrays.get("weights"),
        uncertainty=_numbers(str(poses), arrays, uncertainty, (len(pose), len(names))),
        identity=_identity(str(poses), arrays, len(pose)),
        source=str(poses),
    )
    truth, _ = clean(load_file(test, chosen), chosen, drop=False)
    if truth.pose is None:
        raise UserError(f"{test}: holds no 'pose' (frames, joints, 3) to compare with.")
    return score(given, truth, chosen, str(test))


def _numbers(where: str, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
    """Return an array of ``shape`` (None: any number of frames), None where it is not there; raises UserError for another."""
    found = arrays.get(key)
    if found is None:
        return None
    fits = found.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, found.shape, strict=True))
    if not fits or found.dtype.kind not in "fiu":
        expected = str(shape).replace("None", "frames")
        raise UserError(f"{where}: '{key}' is {found.dtype} of shape {found.shape}, expected numbers {expected}.")
    return found


def _identity(where: str, arrays: dict[str, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    found = {key: arrays[key] for key in _IDENTITY if key in arrays}
    for key, values in found.items():
        if values.shape not in ((), (frames,)):
            raise UserError(f"{where}: '{key}' has shape {values.shape}, expected ({frames},).")
    return {key: np.broadcast_to(values, frames) for key, values in found.items()}


def _skeleton_of(names: tuple[str, ...], where: str) -> Skeleton:
    """Return the shipped skeleton with exactly these joints."""
    for name in shipped_names("skeletons"):
        skeleton = load_skeleton(name)
        if set(skeleton.joints) == set(names):
            return skeleton
    for name in shipped_names("skeletons"):
        skeleton = load_skeleton(name)
        try:
            match_joints(names, skeleton)
        except UserError:
            continue
        raise UserError(
            f"{where}: no shipped skeleton has exactly its joints; they fit '{name}': give skeleton={name}."
        )
    raise UserError(f"{where}: no shipped skeleton has its joints ({listed(names)}): give skeleton=FILE.yaml.")


# The command line.


def evaluate_command(words: Sequence[str]) -> None:
    """Evaluate a run or poses and print all figures."""
    keys = keyed("evaluate", words)
    if ("run" in keys) == ("poses" in keys):
        raise UserError("evaluate takes run=RUN or poses=FILE. (uplift evaluate --help)")
    if "poses" in keys:
        for key in [
            key for key in ("refine", "accelerator", "hypotheses", "items", "evaluation", *CAMERA_KEYS) if key in keys
        ]:
            raise UserError(f"evaluate poses=FILE takes the poses as they are: {key}= goes with run=.")
        if "data.test" not in keys:
            raise UserError("evaluate poses=FILE needs data.test=FILE with the true poses.")
        print(evaluate_poses(keys["poses"], keys["data.test"], keys.get("skeleton")).table())
        return
    if "skeleton" in keys:
        raise UserError("evaluate run=...: the run knows its skeleton; skeleton= goes with poses=.")
    refine = keys.given("refine").get("refine")
    options: dict[str, Any] = keys.given("accelerator", "hypotheses", "items") | {"name": keys.get("evaluation")}
    refined, camera = None if refine is None else REFINE[refine], known_camera(keys)
    weights = read_weights(keys["run"])
    say(evaluate(weights, keys.get("data.test"), refine=refined, camera=camera, **options).table())
    if weights.folder is None:
        say(f"\n{weights.note or f'lifter: {weights.path}'}: it has no run in which the figures could be kept")
        return
    folder = weights.folder.path
    say(f"\nwrote {folder}/evaluation.json and evaluation.csv (older ones: evaluations/)")
    say(f"next: uplift compare {folder} OTHER_RUN")
