"""Ways to make a valid file hostile: its tree, arrays, cells, words and members, its bytes, and its place."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["WORDS", "mutate"]

WORDS = (
    "", "nan", "inf", "-inf", "-1", "0", "1e999", "1e308", "-1e308", "99999999999999999999", "1e-400", "0x10", "1_0",
    "true", "null", "~", "[]", "{}", "[1,", "{a: 1}", "[[]]", "a,b", ",", ",,", "*", "[", "?", "..", ".", "/dev/null", "$HOME",
    "\udcff", "\ud800", "é", "日本", "١٢", "\n", "a\nb", "\t", " ", "\x1b[31m", '!!int ""', "!!float ''", "!!bool x",
    "!!timestamp 9", "!!null x", "!!binary x", "!!python/name:os.system", "&a 1", "*a", "<<", "'", '"', "%s", "{0}",
    "x" * 5000, "=", "==", "-", "--", "1:2:3", "2020-01-01", "0o7", ".inf", "-.inf", ".nan", "a.py:B", "os:system",
    ":", ":x", "x:", "a:b:c", "[abc]", "[a, a]", "[nan]", "{a: {b: {c: 1}}}", "=1+1", "../../etc/passwd", "1" * 500,
    "1,2", "640x480", "0x0", "1920x", "sqrt", "None", "False", "\x00"[:0] or "\x7f", "‮abc", "a" * 300 + ".csv",
)  # fmt: skip
"""Texts where others are expected; the operating system passes all of them."""
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2**31, 2**63, -(2**63) - 1, 10**30, 10**400, 1e308, -1e308, 1e39, 1e-320, float("nan"),
    float("inf"), float("-inf"), 0.5, "\x00", [], {}, [[]], [None], [1, 2], [[1.0, 2.0]], {"a": 1}, [{}], {"": None},
    "\ud800", "\udcff", *WORDS,
)  # fmt: skip
_LONGEST_TREE = 4000


def mutate(path: Path, rng: random.Random) -> str:
    """Damage the file, or a file in the folder, in place; returns what was done."""
    if path.is_dir():
        return _folder(path, rng)
    ending = path.suffix.lower()
    own = _BY_ENDING.get(ending)
    if own is None or rng.random() < 0.15:
        return _bytes(path, rng)
    done = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        try:
            done.append(own(path, rng))
        except Exception:  # what was damaged first may not open any more
            done.append(_bytes(path, rng))
    return ", ".join(done)


# Bytes and places: of any file.


def _bytes(path: Path, rng: random.Random) -> str:
    """Flip, cut, repeat or overwrite bytes."""
    data = bytearray(path.read_bytes())
    if not data:
        path.write_bytes(rng.randbytes(20))
        return "bytes where there were none"
    at = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(len(data), 512))
    what = rng.choice(
        ("flip", "flips", "cut", "cut early", "insert", "ones", "zeros", "repeat", "encoding", "empty", "word")
    )
    if what == "flip":
        data[at] ^= 1 << rng.randrange(8)
    elif what == "flips":
        for _ in range(rng.choice((4, 16, 64))):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif what == "cut":
        data = data[:at]
    elif what == "cut early":
        data = data[: rng.randrange(min(len(data), 64) + 1)]
    elif what == "insert":
        data[at:at] = rng.randbytes(rng.choice((1, 4, 100)))
    elif what in ("ones", "zeros"):
        size = rng.choice((1, 2, 4, 8, 64))
        data[at : at + size] = bytes([255 * (what == "ones")]) * min(size, len(data) - at)
    elif what == "repeat":
        data += data[: rng.randrange(len(data)) + 1]
    elif what == "encoding":
        text = bytes(data).decode("latin-1")
        data = bytearray(rng.choice((text.encode("utf-16"), text.encode("utf-8-sig"), text.encode("utf-32"))))
    elif what == "empty":
        data = bytearray(rng.choice((b"", b"\n", b"\0", b" ")))
    else:
        word = rng.choice((*(_encoded(word) for word in WORDS), b"\xff\xfe"))
        data[at : at + rng.choice((0, 1, len(word)))] = word
    path.write_bytes(bytes(data))
    return f"bytes: {what}"


def _encoded(text: str) -> bytes:
    """Return text in UTF-8, half characters as they are."""
    return text.encode("utf-8", "surrogatepass")


def _folder(path: Path, rng: random.Random) -> str:
    """Damage a file of a folder, most often, or what is in the folder."""
    files = sorted(one for one in path.rglob("*") if one.is_file() and not one.is_symlink())
    if not files:
        return "nothing to damage"
    one = rng.choice(files)
    what = rng.choice(("inside",) * 8 + ("gone", "renamed", "a folder", "junk", "twice", "a link", "hostile name"))
    if what == "inside":
        return f"{one.name}: {mutate(one, rng)}"
    if what in ("gone", "a folder", "a link"):
        one.unlink()
    if what == "renamed":
        one.rename(one.with_name(rng.choice(("x", ".x", one.name.upper(), "é" + one.name, "a b" + one.suffix))))
    elif what == "a folder":
        one.mkdir()
    elif what == "a link":
        one.symlink_to(rng.choice((one, Path("nowhere"), Path("/etc/hostname"), Path(".."))))
    elif what == "junk":
        one.with_name("junk" + one.suffix).write_bytes(rng.randbytes(50))
    elif what == "twice":
        shutil.copy(one, one.with_name("copy" + one.name))
    elif what == "hostile name":
        with_name = (
            os.fsencode(one.parent)
            + b"/"
            + rng.choice((b"\xff", b"a\nb", b"=1+1", b"\x1b[31m", "日本".encode()))
            + os.fsencode(one.suffix)
        )
        os.rename(os.fsencode(one), with_name)
    return f"{one.name}: {what}"


# Trees: JSON, YAML, and what torch saves.


def _places(tree: Any, limit: int = _LONGEST_TREE) -> list[tuple[Any, Any]]:
    """Return (container, key) of the parts of a tree, those of long lists in part."""
    found: list[tuple[Any, Any]] = []
    todo = [tree]
    while todo and len(found) < limit:
        part = todo.pop()
        keys = list(part) if isinstance(part, dict) else range(min(len(part), 12)) if isinstance(part, list) else ()
        for key in keys:
            found.append((part, key))
            todo.append(part[key])
    return found


def _shallow(places: list[tuple[Any, Any]], rng: random.Random) -> tuple[Any, Any]:
    """Return a place, those of mappings more often: there are fewer of them, and they mean more."""
    named = [place for place in places if isinstance(place[0], dict)]
    return rng.choice(named if named and rng.random() < 0.6 else places)


def _tree(tree: Any, rng: random.Random, values: tuple[Any, ...] = _VALUES) -> tuple[Any, str]:
    """Return the tree with one part changed, and what was done."""
    places = _places(tree)
    if not places or rng.random() < 0.02:
        return rng.choice(values), "another value altogether"
    holder, key = _shallow(places, rng)
    what = rng.choice(
        ("value",) * 6 + ("gone", "twice", "renamed", "swapped", "wrapped", "kind", "more", "short", "deep", "number")
    )
    if what == "value":
        holder[key] = rng.choice(values)
    elif what == "gone":
        del holder[key]
    elif what == "twice" and isinstance(holder, list):
        holder.insert(key, holder[key])
    elif what == "renamed" and isinstance(holder, dict):
        holder[str(rng.choice(WORDS))] = holder.pop(key)
    elif what == "swapped":
        other, place = rng.choice(places)
        holder[key], other[place] = (
            other.get(place) if isinstance(other, dict) else other[place] if place < len(other) else None,
            holder[key],
        )
    elif what == "wrapped":
        holder[key] = [holder[key]] if rng.random() < 0.5 else {"x": holder[key]}
    elif what == "kind":
        holder[key] = str(holder[key]) if not isinstance(holder[key], str) else [holder[key]]
    elif what == "more" and isinstance(holder, dict):
        holder[str(rng.choice(WORDS))] = rng.choice(values)
    elif what == "short" and isinstance(holder[key], (list, str)):
        holder[key] = holder[key][: rng.randrange(len(holder[key]) + 1)]
    elif what == "deep":
        holder[key] = _nested(rng.choice((30, 3000)))
    elif isinstance(holder[key], (int, float)):
        holder[key] = holder[key] * rng.choice((-1, 0, 1e30, 1e300, 0.001))
    return tree, f"{str(key)[:20]!r} {what}"


def _nested(depth: int) -> Any:
    made: Any = 1
    for _ in range(min(depth, 400)):
        made = [made]
    return made


def _json(path: Path, rng: random.Random) -> str:
    tree, done = _tree(json.loads(path.read_text(encoding="utf-8-sig")), rng)
    text = json.dumps(tree, ensure_ascii=rng.random() < 0.8)
    if rng.random() < 0.05:
        text = rng.choice(
            (
                text + text,
                "[" * 100_000,
                text.replace(",", ",,", 1),
                text[:-1] + ', "a": 1, "a": 2}',
                "\n".join([text] * 3),
            )
        )
        done += ", text"
    path.write_bytes(_encoded(text))
    return f"json: {done}"


_TAGS = ('!!int ""', "!!float x", "!!bool q", "!!timestamp z", "!!null 3", "!!binary '*'", "!!set {a}", "!!omap [a]", "&x [*x]",
         "*y", "? [a]", "!!str", "!x 1", "2020-99-99", "0b2", "1:99:99", "<<: {a: 1}", "|", ">", "- a", "%YAML 9", "---", "...", "@x", "`x",
         '"\\ud800"', '"\\0"', "{", "]", "'")  # fmt: skip


def _yaml(path: Path, rng: random.Random) -> str:
    import yaml

    if rng.random() < 0.35:
        return _lines(path, rng, words=(*WORDS, *_TAGS), separators=": ,[]{}\n")
    tree, done = _tree(yaml.safe_load(path.read_text()), rng)
    text = yaml.safe_dump(tree, allow_unicode=rng.random() < 0.5, default_flow_style=rng.random() < 0.3)
    path.write_bytes(_encoded(text))
    return f"yaml: {done}"


def _torch(path: Path, rng: random.Random) -> str:
    import torch

    state = torch.load(path, weights_only=True)
    tensors: tuple[Any, ...] = (
        torch.zeros(0), torch.zeros(1), torch.full((3, 3), float("nan")), torch.ones(17, 3, dtype=torch.int64),
        torch.ones(2, 2, 2, dtype=torch.complex64), torch.zeros(5, dtype=torch.bool), torch.ones(64, 64),
    )  # fmt: skip
    if rng.random() < 0.3:
        places = [(holder, key) for holder, key in _places(state) if isinstance(holder[key], torch.Tensor)]
        if places:
            holder, key = rng.choice(places)
            old = holder[key]
            holder[key] = rng.choice((old[:0], old.T if old.ndim == 2 else old, old * float("nan"), old.double(), old.long(), old.bool(),
                                      old.flatten(), old[None], old * 1e30, old.half()))  # fmt: skip
            torch.save(state, path)
            return f"torch: tensor {key!r}"
    state, done = _tree(state, rng, (*_VALUES, *tensors))
    torch.save(state, path)
    return f"torch: {done}"


# Text of lines and cells.


def _lines(path: Path, rng: random.Random, words: tuple[str, ...] = WORDS, separators: str = ",\t; \n") -> str:
    """Change a cell or word, or whole lines."""
    lines = path.read_text(encoding="utf-8", errors="surrogateescape").split("\n")
    at = rng.randrange(len(lines)) if rng.random() < 0.6 else rng.randrange(min(len(lines), 5))
    what = rng.choice(
        ("word",) * 8
        + ("drop word", "more words", "gone", "twice", "swapped", "cut", "blank", "long", "separator", "columns")
    )
    parts = re.split(f"([{re.escape(separators)}]+)", lines[at])
    place = 2 * rng.randrange((len(parts) + 1) // 2)
    if what == "word":
        parts[place] = rng.choice(words)
        lines[at] = "".join(parts)
    elif what == "drop word":
        lines[at] = "".join(parts[:place] + parts[place + 2 :])
    elif what == "more words":
        lines[at] += rng.choice(",\t ; ") + rng.choice(words)
    elif what == "gone":
        del lines[at]
    elif what == "twice":
        lines.insert(at, lines[at])
    elif what == "swapped":
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    elif what == "cut":
        lines = lines[:at] + [lines[at][: rng.randrange(len(lines[at]) + 1)]]
    elif what == "blank":
        lines.insert(at, "")
    elif what == "long":
        lines[at] *= 200
    elif what == "separator":
        old, new = rng.choice(",\t; "), rng.choice(",\t;| ")
        lines = [line.replace(old, new) for line in lines]
    else:
        column, word = rng.randrange(5), rng.choice(words)
        cells = [line.split(",") for line in lines]
        lines = [
            ",".join(word if place == column and n else cell for place, cell in enumerate(row))
            for n, row in enumerate(cells)
        ]
    path.write_bytes(_encoded("\n".join(lines)))
    return f"lines: {what}"


# Arrays: npz, HDF5, pictures.


def _array(old: np.ndarray, rng: random.Random) -> tuple[np.ndarray, str]:
    """Return another array in place of one."""
    what = rng.choice(list(_ARRAYS))
    made = _ARRAYS[what](np.array(old), rng)
    return np.asarray(made), what


def _with(old: np.ndarray, value: Any, rng: random.Random) -> np.ndarray:
    if old.dtype.kind in "fiu" and old.size:
        new = old.astype(np.float64) if old.dtype.kind != "f" else old.copy()
        flat = new.reshape(-1)
        flat[[rng.randrange(flat.size) for _ in range(rng.choice((1, 5, flat.size)))]] = value
        return new
    return old


def _bad_text(old: np.ndarray, rng: random.Random) -> np.ndarray:
    """Text with code points that are none."""
    size = max(old.size, 1)
    made = np.full((size, 4), 97, np.uint32)
    made[rng.randrange(size), 1] = rng.choice((0xD800, 0xDCFF, 0x110000, 0xFFFFFFFF, 0x1B, 0x0A, 0x202E))
    return made.view("<U4").reshape(old.shape or ())


_ARRAYS: dict[str, Callable[[np.ndarray, random.Random], Any]] = {
    "nan": lambda a, r: _with(a, np.nan, r),
    "inf": lambda a, r: _with(a, r.choice((np.inf, -np.inf)), r),
    "huge": lambda a, r: _with(a, r.choice((1e38, -1e300, 1e15, 2**53)), r),
    "zero": lambda a, r: np.zeros_like(a),
    "text": lambda a, r: np.full(a.shape, "abc"),
    "one text": lambda a, r: np.array("abc"),
    "list of text": lambda a, r: np.array(["abc"]),
    "bytes": lambda a, r: np.full(a.shape, b"\xff\xfe"),
    "bad text": _bad_text,
    "complex": lambda a, r: np.full(a.shape, 1j),
    "dates": lambda a, r: np.full(a.shape, np.datetime64("2020-01-01")),
    "records": lambda a, r: np.zeros(a.shape, [("a", "f4"), ("b", "U3")]),
    "objects": lambda a, r: np.full(a.shape, None, object),
    "flags": lambda a, r: np.ones(a.shape, bool),
    "half": lambda a, r: a.astype(np.float16) if a.dtype.kind in "fiub" else a,
    "long double": lambda a, r: a.astype(np.longdouble) if a.dtype.kind in "fiub" else a,
    "big endian": lambda a, r: a.astype(a.dtype.newbyteorder(">")),
    "unsigned": lambda a, r: np.full(a.shape, 2**64 - 1, np.uint64),
    "negative": lambda a, r: -a if a.dtype.kind in "fi" else a,
    "empty": lambda a, r: a[:0] if a.ndim else np.empty(0),
    "no columns": lambda a, r: a[..., :0] if a.ndim else a,
    "scalar": lambda a, r: a.reshape(-1)[0] if a.size else np.float32(0),
    "one row": lambda a, r: a[:1] if a.ndim else a,
    "short": lambda a, r: a[:-1] if a.ndim else a,
    "long": lambda a, r: np.concatenate([a, a[:1]]) if a.ndim else a,
    "transposed": lambda a, r: a.T,
    "flat": lambda a, r: a.reshape(-1),
    "deeper": lambda a, r: a[None],
    "deepest": lambda a, r: a.reshape(a.shape + (1,) * 20) if a.ndim < 10 else a,
    "columns first": lambda a, r: np.asfortranarray(a),
    "backwards": lambda a, r: a[::-1] if a.ndim else a,
    "same": lambda a, r: np.broadcast_to(a.reshape(-1)[:1], a.shape).copy() if a.size else a,
    "zero width text": lambda a, r: np.zeros(a.shape, "U1"),
}
_HEADERS = (
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (-1,), }", b"{'descr': '<f4', 'fortran_order': False, 'shape': (10**9,), }",
    b"{'descr': '<f4', 'shape': (2,), }", b"{'descr': '<f4', 'fortran_order': 3, 'shape': (2,), }", b"{'descr': 'abc', 'fortran_order': False, 'shape': (2,), }",
    b"{'descr': '|O', 'fortran_order': False, 'shape': (2,), }", b"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }",
    b"{'descr': '<f4', 'fortran_order': False, 'shape': 2, }", b"{'descr': '<f4', 'fortran_order': False, 'shape': (2L,), }",
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (2.5,), }", b"{'descr': '<f4', 'fortran_order': False, 'shape': ((2,),), }",
    b"((((((((((", b"{'descr'", b"\x00\x01\x02", b"[1, 2]", b"None", b"{'descr': '<U0', 'fortran_order': False, 'shape': (3000000,), }",
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (1" + b",1" * 60 + b"), }", b"{'descr': None, 'fortran_order': False, 'shape': (), }",
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (9223372036854775808,), }", b"'''", b"{1: 2}", b"\xff\xfe", b"{**1}", b"(" * 90 + b")" * 90,
    b"{'descr': ('<f4', (2, 2)), 'fortran_order': False, 'shape': (2,), }", b"{'descr': '<M8[x]', 'fortran_order': False, 'shape': (2,), }",
    b"{'descr': {'names': ['a'], 'formats': ['O']}, 'fortran_order': False, 'shape': (1,), }", b"{'descr': 'f4,f4', 'fortran_order': False, 'shape': (True,), }",
    b"\n  x\n y", b"{'a': 1\t\n", b"0b", b"1__0", b"{'descr': '<f4', 'fortran_order': False, 'shape': (), }" + b" " * 60_000,
)  # fmt: skip


def _npz(path: Path, rng: random.Random) -> str:
    if rng.random() < 0.35:
        return _members(path, rng)
    with np.load(path, allow_pickle=True) as file:
        arrays = {name: file[name] for name in file.files}
    name = rng.choice(list(arrays))
    what = rng.choice(("array",) * 8 + ("gone", "renamed", "more", "swapped", "only"))
    if what == "array":
        if arrays[name].dtype == object and rng.random() < 0.7:
            tree, done = _tree({"x": arrays[name].item() if arrays[name].ndim == 0 else arrays[name].tolist()}, rng)
            made = np.empty((), object)
            made[()] = tree["x"] if isinstance(tree, dict) and "x" in tree else tree
            arrays[name], what = made, f"{name} {done}"
        else:
            arrays[name], done = _array(arrays[name], rng)
            what = f"{name} {done}"
    elif what in ("gone", "renamed"):
        old = arrays.pop(name)
        if what == "renamed":
            arrays[rng.choice(("x", "é", name.upper(), "a/b", "keypoints ", ""))] = old
    elif what == "more":
        arrays[
            rng.choice(
                (
                    "confidence",
                    "pose",
                    "unit",
                    "masks",
                    "extra",
                    "fps",
                    "image_size",
                    "frame",
                    "subject",
                    "root",
                    "focal_px",
                    "camera",
                )
            )
        ] = _array(arrays[name], rng)[0]
    elif what == "swapped":
        other = rng.choice(list(arrays))
        arrays[name], arrays[other] = arrays[other], arrays[name]
    else:
        arrays = {name: arrays[name]}
    np.savez(path, **arrays)
    return f"npz: {what}"


def _members(path: Path, rng: random.Random) -> str:
    """Change the zip file around the arrays, or the header of one."""
    with zipfile.ZipFile(path) as archive:
        members = {one.filename: archive.read(one) for one in archive.infolist()}
    name = rng.choice(list(members))
    what = rng.choice(("header",) * 5 + ("packing", "name", "content", "cut", "comment", "twice", "version", "flag"))
    packing = zipfile.ZIP_STORED
    if what == "header":
        header = rng.choice(_HEADERS)
        version = rng.choice((b"\x01\x00", b"\x02\x00", b"\x03\x00"))
        size = len(header).to_bytes(2 if version[0] == 1 else 4, "little")
        members[name] = b"\x93NUMPY" + version + size + header + members[name][128:]
    elif what == "packing":
        packing = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    elif what == "name":
        members[rng.choice(("../x.npy", "/x.npy", "x.txt", "é.npy", "a/", ".npy", "x.npy/y.npy", "\n.npy"))] = (
            members.pop(name)
        )
    elif what == "content":
        members[name] = rng.choice((b"", b"abc", b"PK\x03\x04", rng.randbytes(300)))
    elif what == "cut":
        members[name] = members[name][: rng.randrange(len(members[name]) + 1)]
    elif what == "version":
        members[name] = members[name][:6] + rng.randbytes(2) + members[name][8:]
    with zipfile.ZipFile(path, "w", packing) as archive:
        for one, content in members.items():
            archive.writestr(one, content)
        if what == "comment":
            archive.comment = rng.randbytes(60_000)
        if what == "twice":
            archive.writestr(name, members[name])
    if what == "flag" or packing != zipfile.ZIP_STORED:
        data = bytearray(path.read_bytes())
        for signature, place in (
            (b"PK\x01\x02", rng.choice((6, 8, 10, 20, 24, 28, 30, 42))),
            (b"PK\x03\x04", rng.choice((4, 6, 8, 18, 22))),
        ):
            at = data.find(signature)
            if at >= 0 and rng.random() < 0.7:
                data[at + place] = rng.choice((1, 8, 9, 12, 14, 97, 255))
        start = data.find(b"PK\x03\x04")
        if rng.random() < 0.5:
            data[start + 60 + rng.randrange(20)] ^= 0xFF
        path.write_bytes(bytes(data))
    return f"zip: {what}"


def _h5(path: Path, rng: random.Random) -> str:
    import h5py

    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        item = file[name]
        what = rng.choice(
            ("array",) * 6
            + ("gone", "renamed", "attribute", "attribute", "link", "outside", "group", "virtual", "swapped", "packed")
        )
        if what == "array" and not isinstance(item, h5py.Dataset):
            what = "attribute"
        if what == "array":
            value = item[()]
            made, done = _array(np.asarray(value), rng)
            attributes = dict(item.attrs)
            del file[name]
            file[name] = np.char.encode(made, "utf-8", "replace") if made.dtype.kind == "U" else made
            for key, one in attributes.items():
                file[name].attrs[key] = one
            what = f"array {done}"
        elif what == "attribute":
            keys = list(item.attrs) or list(file.attrs) or ["x"]
            key = rng.choice(keys)
            value = rng.choice(
                (
                    1,
                    -1,
                    np.nan,
                    "abc",
                    "",
                    "{",
                    "[1]",
                    b"\xff",
                    np.zeros(3),
                    np.zeros((2, 2), "S3"),
                    "{}",
                    '{"a": 1}',
                    "[]",
                    h5py.Empty("f"),
                    2**40,
                )
            )
            (item if key in item.attrs else file).attrs[key] = value
        elif what in ("gone", "renamed", "link", "outside", "group", "virtual", "packed"):
            value = item[()] if isinstance(item, h5py.Dataset) else np.zeros(3)
            del file[name]
            if what == "renamed":
                file[rng.choice(("x", name + "_", "a/b/c"))] = 1
            elif what == "link":
                file[name] = h5py.SoftLink(rng.choice(("/" + name, "/", "/nowhere", "..")))
            elif what == "outside":
                file[name] = h5py.ExternalLink("/etc/hostname", "/")
            elif what == "group":
                file.create_group(name)
            elif what == "virtual":
                layout = h5py.VirtualLayout((4,), "f4")
                layout[:] = h5py.VirtualSource("/tmp/none.h5", "x", (4,))
                file.create_virtual_dataset(name, layout)
            elif what == "packed" and np.ndim(value):
                file.create_dataset(name, data=value, compression="gzip", shuffle=True)
        else:
            other = rng.choice(names)
            if other != name and not other.startswith(name) and not name.startswith(other):
                file.move(name, "swap")
                file.move(other, name)
                file.move("swap", other)
    return f"h5: {what} of {name}"


def _picture(path: Path, rng: random.Random) -> str:
    from PIL import Image

    if rng.random() < 0.3:
        return _bytes(path, rng)
    with Image.open(path) as image:
        grey = image.convert("L")
    mode = rng.choice(("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "I;16", "F", "I", "YCbCr"))
    form = rng.choice(("png", "jpeg", "tiff", "bmp", "gif", "webp", "ppm"))
    size = rng.choice((grey.size, (1, 1), (1, 500), (3, 3)))
    made = grey.resize(size)
    made = (
        made.convert("I").convert(mode)
        if mode.startswith("I")
        else made.convert("RGB").convert(mode)
        if mode == "YCbCr"
        else made.convert(mode)
    )
    value = rng.choice((None, None, 0, 255))
    if value is not None:
        made = Image.new("L", size, value)
    try:
        made.save(path, form)
    except OSError:
        grey.save(path, form)
    return f"picture: {mode} {form} {size}"


def _glb(path: Path, rng: random.Random) -> str:
    """Change the tree of a binary glTF file."""
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree, done = _tree(json.loads(data[20 : 20 + size]), rng)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    total = 20 + len(text) + len(rest)
    path.write_bytes(
        data[:8] + total.to_bytes(4, "little") + len(text).to_bytes(4, "little") + data[16:20] + text + rest
    )
    return f"glb: {done}"


_BY_ENDING: dict[str, Callable[[Path, random.Random], str]] = {
    **dict.fromkeys((".json", ".gltf"), _json),
    **dict.fromkeys((".yaml", ".yml"), _yaml),
    **dict.fromkeys((".pt", ".ckpt"), _torch),
    **dict.fromkeys((".csv", ".txt", ".asf", ".amc", ".bvh", ".obj", ".ply", ".off", ".calibration", ".py"), _lines),
    ".npz": _npz,
    **dict.fromkeys((".h5", ".slp", ".nwb"), _h5),
    ".png": _picture,
    ".glb": _glb,
}
