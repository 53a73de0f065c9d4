"""Parts of the body lifted by separate networks."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift import UserError
from uplift.models.networks import ResidualNetwork

__all__ = ["Halves"]


class Halves(nn.Module):
    """One residual network for each of ``parts``; joints in several parts, and the tilt, get the mean over the parts.

    After Hardy & Kim 2024, LInKs, 3.1. ``joints`` are the skeleton's, in its order, since a network is given only
    the number of its inputs; ``parts`` are lists of their names.
    """

    shares: Tensor

    def __init__(self, inputs: int, outputs: int, *, joints: list, parts: list, units: int = 256, blocks: int = 2):
        super().__init__()
        count = len(joints)
        unknown = sorted({name for part in parts for name in part} - set(joints))
        left_out = sorted(set(joints) - {name for part in parts for name in part})
        if unknown or left_out:
            raise UserError(f"Halves: parts contain {unknown}, which are not joints, and leave out {left_out}.")
        if inputs % count or not 2 <= inputs // count <= 3 or outputs // count > 2 or outputs % count > 1:
            raise UserError(
                f"Halves: {inputs} inputs and {outputs} outputs do not fit {count} joints: check `joints`, and set "
                "lifter.fill=false."
            )
        self.count, self.confident = count, inputs // count == 3
        self.channels, self.extra = divmod(outputs, count)
        self.rows = [[joints.index(name) for name in part] for part in parts]
        self.networks = nn.ModuleList(
            ResidualNetwork(
                len(part) * (inputs // count), len(part) * self.channels + self.extra, units=units, blocks=blocks
            )
            for part in parts
        )
        shares = torch.zeros(count)
        for rows in self.rows:
            shares[rows] += 1
        self.register_buffer("shares", shares)

    def forward(self, features: Float[Tensor, "batch inputs"]) -> Float[Tensor, "batch outputs"]:
        """Return each joint's values from the networks of its parts, then the values of the body, averaged over parts."""
        keypoints = features[:, : 2 * self.count].unflatten(1, (self.count, 2))
        confidence = features[:, 2 * self.count :]
        total = features.new_zeros(len(features), self.channels, self.count)
        body = features.new_zeros(len(features), self.extra)
        for rows, network in zip(self.rows, self.networks, strict=True):
            seen = keypoints[:, rows].flatten(1)
            if self.confident:
                seen = torch.cat([seen, confidence[:, rows]], 1)
            found = network(seen)
            joints = found[:, : len(rows) * self.channels].unflatten(1, (self.channels, len(rows)))
            total = total.index_add(2, torch.tensor(rows, device=found.device), joints)
            body = body + found[:, len(rows) * self.channels :] / len(self.rows)
        return torch.cat([(total / self.shares).flatten(1), body], 1)
