"""`DataSet`: which files of a published set are wanted, how they become `PoseData`, and the cache of what was read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.config.files import building, cache_folder, clear_parts, replacing
from uplift.data.names import Names, codes_of
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.geometry.lens import Lens

__all__ = ["DataSet", "Rows", "WantedFile", "cached_facts", "first_file", "read_cached"]


@dataclass(frozen=True)
class WantedFile:
    """A file that a split is read from."""

    path: Path
    what: str
    """What it holds and where it comes from, in a few words."""
    part: str = ""
    """What it is one of many files of, such as a subject and action: `uplift data check` has one line for these."""

    @property
    def present(self) -> bool:
        """Whether it is there."""
        return self.path.is_file()


class DataSet:
    """Subclass this, write `files` and `read`, and name the class in a task: ``data.use=my_set.py:MySet``.

    Options are keyword arguments of ``__init__`` with defaults, set as ``data.options``.
    """

    title: ClassVar[str] = ""
    """Its common name."""
    about: ClassVar[str] = ""
    """A few lines: where it comes from, what it may be used for, which files go where."""
    splits: ClassVar[tuple[str, ...]] = ("train", "test")
    version: ClassVar[int] = 1
    """Increase it when the same files give other results: what was cached before is then read anew."""
    cached: ClassVar[bool] = True
    """Whether reading takes long enough to keep the result."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    def files(self, split: str) -> list[WantedFile]:
        """Return the files that `read` opens for ``split``, whether they are there or not."""
        raise NotImplementedError(f"{type(self).__name__} has no files(self, split)")

    def read(self, split: str) -> PoseData:
        """Return the frames of ``split`` in the set's own joints, by name; every file of `files` is there.

        Raises:
            UserError: a file that is damaged, or another one than it should be.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read(self, split)")

    def check_split(self, split: str) -> None:
        """Refuse a split that the set does not have."""
        if split not in self.splits:
            raise UserError(f"{self.title} has no split '{split}'.{did_you_mean(split, self.splits)}")

    def missing(self, split: str) -> list[WantedFile]:
        """Return the files of ``split`` that are not there."""
        return [file for file in self.files(split) if not file.present]


def first_file(places: Iterable[Path]) -> Path:
    """Return the first of ``places`` that is a file, else the first."""
    places = list(places)
    return next((place for place in places if place.is_file()), places[0])


class Rows:
    """Arrays of keypoints with their 3D, allocated once and filled clip by clip."""

    def __init__(self, most: int, joints: tuple[str, ...]):
        self.joints = joints
        self.used = 0
        self.filled = [np.empty((most, len(joints), axes), np.float32) for axes in (2, 3)]
        self.filled += [np.empty((most, columns), np.float32) for columns in (len(joints), 3)]
        self.tilt_deg, self.lens = np.empty(most, np.float32), np.empty(most, np.int16)
        self.lenses: dict[Lens, int] = {}
        self.parts: list[tuple[int, dict[str, Any]]] = []

    def next(self, count: int, tilt_deg: float, identity: dict[str, Any], lens: Lens | None = None) -> list[np.ndarray]:
        """Return the next ``count`` rows of keypoints, pose, confidence and root, to be filled.

        ``identity`` has arrays of ``count``, or one value for all.
        """
        here = slice(self.used, self.used + count)
        self.used = here.stop
        self.tilt_deg[here] = tilt_deg
        if lens is not None:
            self.lens[here] = self.lenses.setdefault(lens, len(self.lenses))
        self.parts.append((count, identity))
        return [array[here] for array in self.filled]

    def data(self, **facts: Any) -> PoseData:
        """Return the rows that were filled; ``facts`` are other fields of `PoseData`."""
        here = slice(self.used)
        keypoints, pose, confidence, root = (array[here] for array in self.filled)
        return PoseData(
            keypoints=keypoints,
            confidence=confidence,
            joint_names=self.joints,
            pose=pose,
            root=root,
            tilt_deg=self.tilt_deg[here],
            identity={key: self._column(key) for key in self.parts[0][1]},
            lenses=tuple(self.lenses),
            lens=self.lens[here] if self.lenses else None,
            **facts,
        )

    def _column(self, key: str) -> Any:
        values = [np.broadcast_to(part[key], count) for count, part in self.parts]
        return Names.concat(values) if values[0].dtype.kind == "U" else np.concatenate(values)


# What was read from a data set's files, kept as plain arrays that load in seconds.

_FORMAT = 2
_ARRAYS = ("keypoints", "confidence", "pose", "root", "tilt_deg", "lens")
_FACTS = ("joint_names", "unit", "fps", "image_size", "focal_px", "source")


def read_cached(source: DataSet, split: str) -> PoseData:
    """Return ``source.read(split)``, from the cache where the files are those that were read before.

    A file that changed size or date, other options or another version of the reader make it read
    anew. A cache that cannot be written or is damaged costs time, never the data.

    Raises:
        UserError: as `DataSet.read` does.
    """
    if not source.cached:
        return source.read(split)
    place = _place(source, split)
    with contextlib.suppress(Exception):  # not there, or damaged in whatever way: it is only a cache
        return _load(place)
    data = source.read(split)
    with contextlib.suppress(OSError, UserError):  # no space, no permission, or another process was first
        _save(data, place)
    return data


def cached_facts(source: DataSet, split: str) -> dict[str, Any] | None:
    """Return frames, joints and bytes of ``split`` in the cache without loading it; None where it is not there."""
    place = _place(source, split)
    try:
        facts = _facts(place)
        size = sum(size for size, _ in facts["files"].values())
        return {"frames": facts["frames"], "joints": len(facts["joint_names"]), "bytes": size}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _place(source: DataSet, split: str) -> Path:
    """Return the folder of this split, read with these options (the first hash) from these files (the second)."""
    paths = [wanted.path for wanted in source.files(split) if wanted.present]
    files = [[str(path.absolute()), path.stat().st_size, path.stat().st_mtime_ns] for path in paths]
    options = {key: value for key, value in vars(source).items() if isinstance(value, (str, int, float, list, tuple))}
    name = type(source).__name__
    choices = _hash([type(source).__module__, name, split, options, str(source.folder.absolute())])
    return cache_folder("data") / f"{name.lower()}-{split}-{choices}-{_hash([_FORMAT, source.version, files])}"


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _save(data: PoseData, place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    clear_parts(place.parent)
    for stale in place.parent.glob(
        f"{place.name.rpartition('-')[0]}-*"
    ):  # damaged, or of files that have changed since
        shutil.rmtree(stale, ignore_errors=True)
        if not stale.is_dir():
            stale.unlink(missing_ok=True)
    with building(place) as folder:
        for name in _ARRAYS:
            array = getattr(data, name)
            if array is not None:
                np.save(folder / f"{name}.npy", array)
        for key, values in data.identity.items():
            _save_runs(folder, key, values)
        facts = {
            "frames": len(data),
            **{name: getattr(data, name) for name in _FACTS},
            "identity": list(data.identity),
            "lenses": [asdict(lens) for lens in data.lenses],
            "files": {path.name: _checksum(path) for path in sorted(folder.iterdir())},
        }
        text = json.dumps(facts).encode()
        with replacing(folder / "facts.json") as file:
            file.write(b"%08x\n" % zlib.crc32(text) + text)


def _checksum(path: Path) -> list[int]:
    """Return the length and the checksum of a file, once it is on the disk."""
    code = 0
    with path.open("rb") as file:
        os.fsync(file.fileno())
        while block := file.read(1 << 22):
            code = zlib.crc32(block, code)
        return [file.tell(), code]


def _facts(place: Path) -> dict[str, Any]:
    """Return what is known of a folder of the cache; raises ValueError where that is damaged."""
    code, _, text = (place / "facts.json").read_bytes().partition(b"\n")
    if code != b"%08x" % zlib.crc32(text):
        raise ValueError("another checksum")
    return json.loads(text)


def _save_runs(folder: Path, key: str, values: Any) -> None:
    """Save an identity array, text as names and the lengths of their runs."""
    if values.dtype.kind not in "US":
        np.save(folder / f"identity_{key}.npy", values)
        return
    names, code = codes_of(values)
    starts = np.flatnonzero(np.diff(code, prepend=-1))
    np.savez(
        folder / f"identity_{key}.npz",
        names=names,
        code=code[starts].astype(np.int32),
        count=np.diff(np.append(starts, len(values))).astype(np.int32),
    )


def _load(place: Path) -> PoseData:
    facts = _facts(place)
    if any(_checksum(place / name) != known for name, known in facts["files"].items()):
        raise ValueError("another checksum")
    arrays = {name: _mapped(place / f"{name}.npy") for name in _ARRAYS if (place / f"{name}.npy").is_file()}
    identity = {}
    for key in facts["identity"]:
        plain = place / f"identity_{key}.npy"
        if plain.is_file():
            identity[key] = _mapped(plain)
            continue
        with np.load(place / f"identity_{key}.npz") as runs:
            identity[key] = Names(np.repeat(runs["code"], runs["count"]), runs["names"])
    return PoseData(
        **arrays,  # type: ignore[arg-type]
        **{name: _as_tuple(facts[name]) for name in _FACTS},
        identity=identity,
        lenses=tuple(Lens(**{key: _as_tuple(value) for key, value in lens.items()}) for lens in facts["lenses"]),
    )


def _mapped(path: Path) -> np.ndarray:
    """Return a memory-mapped array whose changes stay in memory."""
    return np.asarray(np.load(path, mmap_mode="c"))


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
