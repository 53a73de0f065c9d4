"""Masks of several files as one, and at another resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mask_files import blob

from uplift.data.clean_masks import CleanOptions, clean
from uplift.data.concat import concat_masks, resized
from uplift.data.masks import Found, MaskData, Placed
from uplift.errors import UserError
from uplift.geometry.mesh import Mesh


def part(first: int, count: int, side: int = 32, category: str = "") -> MaskData:
    items = [Found(f"{n}", blob(seed=n), category) for n in range(first, first + count)]
    return clean(items, CleanOptions(side=side))[0]


def placed(data: MaskData, meshes: int) -> MaskData:
    items = len(data)
    mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]]))
    where = Placed(
        [mesh] * meshes,
        np.arange(items) % meshes,
        np.tile(np.eye(3, dtype=np.float32), (items, 1, 1)),
        np.ones(items, np.float32),
        np.zeros((items, 2), np.float32),
        np.full(items, np.inf, np.float32),
    )
    return replace(data, truth=where)


def test_joined_and_taken_apart_it_is_what_it_was() -> None:
    one, other = part(0, 3), part(3, 2)
    both = concat_masks([one, other])
    assert both.names == list("01234")
    for rows, same in ((np.arange(3), one), (np.arange(3, 5), other)):
        chosen = both.select(rows)
        assert np.array_equal(chosen.masks, same.masks)
        assert np.array_equal(chosen.centre_px, same.centre_px)
        assert np.array_equal(chosen.scale_px, same.scale_px)
    assert both.category is None
    assert concat_masks([one]) is one
    with pytest.raises(UserError):
        concat_masks([])


def test_what_only_one_knows_is_empty_in_the_other() -> None:
    both = concat_masks([part(0, 2), part(2, 2, category="cow")])
    assert both.category is not None
    assert both.category.tolist() == ["", "", "cow", "cow"]


def test_true_shapes_keep_their_items() -> None:
    one, other = placed(part(0, 3), 2), placed(part(3, 2), 2)
    other = replace(other, labelled=np.array([True, False]))
    both = concat_masks([one, other])
    assert both.truth is not None
    assert len(both.truth.meshes) == 4
    assert both.truth.shape.tolist() == [0, 1, 0, 2, 3]
    assert both.labelled is not None
    assert both.labelled.tolist() == [False, False, False, True, False]
    mixed = concat_masks([one, part(3, 2)])
    assert mixed.truth is None
    assert mixed.labelled is None
    assert any("left out" in note for note in mixed.notes)


def test_another_resolution_is_nearly_what_a_crop_of_it_would_be() -> None:
    fine, coarse = part(0, 4, 128), part(0, 4, 32)
    smaller = resized(fine, 32)
    assert smaller.masks.shape == coarse.masks.shape
    assert np.abs(smaller.masks.astype(int) - coarse.masks).mean() < 6
    assert resized(fine, 128) is fine
    assert concat_masks([coarse, fine]).side == 32
    whole = (fine.masks / 255).mean((1, 2))
    assert np.allclose((smaller.masks / 255).mean((1, 2)), whole, atol=0.003)
