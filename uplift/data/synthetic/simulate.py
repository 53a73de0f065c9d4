"""Simulate an articulated body in front of random cameras: exact 3D and its 2D, from no data at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.data.parsers.files import refuse_more_than_memory
from uplift.data.poses import PoseData
from uplift.data.synthetic import body as bodies
from uplift.data.synthetic.body import Body, forward_kinematics, is_human, rest_positions
from uplift.data.synthetic.human_motion import human_motion
from uplift.data.synthetic.motion import Motion, own_motion
from uplift.errors import UserError
from uplift.geometry.rigid import quaternion_matrix, rotation_about
from uplift.skeleton import Skeleton

__all__ = ["as_tracked", "build_body", "level_feet", "rest_pose", "simulate", "simulate_parts"]

_FOCAL_PX = 1145.0
_CENTRE_PX = 500.0
_IMAGE_SIZE = (1000, 1000)
_BYTES_A_POINT = 200
"""Memory for each frame and point of a body while it is placed: rotations, angles, positions."""


@dataclass(frozen=True)
class _Cameras:
    """One camera a clip: the rotation from the world (y along gravity) and what it looks at."""

    rotation: Float[np.ndarray, "clips 3 3"]
    distance: Float[np.ndarray, " clips"]
    """From the body's middle, body heights."""
    aim: Float[np.ndarray, "clips 2"]
    """Where in the image the body's middle is, share of the focal length."""
    tilt_deg: Float[np.ndarray, " clips"] | None
    """Down-tilt; None where there is no gravity."""


def _random_cameras(
    rng: np.random.Generator, clips: int, gravity: bool, tilt_deg: tuple[float, float], distance: tuple[float, float]
) -> _Cameras:
    """Return cameras of azimuth uniform and down-tilt normal (mean, deviation); uniform on SO(3) without gravity."""
    if gravity:
        tilt = rng.normal(*tilt_deg, clips).clip(-80, 80)
        azimuth = rotation_about((0.0, 1.0, 0.0), rng.uniform(0, 2 * np.pi, clips))
        rotation = rotation_about((1.0, 0.0, 0.0), np.radians(tilt)) @ azimuth
    else:
        tilt = None  # rotations uniform on SO(3), from unit quaternions (Shoemake 1992)
        w, x, y, z = (q := rng.normal(size=(4, clips))) / np.linalg.norm(q, axis=0)
        rotation = quaternion_matrix(np.stack([x, y, z, w], -1))
    return _Cameras(rotation, rng.uniform(*distance, clips), rng.uniform(-0.06, 0.06, (clips, 2)), tilt)


_STAGE = 2.0
"""Body heights that a clip's path over the floor spans at most: the volume of a capture studio."""


def level_feet(
    body: Body, points: Float[np.ndarray, "clips frames points 3"]
) -> Float[np.ndarray, "clips frames points 3"]:
    """Pitch bodies on four or more legs so that the lowest fore and the lowest hind foot are at one height."""
    legs = bodies.find_legs(body)
    rest = rest_positions(body.parents, body.offsets)
    hips = np.array([rest[leg[0], 2] for leg in legs])
    if not len(hips) or np.ptp(hips) < 0.3 * np.ptp(rest, axis=0).max():
        return points
    share = (hips - hips.min()) / np.ptp(hips)
    fore, hind = ([legs[row][-1] for row in np.flatnonzero(rows)] for rows in (share < 0.3, share > 0.7))
    lowest = [points[..., feet, 1].max(-1) for feet in (fore, hind)]
    along = points[..., fore, :].mean(-2) - points[..., hind, :].mean(-2)
    length = np.linalg.norm(along[..., [0, 2]], axis=-1)
    angle = np.arctan2(lowest[0] - lowest[1], np.maximum(length, 1e-6)).clip(-0.35, 0.35)
    heading = rotation_about((0.0, 1.0, 0.0), np.arctan2(along[..., 0], along[..., 2]))
    pitch = heading @ rotation_about((1.0, 0.0, 0.0), angle) @ np.swapaxes(heading, -1, -2)
    return np.einsum("ctij,ctpj->ctpi", pitch, points)


def as_tracked(data: PoseData, seed: int = 0) -> PoseData:
    """Return the 2D of ``data`` as a tracker gives it: missing joints guessed, with low likelihoods.

    A missing joint is put on another joint of the frame, as trackers confuse similar joints,
    with a likelihood of 0.01 to 0.3; visible joints keep their place and have 0.8 to 1.
    """
    rng = np.random.default_rng([seed, 1])
    frames, joints = data.confidence.shape
    seen = data.confidence > 0
    # Every frame has a permutation of its joints with the seen ones first; guesses fall on those.
    order = np.argsort(rng.random((frames, joints)) + ~seen, axis=1)
    place = rng.integers(0, seen.sum(1).clip(1)[:, None], (frames, joints))
    other = np.take_along_axis(order, place, 1)
    guess = np.take_along_axis(data.keypoints, other[..., None], 1) + rng.normal(0, 5, data.keypoints.shape)
    likelihood = np.where(seen, rng.uniform(0.8, 1.0, (frames, joints)), rng.uniform(0.01, 0.3, (frames, joints)))
    return replace(
        data.without_truth(),
        keypoints=np.where(seen[..., None], data.keypoints, guess).astype(np.float32),
        confidence=likelihood.astype(np.float32),
    )


