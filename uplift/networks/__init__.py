"""Network families, one per file; `build_network` picks one by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import nn

from uplift.errors import UserError, did_you_mean
from uplift.plugins import build

__all__ = ["build_network"]

NETWORKS = {
    "kudo": "uplift.networks.kudo:KudoNetwork",
    "residual": "uplift.networks.residual:ResidualNetwork",
}


def build_network(
    use: str, inputs: int, outputs: int, options: Mapping[str, Any], where: str = "lifter.options"
) -> nn.Module:
    """Return the network ``use`` (a name, or ``file.py:Class``) from ``inputs`` to ``outputs`` numbers.

    Raises:
        UserError: no such network or option (a setting below ``where``), sizes that no network can have.
    """
    if use not in NETWORKS and ":" not in use:
        setting = f"{where.removesuffix('.options')}.network={use!r}"
        raise UserError(f"{setting}: no such network.{did_you_mean(use, NETWORKS)} Your own is named file.py:Class.")
    for name in ("units", "blocks"):
        size = options.get(name, 1)
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= 1 << 20:
            raise UserError(f"{where}.{name}={size!r}: expected a whole number of at least 1.")
    return build(use, NETWORKS, options, where, nn.Module, inputs=inputs, outputs=outputs)
