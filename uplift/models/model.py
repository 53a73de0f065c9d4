"""Trained lifters as people use them: pixels in, poses or shapes out; saved as one file that cannot run code."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.config.files import save_torch
from uplift.config.run import Weights, read_weights
from uplift.config.settings import LifterSettings, ShapeSettings, settings_of
from uplift.data.clean import clean
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData, codes_of
from uplift.data.tensors import TrainingSet, as_seen, as_tensor, frames_of, intrinsics_of
from uplift.errors import UserError
from uplift.geometry.camera import build_camera
from uplift.geometry.lens import place_roots
from uplift.geometry.rotation import gravity_of, least_rotation, real_tilt, turn
from uplift.models.lifter import Lifted, Lifter
from uplift.models.metric_scale import CameraHeight, Size, mm_by_camera_height, mm_per_unit, size_of_skeleton
from uplift.models.mixture import ShapeMixture
from uplift.models.networks import build_network
from uplift.models.predict import bridge_gaps, lift_frames, refine_lifted, with_constant_bones
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.models.shape_lifter import LiftedShapes, lift_masks
from uplift.skeleton import Skeleton

__all__ = ["Model", "ShapeModel", "build_lifter", "load", "load_poses"]

# From keypoints to a prediction: lift, mend by clip, bridge gaps, give size and place where they are known.


@dataclass
class _Poses:
    """Poses in pixels at the depth of the root, in the real camera's frame."""

    pose: Tensor
    gravity: Tensor
    """(frames 3)"""
    spread: Tensor | None
    scale: Tensor
    """Pixels per unit of the model."""
    unit_mm: Tensor | None
    """Of one unit of the model, for bodies as large as labelled ones."""


def _predict_poses(
    model: Model,
    data: PoseData,
    title: str = "",
    *,
    refine: bool = True,
    size: Size | None = None,
    constant_bones: bool = False,
) -> Prediction:
    """Return what `uplift.models.model.Model.predict` does."""
    order = data.in_order()
    if (np.diff(order) < 0).any():  # frames of a clip are neighbours in time only where they are neighbours in the rows
        found = _predict_poses(
            model, data.select(order), title, refine=refine, size=size, constant_bones=constant_bones
        )
        return found.select(np.argsort(order))
    data, _ = clean(data, model.skeleton, drop=False)
    lifted = _lifted(model, data, model.refines(data, refine))
    body = _bodies(data)
    pose = lifted.pose.cpu().numpy()
    if constant_bones:
        pose = with_constant_bones(pose, model.skeleton, body)
    per_px = _mm_per_px(model, data, lifted, pose, body, size)
    unit = "px" if per_px is None else "mm"
    spread = None if lifted.spread is None else (lifted.spread * lifted.scale[:, None]).cpu().numpy()
    if per_px is not None:
        pose = (pose * per_px[:, None, None]).astype(np.float32)
        spread = None if spread is None else (spread * per_px[:, None]).astype(np.float32)
    level_pose = _levelled(pose, lifted.gravity) if model.skeleton.gravity else pose.copy()
    blank = (data.confidence > 0).sum(1) == 0
    pose[blank], level_pose[blank] = np.nan, np.nan
    rays = data.rays() if unit == "mm" else None
    gravity = lifted.gravity
    return Prediction(
        pose=pose,
        level_pose=level_pose,
        unit=unit,
        keypoints=data.keypoints,
        confidence=data.confidence,
        joint_names=model.skeleton.joints,
        skeleton=model.skeleton,
        tilt_deg=gravity[:, 2].clamp(-1, 1).asin().rad2deg().cpu().numpy() if model.skeleton.gravity else None,
        identity=data.identity,
        fps=data.fps,
        image_size=data.image_size,
        truth=data.pose,
        truth_unit=data.unit,
        spread=spread,
        root=None if rays is None else place_roots(pose, rays, data.confidence).astype(np.float32),
        filled=data.confidence == 0,
        source=data.source,
        title=title,
        notes=data.notes,
    )


