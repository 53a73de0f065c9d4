"""CMU's motion capture in Human3.6M's 17 joints, filmed by virtual cameras."""

from __future__ import annotations

import os
import re
import zlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.data.datasets.base import Rows
from uplift.data.formats.layouts import H36M_JOINTS as JOINTS
from uplift.data.parsers.json import in_order
from uplift.data.parsers.mocap import Figure, Tree, open_bvh, read_amc, read_asf, read_lines
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean, listed

__all__ = [
    "JOINTS", "Clip", "Rates", "Rig", "Trial", "chosen_test", "film", "filmed", "find_trials", "read_clip", "read_index",
]  # fmt: skip

# How the known conversions of CMU's data name their joints, and which bones they leave out.


@dataclass(frozen=True)
class _Layout:
    """Which joints of a file are which of ours."""

    title: str
    left: dict[str, str]
    """Of the left side and the middle; those of the right are found by `right`."""
    right: tuple[tuple[str, str], ...]
    """How a left joint's name becomes that of the right: what is replaced by what."""
    spine: tuple[str, ...]
    thorax: tuple[str, ...]
    """The mean of these."""
    chest: str = ""
    """If it has children at its own position, the thorax bone was dropped."""
    palm: str = ""
    """If it is at its parent's position, the wrist bone was dropped."""
    rest_frames: int = 0
    """Frames of a rest pose, and of leaving it, that the conversion puts before the motion."""
    eyes: bool = False
    """Whether the head has eyes but no end."""
    head: str = "Head"

    def mirrored(self, name: str) -> str:
        """Return the right side's name for a left joint's."""
        for left, right in self.right:
            if left in name:
                return name.replace(left, right, 1)
        return name

    def sides(self) -> dict[str, str]:
        """Return the file's names by our joints of both limbs."""
        return self.left | {"r" + joint[1:]: self.mirrored(name) for joint, name in self.left.items()}

    def needed(self) -> list[str]:
        """Return every name of the file that is used."""
        names = [*self.sides().values(), *self.spine, *self.thorax, self.head]
        names += [self.palm, self.mirrored(self.palm), self.chest, *(["leftEye", "rightEye"] if self.eyes else [])]
        return [name for name in dict.fromkeys(names) if name]


_LAYOUTS = (
    _Layout(
        "Acclaim skeleton",
        {"lhip": "lfemur", "lknee": "ltibia", "lankle": "lfoot", "lshoulder": "lhumerus", "lelbow": "lradius",
         "lwrist": "lhand"},
        (("l", "r"),), spine=("upperback",), thorax=("lowerneck",), head="head",
    ),
    _Layout(
        "cgspeed's conversion for MotionBuilder",
        {"lhip": "LeftUpLeg", "lknee": "LeftLeg", "lankle": "LeftFoot", "lshoulder": "LeftArm",
         "lelbow": "LeftForeArm", "lwrist": "LeftHand"},
        (("Left", "Right"),), spine=("Spine",), thorax=("Neck",), chest="Spine1", palm="LeftFingerBase", rest_frames=1,
    ),
    _Layout(
        "cgspeed's conversion for 3ds Max",
        {"lhip": "LeftHip", "lknee": "LeftKnee", "lankle": "LeftAnkle", "lshoulder": "LeftShoulder",
         "lelbow": "LeftElbow", "lwrist": "LeftWrist"},
        (("Left", "Right"), ("lhand", "rhand")), spine=("Chest",), thorax=("lowerneck",), chest="Chest2", palm="lhand",
        rest_frames=1,
    ),
    _Layout(
        "the conversion for Poser and DAZ Studio",
        {"lhip": "lThigh", "lknee": "lShin", "lankle": "lFoot", "lshoulder": "lShldr", "lelbow": "lForeArm",
         "lwrist": "lHand"},
        (("l", "r"),), spine=("abdomen", "chest"), thorax=("lCollar", "rCollar"), rest_frames=4, eyes=True, head="head",
    ),
)  # fmt: skip


