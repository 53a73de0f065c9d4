"""A trained lifter as people use it: pixels in, poses out; saved as one file that cannot run code."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uplift.camera import build_camera
from uplift.config import LifterSettings, RefineSettings
from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.lifter import Lifter
from uplift.networks import build_network
from uplift.predicting import predict_poses
from uplift.prediction import Prediction
from uplift.sizing import Size
from uplift.skeleton import Skeleton
from uplift.torch_file import read_torch, save_torch
from uplift.weights import lifts_masks, weights_of

__all__ = ["Model", "build_lifter", "load", "load_poses"]

_FORMAT = 3
_READABLE = (2, 3)  # 2: before bodies had a size


def build_lifter(settings: LifterSettings, skeleton: Skeleton) -> Lifter:
    """Return an untrained lifter for ``skeleton``."""
    tilt = settings.tilt if skeleton.gravity else "level"
    inputs, outputs = Lifter.sizes(
        len(skeleton.joints),
        tilt=tilt,
        confidence_input=settings.confidence_input,
        fill=settings.fill,
        spread=settings.spread,
    )
    network = build_network(settings.network, inputs, outputs, settings.options)
    return Lifter(
        skeleton,
        network,
        build_camera(settings.camera),
        tilt=tilt,
        confidence_input=settings.confidence_input,
        fill=settings.fill,
        denoise=bool(settings.denoise),
        spread=settings.spread,
        root_free=settings.root_free,
    )


@dataclass
class Model:
    """A lifter with its skeleton and settings: call it on pixels, or `predict` whole data."""

    lifter: Lifter
    skeleton: Skeleton
    settings: LifterSettings

    def __call__(self, keypoints: Any, confidence: Any = None) -> Any:
        """Return poses (frames joints 3) of keypoints (frames joints 2) in pixels.

        In pixels as well; in mm where labelled frames told how large bodies are.

        Joints in the order of ``self.skeleton.joints``; NaN or confidence 0 means missing. One frame
        (joints 2) gives one pose. Arrays give arrays, tensors give tensors. Camera frame: x right,
        y down, z away, relative to the root.

        Raises:
            UserError: a wrong shape, or nothing that can be lifted.
        """
        is_tensor = isinstance(keypoints, Tensor)
        array = keypoints.detach().cpu().numpy() if is_tensor else np.asarray(keypoints, np.float32)
        single = array.ndim == 2
        array = array[None] if single else array
        joints = len(self.skeleton.joints)
        if array.ndim != 3 or array.shape[1:] != (joints, 2):
            raise UserError(
                f"keypoints of shape {array.shape}, expected (frames, {joints}, 2): {self.skeleton.joints}."
            )
        if confidence is None:
            sure = np.ones(array.shape[:2], np.float32)
        else:
            sure = np.asarray(confidence.detach().cpu() if isinstance(confidence, Tensor) else confidence, np.float32)
            sure = sure[None] if sure.ndim == 1 else sure
        data = PoseData(array.astype(np.float32), sure, self.skeleton.joints)
        pose = self.predict(data).pose
        pose = pose[0] if single else pose
        return torch.from_numpy(pose).to(keypoints.device) if is_tensor else pose

    def predict(
        self,
        data: PoseData,
        title: str = "",
        *,
        refine: bool = True,
        size: Size | None = None,
        constant_bones: bool = False,
    ) -> Prediction:
        """Return the poses of every frame of ``data``, which has the skeleton's joints in its order.

        Frames that cannot be lifted (fewer than three visible joints) come out as NaN, so that rows
        stay rows. Where the data says which frames make a clip, they are lifted together unless
        ``refine`` is off: one body, one camera tilt and a smooth motion in each (`uplift.refine`, as
        `lifter.refine` says), and joints that go missing for a frame or two are put where the frames
        around say before all is lifted once more (`uplift.bridging`).

        In mm with a ``size`` (else by the skeleton's, else by labelled bodies), and then with the
        place of the root where the camera is known; in pixels otherwise. ``constant_bones`` gives
        each body one length of every bone.

        Raises:
            UserError: a size that does not tell, bones that close loops and are to be constant.
        """
        return predict_poses(self, data, title, refine=refine, size=size, constant_bones=constant_bones)

    def refines(self, data: PoseData, refine: bool = True) -> bool:
        """Return whether `predict` lifts frames of ``data`` together: it is on, and there are clips."""
        clips = data.clips()
        wanted = refine and self.settings.refine.iterations > 0
        return wanted and int(clips.max(initial=-1)) + 1 < len(clips)

    def save(self, path: Path) -> None:
        """Write the model to one file of tensors and plain data."""
        state = {
            "uplift_format": _FORMAT,
            "skeleton": self.skeleton.to_dict(),
            "lifter": dataclasses.asdict(self.settings),
            "state": {key: value.detach().cpu() for key, value in self.lifter.state_dict().items()},
        }
        save_torch(state, path)

    @classmethod
    def load_file(cls, path: Path) -> Model:
        """Return the model of a file that `save` wrote; nothing in the file can run.

        Raises:
            UserError: not such a file, damaged, or inconsistent.
        """
        state = read_torch(path, "lifter")
        if state.get("uplift_format") not in _READABLE:
            raise UserError(
                f"{path} is no lifter of this version: uplift_format is {state.get('uplift_format')!r}, "
                f"expected {_FORMAT}. Fit again, or use the version that wrote it."
            )
        try:
            skeleton = Skeleton.from_dict(state["skeleton"])
            settings = LifterSettings(**{**state["lifter"], "refine": RefineSettings(**state["lifter"]["refine"])})
            _refuse_nearby_code(settings.network)
            lifter = build_lifter(settings, skeleton)
            lifter.load_state_dict({"bone_mm": lifter.bone_mm, **state["state"]})
        except UserError as error:
            raise UserError(f"{path}: {error}") from error
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise UserError(f"{path} is no whole lifter: {str(error).splitlines()[0]}") from error
        return cls(lifter.eval(), skeleton, settings)


def _refuse_nearby_code(network: str) -> None:
    """Refuse a network whose file is named relative to wherever the reader happens to be.

    A fit names the file of a network of one's own in full. A relative name did not come from a fit,
    and would run what came in the same archive.
    """
    file, colon, _ = str(network).rpartition(":")
    if colon and file.endswith(".py") and not Path(file).is_absolute():
        raise UserError(f"names the network '{network}' without its folder: not opened, as it would run that file.")


def load(run: str | Path) -> Any:
    """Return the model of a run (its folder, or runs/<task>/last) or of a ``lifter.pt``.

    A `Model`, or of a run that lifts masks a `uplift.shapes.model.ShapeModel`.

    Raises:
        UserError: no such run, or one that has no weights yet.
    """
    path = weights_of(run)
    if lifts_masks(path):
        from uplift.shapes.model import ShapeModel

        return ShapeModel.load_file(path)
    return Model.load_file(path)


def load_poses(run: str | Path) -> Model:
    """Return `load` of a run that lifts keypoints; raises UserError for another."""
    found = load(run)
    if not isinstance(found, Model):
        raise UserError(f"{run} lifts masks, expected a run that lifts keypoints.")
    return found