def _lifted(model: Model, data: PoseData, refine: bool) -> _Poses:
    """Return the poses of cleaned ``data``; mended by clip and with short gaps bridged where ``refine``."""
    seen = as_seen(data, model.settings)
    frames, lifted = _once(model, seen, refine)
    if refine:
        whole = bridge_gaps(seen, frames, lifted, intrinsics_of(seen, model.settings))
        if whole is not None:  # with fewer gaps, all that is seen is lifted better
            frames, lifted = _once(model, whole, refine)
    pose = lifted.pose * frames.scale[:, None, None]
    if frames.rotation is not None:
        pose = turn(pose, frames.rotation.mT)
    gravity = gravity_of(real_tilt(lifted.tilt, frames.rotation), None)
    return _Poses(pose, gravity, lifted.spread, frames.scale, model.lifter.unit_mm(lifted.pose))


def _once(model: Model, data: PoseData, refine: bool) -> tuple[TrainingSet, Lifted]:
    """Return cleaned ``data`` in the model's units and its poses."""
    frames = frames_of(data, model.skeleton, model.settings).to(next(model.lifter.parameters()).device)
    lifted = lift_frames(model.lifter, frames, both_ways=model.settings.both_ways)
    if refine:
        lifted = refine_lifted(lifted, frames, model.lifter.camera, model.settings.refine)
    return frames, lifted


def _mm_per_px(
    model: Model,
    data: PoseData,
    lifted: _Poses,
    pose: Float[np.ndarray, "frames joints 3"],
    body: Int[np.ndarray, " frames"],
    size: Size | None,
) -> Float[np.ndarray, " frames"] | None:
    """Return the mm of one pixel at each root's depth: by the size given, the skeleton's, or that of labelled bodies."""
    size = size or size_of_skeleton(model.skeleton)
    if isinstance(size, CameraHeight):
        rays = data.rays()
        if rays is None:
            raise UserError(
                "camera_height_mm tells the size only where the camera is known: give focal_px=... and image_size=WIDTHxHEIGHT."
            )
        places = pose + place_roots(pose, rays, data.confidence)[:, None]
        return mm_by_camera_height(pose, places, lifted.gravity.cpu().numpy(), model.skeleton, body, size)
    if size is not None:
        return mm_per_unit(pose, model.skeleton, body, size)
    return None if lifted.unit_mm is None else (lifted.unit_mm / lifted.scale).cpu().numpy()


def _bodies(data: PoseData) -> Int[np.ndarray, " frames"]:
    """Return (frames,) numbers of bodies: of subjects where they are named, else of clips, else one for all."""
    if "subject" in data.identity:
        both = [data.identity[key].astype(str) for key in ("subject", "instance") if key in data.identity]
        return codes_of(np.array([" ".join(names) for names in zip(*both, strict=True)]))[1]
    clips = data.clips()
    return clips if clips.max(initial=-1) + 1 < len(clips) else np.zeros_like(clips)


def _levelled(pose: np.ndarray, gravity: Tensor) -> Float[np.ndarray, "frames joints 3"]:
    """Return poses turned the least way that brings gravity to y: roll is undone with the tilt."""
    turned = least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])).cpu()
    return turn(torch.from_numpy(pose), turned).numpy()


# A trained lifter of masks as people use it: masks in, shapes out; saved as one file that cannot run code.

_SHAPE_FORMAT = 1
_CHUNK = 50
_SURE = 0.75
"""Temperature of lifting, in those of training: one mask is explained, the shapes no longer move."""


