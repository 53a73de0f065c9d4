"""What hiding joints costs: the error of the joints that stay visible, and of those that are filled in."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uplift.config.files import replacing
from uplift.errors import UserError

if TYPE_CHECKING:
    from uplift.data.poses import PoseData
    from uplift.models.model import Model
    from uplift.models.prediction import Prediction
    from uplift.skeleton import Skeleton

__all__ = ["LIMBS", "growth", "hidden_joints", "hide", "occlusion_table", "show", "write_occluded"]

LIMBS = {"no_arm": ("relbow", "rwrist"), "no_leg": ("rknee", "rankle")}
"""Joints hidden together; data without all of them has no such set."""

_SHARE = 0.2
_ERRORS = ("p_mpjpe", "n_mpjpe")


def hidden_joints(names: Sequence[str], frames: int, root: str, seed: int = 0) -> dict[str, np.ndarray]:
    """Return the sets by name: (frames joints) bool, true where a joint is hidden.

    ``missing20`` hides each joint but the root with a chance of 20 %, ``missing20_root`` the root too;
    then the limbs of `LIMBS`. Raises UserError where there is no joint ``root``.
    """
    names = [str(name) for name in names]
    if root not in names:
        raise UserError(f"no joint '{root}' to take as the root among {', '.join(names)}.")
    chance = np.random.default_rng(seed).random((frames, len(names))) < _SHARE
    kept = chance.copy()
    kept[:, names.index(root)] = False
    sets = {"missing20": kept, "missing20_root": chance}
    for limb, joints in LIMBS.items():
        if set(joints) <= set(names):
            sets[limb] = np.zeros_like(chance)
            sets[limb][:, [names.index(joint) for joint in joints]] = True
    return sets


def hide(keypoints: np.ndarray, confidence: np.ndarray | None, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints (frames joints 2) and confidence (frames joints) with 0 where ``hidden``."""
    if confidence is None:
        confidence = np.ones(hidden.shape, np.float32)
    return np.where(hidden[..., None], 0, keypoints).astype(keypoints.dtype), np.where(hidden, 0, confidence).astype(
        np.float32
    )


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
    """Return what it costs a run's model to see ``occluded`` in place of ``test``: the same frames with joints hidden.

    ``p_mpjpe`` and ``n_mpjpe`` are means over the joints visible in ``occluded`` and aligned on those
    alone; ``*_complete`` the same with everything visible, over the same joints; ``*_growth`` is their
    ratio. ``*_missing`` is the error of the hidden joints, ``*_missing_complete`` of the same joints
    where nothing was hidden. ``refine`` as in `uplift.predict`. Raises UserError where the two files
    are not of the same frames.
    """
    from uplift.data.load import load_file
    from uplift.models.model import load

    model = load(run)
    whole, other = (load_file(path, model.skeleton) for path in (test, occluded))
    return _growth(whole, other, *(_predict(model, data, refine) for data in (whole, other)))


def _predict(model: Model, data: PoseData, refine: bool | None) -> Prediction:
    return model.predict(data) if refine is None else model.predict(data, refine=refine)


def _growth(whole: PoseData, occluded: PoseData, of_whole: Prediction, of_occluded: Prediction) -> dict[str, float]:
    from uplift.metrics.evaluate import evaluate

    if len(whole) != len(occluded):
        raise UserError(f"{occluded.source}: {len(occluded):,} frames, but {len(whole):,} in {whole.source}.")
    # Not cleaned: a root that was filled from its neighbours counts as hidden, not as visible.
    truth = replace(whole, confidence=np.where(occluded.confidence > 0, whole.confidence, 0))
    complete, hidden = (evaluate(found, truth, found.skeleton) for found in (of_whole, of_occluded))
    if complete.frames != hidden.frames:
        raise UserError(f"{occluded.source}: {complete.frames - hidden.frames:,} frames cannot be lifted any more.")
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
    whole = load_file(test, model.skeleton)
    of_whole = _predict(model, whole, refine)
    with tempfile.TemporaryDirectory() as folder:
        written = write_occluded(test, folder, _root_in(test, model.skeleton), seed)
        others = ((name, load_file(path, model.skeleton)) for name, path in written.items())
        return {name: _growth(whole, other, of_whole, _predict(model, other, refine)) for name, other in others}


def _root_in(test: str | Path, skeleton: Skeleton) -> str:
    """Return the file's own name of the skeleton's root: the same but for capitals."""
    with np.load(test, allow_pickle=False) as file:
        names = [str(name) for name in file["joint_names"]]
    return next((name for name in names if name.casefold() == skeleton.root.casefold()), skeleton.root)


def show(table: dict[str, dict[str, float]]) -> str:
    """Return the table as text: a row for each set, visible joints against the same with nothing hidden."""
    head = [f"{error} {column}" for error in _ERRORS for column in ("complete", "hidden", "growth", "missing")]
    lines = ["occluded".ljust(16) + "".join(f"{name:>18}" for name in head)]
    for name, found in table.items():
        values = [
            found.get(f"{error}{ending}") for error in _ERRORS for ending in ("_complete", "", "_growth", "_missing")
        ]
        cells = ("-" if v is None else f"{v:.3f}" for v in values)
        lines.append(name.ljust(16) + "".join(f"{cell:>18}" for cell in cells))
    return "\n".join(lines)


def main() -> int:
    """Print the table of a run on a test file; with ``--json`` write it too."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.occlusion", description=__doc__)
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("test", metavar="TEST.npz")
    parser.add_argument("--seed", type=int, default=0, help="of the joints hidden at random")
    parser.add_argument("--refine", choices=("on", "off"), help="lift the frames of a clip together; as the run says")
    parser.add_argument("--json", metavar="FILE", help="write the figures here")
    given = parser.parse_args()
    try:
        refine = None if given.refine is None else given.refine == "on"
        table = occlusion_table(given.run, given.test, given.seed, refine=refine)
        if given.json:
            with replacing(given.json) as file:
                file.write((json.dumps(table, indent=1) + "\n").encode())
    except UserError as error:
        print(f"occlusion: {error}", file=sys.stderr)
        return 2
    print(show(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
