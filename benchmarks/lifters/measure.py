"""What is measured of a ready lifter: protocols, groups, noise, other cameras, real video, layouts, and what it refuses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.rigs import RIGS, film
from uplift.data.clean import clean
from uplift.data.formats.npz import poses_of
from uplift.data.load import in_joints_of, load_file
from uplift.data.poses import PoseData
from uplift.metrics.evaluate import evaluate, evaluate_model
from uplift.metrics.report import Evaluation
from uplift.models.known_body import OTHER, STRANGE, strangeness
from uplift.models.model import Model
from uplift.skeleton import Skeleton

__all__ = ["Figures", "measure"]

_FRAMES = 1500
"""Of the test split, in complete clips, that layouts and noise are measured on."""
_NOISE, _HIDDEN = 0.03, 0.2
_FEW = 3
"""Frames of a clip below which clips are not judged as files."""
_SHOWN = ("p_mpjpe", "n_mpjpe", "mpjpe_gt_scale", "pck@150", "mpjve", "facing", "wrong_signs", "elevation_deg")


@dataclass
class Figures:
    """The tables of a card, each a header and rows of text; ``headline`` are the figures of the list."""

    headline: dict[str, float]
    unit: str
    frames: int
    tables: dict[str, list[list[str]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def measure(model: Model, wanted: Mapping[str, Any], task: str, data: Path, unit: str | None) -> Figures:
    """Return all figures of a lifter on the test split of ``task``, in ``unit``, and what else ``wanted`` names, in ``data``."""
    truth = _cleaned(data / task / "test.npz", model.skeleton)
    truth = replace(truth, unit=unit or truth.unit)
    whole = evaluate_model(model, truth, f"{task}/test")
    found = Figures({name: whole.overall[name] for name in ("p_mpjpe", "n_mpjpe")}, whole.unit, whole.frames)
    found.tables["Protocols"] = _protocols(whole)
    if whole.by_trunk_angle:
        found.tables["By the angle of the trunk to the vertical, degrees"] = _by_angle(whole)
    if len(whole.per_subject) > 1:
        rows = [[name, *_cells(one)] for name, one in sorted(whole.per_subject.items())]
        found.tables["By species or subject"] = [["", *_HEAD], *rows]
    part = _some_clips(truth)
    found.tables["Harder input"] = [["", *_HEAD], *_harder(model, part, wanted, data)]
    if wanted.get("video") and (data / "beam").is_dir():
        found.tables["Real video (one man, four cameras)"] = [["2D", *_HEAD], *_video(model, wanted["video"], data)]
    if wanted["layouts"]:
        found.tables["Layouts that lack joints"] = _layouts(model, part)
    found.tables["What it takes for another body"] = _refusals(model, truth)
    return found


_HEAD = ["p_mpjpe", "n_mpjpe"]


def _cells(overall: Mapping[str, float]) -> list[str]:
    return [f"{overall[name]:.1f}" if name in overall else "-" for name in _HEAD]


def _cleaned(path: Path, skeleton: Skeleton) -> PoseData:
    return clean(load_file(path, skeleton), skeleton)[0]


def _some_clips(data: PoseData) -> PoseData:
    """Return complete clips of about so many frames in all, evenly chosen."""
    clips = data.clips()
    every = max(1, round(len(data) / _FRAMES))
    return data.select(np.flatnonzero(clips % every == 0))


def _protocols(found: Evaluation) -> list[list[str]]:
    from uplift.metrics.protocols import figure_text, metric_meaning, metric_unit

    rows = [
        [name, figure_text(name, found.overall[name], found.unit), metric_unit(name, found.unit), metric_meaning(name)]
        for name in _SHOWN
        if name in found.overall
    ]
    return [["protocol", "value", "unit", "meaning"], *rows]


def _by_angle(found: Evaluation) -> list[list[str]]:
    rows = [
        [angle, f"{one['frames']:,}", f"{one['p_mpjpe']:.1f}", f"{100 * one['wrong_signs']:.1f} %"]
        for angle, one in (found.by_trunk_angle or {}).items()
    ]
    return [["angle", "frames", "p_mpjpe", "bones that point the wrong way in depth"], *rows]


# Noise, missing joints, other cameras, real video.


def _harder(model: Model, part: PoseData, wanted: Mapping[str, Any], data: Path) -> Iterator[list[str]]:
    yield ["exact keypoints", *_cells(evaluate_model(model, part, "").overall)]
    noise = f"noise of {_NOISE:.0%} of the body's mean radius"
    yield [noise, *_cells(evaluate_model(model, _noisy(part), "").overall)]
    yield [f"{_HIDDEN:.0%} of joints missing", *_cells(evaluate_model(model, _with_gaps(part), "").overall)]
    for name, file in wanted.get("tests", {}).items():
        yield [name, *_cells(evaluate_model(model, _some_clips(_cleaned(data / file, model.skeleton)), "").overall)]
    if wanted.get("rig"):
        with np.load(data / "cmu" / "world.npz", allow_pickle=False) as file:
            world = {key: file[key] for key in ("joints", "joint_names", "subject", "action", "sequence", "fps")}
        filmed = in_joints_of(poses_of("rig", film(world, RIGS[wanted["rig"]], "test")), model.skeleton)
        what = "other cameras: tilt -20 to 50 degrees, roll up to 25, 2 to 8 m away, unknown focal length"
        yield [what, *_cells(evaluate_model(model, _some_clips(clean(filmed, model.skeleton)[0]), "").overall)]


def _noisy(data: PoseData) -> PoseData:
    radius = np.linalg.norm(data.keypoints - data.keypoints.mean(1, keepdims=True), axis=-1).mean(1)
    noise = np.random.default_rng(0).normal(size=data.keypoints.shape) * _NOISE * radius[:, None, None]
    return replace(data, keypoints=(data.keypoints + noise).astype(np.float32))


def _with_gaps(data: PoseData) -> PoseData:
    hidden = np.random.default_rng(0).random(data.confidence.shape) < _HIDDEN
    return replace(data, confidence=np.where(hidden, 0, data.confidence).astype(np.float32))


def _video(model: Model, files: Mapping[str, str], data: Path) -> list[list[str]]:
    rows = []
    for name, pattern in files.items():
        found = [
            evaluate_model(model, _cleaned(path, model.skeleton), "").overall for path in sorted(data.glob(pattern))
        ]
        mean = {key: float(np.mean([one[key] for one in found])) for key in _HEAD}
        rows.append([f"{name}, mean of {len(found)} cameras", *_cells(mean)])
    return rows


# Layouts: the test frames as a file of each would have them.


def _layouts(model: Model, part: PoseData) -> list[list[str]]:
    """Return the errors of joints that a layout has, where those alone are given and where all are, and of those it lacks."""
    skeleton, rows = (
        model.skeleton,
        [["layout", "joints", "p_mpjpe", "the same joints, all given", "joints it lacks", "p_mpjpe of these"]],
    )
    complete = model.predict(part)
    for layout in skeleton.sources:
        given = _as_in(layout, skeleton, part)
        seen = replace(part, confidence=given.confidence)
        lifted = evaluate(model.predict(given), seen, skeleton).overall
        beside = evaluate(complete, seen, skeleton).overall["p_mpjpe"]
        lacks = [name for name, shown in zip(skeleton.joints, given.confidence.any(0), strict=True) if not shown]
        missing = f"{lifted['p_mpjpe_missing']:.1f}" if lacks else "-"
        names = ", ".join(lacks) if len(lacks) < 6 else f"{len(lacks)} of {len(skeleton.joints)}"
        has = str(len(skeleton.joints) - len(lacks))
        rows.append([f"`{layout}`", has, f"{lifted['p_mpjpe']:.1f}", f"{beside:.1f}", names or "-", missing])
    return rows


def _as_in(layout: str, skeleton: Skeleton, data: PoseData) -> PoseData:
    """Return ``data`` as built from a file of ``layout``: means are made of the joints there, what it lacks is missing."""
    made = skeleton.sources[layout]
    of_part = {parts[0]: skeleton.index(joint) for joint, parts in made.items() if len(parts) == 1}
    keypoints, confidence = data.keypoints.copy(), np.zeros_like(data.confidence)
    for joint, parts in made.items():
        place = skeleton.index(joint)
        places = [of_part[part] for part in parts if part in of_part] or [place]
        keypoints[:, place] = data.keypoints[:, places].mean(1)
        confidence[:, place] = data.confidence[:, places].min(1)
    return replace(data, keypoints=keypoints, confidence=confidence)


# What it takes for another body.


def _refusals(model: Model, truth: PoseData) -> list[list[str]]:
    """Return how strange test clips (bodies, where there are no clips) look to the lifter, and joints in random order."""
    groups, what = truth.clips(), "test clips"
    if np.median(np.bincount(groups)) < _FEW:  # single frames: by kind
        groups, what = np.unique(truth.identity.get("subject", np.zeros(len(truth))), return_inverse=True)[1], "kinds"
    own = [strangeness(model, truth.select(np.flatnonzero(groups == one)))[0] for one in np.unique(groups)]
    order = np.random.default_rng(0).permutation(len(model.skeleton.joints))
    mixed = replace(truth, keypoints=truth.keypoints[:, order], confidence=truth.confidence[:, order])
    rows = [["input", "median", "largest", f"warned (over {STRANGE:g})", f"refused (over {OTHER:g})"]]
    mixed_up = np.array([strangeness(model, mixed)[0]])
    for name, found in (
        ("the test split" + (f", {len(own)} {what}, each a file" if len(own) > 1 else ""), np.array(own)),
        ("its joints in random order", mixed_up),
    ):
        shares = [f"{(found > limit).mean():.1%}" for limit in (STRANGE, OTHER)]
        rows.append([name, f"{np.median(found):.1f}", f"{found.max():.1f}", *shares])
    return rows
