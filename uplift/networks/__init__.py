"""Network families, one per file; `build_network` picks one by name."""

from __future__ import annotations

from torch import nn

from uplift.plugins import build

__all__ = ["build_network"]

NETWORKS = {
    "kudo": "uplift.networks.kudo:KudoNetwork",
    "residual": "uplift.networks.residual:ResidualNetwork",
}


def build_network(use: str, inputs: int, outputs: int, options: dict) -> nn.Module:
    """Return the network ``use`` (a name, or ``file.py:Class``) from ``inputs`` to ``outputs`` numbers."""
    network = build(use, NETWORKS, options, "lifter", inputs=inputs, outputs=outputs)
    assert isinstance(network, nn.Module)
    return network
