"""A trained lifter as people use it: pixels in, poses out; saved as one file that cannot run code."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from uplift.camera import build_camera
from uplift.config import LifterSettings
from uplift.data.clean import clean
from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.lifter import Lifter
from uplift.networks import build_network
from uplift.normalise import Intrinsics, normalise
from uplift.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.training.checkpoint import read_torch, save_torch
from uplift.views import least_rotation, turn

__all__ = ["Model", "build_lifter", "intrinsics_of", "load"]

_FORMAT = 1
_CHUNK = 8192


def build_lifter(settings: LifterSettings, skeleton: Skeleton) -> Lifter:
    """Return an untrained lifter for ``skeleton``."""
    tilt = settings.tilt if skeleton.gravity else "level"
    inputs, outputs = Lifter.sizes(
        len(skeleton.joints), tilt=tilt, confidence_input=settings.confidence_input, fill=settings.fill
    )
    network = build_network(settings.network, inputs, outputs, settings.options)
    return Lifter(
        skeleton,
        network,
        build_camera(settings.camera),
        tilt=tilt,
        confidence_input=settings.confidence_input,
        fill=settings.fill,
        root_free=settings.root_free,
    )


def intrinsics_of(data: PoseData, settings: LifterSettings) -> Intrinsics | None:
    """Return the camera that ``data`` knows and the settings let be used, None otherwise."""
    if settings.intrinsics == "off" or settings.camera == "orthographic":
        return None
    if data.focal_px is None or data.centre_px is None:
        return None
    return Intrinsics(data.focal_px, data.centre_px)


@dataclass
class Model:
    """A lifter with its skeleton and settings: call it on pixels, or `predict` whole data."""

    lifter: Lifter
    skeleton: Skeleton
    settings: LifterSettings

    def __call__(self, keypoints: Any, confidence: Any = None) -> Any:
        """Return poses (frames joints 3) in pixels of keypoints (frames joints 2) in pixels.

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

    def predict(self, data: PoseData, title: str = "") -> Prediction:
        """Return the poses of every frame of ``data``, which has the skeleton's joints in its order.

        Frames that cannot be lifted (fewer than three visible joints) come out as NaN, so that rows
        stay rows.
        """
        data, _ = clean(data, self.skeleton, drop=False)
        intrinsics = intrinsics_of(data, self.settings)
        device = next(self.lifter.parameters()).device
        poses, levels, tilts = [], [], []
        with torch.inference_mode():
            for start in range(0, len(data), _CHUNK):
                rows = slice(start, start + _CHUNK)
                keypoints = torch.from_numpy(data.keypoints[rows]).to(device)
                confidence = torch.from_numpy(data.confidence[rows]).to(device)
                pose, gravity = self._lift(keypoints, confidence, intrinsics)
                poses.append(pose.cpu())
                levels.append(_levelled(pose, gravity).cpu() if self.skeleton.gravity else pose.cpu())
                tilts.append(torch.asin(gravity[:, 2].clamp(-1, 1)).cpu())
        pose, level_pose = (torch.cat(parts).numpy() for parts in (poses, levels))
        blank = (data.confidence > 0).sum(1) == 0
        pose[blank], level_pose[blank] = np.nan, np.nan
        return Prediction(
            pose=pose,
            level_pose=level_pose,
            unit="px",
            keypoints=data.keypoints,
            confidence=data.confidence,
            joint_names=self.skeleton.joints,
            skeleton=self.skeleton,
            tilt_deg=np.degrees(torch.cat(tilts).numpy()) if self.skeleton.gravity else None,
            identity=data.identity,
            fps=data.fps,
            image_size=data.image_size,
            truth=data.pose,
            truth_unit=data.unit,
            source=data.source,
            title=title,
        )

    def _lift(
        self,
        keypoints: Float[Tensor, "frames joints 2"],
        confidence: Float[Tensor, "frames joints"],
        intrinsics: Intrinsics | None,
    ) -> tuple[Tensor, Tensor]:
        """Return poses in pixels and the direction of gravity (frames 3), both in the real camera's frame."""
        normal = normalise(
            keypoints,
            confidence,
            self.skeleton.root_index,
            count_root=self.settings.radius == "all",
            intrinsics=intrinsics,
            distance=self.settings.distance,
        )
        lift = self.lifter.lift_both_ways if self.settings.both_ways else self.lifter
        lifted = lift(normal.keypoints, confidence, normal.distance)
        pose, tilt = lifted.pose * normal.scale_px[:, None, None], lifted.tilt
        gravity = torch.stack([torch.zeros_like(tilt), tilt.cos(), tilt.sin()], -1)
        if normal.rotation is not None:
            pose = turn(pose, normal.rotation.mT)
            gravity = turn(gravity[:, None], normal.rotation.mT)[:, 0]
        return pose, gravity

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
        if state.get("uplift_format") != _FORMAT:
            raise UserError(
                f"{path} is no lifter of this version: uplift_format is {state.get('uplift_format')!r}, "
                f"expected {_FORMAT}. Fit again, or use the version that wrote it."
            )
        try:
            skeleton = Skeleton.from_dict(state["skeleton"])
            settings = LifterSettings(**state["lifter"])
            _refuse_nearby_code(settings.network)
            lifter = build_lifter(settings, skeleton)
            lifter.load_state_dict(state["state"])
        except UserError as error:
            raise UserError(f"{path}: {error}") from error
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise UserError(f"{path} is no whole lifter: {str(error).splitlines()[0]}") from error
        return cls(lifter.eval(), skeleton, settings)


def _levelled(pose: Tensor, gravity: Tensor) -> Tensor:
    """Return poses turned the least way that brings gravity to y: roll is undone with the tilt."""
    return turn(pose, least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])))


def _refuse_nearby_code(network: str) -> None:
    """Refuse a network whose file is named relative to wherever the reader happens to be.

    A fit names the file of a network of one's own in full. A relative name did not come from a fit,
    and would run what came in the same archive.
    """
    file, colon, _ = str(network).rpartition(":")
    if colon and file.endswith(".py") and not Path(file).is_absolute():
        raise UserError(f"names the network '{network}' without its folder: not opened, as it would run that file.")


def load(run: str | Path) -> Model:
    """Return the model of a run (its folder, or runs/<task>/last) or of a ``lifter.pt``.

    Raises:
        UserError: no such run, or one that has no weights yet.
    """
    from uplift.run import RunFolder

    path = Path(run)
    if path.is_file():
        return Model.load_file(path)
    folder = RunFolder.open(path)
    if not folder.weights.is_file():
        raise UserError(
            f"{folder.path} has no lifter.pt yet: its fit was ended early. `uplift fit resume={folder.path}` finishes it."
        )
    return Model.load_file(folder.weights)
