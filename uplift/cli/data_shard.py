"""The verb data shard: keypoints of any number of files as one folder of shards."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from uplift.cli.parsing import Keys, keyed
from uplift.config.files import building, files_of, refuse_output
from uplift.config.loading import load_settings
from uplift.config.progress import progress
from uplift.data.datasets import DATA_SETS
from uplift.data.far import without_far
from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.data.formats.shards import write_shards
from uplift.data.individuals import by_individuals
from uplift.data.joints import in_joints_of
from uplift.data.load import load_split
from uplift.data.parts import frames_of, iterate_parts
from uplift.data.pieces import pieces_of
from uplift.data.poses import PoseData
from uplift.data.reading import read_each
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["shard_command"]

_VERB = "data shard"
_PART = 100_000
"""Frames that are in memory at once, where a file can be read in parts."""


def shard_command(words: Sequence[str]) -> list[str]:
    """Write shards and return what to print; raises UserError for an invalid word or file."""
    keys = keyed(_VERB, words)
    if not keys.plain:
        raise UserError(f"{_VERB} takes files of keypoints, and output=FOLDER. (uplift {_VERB} --help)")
    output = Path(keys["output"]).expanduser()
    refuse_output(output)
    skeleton = load_skeleton(keys["skeleton"]) if "skeleton" in keys else None
    sets = [word for word in keys.plain if _is_set(word)]
    found = (one for word in keys.plain if word not in sets for one in files_of(Path(word).expanduser()))
    files, left_out = keypoint_files(list(dict.fromkeys(found)))
    _refuse_words(keys, sets, skeleton)
    with building(output) as folder:
        parts = progress(_parts(keys, files, sets, skeleton), "parts of files read")
        several = len(files) + len(sets) > 1
        index = write_shards(parts, folder, dtype=keys.value("dtype"), frames=keys.value("frames"), several=several)
    shards, notes = index["shards"], [*left_out, *index["notes"]]
    clips, size = sum(one["clips"] for one in shards), sum(one.stat().st_size for one in output.rglob("*.npy"))
    count = f"{len(shards):,} shard{'s' * (len(shards) > 1)}"
    wrote = f"wrote {output}: {index['frames']:,} frames in {clips:,} clips, {count}, {size / 1e9:.3g} GB"
    name = shlex.quote(keys.get("skeleton", "SKELETON"))
    return [*notes, wrote, f"next: uplift fit skeleton={name} data.train={shlex.quote(str(output))}"]


def _is_set(word: str) -> bool:
    return ":" in word and not Path(word).exists()


def _refuse_words(keys: Keys, sets: Sequence[str], skeleton: Skeleton | None) -> None:
    """Raise UserError for sets without a skeleton, and words that go with sets alone."""
    if sets and skeleton is None:
        raise UserError(f"{_VERB} {sets[0]}: a published set needs skeleton=NAME, whose joints are kept.")
    own = [key for key in keys if key in ("data.name", "data.root") or key.startswith("data.options")]
    if own and not sets:
        raise UserError(f"{_VERB}: {own[0]}= goes with a published set, SET:SPLIT.")


def _parts(keys: Keys, files: list[Path], sets: Sequence[str], skeleton: Skeleton | None) -> Iterator[PoseData]:
    options = keys.reading()
    for alone, some in groupby(files, lambda file: (frames_of(file, options) or 0) > _PART):
        if alone:
            for file in some:
                yield from iterate_parts(file, _PART, options, skeleton)
        else:
            for found in read_each(list(some), options, keys.value("workers")):
                part = without_far(by_individuals(found, skeleton))
                yield from pieces_of(part if skeleton is None else in_joints_of(part, skeleton), _PART)
    for word in sets:
        assert skeleton is not None
        use, _, split = word.rpartition(":")
        own = [f"{key}={value}" for key, value in keys.items() if key.startswith("data.")]
        settings = load_settings(None, [*([f"data.name={use}"] if use in DATA_SETS else []), f"data.use={use}", *own])
        settings.data.train = split
        yield from pieces_of(replace(load_split(settings, "train", skeleton), source=word), _PART)
