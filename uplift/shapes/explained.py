"""`Explained`: which masks each shape explains from each view, summed up: all that the shapes are then trained on."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.shapes.mask_set import MaskSet
from uplift.shapes.mixture import LEAST, MOST, Drawn, ShapeMixture

__all__ = ["Explained"]

_CHUNK = 500
_POOLED = 0.9
"""How much smaller the errors of pooled crops are: with it, they give nearly the shares that whole crops do."""
_FAINT = 0.01
"""Shares of a mask below this, of its largest, are left out of the sums."""


class Explained(nn.Module):
    """The expectation step of a mixture, as buffers, so that a fit resumes where it was.

    The likelihood of masks under a shape and view is linear in the mask: the mean of the masks that a
    silhouette explains, and how many they are, are all that its gradient needs. So the expectation over
    all masks is made once in many steps, and a step costs the drawing of a few views.
    """

    weight: Tensor
    """(shapes drawn): share of all masks; sums to 1."""
    mask: Tensor
    """(shapes drawn side side): their mean, those of mirrored views mirrored."""
    ratio: Tensor
    """(shapes drawn): the mean logarithm of their width over height."""
    energy: Tensor
    told: Tensor
    """(shapes,): share of all masks that are labelled and explained by each shape."""
    truth: Tensor
    """(shapes depth height width): the mean of their true shapes."""

    def __init__(self, mixture: ShapeMixture, labels: bool, pooled: int = 1):
        """``labels``: true shapes are summed up too; ``pooled``: pixels, along an axis, that are compared as one."""
        super().__init__()
        self.pooled = pooled
        parts, drawn = len(mixture.logits), len(mixture.grid.drawn)
        side, n = mixture.settings.crop, mixture.settings.detail if labels else 1
        self.labels = labels
        sizes = {
            "weight": (parts, drawn), "mask": (parts, drawn, side, side), "ratio": (parts, drawn), "energy": (),
            "told": (parts,), "truth": (parts, n, n, n),
        }  # fmt: skip
        for name, size in sizes.items():
            self.register_buffer(name, torch.zeros(size))

    @torch.no_grad()
    def update(self, mixture: ShapeMixture, data: MaskSet, temperature: float) -> None:
        """Make all sums anew, over all masks, with the shapes as they are."""
        drawn = mixture.crops()
        if self.pooled > 1:
            drawn = drawn._replace(cut=nn.functional.avg_pool2d(drawn.cut, self.pooled))
            temperature *= _POOLED
        for part in self.buffers():
            part.zero_()
        for start in range(0, len(data), _CHUNK):
            rows = torch.arange(start, min(start + _CHUNK, len(data)), device=data.crops.device)
            self._add(mixture, data, drawn, rows, temperature)
        self.mask /= self.weight.clamp_min(1e-9)[..., None, None]
        self.ratio /= self.weight.clamp_min(1e-9)
        self.truth /= self.told.clamp_min(1e-9)[:, None, None, None]
        for part in (self.weight, self.told, self.energy):
            part /= len(data)

    def _add(self, mixture: ShapeMixture, data: MaskSet, drawn: Drawn, rows: Tensor, temperature: float) -> None:
        masks, spread, known = data.crops[rows], data.spread[rows], data.labelled[rows]
        small = nn.functional.avg_pool2d(masks, self.pooled) if self.pooled > 1 else masks
        evidence = mixture.evidence(small, spread, drawn, temperature)
        if bool(known.any()):
            nearest = (data.view[rows].flatten(1) @ mixture.grid.views.to(masks).flatten(1).T).argmax(1)
            elsewhere = torch.arange(evidence.shape[2], device=masks.device)[None] != nearest[:, None]
            evidence = evidence.masked_fill((known[:, None] & elsewhere)[:, None], -1e4)
        self.energy -= temperature * torch.logsumexp(evidence.flatten(1), 1).sum()
        share = evidence.flatten(1).softmax(1)
        share = share.where(share > _FAINT * share.amax(1, keepdim=True), 0).view_as(evidence)
        share = share / share.sum((1, 2), keepdim=True).clamp_min(1e-9)
        grid, ratio = mixture.grid, (spread[:, 0] / spread[:, 1]).log()
        for views, seen in ((grid.drawn, masks), (grid.mirrored, masks.flip(-1))):
            if views is None:
                continue
            flat = share[:, :, views.to(share.device)].flatten(1).T
            self.weight += flat.sum(1).view_as(self.weight)
            self.mask += (flat.to_sparse_csr() @ seen.flatten(1)).view_as(self.mask)
            self.ratio += (flat @ ratio).view_as(self.ratio)
        if self.labels and bool(known.any()):
            told = share[known].sum(2)
            self.told += told.sum(0)
            self.truth += (told.T @ data.shapes[data.shape[rows][known]].flatten(1)).view_as(self.truth)

    def loss(self, mixture: ShapeMixture, drawn: Drawn, rows: Sequence[int], temperature: float) -> Float[Tensor, ""]:
        """Return the error of the silhouettes ``drawn`` from ``rows`` of the drawn views; an estimate of that of all."""
        pixels, target = drawn.cut.clamp(LEAST, MOST), self.mask[:, rows]
        error = -(target * pixels.log() + (1 - target) * (1 - pixels).log()).mean((-2, -1))
        wide = (drawn.spread[..., 0] / drawn.spread[..., 1]).log()
        unlike = 0.5 * ((self.ratio[:, rows] - wide) / mixture.settings.proportions) ** 2
        each = (error + temperature * unlike) * self.weight[:, rows]
        return each.sum() * self.weight.shape[1] / len(rows)

    def unlike_truth(self, logits: Float[Tensor, "shapes depth height width"]) -> Float[Tensor, ""]:
        """Return the cross-entropy of the true shapes of labelled masks under the shapes that explain them."""
        each = -(self.truth * nn.functional.logsigmoid(logits) + (1 - self.truth) * nn.functional.logsigmoid(-logits))
        return (each.mean((1, 2, 3)) * self.told).sum()
