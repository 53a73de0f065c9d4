"""The supervised twin: a task's student trained on true poses instead of its teacher's; an upper bound of the recipe.

``python -m benchmarks.accuracy.twin task=cmu trainer.max_time=00:04:00 seed=0`` writes an ordinary run
folder, runs/cmu_twin/<time>. Network, views, mixing and optimiser are the task's; a single round uses the full
budget. It is not 2D-only: it uses poses, root depths and camera tilts of the training file.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from uplift.cli.evaluate import save_evaluation
from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.config.settings import Settings
from uplift.data.load import Loaded, load_data
from uplift.data.module import KeypointData
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, to_training_set
from uplift.errors import UserError
from uplift.geometry.camera import build_camera
from uplift.geometry.rotation import least_rotation, turn
from uplift.metrics.evaluate import evaluate_model
from uplift.skeleton import Skeleton, load_skeleton
from uplift.training.base import plain_settings
from uplift.training.pseudo_labels import PseudoPoses
from uplift.training.stages import run_stage, stage_budgets
from uplift.training.student import StudentModule, student_settings

__all__ = ["gravity_in_camera", "gravity_of_recurring_poses", "load_labelled", "train_twin", "true_poses"]

_NOISY = 1e-3  # mean distance, model units, above which keypoints count as noisy
_MOST_ROLL = 1e-4  # mean squared component of gravity along the image's x: 0.6 degrees


def main(words: list[str]) -> int:
    """Train and evaluate a twin; return the exit status."""
    task = next((word.removeprefix("task=") for word in words if word.startswith("task=")), None)
    try:
        run = train_twin(load_settings(task, [word for word in words if not word.startswith("task=")]))
    except UserError as error:
        print(f"twin: {error}", file=sys.stderr)
        return 2
    print(f"wrote {run.path}/")
    return 0


def train_twin(settings: Settings) -> RunFolder:
    """Train the student of ``settings`` on the truth for the full budget, evaluate it, and return its run."""
    if settings.trainer.threads:
        torch.set_num_threads(settings.trainer.threads)
    skeleton = load_skeleton(settings.skeleton)
    loaded = load_labelled(settings, skeleton)
    poses, note = true_poses(settings, skeleton, loaded.train)
    chosen = student_settings(settings, last=True)
    if chosen.denoise is None:
        chosen = replace(chosen, denoise=poses.noise is not None)
    plain = plain_settings(settings.student)
    module = StudentModule(skeleton, lifter=asdict(chosen), seed=settings.seed + 1, **plain)
    module.frames, module.labelled_share = poses, None
    data = KeypointData.of(loaded, skeleton, replace(settings, data=replace(settings.data, val=None)))
    data.batch_size = settings.student.batch_size
    [budget] = stage_budgets(settings.trainer, [1.0], len(poses), settings.student.batch_size)
    settings = replace(
        settings, task=f"{settings.task or 'own'}_twin", description="Supervised twin, trained on true poses."
    )
    run = RunFolder.create(settings, shlex.join(["python", "-m", "benchmarks.accuracy.twin", *sys.argv[1:]]))
    print(
        "\n".join([f"supervised twin, {len(poses):,} labelled frames; gravity: {note}", f"run: {run.path}"]), flush=True
    )
    run_stage("twin", module, data, settings.trainer, budget, run.path)
    module.cpu()
    model = module.model()
    model.save(run.weights)
    run.link_last()
    if loaded.test is not None and loaded.test.pose is not None:
        evaluation = evaluate_model(model, loaded.test, loaded.test.source)
        save_evaluation(evaluation, run)
        print(evaluation.table())
    return run


def load_labelled(settings: Settings, skeleton: Skeleton) -> Loaded:
    """Return the task's data with poses; a `*_detected` file takes those of the file without that suffix.

    Raises:
        UserError: neither file has poses, or their rows differ.
    """
    loaded = load_data(settings, skeleton)
    train, file = loaded.train, Path(settings.data.train or "")
    if train.pose is None and file.stem.endswith("_detected"):
        exact = replace(settings.data, train=str(file.with_stem(file.stem.removesuffix("_detected"))), test=None)
        true = load_data(replace(settings, data=exact), skeleton).train
        same = len(true) == len(train) and all(
            key in true.identity and np.array_equal(values, true.identity[key])
            for key, values in train.identity.items()
        )
        if not same:
            raise UserError(f"{true.source}: its frames are not those of {train.source}.")
        train = replace(train, pose=true.pose, root=true.root, unit=true.unit, tilt_deg=true.tilt_deg)
    if train.pose is None:
        raise UserError(
            f"{train.source}: has no 'pose': a supervised twin needs the true poses of its training frames."
        )
    return replace(loaded, train=train)


def true_poses(settings: Settings, skeleton: Skeleton, train: PoseData) -> tuple[PseudoPoses, str]:
    """Return the frames as a teacher with true depths would lift them, and the source of gravity.

    The student's noise is the difference between the keypoints and the projected poses. Missing joints get their true
    positions.
    """
    assert train.pose is not None
    data = to_training_set(train, skeleton, settings.lifter)
    known = torch.from_numpy(np.isfinite(train.pose).all(-1))
    pose = torch.from_numpy(np.nan_to_num(train.pose))
    gravity, note = gravity_in_camera(train, skeleton)
    down = torch.from_numpy(gravity).to(pose)
    if data.rotation is not None:
        pose, down = turn(pose, data.rotation), turn(down[:, None], data.rotation)[:, 0]
    seen = data.confidence > 0
    pose = pose * _units(data, pose, (seen & known).unsqueeze(-1), train.root)[:, None, None]
    noise = data.keypoints - build_camera(settings.lifter.camera).project(pose, data.distance)
    noise = noise * (seen & known).unsqueeze(-1)
    if skeleton.gravity:
        pose = turn(pose, least_rotation(down, pose.new_tensor([0.0, 1.0, 0.0])))
    confidence = torch.where(seen, data.confidence, torch.ones_like(data.confidence)) * known
    return PseudoPoses(
        skeleton=skeleton,
        pose=pose,
        gravity=down,
        distance=data.distance,
        confidence=confidence,
        noise=noise if noise.norm(dim=-1).mean() > _NOISY else None,
    ), note


def _units(data: TrainingSet, pose: Tensor, both: Tensor, root: np.ndarray | None) -> Tensor:
    """Return the model's units per unit of ``pose``: from the true distance if known, else from the 2D."""
    if data.rotation is not None and root is not None:
        return data.distance / torch.from_numpy(root).norm(dim=-1)
    flat = pose[..., :2] * both
    return (flat * data.keypoints).sum((1, 2)) / flat.square().sum((1, 2)).clamp_min(1e-12)


