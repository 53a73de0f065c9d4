"""Shards: keypoints of any number of frames as a folder of plain arrays, which are mapped into memory, not read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from uplift.config.files import replacing
from uplift.data.concat import joined_columns
from uplift.data.formats.base import FileFormat, ReadOptions
from uplift.data.names import Names, codes_of
from uplift.data.parsers.files import bytes_of, check_claim, damage_as_error, read_bytes, refuse_more_than_memory
from uplift.data.parsers.npz import read_header, sound
from uplift.data.pieces import pieces_of
from uplift.data.poses import IDENTITY_KEYS, UNITS, PoseData
from uplift.errors import UserError
from uplift.geometry.lens import Lens

__all__ = ["DTYPES", "FORMAT", "INDEX", "SHARD_FRAMES", "Outline", "Shards", "write_shards"]

DTYPES = ("float32", "float16")
"""What keypoints and confidences are stored as.

As float16, keypoints are stored from the middle of the frame's box, which is float32: a joint is off by a 2048th of its
distance from there at most, 0.05 % of the body's size, and a confidence by a 2048th of itself. Truth stays float32.
"""
SHARD_FRAMES = 250_000
"""Frames of a shard, where no clip is longer."""
INDEX = "shards.json"
_FORMAT, _VERSION = "uplift shards", 1
_ROW: dict[str, tuple[Any, ...]] = {
    "keypoints": ("joints", 2), "origin": (2,), "confidence": ("joints",), "pose": ("joints", 3), "root": (3,),
    "tilt_deg": (), "gravity": (3,), "masks": ("side", "side"), "mask_box": (3,), "lens": (),
}  # fmt: skip
"""Arrays of a shard, beside those of identity, and the shape of a row of each."""
_FLOATS = ("pose", "root", "tilt_deg", "gravity", "mask_box")


# Write.


def write_shards(
    parts: Iterable[PoseData],
    folder: Path,
    *,
    dtype: str = "float32",
    frames: int = SHARD_FRAMES,
    several: bool = False,
) -> dict[str, Any]:
    """Write the frames of ``parts``, whose clips are whole, into an empty folder, and return the index.

    Frames of one clip are put together and in time. With parts of ``several`` files their sequences stay apart: a name
    that an earlier file has is put behind that of its file, and a file without sequences is one, named as the file.

    Raises:
        UserError: no frames, parts with other joints than the first, poses in another unit, masks of another size.
    """
    writer = _Writer(several)
    shards: list[dict[str, Any]] = []
    for group in _groups((piece for part in parts for piece in pieces_of(writer.alike(part), frames)), frames):
        place = folder / f"{len(shards):06d}"
        place.mkdir()
        shards.append(_write_shard(group, place, dtype))
    if not shards:
        raise UserError("there are no frames to write.")
    index = {"format": _FORMAT, "version": _VERSION, "dtype": dtype, **writer.facts(), "shards": shards}
    with replacing(folder / INDEX) as file:
        file.write(json.dumps(index).encode())
    return index


def _groups(pieces: Iterable[PoseData], frames: int) -> Iterator[list[PoseData]]:
    """Yield pieces that have ``frames`` frames together at most."""
    group: list[PoseData] = []
    for piece in pieces:
        if group and sum(map(len, group)) + len(piece) > frames:
            yield group
            group = []
        group.append(piece)
    if group:
        yield group


@dataclass
class _Writer:
    """What the parts so far have in common, and where they differ."""

    several: bool
    first: PoseData | None = None
    frames: int = 0
    fps: dict[float | None, None] = field(default_factory=dict)
    cameras: dict[tuple[Any, ...], int] = field(default_factory=dict)
    """(focal length, image size, lens) -> its number."""
    notes: dict[str, None] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)
    """Rows so far of each source."""
    names: dict[str, str] = field(default_factory=dict)
    """Sequence -> the first source that has it."""

    def alike(self, part: PoseData) -> PoseData:
        """Return a part with the joints of the first in its order, its sequences apart, and `lens` numbered in all parts."""
        first = self.first = self.first or part
        self._check(part, first)
        if part.joint_names != first.joint_names:
            order = [part.joint_names.index(name) for name in first.joint_names]
            pose = None if part.pose is None else part.pose[:, order]
            part = replace(
                part,
                keypoints=part.keypoints[:, order],
                confidence=part.confidence[:, order],
                pose=pose,
                joint_names=first.joint_names,
            )
        part = replace(part, identity=self._identity(part))
        order = part.in_order()
        part = part if (np.diff(order) == 1).all() else part.select(order)
        self.frames += len(part)
        self.fps[part.fps] = None
        self.notes |= dict.fromkeys(part.notes)
        known = [(None, lens.image_size, lens) for lens in part.lenses] or [(part.focal_px, part.image_size, None)]
        numbers = np.array([self.cameras.setdefault(camera, len(self.cameras)) for camera in known], np.int16)
        return replace(part, lens=numbers[np.zeros(len(part), int) if part.lens is None else part.lens], lenses=())

    def _check(self, part: PoseData, first: PoseData) -> None:
        """Raise UserError for a part that does not go with the first."""
        where = f"{part.source}: "
        if set(part.joint_names) != set(first.joint_names):
            more, less = (
                sorted(set(a) - set(b))
                for a, b in ((part.joint_names, first.joint_names), (first.joint_names, part.joint_names))
            )
            found = "; ".join(
                f"{what} {', '.join(names[:4])}" for what, names in (("has", more), ("lacks", less)) if names
            )
            raise UserError(
                f"{where}other joints than {first.source} ({found}): shards have the same joints throughout. Give "
                "skeleton=NAME, whose joints both have."
            )
        if part.pose is not None and part.unit != (first.unit if first.pose is not None else part.unit):
            raise UserError(
                f"{where}poses in {part.unit}, those of {first.source} in {first.unit}: convert one of them."
            )
        sides = [one.masks.shape[1] for one in (first, part) if one.masks is not None]
        if len(set(sides)) > 1:
            raise UserError(
                f"{where}masks of {sides[1]} px a side, those of {first.source} of {sides[0]}: make them alike."
            )

    def _identity(self, part: PoseData) -> dict[str, Any]:
        """Return what the frames are of, with sequences that no other source has."""
        identity, source = dict(part.identity), part.source
        if not self.several or ("image" in identity and "sequence" not in identity):
            return identity
        before = self.rows.get(source, 0)
        self.rows[source] = before + len(part)
        if "sequence" not in identity:
            identity["sequence"] = np.full(len(part), Path(source).stem)
            identity.setdefault("frame", np.arange(before, before + len(part)))
        names, code = codes_of(Names.of(identity["sequence"]))
        apart = [
            name if self.names.setdefault(name, source) == source else f"{source}: {name}" for name in names.tolist()
        ]
        return identity | {"sequence": Names(code, np.array(apart))}

    def facts(self) -> dict[str, Any]:
        """Return what holds for all frames."""
        assert self.first is not None
        first, notes = self.first, list(self.notes)
        fps = next(iter(self.fps)) if len(self.fps) == 1 else None
        if len(self.fps) > 1:
            notes.append("fps is not the same in all files and is not used")
        return {
            "frames": self.frames, "joint_names": list(first.joint_names), "unit": first.unit, "fps": fps, "stills": first.stills,
            "bones": first.bones, "mirror": first.mirror, **self._cameras(notes), "notes": notes,
        }  # fmt: skip

    def _cameras(self, notes: list[str]) -> dict[str, Any]:
        """Return the cameras: one for all frames, or those that `lens` numbers; a note where some are not known."""
        known = all(lens or (focal_px and size) for focal_px, size, lens in self.cameras)
        sizes = {size for _, size, _ in self.cameras}
        focal_px = next(iter(self.cameras))[0] if len(self.cameras) == 1 else None
        size = sizes.pop() if len(sizes) == 1 else None
        lenses: list[Any] = []
        if next(iter(self.cameras))[2] or (known and len(self.cameras) > 1):
            lenses = [asdict(lens or Lens.ideal(focal, size)) for focal, size, lens in self.cameras]
        elif len(self.cameras) > 1:
            notes.append("focal_px or image_size is not the same in all files and is not used")
        return {"focal_px": focal_px, "image_size": size, "lenses": lenses}


def _write_shard(group: Sequence[PoseData], place: Path, dtype: str) -> dict[str, Any]:
    """Write the frames of a group as the shard ``place``, and return its entry in the index."""
    keys = [key for key in IDENTITY_KEYS if any(key in part.identity for part in group)]
    blank = [np.full(len(part), "") for part in group]
    identity = {
        key: joined_columns([part.identity.get(key, none) for part, none in zip(group, blank, strict=True)])
        for key in keys
    }
    data = PoseData.concat(group, identity=identity) if len(group) > 1 else group[0]
    arrays = {name: getattr(data, name) for name in ("keypoints", "confidence", *_FLOATS, "masks", "lens")}
    arrays = {name: array for name, array in arrays.items() if array is not None}
    arrays |= {
        name: arrays[name].astype(np.float32) for name in ("keypoints", "confidence", *_FLOATS) if name in arrays
    }
    if dtype == "float16":
        arrays |= _in_float16(arrays["keypoints"], arrays["confidence"])
    for key, values in data.identity.items():
        arrays |= _coded(key, values)
    for name, array in arrays.items():
        np.save(place / f"{name}.npy", np.ascontiguousarray(array))
    return {"name": place.name, "frames": len(data), "clips": int(data.clips().max()) + 1, "arrays": sorted(arrays)}


def _in_float16(keypoints: np.ndarray, confidence: np.ndarray) -> dict[str, np.ndarray]:
    seen = np.asarray(confidence > 0) & np.isfinite(keypoints).all(-1)
    low, high = (np.where(seen[:, :, None], keypoints, far) for far in (np.float32(np.inf), np.float32(-np.inf)))
    origin = np.where(seen.any(1, keepdims=True), (low.min(1) + high.max(1)) / 2, 0).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # what is too far away for float16 is missing
        offsets = np.where(seen[:, :, None], keypoints - origin[:, None], np.nan).astype(np.float16)
        small = np.where(seen, np.fmax(confidence, np.finfo(np.float16).smallest_subnormal), 0).astype(np.float16)
    return {"keypoints": offsets, "origin": origin, "confidence": small}


def _coded(key: str, values: Any) -> dict[str, np.ndarray]:
    """Return a column of identity as small numbers, text as the numbers of its names."""
    if values.dtype.kind in "iu":
        least = np.result_type(*(np.min_scalar_type(int(end)) for end in (values.min(), values.max())))
        return {key: values.astype(least)}
    if values.dtype.kind in "fb":
        return {key: values}
    names, code = codes_of(Names.of(values))  # those of these frames alone
    return {key: code.astype(np.min_scalar_type(max(0, len(names) - 1))), f"{key}.names": names}


# Read.

_INSTEAD = "Train on the folder alone (data.train=FOLDER), which reads it bit by bit, or predict in parts"


@dataclass
class Outline(PoseData):
    """Frames without their keypoints."""

    rows: Int[np.ndarray, " frames"] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Which frames of the shards they are."""


