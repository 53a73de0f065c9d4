"""Finer mixtures: copies begin nearly alike, together they explain what their shape did, and nothing else is lost."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shape_mixtures import chair, masks_of, mixture_of, small

from uplift.data.mask_tensors import MaskSet, to_mask_set
from uplift.models import mixture as module
from uplift.models.mixture import ShapeMixture, split
from uplift.training.mixture import EStepStatistics

T = 0.03
KINDS = [{}, {"symmetric": False}, {"gravity": False}]


def used(more: dict[str, bool], azimuths: int = 24) -> ShapeMixture:
    """Return a mixture that has been trained, as far as its buffers tell."""
    torch.manual_seed(1)
    mixture = ShapeMixture(small(elevation_deg=(15.0, 10.0), **more), 3, azimuths)
    mixture.azimuth_bias += torch.randn_like(mixture.azimuth_bias)
    mixture.part_bias += torch.randn_like(mixture.part_bias)
    mixture.level.fill_(0.37)
    return mixture


def explained(mixture: ShapeMixture, masks: MaskSet) -> EStepStatistics:
    """Return what the mixture explains."""
    found = EStepStatistics(mixture, labels=False)
    found.update(mixture, masks, T)
    return found


@given(st.integers(2, 5), st.sampled_from(KINDS))
@settings(max_examples=6)
def test_copies_differ_and_are_nearest_to_their_own_shape(times: int, more: dict[str, bool]) -> None:
    mixture = used(more)
    before = {name: part.clone() for name, part in mixture.state_dict().items()}
    made = split(mixture, times, 24)
    assert made.logits.shape == (3 * times, *mixture.logits.shape[1:])
    far = torch.cdist(made.logits.detach().flatten(1), mixture.logits.detach().flatten(1))
    assert far.argmin(1).tolist() == [part for part in range(3) for _ in range(times)]
    between = torch.cdist(*[made.logits.detach().flatten(1)] * 2) / math.sqrt(mixture.logits[0].numel())
    assert float(between.fill_diagonal_(math.inf).min()) > 0.3, "no two shapes are the same"
    assert all(torch.equal(part, before[name]) for name, part in mixture.state_dict().items())


def test_a_split_is_repeated_with_its_seed() -> None:
    mixture, found = used({}), []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        found.append(split(mixture, 2, 24).logits)
    assert torch.equal(found[0], found[1])
    assert not torch.allclose(found[0], found[2], atol=0.5)


@pytest.mark.parametrize("times", [1, 3])
@pytest.mark.parametrize("more", KINDS)
def test_a_view_keeps_its_bias_and_a_surface_its_level(more: dict[str, bool], times: int) -> None:
    mixture = used(more)
    made = split(mixture, times, 48)
    assert made.grid.azimuths == (192 if "gravity" in more else 48)
    assert len(made.grid.views) == (192 if "gravity" in more else 144)
    assert float(made.level) == pytest.approx(0.37)
    assert made.part_bias.tolist() == [float(bias) for bias in mixture.part_bias for _ in range(times)]
    # The view of the coarse grid that is the nearest; of another bias is none that is as near.
    nearest = torch.cdist(made.grid.views.flatten(1), mixture.grid.views.flatten(1)).argmin(1)
    coarse = mixture.azimuth_bias[:, mixture.grid.azimuth[nearest]].repeat_interleave(times, 0)
    assert torch.equal(made.azimuth_bias[:, made.grid.azimuth], coarse)
    if times == 1:
        assert torch.equal(made.logits, mixture.logits), "finer views alone change no shape"


def test_matrices_of_the_same_views_are_not_made_again() -> None:
    mixture = used({}, 48)
    mixture.silhouettes([0])
    same = split(mixture, 2, 48)
    assert same.grid.azimuths == 48
    assert same.projector is mixture.projector
    coarse = used({})
    coarse.silhouettes([0])
    finer = split(coarse, 2, 48)
    with torch.no_grad():
        assert finer.cut_out().cut.shape[:2] == (6, 72)
    assert coarse.projector is not None
    assert len(coarse.projector) == 36


@pytest.fixture(scope="module")
def known() -> ShapeMixture:
    """Return a mixture that knows two chairs."""
    return mixture_of((0, 4), small(coarse=16, crop=20))


@pytest.fixture(scope="module")
def masks(known: ShapeMixture) -> MaskSet:
    """Return masks of one of the two."""
    return to_mask_set(masks_of(chair(), 40), known.settings, known.settings.coarse)


@pytest.mark.parametrize("times", [2, 3])
def test_copies_without_noise_share_what_their_shape_explained(
    known: ShapeMixture, masks: MaskSet, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_NOISE", 0.0)
    monkeypatch.setattr("uplift.training.mixture._FAINT", 0.0)
    one, several = explained(known, masks), explained(split(known, times, 24), masks)
    each = several.weight.unflatten(0, (2, times))
    assert torch.allclose(each.sum(1), one.weight, atol=1e-5)
    assert torch.allclose(each, each[:, :1].expand_as(each), atol=1e-6)
    seen = one.weight > 1e-4
    for copy in several.mask.unflatten(0, (2, times)).unbind(1):
        assert torch.allclose(copy[seen], one.mask[seen], atol=1e-4)
    assert float(several.energy) == pytest.approx(float(one.energy) - T * math.log(times), abs=1e-4)


def test_copies_explain_other_masks_and_together_those_of_their_shape(known: ShapeMixture, masks: MaskSet) -> None:
    torch.manual_seed(0)
    one, several = explained(known, masks), explained(split(known, 3, 24), masks)
    assert float(several.weight.sum()) == pytest.approx(1, abs=1e-5)
    share = several.weight.sum(1).view(2, 3)
    assert share.sum(1).tolist() == pytest.approx(one.weight.sum(1).tolist(), abs=0.15)
    assert float(share[0].min()) > 0.02, "no copy is dead"
    assert float(share[0].max() / share[0].min()) > 1.05
