"""The verb data cmu: CMU's motion capture files as training and test data with virtual cameras."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from uplift.cli.parsing import check_keys
from uplift.config.files import refuse_existing, refuse_output
from uplift.config.loading import split_words
from uplift.data.datasets.cmu import Clip, Rates, Rig, Trial, chosen_test, filmed, find_trials, read_clip, read_index
from uplift.errors import UserError

__all__ = ["make_cmu_files"]

_KEYS = (
    "output", "fps", "cameras", "tilt", "tilt_sd", "distance", "focal_px", "image_size", "seed", "test", "index",
    "rate", "skip", "unit_mm",
)  # fmt: skip
_USE = "data cmu DIR output=FOLDER [fps=10 cameras=4 tilt=8 seed=0 test=S5,S16 index=FILE]"
_EVERY_S = 5.0
_CREDIT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)


def make_cmu_files(words: list[str]) -> Iterator[str]:
    """Write ``train.npz`` and ``test.npz`` and yield a line on each step.

    Raises:
        UserError: an invalid setting or file, or an output that exists.
    """
    folder, keys = _settings(words)
    rates, rig = _rates(keys), _rig(keys)
    seed = int(_number(keys, "seed", 0.0, least=0.0, whole=True))
    unit_mm = _number(keys, "unit_mm", 0.0, above=0.0) if "unit_mm" in keys else None
    output = _output(keys)
    trials, notes = find_trials(folder, _listed(keys, "skip"))
    unknown = set(rates.own) - {trial.subject for trial in trials} - {trial.sequence for trial in trials}
    if unknown:
        raise UserError(f"rate={sorted(unknown)[0]}:...: no such subject or motion in {folder}.")
    index = _index(folder, keys)
    actions = read_index(index) if index else None
    yield f"{_people(trials)} in {folder}"
    yield from notes
    if index:
        yield f"actions from {index}"
    clips: list[Clip] = []
    yield from _read(trials, rates, unit_mm, clips)
    chosen, how = chosen_test(clips, _listed(keys, "test"), seed)
    yield how
    _make_folder(output)
    for name in ("train", "test"):
        part = [clip for clip in clips if (clip.sequence in chosen) == (name == "test")]
        yield _write(output / f"{name}.npz", part, rig, rates.fps, seed, actions)
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


def _write(path: Path, clips: list[Clip], rig: Rig, fps: float, seed: int, actions: dict[str, str] | None) -> str:
    from uplift.data.formats.npz import write_keypoints

    data = filmed(clips, rig, fps, seed, actions)
    write_keypoints(data, path)
    return f"wrote {path}: {len(data):,} rows ({_people(clips)}, {rig.cameras} camera{'s' * (rig.cameras > 1)})"


def _people(motions: Sequence[Trial] | Sequence[Clip]) -> str:
    subjects = len({motion.subject for motion in motions})
    return f"{len(motions):,} motion{'s' * (len(motions) > 1)} of {subjects:,} subject{'s' * (subjects > 1)}"


def _settings(words: list[str]) -> tuple[Path, dict[str, str]]:
    folders, keys = split_words(words, _KEYS)
    check_keys("data cmu", keys, _KEYS)
    if len(folders) != 1 or "output" not in keys:
        raise UserError(f"data cmu takes one DIR with .asf, .amc or .bvh files, and output=FOLDER. ({_USE})")
    return Path(folders[0]).expanduser(), keys


def _output(keys: dict[str, str]) -> Path:
    output = Path(keys["output"]).expanduser()
    if output.exists() and not output.is_dir():
        raise UserError(f"output={output} is a file, expected a folder to write train.npz and test.npz into.")
    for name in ("train.npz", "test.npz"):
        refuse_existing(output / name)
    if not output.exists():
        refuse_output(output)
    return output


def _make_folder(output: Path) -> None:
    try:
        output.mkdir(exist_ok=True)
    except OSError as error:
        raise UserError(f"output={output}: cannot be created ({error.strerror}).") from error


def _index(folder: Path, keys: dict[str, str]) -> Path | None:
    if "index" in keys:
        return Path(keys["index"]).expanduser()
    # The name under which cgspeed.com gives it.
    return next(iter(sorted(folder.rglob("cmu-mocap-index-text*.txt"))), None)


def _rig(keys: dict[str, str]) -> Rig:
    size = [part.strip() for part in keys.get("image_size", "1000x1000").replace(",", "x").split("x")]
    size = size * 2 if len(size) == 1 else size
    if len(size) != 2 or not all(part.isdigit() and 0 < int(part) <= 100_000 for part in size):
        raise UserError(f"data cmu: image_size={keys['image_size']!r}, expected width x height in px, as 1000x1000.")
    return Rig(
        cameras=int(_number(keys, "cameras", float(Rig.cameras), least=1.0, most=100.0, whole=True)),
        tilt_deg=_number(keys, "tilt", Rig.tilt_deg, least=-60.0, most=60.0),
        tilt_sd_deg=_number(keys, "tilt_sd", Rig.tilt_sd_deg, least=0.0, most=30.0),
        distance_m=_number(keys, "distance", Rig.distance_m, least=1.0, most=1000.0),
        focal_px=_number(keys, "focal_px", Rig.focal_px, above=0.0, most=1e6),
        image_size=(int(size[0]), int(size[1])),
    )


def _rates(keys: dict[str, str]) -> Rates:
    amc, own = Rates.amc, {}
    for part in _listed(keys, "rate"):
        name, colon, value = part.rpartition(":")
        rate = _number({"rate": value}, "rate", 0.0, above=0.0, most=10_000.0)
        if colon:
            own[name] = rate
        else:
            amc = rate
    return Rates(fps=_number(keys, "fps", Rates.fps, above=0.0, most=1000.0), amc=amc, own=own)


def _listed(keys: dict[str, str], key: str) -> list[str]:
    return [part.strip() for part in keys.get(key, "").split(",") if part.strip()]


def _number(
    keys: dict[str, str],
    key: str,
    default: float,
    *,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    whole: bool = False,
) -> float:
    if key not in keys:
        return default
    try:
        value = float(keys[key])
    except ValueError:
        value = math.nan
    if not (least <= value <= most and value > above) or not math.isfinite(value) or (whole and value != int(value)):
        limits = [f"at least {least:g}"] * (least > -math.inf) + [f"above {above:g}"] * (above > -math.inf)
        limits += [f"at most {most:g}"] * (most < math.inf)
        kind = "a whole number" if whole else "a number"
        raise UserError(f"data cmu: {key}={keys[key]!r}, expected {kind} {' and '.join(limits)}.".replace(" .", "."))
    return value
