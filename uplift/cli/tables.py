"""The verb tables: Tables 1 and 2 and the 3DHP figure of Kudo et al. 2018, with the published rows and your own fits."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.cli.parsing import checked
from uplift.cli.verbs import VERBS
from uplift.config.files import replacing
from uplift.config.loading import load_settings
from uplift.config.progress import say
from uplift.config.settings import Settings, seconds_of
from uplift.errors import UserError, did_you_mean
from uplift.metrics.kudo2018 import TITLES, notes_of, sheets_of

if TYPE_CHECKING:
    from uplift.config.run import RunFolder

__all__ = ["tables_command"]

RESULTS = Path("runs") / "tables"
"""Where results are stored, in the current folder."""

_NOT_HASHED = ("task", "description", "seed")
_OF_THE_MACHINE = ("threads", "checkpoint_every", "checkpoint_steps", "log_every", "logger", "accelerator", "devices")
_TRAIN_FRAMES = 60_000
"""Training frames, complete clips at random, on which the 3DHP figure of the paper is computed."""


def tables_command(words: Sequence[str]) -> int:
    """Fit what was asked for, or use existing runs and results, and print the tables; 2 if data is missing.

    Raises UserError for an invalid word.
    """
    chosen, missing = _chosen(words), {}
    if chosen.show:
        shown = {table: sorted((RESULTS / table).glob("*.json")) for table in chosen.tables or TABLES}
    elif chosen.runs:
        shown = _taken(chosen)
    else:
        recipes = _recipes(chosen)
        missing = _missing(recipes)
        shown = _fitted([recipe for recipe in recipes if recipe.table not in missing])
    for table, places in shown.items():
        sheets = sheets_of(table, [read_result(place) for place in dict.fromkeys(places)])
        print("\n".join(sheet.markdown() if chosen.markdown else sheet.text() for sheet in sheets))
        print("\n" + "\n".join(f"- {note}" for note in notes_of(table)), flush=True)
        if places:
            print(f"\nresults: {RESULTS / table}/")
    for number, (table, error) in enumerate(missing.items()):  # the first message in full, one line of the others
        message = str(error) if not number else str(error).splitlines()[0]
        print(f"uplift: no {table}: {message}", file=sys.stderr)
    return 2 if missing else 0


@dataclass
class _Words:
    """The arguments of the command line, by kind."""

    tables: list[str] = field(default_factory=list)
    tasks: list[str] = field(default_factory=list)
    runs: list[str] = field(default_factory=list)
    more: list[str] = field(default_factory=list)
    """Settings of the fits."""
    seeds: Sequence[int] = (0, 1, 2)
    show: bool = False
    markdown: bool = False


def _chosen(words: Sequence[str]) -> _Words:
    found = _Words()
    for word in words:
        key, equals, value = word.partition("=")
        if word in TABLES:
            found.tables.append(word)
        elif not equals:
            raise UserError(
                f"tables: no table '{word}'.{did_you_mean(word, TABLES)} Expected any of {', '.join(TABLES)}."
            )
        elif key in ("task", "run"):
            (found.tasks if key == "task" else found.runs).extend(value.split(","))
        elif key in ("show", "markdown", "seeds"):
            setattr(found, key, _value(key, value))
        elif key == "seed":
            raise UserError("tables: seeds are set with seeds=0,1,2.")
        else:
            found.more.append(word)
    if found.runs and (found.tasks or found.more):
        raise UserError("tables: run=RUN uses a run as it is: leave out task= and settings, or fit again without run=.")
    return found


def _value(key: str, text: str) -> Any:
    return checked(VERBS["tables"].settings[key], text, "tables")


@dataclass(frozen=True)
class Table:
    """A table or figure of the paper: its data set, and the tasks fitted for it."""

    use: str
    tasks: tuple[str, ...]
    words: tuple[str, ...] = ()
    """Settings that move a task of another data set to this one."""
    keypoints: tuple[str, ...] = ()
    """Allowed `data.options.keypoints` of its runs."""


_H36M = (
    "data.name=h36m", "data.use=h36m", "data.train=train", "data.test=test", "data.options.fps=10",
)  # fmt: skip
_KUDO = ("kudo2018_code", "kudo2018_paper")
TABLES = {
    "table1": Table(
        "h36m", ("h36m", *_KUDO),
        (*_H36M, "data.options.keypoints=gt"), ("gt", "projected"),
    ),
    "table2": Table(
        "h36m", ("h36m_detected", *_KUDO),
        (*_H36M, "data.options.keypoints=detected"), ("detected", "sh", "sh_mpii", "cpn", "detectron"),
    ),
    "3dhp": Table(
        "mpi_inf_3dhp", ("mpi_inf_3dhp", *_KUDO),
        ("data.name=mpi_inf_3dhp", "data.use=mpi_inf_3dhp", "data.train=train", "data.test=test",
         "skeleton=mpi_inf_3dhp17", "priors.handedness.front=null", "priors.handedness.left=null"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """A task with further settings and a seed, for one table."""

    table: str
    task: str
    words: tuple[str, ...]
    seed: int

    @classmethod
    def of(cls, table: str, task: str, words: Sequence[str], seed: int) -> Recipe:
        """Return the recipe on the table's data; the user's settings ``words`` replace the table's."""
        chosen = load_settings(task).data
        moved = () if _is_of(chosen.use, chosen.options.get("keypoints"), TABLES[table]) else TABLES[table].words
        if chosen.use not in (None, TABLES[table].use):
            raise UserError(f"task {task} uses other data than {TITLES[table]}.")
        given = {word.partition("=")[0] for word in words}
        kept = (word for word in moved if word.partition("=")[0] not in given)
        return cls(table, task, (*kept, *words), seed)

    def settings(self) -> Settings:
        """Return the settings of the fit."""
        return load_settings(self.task, [*self.words, f"seed={self.seed}"])

    @property
    def command(self) -> str:
        """The command as a reader would type it, without this machine's folders."""
        words = [w if not w.startswith("data.root=") else "data.root=FOLDER" for w in self.words]
        return " ".join(["uplift fit", f"task={self.task}", *words, f"seed={self.seed}"])


