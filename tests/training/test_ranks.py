"""Several processes are one: the same losses, gradients, random numbers and results as one process with the same batch."""

from __future__ import annotations

import importlib
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from bodies import own_data, refusal, status_of
from hypothesis import given
from hypothesis import strategies as st

from uplift.config import ranks
from uplift.config.run import RunFolder
from uplift.errors import UserError
from uplift.priors import PRIORS
from uplift.training.callbacks import read_metrics
from uplift.training.launch import _found

TOGETHER = '''
import functools
import sys
import types
import numpy as np
import torch
import uplift
from torch import distributed
from uplift.config import ranks
from uplift.config.settings import RefineSettings
from uplift.data.poses import PoseData
from uplift.models import refine, signs
from uplift.priors.base import Lift
from uplift.training import mixture as mixtures, shapes as spaces
from uplift.training.mixture import MixtureModule
from uplift.training.pseudo_labels import lift_all

BATCH = 22
PRIORS = {
    "flow": {"steps": 3}, "bones": {"weight": 10.0, "slack": 0.05}, "handedness": 1.0, "consistency": 1.0,
    "pairwise": 1.0, "symmetry": 1.0, "fill": 1.0, "labelled": 1.0, "critic": {"weight": 1.0, "gate": [0.1, 0.9]}, "mask": 1.0,
}
SMALL = {"options": {"units": 16}}
SHAPE = {"coarse": 8, "detail": 12, "crop": 12, "pixels": 12, "code": 4, "hidden": 16, "parts": 2}


class Mine(uplift.Prior):
    """As a user writes it: a number of the batch it sees, and numbers of its own."""

    def loss(self, lift):
        return Lift.mean(lift.level_pose[..., 1].square(), lift.visible) + lift.rotated.square().mean()


@functools.cache
def data(labelled):
    """Return bodies with true poses and masks, a fifth of the joints missing: more on some ranks than on others."""
    poses = uplift.KeypointData(160, "h36m17", val=0, seed=3).train_samples
    masks = np.zeros((len(poses), 16, 16), np.uint8)
    masks[:, 2:-2, 2:-2] = 255
    low = poses.keypoints.min(1) - 20
    side = (poses.keypoints.max(1) + 20 - low).max(1, keepdims=True)
    missing = np.random.default_rng(0).random(poses.confidence.shape) < 0.2
    missing[:, 0] = False
    given = {name: getattr(poses, name) for name in ("pose", "root", "tilt_deg", "identity", "image_size", "fps", "unit")}
    return uplift.KeypointData(
        PoseData(
            poses.keypoints, np.where(missing, 0, poses.confidence).astype(np.float32), poses.joint_names, source="a",
            masks=masks, mask_box=np.concatenate([low, side], 1).astype(np.float32), **given,
        ),
        "h36m17", val=0, batch_size=BATCH, labelled=labelled,
    )


def step(module, batch=BATCH):
    """Return loss, terms and gradients of one step, as `DistributedDataParallel` averages them."""
    loss = module.training_step(batch, 0)
    module.zero_grad()
    loss.backward()
    found = {name: p.grad for name, p in module.named_parameters() if p.grad is not None}
    for name in sorted(found) if ranks.world() > 1 else ():
        distributed.all_reduce(found[name])
        found[name] /= ranks.world()
    return {"loss": loss.detach(), **{f"term {n}": torch.as_tensor(v) for n, v in module.logged.items()}, **found}


def teacher(**more):
    given = {"priors": PRIORS, "lifter": SMALL, "hide": 0.2, "average": None, **more}
    module = uplift.LiftingModule("h36m17", **given)
    module.prepare(data(0.3 if "labelled" in given["priors"] else None))
    return module


def student(source, **more):
    module = uplift.StudentModule("h36m17", teacher=source, average=None, **more)
    module.prepare(data(None))
    return module


def all_results():
    plain = {"bones": 1.0, "mine": Mine}
    lifter = teacher()
    found = {"batch": step(lifter), "normal": step(teacher(views={"elevation": "normal"}))}
    found["own"] = step(teacher(priors=plain, hide=0.0, views={"elevation": "batch"}))
    found["any camera"] = step(student(lifter, lifter={**SMALL, "signs": 16, "uncertainty": True, "cameras": "any"}))
    found["own camera"] = step(student(lifter, lifter={**SMALL, "tilt": "predicted", "cameras": "own"}))
    masks = uplift.MaskDataModule(60, family="chairs", side=32, batch_size=16, val=0)
    views = MixtureModule(shape=SHAPE, average=None)
    views.prepare(masks)
    found["views"] = step(views, 16)
    shapes = uplift.ShapeModule(views, shape=SHAPE, average=None, detail=8, first=False)
    shapes.prepare(masks)
    shapes.find_views()
    found["shapes"] = step(shapes, 16)
    later = shapes.go_on(12)
    later.trainer = types.SimpleNamespace(precision="32-true", global_step=0)
    later.prepare(masks)
    later.find_views()
    found["picked"] = {name: value.clone() for name, value in vars(later.poses.hypotheses()).items()}
    frames = data(None).frames(lifter.lifter_settings)
    refine._BLOCK_FRAMES = signs._BLOCK_FRAMES = 40
    solved = student(lifter, lifter={**SMALL, "signs": 16})
    with ranks.work_shared():
        poses = lift_all(solved.lifter, frames, RefineSettings(iterations=3))
    found["lifted"] = {"pose": poses.pose, "gravity": poses.gravity}
    return found


if __name__ == "__main__":
    rank, folder = int(sys.argv[1]), sys.argv[2]
    torch.set_num_threads(1)
    distributed.init_process_group("gloo", init_method=f"file://{folder}/store", rank=rank, world_size=2)
    mixtures._CHUNK = spaces._PICK_CHUNK = 20
    torch.save(all_results(), f"{folder}/rank{rank}.pt")
'''  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory):
    """Return what one process finds, and what each of two that share the batch find."""
    folder = tmp_path_factory.mktemp("ranks")
    (folder / "together.py").write_text(TOGETHER)
    words = [sys.executable, str(folder / "together.py")]
    both = [subprocess.Popen([*words, str(rank), str(folder)], stderr=subprocess.PIPE, text=True) for rank in (0, 1)]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        together = importlib.import_module("together")

        patch.setattr("uplift.models.refine._BLOCK_FRAMES", 4000)
        patch.setattr("uplift.models.signs._BLOCK_FRAMES", 4000)
        alone = together.all_results()
    for one in both:
        _, text = one.communicate(timeout=240)
        assert one.returncode == 0, text[-3000:]
    return alone, *(torch.load(folder / f"rank{rank}.pt", weights_only=True) for rank in (0, 1)), together.PRIORS