_ASYMMETRY = 0.008
"""Left and right bones of one person differ by about 1 % (Auerbach & Ruff 2006, J. Human Evolution 50)."""


def simulate(
    skeleton: Skeleton,
    frames: int = 20000,
    seed: int = 0,
    *,
    subjects: int | None = None,
    clip_seconds: float = 3.0,
    fps: float = 10.0,
    tilt_deg: tuple[float, float] = (8.0, 5.0),
    distance: tuple[float, float] = (3.0, 6.0),
    noise_px: float = 0.0,
    missing: float = 0.0,
    mode: str | list[str] = "all",
) -> PoseData:
    """Return ``frames`` frames of random bodies in random motion before random cameras.

    Clips last ``clip_seconds``, one camera and one subject each (by default a subject every three
    clips). ``tilt_deg`` is mean and standard deviation of the down-tilt, ``distance`` the range of
    camera distances in body heights (farther where a clip needs it to stay in the picture), ``mode`` ``all``
    or a list of motions, ``noise_px`` and ``missing`` the noise of the keypoints and the share of
    joints left out. Raises UserError for a skeleton without a body or a setting out of range.
    """
    _check(frames, subjects, clip_seconds, fps, tilt_deg, distance, noise_px, missing)
    body = build_body(skeleton)
    size = frames * len(body.parents) * _BYTES_A_POINT
    refuse_more_than_memory(f"simulate: frames={frames:,}", size, "Simulate fewer, or several files of them")
    rng = np.random.default_rng(seed)
    length = min(frames, max(1, round(clip_seconds * fps)))
    clips = -(-frames // length)
    subject = np.sort(rng.integers(subjects, size=clips)) if subjects else np.arange(clips) // 3
    offsets, height = _random_bodies(rng, body, int(subject.max()) + 1)
    time_s = np.arange(length) / fps
    if is_human(skeleton):
        motion = human_motion(rng, body, clips, time_s, mode)
    else:
        motion = own_motion(rng, body, clips, time_s, mode, skeleton.gravity, bodies.leaders(skeleton))
    cameras = _random_cameras(rng, clips, skeleton.gravity, tilt_deg, distance)
    points = _place(body, offsets[subject], motion, skeleton.gravity)
    joints = np.einsum("jp,ctpk->ctjk", body.joints, points)
    seen = _into_camera(joints, cameras) * height[subject, None, None, None]
    return _pack(rng, skeleton, body, seen, cameras, motion, subject, frames, fps, noise_px, missing)


_PART = 30_000
"""Frames that are simulated together."""


def simulate_parts(skeleton: Skeleton, frames: int, seed: int = 0, **options: Any) -> Iterator[PoseData]:
    """Yield ``frames`` frames in parts of whole clips, each of other bodies, motions and cameras than the ones before.

    ``options`` are those of `simulate`, which also says what it raises. What a part has depends on ``seed`` and its
    number alone.
    """
    length = max(1, round(options.get("clip_seconds", 3.0) * options.get("fps", 10.0)))
    step = max(1, _PART // length) * length
    clips = subjects = 0
    for number, start in enumerate(range(0, frames, step)):
        own = int(np.random.SeedSequence([seed, number]).generate_state(1, np.uint64)[0])
        part = simulate(skeleton, min(step, frames - start), own, **options)
        subject = np.char.lstrip(part.identity["subject"], "S").astype(int)
        clip = part.identity["sequence"].astype(int)
        names = {
            "subject": np.char.add("S", (subject + subjects).astype(str)),
            "sequence": np.char.zfill((clip + clips).astype(str), 6),
        }
        yield replace(part, identity=part.identity | names)
        subjects, clips = subjects + int(subject.max()), clips + int(clip.max()) + 1


def build_body(skeleton: Skeleton) -> Body:
    """Return the body of a skeleton: the human one where it names it, else that of its proportions; raises UserError."""
    return bodies.human_body(skeleton) if is_human(skeleton) else bodies.own_body(skeleton)


def rest_pose(skeleton: Skeleton) -> Float[np.ndarray, "joints 3"]:
    """Return the mean body in its rest pose, relative to the root, facing the camera, in body heights."""
    body = build_body(skeleton)
    angles = np.zeros(len(body.angles)).clip(body.low_deg, body.high_deg)
    joints = body.joints @ forward_kinematics(body, body.offsets[None], angles[None])[0]
    return joints - joints[skeleton.root_index]


def _check(frames, subjects, clip_seconds, fps, tilt_deg, distance, noise_px, missing) -> None:
    rules = {
        "frames": (frames, frames >= 1, "at least 1"),
        "subjects": (subjects, subjects is None or subjects >= 1, "at least 1"),
        "clip_seconds": (clip_seconds, clip_seconds > 0, "above 0"),
        "fps": (fps, fps > 0, "above 0"),
        "tilt_deg": (tilt_deg, len(tilt_deg) == 2 and tilt_deg[1] >= 0, "mean and standard deviation"),
        "distance": (distance, len(distance) == 2 and 1.5 <= distance[0] <= distance[1], "nearest and farthest, 1.5 or more"),
        "noise_px": (noise_px, noise_px >= 0, "0 or more"),
        "missing": (missing, 0 <= missing < 1, "a share from 0 to below 1"),
    }  # fmt: skip
    for name, (value, valid, expected) in rules.items():
        if not valid:
            raise UserError(f"simulate: {name}={value}, expected {expected}.")


def _random_bodies(rng: np.random.Generator, body: Body, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return bone offsets (bodies points 3) in mean body heights, and each body's height in its unit."""
    kinds, group = np.unique(body.groups, return_inverse=True)
    factor = (1 + body.spread * rng.normal(size=(count, len(kinds))).clip(-2.5, 2.5))[:, group]
    stretch = np.ones((count, 1, 3))
    if body.scaled_axes.any():
        stretch = np.where(body.scaled_axes, 1 + 0.15 * rng.normal(size=(count, 1, 3)).clip(-2, 2), 1.0)
    else:
        factor = factor * (1 + _ASYMMETRY * rng.normal(size=factor.shape).clip(-3, 3))
    mean, deviation = body.height
    return body.offsets * factor[..., None] * stretch, mean + deviation * rng.normal(size=count).clip(-2.5, 2.5)


def _place(
    body: Body, offsets: Float[np.ndarray, "clips points 3"], motion: Motion, gravity: bool
) -> Float[np.ndarray, "clips frames points 3"]:
    """Return the points in the world, the clip about the origin; on the floor where there is gravity."""
    clips, frames, _ = motion.angles_deg.shape
    angles = motion.angles_deg.reshape(clips * frames, -1)
    points = forward_kinematics(body, np.repeat(offsets, frames, 0), angles)
    points = points.reshape(clips, frames, *offsets.shape[1:])
    if gravity:
        points = level_feet(body, points)
        lowest = points[..., 1].max(-1) + motion.lift  # y of the lowest point becomes -lift, that of the floor 0
        points = points - lowest[..., None, None] * np.array([0.0, 1.0, 0.0])
        reach = np.maximum(np.ptp(motion.travel, axis=1).max(-1), _STAGE)  # as on a treadmill: never off the stage
        points[..., [0, 2]] += (motion.travel * (_STAGE / reach)[:, None, None])[:, :, None]
    middle = (points.min((1, 2)) + points.max((1, 2))) / 2
    return points - middle[:, None, None]


def _into_camera(
    points: Float[np.ndarray, "clips frames joints 3"], cameras: _Cameras
) -> Float[np.ndarray, "clips frames joints 3"]:
    """Return points in the camera frame, the camera far enough away to keep every point in the picture."""
    rotated = np.einsum("cij,ctpj->ctpi", cameras.rotation, points)
    widest = np.abs(rotated[..., :2]).max((1, 2, 3))
    distance = np.maximum(cameras.distance, widest / 0.37 - rotated[..., 2].min((1, 2)))
    rotated[..., :2] += (cameras.aim * distance[:, None])[:, None, None]
    rotated[..., 2] += distance[:, None, None]
    return rotated


def _pack(
    rng, skeleton: Skeleton, body: Body, seen: np.ndarray, cameras: _Cameras, motion: Motion, subject: np.ndarray,
    frames: int, fps: float, noise_px: float, missing: float,
) -> PoseData:  # fmt: skip
    clips, length = seen.shape[:2]
    clip = np.repeat(np.arange(clips), length)[:frames]
    flat = seen.reshape(clips * length, *seen.shape[2:])[:frames]
    keypoints = (
        flat[..., :2] / flat[..., 2:] * _FOCAL_PX + _CENTRE_PX + noise_px * rng.normal(size=(*flat.shape[:2], 2))
    )
    confidence = (rng.uniform(size=flat.shape[:2]) >= missing).astype(np.float32)
    keypoints[confidence == 0] = 0
    root = flat[:, skeleton.root_index]
    return PoseData(
        keypoints=keypoints.astype(np.float32),
        confidence=confidence,
        joint_names=skeleton.joints,
        pose=(flat - root[:, None]).astype(np.float32),
        root=root.astype(np.float32),
        unit=body.unit,
        identity={
            "subject": np.char.add("S", (subject[clip] + 1).astype(str)),
            "action": motion.actions[clip],
            "sequence": np.char.zfill(clip.astype(str), 6),
            "camera": np.zeros(frames, np.int8),
            "frame": np.tile(np.arange(length, dtype=np.int32), clips)[:frames],
        },
        fps=float(fps),
        image_size=_IMAGE_SIZE,
        focal_px=_FOCAL_PX,
        tilt_deg=None if cameras.tilt_deg is None else cameras.tilt_deg[clip].astype(np.float32),
        source=f"simulated {skeleton.name}",
    )
