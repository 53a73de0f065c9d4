"""Clips and a camera rig as the rows of a training and a test file."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.mocap.clips import Clip
from uplift.mocap.human import JOINTS
from uplift.mocap.rigs import Rig, film

__all__ = ["chosen_test", "filmed"]

_TEST_SHARE = 0.15
_BASE_FPS = 120


def chosen_test(clips: Sequence[Clip], chosen: Sequence[str], seed: int) -> tuple[set[str], str]:
    """Return the sequences of the test file and how they were chosen.

    ``chosen`` names subjects or sequences; without it whole subjects are drawn until they have 15 % of
    the frames, or whole clips where there is one subject.

    Raises:
        UserError: a name that is not there, nothing left to train on.
    """
    subjects = {clip.subject for clip in clips}
    if chosen:
        known = subjects | {clip.sequence for clip in clips}
        for name in chosen:
            if name not in known:
                raise UserError(f"test={name}: no such subject or motion.{did_you_mean(name, sorted(known))}")
        found = {clip.sequence for clip in clips if {clip.subject, clip.sequence} & set(chosen)}
        if len(found) == len(clips):
            raise UserError(f"test={','.join(chosen)} leaves nothing to train on.")
        return found, f"test: {', '.join(chosen)}"
    if len(clips) < 2:
        raise UserError("One motion only: there must be at least two, one to train on and one to test.")
    by_subject = len(subjects) > 1
    frames: dict[str, int] = {}
    for clip in clips:
        name = clip.subject if by_subject else clip.sequence
        frames[name] = frames.get(name, 0) + len(clip.joints)
    order = np.random.default_rng(seed).permutation(list(frames))[: len(frames) - 1].tolist()
    before = np.cumsum([0, *(frames[name] for name in order)])[:-1]
    picked = [
        name for name, sum_before in zip(order, before, strict=True) if sum_before < _TEST_SHARE * sum(frames.values())
    ]
    found = {clip.sequence for clip in clips if {clip.subject, clip.sequence} & set(picked)}
    if by_subject:
        return found, f"test: {', '.join(picked)} (subjects drawn with seed={seed}; others: test=S5,S16)"
    return found, f"test: {', '.join(picked)} (motions of the one subject there is: the test is no other person)"


def filmed(
    clips: Sequence[Clip], rig: Rig, fps: float, seed: int = 0, actions: Mapping[str, str] | None = None
) -> PoseData:
    """Return the rows: of each clip all cameras, of each camera all frames.

    A clip's cameras depend on ``seed`` and its own name, not on the other clips. ``frame`` counts at 120 Hz.
    """
    lengths = np.array([len(clip.joints) for clip in clips])
    rows = int(lengths.sum()) * rig.cameras
    keypoints = np.empty((rows, len(JOINTS), 2), np.float32)
    pose = np.empty((rows, len(JOINTS), 3), np.float32)
    root, tilt = np.empty((rows, 3), np.float32), np.empty(rows, np.float32)
    start = 0
    for clip in clips:
        random = np.random.default_rng([seed, zlib.crc32(clip.sequence.encode())])
        for view in film(clip.joints, rig, random):
            here = slice(start, start + len(clip.joints))
            keypoints[here], pose[here], root[here], tilt[here] = view.keypoints, view.pose, view.root, view.tilt_deg
            start = here.stop
    return PoseData(
        keypoints=keypoints,
        confidence=np.ones(keypoints.shape[:2], np.float32),
        joint_names=JOINTS,
        pose=pose,
        root=root,
        identity=_identity(clips, lengths, rig.cameras, fps, actions),
        fps=fps,
        image_size=rig.image_size,
        focal_px=rig.focal_px,
        tilt_deg=tilt,
    )


def _identity(
    clips: Sequence[Clip], lengths: np.ndarray, cameras: int, fps: float, actions: Mapping[str, str] | None
) -> dict[str, np.ndarray]:
    rows = lengths * cameras
    identity = {
        "subject": np.repeat(np.array([clip.subject for clip in clips]), rows),
        "sequence": np.repeat(np.array([clip.sequence for clip in clips]), rows),
        "camera": np.repeat(np.tile(np.arange(cameras, dtype=np.int16), len(clips)), np.repeat(lengths, cameras)),
        "frame": np.concatenate([np.arange(n, dtype=np.int32) for n in np.repeat(lengths, cameras)])
        * np.int32(max(1, round(_BASE_FPS / fps))),
    }
    if actions is not None:
        named = np.array([actions.get(clip.sequence, "unknown") for clip in clips])
        identity["action"] = np.repeat(named, rows)
    return identity
