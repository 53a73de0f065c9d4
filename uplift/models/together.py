"""Several cameras of one scene: their frames matched, the cameras found or given, one body for every moment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int

from uplift.data.calibration import SceneCamera
from uplift.data.poses import IDENTITY_KEYS, PoseData, previous_frames
from uplift.errors import UserError
from uplift.geometry.bundle import adjust_cameras
from uplift.geometry.gravity import tilt_of
from uplift.geometry.lens import Lens
from uplift.geometry.multiview import Cameras, Points, Seen, cameras_from_poses, triangulate, weighted_median
from uplift.models.fused import fuse
from uplift.models.metric_scale import CameraHeight, Size, mm_by_camera_height, mm_per_unit, size_of_skeleton
from uplift.models.predict import to_level, with_constant_bones
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = [
    "CAMERA_NAME", "Moments", "Scene", "SolvedScene", "alone", "as_prediction", "match_views", "placed_cameras", "solve",
    "view_names", "with_lenses",
]  # fmt: skip

CAMERA_NAME = re.compile(
    r"(?<![a-z])(?:(?:camera|cam|view)[\s_.-]*(?:\d+|[a-rt-z](?![a-z]))|c\d+)(?!\d)", re.IGNORECASE
)
"""What names a camera in the name of a file or a sequence."""
_FEWEST = 5
"""Frames that a camera must share with the others."""
_MOST_FRAMES = 200
"""Well-spread frames that cameras are found by: more change nothing and take time."""
_BLOCK, _OVERLAP = 4000, 20
"""Frames of a block, and of the blocks beside it that are solved with it."""
_GUESSED_SD = 0.2
"""Standard deviation of the logarithm of a focal length about the guess, the longer side of the image."""
_BAD_PX = 0.05
"""Median error, as a share of the body's size in the image, above which cameras do not fit what they see."""


# Which rows of the views show the same body at the same time.


@dataclass(frozen=True)
class Moments:
    """The same body at the same time, in every view that shows it."""

    rows: Int[np.ndarray, "views moments"]
    """Of each view, -1 where it does not show it."""
    clip: Int[np.ndarray, " moments"]
    """Moments of one body in one sequence have one number."""
    identity: dict[str, np.ndarray]
    """Of each moment, as far as the views say."""
    film: bool
    """Whether moments of a clip follow one another in time."""

    def triples(self) -> Int[np.ndarray, "triples 3"]:
        """Return the moments of one body that follow one another, three in a row."""
        if not self.film:
            return np.zeros((0, 3), np.int64)
        before = previous_frames(self.clip, self.identity.get("frame"))
        last = np.flatnonzero((before >= 0) & (before[before] >= 0))
        return np.stack([before[before[last]], before[last], last], 1)


def view_names(views: Sequence[PoseData]) -> list[str]:
    """Return the name of each view: that of its camera, else of its file, else its number."""
    found = []
    for number, view in enumerate(views):
        cameras = np.unique(view.identity["camera"].astype(str)) if "camera" in view.identity else []
        file = view.source.rpartition("/")[2]
        found.append(str(cameras[0]) if len(cameras) == 1 else file.rpartition(".")[0] or file or f"view {number + 1}")
    return found if len(set(found)) == len(found) else [f"{name} ({at + 1})" for at, name in enumerate(found)]