def _layout_of(tree: Tree, path: Path) -> _Layout:
    """Return the layout whose joints are all in ``tree``; raises UserError where none is."""
    missing = {}
    for layout in _LAYOUTS:
        missing[layout.title] = [name for name in layout.needed() if name not in tree.names]
        if not missing[layout.title]:
            if not layout.eyes and np.isnan(tree.tips[tree.names.index(layout.head)]).any():
                raise UserError(f"{path}: joint '{layout.head}' has no End Site: the head has no top.")
            return layout
    nearest = min(missing, key=lambda title: len(missing[title]))
    raise UserError(
        f"{path}: joints of no known conversion of CMU's data: {listed(tree.names)}. "
        f"Nearest is {nearest}, without {listed(missing[nearest])}."
    )


# Human3.6M's 17 joints out of a motion capture figure.

_UNITS_MM = (25.4 / 0.45, 1.0, 10.0, 25.4, 1000.0)
"""Inches / 0.45, as CMU's; mm, cm, inches, m."""
_LEG_MM = (550.0, 1200.0)


def _unit_of(tree: Tree, layout: _Layout, path: Path, unit_mm: float | None = None) -> float:
    """Return the millimetres in the file's unit: ``unit_mm`` where known, else the one that suits the legs.

    Raises:
        UserError: the legs have a length that no person's have.
    """
    names = layout.sides()
    leg = float(np.mean([sum(tree.length(names[side + part]) for part in ("knee", "ankle")) for side in "lr"]))
    found = unit_mm
    if found is None:
        middle = np.sqrt(_LEG_MM[0] * _LEG_MM[1])
        found = min(_UNITS_MM, key=lambda unit: abs(np.log(max(leg, 1e-9) * unit / middle)))
    if not _LEG_MM[0] <= leg * found <= _LEG_MM[1]:
        raise UserError(
            f"{path}: thigh and shin are {leg * found:.4g} mm together ({leg:.4g} in the file's unit, taken as "
            f"{found:.4g} mm), expected {_LEG_MM[0]:g} to {_LEG_MM[1]:g}. Say the unit with unit_mm=."
        )
    return found


def _with_dropped_bones(tree: Tree, layout: _Layout) -> Tree:
    """Return ``tree`` with the bones restored that the conversion dropped.

    A dropped bone leaves its child where its parent is. The thorax bone comes back as long as the bone
    below it, straight up; the wrist bone comes back as the half of the forearm that CMU's model makes it.
    """
    offsets = tree.offsets.copy()
    if layout.chest:
        chest = tree.names.index(layout.chest)
        dropped = (np.array(tree.parents) == chest) & ~tree.offsets.any(1)
        offsets[dropped] = (0, tree.length(layout.chest), 0)
    if layout.palm:
        for palm in (layout.palm, layout.mirrored(layout.palm)):
            joint = tree.names.index(palm)
            if not tree.offsets[joint].any():
                offsets[tree.parents[joint]] *= 1.5
    return replace(tree, offsets=offsets)


def _human_joints(figure: Figure, layout: _Layout, unit_mm: float) -> Float[np.ndarray, "frames 17 3"]:
    """Return the joints in `JOINTS`' order, mm, world (y up).

    ``hip`` is the middle of the hips. ``nose`` is synthetic: ahead of the head's joint by the length of its bone.
    """
    points = {joint: figure.at(name) for joint, name in layout.sides().items()}
    points["hip"] = (points["lhip"] + points["rhip"]) / 2
    for joint, names in (("spine", layout.spine), ("thorax", layout.thorax)):
        points[joint] = np.mean([figure.at(name) for name in names], axis=0)
    if layout.eyes:
        eyes = np.mean([figure.tree.offsets[figure.tree.names.index(name)] for name in ("leftEye", "rightEye")], axis=0)
        # Eyes are at half the height of a head; a nose is halfway down from them, and a quarter further ahead.
        up, ahead = np.array([0, 2 * eyes[1], 0]), np.array([0, eyes[1] / 2, 1.25 * eyes[2]])
    else:
        up = figure.tree.tips[figure.tree.names.index(layout.head)]
        ahead = np.array([0, 0, np.linalg.norm(up)])
    points["headtop"] = figure.beyond(layout.head, up)
    points["nose"] = figure.beyond(layout.head, ahead)
    return (np.stack([points[joint] for joint in JOINTS], 1) * unit_mm).astype(np.float32)


# The index of the CMU data base: what is done in each motion.

_LINE = re.compile(r"(\d{1,3})_(\d{1,3}[a-z]?)(?:\.\w+)?[\t ,;]+(\S.*)")


