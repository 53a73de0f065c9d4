"""Names that are no text, such as those of files in another encoding, do not stop a writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shape_samples import shapes
from writers_samples import ENDINGS, needed, prediction

from uplift.export import WRITERS, write

ODD = ("clip\udce9", "\ud800", "a\nb\t\x00", "=1+1", "\u202eabc", "日本")
TEXT = (".html", ".csv", ".json", ".bvh", ".trc", ".obj", ".dlc.csv", ".anipose.csv", ".blend.py", ".usda")


@pytest.mark.parametrize("ending", [ending for ending in ENDINGS if ending != ".mp4"])
def test_every_writer_of_poses_takes_any_name(ending: str, tmp_path: Path) -> None:
    needed(ending)
    frames = 3 * len(ODD)
    who = {"sequence": np.repeat(ODD, 3), "frame": np.tile(np.arange(3), len(ODD)), "subject": np.repeat(ODD[::-1], 3)}
    sample = prediction(frames, rooted=True, identity=who, title=ODD[0], source="".join(ODD[:2]), notes=ODD)
    files = write(sample, tmp_path / f"a\udce9{ending}")
    assert files
    for path in files:
        content = path.read_bytes()
        assert content
        if ending in TEXT:
            content.decode("utf-8")


@pytest.mark.parametrize("ending", WRITERS["shapes"])
def test_every_writer_of_shapes_takes_any_name(ending: str, tmp_path: Path) -> None:
    files = write(shapes(2, ["\ud800\n", "b\udce9"]), tmp_path / f"a{ending}")
    for path in files:
        content = path.read_bytes()
        assert content
        if ending in TEXT:
            content.decode("utf-8")