def match_views(views: Sequence[PoseData]) -> Moments:
    """Return which rows go together: by sequence, body and frame number, or by row where there is none.

    Names of sequences that differ in the camera's alone are one, and those of views with one sequence each do not
    matter. Nor do names of bodies (`subject`, `instance`) where no view shows two at a time.

    Raises:
        UserError: a view that shares no frames with the others, or shows one body twice at a time.
    """
    one = all(len(np.unique(view.identity["sequence"])) == 1 for view in views if "sequence" in view.identity)
    sequences = _codes([np.array([""]).repeat(len(view)) if one else _sequences(view) for view in views])
    frames = _codes(_frames(views, sequences))
    bodies = _codes([_bodies(view) for view in views])
    times = [s * (max(map(_top, frames)) + 1) + f for s, f in zip(sequences, frames, strict=True)]
    several = any(len(np.unique(time)) < len(time) for time in times)
    clips = [s * (max(map(_top, bodies)) + 1) + b * several for s, b in zip(sequences, bodies, strict=True)]
    keys = [clip * (max(map(_top, frames)) + 1) + frame for clip, frame in zip(clips, frames, strict=True)]
    every = np.unique(np.concatenate(keys))
    rows = np.full((len(views), len(every)), -1)
    names = view_names(views)
    for place, (name, key) in enumerate(zip(names, keys, strict=True)):
        if len(np.unique(key)) < len(key):
            raise UserError(
                f"together: {name} shows one body twice in one frame: bodies need an 'instance' or 'subject'."
            )
        rows[place, np.searchsorted(every, key)] = np.arange(len(key))
    _check_shared(rows, names)
    film = all("sequence" in view.identity and not view.stills for view in views)
    clip = np.unique(every // (max(map(_top, frames)) + 1), return_inverse=True)[1]
    return Moments(rows, clip, _identity(views, rows, names, several), film)


def _codes(columns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the number of each value among those of all views."""
    values, code = np.unique(np.concatenate(columns), return_inverse=True)
    del values
    return np.split(code, np.cumsum([len(column) for column in columns])[:-1])


def _top(codes: np.ndarray) -> int:
    return int(codes.max(initial=0))


def _sequences(view: PoseData) -> np.ndarray:
    named = view.identity.get("sequence", np.full(len(view), "")).astype(str)
    names, code = np.unique(named, return_inverse=True)
    return np.array([CAMERA_NAME.sub("", name) for name in names])[code]


def _frames(views: Sequence[PoseData], sequences: Sequence[np.ndarray]) -> list[Any]:
    """Return frame numbers, or numbers of rows within a sequence where a view has none."""
    if all("frame" in view.identity for view in views):
        return [view.identity["frame"] for view in views]
    counted = []
    for code in sequences:
        order = np.argsort(code, kind="stable")
        first = np.searchsorted(code[order], code[order])
        number = np.empty(len(code), np.int64)
        number[order] = np.arange(len(code)) - first
        counted.append(number)
    return counted


def _bodies(view: PoseData) -> np.ndarray:
    parts = [view.identity[key].astype(str) for key in ("subject", "instance") if key in view.identity]
    return np.array([" ".join(names) for names in zip(*parts, strict=True)]) if parts else np.full(len(view), "")


def _check_shared(rows: np.ndarray, names: Sequence[str]) -> None:
    """Raise UserError for a view that shares too few frames with those before it, directly or through others."""
    there = rows >= 0
    joined, left = [0], list(range(1, len(rows)))
    while left:
        shared = [int((there[view] & there[joined].any(0)).sum()) for view in left]
        best = int(np.argmax(shared))
        if shared[best] < _FEWEST:
            raise UserError(
                f"together: {names[left[best]]} shares {shared[best]} frames with {', '.join(names[at] for at in joined)}, "
                f"expected {_FEWEST} or more: frames are matched by sequence, body and 'frame' number, or by row without one."
            )
        joined.append(left.pop(best))


def _identity(
    views: Sequence[PoseData], rows: np.ndarray, names: Sequence[str], several: bool
) -> dict[str, np.ndarray]:
    """Return what is known of each moment, of the first view that shows it; all are seen by the first camera."""
    found: dict[str, np.ndarray] = {}
    for key in IDENTITY_KEYS:
        if not all(key in view.identity for view in views) or (key == "instance" and not several):
            continue
        columns = [view.identity[key] for view in views]
        columns = columns if all(column.dtype.kind in "iuf" for column in columns) else [c.astype(str) for c in columns]
        value = np.zeros(rows.shape[1], np.result_type(*columns))
        for column, at in reversed(list(zip(columns, rows, strict=True))):
            value[at >= 0] = column[at[at >= 0]]
        found[key] = value
    if "camera" in found:
        found["camera"] = np.full(rows.shape[1], names[0])
    if "sequence" in found:
        first = views[0].identity["sequence"].astype(str)
        found["sequence"] = (
            found["sequence"].astype(str) if len(np.unique(first)) > 1 else np.full(rows.shape[1], first[0])
        )
    return found


# What the views see, in pixels about the optical axis.


@dataclass(frozen=True)
class Scene:
    """What several cameras see of bodies, and what each of them alone says of these."""

    names: list[str]
    moments: Moments
    seen: Seen
    poses: Float[np.ndarray, "views moments joints 3"]
    """Root-relative, each in its camera's frame, bones 1 long in the mean; 0 where a view does not show the body."""
    lenses: list[Lens]
    guessed: list[bool]
    """Whether the focal length of a lens is a guess."""
    gravity: Float[np.ndarray, "views 3"] | None
    """In each camera's frame; None without gravity."""

    @classmethod
    def of(cls, views: Sequence[PoseData], lifted: Sequence[Prediction], moments: Moments) -> Scene:
        """Return the scene of cleaned views and their poses."""
        skeleton, rows = lifted[0].skeleton, moments.rows
        lenses, guessed = zip(*map(_lens_of, views), strict=True)
        pixels, weight, poses = [], [], []
        for view, lens, found, at in zip(views, lenses, lifted, rows, strict=True):
            there = ((at >= 0) & np.isfinite(found.pose[at]).all((1, 2)))[:, None]
            trust = np.where(there, view.confidence[at], 0).astype(np.float64)
            rays = lens.rays(view.keypoints.astype(np.float64))[at]
            pixels.append(np.where(trust[..., None] > 0, rays * np.mean(lens.focal_px), 0))
            weight.append(trust)
            poses.append(np.where(there[..., None], _unit_bones(found.pose[at].astype(np.float64), skeleton), 0))
        known = [_direction(found.gravity) for found in lifted if found.gravity is not None]
        gravity = np.stack(known) if len(known) == len(lifted) else None
        seen = Seen(np.stack(pixels), np.stack(weight))
        return cls(view_names(views), moments, seen, np.stack(poses), list(lenses), list(guessed), gravity)

    @property
    def focal_px(self) -> Float[np.ndarray, " views"]:
        """The mean focal length of each lens."""
        return np.array([np.mean(lens.focal_px) for lens in self.lenses])


def with_lenses(views: Sequence[PoseData], cameras: Sequence[SceneCamera]) -> list[PoseData]:
    """Return the views seen through the lenses of their calibrated cameras."""
    changed = []
    for view, one in zip(views, cameras, strict=True):
        size = one.lens.image_size
        if view.image_size is not None and view.image_size != size:
            (width, height), (w, h) = view.image_size, size or (0, 0)
            raise UserError(
                f"camera {one.name} is calibrated for images of {w} x {h} px, its keypoints are on images of "
                f"{width} x {height}: expected the same. Scale the keypoints, or calibrate at their size."
            )
        lens = {"lenses": (one.lens,), "lens": np.zeros(len(view), np.int16)}
        changed.append(replace(view, focal_px=None, image_size=size, **lens))
    return changed


def _lens_of(view: PoseData) -> tuple[Lens, bool]:
    """Return the lens of a view, and whether its focal length is a guess: the longer side of the image."""
    if view.lens is not None:
        return view.lenses[int(view.lens[0])], False
    size = view.image_size
    if size is None:  # about as large as what is seen in it
        seen = view.keypoints[view.confidence > 0]
        size = (int(np.ceil(seen[:, 0].max())) + 1, int(np.ceil(seen[:, 1].max())) + 1)
        size = (max(size[0], 2), max(size[1], 2))
    return Lens.ideal(view.focal_px or float(max(size)), size), view.focal_px is None or view.image_size is None


def _unit_bones(pose: Points, skeleton: Skeleton) -> Points:
    parent, child = skeleton.bone_indices.T
    length = np.linalg.norm(pose[:, child] - pose[:, parent], axis=-1).mean(1)
    return pose / np.maximum(length, 1e-9)[:, None, None]


def _direction(vectors: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, " 3"]:
    """Return the direction that most unit vectors are near (iteratively re-weighted mean)."""
    vectors = vectors[np.isfinite(vectors).all(1)].astype(np.float64)
    weight = np.ones(len(vectors))
    mean = np.array([0.0, 1.0, 0.0])
    for _ in range(10):
        mean = (vectors * weight[:, None]).sum(0)
        mean = mean / max(np.linalg.norm(mean), 1e-12)
        weight = 1 / (np.linalg.norm(vectors - mean, axis=1) + 0.05)
    return mean


# Solving.


@dataclass(frozen=True)
class SolvedScene:
    """The cameras and the bodies of a scene, in the frame of the first camera."""

    cameras: Cameras
    points: Points
    spread: Float[np.ndarray, "frames joints"]
    """The error to expect of each joint's place."""
    gravity: Float[np.ndarray, " 3"] | None
    error_px: Float[np.ndarray, " views"]
    """Median distance of the keypoints of each camera from where the body is seen."""


def solve(scene: Scene, skeleton: Skeleton, placed: Cameras | None = None) -> SolvedScene:
    """Return cameras and bodies; in the unit of ``placed`` cameras, which stay, else with bones 1 long in the mean.

    Cameras that are not given are found from the lifted poses, then by bundle adjustment on up to 200 frames; focal
    lengths that were guessed move with it.
    """
    several = _spread_frames(scene)
    cameras = placed.from_first() if placed is not None else _found(scene, several)
    scale = _bone_scale(scene, cameras, several, skeleton.bone_indices)
    if placed is None:
        cameras, scale = cameras.scaled(1 / scale), 1.0
    points, spread = _fused(cameras, scene, scale, skeleton.bone_indices)
    far = np.linalg.norm(cameras.errors(np.nan_to_num(points), scene.seen), axis=-1)
    error = np.array([weighted_median(*one) for one in zip(far, scene.seen.weight, strict=True)])
    gravity = None if scene.gravity is None else _direction(np.einsum("vab,va->vb", cameras.rotation, scene.gravity))
    return SolvedScene(cameras, points, spread, gravity, error)


def _spread_frames(scene: Scene) -> Int[np.ndarray, " frames"]:
    """Return well-spread frames that two cameras or more see; raises UserError without any."""
    several = np.flatnonzero(((scene.seen.weight > 0).sum(2) > 2).sum(0) > 1)
    if not len(several):
        raise UserError("together: no frame shows a body to two cameras.")
    return several[np.linspace(0, len(several) - 1, min(len(several), _MOST_FRAMES)).round().astype(int)]


def _found(scene: Scene, frames: np.ndarray) -> Cameras:
    """Return the cameras that the poses and then the keypoints agree with best."""
    cameras = cameras_from_poses(scene.poses, scene.seen, scene.focal_px)
    return adjust_cameras(cameras, scene.seen.at(frames), np.where(scene.guessed, _GUESSED_SD, 0.0))


def _bone_scale(scene: Scene, cameras: Cameras, frames: np.ndarray, bones: np.ndarray) -> float:
    """Return how many units of the world a unit of the lifted poses is: the median over bones of the ratio of lengths."""
    parent, child = bones.T
    points, there = triangulate(cameras, scene.seen.at(frames)), scene.seen.weight[:, frames].max(-1) > 0
    length = np.linalg.norm(points[:, child] - points[:, parent], axis=-1)
    lifted = np.linalg.norm(scene.poses[:, frames][:, :, child] - scene.poses[:, frames][:, :, parent], axis=-1)[there]
    seen = np.isfinite(length).sum(0) > 0
    if not seen.any():
        raise UserError("together: no bone is seen by two cameras in one frame.")
    return float(
        np.median(np.nanmedian(length[:, seen], axis=0) / np.maximum(np.median(lifted[:, seen], axis=0), 1e-9))
    )


def _fused(cameras: Cameras, scene: Scene, scale: float, bones: np.ndarray) -> tuple[Points, np.ndarray]:
    """Return the joints in the world and their errors; NaN where no camera sees the body. In blocks, which fit into memory."""
    kept = np.flatnonzero(scene.seen.weight.max((0, 2)) > 0)
    place = np.full(scene.seen.weight.shape[1] + 1, -1)
    place[kept] = np.arange(len(kept))
    triples = place[scene.moments.triples()]
    triples = triples[triples.min(1, initial=0) >= 0]
    points = np.full((len(place) - 1, *scene.poses.shape[2:]), np.nan)
    spread = points[..., 0].copy()
    for start in range(0, len(kept), _BLOCK):
        low, high = max(0, start - _OVERLAP), min(len(kept), start + _BLOCK + _OVERLAP)
        rows, inside = kept[low:high], triples[((triples >= low) & (triples < high)).all(1)] - low
        lifted = scene.poses[:, rows] @ cameras.rotation[:, None] * scale  # row vectors times R: to the world
        found, off = fuse(cameras, scene.seen.at(rows), lifted, bones, inside)
        core = slice(start - low, start - low + _BLOCK)
        points[rows[core]], spread[rows[core]] = found[core], off[core]
    return points, spread


# Cameras in and out, and the prediction.


def placed_cameras(cameras: Sequence[SceneCamera]) -> Cameras | None:
    """Return calibrated cameras by their places, mm; None where the file has none of them.

    Raises UserError: only some of them have a place.
    """
    without = [one.name for one in cameras if one.rotation is None]
    if without and len(without) < len(cameras):
        raise UserError(f"camera {without[0]} has no 'rotation' and 'translation', others have: expected all or none.")
    if without:
        return None
    places = [
        (one.rotation, one.translation) for one in cameras if one.rotation is not None and one.translation is not None
    ]
    rotation, translation = map(np.stack, zip(*places, strict=True))
    return Cameras(rotation, translation, np.array([one.focal_px for one in cameras]))


def alone(view: PoseData) -> list[SceneCamera]:
    """Return the one camera of a scene."""
    return [SceneCamera(view_names([view])[0], _lens_of(view)[0], np.eye(3), np.zeros(3))]


def as_prediction(
    solved: SolvedScene,
    scene: Scene,
    views: Sequence[PoseData],
    lifted: Sequence[Prediction],
    title: str,
    size: Size | None,
    metric: bool,
    constant_bones: bool,
) -> tuple[Prediction, list[SceneCamera]]:
    """Return the bodies in the frame of the first camera with what it sees of them, and the cameras in the same unit."""
    skeleton, first, rows = lifted[0].skeleton, views[0], scene.moments.rows
    pose = solved.points - solved.points[:, [skeleton.root_index]]
    if constant_bones:
        pose = with_constant_bones(pose, skeleton, scene.moments.clip)
    factor, unit = (1.0, "mm") if metric else _factor(solved, scene, lifted, pose, size)
    root, pose = solved.points[:, skeleton.root_index] * factor, (pose * factor).astype(np.float32)
    gravity = None if solved.gravity is None else np.tile(solved.gravity.astype(np.float32), (len(pose), 1))
    there = rows[0] >= 0
    prediction = Prediction(
        pose=pose,
        level_pose=pose.copy() if gravity is None else to_level(pose, torch.from_numpy(gravity)),
        unit=unit,
        keypoints=np.where(there[:, None, None], first.keypoints[rows[0]], 0).astype(np.float32),
        confidence=np.where(there[:, None], first.confidence[rows[0]], 0).astype(np.float32),
        joint_names=skeleton.joints,
        skeleton=skeleton,
        tilt_deg=None if gravity is None else tilt_of(gravity),
        gravity=gravity,
        identity=scene.moments.identity,
        fps=next((view.fps for view in views if view.fps), None),
        image_size=first.image_size,
        truth=None
        if first.pose is None
        else np.where(there[:, None, None], first.pose[rows[0]], np.nan).astype(np.float32),
        truth_unit=first.unit,
        uncertainty=(solved.spread * factor).astype(np.float32),
        root=root.astype(np.float32),
        filled=(scene.seen.weight == 0).all(0),
        source=first.source,
        title=title,
    )
    cameras = solved.cameras.scaled(factor)
    return replace(prediction, notes=_notes(solved, scene, views, pose, metric)), _scene_cameras(cameras, scene, solved)


def _scene_cameras(cameras: Cameras, scene: Scene, solved: SolvedScene) -> list[SceneCamera]:
    found = []
    for at, (name, lens) in enumerate(zip(scene.names, scene.lenses, strict=True)):
        zoom = cameras.focal_px[at] / np.mean(lens.focal_px)
        lens = replace(lens, focal_px=(lens.focal_px[0] * zoom, lens.focal_px[1] * zoom))
        found.append(SceneCamera(name, lens, cameras.rotation[at], cameras.translation[at], float(solved.error_px[at])))
    return found


def _factor(
    solved: SolvedScene, scene: Scene, lifted: Sequence[Prediction], pose: Points, size: Size | None
) -> tuple[float, str]:
    """Return what a unit of the world is, and in what: mm by the size or by labelled bodies, else pixels of the first camera."""
    skeleton = lifted[0].skeleton
    known = np.isfinite(pose).all((1, 2))
    size = size or size_of_skeleton(skeleton)
    if isinstance(size, CameraHeight):
        if any(scene.guessed):
            raise UserError(
                "camera_height_mm gives the scale only if the camera is known: add focal_px=... and image_size=WIDTHxHEIGHT."
            )
        assert solved.gravity is not None
        gravity = np.tile(solved.gravity, (len(pose), 1))
        body = np.zeros(int(known.sum()), np.int64)
        return float(
            np.median(mm_by_camera_height(pose[known], solved.points[known], gravity[known], skeleton, body, size))
        ), "mm"
    if size is not None:
        return float(np.median(mm_per_unit(pose[known], skeleton, scene.moments.clip[known], size))), "mm"
    if all(one.unit == "mm" for one in lifted):
        return _bone_ratio(lifted, pose[known], skeleton), "mm"
    depth = solved.points[known, skeleton.root_index, 2]
    ahead = depth > 0
    return float(solved.cameras.focal_px[0] / np.median(depth[ahead])) if ahead.any() else 1.0, "px"


def _bone_ratio(lifted: Sequence[Prediction], pose: Points, skeleton: Skeleton) -> float:
    """Return how much longer bones are in poses of labelled size."""
    parent, child = skeleton.bone_indices.T
    own = [np.linalg.norm(one.pose[:, child] - one.pose[:, parent], axis=-1).sum(1) for one in lifted]
    return float(
        np.nanmedian(np.concatenate(own)) / np.median(np.linalg.norm(pose[:, child] - pose[:, parent], axis=-1).sum(1))
    )


def _notes(solved: SolvedScene, scene: Scene, views: Sequence[PoseData], pose: Points, metric: bool) -> tuple[str, ...]:
    """Return what was read, found and is odd, a line each."""
    notes = list(dict.fromkeys(note for view in views for note in view.notes))
    shown = ", ".join(f"{name} {error:.1f}" for name, error in zip(scene.names, solved.error_px, strict=True))
    how = "as calibrated" if metric else "found from what they see"
    notes.append(f"{len(views)} cameras together, {how}: the body is off their keypoints by {shown} px (median)")
    if any(scene.guessed):
        focal = ", ".join(
            f"{name} {f:.0f}"
            for name, f, g in zip(scene.names, solved.cameras.focal_px, scene.guessed, strict=True)
            if g
        )
        notes.append(
            f"focal lengths were not known and are estimated: {focal} px (focal_px= and image_size=, or cameras=, give them)"
        )
    for view, (name, error) in enumerate(zip(scene.names, solved.error_px, strict=True)):
        reach = solved.cameras.focal_px[view] * np.nanmedian(np.linalg.norm(pose, axis=-1).max(1))
        depth = np.nanmedian(solved.cameras.to_cameras(np.nan_to_num(solved.points))[view, :, :, 2])
        if error * depth > _BAD_PX * reach:
            why = (
                "is the calibration of this scene?"
                if metric
                else "do the files show the same moments, and stand the cameras still?"
            )
            notes.append(f"WARNING: {name} does not fit the others: {why}")
    return tuple(notes)