def test_a_step_of_two_ranks_is_that_of_one(results) -> None:
    """Loss, every term and the gradient of every parameter agree to 1e-5, in two parts of 10 and 12 frames."""
    alone, first, second, priors = results
    judge_poses = set(PRIORS) - {"smoothness", "compactness", "shape_symmetry", "mask_critic"}
    assert judge_poses == set(priors)
    for name, expected in alone.items():
        # A gradient that cancels, as that of the critic's last bias, is compared with those beside it.
        scale = torch.stack([value.norm() for value in expected.values()]).median()
        for found in (first[name], second[name]):
            assert found.keys() == expected.keys()
            for key, value in expected.items():
                off = (found[key] - value).norm() / torch.maximum(value.norm(), scale)
                assert off < 1e-5, (name, key, float(off))


@given(batch=st.integers(2, 60), world=st.integers(1, 8), times=st.integers(1, 3), seed=st.integers(0, 99))
def test_ranks_draw_the_numbers_of_one_batch(batch: int, world: int, times: int, seed: int) -> None:
    """Parts of all ranks, side by side, are the whole; pairs of neighbours stay together."""

    def draw(share: ranks.Share | None, dim: int) -> torch.Tensor:
        torch.manual_seed(seed)
        count = times * (batch if share is None else share.count)
        with ranks.sharing(share):
            return ranks.drawn(count, lambda n: torch.rand((n, 3) if dim == 0 else (3, n)), dim=dim)

    if batch < 2 * world:
        with pytest.raises(UserError, match="two for each"):
            ranks.Share.of(batch, 0, world)
        return
    shares = [ranks.Share.of(batch, rank, world) for rank in range(world)]
    assert [share.start for share in shares] == [sum(one.count for one in shares[:rank]) for rank in range(world)]
    assert sum(share.count for share in shares) == batch and all(share.start % 2 == 0 for share in shares)
    assert max(share.count for share in shares) - min(share.count for share in shares) <= 3
    for dim in (0, 1):
        whole = draw(None, dim).unflatten(dim, (times, batch))
        parts = [draw(share, dim).unflatten(dim, (times, share.count)) for share in shares]
        assert torch.equal(torch.cat(parts, dim + 1), whole)


# The command line.


def _scores(run: Path) -> dict[tuple[str, ...], float]:
    return {tuple(row[:3]): float(row[3]) for row in read_metrics(run / "metrics.csv")}


