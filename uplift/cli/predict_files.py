"""The verb predict on the command line: one output of everything, or with ``output=FOLDER/`` one of each input."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from uplift import __version__
from uplift.cli.failures import one_line, told
from uplift.cli.kinds import KINDS
from uplift.cli.live import LIVE, live_command
from uplift.cli.outputs import outputs_of
from uplift.cli.parsing import Keys, keyed
from uplift.cli.part_store import digest_of, stamps_of
from uplift.cli.predict import predict_keys
from uplift.config.device import device_of
from uplift.config.files import files_of, replacing
from uplift.config.lock import only_one
from uplift.config.progress import is_quiet, quiet, say
from uplift.config.run import Weights, read_weights
from uplift.config.trust import Consent, granted
from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.errors import UserError, listed
from uplift.export import writer_for

__all__ = ["predict_command"]


def predict_command(words: Sequence[str]) -> None:
    """Lift, write, and print what was done."""
    keys = keyed("predict", words)
    weights = read_weights(keys["run"])
    if keys["output"] == LIVE and weights.lifts == "keypoints":
        live_command(keys, weights)
    elif any(map(_is_folder, outputs_of(keys["output"]))):
        _predict_each(keys, weights)
    elif "workers" in keys:
        raise UserError("workers= goes with an output for each input: output=FOLDER/ or output='FOLDER/*.csv'.")
    else:
        say("\n".join(predict_keys(keys, weights).lines()))


# One output of each input. Which they are:

_USUAL = "*.npz"
_WRITTEN = {"keypoints": "poses", "masks": "shapes"}
_ITEMS = {"keypoints": "frames", "masks": "masks"}
_MANIFEST = "predict.json"
_MOST_NAMED = 3


@dataclass(frozen=True)
class _Job:
    """An input and what is made of it."""

    name: str
    """The input from the folder that all inputs are in."""
    input: str
    outputs: tuple[str, ...]
    keypoints: str | None
    stamp: tuple[int, int]
    """Its size and time of change; of a folder the sum and the latest of its files."""


def _is_folder(output: str) -> bool:
    """Return whether an output means one for each input."""
    return output.endswith(("/", os.sep)) or "*" in output or Path(output).is_dir()


def _patterns(keys: Keys, lifts: str) -> list[Path]:
    """Return the outputs with a ``*`` for the names of the inputs; raises UserError for others, before any work."""
    found = []
    for output in outputs_of(keys["output"]):
        if not _is_folder(output):
            raise UserError(
                f"output={keys['output']}: '{output}' is one file, the others are one for each input. Write "
                f"'FOLDER/*{Path(output).suffix}' for it, with the * for the name of the input."
            )
        path = Path(output) if "*" in output else Path(output) / _USUAL
        if path.name.count("*") != 1 or "*" in str(path.parent):
            raise UserError(f"output={output}: expected one * in the name of the file, for the name of the input.")
        writer_for(path.name.replace("*", "x"), keys.get("page") if path.suffix == ".html" else None, _WRITTEN[lifts])
        found.append(path)
    return found


def _jobs(keys: Keys, lifts: str) -> list[_Job]:
    """Return what is to be made of each input; raises UserError for inputs that are no files, or have one output."""
    patterns = _patterns(keys, lifts)
    if keys.get("together") == "true" and lifts == "keypoints":
        raise UserError("together=true makes one body of all inputs: it needs one output, not one for each.")
    kept = keys.get("keypoints")
    if kept is not None and Path(kept).name.count("*") != 1:
        raise UserError(f"keypoints={kept}: expected a * for the name of each input, as in keypoints='2d/*.npz'.")
    files = files_of(keys["input"])
    files = keypoint_files(files)[0] if lifts == "keypoints" else files
    base = _base_of(keys["input"])
    jobs: dict[tuple[str, ...], _Job] = {}
    for file in files:
        name = Path(os.path.relpath(file.absolute(), base))
        outputs = tuple(str(_output_of(pattern, name)) for pattern in patterns)
        keypoints = None if kept is None else str(_output_of(Path(kept), name))
        job = _Job(name.as_posix(), str(file), outputs, keypoints, _stamp(file))
        if outputs in jobs:
            raise UserError(
                f"{jobs[outputs].input} and {file} would both be written to {outputs[0]}: rename one of them."
            )
        jobs[outputs] = job
    return list(jobs.values())


def _base_of(input: str) -> str:
    """Return the folder that names are told from: what stands before the first ``*`` of a pattern, the folder of a file."""
    parts = [input] if Path(input).exists() else [part for part in input.split(",") if part]
    folders = []
    for part in map(Path, parts):
        plain = [one for one in (part, *part.parents) if not any(sign in str(one) for sign in "*?[")]
        folders.append(str((part.parent if part.exists() else plain[0]).absolute()))
    return os.path.commonpath(folders)


def _output_of(pattern: Path, name: Path) -> Path:
    return pattern.parent / name.parent / pattern.name.replace("*", name.stem)


def _stamp(file: Path) -> tuple[int, int]:
    stamps = list(stamps_of([file]).values())
    return sum(size for size, _ in stamps), max((changed for _, changed in stamps), default=0)


# What was done, in ``predict.json``.

_APART = ("run", "input", "output", "workers", "accelerator", "keypoints", "page")
"""Words that poses do not depend on, or that are told by themselves."""


class _Manifest:
    """What was made of which input, in the folder of the outputs; raises UserError where that was by other means."""

    def __init__(self, folder: Path, keys: Keys, weights: Weights):
        self.path = folder / _MANIFEST
        self._last, self._took = 0.0, 0.0
        self._facts = {
            "run": weights.run,
            "lifter": digest_of(weights.path),
            "version": __version__,
            "settings": {key: value for key, value in keys.items() if key not in _APART},
        }
        self.files: dict[str, dict[str, Any]] = {}
        if self.path.exists():
            self._read()

    def _read(self) -> None:
        try:
            before = json.loads(self.path.read_bytes())
            self.files = {entry["input"]: entry for entry in before["files"]}
            then = {name: before[name] for name in self._facts}
        except (ValueError, KeyError, TypeError):
            raise UserError(f"{self.path} is not what predict writes: remove it, or choose another folder.") from None
        for name, now in self._facts.items():
            if now != then[name] and name != "run":
                raise UserError(
                    f"{self.path.parent}: the poses in it were made with another value of '{name}': {_shown(then[name])} "
                    f"then, {_shown(now)} now. Choose another folder, or remove this one."
                )

    def missing(self, job: _Job) -> _Job | None:
        """Return what is left to do of a job, None where all is there; raises UserError where its input has changed since."""
        entry = self.files.get(job.name)
        if entry is None or entry["error"] is not None:
            return job
        folder = self.path.parent
        made = {
            asked: files for asked, files in entry["outputs"].items() if all((folder / one).exists() for one in files)
        }
        left = tuple(one for one in job.outputs if self._name(one) not in made)
        if left and len(left) == len(job.outputs):
            return job
        if tuple(entry["stamp"]) != job.stamp:
            raise UserError(
                f"{job.input} has changed since {folder / next(iter(made))} was made of it: remove that first."
            )
        return replace(job, outputs=left) if left else None

    def add(self, job: _Job, entry: dict[str, Any]) -> None:
        """Note what came of a job, and write it down unless that takes longer than the work."""
        before = self.files.get(job.name, {}).get("outputs", {})
        made = {self._name(one): [self._name(file) for file in files] for one, files in entry["outputs"].items()}
        self.files[job.name] = {"input": job.name, "stamp": job.stamp, **entry, "outputs": before | made}
        if time.monotonic() - self._last > 20 * self._took:
            self.write()

    def _name(self, path: str) -> str:
        return Path(os.path.relpath(path, self.path.parent)).as_posix()

    def write(self) -> None:
        """Write all that is known."""
        start = time.monotonic()
        files = [self.files[name] for name in sorted(self.files)]
        with replacing(self.path) as file:
            file.write(json.dumps({**self._facts, "files": files}, indent=1).encode())
        self._last = time.monotonic()
        self._took = self._last - start


def _shown(value: Any) -> str:
    """Return a fact of a command for a message."""
    words = [f"{key}={text}" for key, text in value.items()] if isinstance(value, dict) else [str(value)[:12]]
    return " ".join(words) or "the usual"


def _made_for(output: str, files: Sequence[Path]) -> list[str]:
    """Return those of the files that were written for an output: itself, or one for each clip, body or item."""
    path = Path(output)
    ending = "".join(path.suffixes)
    stem = path.name.removesuffix(ending) + "_"
    return [
        str(one)
        for one in files
        if one == path or (one.parent == path.parent and one.name.startswith(stem) and one.name.endswith(path.suffix))
    ]


# One after the other, or several at a time.


def _predict_each(keys: Keys, weights: Weights) -> None:
    """Lift each input into files of its own, and note in the manifest what came of it.

    Raises UserError at the end where inputs failed.
    """
    KINDS[weights.lifts].predict_arguments(keys)  # refuses wrong values before any work
    jobs = _jobs(keys, weights.lifts)
    folder = Path(jobs[0].outputs[0]).parent if len(jobs) == 1 else _patterns(keys, weights.lifts)[0].parent
    _make_folders([folder], [path for job in jobs for path in (*job.outputs, *filter(None, [job.keypoints]))])
    with only_one(folder / f".{_MANIFEST}.lock", str(folder)):
        manifest = _Manifest(folder, keys, weights)
        failed = _do(jobs, manifest, keys, weights)
        say(f"wrote {manifest.path}: {len(jobs) - len(failed):,} of {len(jobs):,} inputs are done")
    if failed:
        named = [f"{name}: {error}" for name, error in failed.items()]
        more = f"; and {len(named) - _MOST_NAMED:,} more" if len(named) > _MOST_NAMED else ""
        raise UserError(
            f"{len(failed):,} of {len(jobs):,} inputs failed ({manifest.path}): {'; '.join(named[:_MOST_NAMED])}{more}"
        )


def _make_folders(first: Sequence[Path], outputs: Sequence[str]) -> None:
    """Make the folders of outputs; the one that the first is in must be there."""
    for folder in first:
        if not folder.absolute().parent.is_dir():
            raise UserError(f"output={folder}: no folder {folder.absolute().parent}. Create it first.")
    for folder in {*first, *(Path(output).parent for output in outputs)}:
        folder.mkdir(parents=True, exist_ok=True)


def _do(jobs: list[_Job], manifest: _Manifest, keys: Keys, weights: Weights) -> dict[str, str]:
    """Do what is not done yet; return the inputs that failed, with why."""
    failed, todo = {}, []
    for job in jobs:
        try:
            todo += filter(None, [manifest.missing(job)])
        except UserError as error:
            failed[job.name] = str(error)
    if len(todo) + len(failed) < len(jobs):
        say(f"going on: {len(jobs) - len(todo) - len(failed):,} of {len(jobs):,} inputs were done before")
    done = 0
    try:
        for job, entry in _results(todo, keys, weights):
            manifest.add(job, entry)
            done += 1
            say("\n".join(_told(f"{done}/{len(todo)} {job.name}", entry, _ITEMS[weights.lifts])))
            if entry["error"] is not None:
                failed[job.name] = entry["error"]
    finally:
        manifest.write()
    return failed


def _told(which: str, entry: dict[str, Any], items: str) -> list[str]:
    """Return what is printed of an input."""
    if entry["error"] is not None:
        return [f"{which}: FAILED: {one_line(entry['error'])}"]
    warnings = [f"{which}: {note}" for note in entry["notes"] if "WARNING" in note]
    files = listed([file for made in entry["outputs"].values() for file in made], _MOST_NAMED)
    return [f"{which}: {entry['frames']:,} {items}, {entry['seconds']:.1f} s -> {files}", *warnings]


def _results(jobs: list[_Job], keys: Keys, weights: Weights) -> Iterator[tuple[_Job, dict[str, Any]]]:
    """Yield each job with what came of it, as they are done."""
    workers = min(keys.value("workers") or _usual_workers(keys.value("accelerator")), len(jobs))
    if workers < 2:
        yield from ((job, _lift(keys, job, weights)) for job in jobs)
        return
    with granted() as consent:
        start = (consent, is_quiet())
    context = multiprocessing.get_context("spawn")  # threads of torch do not survive a fork
    with ProcessPoolExecutor(workers, context, _begin, start) as pool:
        futures = {pool.submit(_lift, keys, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], _result(future)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


_WORKER_BYTES = 2e9
"""Memory of a worker at most, about."""


def _usual_workers(accelerator: str) -> int:
    """Return how many cores this process may use, or fewer where there is little memory; one where another device computes."""
    if device_of(accelerator).type != "cpu":
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return max(1, min(cores, int(memory // _WORKER_BYTES)))


_STACK = ExitStack()
"""Of what holds for as long as a worker lives."""


def _begin(consent: Consent, silent: bool) -> None:
    """Prepare a worker: one thread, as there is one worker for each core, and the user's consent."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a word; the command says what there is to say
    torch.set_num_threads(1)
    _STACK.enter_context(granted(consent))
    _STACK.enter_context(quiet())


def _lift(keys: Keys, job: _Job, weights: Weights | None = None) -> dict[str, Any]:
    """Lift one input and return what came of it, as plain data; no error goes further."""
    start = time.monotonic()
    words = {**keys, "input": job.input, **({} if job.keypoints is None else {"keypoints": job.keypoints})}
    entry: dict[str, Any] = {"outputs": {}, "frames": 0, "notes": [], "error": None}
    try:
        alone = Keys("predict", {key: value for key, value in words.items() if key != "workers"})
        done = predict_keys(alone, weights or read_weights(keys["run"]), job.outputs)
        made = {output: _made_for(output, list(done.files)) for output in job.outputs}
        entry |= {"outputs": made, "frames": done.frames, "notes": done.notes}
    except Exception as error:
        entry["error"] = told(error, [f"{key}={value}" for key, value in words.items()])[0]
    return {**entry, "seconds": round(time.monotonic() - start, 2)}


def _result(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except BrokenProcessPool:
        why = "its process was ended from outside, perhaps as memory ran out: workers=1 takes the least"
        return {"outputs": {}, "frames": 0, "notes": [], "error": why, "seconds": 0.0}
