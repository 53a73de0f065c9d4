"""Trained lifters as people use them: keypoints to poses, masks to shapes; saved as one file that cannot run code."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from uplift.config.device import device_of, fast_products, half_is_fast
from uplift.config.files import save_torch
from uplift.config.progress import progress
from uplift.config.run import Weights, read_weights
from uplift.config.safe_weights import ENDING, save_safe
from uplift.config.settings import LifterSettings, ShapeSettings, settings_of
from uplift.config.trust import Trust, consents
from uplift.data.calibration import SceneCamera, match_cameras
from uplift.data.clean import clean
from uplift.data.formats.scales import in_pixels, with_sure_confidence
from uplift.data.mask_tensors import as_tensor
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.geometry.lens import place_roots
from uplift.models.front import front_at
from uplift.models.ground import put_on_ground
from uplift.models.known_camera import KnownCamera, about_cameras, with_guessed_focal
from uplift.models.lifter import Lifter, mixed_networks
from uplift.models.metric_scale import Size, size_of_skeleton
from uplift.models.networks import NETWORKS
from uplift.models.parts import PART_FRAMES, lift_piece, pieces
from uplift.models.predict import (
    LAG_SECONDS,
    InferredPoses,
    causal_windows,
    infer,
    mm_per_pixel,
    to_level,
    with_constant_bones,
)
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.models.shape_groups import lift_groups
from uplift.models.shape_lifter import LiftedShapes, fill_rays, lift_masks, of_groups
from uplift.models.shape_space import ShapeSpace
from uplift.models.together import (
    Scene,
    alone,
    as_prediction,
    match_views,
    placed_cameras,
    solve,
    view_names,
    with_lenses,
)
from uplift.skeleton import Skeleton

__all__ = ["Model", "ShapeModel", "UsualErrors", "load", "load_poses", "load_shapes"]


@consents
def load(run: str | Path | Weights, *, trust: Trust = None) -> Model | ShapeModel:
    """Return the model of a run (its folder, or runs/<task>/last), of a ``lifter.pt``, or of weights that were read.

    Args:
        run: what to load.
        trust: files and modules of code that may run, such as ``"my_nets.py"``, where the run has a network of its own.

    Raises:
        UserError: no such run, one without weights yet, a file that cannot be read, or code that is not in ``trust``.
    """
    weights = run if isinstance(run, Weights) else read_weights(run)
    return (ShapeModel if weights.lifts == ShapeModel.lifts else Model).from_weights(weights)


@consents
def load_poses(run: str | Path | Weights, *, trust: Trust = None) -> Model:
    """Return `load` of a run that lifts keypoints; raises UserError for a run that lifts masks."""
    return _load_as(Model, run)


@consents
def load_shapes(run: str | Path | Weights, *, trust: Trust = None) -> ShapeModel:
    """Return `load` of a run that lifts masks; raises UserError for a run that lifts keypoints."""
    return _load_as(ShapeModel, run)


SavedT = TypeVar("SavedT", bound="_Saved")


def _load_as(kind: type[SavedT], run: str | Path | Weights) -> SavedT:
    found = load(run)
    if not isinstance(found, kind):
        name = run.run if isinstance(run, Weights) else run
        raise UserError(f"{name} lifts {found.lifts}, expected a run that lifts {kind.lifts}.")
    return found


# Saving and loading, of lifters of both kinds.


class _Saved:
    """A trained lifter that is saved as one file of tensors and plain data."""

    lifts: ClassVar[str]
    formats: ClassVar[tuple[int, ...]]
    """Versions of the file that can be read; the last one is written."""
    later_buffers: ClassVar[tuple[str, ...]] = ()
    """Buffers that files of earlier formats lack."""
    lifter: nn.Module

    def _description(self) -> dict[str, Any]:
        """Return plain data that the lifter can be built from again."""
        raise NotImplementedError

    @classmethod
    def _untrained(cls, state: dict[str, Any]) -> Any:
        """Return a model as `_description` describes it, with random weights."""
        raise NotImplementedError

    def save(self, path: str | Path, *, half: bool = False, about: Mapping[str, Any] | None = None) -> None:
        """Write the model to one file of tensors and plain data: a ``.safetensors``, or what torch saves.

        Args:
            path: of the file; by its ending ``.safetensors`` other programs can read it too.
            half: float16 matrices, for a ``.safetensors`` of half the size.
            about: plain data of yours that a ``.safetensors`` carries along, such as where the weights come from.

        Raises:
            UserError: ``half`` or ``about`` with another ending, or a place where nothing can be written.
        """
        path = Path(path)
        weights = {key: value.detach().cpu() for key, value in self.lifter.state_dict().items()}
        state = {"uplift_format": self.formats[-1], **self._description(), "state": weights}
        if path.suffix.lower() == ENDING:
            save_safe({**state, "about": dict(about)} if about else state, path, half=half)
        elif half or about:
            raise UserError(f"save: half= and about= go with a file that ends in {ENDING}, not with {path}.")
        else:
            save_torch(state, path)

    @classmethod
    def from_weights(cls: type[SavedT], weights: Weights) -> SavedT:
        """Return the model that `save` wrote; raises UserError for other or damaged files, and for code without consent."""
        path, state = weights.path, weights.state
        version = state.get("uplift_format")
        if "state_dict" in state and "hyper_parameters" in state:
            raise UserError(
                f"{path} is a checkpoint of Lightning's, expected a lifter: "
                "uplift.LiftingModule.load_from_checkpoint(...).save(FILE.pt) makes one."
            )
        if version not in cls.formats or weights.lifts != cls.lifts:
            raise UserError(
                f"{path} is not a lifter of {cls.lifts} that this version can read: uplift_format is {version!r} and it "
                f"lifts {weights.lifts}, expected {cls.formats[-1]}. Fit again, or use the version that wrote it."
            )
        try:
            model = cls._untrained(state)
            later = {name: getattr(model.lifter, name) for name in cls.later_buffers}
            model.lifter.load_state_dict({**later, **state["state"]})
        except UserError as error:
            raise UserError(f"{path}: {error}") from error
        except Exception as error:  # whatever a description that is none leads to
            raise UserError(f"{path} is not a valid lifter: {' '.join(str(error).split())[:200]}") from error
        if not all(weight.isfinite().all() for weight in model.lifter.parameters()):
            raise UserError(f"{path} is not a valid lifter: it holds weights that are not finite. Fit again.")
        model.lifter.eval()
        return model


# A lifter of keypoints.

UsualErrors = tuple[tuple[float, ...], tuple[float, ...]]
"""The median error of each hidden joint in training data, in mean 2D radii: where all others are visible, and where
about half of them are. 0 for the root, and for a joint that is never visible."""


@dataclass
class Model(_Saved):
    """A lifter of keypoints with its skeleton and settings: call it on pixels, or `predict` from `PoseData`.

    Example::

        model = uplift.load("runs/demo/last")
        pose = model(keypoints)  # (frames joints 2) pixels -> (frames joints 3)
    """

    lifts: ClassVar[str] = "keypoints"
    formats: ClassVar[tuple[int, ...]] = (2, 3)  # 2: before bodies had a size
    later_buffers: ClassVar[tuple[str, ...]] = ("bone_mm",)

    lifter: Lifter
    skeleton: Skeleton
    settings: LifterSettings
    usual: UsualErrors | None = None
    """By which other bodies are told from those it was trained on (`uplift.models.known_body`); None: they are not."""
    products: str = "auto"
    """How float32 matrices are multiplied, one of `uplift.config.device.PRODUCTS`; "auto" lets networks multiply in
    bfloat16 where the device is fast at it, and poses differ by 0.03 % of the body."""

    def __call__(self, keypoints: Any, confidence: Any = None) -> Any:
        """Return root-relative poses (frames joints 3): camera frame, x right, y down, z away.

        They are in pixels, or in mm where the body's size is known from the skeleton or from labels.

        Args:
            keypoints: (frames joints 2) in pixels, or one frame (joints 2), joints as in ``self.skeleton.joints``;
                NaN means missing. Arrays give arrays, tensors give tensors on the same device.
            confidence: (frames joints), 0..1; 0 means missing. All 1 if None.

        Raises:
            UserError: a wrong shape, shares of an image in place of pixels, or nothing that can be lifted.
        """
        array = _float_array(keypoints)
        single = array.ndim == 2
        array = array[None] if single else array
        joints = len(self.skeleton.joints)
        if array.ndim != 3 or array.shape[1:] != (joints, 2):
            raise UserError(
                f"keypoints of shape {array.shape}, expected (frames, {joints}, 2): {self.skeleton.joints}."
            )
        weight = np.ones(array.shape[:2], np.float32) if confidence is None else _float_array(confidence)
        weight = weight[None] if weight.ndim == 1 else weight
        data = in_pixels(with_sure_confidence(PoseData(array, weight, self.skeleton.joints)))
        pose = self.predict(data).pose
        pose = pose[0] if single else pose
        return torch.from_numpy(pose).to(keypoints.device) if isinstance(keypoints, Tensor) else pose

    @property
    def device(self) -> torch.device:
        """What computes: a device of PyTorch's."""
        return next(self.lifter.parameters()).device

    def to(self, device: str | torch.device) -> Model:
        """Move the lifter to a device, on which `predict` then computes; returns the model itself."""
        self.lifter.to(device)
        return self

    def on(self, accelerator: str) -> Model:
        """Move the lifter to the device of an accelerator's name; "auto" is a CUDA device where there is one, else the processor.

        Raises UserError: an unknown name, or a device that this machine lacks.
        """
        device = device_of(accelerator)
        # Apple's GPUs are for those who ask: poses are small beside the copies.
        return self.to("cpu" if accelerator == "auto" and device.type == "mps" else device)

    def predict(
        self,
        data: PoseData,
        title: str = "",
        *,
        refine: bool | str = True,
        size: Size | None = None,
        constant_bones: bool = False,
        hypotheses: int = 0,
        camera: KnownCamera | None = None,
        ground: bool = False,
    ) -> Prediction:
        """Return the pose of every frame of ``data``; NaN where fewer than three joints are visible.

        In mm if ``size``, the skeleton or labelled bodies give the scale, and then with the root's position if
        the camera is known; in pixels otherwise.

        Args:
            data: with the skeleton's joints in its order.
            title: of the prediction.
            refine: whether frames of one clip are lifted together (`uplift.models.refine`): one body, one camera
                tilt, smooth motion, depth signs, and short gaps interpolated; ``"causal"``: by what was seen up to half a
                second after each frame (`uplift.models.predict.causal_windows`).
            size: the body's known size.
            constant_bones: whether each body gets one length for every bone.
            hypotheses: how many poses to return for each frame, with their probabilities; 0 for none beside ``pose``.
            camera: how the camera stands, where it is known.
            ground: whether to find the ground, and keep standing feet on it where they are (`uplift.models.ground`).

        Raises:
            UserError: a size that does not give the scale; constant bones of a skeleton whose bones form loops;
                hypotheses of a lifter that does not predict depth signs; a ground without a size or the size of the
                image.
        """
        camera, ground = camera or KnownCamera(), ground and self._may_stand(size)
        order = data.in_order()
        if (np.diff(order) < 0).any():  # neighbours in time must be neighbours in the rows
            options = {"refine": refine, "size": size, "constant_bones": constant_bones, "hypotheses": hypotheses}
            options |= {"camera": camera, "ground": ground}
            return self.predict(data.select(order), title, **options).select(np.argsort(order))
        if hypotheses and self.lifter.signs is None:
            raise UserError(
                f"hypotheses={hypotheses}: this lifter does not say which way bones may point: fit with lifter.signs=512."
            )
        if refine == "causal" and ground:
            raise UserError("ground=true looks at whole clips: it does not go with refine=causal.")
        if refine == "causal":
            windows, rows = causal_windows(data)
            options = {"size": size, "constant_bones": constant_bones, "camera": camera, "hypotheses": hypotheses}
            live = self.predict(windows, title, **options).select(rows)
            note = f"each frame is lifted by what was seen up to {LAG_SECONDS:g} s after it"
            return replace(live, identity=data.identity, notes=(*data.notes, note))
        data, _ = clean(data, self.skeleton, drop=False)
        with fast_products(self.products):
            inferred = infer(
                self.lifter,
                data,
                self.settings,
                refine=bool(refine) and self.settings.refine.iterations > 0,
                hypotheses=hypotheses,
                half=self.products == "auto" and self.lifter.halves and half_is_fast(self.device),
            )
        inferred, data = self._seen_by(inferred, data, camera)
        if ground and self.skeleton.gravity:
            data = with_guessed_focal(data, None if inferred.focal_px is None else inferred.focal_px.cpu().numpy())
        pose, body = inferred.pose.cpu().numpy(), data.bodies()
        if constant_bones:
            pose = with_constant_bones(pose, self.skeleton, body)
        mm_per_px = mm_per_pixel(inferred, pose, data, self.skeleton, body, size)
        prediction = self._prediction(data, inferred, pose, mm_per_px, title)
        return self._on_ground(prediction, data) if ground else prediction

    def predict_parts(
        self, parts: Iterable[PoseData], title: str = "", *, frames: int = PART_FRAMES, **how: Any
    ) -> Iterator[Prediction]:
        """Yield the poses of an input of any length, part by part, in memory that does not depend on how many there are.

        What `predict` learns from all clips of its input (what confidences are worth, the mean body) is that of each part,
        and a clip that is longer than a part is cut, and lifted with the frames beside each cut (`uplift.models.parts`).

        Args:
            parts: frames in order, in parts of whole clips, as `uplift.data.parts.iterate_parts` reads them.
            title: of the predictions.
            frames: how many are lifted at a time.
            how: as `predict` takes it. With ``ground`` no clip is cut.

        Raises:
            UserError: as `predict`, but for frames that nobody is in, which are NaN.
        """
        for piece in pieces(parts, frames, cut=not how.get("ground")):
            yield lift_piece(partial(self.predict, title=title, **how), piece, self.skeleton)

    def _may_stand(self, size: Size | None) -> bool:
        """Return True; raises UserError where nothing tells lengths in millimetres, without which there is no ground."""
        known = size or size_of_skeleton(self.skeleton) or (self.lifter.bone_mm > 0).any()
        if self.skeleton.gravity and not known:
            height = "height_mm=..., or " if "of_height" in self.skeleton.size else ""
            raise UserError(
                f"ground=true needs millimetres: give {height}bone=JOINT,JOINT bone_mm=... (docs/output.md)"
            )
        return True

    def _seen_by(self, inferred: InferredPoses, data: PoseData, camera: KnownCamera) -> tuple[InferredPoses, PoseData]:
        """Return what was inferred with gravity as ``camera`` has it, and ``data`` with a note on the cameras."""
        if not self.skeleton.gravity:
            return inferred, data
        used = camera.gravity(inferred.gravity.cpu().numpy())
        focal_px = None if inferred.focal_px is None else inferred.focal_px.cpu().numpy()
        notes = about_cameras(data, inferred.gravity_by_frame.cpu().numpy(), used, camera, focal_px)
        gravity = torch.from_numpy(used).to(inferred.gravity)
        return dataclasses.replace(inferred, gravity=gravity), dataclasses.replace(data, notes=(*data.notes, *notes))

    def _on_ground(self, prediction: Prediction, data: PoseData) -> Prediction:
        """Return the poses with standing feet on the ground; as they are, with a note, where there is no gravity."""
        rays, root, gravity = data.rays(), prediction.root, prediction.gravity
        if gravity is None or rays is None or root is None:
            note = f"ground: poses are as they were lifted: the skeleton '{self.skeleton.name}' has no gravity"
            return dataclasses.replace(prediction, notes=(*prediction.notes, note))
        found = put_on_ground(prediction.pose, root, gravity, data, rays, self.skeleton)
        level_pose = to_level(found.pose, torch.from_numpy(gravity))
        notes = (*prediction.notes, *found.notes)
        return dataclasses.replace(prediction, **found._asdict() | {"level_pose": level_pose, "notes": notes})

    def _prediction(
        self,
        data: PoseData,
        inferred: InferredPoses,
        pose: Float[np.ndarray, "frames joints 3"],
        mm_per_px: Float[np.ndarray, " frames"] | None,
        title: str,
    ) -> Prediction:
        """Return ``pose``, in pixels, as a prediction; in mm if the scale is known."""
        gravity, with_gravity, several = inferred.gravity, self.skeleton.gravity, inferred.hypotheses
        unit = np.ones(len(pose), np.float32) if mm_per_px is None else mm_per_px
        uncertainty = None if inferred.uncertainty is None else inferred.uncertainty.cpu().numpy()
        rays = None
        if mm_per_px is not None:
            rays = data.rays()
            pose = (pose * mm_per_px[:, None, None]).astype(np.float32)
            uncertainty = None if uncertainty is None else (uncertainty * mm_per_px[:, None]).astype(np.float32)
        level_pose = to_level(pose, gravity) if with_gravity else pose.copy()
        blank = (data.confidence > 0).sum(1) == 0
        pose[blank], level_pose[blank] = np.nan, np.nan
        hypotheses = None if several is None else several.pose.cpu().numpy() * unit[:, None, None, None]
        if hypotheses is not None:
            hypotheses[blank] = np.nan
        return Prediction(
            pose=pose,
            level_pose=level_pose,
            unit="px" if mm_per_px is None else "mm",
            keypoints=data.keypoints,
            confidence=data.confidence,
            joint_names=self.skeleton.joints,
            skeleton=self.skeleton,
            tilt_deg=gravity[:, 2].clamp(-1, 1).asin().rad2deg().cpu().numpy() if with_gravity else None,
            gravity=gravity.cpu().numpy() if with_gravity else None,
            identity=data.identity,
            fps=data.fps,
            image_size=data.image_size,
            truth=data.pose,
            truth_unit=data.unit,
            uncertainty=uncertainty,
            root=None if rays is None else place_roots(pose, rays, data.confidence).astype(np.float32),
            filled=data.confidence == 0,
            hypotheses=hypotheses,
            weights=None if several is None else several.weight.cpu().numpy(),
            source=data.source,
            title=title,
            notes=data.notes,
        )

    def predict_together(
        self,
        views: Sequence[PoseData],
        title: str = "",
        *,
        cameras: Sequence[SceneCamera] | None = None,
        refine: bool = True,
        size: Size | None = None,
        constant_bones: bool = False,
    ) -> tuple[Prediction, list[SceneCamera]]:
        """Return one body for every moment that several cameras see, in the first camera's frame, and the cameras.

        Each view is lifted as `predict` does; where the cameras are follows from the poses and is adjusted to the
        keypoints, and a body is where all of them see it (`uplift.models.together`). Cameras stand still, and are
        the same in all that is given. In mm if placed ``cameras``, ``size``, the skeleton or labelled bodies give the
        scale, else in pixels of the first camera at the body's median distance; ``root`` is known either way.
        One view gives what `predict` gives.

        Args:
            views: a camera each; joints in the skeleton's order, frames matched by number (by row without any), bodies
                by ``subject`` and ``instance`` where several are seen at a time.
            title: of the prediction.
            cameras: calibrated ones, by name; those without a place have only their lens used.
            refine: whether frames of one clip are lifted together, and move smoothly.
            size: the body's known size.
            constant_bones: whether each body gets one length for every bone.

        Raises:
            UserError: views without frames in common, cameras that do not fit them, two sizes, and as `predict`.
        """
        if not views:
            raise UserError("together: no view is given.")
        given = None if cameras is None else match_cameras(cameras, view_names(views))
        views = list(views) if given is None else with_lenses(views, given)
        if len(views) == 1:
            prediction = self.predict(views[0], title, refine=refine, size=size, constant_bones=constant_bones)
            return prediction, alone(views[0])
        placed = None if given is None else placed_cameras(given)
        if placed is not None and size is not None:
            raise UserError("placed cameras give the scale: leave out height_mm=, bone_mm= or camera_height_mm=.")
        views = [clean(view, self.skeleton, drop=False)[0] for view in views]
        lifted = [self.predict(view, refine=refine) for view in views]
        moments = match_views(views)
        scene = Scene.of(views, lifted, moments if refine else replace(moments, film=False))
        solved = solve(scene, self.skeleton, placed)
        return as_prediction(solved, scene, views, lifted, title, size, placed is not None, constant_bones)

    def refines(self, data: PoseData, refine: bool | str = True) -> bool:
        """Return whether `predict` refines: it is on, and ``data`` has clips of several frames."""
        clips = data.clips()
        return bool(refine) and self.settings.refine.iterations > 0 and bool(clips.max(initial=-1) + 1 < len(clips))

    def _description(self) -> dict[str, Any]:
        described = {"skeleton": self.skeleton.to_dict(), "lifter": dataclasses.asdict(self.settings)}
        return described if self.usual is None else {**described, "usual": self.usual}

    @classmethod
    def _untrained(cls, state: dict[str, Any]) -> Model:
        skeleton = Skeleton.from_dict(state["skeleton"])
        # A lifter from before confidences were calibrated has learned from those of its files.
        settings = settings_of(LifterSettings, "lifter", {"confidence": "given", **state["lifter"]})
        if settings.network in NETWORKS:
            _check_shapes(skeleton, settings, state["state"])
        usual = _usual_of(state.get("usual"), len(skeleton.joints))
        return cls(Lifter(skeleton, settings), skeleton, settings, usual)