def read_index(path: Path) -> dict[str, str]:
    """Return the description of each motion: lines such as ``02_01<tab>walk``, anything else in between.

    Raises:
        UserError: no such file, or none of its lines describes a motion.
    """
    if not path.is_file():
        raise UserError(f"No index file {path}.")
    found: dict[str, str] = {}
    for line in read_lines(path, "an index of motions"):
        match = _LINE.match(line.strip().lstrip("\ufeff"))
        if match:
            subject, trial, text = match.groups()
            found[f"{int(subject):02d}_{trial.zfill(2)}"] = text.strip().strip('"')
    if not found:
        raise UserError(f"{path}: no line describes a motion. Expected lines such as: 02_01, a tab, walk.")
    return found


# Which files of a folder are motions, whose they are, and which skeleton goes with each.

_NUMBERED = re.compile(r"(?<!\d)(\d{1,3})_(\d{1,3}[a-z]?)(?![\da-zA-Z])")


@dataclass(frozen=True)
class Trial:
    """One motion file."""

    path: Path
    subject: str
    """Such as ``S35``."""
    sequence: str
    """Such as ``35_01``."""
    skeleton: Path | None = None
    """The ``.asf`` of an ``.amc``."""


def find_trials(folder: Path, skip: Collection[str] = ()) -> tuple[list[Trial], list[str]]:
    """Return the motions below ``folder`` in order, and what was noticed.

    Raises:
        UserError: no folder, no motions, an ``.amc`` without its ``.asf``, one motion twice.
    """
    if not folder.is_dir():
        raise UserError(f"No folder {folder}. Expected one with CMU's .asf and .amc files, or .bvh files made of them.")
    files = _files(folder)
    found: dict[str, Trial] = {}
    doubled = 0
    skipped = set()
    for path in [*files[".amc"], *files[".bvh"]]:
        trial = _trial(path)
        if named := {trial.subject, trial.sequence} & set(skip):
            skipped |= named
            continue
        other = found.get(trial.sequence)
        if other is None:
            skeleton = _skeleton_of(path, trial.subject, files[".asf"]) if path.suffix.lower() == ".amc" else None
            found[trial.sequence] = replace(trial, skeleton=skeleton)
        elif other.path.suffix.lower() == path.suffix.lower():
            raise UserError(f"{other.path} and {path} are both motion {trial.sequence}: keep one of them.")
        else:
            doubled += 1
    if set(skip) - skipped:
        raise UserError(f"skip={', '.join(sorted(set(skip) - skipped))}: no such subject or motion in {folder}.")
    if not found:
        kinds = ", ".join(f"{len(paths)} {kind}" for kind, paths in files.items())
        raise UserError(f"{folder}: no motions (found {kinds}). Expected .amc files with their .asf, or .bvh files.")
    notes = [f"{doubled} .bvh left out: their .amc, which has all bones, is there"] if doubled else []
    return sorted(found.values(), key=lambda trial: in_order(trial.sequence)), notes


def _files(folder: Path) -> dict[str, list[Path]]:
    files: dict[str, list[Path]] = {".asf": [], ".amc": [], ".bvh": []}
    for place, folders, names in os.walk(folder):
        folders.sort()
        for path in (Path(place, name) for name in sorted(names) if not name.startswith(".")):
            if path.suffix.lower() in files and path.is_file():
                files[path.suffix.lower()].append(path)
    return files


def _trial(path: Path) -> Trial:
    numbers = _NUMBERED.search(path.stem)
    if numbers:
        subject, trial = numbers.groups()
        return Trial(path, f"S{int(subject)}", f"{int(subject):02d}_{trial.zfill(2)}")
    subject, _, _ = path.stem.rpartition("_")
    return Trial(path, _subject(subject or path.stem), path.stem)


def _subject(stem: str) -> str:
    return f"S{int(stem)}" if re.fullmatch(r"\d{1,9}", stem) else stem


def _skeleton_of(path: Path, subject: str, skeletons: list[Path]) -> Path:
    choices = [skeleton for skeleton in skeletons if _subject(skeleton.stem) == subject]
    beside = [choice for choice in choices if choice.parent == path.parent]
    if len(beside or choices) == 1:
        return (beside or choices)[0]
    if choices:
        raise UserError(f"{path}: {len(choices)} skeletons of {subject} ({choices[0]}, {choices[1]}): keep one.")
    raise UserError(
        f"{path}: its skeleton is missing. Expected {subject.removeprefix('S')}.asf: CMU gives it with the subject."
    )


