"""uplift's own file of masks among the formats: options hold for it as far as they can."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mask_files import blob, save

from uplift.data.clean_masks import clean
from uplift.data.formats import read_masks
from uplift.data.formats.masks_npz import write_masks_npz
from uplift.data.masks import Found, MaskData
from uplift.errors import UserError


def masks(first: int, count: int) -> MaskData:
    """Return masks of cows and horses in turns."""
    return clean([Found(f"{n}", blob(seed=n), "cow" if n % 2 else "horse") for n in range(first, first + count)])[0]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Return a folder with a.npz and b.npz."""
    write_masks_npz(masks(0, 5), tmp_path / "a.npz")
    write_masks_npz(masks(5, 4), tmp_path / "b.npz")
    return tmp_path


def test_masks_are_as_they_were(files: Path) -> None:
    data = read_masks(files / "a.npz")
    assert np.array_equal(data.masks, masks(0, 5).masks)
    assert data.names == list("01234")
    assert data.notes == ()
    assert data.source == str(files / "a.npz")
    assert read_masks(f"{files}/*.npz").names == list("012345678")


def test_options(files: Path) -> None:
    assert read_masks(f"{files}/a.npz", category="cow").names == ["1", "3"]
    with pytest.raises(UserError, match="category=dog"):
        read_masks(f"{files}/a.npz", category="dog")
    some = read_masks(f"{files}/*.npz", most=4)
    assert len(some) == 4
    assert some.names == sorted(some.names)
    assert "4 of 9 masks are taken (most=4)" in some.notes
    small = read_masks(f"{files}/a.npz", side=32)
    assert small.masks.shape == (5, 32, 32)
    assert "crops of 64 px are resampled to 32 px" in small.notes
    save(files / "photos" / "3.png", np.zeros((9, 9), np.uint8))
    photos = read_masks(f"{files}/a.npz", images=str(files / "photos"))
    assert photos.images is not None and photos.images.tolist() == ["", "", "", str(files / "photos" / "3.png"), ""]
    assert any("4 masks have no photo" in note for note in photos.notes)