def _is_of(use: str | None, keypoints: str | None, table: Table) -> bool:
    return use == table.use and (not table.keypoints or (keypoints or "gt") in table.keypoints)


def _taken(chosen: _Words) -> dict[str, list[Path]]:
    shown: dict[str, list[Path]] = {table: [] for table in chosen.tables}
    for run in chosen.runs:
        table, place = take_run(run)
        if chosen.tables and table not in chosen.tables:
            raise UserError(f"{run} belongs to {table}, not to {', '.join(chosen.tables)}.")
        shown.setdefault(table, []).append(place)
    return shown


def _recipes(chosen: _Words) -> list[Recipe]:
    return [
        Recipe.of(table, task, chosen.more, seed)
        for table in chosen.tables or TABLES
        for seed in chosen.seeds
        for task in chosen.tasks or TABLES[table].tasks
    ]


def _missing(recipes: Sequence[Recipe]) -> dict[str, UserError]:
    """Return the tables without data, with what is missing, before anything is trained."""
    found: dict[str, UserError] = {}
    for recipe in recipes:
        if recipe.table not in found and not place_of(recipe.table, recipe.settings()).is_file():
            try:
                need_data(recipe)
            except UserError as error:
                found[recipe.table] = error
    return found


def _fitted(recipes: Sequence[Recipe]) -> dict[str, list[Path]]:
    shown: dict[str, list[Path]] = {}
    for recipe in recipes:
        shown.setdefault(recipe.table, []).append(fit_recipe(recipe))
    return shown


def table_of(settings: Settings, where: str) -> str:
    """Return the table that a run of these settings belongs to.

    Raises:
        UserError: it was fitted on other data, or has other test frames.
    """
    data = settings.data
    for name, table in TABLES.items():
        if _is_of(data.use, data.options.get("keypoints"), table) and Path(data.test or "").name == "test":
            return name
    raise UserError(
        f"{where}: was fitted on {data.use or data.train or 'simulated frames'} and tested on {data.test}; the tables need "
        "Human3.6M or MPI-INF-3DHP, tested on the split 'test'."
    )


def _budget_of(settings: Settings) -> str:
    """Return the budget of a fit, for a row's name: ``10min``, ``20epochs``, ``6000steps``."""
    trainer = settings.trainer
    parts = []
    if trainer.max_time:
        parts.append(f"{seconds_of(trainer.max_time) / 60:.4g}min")
    if trainer.max_epochs:
        parts.append(f"{trainer.max_epochs:g}epochs")
    if trainer.max_steps:
        parts.append(f"{trainer.max_steps}steps")
    return "-".join(parts)


def uses_of(settings: Settings) -> str:
    """Return the training signal of a fit, in a few words."""
    lifter, labelled = settings.lifter, settings.data.labelled
    uses = ["2D"]
    if lifter.intrinsics != "off" and lifter.camera != "orthographic":
        uses.append("lenses")
    groups = [*(labelled.subjects or []), *(labelled.actions or [])]
    if groups or labelled.fraction is not None or labelled.file:
        share = "" if labelled.fraction is None else f"{100 * labelled.fraction:g} % of "
        what = ", ".join(map(str, groups)) or (Path(labelled.file).name if labelled.file else "the frames")
        uses.append(f"3D of {share}{what}{' only' if labelled.only else ''}")
    return ", ".join(uses)