class Shards:
    """A folder of shards: what is known of all frames; their arrays are mapped as they are asked for.

    Raises:
        UserError: not there, not shards, damaged, or of a later version.
    """

    def __init__(self, path: str | Path):
        path = Path(path)
        self.path = path.parent if path.name == INDEX else path
        place = self.path / INDEX
        with damage_as_error(place, "the index of shards"):
            index = json.loads(read_bytes(place))
            if index["format"] != _FORMAT:
                raise ValueError(f"its format is {index['format']!r}, expected {_FORMAT!r}")
            if index["version"] > _VERSION:
                raise UserError(
                    f"{place}: written by a later version of uplift (layout {index['version']}, known: {_VERSION})."
                )
            self.facts, self.is_float16 = _facts(index), index["dtype"] == "float16"
            self.shards = [_Shard.of(self.path, entry) for entry in index["shards"]]
        self.starts = np.cumsum([0, *(shard.frames for shard in self.shards)])
        """First row of each shard, and the number of frames."""

    def __len__(self) -> int:
        return int(self.starts[-1])

    @property
    def joints(self) -> int:
        """How many joints there are."""
        return len(self.facts["joint_names"])

    @property
    def has_pose(self) -> bool:
        """Whether any frame has a true pose."""
        return any("pose" in shard.arrays for shard in self.shards)

    @property
    def size(self) -> int:
        """The bytes that all frames take in memory, about."""
        files = (shard.folder / f"{name}.npy" for shard in self.shards for name in shard.arrays)
        return sum(path.stat().st_size for path in files if path.is_file()) * (2 if self.is_float16 else 1)

    def shard(self, number: int, rows: slice = slice(None)) -> PoseData:
        """Return the frames of a shard; float32 arrays are mapped, and read as they are used."""
        shard = self.shards[number]
        arrays = {name: shard.array(name, self.joints)[rows] for name in shard.arrays if name in _ROW}
        if "origin" in arrays:
            arrays["keypoints"] = arrays["keypoints"].astype(np.float32) + arrays.pop("origin")[:, None]
        arrays["confidence"] = arrays["confidence"].astype(np.float32, copy=False)
        lens, known = arrays.pop("lens", None), bool(self.facts["lenses"])
        if known and lens is not None and lens.max(initial=0) >= len(self.facts["lenses"]):
            raise UserError(f"{shard.folder}: frames of camera {lens.max()}, of {len(self.facts['lenses'])}: damaged.")
        identity = {key: shard.column(key, rows) for key in IDENTITY_KEYS if key in shard.arrays}
        return PoseData(**arrays, **self.facts, identity=identity, lens=lens if known else None, source=str(self.path))

    def take(self, rows: np.ndarray) -> PoseData:
        """Return the frames of rows in rising order; raises UserError where they are more than half of the memory."""
        refuse_more_than_memory(
            f"{self.path}: {len(rows):,} of its frames", self.size * len(rows) // len(self), _INSTEAD
        )
        ends = np.searchsorted(rows, self.starts)
        parts = [
            self.shard(number).select(rows[start:end] - self.starts[number])
            for number, (start, end) in enumerate(pairwise(ends))
            if start < end
        ]
        return self._joined(parts)

    def outline(self, *, named: bool = True) -> Outline:
        """Return all frames without a joint; ``named``, with what they are of, which they are chosen by."""
        keys = [key for key in IDENTITY_KEYS if named and all(key in shard.arrays for shard in self.shards)]
        columns = {key: [shard.column(key, slice(None)) for shard in self.shards] for key in keys}
        frames = len(self)
        return Outline(
            np.zeros((frames, 0, 2), np.float32),
            np.zeros((frames, 0), np.float32),
            pose=np.zeros((frames, 0, 3), np.float32) if self.has_pose else None,
            **{**self.facts, "lenses": (), "joint_names": ()},
            identity={key: joined_columns(values) for key, values in columns.items()},
            source=str(self.path),
            rows=np.arange(frames),
        )

    def clip_starts(self, number: int) -> np.ndarray:
        """Return the rows of a shard at which clips begin; all where frames are no clips."""
        shard = self.shards[number]
        rows = np.arange(shard.frames)
        if "sequence" not in shard.arrays or self.facts["stills"]:
            return rows
        changed = np.zeros(shard.frames, bool)
        for key in ("subject", "sequence", "camera", "instance"):
            if key in shard.arrays:
                values = shard.numbers(key)
                changed[1:] |= values[1:] != values[:-1]
        changed[0] = True
        return rows[changed]

    def parts(self, frames: int) -> Iterator[PoseData]:
        """Yield all frames in order, in parts of whole clips of ``frames`` at most, or one longer clip."""
        pieces = (piece for number in range(len(self.shards)) for piece in pieces_of(self.shard(number), frames))
        for group in _groups(pieces, frames):
            yield self._joined(group)

    def _joined(self, parts: Sequence[PoseData]) -> PoseData:
        if len(parts) == 1:
            return parts[0]
        keys = [key for key in IDENTITY_KEYS if all(key in part.identity for part in parts)]
        return PoseData.concat(
            parts, identity={key: joined_columns([part.identity[key] for part in parts]) for key in keys}
        )

    def read(self) -> PoseData:
        """Return all frames; raises UserError where they are more than half of the memory."""
        refuse_more_than_memory(f"{self.path}: all of its frames", self.size, _INSTEAD)
        return self._joined([self.shard(number) for number in range(len(self.shards))])


