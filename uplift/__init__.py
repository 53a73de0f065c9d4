"""Lift 2D keypoints of anything to 3D, learning from 2D alone."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uplift.biomechanics.angles import joint_angles
    from uplift.biomechanics.gait import gait_of
    from uplift.cli.detect import detect
    from uplift.cli.evaluate import evaluate, evaluate_poses
    from uplift.cli.fit import fit
    from uplift.cli.listing import compare
    from uplift.cli.predict import predict
    from uplift.cli.simulate import simulate
    from uplift.cli.sweep.command import sweep
    from uplift.data.datasets.base import DataSet, WantedFile
    from uplift.data.formats.masks_own import MaskFormat
    from uplift.data.formats.own import Format
    from uplift.data.masks import MaskData
    from uplift.data.module import KeypointData, MaskDataModule
    from uplift.data.poses import PoseData
    from uplift.errors import UserError
    from uplift.export.netcdf import to_xarray
    from uplift.models.known_camera import KnownCamera
    from uplift.models.model import Model, load
    from uplift.priors.base import Lift, Prior, ShapeLift, ShapePrior
    from uplift.skeleton import Skeleton, load_skeleton
    from uplift.training.lifting import LiftingModule
    from uplift.training.mixture import MixtureModule
    from uplift.training.shapes import ShapeModule
    from uplift.training.student import StudentLoss, StudentModule
    from uplift.training.views import Views
    from uplift.video.detector import Detector

__all__ = [
    "DataSet", "Detector", "Format", "KeypointData", "KnownCamera", "Lift", "LiftingModule", "MaskData", "MaskDataModule", "MaskFormat", "MixtureModule", "Model",
    "PoseData", "Prior", "ShapeLift", "ShapeModule", "ShapePrior", "Skeleton", "StudentLoss", "StudentModule", "UserError",
    "Views", "WantedFile", "compare", "detect", "evaluate", "evaluate_poses", "fit", "gait_of", "joint_angles", "load", "load_skeleton", "predict", "simulate",
    "sweep",    "to_xarray",
]  # fmt: skip
__version__ = "0.1.0"

# Loaded when first used: `import uplift` takes no torch, and `uplift --help` answers at once.
_HOMES = {
    "biomechanics.angles": ("joint_angles",),
    "biomechanics.gait": ("gait_of",),
    "cli.detect": ("detect",),
    "cli.evaluate": ("evaluate", "evaluate_poses"),
    "cli.fit": ("fit",),
    "cli.listing": ("compare",),
    "cli.predict": ("predict",),
    "cli.simulate": ("simulate",),
    "cli.sweep.command": ("sweep",),
    "data.datasets.base": ("DataSet", "WantedFile"),
    "data.formats.masks_own": ("MaskFormat",),
    "data.formats.own": ("Format",),
    "data.masks": ("MaskData",),
    "data.module": ("KeypointData", "MaskDataModule"),
    "data.poses": ("PoseData",),
    "errors": ("UserError",),
    "export.netcdf": ("to_xarray",),
    "models.known_camera": ("KnownCamera",),
    "models.model": ("Model", "load"),
    "priors.base": ("Lift", "Prior", "ShapeLift", "ShapePrior"),
    "skeleton": ("Skeleton", "load_skeleton"),
    "training.lifting": ("LiftingModule",),
    "training.mixture": ("MixtureModule",),
    "training.shapes": ("ShapeModule",),
    "training.student": ("StudentLoss", "StudentModule"),
    "training.views": ("Views",),
    "video.detector": ("Detector",),
}


def __getattr__(name: str) -> Any:
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'uplift' has no attribute '{name}'")
    value = getattr(import_module(f"uplift.{home}"), name)
    globals()[name] = value
    return value