# A motion file, or a folder of them, as joints in the world at a lower frame rate.

_WORLD_MM = 1e6


@dataclass(frozen=True)
class Rates:
    """Frames a second of the files, and of what is made of them."""

    fps: float = 10.0
    amc: float = 120.0
    """Of .amc files, which do not give it; CMU's are 120 Hz, some 60 Hz."""
    own: dict[str, float] = field(default_factory=dict)
    """Rates of subjects or motions; these override the files."""

    def step(self, trial: Trial, rate: float) -> int:
        """Return which frames to keep; raises UserError where ``fps`` does not divide the rate."""
        rate = self.own.get(trial.sequence, self.own.get(trial.subject, rate))
        step = round(rate / self.fps)
        if step < 1 or abs(rate / self.fps - step) > 0.001 * step:
            near = rate / max(1, step)
            raise UserError(
                f"{trial.path}: {rate:.4g} frames a second cannot be thinned out to fps={self.fps:g}. "
                f"Nearest: fps={near:.4g}. (A wrong rate is set right with rate={trial.sequence}:60.)"
            )
        return step


@dataclass(frozen=True)
class Clip:
    """The 17 joints of a motion."""

    subject: str
    sequence: str
    joints: Float[np.ndarray, "frames 17 3"]
    """mm, world, y up."""


def read_clip(trial: Trial, rates: Rates, unit_mm: float | None = None) -> Clip:
    """Read one motion.

    Raises:
        UserError: a file that is damaged or another one than it should be.
    """
    if trial.skeleton is not None:
        skeleton = _read_skeleton(trial.skeleton)
        layout = _layout_of(skeleton.tree, skeleton.path)
        unit = _unit_of(skeleton.tree, layout, skeleton.path, unit_mm or skeleton.unit_mm)
        figure = read_amc(trial.path, skeleton, rates.step(trial, rates.amc))
    else:
        file = open_bvh(trial.path)
        layout = _layout_of(file.tree, file.path)
        unit = _unit_of(file.tree, layout, file.path, unit_mm)
        # A captured root never has a rotation of exactly zero.
        first = 0 if any(file.row(0)[3:6]) else layout.rest_frames
        if file.frames <= first:
            raise UserError(f"{trial.path}: no frames after the rest pose.")
        figure = file.figure(first, rates.step(trial, file.rate), _with_dropped_bones(file.tree, layout))
    joints = _human_joints(figure, layout, unit)
    if not (np.abs(joints) < _WORLD_MM).all():
        raise UserError(f"{trial.path}: joints farther than a kilometre from the origin: damaged, or another unit.")
    return Clip(trial.subject, trial.sequence, joints)


_read_skeleton = lru_cache(maxsize=8)(read_asf)


# Virtual cameras around a motion: fixed, level but for a down-tilt, far enough to keep every joint in the image.

_NEAREST_MM = 500.0


@dataclass(frozen=True)
class Rig:
    """Number and properties of the cameras."""

    cameras: int = 4
    tilt_deg: float = 8.0
    """Mean down-tilt."""
    tilt_sd_deg: float = 2.0
    distance_m: float = 5.0
    """From the middle of the motion; farther where a joint would leave the image."""
    focal_px: float = 1145.0
    image_size: tuple[int, int] = (1000, 1000)


@dataclass(frozen=True)
class _View:
    """A motion as one camera sees it."""

    keypoints: Float[np.ndarray, "frames joints 2"]
    """Pixels."""
    pose: Float[np.ndarray, "frames joints 3"]
    """mm, camera frame, relative to the first joint."""
    root: Float[np.ndarray, "frames 3"]
    tilt_deg: float


