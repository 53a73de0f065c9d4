"""What `refine_clips` minimises and how: its cost, written plainly, whose gradient autograd gives, and Adam's steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, doubles, seen_bodies
from torch import Tensor

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.geometry.camera import build_camera
from uplift.models import refine
from uplift.models.refine import _blocks, _Bodies, _Problem, refine_clips

SETTINGS = RefineSettings(bones=0.7, near=1.3, seen=0.6, smooth=2.0, iterations=3, rate=0.05)
CLIPS = (5, 3)
ROOT = H36M.root_index
BONES = torch.from_numpy(H36M.bone_indices.copy())
PARTNER = torch.from_numpy(H36M.bone_mirror_permutation.copy())
VARIANTS = {
    "known camera": {},
    "unknown camera": {"focal_px": None},
    "orthographic": {"camera": "orthographic"},
    "every joint sure": {"sure": True},
    "no smoothness": {"smooth": 0.0},
    "camera at the body": {"distance": 2.0},
}


def small_clips(sure: bool = False, camera: str = "perspective", **changes) -> tuple[TrainingSet, Tensor]:
    """Return two clips and depths: by default seen by a known camera, some joints sure, some doubtful, some missing."""
    rng = np.random.default_rng(3)
    data = seen_bodies(**changes).select(slice(0, 8))
    confidence = np.ones((8, 17)) if sure else rng.choice([0.0, 0.4, 0.9995, 1.0], (8, 17))
    confidence[:, ROOT] = 1
    identity = {"sequence": np.repeat(["a", "b"], CLIPS), "frame": np.concatenate([np.arange(n) for n in CLIPS])}
    data = replace(data, keypoints=data.keypoints.astype(float), confidence=confidence, identity=identity)
    depth = torch.from_numpy(rng.normal(0, 0.5, (8, 17)))
    depth[:, ROOT] = 0
    return to_training_set(data, H36M, LifterSettings(camera=camera)), depth


def given(variant: dict) -> tuple[TrainingSet, Tensor, str, RefineSettings]:
    """Return what `refine_clips` takes."""
    rest = {key: value for key, value in variant.items() if key not in ("smooth", "distance")}
    frames, depth = small_clips(**rest)
    if "distance" in variant:  # some joints are at or behind the pinhole
        frames, depth = replace(frames, distance=torch.full_like(frames.distance, variant["distance"])), 3 * depth
        assert (depth < -0.9 * frames.distance[:, None]).any()
    settings = replace(SETTINGS, smooth=variant.get("smooth", SETTINGS.smooth))
    return frames, depth, variant.get("camera", "perspective"), settings


def start_of(frames: TrainingSet, depth: Tensor, camera: str) -> dict[str, Tensor]:
    """Return the variables at the lifted poses, and the mean body and its spread."""
    weight = seen(frames)[:, BONES].prod(-1)
    first = logs(pose_of(frames, frames.keypoints, depth, camera))
    size = -((first.exp() * weight).sum(1) / weight.sum(1)).log()
    scaled = first + size[:, None]
    each = [(scaled[rows] * weight[rows]).sum(0) / weight[rows].sum(0) for rows in (slice(0, 5), slice(5, 8))]
    shape = torch.stack(each)
    common = (scaled * weight).sum(0) / weight.sum(0)
    common = (common + common[PARTNER]) / 2
    spread = ((shape - common) ** 2).mean(0) + 0.02**2
    start = {"depth": depth, "size": size, "shape": shape, "shift": torch.zeros_like(frames.keypoints)}
    return start | {"common": common, "spread": spread}


def pose_of(frames: TrainingSet, keypoints: Tensor, depth: Tensor, camera: str) -> Tensor:
    far = frames.distance[:, None]
    ratio = torch.ones_like(depth) if camera == "orthographic" else (1 + depth / far).clamp_min(0.1)
    return torch.stack([keypoints[..., 0] * ratio, keypoints[..., 1] * ratio, depth], -1)


def seen(frames: TrainingSet) -> Tensor:
    return torch.where(frames.confidence > 0, 1.0, 0.1)


def logs(pose: Tensor) -> Tensor:
    return ((pose[:, BONES[:, 1]] - pose[:, BONES[:, 0]]).square().sum(-1) + 1e-8).sqrt().log()


def huber(value: Tensor, delta: float) -> Tensor:
    return torch.where(value.abs() <= delta, value**2 / 2, delta * (value.abs() - delta / 2))


def costs(
    frames: TrainingSet, camera: str, settings: RefineSettings, start: dict, depth, size, shape, shift
) -> dict[str, Tensor]:
    """Return each weighted term, summed over frames."""
    confidence, weight, far = frames.confidence, seen(frames), frames.distance
    moved = shift * (confidence < 0.999)[..., None]
    pose = pose_of(frames, frames.keypoints + moved, depth * (torch.arange(17) != ROOT), camera)
    if camera == "perspective":  # what is at or behind the pinhole is held before it
        pose = torch.cat([pose[..., :2], pose[..., 2:].clamp_min(-0.9 * far.min())], -1)
    bones = (logs(pose * size.exp()[:, None, None]) - shape[frames.clip]) * weight[:, BONES].prod(-1)
    held = torch.where(confidence > 0, confidence**2, settings.near / settings.seen)
    place = torch.cat([pose[..., :2], pose[..., 2:] + far[:, None, None]], -1) * size.exp()[:, None, None]
    if frames.rotation is not None:
        place = torch.einsum("fba,fjb->fja", frames.rotation, place)
    smooth = [huber(place[f - 1] - 2 * place[f] + place[f + 1], 0.1).sum() for f in (1, 2, 3, 6)]
    return {
        "bones": 10 * settings.bones * huber(bones, 0.1).sum(),
        "near": settings.near * (huber(depth - start["depth"], 0.2) * weight).sum(),
        "seen": settings.seen * (huber(moved, 0.05) * held[..., None]).sum(),
        "sides": 8 * (shape - shape[:, PARTNER]).square().sum(1).mean(),
        "clips": 8 * 0.03 * ((shape - start["common"]) ** 2 / start["spread"]).mean(),
        "size": (size - start["size"]).square().sum(),
        "smooth": settings.smooth * 8 * torch.stack(smooth).mean(),
    }


NAMES = ("depth", "size", "shape", "shift")


def gradient_by_autograd(frames: TrainingSet, camera: str, settings: RefineSettings, start: dict, values: dict) -> dict:
    leaves = {name: values[name].detach().requires_grad_() for name in NAMES}
    with torch.enable_grad():
        terms = costs(frames, camera, settings, start, **leaves)
        found = torch.autograd.grad(torch.stack(list(terms.values())).sum(), list(leaves.values()))
    return dict(zip(NAMES, found, strict=True))


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=list(VARIANTS))
def test_the_gradient_is_that_of_the_cost(variant: dict) -> None:
    with doubles():
        frames, depth, camera, settings = given(variant)
        rows, start = torch.arange(8), start_of(frames, depth, camera)
        lifted = build_camera(camera).unproject(frames.keypoints, depth, frames.distance)
        bodies = _Bodies.of(frames, rows, lifted)
        made = _Problem(frames, rows, frames.keypoints, depth, build_camera(camera), settings, bodies)
        draw = torch.Generator().manual_seed(1)
        values = {name: start[name] + 0.3 * torch.randn(start[name].shape, generator=draw) for name in NAMES}
        values["depth"][:, ROOT] = 0
        values["shift"] = values["shift"] * (frames.confidence < 0.999)[..., None]
        for name, value in made.variables.items():
            value.copy_(values[name].permute(*reversed(range(value.ndim))))
        expected = gradient_by_autograd(frames, camera, settings, start, values)
        found = made.gradient()
        assert set(NAMES) - set(found) == ({"shift"} if variant.get("sure") else set())
        for name, gradient in found.items():
            assert (gradient.abs() > 1e-3).any(), name
            turned = gradient.permute(*reversed(range(gradient.ndim)))
            torch.testing.assert_close(turned, expected[name], rtol=1e-8, atol=1e-10, msg=lambda m, n=name: f"{n}: {m}")


def test_every_term_counts() -> None:
    with doubles():
        frames, depth, camera, settings = given({})
        start = start_of(frames, depth, camera)
        draw = torch.Generator().manual_seed(1)
        values = {name: start[name] + 0.3 * torch.randn(start[name].shape, generator=draw) for name in NAMES}
        terms = costs(frames, camera, settings, start, **values)
        assert all(term > 1e-4 * sum(terms.values()) for term in terms.values()), terms


@pytest.mark.parametrize("variant", ["known camera", "unknown camera", "every joint sure"])
def test_it_is_minimised_by_adam_at_a_falling_rate_of_each_kind(variant: str) -> None:
    """Steps by hand: the rate falls to a tenth, and depths move twice as fast as sizes and shifts, four times as shapes."""
    with doubles():
        frames, depth, camera, settings = given(VARIANTS[variant])
        settings, start = replace(settings, iterations=12), start_of(frames, depth, camera)
        values = {name: start[name].clone() for name in NAMES}
        share = {"depth": 1.0, "size": 0.5, "shape": 0.25, "shift": 0.5}
        moments = {name: [torch.zeros_like(values[name]) for _ in range(2)] for name in NAMES}
        for step in range(12):
            for name, gradient in gradient_by_autograd(frames, camera, settings, start, values).items():
                first, second = moments[name]
                first.mul_(0.8).add_(0.2 * gradient)
                second.mul_(0.9).add_(0.1 * gradient.square())
                rate = 0.05 * share[name] * (1 - 0.9 * step / 12)
                moved = first / (1 - 0.8 ** (step + 1)) / ((second / (1 - 0.9 ** (step + 1))).sqrt() + 1e-8)
                values[name] = values[name] - rate * moved
        moved = values["shift"] * (frames.confidence < 0.999)[..., None]
        expected = pose_of(frames, frames.keypoints + moved, values["depth"], camera)
        found = refine_clips(frames, frames.keypoints, depth, build_camera(camera), settings)
        torch.testing.assert_close(found, expected - expected[:, [ROOT]], rtol=1e-7, atol=1e-9)


def test_blocks_are_whole_clips_of_so_many_frames() -> None:
    def blocks(most: int, *clips: int) -> list[tuple[int, int, int, int]]:
        return [(f.start, f.stop, c.start, c.stop) for f, c in _blocks(torch.tensor(clips), most)]

    expected = [(0, 20_000, 0, 2), (20_000, 20_001, 2, 3), (20_001, 60_000, 3, 4), (60_000, 60_010, 4, 5)]
    assert blocks(20_000, 9000, 11_000, 1, 39_999, 10) == expected
    assert blocks(20_000, 5, 4) == [(0, 9, 0, 2)]


def test_clips_are_solved_alike_in_any_blocks_and_any_order_of_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of two clips that alternate: each is put together, solved, and put back. A frame alone has no influence."""
    with doubles():
        frames, depth, camera, settings = given({})
        camera = build_camera(camera)
        together = refine_clips(frames, frames.keypoints, depth, camera, settings)
        monkeypatch.setattr(refine, "_BLOCK_FRAMES", 4)
        apart = refine_clips(frames, frames.keypoints, depth, camera, settings)
        torch.testing.assert_close(apart, together, rtol=1e-9, atol=1e-12)
        settings = replace(settings, smooth=0.0)
        straight = refine_clips(frames, frames.keypoints, depth, camera, settings)
        order = torch.tensor([5, 0, 6, 1, 2, 7, 3, 4])
        mixed = frames.select(order)
        found = refine_clips(mixed, mixed.keypoints, depth[order], camera, settings)
        torch.testing.assert_close(found, straight[order], rtol=1e-9, atol=1e-12)
        more = TrainingSet.concat([frames, frames.select(slice(2, 3))])
        found = refine_clips(more, more.keypoints, torch.cat([depth, 2 * depth[2:3]]), camera, settings)
        torch.testing.assert_close(found[:8], straight, rtol=1e-9, atol=1e-12)
