"""Devices by name, and products that are exact whatever way they take."""

from __future__ import annotations

import pytest
import torch

from uplift.config import device
from uplift.config.device import ACCELERATORS, device_of, fast_products, precision_of
from uplift.errors import UserError


def relative_error() -> float:
    left, right = torch.randn(300, 200), torch.randn(200, 400)
    exact = left.double() @ right.double()
    return float((left @ right - exact).norm() / exact.norm())


def test_automatic_products_have_the_error_of_float32_and_the_former_way_comes_back() -> None:
    before = torch.get_float32_matmul_precision()
    with fast_products("auto"):
        assert relative_error() < 1e-5
    with fast_products("high"), pytest.raises(ZeroDivisionError):
        assert torch.get_float32_matmul_precision() == "high"
        with fast_products("medium"):
            raise ZeroDivisionError
    assert torch.get_float32_matmul_precision() == before


def test_a_processor_whose_fast_products_are_rounded_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    device._fastest_exact.cache_clear()
    monkeypatch.setattr(device, "_EXACT", 0.0)
    with fast_products("auto"):
        assert torch.get_float32_matmul_precision() == "highest"
    device._fastest_exact.cache_clear()


def test_devices_by_name() -> None:
    assert device_of("cpu") == torch.device("cpu")
    assert device_of("auto").type in ACCELERATORS
    with pytest.raises(UserError, match="accelerator=cudda.*cuda"):
        device_of("cudda")
    if not torch.cuda.is_available():
        with pytest.raises(
            UserError, match=r"accelerator=gpu: PyTorch finds no such device here, expected one of: auto"
        ):
            device_of("gpu")


def test_automatic_precision_follows_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    for found in ("avx512_bf16", "amx_tile", ""):
        for name in ("avx512_bf16", "amx_tile"):
            monkeypatch.setattr(torch.cpu, f"_is_{name}_supported", lambda is_it=name == found: is_it, raising=False)
        device._half_on_cpu.cache_clear()
        assert precision_of("auto", "cpu") == ("bf16-mixed" if found else "32-true")
        assert precision_of("auto", "gpu") == precision_of("32-true", "cpu") == "32-true"
    device._half_on_cpu.cache_clear()
