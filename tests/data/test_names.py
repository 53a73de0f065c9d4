"""`Names` behaves as the array of text that it stands for, and takes a byte or a few for each row."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.formats.npz import read_npz
from uplift.data.names import Names, codes_of
from uplift.data.poses import PoseData

TEXTS = st.lists(st.sampled_from(["", "S1", "S10", "walking", "ä b"]), min_size=1, max_size=30)


@given(TEXTS, st.data())
def test_it_does_what_an_array_does(texts: list[str], data: st.DataObject):
    array, names = np.array(texts), Names.of(np.array(texts))
    rows = np.array(data.draw(st.lists(st.integers(0, len(texts) - 1))), int)
    assert (len(names), names.shape, names.ndim, names.dtype.kind) == (len(texts), array.shape, 1, "U")
    assert list(names) == names.tolist() == texts
    assert names[rows].tolist() == array[rows].tolist()
    assert names[array == "S1"].tolist() == array[array == "S1"].tolist()
    assert names[1:].tolist() == array[1:].tolist()
    assert str(names[-1]) == texts[-1]
    for other in ("S1", "none", array[::-1], Names.of(array[::-1])):
        wanted = array == (other if isinstance(other, str) else np.asarray(other))
        np.testing.assert_array_equal(names == other, wanted)
        np.testing.assert_array_equal(names != other, ~wanted)
    for function in (np.unique, np.asarray, np.array, lambda v: np.char.add(v, "x"), lambda v: np.concatenate([v, v]),
                     lambda v: np.isin(v, ["S1"]), lambda v: np.where(v == "S1", v, "no")):  # fmt: skip
        np.testing.assert_array_equal(function(names), function(array))
    for one, other in zip(codes_of(names), np.unique(array, return_inverse=True), strict=True):
        np.testing.assert_array_equal(one, other)
    names[rows], wide = "a longer one", array.astype(object)
    wide[rows] = "a longer one"
    assert names.tolist() == wide.tolist()
    assert pickle.loads(pickle.dumps(names)).tolist() == names.tolist()
    assert names.astype(str).tolist() == names.astype(object).tolist() == wide.tolist()


@given(st.lists(TEXTS, min_size=1, max_size=4))
def test_parts_join_with_names_of_their_own(parts: list[list[str]]):
    joined = Names.concat([Names.of(np.array(part)) for part in parts])
    assert joined.tolist() == [text for part in parts for text in part]
    assert len(set(joined.names.tolist())) == len(joined.names)


def test_frames_hold_their_text_as_names():
    text = np.repeat(["one", "two"], 2)
    data = PoseData(np.zeros((4, 1, 2)), np.ones((4, 1)), ("a",), identity={"sequence": text, "frame": np.arange(4)})
    assert isinstance(data.identity["sequence"], Names)
    assert isinstance(data.select([0, 3]).identity["sequence"], Names)
    both = PoseData.concat([data, data.select([1])])
    assert both.identity["sequence"].tolist() == [*text, "one"]
    assert both.clips().tolist() == [0, 0, 1, 1, 0]


def test_real_identities_take_a_few_bytes(benchmark_data):
    path: Path = benchmark_data("cmu/train.npz")
    data = read_npz(path)
    text = [values for values in data.identity.values() if isinstance(values, Names)]
    assert text
    with np.load(path) as file:
        before = sum(file[key].nbytes for key, values in data.identity.items() if isinstance(values, Names))
    after = sum(values.nbytes for values in text)
    print(f"{before / len(data):.0f} bytes a frame before, {after / len(data):.1f} after")
    assert after < before / 10


@pytest.mark.parametrize("rows", [0, 1])
def test_few_rows(rows: int):
    names = Names.of(np.array(["a"] * rows, dtype="U3"))
    assert names.tolist() == ["a"] * rows
    assert len(np.unique(names)) == rows