def _usual_of(plain: Any, joints: int) -> UsualErrors | None:
    """Return what a file says of usual errors; raises ValueError for anything else."""
    if plain is None:
        return None
    found = np.asarray(plain, np.float64)
    if found.shape != (2, joints) or not (np.isfinite(found).all() and (found >= 0).all()):
        raise ValueError(f"'usual' has shape {found.shape}, expected (2, {joints}): errors, 0 or more")
    shown, halved = found.tolist()
    return tuple(shown), tuple(halved)


def _check_shapes(skeleton: Skeleton, settings: LifterSettings, weights: Mapping[str, Tensor]) -> None:
    """Raise ValueError where weights are not as large as their description says, before memory is taken for these."""
    with torch.device("meta"):
        described = Lifter(skeleton, settings).state_dict()
    for name, found in weights.items():
        if name in described and found.shape != described[name].shape:
            raise ValueError(f"{name} is {tuple(found.shape)}, its description says {tuple(described[name].shape)}")


def _float_array(values: Any) -> np.ndarray:
    return np.array(values.detach().cpu() if isinstance(values, Tensor) else values, np.float32)


# A lifter of masks.

_CHUNK = 50


@dataclass
class ShapeModel(_Saved):
    """A lifter of masks with its settings."""

    lifts: ClassVar[str] = "masks"
    formats: ClassVar[tuple[int, ...]] = (2,)
    later_buffers: ClassVar[tuple[str, ...]] = ("front",)

    lifter: ShapeSpace
    settings: ShapeSettings

    def lift(
        self,
        masks: np.ndarray,
        resolution: int | None = None,
        refine: int | None = None,
        group: Int[np.ndarray, " items"] | None = None,
    ) -> LiftedShapes:
        """Return shapes of masks (items side side), 0..255, cropped as `uplift.data.masks.MaskData` has them.

        Args:
            masks: to lift.
            resolution: voxels along a grid; ``shape.resolution`` if None.
            refine: steps in which code and view of each mask are refined; ``shape.refine`` if None.
            group: a number for each mask: those with the same are one object and get one shape
                (`uplift.models.shape_groups`). None: each mask is lifted alone.
        """
        lifter, device = self.lifter, self.lifter.level.device
        steps = self.settings.refine if refine is None else refine
        how = {"resolution": resolution or self.settings.resolution, "steps": steps}
        number = np.arange(len(masks)) if group is None else np.unique(group, return_inverse=True)[1].reshape(-1)
        order, found = np.argsort(number, kind="stable"), []
        with fast_products("auto"), mixed_networks(torch.bfloat16 if half_is_fast(device) else None):
            for part in progress(_whole_groups(number[order]), "lifting masks, by 50"):
                part_masks, which = as_tensor(masks[order[part]]).to(device), torch.from_numpy(number[order[part]])
                if group is None:
                    found.append(lift_masks(lifter, part_masks, **how).to("cpu"))
                else:
                    found.append(lift_groups(lifter, part_masks, (which - which[0]).to(device), **how).to("cpu"))
        return LiftedShapes.concat(found).select(np.argsort(order))

    def predict(
        self,
        data: MaskData,
        title: str = "",
        refine: int | None = None,
        group: Sequence[Any] | np.ndarray | None = None,
    ) -> ShapePrediction:
        """Return a shape for every mask: expected occupancy, the iso threshold of its surface, and uncertainty.

        Occupancy is raised along rays of the mask that nothing else reaches the threshold on.

        Args:
            data: the masks.
            title: of the prediction.
            refine: steps, as `lift` has them.
            group: a name or number for each mask: those with the same are views of one object, such as frames of a
                video, and get one shape, each with its own pose. None: each mask is lifted alone.

        Raises:
            UserError: no masks, or not one group for each.
        """
        if not len(data):
            raise UserError("There is no mask to lift.")
        number = None if group is None else _numbered(group, len(data))
        found, level = self.lift(data.masks, refine=refine, group=number), float(self.lifter.level)
        filled = fill_rays(found, as_tensor(data.masks), level, symmetric=self.settings.symmetric)
        if number is not None:
            filled = of_groups(filled, torch.from_numpy(number), "amax")
        return ShapePrediction(
            **{name: part.numpy() for name, part in vars(replace(found, occupancy=filled)).items()},
            masks=data.masks,
            names=list(data.names),
            centre_px=data.centre_px,
            scale_px=data.scale_px,
            level=level,
            title=title,
            images=data.images,
        )

    def facing(self, degrees: int | float) -> ShapeModel:
        """Return a model whose shapes have their front where this one's are seen at azimuth ``degrees``.

        It is the same lifter in another frame: silhouettes stay, azimuths are less by ``degrees``. Raises UserError for
        other than 0 and 180 where shapes are their own mirror image.
        """
        space = copy.deepcopy(self.lifter)
        space.front.copy_(front_at(degrees, self.settings).to(space.front) @ space.front)
        return replace(self, lifter=space)

    def _description(self) -> dict[str, Any]:
        shape = {**dataclasses.asdict(self.settings), "views": None}  # a file of the machine that it was fitted on
        return {"lifts": self.lifts, "shape": shape, "detail": self.lifter.detail}

    @classmethod
    def _untrained(cls, state: dict[str, Any]) -> ShapeModel:
        settings = settings_of(ShapeSettings, "shape", state["shape"])
        space = ShapeSpace(settings, state["detail"])
        return cls(space.eval().requires_grad_(False), settings)


def _whole_groups(number: np.ndarray) -> list[slice]:
    """Return parts of sorted groups, none of which is cut: so many as there are in about `_CHUNK` masks."""
    ends = np.append(np.flatnonzero(np.diff(number)) + 1, len(number))
    parts, start, last = [], 0, 0
    for end in ends.tolist():
        if end - start > _CHUNK and last > start:
            parts.append(slice(start, last))
            start = last
        last = end
    return [*parts, slice(start, len(number))]


def _numbered(group: Sequence[Any] | np.ndarray, items: int) -> Int[np.ndarray, " items"]:
    """Return the groups as numbers from 0."""
    names = np.asarray(group)
    if names.shape != (items,):
        raise UserError(f"group has shape {names.shape}, expected one name or number for each of {items:,} masks.")
    return np.unique(names, return_inverse=True)[1].reshape(-1)
