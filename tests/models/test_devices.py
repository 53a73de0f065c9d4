"""Where inference computes: all of it on the lifter's device, without waiting for it within a descent, on several threads alike."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, small_lifter
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from uplift.config.device import half_is_fast
from uplift.config.settings import LifterSettings
from uplift.config.threads import in_threads
from uplift.data.clean import clean
from uplift.data.confidence import calibrated
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import to_training_set
from uplift.errors import UserError
from uplift.models import predict, refine, signs
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.models.predict import infer

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def lifter() -> Lifter:
    torch.manual_seed(0)
    found = small_lifter(uncertainty=True, signs=8, cameras="any", fill=True, tilt="predicted")
    torch.nn.init.normal_(found.signs.leave.weight)
    return found


SETTINGS = LifterSettings(cameras="any")


def film() -> PoseData:
    """Return four simulated clips with gaps, seen by a camera of unknown focal length."""
    data = simulate(H36M, 120, seed=3, clip_seconds=3.0)
    confidence = np.ones((120, 17), np.float32)
    confidence[7::11, 5] = 0
    return clean(replace(data, focal_px=None, confidence=confidence), H36M, drop=False)[0]


@contextmanager
def kept_on_the_device(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Within, what is made without a device is useless, and numbers with a point cannot be read."""

    def refusing(name: str):
        usual = getattr(Tensor, name)

        def read(tensor: Tensor, *arguments: object, **options: object) -> object:
            assert not tensor.is_floating_point(), f"Tensor.{name} of {tuple(tensor.shape)}"
            return usual(tensor, *arguments, **options)

        return read

    with monkeypatch.context() as patch:
        for name in ("cpu", "numpy", "tolist", "item", "__float__", "__array__"):
            patch.setattr(Tensor, name, refusing(name))
        with torch.device("meta"):
            yield


@pytest.mark.parametrize("refined", [True, False])
def test_everything_from_the_training_set_to_the_pose_is_computed_on_the_device(
    lifter: Lifter, refined: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = infer(lifter, film(), SETTINGS, refine=refined, hypotheses=2)
    frames = to_training_set(
        calibrated(film(), H36M, SETTINGS), H36M, SETTINGS
    )  # on the processor, from NumPy's arrays
    monkeypatch.setattr(predict, "to_training_set", lambda *_: frames)
    with kept_on_the_device(monkeypatch):
        found = infer(lifter, film(), SETTINGS, refine=refined, hypotheses=2)
    assert torch.equal(found.pose, usual.pose) and torch.equal(found.hypotheses.pose, usual.hypotheses.pose)


class NoWaiting(TorchDispatchMode):
    """Refuses what a device has to finish its work for: values that decide, and shapes that values decide on."""

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        name = str(function)
        waits = ("_local_scalar_dense", "nonzero", "bincount", "unique", "masked_select", "repeat_interleave")
        assert not any(f"aten.{word}" in name for word in waits), name
        return function(*arguments, **(options or {}))


def test_a_descent_and_the_messages_along_a_clip_wait_for_no_value(lifter: Lifter, monkeypatch) -> None:
    def watched(function):
        def run(*arguments: object) -> object:
            ran.append(function.__name__)
            with NoWaiting():
                return function(*arguments)

        return run

    ran: list[str] = []
    for module, name in ((refine, "_solve"), (signs, "_by_acceleration"), (signs, "_by_speed")):
        monkeypatch.setattr(module, name, watched(getattr(module, name)))
    infer(lifter, film(), SETTINGS, refine=True)
    assert set(ran) == {"_solve", "_by_acceleration", "_by_speed"}


def test_several_threads_give_what_one_gives(lifter: Lifter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predict, "_CHUNK", 16)
    monkeypatch.setattr(refine, "_BLOCK_FRAMES", 20)
    monkeypatch.setattr(signs, "_WINDOWS", 1)
    alone = infer(lifter, film(), SETTINGS, refine=True)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        together = infer(lifter, film(), SETTINGS, refine=True)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(together.pose, alone.pose, rtol=1e-5, atol=1e-3)


def test_parts_of_work_come_back_in_order_and_a_fault_ends_it() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert in_threads(lambda part: part**2, range(20), CPU, "squaring") == [part**2 for part in range(20)]
        with pytest.raises(ZeroDivisionError):
            in_threads(lambda part: 1 // (part - 3), range(200), CPU, "dividing")
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_networks_in_bfloat16_change_little_and_only_where_that_is_asked_for(lifter: Lifter) -> None:
    exact, half, again = (infer(lifter, film(), SETTINGS, refine=False, half=one).pose for one in (False, True, False))
    assert torch.equal(exact, again)
    off = (half - exact).norm(dim=-1).mean() / exact.norm(dim=-1).mean()
    assert 0 < off < 2e-3


def test_a_model_says_and_chooses_what_computes(lifter: Lifter) -> None:
    model = Model(lifter, H36M, SETTINGS)
    assert model.on("cpu").to("cpu") is model and model.device == CPU
    if not torch.cuda.is_available():
        assert model.on("auto").device == CPU
        assert not half_is_fast(torch.device("mps"))
        with pytest.raises(UserError, match="accelerator=cuda"):
            model.on("cuda")
    with pytest.raises(UserError, match="Did you mean"):
        model.on("cudo")
    model.products = "highest"
    poses = [model.predict(film(), refine=False).pose for _ in range(2)]
    np.testing.assert_array_equal(*poses)
    np.testing.assert_array_equal(poses[0], infer(lifter, film(), SETTINGS, refine=False).pose.numpy())
