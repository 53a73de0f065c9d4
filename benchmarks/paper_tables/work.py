"""Fit and evaluate a recipe, or take a run that is there, and keep what was found."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.machine import facts
from benchmarks.paper_tables.recipes import TABLES, Recipe, budget_of, place_of, table_of, uses_of
from uplift.config.files import replacing
from uplift.config.settings import Settings
from uplift.errors import UserError

if TYPE_CHECKING:
    from uplift.config.run import RunFolder

__all__ = ["fit_recipe", "need_data", "read_result", "take_run"]

_TRAIN_FRAMES = 60_000
"""Of training data, whole clips at random, that the 3DHP figure of the paper is computed on."""


def need_data(recipe: Recipe) -> None:
    """Look for the files of both splits; raises UserError that says what is missing and where it comes from."""
    from uplift.data.load import find_data, set_of

    settings = recipe.settings()
    for which in ("train", "test"):
        if set_of(settings, which) is None:
            find_data(settings, which)


def fit_recipe(recipe: Recipe) -> Path:
    """Fit the recipe into ./runs unless its result is kept, and return the file of the result.

    Raises:
        KeyboardInterrupt: Ctrl-C in the middle of training, too.
    """
    import uplift
    from uplift.training.callbacks import Interrupted

    place = place_of(recipe.table, recipe.settings())
    if place.is_file():
        print(f"kept {place.name}", flush=True)
        return place
    print(f"run {recipe.command}", flush=True)
    try:
        run = uplift.fit(recipe.task, *recipe.words, f"seed={recipe.seed}")
    except Interrupted:
        raise KeyboardInterrupt from None
    return _keep(run, recipe.table, recipe.command)


def take_run(path: str) -> tuple[str, Path]:
    """Return the table that a fitted run belongs to, and the file that its result is kept in.

    Raises:
        UserError: no such run, or one on other data.
    """
    from uplift.config.run import RunFolder

    run = RunFolder.open(path)
    table = table_of(run.settings(), str(path))
    told = str(run.facts().get("command", ""))
    return table, _keep(run, table, re.sub(r"(data\.root|init)=\S+", r"\1=FOLDER", told))


def _keep(run: RunFolder, table: str, command: str) -> Path:
    settings = run.settings()
    place = place_of(table, settings)
    evaluation = _evaluation(run, table)
    told = run.facts()
    result: dict[str, Any] = {
        "command": command,
        "seed": settings.seed,
        **facts(),
        "fitted_by": {"commit": ((told.get("git") or {}).get("commit") or "")[:7], "started": told.get("started")},
        "table": table,
        "task": settings.task,
        "budget": budget_of(settings),
        "uses": uses_of(settings),
        "fps": settings.data.options.get("fps"),
        "data": str(evaluation["data"]).replace(str(Path(settings.data.root or "").absolute()), "FOLDER"),
        **{key: evaluation[key] for key in ("unit", "frames", "overall", "per_action", "notes")},
    }
    if table == "3dhp":
        result["train"] = _on_training_data(run)
    place.parent.mkdir(parents=True, exist_ok=True)
    with replacing(place) as file:
        file.write((json.dumps(result, indent=1) + "\n").encode())
    return place


def _evaluation(run: RunFolder, table: str) -> dict[str, Any]:
    """Return what the run scored on the test split; evaluated anew where it was on other frames last."""
    import uplift

    title = {"h36m": "Human3.6M", "mpi_inf_3dhp": "MPI-INF-3DHP"}[TABLES[table].use]
    found = run.evaluation()
    if found is None or not str(found["data"]).startswith(f"{title} test "):
        found = uplift.evaluate(run.path).to_dict()
    if not found["per_action"]:
        raise UserError(f"{run.path}: its test frames have no actions: nothing to fill a table with.")
    return found


def _on_training_data(run: RunFolder) -> dict[str, Any]:
    """Return what the run scores on frames it was trained on, as the paper's figure is of such."""
    from uplift.cli.evaluate import evaluate_model
    from uplift.data.clean import clean
    from uplift.data.load import load_split
    from uplift.data.select import chosen_clips
    from uplift.models.model import load

    settings: Settings = run.settings()
    model = load(run.path)
    data = load_split(settings, "train", model.skeleton)
    if len(data) > _TRAIN_FRAMES:
        data = data.select(np.flatnonzero(chosen_clips(data.clips(), _TRAIN_FRAMES / len(data), 0)))
    data, _ = clean(data, model.skeleton)
    found = evaluate_model(model, data, "training frames")
    return {"frames": found.frames, "overall": found.overall}


def read_result(place: Path) -> dict[str, Any]:
    """Return a kept result.

    Raises:
        UserError: the file is damaged.
    """
    try:
        found = json.loads(place.read_text())
        return found | {"file": place.name} if isinstance(found["per_action"], dict) else {}
    except (ValueError, KeyError, TypeError):
        raise UserError(f"{place} is no whole result: delete it, and the same command makes it anew.") from None
