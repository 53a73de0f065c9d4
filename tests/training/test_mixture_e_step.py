"""The expectation over all masks: what it sums up is what each mask by itself says, and so are loss and gradient."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shape_mixtures import chair, masks_of, mixture_of, small
from torch import Tensor
from torch.nn import functional

from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import MaskSet, to_mask_set
from uplift.data.masks import MaskData
from uplift.data.synthetic.masks import ViewChoice, simulate_masks
from uplift.models.mixture import LEAST, MOST, ShapeMixture
from uplift.models.projector import Projector
from uplift.training import mixture as module
from uplift.training.mixture import EStepStatistics

KINDS = [{}, {"symmetric": False}, {"gravity": False}]
ITEMS, T = 20, 0.05


@pytest.fixture(scope="module")
def data() -> MaskData:
    """Return masks of two chairs, told apart by nothing but their truth."""
    views = ViewChoice(elevation_mean_deg=20, elevation_sd_deg=4)
    return simulate_masks([chair(0), chair(4)], ITEMS, seed=1, side=48, views=views)


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep faint shares too, and make several chunks of the masks."""
    monkeypatch.setattr(module, "_FAINT", 0.0)
    monkeypatch.setattr(module, "_CHUNK", 7)


@lru_cache
def projector(**more: bool) -> Projector:
    """Return what draws the mixtures of one kind: it takes a while to make."""
    mixture = ShapeMixture(small(elevation_deg=(15.0, 10.0), **more))
    mixture.silhouettes([0])
    assert mixture.projector is not None
    return mixture.projector


def fresh(seed: int = 0, **more: bool) -> ShapeMixture:
    """Return shapes that are none, used unevenly so far."""
    torch.manual_seed(seed)
    mixture = ShapeMixture(small(elevation_deg=(15.0, 10.0), **more))
    mixture.projector = projector(**more)
    mixture.azimuth_bias += 0.5 * torch.randn_like(mixture.azimuth_bias)
    mixture.part_bias += 0.5 * torch.randn_like(mixture.part_bias)
    return mixture


def told(data: MaskData, labelled: np.ndarray, shape: ShapeSettings) -> MaskSet:
    """Return the masks with the labels of some."""
    return to_mask_set(replace(data, labelled=labelled), shape, shape.coarse)


def explain(mixture: ShapeMixture, masks: MaskSet, temperature: float = T, pooled: int = 1) -> EStepStatistics:
    """Return what the mixture explains."""
    found = EStepStatistics(mixture, bool(masks.labelled.any()), pooled)
    found.update(mixture, masks, temperature)
    return found


def evidence_of(mixture: ShapeMixture, masks: MaskSet, temperature: float, pooled: int = 1) -> Tensor:
    """Return the evidence (items shapes views), mask by mask."""

    def small_of(image: Tensor) -> Tensor:
        side = image.shape[-1] // pooled
        return image.unflatten(-1, (side, pooled)).unflatten(-3, (side, pooled)).mean((-3, -1))

    with torch.no_grad():
        drawn = mixture.crops()
        drawn = drawn._replace(cut=small_of(drawn.cut))
        each = [
            mixture.evidence(small_of(masks.crops[row : row + 1]), masks.spread[row : row + 1], drawn, temperature)
            for row in range(len(masks))
        ]
    return torch.cat(each)


def mirrors_of(mixture: ShapeMixture) -> Tensor:
    """Return for each view of the grid which one sees its mirror image, found by its rotation."""
    views, flip = mixture.grid.views, torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    return torch.cdist((flip @ views @ flip).flatten(1), views.flatten(1)).argmin(1)


def drawn_as(mixture: ShapeMixture, view: int) -> tuple[int, bool]:
    """Return which drawn view stands for a view, and whether masks are mirrored for it."""
    drawn = mixture.grid.drawn.tolist()
    if view in drawn:
        return drawn.index(view), False
    return drawn.index(int(mirrors_of(mixture)[view])), True


def folded(mixture: ShapeMixture, share: Tensor) -> Tensor:
    """Return shares (items shapes views) at the views that are drawn."""
    total = torch.zeros(*share.shape[:2], len(mixture.grid.drawn))
    for view in range(share.shape[2]):
        total[:, :, drawn_as(mixture, view)[0]] += share[:, :, view]
    return total


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("pooled", [1, 2])
@pytest.mark.parametrize("more", KINDS)
def test_sums_are_those_over_each_mask(more: dict[str, bool], pooled: int, data: MaskData) -> None:
    mixture = fresh(**more)
    masks = to_mask_set(data, mixture.settings, mixture.settings.coarse)
    found = explain(mixture, masks, pooled=pooled)
    temperature = T * (module._POOLED if pooled > 1 else 1)
    evidence = evidence_of(mixture, masks, temperature, pooled)
    share = evidence.flatten(1).softmax(1).view_as(evidence)
    weight = folded(mixture, share).mean(0)
    assert float(found.weight.sum()) == pytest.approx(1, abs=1e-5)
    assert torch.allclose(found.weight, weight, atol=1e-5)
    assert float(found.energy) == pytest.approx(-temperature * float(evidence.flatten(1).logsumexp(1).mean()), abs=1e-5)
    total = torch.zeros_like(found.mask)
    for view in range(share.shape[2]):
        row, mirrored = drawn_as(mixture, view)
        seen = masks.crops.flip(-1) if mirrored else masks.crops
        total[:, row] += torch.einsum("is,iyx->syx", share[:, :, view], seen) / ITEMS
    assert torch.allclose(found.mask * weight[..., None, None], total, atol=1e-5)
    ratio = (masks.spread[:, 0] / masks.spread[:, 1]).log()
    assert torch.allclose(
        found.ratio * weight, torch.einsum("isd,i->sd", folded(mixture, share), ratio) / ITEMS, atol=1e-5
    )
    assert not found.labelled.any()
    assert 3 / weight.numel() < float(weight.max()) < 0.9, "some shapes and views explain more than others"


