"""The effect of hidden joints on the error of the visible joints, and the error of those filled in."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.common import Sheet, mean_and_range, text, write_json
from uplift.config.files import replacing
from uplift.errors import UserError

if TYPE_CHECKING:
    from uplift.data.poses import PoseData
    from uplift.models.model import Model
    from uplift.models.prediction import Prediction
    from uplift.skeleton import Skeleton

__all__ = ["LIMBS", "growth", "hidden_joints", "hide", "occlusion_table", "show", "write_occluded"]

LIMBS = {"no_arm": ("relbow", "rwrist"), "no_leg": ("rknee", "rankle")}
"""Joints hidden together; skipped for data without all of them."""

_FRACTION = 0.2
_ERRORS = ("p_mpjpe", "n_mpjpe")


def hidden_joints(names: Sequence[str], frames: int, root: str, seed: int = 0) -> dict[str, np.ndarray]:
    """Return the sets by name: (frames joints) bool, true where a joint is hidden.

    ``missing20`` hides each joint except the root with a probability of 20 %, ``missing20_root`` the root too;
    the others hide the limbs of `LIMBS`. Raises UserError if there is no joint ``root``.
    """
    names = [str(name) for name in names]
    if root not in names:
        raise UserError(f"no root joint '{root}' among {', '.join(names)}.")
    chance = np.random.default_rng(seed).random((frames, len(names))) < _FRACTION
    not_root = chance.copy()
    not_root[:, names.index(root)] = False
    sets = {"missing20": not_root, "missing20_root": chance}
    for limb, joints in LIMBS.items():
        if set(joints) <= set(names):
            sets[limb] = np.zeros_like(chance)
            sets[limb][:, [names.index(joint) for joint in joints]] = True
    return sets


def hide(keypoints: np.ndarray, confidence: np.ndarray | None, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints (frames joints 2) and confidence (frames joints) with 0 where ``hidden``."""
    if confidence is None:
        confidence = np.ones(hidden.shape, np.float32)
    keypoints = np.where(hidden[..., None], 0, keypoints).astype(keypoints.dtype)
    return keypoints, np.where(hidden, 0, confidence).astype(np.float32)


def write_occluded(test: str | Path, folder: str | Path, root: str = "hip", seed: int = 0) -> dict[str, Path]:
    """Write a copy of the npz ``test`` for each set of `hidden_joints` into ``folder``; return their paths."""
    with np.load(test, allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    keypoints, confidence = arrays["keypoints"], arrays.get("confidence")
    written = {}
    for name, hidden in hidden_joints(arrays["joint_names"], len(keypoints), root, seed).items():
        written[name] = Path(folder) / f"{Path(test).stem}_{name}.npz"
        arrays["keypoints"], arrays["confidence"] = hide(keypoints, confidence, hidden)
        with replacing(written[name]) as handle:
            np.savez(handle, **arrays)
    return written


def growth(run: str | Path, test: str | Path, occluded: str | Path, *, refine: bool | None = None) -> dict[str, float]:
    """Return the errors of a run's model on ``occluded``, compared with ``test``: the same frames with nothing hidden.

    ``p_mpjpe`` and ``n_mpjpe`` are means over the joints visible in ``occluded``, aligned on those only;
    ``*_complete`` is the same with everything visible, over the same joints; ``*_growth`` is their
    ratio. ``*_missing`` is the error of the hidden joints, ``*_missing_complete`` that of the same joints
    with nothing hidden. ``refine`` as in `uplift.predict`. Raises UserError if the frames differ.
    """
    from uplift.data.load import load_file
    from uplift.models.model import load

    model = load(run)
    complete, other = (load_file(path, model.skeleton) for path in (test, occluded))
    return _growth(complete, other, *(_predict(model, data, refine) for data in (complete, other)))


def _predict(model: Model, data: PoseData, refine: bool | None) -> Prediction:
    return model.predict(data) if refine is None else model.predict(data, refine=refine)


def _growth(
    original: PoseData, occluded: PoseData, of_original: Prediction, of_occluded: Prediction
) -> dict[str, float]:
    from uplift.metrics.evaluate import evaluate

    if len(original) != len(occluded):
        raise UserError(f"{occluded.source}: {len(occluded):,} frames, but {len(original):,} in {original.source}.")
    # Not cleaned: a root that was filled from its neighbours counts as hidden, not as visible.
    truth = replace(original, confidence=np.where(occluded.confidence > 0, original.confidence, 0))
    complete, hidden = (evaluate(found, truth, found.skeleton) for found in (of_original, of_occluded))
    if complete.frames != hidden.frames:
        raise UserError(f"{occluded.source}: {complete.frames - hidden.frames:,} frames can no longer be lifted.")
    found: dict[str, float] = {"frames": hidden.frames, "hidden": float((truth.confidence == 0).mean())}
    for name in _ERRORS:
        found |= {name: hidden.overall[name], f"{name}_complete": complete.overall[name]}
        found[f"{name}_growth"] = hidden.overall[name] / complete.overall[name]
        missing = f"{name}_missing"
        if missing in hidden.overall:
            found |= {missing: hidden.overall[missing], f"{missing}_complete": complete.overall[missing]}
    return found


def occlusion_table(
    run: str | Path, test: str | Path, seed: int = 0, *, refine: bool | None = None
) -> dict[str, dict[str, float]]:
    """Return `growth` for each set of `hidden_joints` of the file ``test``."""
    from uplift.data.load import load_file
    from uplift.models.model import load

    model = load(run)
    original = load_file(test, model.skeleton)
    of_original = _predict(model, original, refine)
    with tempfile.TemporaryDirectory() as folder:
        written = write_occluded(test, folder, _root_in(test, model.skeleton), seed)
        others = ((name, load_file(path, model.skeleton)) for name, path in written.items())
        return {name: _growth(original, other, of_original, _predict(model, other, refine)) for name, other in others}


def _root_in(test: str | Path, skeleton: Skeleton) -> str:
    """Return the skeleton's root as the file spells it, ignoring case."""
    with np.load(test, allow_pickle=False) as file:
        names = [str(name) for name in file["joint_names"]]
    return next((name for name in names if name.casefold() == skeleton.root.casefold()), skeleton.root)


def show(table: dict[str, dict[str, float]]) -> str:
    """Return the table as text: a row per set, visible joints compared with the same joints when nothing is hidden."""
    columns = {"complete": "_complete", "hidden": "", "growth": "_growth", "missing": "_missing"}
    head = ["occluded", *(f"{error} {column}" for error in _ERRORS for column in columns)]
    rows = [
        [name, *(mean_and_range([found.get(f"{error}{ending}")]) for error in _ERRORS for ending in columns.values())]
        for name, found in table.items()
    ]
    return text(Sheet("hidden joints", head, rows))


def main() -> int:
    """Print the table of a run on a test file; with ``--json`` also write it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.occlusion", description=__doc__)
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("test", metavar="TEST.npz")
    parser.add_argument("--seed", type=int, default=0, help="for the joints hidden at random")
    parser.add_argument("--refine", choices=("on", "off"), help="refine clips; default: as in the run")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the results to this file")
    given = parser.parse_args()
    try:
        refine = None if given.refine is None else given.refine == "on"
        table = occlusion_table(given.run, given.test, given.seed, refine=refine)
        if given.json:
            write_json(given.json, table)
    except UserError as error:
        print(f"occlusion: {error}", file=sys.stderr)
        return 2
    print(show(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
