"""Files read by several processes come in order, and the first that is wrong is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats import read
from uplift.data.reading import read_each
from uplift.errors import UserError


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Return six files of a body of three joints, the last of them damaged."""
    paths = [tmp_path / f"{number}.npz" for number in range(6)]
    for number, path in enumerate(paths):
        points = np.random.default_rng(number).uniform(0, 500, (10 + number, 3, 2))
        np.savez(path, keypoints=points, joint_names=["a", "b", "c"])
    paths[-1].write_bytes(paths[-1].read_bytes()[:300])
    return paths


@pytest.mark.parametrize("workers", [1, 2])
def test_files_come_in_order_until_one_is_wrong(files: list[Path], workers: int):
    found = []
    with pytest.raises(UserError, match=r"5\.npz"):
        for part in read_each(files, None, workers):
            found.append(part)
    assert len(found) == 5
    for part, path in zip(found, files, strict=False):
        np.testing.assert_array_equal(part.keypoints, read(path).keypoints)
        assert part.source == str(path)