def test_a_fit_on_two_devices_is_one_run(here: Path) -> None:
    """One folder, one report, said once; losses as of one process, which goes on where two stopped."""
    words = [*own_data(here / "a.npz"), "trainer.accelerator=cpu", "trainer.precision=32-true", "data.val=0.2"]
    assert status_of("fit", *words) == 0
    alone = RunFolder.open("runs/h36m17").path
    command = [sys.executable, "-m", "uplift.cli.main", "fit", *words, "trainer.devices=2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr[-3000:]
    runs = {path.resolve() for path in (here / "runs" / "h36m17").iterdir()}
    assert len(runs) == 2 and done.stdout.count("run: runs/") == 1 and done.stdout.count("next: uplift") == 1
    together = RunFolder.open("runs/h36m17").path
    assert together != alone.resolve()
    first, second = _scores(alone), _scores(together)
    assert first.keys() == second.keys()
    assert all(second[key] == pytest.approx(value, rel=1e-3, abs=1e-4) for key, value in first.items())
    (together / "checkpoints" / "student_1.ckpt").unlink()
    before = torch.load(together / "lifter.pt", weights_only=True)["state"]
    assert status_of("fit", f"resume={together}", "trainer.devices=1") == 0
    after = torch.load(together / "lifter.pt", weights_only=True)["state"]
    assert all(torch.allclose(before[key], value, atol=1e-3) for key, value in after.items())


ENVIRONMENTS = [
    ({"RANK": "0"}, "has RANK, as torchrun sets, but not WORLD_SIZE"),
    ({"RANK": "0", "LOCAL_RANK": "0", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "but not WORLD_SIZE"),
    ({"RANK": "2", "WORLD_SIZE": "2", "LOCAL_RANK": "0", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "process 2 of 2"),
    ({"RANK": "1", "WORLD_SIZE": "4", "LOCAL_RANK": "1", "LOCAL_WORLD_SIZE": "3", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "of 3 on"),
    ({"RANK": "x", "WORLD_SIZE": "2", "LOCAL_RANK": "0", "MASTER_ADDR": "a", "MASTER_PORT": "1"}, "RANK=x: expected a whole number"),
    ({"RANK": "0", "WORLD_SIZE": "2", "LOCAL_RANK": "0", "MASTER_ADDR": "a", "MASTER_PORT": "http"}, "MASTER_PORT=http"),
    ({"SLURM_NTASKS": "2"}, "SLURM_PROCID, SLURM_LOCALID are not set: start the command with srun"),
    ({"SLURM_NTASKS": "2", "SLURM_PROCID": "2", "SLURM_LOCALID": "0"}, "srun says that this is process 2 of 2"),
]  # fmt: skip


@pytest.mark.parametrize(("environ", "message"), ENVIRONMENTS)
def test_an_odd_environment_is_said_in_one_line(environ: dict[str, str], message: str) -> None:
    with pytest.raises(UserError) as caught:
        _found(environ)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_who_started_a_process() -> None:
    """Variables as the programs set them."""
    assert _found({}) is None and _found({"WORLD_SIZE": "1", "RANK": "0"}) is None
    assert _found({"SLURM_NTASKS": "1"}) is None
    interactive = {"SLURM_NTASKS": "4", "SLURM_JOB_NAME": "bash"}
    assert _found(interactive) is None
    torchrun = {
        "RANK": "5",
        "WORLD_SIZE": "8",
        "LOCAL_RANK": "1",
        "LOCAL_WORLD_SIZE": "4",
        "MASTER_ADDR": "a",
        "MASTER_PORT": "29500",
    }
    found = _found({**interactive, **torchrun})
    assert found is not None and (found.rank, found.ranks, found.local_rank, found.nodes) == (5, 8, 1, 2)
    srun = {
        "SLURM_NTASKS": "8",
        "SLURM_PROCID": "6",
        "SLURM_LOCALID": "2",
        "SLURM_NNODES": "2",
        "SLURM_JOB_ID": "73421",
    }
    found = _found({**srun, "SLURM_STEP_NODELIST": "gpu[07-08]"})
    assert found is not None and (found.rank, found.ranks, found.local_ranks, found.nodes) == (6, 8, 4, 2)
    assert (found.host, found.port) == ("gpu07", 15_000 + 3421)


@pytest.mark.parametrize(
    ("rank", "taken", "message"),
    [
        (0, True, "another program uses this port"),
        (1, True, "found no process 0 at MASTER_ADDR=127.0.0.1"),
        (1, False, "found no process 0 at MASTER_ADDR=127.0.0.1"),
        (0, False, "1 of 2 processes started, waited 1 s: there is no process 1"),
    ],
)
def test_a_process_without_the_others_ends_in_one_line(
    here: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, rank: int, taken: bool, message: str
) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        if not taken:
            other.close()
        variables = {"RANK": rank, "WORLD_SIZE": 2, "LOCAL_RANK": rank, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
        for name, value in variables.items():
            monkeypatch.setenv(name, str(value))
        assert message in refusal(capsys, "fit", *own_data(here / "a.npz"), "trainer.wait=1")


def test_devices_that_disagree_with_torchrun(here: Path, capsys: pytest.CaptureFixture, monkeypatch) -> None:
    for name, value in {
        "RANK": 0,
        "WORLD_SIZE": 2,
        "LOCAL_RANK": 0,
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": 1,
    }.items():
        monkeypatch.setenv(name, str(value))
    assert "torchrun started 2 processes" in refusal(capsys, "fit", *own_data(here / "a.npz"), "trainer.devices=3")
    assert "trainer.num_nodes=3" in refusal(capsys, "fit", *own_data(here / "a.npz"), "trainer.num_nodes=3")
