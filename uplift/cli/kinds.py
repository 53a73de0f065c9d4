"""What the verbs do for runs that lift keypoints and for runs that lift masks: one table of two rows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from uplift.cli.verbs import EVALUATE, POSE_KEYS, SHAPE_KEYS
from uplift.errors import UserError
from uplift.metrics.protocols import BEST_BASELINE, SHAPE_METRICS

__all__ = ["KINDS", "Kind", "Later"]


class Later(str):
    """A function named ``module:function``, imported when it is called: the command line starts at once."""

    __slots__ = ()

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Import and call it."""
        module, _, name = self.partition(":")
        return getattr(import_module(module), name)(*arguments, **options)


@dataclass(frozen=True)
class Kind:
    """What differs between runs by what they lift; the fields are named after the verbs that ask for them."""

    lifts: str
    """As `uplift.config.settings.Settings.lifts` names it, and in messages."""
    fit: Later
    """(settings, run to resume or None) -> `uplift.cli.fit.Prepared`."""
    report: Later
    """(model, settings, loaded data, recipe that was trained) -> `uplift.cli.report.Findings`."""
    evaluate: Later
    """(`uplift.config.run.Weights`, model, test file or None, options among `evaluate_keys`) -> evaluation."""
    predict: Later
    """(`uplift.cli.request.Request`) -> prediction, and the files written with a remark on each."""
    predict_arguments: Later
    """(keys of the command line) -> arguments of `uplift.cli.predict.predict`."""
    predict_summary: Later
    """(prediction) -> lines to print."""
    check_simulated: Later
    """(settings, skeleton or None) -> what a fit simulates, in words."""
    check_file: Later
    """(path, settings, skeleton or None) -> what the file holds, in words; raises UserError for what a fit refuses."""
    predict_keys: tuple[str, ...]
    """Words of predict that go with such runs alone."""
    evaluate_keys: tuple[str, ...]
    """Words of evaluate that go with such runs alone."""
    compared: tuple[str, ...]
    """Metrics that compare shows, in order."""

    def refuse_others(self, verb: str, keys: Iterable[str], run: str | Path) -> None:
        """Raise UserError for a word of ``verb`` (predict or evaluate) that goes with runs of another kind."""
        for other in (kind for kind in KINDS.values() if kind is not self):
            words = other.predict_keys if verb == "predict" else other.evaluate_keys
            for key in keys:
                if any(key == word or key.startswith(f"{word}.") for word in words):
                    kinds = f"a run that lifts {other.lifts}; {run} lifts {self.lifts}"
                    raise UserError(f"{verb}: {key}= goes with {kinds}.")


def _evaluate_keys(lifts: str) -> tuple[str, ...]:
    return tuple(name for name, one in EVALUATE.items() if one.only == lifts)


KINDS = {
    "keypoints": Kind(
        lifts="keypoints",
        fit=Later("uplift.cli.fit:prepare_keypoints"),
        report=Later("uplift.cli.report:pose_findings"),
        evaluate=Later("uplift.cli.evaluate:evaluate_keypoints"),
        predict=Later("uplift.cli.predict:lift_keypoints"),
        predict_arguments=Later("uplift.cli.predict:keypoint_arguments"),
        predict_summary=Later("uplift.cli.pose_summary:pose_summary"),
        check_simulated=Later("uplift.cli.data_check:simulated_keypoints"),
        check_file=Later("uplift.cli.data_check:keypoint_file"),
        predict_keys=tuple(POSE_KEYS),
        evaluate_keys=_evaluate_keys("keypoints"),
        compared=(
            "p_mpjpe", "n_mpjpe", "mpjpe_gt_scale", "mpjpe", "p_mpjpe_reflect", "pck@150", "auc", "mpjve",
            "facing", "facing_sign", "wrong_signs", "elevation_deg", "roll_deg", "bone_cv", "symmetry",
        ),
    ),
    "masks": Kind(
        lifts="masks",
        fit=Later("uplift.cli.fit:prepare_masks"),
        report=Later("uplift.cli.report:shape_findings"),
        evaluate=Later("uplift.cli.evaluate:evaluate_masks"),
        predict=Later("uplift.cli.predict_masks:lift_masks"),
        predict_arguments=Later("uplift.cli.predict_masks:mask_arguments"),
        predict_summary=Later("uplift.cli.predict_masks:shape_summary"),
        check_simulated=Later("uplift.cli.data_check:simulated_masks"),
        check_file=Later("uplift.cli.data_check:mask_file"),
        predict_keys=tuple(SHAPE_KEYS),
        evaluate_keys=_evaluate_keys("masks"),
        compared=tuple(one for name in SHAPE_METRICS for one in (name, BEST_BASELINE + name)),
    ),
}  # fmt: skip
