"""Steps whose tensors are on an accelerator read nothing back and take nothing from the host: shown on the device "meta"."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from bodies import write_body
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import uplift
from uplift.data.samples import Samples
from uplift.training.base import TrainingModule

STEP = 101
"""After those in which priors are watched, and not one of those that look at losses."""


class Apart(TorchDispatchMode):
    """Fails where numbers of the device are read, or where sizes depend on them, or tensors come from the host."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        assert name not in ("_local_scalar_dense", "nonzero", "is_nonzero", "masked_select", "unique_dim"), name
        tensors = [one for one in tree_leaves((args, kwargs)) if isinstance(one, torch.Tensor)]
        devices = {one.device.type for one in tensors if one.ndim}
        result = func(*args, **(kwargs or {}))
        made = {one.device.type for one in tree_leaves(result) if isinstance(one, torch.Tensor)}
        assert len(devices | made) < 2 or name == "detach", f"{name}: {devices} and {made}"
        masks = [one for one in tree_leaves(args[1:2]) if isinstance(one, torch.Tensor) and one.dtype == torch.bool]
        assert name not in ("index", "index_put", "index_put_") or not masks, f"{name} with a mask"
        return result


def moved(value: Any) -> Any:
    """Return all tensors in ``value`` on "meta", as those that are set up once there are."""
    if isinstance(value, torch.Tensor):
        return value.to("meta")
    if isinstance(value, Samples):
        return value.to("meta")  # type: ignore[arg-type]
    if isinstance(value, dict):
        return {key: moved(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return type(value)(moved(part) for part in value)
    if type(value).__name__ in ("ViewMaker", "LimbMixer", "LabelledSampler", "_Limb"):
        other = copy.copy(value)
        for key, part in vars(value).items():
            object.__setattr__(other, key, torch.device("meta") if key == "device" else moved(part))
        return other
    return value


def at(step: int, module: TrainingModule) -> Any:
    """Return the module on "meta", as it is after so many steps."""
    kind = type(module)
    module.__class__ = type(kind.__name__, (kind,), {"global_step": property(lambda self: step)})
    module.terms.idle = {}
    module.frames = moved(module.frames)
    for name in ("sampler", "_maker", "maker"):
        if name in vars(module):
            setattr(module, name, moved(getattr(module, name)))
    return module.to("meta")


def teacher(
    task: Callable[[], dict[str, Any]], here: Path, skeleton: str = "h36m17", **options: Any
) -> uplift.LiftingModule:
    data = uplift.KeypointData(write_body(here / f"{skeleton}.npz", frames=60, skeleton=skeleton), skeleton, val=None)
    module = uplift.LiftingModule(
        skeleton, lifter={"options": {"units": 16, "blocks": 1}}, average=0.9, **task(), **options
    )
    if "flow" in module.priors:
        module.priors["flow"].steps = 2
    module.prepare(data)
    return module


PRIORS = {
    "default": dict,
    "all": lambda: {
        "priors": {**dict.fromkeys(("bones", "pairwise", "handedness", "consistency", "critic", "fill"), 1.0), "symmetry": {"if_possible": True},
                   "flow": {"steps": 2}}, "hide": 0.2, "views": {"elevation": "batch"},
    },
    "2018": lambda: {"priors": {"critic": {"objective": "minimax"}, "handedness": {"planar": False, "frame": "camera"}}},
}  # fmt: skip


@pytest.mark.parametrize("skeleton", ["h36m17", "hand21"])
@pytest.mark.parametrize("recipe", PRIORS)
def test_a_teachers_step(recipe: str, skeleton: str, here: Path) -> None:
    module = at(STEP, teacher(PRIORS[recipe], here, skeleton))
    with Apart():
        module.training_step(16, STEP).backward()
    assert module.averaged is not None
    module.averaged.n_averaged = torch.zeros((), dtype=torch.long)
    module.averaged.update_parameters(module.lifter)
    module.averaged.to("meta")
    with Apart():
        module.averaged.update_parameters(module.lifter)
    assert all(p.grad is not None for p in module.lifter.network.parameters())


@pytest.mark.parametrize("cameras", ["any", "own"])
def test_a_students_step(cameras: str, here: Path) -> None:
    given = teacher(dict, here)
    data = given.prepared_with() if given.prepared_with else None
    data = data or uplift.KeypointData(here / "h36m17.npz", "h36m17", val=None)
    student = uplift.StudentModule("h36m17", teacher=given, cameras=cameras, refine={"iterations": 2}, any_way=0.3)
    student.prepare(data)
    student.maker(8 * 16)  # what is set up once
    student = at(STEP, student)
    with Apart():
        student.training_step(8, STEP).backward()
        student._views(8)
    assert all(p.grad is not None for p in student.lifter.parameters())


def test_a_step_with_labelled_frames(here: Path) -> None:
    data = uplift.KeypointData(write_body(here / "a.npz", frames=60), "h36m17", val=None, labelled=0.5)
    module = uplift.LiftingModule("h36m17", lifter={"options": {"units": 16, "blocks": 1}}, priors={"labelled": 1.0})
    module.prepare(data)
    module.objective(8)
    module = at(STEP, module)
    with Apart():
        module.training_step(8, STEP).backward()
