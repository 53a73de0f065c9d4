"""Files that grow: parts give the file of the whole, and nothing is left of one that fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from writers_samples import complete_prediction, prediction

from uplift.errors import UserError
from uplift.export import MEASURES, WRITERS, open_stream, write
from uplift.models.ground import Ground
from uplift.models.prediction import Prediction
from uplift.skeleton import load_skeleton

GROWING = [name for name, writer in (WRITERS["poses"] | MEASURES).items() if writer.stream]
TEXT = st.text(st.sampled_from("ab é日"), min_size=1, max_size=9)


def film(lengths: Sequence[int], names: Sequence[str]) -> Prediction:
    """Return clips of so many frames of two people (h36m17), with everything that a prediction may have."""
    rows = 2 * sum(lengths)
    random = np.random.default_rng(rows)
    body = prediction(rows, joints=17, rooted=True, uncertainty=True)
    skeleton = load_skeleton("h36m17")
    clip = np.repeat(np.arange(len(lengths)), [2 * length for length in lengths])
    identity = {
        "sequence": np.array([f"{names[one % len(names)]} {one}" for one in clip], np.str_),
        "instance": np.concatenate([np.repeat(["Anna", "Ben"], length) for length in lengths]),
        "frame": np.concatenate([np.tile(np.arange(length), 2) for length in lengths]),
    }
    down = np.tile([0.0, 1.0, 0.0], (rows, 1))
    ground = Ground(down * 900, -down, random.random((rows, 17)) < 0.2)
    many = {"hypotheses": np.stack([body.pose, -body.pose], 1), "weights": np.tile([0.7, 0.3], (rows, 1))}
    body = replace(body, joint_names=skeleton.joints, skeleton=skeleton, identity=identity, ground=ground, **many)
    body.pose[random.random((rows, 17)) < 0.05] = np.nan
    return replace(body, filled=random.random((rows, 17)) < 0.3, gravity=down, fps=25.0)


def clips(whole: Prediction) -> list[Prediction]:
    """Return the parts of a prediction, a clip each; names in a part are no longer than they need to be."""
    found = []
    for name in dict.fromkeys(whole.identity["sequence"].tolist()):
        part = whole.select(whole.identity["sequence"] == name)
        found.append(replace(part, identity={key: np.array(rows.tolist()) for key, rows in part.identity.items()}))
    return found


@pytest.mark.parametrize("name", GROWING)
@pytest.mark.parametrize("axes", [None, "blender"])
def test_parts_give_the_bytes_of_the_whole(name: str, axes: str | None, tmp_path: Path) -> None:
    if name in MEASURES and axes:
        pytest.skip("angles and gait have no axes")
    whole = film([40, 300, 7], ["walk", "a much longer name, é"])
    one, many = tmp_path / f"whole_{name.strip('.')}", tmp_path / f"parts_{name.strip('.')}"
    one, many = (path if "." in path.name else path.with_suffix(name) for path in (one, many))
    expected = write(whole, one, axes=axes)
    with open_stream(many, axes=axes) as stream:
        for part in clips(whole):
            stream.append(part)
            assert not many.exists()
    if name == "angles.csv":  # digits behind those that count depend on which frames are computed at once
        assert_close(many.read_text(), one.read_text())
    else:
        assert many.read_bytes() == one.read_bytes()
    assert stream.of_clips == (name in MEASURES or axes is not None)
    assert stream.remark == expected[one]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([one.name, many.name])


def assert_close(one: str, other: str) -> None:
    """Compare two tables, numbers by their size."""
    for here, there in zip(one.splitlines(), other.splitlines(), strict=True):
        for cell, wanted in zip(here.split(","), there.split(","), strict=True):
            assert cell == wanted or abs(float(cell) - float(wanted)) < 1e-4


@given(lengths=st.lists(st.integers(0, 5), min_size=1, max_size=5), names=st.lists(TEXT, min_size=1))
def test_columns_of_text_and_numbers_grow(
    lengths: list[int], names: list[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Also of text in some parts and numbers in others, as numpy joins them."""
    folder, whole = tmp_path_factory.mktemp("npz"), prediction(sum(lengths))
    parts, start = [], 0
    for number, length in enumerate(lengths):
        part = whole.select(slice(start, start + length))
        label = np.full(length, names[number % len(names)]) if number % 2 else np.arange(length)
        parts.append(replace(part, identity={"action": label}))
        start += length
    write(Prediction.concat(parts), folder / "whole.npz")
    with open_stream(folder / "parts.npz") as stream:
        for part in parts:
            stream.append(part)
    assert (folder / "whole.npz").read_bytes() == (folder / "parts.npz").read_bytes()


@pytest.mark.parametrize("name", GROWING)
def test_nothing_is_left_of_a_file_that_fails(name: str, tmp_path: Path) -> None:
    path = tmp_path / (name if name[0] != "." else f"poses{name}")
    parts = clips(film([9, 9], ["walk"]))

    def interrupted() -> None:
        with open_stream(path) as stream:
            stream.append(parts[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(UserError, match="no poses"), open_stream(path):
        pass
    stream = open_stream(path)
    stream.append(parts[0])
    with pytest.raises(UserError, match="part 2 has 50.0 as 'fps', those before it 25.0"):
        stream.append(replace(parts[1], fps=50.0))
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="closed"):
        stream.append(parts[1])
    with pytest.raises(ValueError, match="given up"):
        stream.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"root": None}, "part 2 has nothing as 'root', those before it \\(3,\\)"),
        ({"identity": {}}, "part 2 has nothing as 'identity.frame'"),
        ({"weights": np.ones((12, 3)), "hypotheses": np.ones((12, 3, 7, 3))}, r"\(3, 7, 3\) as 'hypotheses'.* nothing"),
        ({"unit": "px"}, "part 2 has px as 'unit', those before it mm"),
        ({"image_size": (320, 240)}, "image_size"),
    ],
)
def test_parts_of_another_kind_are_refused(change: dict, message: str, tmp_path: Path) -> None:
    sample = complete_prediction(6)
    with pytest.raises(UserError, match=message), open_stream(tmp_path / "a.npz") as stream:
        stream.append(sample)
        stream.append(replace(sample, **change))
    assert not list(tmp_path.iterdir())


def test_formats_that_cannot_grow_name_those_that_can(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"a \.html is written as a whole.*\.npz, .*\.csv"):
        open_stream(tmp_path / "a.html")
    with pytest.raises(UserError, match="does not exist"):
        open_stream(tmp_path / "no" / "a.csv")
    assert not list(tmp_path.iterdir())
