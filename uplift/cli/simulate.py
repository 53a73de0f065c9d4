"""The verb simulate: keypoints and exact poses of a simulated body, to rehearse a skeleton with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uplift.cli.parsing import Keys, keyed
from uplift.cli.verbs import VERBS
from uplift.config.files import building, refuse_output
from uplift.config.progress import progress, say
from uplift.data.poses import PoseData
from uplift.errors import UserError, nearest
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["simulate", "simulate_command", "simulate_shards"]

_ENDINGS = (".npz", ".csv")
_TRACKERS = ("deeplabcut",)
_MOST_FILES = 1000


def simulate(
    skeleton: str | Path | Skeleton,
    output: str | Path | None = None,
    *,
    frames: int = 20000,
    seed: int = 0,
    tracker: str | None = None,
    csv_safe: bool = False,
    written: list[Path] | None = None,
    **options: Any,
) -> PoseData:
    """Simulate ``frames`` frames of ``skeleton`` and write them to ``output`` (.npz or .csv), if given.

    An .npz has the exact poses too, a .csv the 2D alone. With ``tracker`` (``deeplabcut``) the .csv is what
    that tracker would have written: its layout, a file for each clip, a guess where a joint is missing.
    With ``csv_safe`` names that a spreadsheet would run as a formula begin with an apostrophe in a .csv.
    ``options`` are those of `uplift.data.synthetic.simulate`. The files written are added to ``written``.

    Raises:
        UserError: a skeleton without proportions, an output that exists or has another ending, no such tracker.
    """
    from uplift.data.synthetic.simulate import simulate as run

    if output is not None:
        output = _checked(Path(output), tracker)
    elif tracker is not None:
        raise UserError(f"tracker={tracker} is a layout of files: give output=FILE.csv.")
    if seed < 0:
        raise UserError(f"seed={seed}: expected a whole number of at least 0.")
    if frames < 1:
        raise UserError(f"frames={frames}: expected at least 1.")
    chosen = skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
    data = run(chosen, frames, seed=seed, **options)
    if output is not None:
        files = _write(data, output, tracker, seed, csv_safe)
        if written is not None:
            written += files
    return data


def simulate_shards(
    skeleton: str | Path | Skeleton, output: str | Path, *, frames: int, seed: int = 0, **options: Any
) -> int:
    """Simulate any number of frames part by part, write them with the exact poses as shards, and return how many these are.

    ``options`` are those of `uplift.data.synthetic.simulate`. The frames are others than `simulate` makes of the seed.

    Raises:
        UserError: a skeleton without proportions, an output that exists.
    """
    from uplift.data.formats.shards import write_shards
    from uplift.data.synthetic.simulate import simulate_parts

    output = Path(output)
    refuse_output(output)
    chosen = skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
    with building(output) as folder:
        parts = progress(simulate_parts(chosen, frames, seed, **options), "parts simulated")
        return len(write_shards(parts, folder)["shards"])


def simulate_command(words: Sequence[str]) -> None:
    """Simulate, write, and print what was done."""
    keys = keyed("simulate", words)
    given = keys.given("frames", "seed", "clip_seconds", "noise_px", "missing", "tracker", "csv_safe")
    if not Path(keys["output"]).suffix:
        _shards_command(keys, given)
        return
    written: list[Path] = []
    data = simulate(keys["skeleton"], keys["output"], written=written, **given)
    output = Path(keys["output"])
    several = len(written) > 1
    files = f"{len(written)} files, {written[0]} to {written[-1].name}" if several else output
    train = f"'{output.with_name(f'{output.stem}_*{output.suffix}')}'" if several else output
    say(f"simulated {len(data):,} frames of {keys['skeleton']}\nwrote {files}")
    say(f"next: uplift fit skeleton={keys['skeleton']} data.train={train}")


def _shards_command(keys: Keys, given: dict[str, Any]) -> None:
    for key in ("tracker", "csv_safe"):
        if given.pop(key, None):
            raise UserError(f"output={keys['output']} is a folder of shards; {key}= goes with output=FILE.csv.")
    frames = given.pop("frames", VERBS["simulate"].settings["frames"].default)
    shards = simulate_shards(keys["skeleton"], keys["output"], frames=frames, **given)
    count = f"{shards:,} shard{'s' * (shards > 1)}"
    say(f"simulated {frames:,} frames of {keys['skeleton']}\nwrote {keys['output']}: {count}")
    say(f"next: uplift fit skeleton={keys['skeleton']} data.train={keys['output']}")


def _checked(output: Path, tracker: str | None) -> Path:
    ending = output.suffix.lower()
    if ending not in _ENDINGS:
        raise UserError(
            f"output={output}: simulated data is written as {' or '.join(_ENDINGS)}, or as a folder of shards (no ending)."
        )
    if tracker is not None and tracker not in _TRACKERS:
        raise UserError(f"tracker={tracker}: expected {' or '.join(_TRACKERS)}.{nearest(tracker, _TRACKERS)}")
    if tracker is not None and ending != ".csv":
        raise UserError(f"output={output}: the files of tracker={tracker} are .csv.")
    refuse_output(output)
    return output


def _write(data: PoseData, output: Path, tracker: str | None, seed: int, csv_safe: bool) -> list[Path]:
    if tracker is not None:
        return _write_videos(data, output, seed, csv_safe)
    if output.suffix.lower() == ".csv":
        from uplift.data.formats.csv import write_keypoints_csv

        write_keypoints_csv(data.without_truth(), output, csv_safe=csv_safe)
    else:
        from uplift.data.formats.npz import write_keypoints

        write_keypoints(data, output)
    return [output]


def _write_videos(data: PoseData, output: Path, seed: int, csv_safe: bool) -> list[Path]:
    """Write a file for each clip, in DeepLabCut's layout."""
    from uplift.data.formats.deeplabcut import write_deeplabcut_csv
    from uplift.data.synthetic.simulate import as_tracked
    from uplift.export import paths_of

    clips = np.unique(data.identity["sequence"])
    if len(clips) > _MOST_FILES:
        raise UserError(
            f"{len(clips):,} clips, and this layout needs a file for each; the most is {_MOST_FILES}. Give fewer frames=, "
            "or longer clips, such as clip_seconds=30."
        )
    tracked = as_tracked(data, seed)
    paths = paths_of(output, [str(clip) for clip in clips])
    for clip, path in zip(clips, paths, strict=True):
        write_deeplabcut_csv(tracked.select(data.identity["sequence"] == clip), path, csv_safe=csv_safe)
    return paths