def place_of(table: str, settings: Settings) -> Path:
    """Return the file of a result; fits that differ in any setting other than the machine's have different files."""
    plain = dataclasses.asdict(settings)
    for name in _NOT_HASHED:
        del plain[name]
    plain["data"] = {**plain["data"], **{key: Path(plain["data"][key] or "").name for key in ("train", "test")}}
    for name in ("root", "get", "name"):
        del plain["data"][name]
    for name in _OF_THE_MACHINE:
        del plain["trainer"][name]
    digest = hashlib.sha256(json.dumps(plain, sort_keys=True, default=str).encode()).hexdigest()[:8]
    return RESULTS / table / f"{settings.task or 'own'}_{_budget_of(settings)}_{digest}_seed{settings.seed}.json"


def need_data(recipe: Recipe) -> None:
    """Look for the files of both splits; raises UserError with what is missing and where to get it."""
    from uplift.data.load import find_data, set_of

    settings = recipe.settings()
    for which in ("train", "test"):
        if set_of(settings, which) is None:
            find_data(settings, which)


def fit_recipe(recipe: Recipe) -> Path:
    """Fit the recipe into ./runs unless its result is stored, and return the file of the result.

    Raises:
        KeyboardInterrupt: also for Ctrl-C during training.
    """
    import uplift
    from uplift.training.callbacks import Interrupted

    place = place_of(recipe.table, recipe.settings())
    if place.is_file():
        say(f"stored {place.name}")
        return place
    say(f"run {recipe.command}")
    try:
        run = uplift.fit(recipe.task, *recipe.words, f"seed={recipe.seed}")
    except Interrupted as stopped:
        again = f"uplift fit resume={stopped}, then uplift tables run={stopped}"
        print(f"\nstopped and saved: repeat the command, or {again}", file=sys.stderr)
        raise KeyboardInterrupt from stopped
    return _store(run, recipe.table, recipe.command)


def take_run(path: str) -> tuple[str, Path]:
    """Return the table that an existing run belongs to, and the file of its result.

    Raises:
        UserError: no such run, or one on other data.
    """
    from uplift.config.run import RunFolder

    run = RunFolder.open(path)
    table = table_of(run.settings(), str(path))
    command = str(run.facts().get("command", ""))
    return table, _store(run, table, re.sub(r"(data\.root|init)=\S+", r"\1=FOLDER", command))


def _store(run: RunFolder, table: str, command: str) -> Path:
    settings = run.settings()
    place = place_of(table, settings)
    evaluation = _evaluation(run, table)
    fitted = run.facts()
    result: dict[str, Any] = {
        "command": command,
        "seed": settings.seed,
        "fitted_by": {key: fitted.get(key) for key in ("started", "git", "versions", "python", "cores")},
        "table": table,
        "task": settings.task,
        "budget": _budget_of(settings),
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
    """Return the run's evaluation on the test split, evaluating again if the last was on other frames."""
    import uplift

    title = {"h36m": "Human3.6M", "mpi_inf_3dhp": "MPI-INF-3DHP"}[TABLES[table].use]
    found = run.evaluation()
    if found is None or not str(found["data"]).startswith(f"{title} test "):
        found = uplift.evaluate(run.path).to_dict()
    if not found["per_action"]:
        raise UserError(f"{run.path}: its test frames have no actions, which the tables need.")
    return found


def _on_training_data(run: RunFolder) -> dict[str, Any]:
    """Return the run's scores on training frames, on which the paper's figure was computed."""
    from uplift.data.clean import clean
    from uplift.data.load import load_split
    from uplift.data.select import chosen_clips
    from uplift.metrics.evaluate import evaluate_model
    from uplift.models.model import load_poses

    settings: Settings = run.settings()
    model = load_poses(run.path)
    data = load_split(settings, "train", model.skeleton)
    if len(data) > _TRAIN_FRAMES:
        data = data.select(np.flatnonzero(chosen_clips(data.clips(), _TRAIN_FRAMES / len(data), 0)))
    data, _ = clean(data, model.skeleton)
    found = evaluate_model(model, data, "training frames")
    return {"frames": found.frames, "overall": found.overall}


def read_result(place: Path) -> dict[str, Any]:
    """Return a stored result.

    Raises:
        UserError: the file is damaged.
    """
    try:
        found = json.loads(place.read_text())
        return found | {"file": place.name} if isinstance(found["per_action"], dict) else {}
    except (ValueError, KeyError, TypeError):
        raise UserError(f"{place} is not a valid result: delete it and repeat the command.") from None