def gravity_in_camera(train: PoseData, skeleton: Skeleton) -> tuple[Float[np.ndarray, "frames 3"], str]:
    """Return the direction of gravity in each real camera's frame, and how it was found.

    From the file's `tilt_deg` if present; else from poses that several cameras saw at once, as gravity is perpendicular
    to the x axes of cameras without roll; else cameras are assumed level.
    """
    level = np.tile([0.0, 1.0, 0.0], (len(train), 1))
    if not skeleton.gravity:
        return level, "none"
    if train.tilt_deg is not None:
        tilt = np.radians(train.tilt_deg.astype(np.float64))
        return np.stack([np.zeros_like(tilt), np.cos(tilt), np.sin(tilt)], 1), "the file's camera tilts"
    found = gravity_of_recurring_poses(train, rigid=skeleton.rigid)
    return (level, "unknown, cameras assumed level") if found is None else (found, "poses seen from several sides")


def gravity_of_recurring_poses(train: PoseData, *, rigid: bool = False) -> Float[np.ndarray, "frames 3"] | None:
    """Return gravity in each camera's frame from frames of the same moment, None if that does not determine it.

    All frames of a ``rigid`` subject count as one moment.
    """
    moment = ("subject",) if rigid else ("subject", "action", "sequence", "frame")
    keys = [train.identity[key].astype(str) for key in moment if key in train.identity]
    if moment[-1] not in train.identity or train.pose is None or not np.isfinite(train.pose).all():
        return None
    _, first, group = np.unique(np.stack(keys, 1), axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    pose = train.pose.astype(np.float64)
    # Kabsch 1976: the rotation from the frame of a moment's first camera to that of each other.
    left, _, right = np.linalg.svd(pose.transpose(0, 2, 1) @ pose[first[group]])
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotation = left @ right
    sideways = rotation[:, 0]
    spread = np.zeros((len(first), 3, 3))
    np.add.at(spread, group, sideways[:, :, None] * sideways[:, None])
    spread /= np.bincount(group)[:, None, None]
    size, axis = np.linalg.eigh(spread)
    if size[:, 0].max() > _MOST_ROLL or np.median(size[:, 1]) < _MOST_ROLL:
        return None  # cameras with roll, or one camera per moment
    down = np.einsum("fij,fj->fi", rotation, axis[group, :, 0])
    upright = np.zeros(len(first))
    np.add.at(upright, group, down[:, 1])
    return down * np.sign(upright)[group, None]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