@pytest.mark.parametrize("more", KINDS)
def test_faint_shares_are_left_out_and_little_is_lost(more: dict[str, bool], data: MaskData) -> None:
    mixture = fresh(**more)
    masks = to_mask_set(data, mixture.settings, mixture.settings.coarse)
    found = explain(mixture, masks)
    assert float(found.weight.sum()) == pytest.approx(1, abs=1e-5)
    evidence = evidence_of(mixture, masks, T)
    share = evidence.flatten(1).softmax(1).view_as(evidence)
    assert float((found.weight - folded(mixture, share).mean(0)).abs().sum()) < 0.05
    assert int((found.weight == 0).sum()) > 0
    assert float(found.mask[found.weight == 0].abs().sum()) == 0


def test_pooled_pixels_give_nearly_the_shares_of_all(data: MaskData) -> None:
    mixture = mixture_of((0, 4), small(coarse=20, crop=24))
    masks = to_mask_set(data, mixture.settings, mixture.settings.coarse)
    whole, pooled = (explain(mixture, masks, 0.02, by) for by in (1, 2))
    assert pooled.mask.shape == whole.mask.shape
    assert 0.5 * float((whole.weight - pooled.weight).abs().sum()) < 0.15  # the share of masks that moved
    assert not torch.allclose(whole.weight, pooled.weight, atol=1e-4)


@given(st.permutations(range(ITEMS)), st.integers(0, 1000))
@settings(max_examples=4)
def test_the_order_of_masks_changes_nothing(data: MaskData, order: list[int], seed: int) -> None:
    mixture = fresh(seed)
    labelled = np.arange(ITEMS) < 7
    one, other = (
        explain(mixture, told(data.select(np.array(rows)), labelled[rows], mixture.settings))
        for rows in (range(ITEMS), order)
    )
    for name, part in one.named_buffers():
        assert torch.allclose(part, other.get_buffer(name), atol=1e-5), name


def test_nothing_is_left_of_what_was_summed_up_before(data: MaskData) -> None:
    mixture = fresh()
    masks = told(data, np.arange(ITEMS) < 7, mixture.settings)
    found = explain(mixture, masks)
    first = {name: part.clone() for name, part in found.named_buffers()}
    found.update(mixture, to_mask_set(data.select(np.arange(3)), mixture.settings, mixture.settings.coarse), T)
    assert not torch.allclose(found.weight, first["weight"], atol=1e-3)
    found.update(mixture, masks, T)
    assert all(torch.equal(part, first[name]) for name, part in found.named_buffers())


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("more", KINDS)
def test_the_loss_is_the_expected_error_of_each_mask(more: dict[str, bool], data: MaskData) -> None:
    mixture = fresh(**more)
    masks = to_mask_set(data, mixture.settings, mixture.settings.coarse)
    found = explain(mixture, masks)
    rows = list(range(len(mixture.grid.drawn)))
    loss = found.loss(mixture, mixture.cut_out(rows), rows, T)
    evidence = evidence_of(mixture, masks, T)
    share = evidence.flatten(1).softmax(1).view_as(evidence)
    cut, _, spread = mixture.crops()
    pixels, expected = cut.clamp(LEAST, MOST), loss.new_zeros(())
    wide = (spread[..., 0] / spread[..., 1]).log()
    for mask, size, likely in zip(masks.crops, masks.spread, share, strict=True):
        error = functional.binary_cross_entropy(pixels, mask.expand_as(pixels), reduction="none").mean((-2, -1))
        unlike = 0.5 * (((size[0] / size[1]).log() - wide) / mixture.settings.proportions) ** 2
        expected = expected + (likely * (error + T * unlike)).sum() / ITEMS
    # How much the proportions of the masks of a silhouette differ is the shapes' fault in no way.
    ratio, likely = (masks.spread[:, 0] / masks.spread[:, 1]).log(), folded(mixture, share)
    differing = (likely * (ratio[:, None, None] - found.ratio) ** 2).sum() / ITEMS
    differing = 0.5 * T / mixture.settings.proportions**2 * differing
    assert float(loss.detach()) == pytest.approx(float((expected - differing).detach()), abs=1e-4)
    slopes = [torch.autograd.grad(value, mixture.logits)[0] for value in (loss, expected)]
    assert torch.allclose(*slopes, atol=1e-3 * float(slopes[1].abs().max()))
    assert float(slopes[1].abs().max()) > 1e-5


