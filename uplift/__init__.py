"""Lift 2D keypoints of anything to 3D, learning from 2D alone."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uplift.data.container import PoseData
    from uplift.datasets.base import DataSet, WantedFile
    from uplift.errors import UserError
    from uplift.lift import Lift
    from uplift.model import Model, load
    from uplift.priors.base import Prior
    from uplift.priors.shape_base import ShapePrior
    from uplift.shapes.lift import ShapeLift
    from uplift.skeleton import Skeleton, load_skeleton
    from uplift.verbs.compare import compare
    from uplift.verbs.evaluate import evaluate, evaluate_poses
    from uplift.verbs.fit import fit
    from uplift.verbs.predict import predict
    from uplift.verbs.simulate import simulate

__all__ = [
    "DataSet", "Lift", "Model", "PoseData", "Prior", "ShapeLift", "ShapePrior", "Skeleton", "UserError", "WantedFile", "compare", "evaluate",
    "evaluate_poses", "fit", "load", "load_skeleton", "predict", "simulate",
]  # fmt: skip
__version__ = "0.1.0"

# Loaded when first used: `import uplift` takes no torch, and `uplift --help` answers at once.
_HOMES = {
    "DataSet": "uplift.datasets.base",
    "Lift": "uplift.lift",
    "Model": "uplift.model",
    "PoseData": "uplift.data.container",
    "Prior": "uplift.priors.base",
    "ShapeLift": "uplift.shapes.lift",
    "ShapePrior": "uplift.priors.shape_base",
    "Skeleton": "uplift.skeleton",
    "UserError": "uplift.errors",
    "WantedFile": "uplift.datasets.base",
    "compare": "uplift.verbs.compare",
    "evaluate": "uplift.verbs.evaluate",
    "evaluate_poses": "uplift.verbs.evaluate",
    "fit": "uplift.verbs.fit",
    "load": "uplift.model",
    "load_skeleton": "uplift.skeleton",
    "predict": "uplift.verbs.predict",
    "simulate": "uplift.verbs.simulate",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'uplift' has no attribute '{name}'")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value
