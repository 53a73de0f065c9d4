"""Pickles of arrays come back whole; pickles of anything else do nothing."""

from __future__ import annotations

import collections
import io
import os
import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uplift.data.parsers.pickles import load_object_npz, load_pickle
from uplift.errors import UserError

NUMBERS = st.sampled_from(["?", "i1", "u2", "<i4", ">i4", "<f4", ">f8", "f2", "c8", "U3", "S2"]).map(np.dtype)
ARRAYS = NUMBERS.flatmap(lambda kind: hnp.arrays(kind, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0)))
PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary() | ARRAYS
NESTED = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=4)
        | st.tuples(inner, inner)
    ),
    max_leaves=12,
)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("pickles")


def same(ours, theirs) -> bool:
    if isinstance(theirs, np.ndarray):
        native = theirs.dtype.newbyteorder("=")  # NumPy itself turns bytes round when it reads
        equal = ours.dtype.newbyteorder("=") == native and ours.shape == theirs.shape
        ours, theirs = ours.astype(native), theirs.astype(native)
        return equal and (
            ours.tobytes() == theirs.tobytes() if theirs.dtype != object else all(map(same, ours, theirs))
        )
    if type(ours) is not type(theirs):
        return False
    if isinstance(theirs, dict):
        return list(ours) == list(theirs) and all(same(ours[key], theirs[key]) for key in theirs)
    if isinstance(theirs, (list, tuple)):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    return ours == theirs


@given(NESTED, st.integers(0, 5))
def test_a_pickle_of_plain_data_comes_back(place, value, protocol):
    (place / "a.pkl").write_bytes(pickle.dumps(value, protocol))
    assert same(load_pickle(place / "a.pkl"), value)


@given(NESTED, st.booleans())
def test_an_object_array_of_plain_data_comes_back(place, value, compressed):
    cell = np.empty((), object)
    cell[()] = value
    (np.savez_compressed if compressed else np.savez)(place / "a.npz", cell=cell, plain=np.arange(6.0).reshape(2, 3))
    read = load_object_npz(place / "a.npz")
    assert same(read["cell"], value) and same(read["plain"], np.arange(6.0).reshape(2, 3))
    assert list(load_object_npz(place / "a.npz", ["plain"])) == ["plain"]


@pytest.mark.parametrize("protocol", range(6))
def test_what_real_files_hold(place, protocol):
    positions = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    value = {
        "S1": collections.OrderedDict([("Directions 1", [positions, positions[::-1], positions.transpose(2, 0, 1)])]),
        "scalar": np.float64(2.5),
        "swapped": positions.astype(">f4"),
        "ragged": np.array([positions, None], object),
        "shared": [positions, positions],
        "set": {1, 2},
        "default": collections.defaultdict(list, a=[1]),
    }
    (place / "a.pkl").write_bytes(pickle.dumps(value, protocol))
    read = load_pickle(place / "a.pkl")
    assert same(read["S1"], value["S1"]) and same(read["swapped"], value["swapped"])
    assert read["scalar"] == 2.5 and isinstance(read["scalar"], np.float64)
    assert same(read["ragged"][0], positions) and read["ragged"][1] is None
    assert read["shared"][0] is read["shared"][1]
    assert read["set"] == {1, 2} and read["default"] == {"a": [1]}


def test_a_pickle_of_python_2(place):
    # {'S1': array([1., 2.], dtype=float32)} as Python 2 with an old NumPy writes it, protocol 2: str is bytes there.
    raw = np.array([1, 2.0], "<f4").tobytes()
    stream = (
        b"\x80\x02}q\x01U\x02S1q\x02cnumpy.core.multiarray\n_reconstruct\nq\x03cnumpy\nndarray\nq\x04K\x00\x85U\x01b\x87R"
        b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02f4K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89"
        b"U" + struct.pack("<B", len(raw)) + raw + b"tbs."
    )
    (place / "a.pkl").write_bytes(stream)
    assert same(load_pickle(place / "a.pkl"), {"S1": np.array([1, 2], "f4")})


class Runs:
    """Leaves a file where it runs."""

    def __init__(self, call, *args):
        self.how = call, args

    def __reduce__(self):
        return self.how


def bombs(mark: Path) -> list:
    return [
        Runs(os.system, f"touch {mark}"),
        Runs(eval, f"open({str(mark)!r}, 'w')"),
        Runs(exec, f"open({str(mark)!r}, 'w')"),
        Runs(getattr, {}, "keys"),
        Runs(open, str(mark), "w"),
        Runs(Path, str(mark)),
        Runs(np.memmap, str(mark), "u1", "w+", 0, (4,)),
        Runs(np.lib.format.open_memmap, str(mark), "w+"),
        Runs(bytearray, 8),
        Runs(type, "Own", (), {}),
        np.random.default_rng(0),
        np.array([(1, 2.0)], "i4,f4"),
        np.datetime64("2020-01-01"),
    ]


@pytest.mark.parametrize("which", range(13))
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_nothing_else_is_opened_and_nothing_runs(tmp_path, which, protocol):
    mark = tmp_path / "ran"
    bomb = bombs(mark)[which]
    for value in (bomb, {"S1": [bomb]}, np.array([bomb, None], object)):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(value, protocol))
        with pytest.raises(UserError, match=r"wants to import '|expected numbers, text|dtype|a state"):
            load_pickle(tmp_path / "a.pkl")
    np.savez(tmp_path / "a.npz", positions_3d=np.array([bomb, None], object))
    with pytest.raises(UserError, match=r"a\.npz.*(wants to import|expected numbers)"):
        load_object_npz(tmp_path / "a.npz")
    assert not mark.exists()