def test_some_views_give_the_loss_of_all_on_average(data: MaskData) -> None:
    mixture = fresh()
    found = explain(mixture, to_mask_set(data, mixture.settings, mixture.settings.coarse))
    with torch.no_grad():
        every = torch.randperm(len(mixture.grid.drawn))
        losses = [
            float(found.loss(mixture, mixture.cut_out(rows), rows, T))
            for rows in (every.tolist(), *every.view(-1, 6).tolist())
        ]
    assert np.mean(losses[1:]) == pytest.approx(losses[0], rel=1e-4)
    assert np.std(losses[1:]) > 0.01


def nearest_views(data: MaskData, mixture: ShapeMixture) -> list[int]:
    """Return the view of the grid that differs least, by angle, from each mask's true one."""
    assert data.truth is not None
    between = torch.from_numpy(data.truth.view).float()[:, None] @ mixture.grid.views.mT[None]
    cosine = (between.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    assert math.degrees(float(cosine.amax(1).clamp(-1, 1).arccos().max())) < 35
    return cosine.argmax(1).tolist()


@pytest.mark.parametrize("more", KINDS)
def test_labelled_masks_are_explained_from_their_true_view_alone(more: dict[str, bool], data: MaskData) -> None:
    mixture = fresh(**more)
    count = torch.zeros(len(mixture.grid.drawn))
    for view in nearest_views(data, mixture):
        count[drawn_as(mixture, view)[0]] += 1 / ITEMS
    found = explain(mixture, told(data, np.ones(ITEMS, bool), mixture.settings))
    assert torch.allclose(found.weight.sum(0), count, atol=1e-5)
    assert torch.allclose(found.labelled, found.weight.sum(1), atol=1e-5)
    free = explain(mixture, to_mask_set(data, mixture.settings, mixture.settings.coarse))
    assert float((free.weight.sum(0) - count).abs().sum()) > 0.5, "without labels the views are others"


def test_labels_of_some_say_nothing_of_the_others(data: MaskData) -> None:
    mixture = fresh()
    labelled = np.arange(ITEMS) % 4 == 0
    found = explain(mixture, told(data, labelled, mixture.settings))
    assert float(found.labelled.sum()) == pytest.approx(0.25, abs=1e-5)
    some, rest = (
        explain(mixture, told(data.select(np.flatnonzero(rows)), labelled[rows], mixture.settings))
        for rows in (labelled, ~labelled)
    )
    assert torch.allclose(found.weight, 0.25 * some.weight + 0.75 * rest.weight, atol=1e-5)
    assert torch.allclose(found.truth, some.truth, atol=1e-5)
    assert rest.truth.numel() == len(mixture.logits), "nothing is kept for shapes that nobody tells"


@given(st.integers(0, 1000), st.floats(0.05, 2))
@settings(max_examples=10)
def test_the_truth_is_where_shapes_are_least_unlike_it(data: MaskData, seed: int, far: float) -> None:
    torch.manual_seed(seed)
    mixture = mixture_of((0, 4), small())
    rows = np.arange(ITEMS) % 4 != 3
    masks = told(data, rows, mixture.settings)
    found = explain(mixture, masks)
    evidence = evidence_of(mixture, masks, T)
    share = torch.stack([e[:, view].softmax(0) for e, view in zip(evidence, nearest_views(data, mixture), strict=True)])
    share, true = share[rows], masks.shapes[masks.shape][rows]
    mean = torch.einsum("is,izyx->szyx", share, true) / share.sum(0)[:, None, None, None]
    assert torch.allclose(found.truth, mean, atol=5e-3)
    best = torch.logit(mean, 1e-4).requires_grad_()
    least = found.label_loss(best)
    other = best.detach() + far * torch.randn_like(best)
    each = functional.binary_cross_entropy_with_logits(
        other.expand(len(true), *other.shape), true[:, None].expand(-1, 2, -1, -1, -1), reduction="none"
    )
    expected = float((each.mean((2, 3, 4)) * share).sum() / ITEMS)
    assert float(found.label_loss(other)) == pytest.approx(expected, rel=5e-3)
    assert float(least.detach()) < float(found.label_loss(other))
    assert float(torch.autograd.grad(least, best)[0].abs().max()) < 2e-5
    assert float(least.detach()) < float(found.label_loss(best.detach().flip(0))), "each shape has its own truth"


def test_no_mask_is_lost_where_nothing_is_known() -> None:
    torch.manual_seed(0)
    data = masks_of(chair(), 12)
    settings = small(parts=64, proportions=1.0)
    mixture = ShapeMixture(settings)
    explained = EStepStatistics(mixture, labels=False)
    explained.update(mixture, to_mask_set(data.without_truth(), settings, settings.coarse), 0.3)
    assert float(explained.weight.sum()) == pytest.approx(1, abs=1e-4)
