"""One fit of a sweep: train it in its own run folder or go on with it, and score it on the 2D that all fits share."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from uplift.cli.failures import RUN_VARIABLE, clear_output, status_of
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.config.grid import Cell
from uplift.config.run import RunFolder
from uplift.config.trust import Consent, granted
from uplift.errors import UserError

if TYPE_CHECKING:
    from uplift.data.poses import PoseData

__all__ = ["OWN_FRAMES", "outcome_of", "run_cell", "run_cell_apart"]

OWN_FRAMES = ("skeleton", "lifter.radius", "data.layout", "data.flip_x", "data.flip_y", "data.rotate")
"""Settings that change what a keypoint or the unit of a score is: fits that differ in them have no score in common."""


def run_cell(sweep: Sweep, cell: Cell) -> Outcome | None:
    """Train one fit and write what became of it, an error too; None where it was interrupted, and can go on.

    What it says goes where everything else does.
    """
    from uplift.cli.fit import fit_settings
    from uplift.training.callbacks import Interrupted

    run, command = sweep.run_of(cell), sweep.command_of(cell)
    os.environ.pop(RUN_VARIABLE, None)  # of the fit before
    try:
        settings = sweep.settings_of(cell) if run is None else run.settings()
        run = fit_settings(settings, run, place=sweep.path / cell.name, command=command)
        outcome = outcome_of(sweep, cell, run)
    except (Interrupted, KeyboardInterrupt):
        return None
    except Exception as error:
        outcome = Outcome(error=_one_line(error, command))
    sweep.put_outcome(cell, outcome)
    return outcome


def outcome_of(sweep: Sweep, cell: Cell, run: RunFolder) -> Outcome:
    """Return what became of a fit that is finished, with its score."""
    facts = run.facts()
    scores, scored_on = _score(sweep, cell)
    return Outcome("", sum(facts["steps"].values()), sum(facts["seconds"].values()), scores, scored_on)


def run_cell_apart(folder: Path, name: str, consent: Consent) -> Outcome | None:
    """Do as `run_cell` in a process for it, whose output goes into the log of the fit."""
    sweep = Sweep.open(folder)
    cell = next(one for one in sweep.cells if one.name == name)
    log = open(sweep.log_of(cell), "a", encoding="utf-8", errors="backslashreplace")  # noqa: SIM115 (closed below)
    with log, _output_to(log), clear_output(), granted(consent):
        outcome = run_cell(sweep, cell)
        print(outcome.error if outcome else "interrupted", file=log)
        return outcome


@contextlib.contextmanager
def _output_to(log: TextIO) -> Iterator[None]:
    """Let all that this process prints go into a file, that of libraries in C too where there are such streams."""
    kept = []
    for number in (1, 2):
        with contextlib.suppress(OSError):
            kept.append((number, os.dup(number)))
            os.dup2(log.fileno(), number)
    try:
        with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
            yield
    finally:
        log.flush()
        for number, before in kept:
            os.dup2(before, number)
            os.close(before)


def _one_line(error: BaseException, command: str) -> str:
    """Return what the command line says of an error."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        status_of(error, shlex.split(command)[1:])
    return said.getvalue().strip().removeprefix("uplift: ").splitlines()[0]


# The score: of 2D alone, of the same frames for all.


def _score(sweep: Sweep, cell: Cell) -> tuple[dict[str, float], str]:
    """Return the score of a finished fit and what it was scored on; no score, and the reason, where there is none."""
    from uplift.metrics.score_2d import score_2d
    from uplift.models.model import Model, load

    own = any(axis.key in OWN_FRAMES for axis in sweep.axes)
    settings = sweep.settings_of(cell if own else sweep.cells[0])
    if settings.lifts != "keypoints":
        return {}, f"no score: there is none for {settings.lifts} without true shapes"
    model = load(sweep.path / cell.name)
    assert isinstance(model, Model)
    try:
        frames, about = _frames(sweep.path, cell.name if own else sweep.cells[0].name)
        return score_2d(model, frames, azimuth_deg=settings.views.azimuth_deg), about
    except UserError as error:
        return {}, f"no score: {error}"


@functools.lru_cache(maxsize=1)
def _frames(folder: Path, name: str) -> tuple[PoseData, str]:
    """Return the frames that fits are scored on, as the fit ``name`` reads them, and what they are in words.

    These are frames that no fit trains on, where there are any: those of ``data.val``, else the 2D of the test.
    """
    from uplift.data.module import KeypointData, share_or_files
    from uplift.data.stream import load_training
    from uplift.metrics.score_2d import LEAST_FRAMES
    from uplift.skeleton import load_skeleton

    sweep = Sweep.open(folder)
    settings = sweep.settings_of(next(cell for cell in sweep.cells if cell.name == name))
    skeleton = load_skeleton(settings.skeleton)
    loaded = load_training(settings, skeleton)
    data = KeypointData.of(loaded, skeleton, settings)
    val = (data.val_samples, "held-out frames of data.val")
    found = [val, (loaded.test, "test frames, their 2D alone"), (data.train_samples, "training frames")]
    # A share of the training frames is held out by seed: others of them are trained on by other fits.
    if isinstance(share_or_files(settings.data.val), float) and _varies_data(sweep):
        found = [found[1], (val[0], f"frames that {name} held out, which other fits have trained on"), found[2]]
    known = [(frames, about) for frames, about in found if frames is not None]
    frames, about = next((one for one in known if len(one[0]) >= LEAST_FRAMES), known[0])
    return frames.without_truth(), f"{len(frames):,} {about}"


def _varies_data(sweep: Sweep) -> bool:
    return any(axis.key == "seed" or axis.key.startswith("data.") for axis in sweep.axes)