@dataclass
class ShapeModel:
    """A lifter of masks with its settings."""

    lifter: ShapeMixture
    settings: ShapeSettings

    def lift(self, masks: np.ndarray, resolution: int | None = None) -> LiftedShapes:
        """Return shapes of masks (items side side) of 0..255, cut out as `uplift.data.masks.MaskData` has them."""
        with torch.no_grad():
            drawn = self.lifter.crops()
            parts = [
                lift_masks(
                    self.lifter,
                    as_tensor(masks[start : start + _CHUNK]),
                    drawn,
                    resolution=resolution or self.settings.resolution,
                    temperature=_SURE * self.settings.temperature_end,
                )
                for start in range(0, len(masks), _CHUNK)
            ]
        names = [part.name for part in dataclasses.fields(LiftedShapes)]
        return LiftedShapes(**{name: torch.cat([getattr(part, name) for part in parts]) for name in names})

    def predict(self, data: MaskData, title: str = "") -> ShapePrediction:
        """Return a shape for every mask.

        Occupancy is the expected one over the likeliest shapes and views, and `ShapePrediction.level` says
        where its surface is. Empty above that level where nothing explains a mask.

        Raises:
            UserError: no masks.
        """
        if not len(data):
            raise UserError("There is no mask to lift.")
        found = self.lift(data.masks)
        return ShapePrediction(
            found.occupancy.numpy(),
            found.view.numpy(),
            found.scale.numpy(),
            found.offset.numpy(),
            found.distance.numpy(),
            data.masks,
            list(data.names),
            data.centre_px,
            data.scale_px,
            level=float(self.lifter.level),
            title=title,
            images=data.images,
        )

    def save(self, path: Path) -> None:
        """Write the model to one file of tensors and plain data."""
        state = {
            "uplift_format": _SHAPE_FORMAT,
            "lifts": "masks",
            "shape": dataclasses.asdict(self.settings),
            "state": {key: value.detach().cpu() for key, value in self.lifter.state_dict().items()},
        }
        save_torch(state, path)

    @classmethod
    def from_weights(cls, weights: Weights) -> ShapeModel:
        """Return the model that `save` wrote.

        Raises:
            UserError: not such a file, damaged, or inconsistent.
        """
        path, state = weights.path, weights.state
        if state.get("uplift_format") != _SHAPE_FORMAT or state.get("lifts") != "masks":
            raise UserError(
                f"{path} is no lifter of masks of this version: uplift_format is {state.get('uplift_format')!r} and "
                f"lifts is {state.get('lifts')!r}, expected {_SHAPE_FORMAT} and 'masks'. Fit again, or use the version that wrote it."
            )
        try:
            settings = settings_of(ShapeSettings, "shape", state["shape"])
            parts, azimuths = state["state"]["azimuth_bias"].shape
            mixture = ShapeMixture(settings, parts, azimuths)
            mixture.load_state_dict(state["state"])
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise UserError(f"{path} is no whole lifter: {str(error).splitlines()[0]}") from error
        return cls(mixture.eval(), settings)


# A trained lifter as people use it: pixels in, poses out; saved as one file that cannot run code.

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
        ``refine`` is off: one body, one camera tilt and a smooth motion in each (`uplift.models.refine`, as
        `lifter.refine` says), and joints that go missing for a frame or two are put where the frames
        around say before all is lifted once more (`uplift.models.predict`).

        In mm with a ``size`` (else by the skeleton's, else by labelled bodies), and then with the
        place of the root where the camera is known; in pixels otherwise. ``constant_bones`` gives
        each body one length of every bone.

        Raises:
            UserError: a size that does not tell, bones that close loops and are to be constant.
        """
        return _predict_poses(self, data, title, refine=refine, size=size, constant_bones=constant_bones)

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
    def from_weights(cls, weights: Weights) -> Model:
        """Return the model that `save` wrote.

        Raises:
            UserError: not such a file, damaged, or inconsistent.
        """
        path, state = weights.path, weights.state
        if state.get("uplift_format") not in _READABLE:
            raise UserError(
                f"{path} is no lifter of this version: uplift_format is {state.get('uplift_format')!r}, "
                f"expected {_FORMAT}. Fit again, or use the version that wrote it."
            )
        try:
            skeleton = Skeleton.from_dict(state["skeleton"])
            settings = settings_of(LifterSettings, "lifter", state["lifter"])
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


def load(run: str | Path | Weights) -> Any:
    """Return the model of a run (its folder, or runs/<task>/last) or of a ``lifter.pt``, which is read unless it has been.

    A `Model`, or of a run that lifts masks a `uplift.models.model.ShapeModel`.

    Raises:
        UserError: no such run, or one that has no weights yet.
    """
    weights = run if isinstance(run, Weights) else read_weights(run)
    return (ShapeModel if weights.lifts == "masks" else Model).from_weights(weights)


def load_poses(run: str | Path) -> Model:
    """Return `load` of a run that lifts keypoints; raises UserError for another."""
    found = load(run)
    if not isinstance(found, Model):
        raise UserError(f"{run} lifts masks, expected a run that lifts keypoints.")
    return found
