"""The verb data cmu: CMU's motion capture files as training and test data with virtual cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from uplift.cli.parsing import Keys, checked, keyed
from uplift.cli.verbs import VERBS
from uplift.config.files import refuse_existing, refuse_output
from uplift.data.datasets.cmu import Clip, Rates, Rig, Trial, chosen_test, filmed, find_trials, read_clip, read_index
from uplift.data.formats.base import size_of
from uplift.data.formats.npz import write_keypoints
from uplift.errors import UserError

__all__ = ["make_cmu_files"]

_EVERY_S = 5.0
_RATE = VERBS["data cmu"].settings["fps"]._replace(name="rate", high=10_000)
_CREDIT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)


def make_cmu_files(words: list[str]) -> Iterator[str]:
    """Write ``train.npz`` and ``test.npz`` and yield a line on each step; raises UserError for an invalid word or file."""
    keys = keyed("data cmu", words)
    if len(keys.plain) != 1:
        raise UserError("data cmu takes one FOLDER with .asf, .amc or .bvh files. (uplift data cmu --help)")
    folder = Path(keys.plain[0]).expanduser()
    rates, rig = _rates(keys), _rig(keys)
    seed, unit_mm = keys.value("seed"), keys.value("unit_mm")
    output = _output(keys)
    trials, notes = find_trials(folder, keys.value("skip"))
    unknown = set(rates.own) - {trial.subject for trial in trials} - {trial.sequence for trial in trials}
    if unknown:
        raise UserError(f"rate={sorted(unknown)[0]}:...: no such subject or motion in {folder}.")
    # cgspeed.com distributes the index under this name.
    found = sorted(folder.rglob("cmu-mocap-index-text*.txt"))
    index = Path(keys["index"]).expanduser() if "index" in keys else next(iter(found), None)
    actions = read_index(index) if index else None
    yield f"{_people(trials)} in {folder}"
    yield from notes
    if index:
        yield f"actions from {index}"
    clips: list[Clip] = []
    yield from _read(trials, rates, unit_mm, clips)
    chosen, how = chosen_test(clips, keys.value("test"), seed)
    yield how
    output.mkdir(exist_ok=True)
    for name in ("train", "test"):
        part, path = [clip for clip in clips if (clip.sequence in chosen) == (name == "test")], output / f"{name}.npz"
        data = filmed(part, rig, rates.fps, seed, actions)
        write_keypoints(data, path)
        yield f"wrote {path}: {len(data):,} rows ({_people(part)}, {rig.cameras} camera{'s' * (rig.cameras > 1)})"
    yield f'credit: "{_CREDIT}" It may not be resold.'
    yield f"next: uplift fit task=cmu data.root={output}"


def _read(trials: list[Trial], rates: Rates, unit_mm: float | None, clips: list[Clip]) -> Iterator[str]:
    reported = time.monotonic()
    for trial in trials:
        clips.append(read_clip(trial, rates, unit_mm))
        if time.monotonic() - reported > _EVERY_S:
            reported = time.monotonic()
            yield f"read {len(clips):,} of {len(trials):,} motions"
    frames = sum(len(clip.joints) for clip in clips)
    yield f"read {frames:,} frames at {rates.fps:g} a second, {frames / rates.fps / 60:.1f} minutes"


def _people(motions: Sequence[Trial] | Sequence[Clip]) -> str:
    subjects = len({motion.subject for motion in motions})
    return f"{len(motions):,} motion{'s' * (len(motions) > 1)} of {subjects:,} subject{'s' * (subjects > 1)}"


def _output(keys: Keys) -> Path:
    output = Path(keys["output"]).expanduser()
    if output.exists() and not output.is_dir():
        raise UserError(f"output={output} is a file, expected a folder to write train.npz and test.npz into.")
    for name in ("train.npz", "test.npz"):
        refuse_existing(output / name)
    if not output.exists():
        refuse_output(output)
    return output


def _rig(keys: Keys) -> Rig:
    return Rig(
        cameras=keys.value("cameras"),
        tilt_deg=keys.value("tilt"),
        tilt_sd_deg=keys.value("tilt_sd"),
        distance_m=keys.value("distance"),
        focal_px=keys.value("focal_px"),
        image_size=size_of(keys.value("image_size")),
    )


def _rates(keys: Keys) -> Rates:
    amc, own = Rates.amc, {}
    for part in keys.value("rate"):
        name, colon, value = part.rpartition(":")
        rate = checked(_RATE, value, "data cmu")
        if colon:
            own[name] = rate
        else:
            amc = rate
    return Rates(fps=keys.value("fps"), amc=amc, own=own)
