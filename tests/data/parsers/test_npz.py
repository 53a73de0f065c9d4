"""Npz files whose headers, members or text are damaged: one error that names the file, whatever NumPy and zipfile raise."""

from __future__ import annotations

import io
import struct
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats.base import Peek
from uplift.data.parsers.npz import array_headers, read_arrays
from uplift.errors import UserError

HEADERS = {
    "TokenError": b"{'descr': '<f4', 'shape': (2,", "a line end in brackets": b"((((\n", "SyntaxError": b"{'descr'",
    "an indentation": b"\n  x\n y", "TypeError": b"{'descr': None, 'fortran_order': False, 'shape': ()}",
    "a number for a tuple": b"{'descr': '<f4', 'fortran_order': False, 'shape': 2}", "other keys": b"{1: 2}",
    "too many axes": b"{'descr': '<f4', 'fortran_order': False, 'shape': (1" + b",1" * 60 + b")}",
    "a negative size": b"{'descr': '<f4', 'fortran_order': False, 'shape': (-2,)}", "a spread": b"{**1}",
    "an odd date": b"{'descr': '<M8[x]', 'fortran_order': False, 'shape': (2,)}", "bytes": b"\xff\xfe\x00",
    "brackets": b"(" * 3000 + b")" * 3000,
}  # fmt: skip


def member(header: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(8)


def packed(content: bytes, method: int, flip: int) -> bytes:
    """Return a zip file of one member with a byte of its packed content changed."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        archive.writestr("a.npy", content)
    whole = bytearray(stream.getvalue())
    whole[30 + len("a.npy") + flip] ^= 0xFF
    return bytes(whole)


def refused(path: Path) -> None:
    with pytest.raises(UserError, match=str(path)):
        read_arrays(path)
    with suppress(UserError):  # headers alone may be sound
        array_headers(path)
    assert isinstance(Peek(path).npz_names, tuple)


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_that_is_none(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", member(HEADERS[name]))
    refused(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("flip", [2, 9, 12])
def test_members_whose_packing_is_damaged(method: int, flip: int, tmp_path: Path) -> None:
    """LZMAError, OSError, zlib.error or EOFError, and NotImplementedError for other packings."""
    path = tmp_path / "a.npz"
    content = member(b"{'descr': '<f4', 'fortran_order': False, 'shape': (2,)}")
    path.write_bytes(packed(content, method, flip))
    refused(path)


@pytest.mark.parametrize("code", [0x110000, 0xFFFFFFFF])
def test_text_of_characters_that_do_not_exist(code: int, tmp_path: Path) -> None:
    text = np.array([[97, code]], np.uint32).view("<U2").reshape(1)
    np.savez(tmp_path / "a.npz", joint_names=text)
    with pytest.raises(UserError, match="holds text of characters that do not exist"):
        read_arrays(tmp_path / "a.npz")


def test_a_header_of_python_2_is_read_without_a_word(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    plain = io.BytesIO()
    np.save(plain, np.arange(3.0))
    header = plain.getvalue().replace(b"(3,), }", b"(3L,),}")  # as long as before
    assert header != plain.getvalue()
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", header)
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.npz", ("a",))["a"], [0, 1, 2])
    assert not recwarn.list
