"""What computes: the device of an accelerator's name, and the fast way of float32 matrix products where it is exact."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from uplift.errors import UserError, did_you_mean

if TYPE_CHECKING:
    import torch

__all__ = ["ACCELERATORS", "PRODUCTS", "device_of", "fast_products", "half_is_fast", "mixed_precision", "precision_of"]

ACCELERATORS = ("auto", "cpu", "cuda", "mps")
"""Devices by name; Lightning's "gpu" is taken too."""
PRODUCTS = ("auto", "highest", "high", "medium")
"""How float32 matrices are multiplied, as in `torch.set_float32_matmul_precision`; "auto" decides by the machine."""
_EXACT = 4e-6
"""Relative error of a product of random matrices that counts as that of float32, which has up to 6e-7; TF32 has 3e-4."""
_SIDE = 256


def device_of(accelerator: str) -> torch.device:
    """Return the device of an accelerator; "auto" is a CUDA device, else Apple's, else the processor.

    Raises UserError: an unknown name, or a device that this machine lacks.
    """
    import torch

    name = "cuda" if accelerator == "gpu" else accelerator
    there = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available(), "cpu": True}
    if name == "auto":
        return torch.device(next(kind for kind, found in there.items() if found))
    if name.partition(":")[0] not in there:
        raise UserError(f"accelerator={accelerator}.{did_you_mean(accelerator, ACCELERATORS)}")
    if not there[name.partition(":")[0]]:
        found = ", ".join(kind for kind, usable in there.items() if usable)
        raise UserError(
            f"accelerator={accelerator}: PyTorch finds no such device here, expected one of: auto, {found}."
        )
    return torch.device(name)


def mixed_precision(device: torch.device) -> torch.dtype | None:
    """Return the data type of autocast on a device where it is on, else None."""
    import torch

    if not (torch.amp.is_autocast_available(device.type) and torch.is_autocast_enabled(device.type)):
        return None
    return torch.get_autocast_dtype(device.type)


def precision_of(precision: str, accelerator: str) -> str:
    """Return the precision of Lightning's Trainer; "auto" is "bf16-mixed" on processors that multiply bfloat16, else "32-true"."""
    if precision != "auto":
        return precision
    # On other processors bfloat16 is emulated and slow. GPUs have TF32 by `fast_products`.
    on_cpu = accelerator in ("auto", "cpu") and device_of(accelerator).type == "cpu"
    return "bf16-mixed" if on_cpu and _half_on_cpu() else "32-true"


@contextmanager
def fast_products(way: str = "auto", *, training: bool = False) -> Iterator[None]:
    """Multiply float32 matrices inside as ``way``, one of `PRODUCTS`, says; afterwards as before.

    "auto" is "medium" on processors where a product that way has the error of float32: some multiply up to twice as fast
    then, others round to bfloat16 and are left alone. On CUDA it is "high" (TF32) in ``training``, whose steps are noisy
    anyway, and leaves all else alone.
    """
    import torch

    before = torch.get_float32_matmul_precision()
    if way == "auto":
        # One setting holds for all devices, and TF32 is for training alone.
        way = ("high" if training else before) if torch.cuda.is_available() else _fastest_exact(before)
    torch.set_float32_matmul_precision(way)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@cache
def _fastest_exact(before: str) -> str:
    """Return "medium" where its products are exact on this processor, else ``before``."""
    import torch

    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(_SIDE, _SIDE, generator=generator) for _ in range(2))
    exact = left.double() @ right.double()
    torch.set_float32_matmul_precision("medium")
    try:
        error = float((left @ right - exact).norm() / exact.norm())
    finally:
        torch.set_float32_matmul_precision(before)
    return "medium" if error < _EXACT else before


def half_is_fast(device: torch.device) -> bool:
    """Return whether the device has instructions for products of bfloat16, which are two to ten times as fast as float32."""
    import torch

    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return device.type == "cpu" and _half_on_cpu()


@cache
def _half_on_cpu() -> bool:
    import torch

    # By what the processor says, not by a measurement: the same machine gives the same poses.
    try:
        return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    except AttributeError:  # not every version of PyTorch asks the processor
        return False