def _facts(index: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of `PoseData` that hold for all frames; raises whatever damage leads to."""
    size, fps, focal_px = index["image_size"], index["fps"], index["focal_px"]
    if index["unit"] not in UNITS:
        raise ValueError(f"its unit is {index['unit']!r}")
    return {
        "joint_names": tuple(map(str, index["joint_names"])),
        "unit": index["unit"],
        "fps": None if fps is None else float(fps),
        "image_size": None if size is None else (int(size[0]), int(size[1])),
        "focal_px": None if focal_px is None else float(focal_px),
        "stills": bool(index["stills"]),
        "lenses": tuple(_lens(one) for one in index["lenses"]),
        "bones": tuple((str(a), str(b)) for a, b in index["bones"]),
        "mirror": tuple((str(a), str(b)) for a, b in index["mirror"]),
        "notes": tuple(map(str, index["notes"])),
    }


def _lens(entry: dict[str, Any]) -> Lens:
    fields: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return Lens(**fields)


@dataclass(frozen=True)
class _Shard:
    """One shard and the names of its arrays."""

    folder: Path
    frames: int
    clips: int
    arrays: tuple[str, ...]

    @classmethod
    def of(cls, path: Path, entry: dict[str, Any]) -> _Shard:
        """Return the shard of an entry of the index; raises ValueError for one that leads out of the folder."""
        known = {*_ROW, *IDENTITY_KEYS, *(f"{key}.names" for key in IDENTITY_KEYS)}
        name, frames, arrays = str(entry["name"]), int(entry["frames"]), tuple(map(str, entry["arrays"]))
        if not name.isdigit() or frames < 1 or not {"keypoints", "confidence"} <= {*arrays} <= known:
            raise ValueError(f"the shard {name!r} is none")
        return cls(path / name, frames, int(entry["clips"]), arrays)

    def array(self, name: str, joints: int) -> np.ndarray:
        """Return an array of a row for each frame, mapped; raises UserError for another type or shape."""
        array = self._mapped(name)
        row = [{"joints": joints, "side": array.shape[-1] if array.ndim else 0}.get(one, one) for one in _ROW[name]]
        kinds = "u" if name == "masks" else "iu" if name == "lens" else "f"
        if array.shape != (self.frames, *row) or array.dtype.kind not in kinds:
            raise UserError(
                f"{self.folder / name}.npy is {array.dtype} of shape {array.shape}, expected {(self.frames, *row)}: damaged."
            )
        return array

    def column(self, key: str, rows: slice) -> np.ndarray | Names:
        """Return what the frames ``rows`` are of; raises UserError for numbers without a name, or another shape."""
        values = self.numbers(key)
        if f"{key}.names" not in self.arrays:
            return np.array(values[rows])
        names, codes = self._mapped(f"{key}.names"), values[rows]
        if (
            names.ndim != 1
            or names.dtype.kind != "U"
            or (len(codes) and not 0 <= codes.min() <= codes.max() < len(names))
        ):
            raise UserError(f"{self.folder / key}.names.npy has no name for some frames: damaged.")
        return Names(np.array(codes), sound(key, np.array(names)))

    def numbers(self, key: str) -> np.ndarray:
        """Return what the frames are of as it is stored; raises UserError for another type or shape."""
        values = self._mapped(key)
        if values.shape != (self.frames,) or values.dtype.kind not in "iufb":
            raise UserError(f"{self.folder / key}.npy is {values.dtype} of shape {values.shape}: damaged.")
        return values

    def _mapped(self, name: str) -> np.ndarray:
        """Return a mapped array, whose changes stay in memory, after its header was compared with the bytes that are there."""
        path = self.folder / f"{name}.npy"
        with damage_as_error(path, "an array of a shard"), path.open("rb") as file:
            shape, by_columns, dtype = read_header(file)
            offset, size = file.tell(), check_claim(str(path), shape, dtype)
            if dtype.hasobject or by_columns or offset + size != path.stat().st_size:
                raise ValueError(f"its header claims {bytes_of(shape, dtype):,} bytes of {dtype}")
            return np.asarray(np.memmap(path, dtype, "c", offset, shape))


def _read(path: Path, options: ReadOptions) -> PoseData:
    return Shards(path).read()


FORMAT = FileFormat(
    "shards",
    "uplift's shards",
    lambda peek: peek.path.name == INDEX or (peek.is_folder and (peek.path / INDEX).is_file()),
    lambda peek, options: _read(peek.path, options),
    coordinates="placed",
)