def test_the_message_names_what_the_file_wanted(tmp_path):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(Runs(os.system, "true")))
    with pytest.raises(UserError, match=r"a\.pkl wants to import '(posix|nt)\.system', expected only NumPy arrays"):
        load_pickle(tmp_path / "a.pkl")


HUGE = [
    b"\x80\x05\x96" + struct.pack("<Q", 2**40) + b"abc.",  # a bytearray of a terabyte
    b"\x80\x04\x8e" + struct.pack("<Q", 2**40) + b"abc.",  # bytes
    b"\x80\x04\x95" + struct.pack("<Q", 2**40) + b"N.",  # a frame
    b"\x80\x02Nr" + struct.pack("<I", 2**32 - 1) + b".",  # a memo of four thousand million places: harmless here
    b"cnumpy\nndarray\n(I1000000000000\ntR.",
    b"cbuiltins\nbytearray\n(I1000000000000\ntR.",
    b"cnumpy\ndtype\n(S'V2000000000'\ntR.",
    b"\x80\x02}" + b"K\x01" + b"\x85" * 1_000_000 + b"K\x01s.",  # a key that takes a million calls to hash
    b"\x82\x01.", b"\x80\x02cbuiltins\nlist\n}X\x01\x00\x00\x00aK\x01sb.", b"Pxyz\n.", b"", b".", b"0",
]  # fmt: skip


@pytest.mark.parametrize("stream", HUGE)
def test_a_hostile_stream_takes_no_memory(tmp_path, stream):
    import resource

    (tmp_path / "a.pkl").write_bytes(stream)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        assert load_pickle(tmp_path / "a.pkl") is None
    except UserError as error:
        assert "a.pkl" in str(error)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


@pytest.mark.parametrize("shape", [(10**12,), (2, 2), (10**6, 10**6), (-1,), (3, 0)])
@pytest.mark.parametrize("kind", ["f4", "O"])
def test_an_array_that_claims_more_than_it_holds(tmp_path, shape, kind):
    class Lies:
        def __reduce__(self):
            state = (1, shape, np.dtype(kind), False, [None] * 3 if kind == "O" else b"\0" * 12)
            return np._core.multiarray._reconstruct, (np.ndarray, (0,), b"b"), state

    (tmp_path / "a.pkl").write_bytes(pickle.dumps(Lies()))
    with pytest.raises(UserError, match="claims|shape"):
        load_pickle(tmp_path / "a.pkl")


@given(st.integers(0, 10**6), st.binary(min_size=1, max_size=3))
def test_a_damaged_pickle_gives_one_error_or_plain_data(place, at, patch):
    stream = pickle.dumps({"S1": {"Walking": [np.ones((5, 17, 2), np.float32)] * 4}, "n": 3}, 2)
    at %= len(stream)
    (place / "cut.pkl").write_bytes(stream[:at] or b"\x80")
    with pytest.raises(UserError, match=r"cut\.pkl"):
        load_pickle(place / "cut.pkl")
    (place / "bent.pkl").write_bytes(stream[:at] + patch + stream[at + len(patch) :])
    try:
        load_pickle(place / "bent.pkl")
    except UserError as error:
        assert "bent.pkl" in str(error)


@given(st.binary(max_size=200))
def test_noise_gives_one_error_or_plain_data(place, noise):
    (place / "noise.pkl").write_bytes(noise)
    try:
        load_pickle(place / "noise.pkl")
    except UserError as error:
        assert "noise.pkl" in str(error)


@given(st.floats(0, 0.999))
def test_a_cut_npz_gives_one_error(place, share):
    np.savez_compressed(place / "whole.npz", positions_2d=np.array({"S1": np.ones((50, 2))}, object))
    stream = (place / "whole.npz").read_bytes()
    (place / "cut.npz").write_bytes(stream[: max(1, int(share * len(stream)))])
    with pytest.raises(UserError, match=r"cut\.npz"):
        load_object_npz(place / "cut.npz")


def test_an_npz_whose_headers_lie(tmp_path):
    def packed(content: bytes) -> Path:
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("a.npy", content)
        return tmp_path / "a.npz"

    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": (10**12,)})
    with pytest.raises(UserError, match="claims 4,000,000,000,000 bytes"):
        load_object_npz(packed(stream.getvalue() + b"\0" * 16))
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": (3,)})
    with pytest.raises(UserError, match="announces"):
        load_object_npz(packed(stream.getvalue() + pickle.dumps([1, 2, 3])))
    with pytest.raises(UserError, match=r"a\.npz"):
        load_object_npz(packed(b"not an array"))


def test_files_that_are_none(tmp_path):
    (tmp_path / "empty").touch()
    for load in (load_pickle, load_object_npz):
        for path in (tmp_path, tmp_path / "none", tmp_path / "empty"):
            with pytest.raises(UserError):
                load(path)
    (tmp_path / "page.html").write_text("<html>you need to log in</html>")
    for load in (load_pickle, load_object_npz):
        with pytest.raises(UserError, match="another format"):
            load(tmp_path / "page.html")
