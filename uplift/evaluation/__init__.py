"""Every evaluation protocol by its name, from one prediction and one truth."""

from __future__ import annotations

from uplift.evaluation.evaluator import evaluate, flat_depth
from uplift.evaluation.match import GivenPoses
from uplift.evaluation.report import Evaluation

__all__ = ["Evaluation", "GivenPoses", "evaluate", "flat_depth"]
