"""Drawing labelled and unlabelled frames: how many of each, and which."""

from __future__ import annotations

import pytest
import torch

from uplift.data.sampler import LabelledSampler


def marked(labelled: int, frames: int = 1000) -> torch.Tensor:
    return torch.arange(frames) < labelled


@pytest.mark.parametrize(
    ("labelled", "share", "of_a_batch"),
    [
        (500, 0.25, 0.25),
        (100, 0.5, 0.5),
        (10, 0.5, 0.25),
        (1, 0.5, 0.025),
        (500, None, 0.5),
        (0, 0.5, 0),
        (1000, 0.5, 1),
    ],
)
def test_the_share_is_what_is_asked_for_but_no_frame_comes_25_times_as_often_as_by_chance(
    labelled: int, share: float | None, of_a_batch: float
) -> None:
    sampler = LabelledSampler(marked(labelled), share)
    assert sampler.share == pytest.approx(of_a_batch)
    assert sampler.balanced == (share is not None and 0 < labelled < 1000)
    torch.manual_seed(0)
    drawn = sampler(200)
    assert drawn.shape == (200,)
    count = int((drawn < labelled).sum())
    assert count == round(200 * of_a_batch) if sampler.balanced else abs(count / 200 - of_a_batch) < 0.1
    assert len(drawn.unique()) > 20 and bool((drawn.diff() > 0).any() and (drawn.diff() < 0).any())


def test_one_labelled_frame_is_in_every_batch_and_no_frames_draw_nothing() -> None:
    assert (LabelledSampler(marked(1), 0.5)(3) < 1).sum() == 1
    assert LabelledSampler(marked(0, 0), 0.5).share == 0