def film(joints: Float[np.ndarray, "frames joints 3"], rig: Rig, random: np.random.Generator) -> list[_View]:
    """Return what the cameras see of ``joints`` (mm, world, y up), the first of which is the root.

    They are spaced evenly around the middle of the motion from a random start, each up to a sixth of the spacing off.
    """
    start = random.uniform(0, 360)
    views = []
    middle = (joints.max((0, 1)).astype(np.float64) + joints.min((0, 1))) / 2
    for camera in range(rig.cameras):
        azimuth = start + 360 / rig.cameras * (camera + random.uniform(-1, 1) / 6)
        tilt = float(np.clip(rig.tilt_deg + rig.tilt_sd_deg * random.standard_normal(), -80, 80))
        distance = 1000 * rig.distance_m * (1 + 0.1 * random.uniform(-1, 1))
        points = (joints - middle) @ _axes(azimuth, tilt).T
        # Far enough away to see every joint, within 96 % of the half image.
        needed = rig.focal_px * np.abs(points[..., :2]) / (0.96 * np.array(rig.image_size) / 2) - points[..., 2:]
        points[..., 2] += max(distance, float(max(needed.max(), _NEAREST_MM - points[..., 2].min())))
        views.append(_view(points, rig, tilt))
    return views


def _axes(azimuth_deg: float, tilt_deg: float) -> Float[np.ndarray, "3 3"]:
    """Return the camera's right, down and forward in the world, as rows."""
    around, down = np.deg2rad([azimuth_deg, tilt_deg])
    level = np.array([np.sin(around), 0, np.cos(around)])
    right = np.cross(level, [0, 1, 0])
    forward = np.cos(down) * level - np.sin(down) * np.array([0, 1, 0])
    return np.stack([right, np.cross(forward, right), forward])


def _view(points: np.ndarray, rig: Rig, tilt_deg: float) -> _View:
    root = points[:, 0].astype(np.float32)
    pose = (points - points[:, :1]).astype(np.float32)
    # From the rounded numbers, so that the written pose projects exactly to the written keypoints.
    seen = pose.astype(np.float64) + root[:, None]
    keypoints = rig.focal_px * seen[..., :2] / seen[..., 2:] + np.array(rig.image_size) / 2
    return _View(keypoints.astype(np.float32), pose, root, tilt_deg)


# Clips and a camera rig as the rows of a training and a test file.

_TEST_SHARE = 0.15
_BASE_FPS = 120


def chosen_test(clips: Sequence[Clip], chosen: Sequence[str], seed: int) -> tuple[set[str], str]:
    """Return the sequences of the test file and how they were chosen.

    ``chosen`` names subjects or sequences; without it subjects are drawn until they have 15 % of
    the frames, or clips where there is only one subject.

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
    frames: Counter[str] = Counter()
    for clip in clips:
        frames[clip.subject if by_subject else clip.sequence] += len(clip.joints)
    order = np.random.default_rng(seed).permutation(list(frames))[: len(frames) - 1].tolist()
    before = np.cumsum([0, *(frames[name] for name in order)])[:-1]
    enough = _TEST_SHARE * sum(frames.values())
    picked = [name for name, earlier in zip(order, before, strict=True) if earlier < enough]
    found = {clip.sequence for clip in clips if {clip.subject, clip.sequence} & set(picked)}
    if by_subject:
        return found, f"test: {', '.join(picked)} (subjects drawn with seed={seed}; others: test=S5,S16)"
    return found, f"test: {', '.join(picked)} (motions of the one subject there is: the test is no other person)"


def filmed(
    clips: Sequence[Clip], rig: Rig, fps: float, seed: int = 0, actions: Mapping[str, str] | None = None
) -> PoseData:
    """Return the rows: of each clip all cameras, of each camera all frames.

    A clip's cameras depend on ``seed`` and its name, not on the other clips. ``frame`` counts at 120 Hz.
    """
    rows = Rows(sum(len(clip.joints) for clip in clips) * rig.cameras, JOINTS)
    step = np.int32(max(1, round(_BASE_FPS / fps)))
    for clip in clips:
        random = np.random.default_rng([seed, zlib.crc32(clip.sequence.encode())])
        frame = np.arange(len(clip.joints), dtype=np.int32) * step
        for camera, view in enumerate(film(clip.joints, rig, random)):
            identity = {"subject": clip.subject, "sequence": clip.sequence, "camera": np.int16(camera), "frame": frame}
            if actions is not None:
                identity["action"] = actions.get(clip.sequence, "unknown")
            keypoints, pose, confidence, root = rows.next(len(frame), view.tilt_deg, identity)
            keypoints[:], pose[:], confidence[:], root[:] = view.keypoints, view.pose, 1, view.root
    return rows.data(fps=fps, image_size=rig.image_size, focal_px=rig.focal_px)
