"""What each table fits, and where the result of one fit is kept."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import ROOT
from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.errors import UserError

__all__ = ["RESULTS", "TABLES", "Recipe", "Table", "budget_of", "place_of", "table_of", "uses_of"]

RESULTS = ROOT / "benchmarks" / "results" / "paper_tables"

_BY_CHANCE = ("task", "description", "seed")
_NO_MATTER = ("threads", "checkpoint_every", "checkpoint_steps", "log_every", "logger", "accelerator", "devices")


@dataclass(frozen=True)
class Table:
    """A table or figure of the paper: its data set and the tasks that are fitted for it."""

    title: str
    use: str
    tasks: tuple[str, ...]
    words: tuple[str, ...] = ()
    """What brings a task of another set's to this one."""
    keypoints: tuple[str, ...] = ()
    """`data.options.keypoints` of its runs."""


_H36M = (
    "data.name=h36m", "data.use=h36m", "data.train=train", "data.test=test", "data.options.fps=10",
)  # fmt: skip
_KUDO = ("kudo2018_code", "kudo2018_paper")
TABLES = {
    "table1": Table(
        "Table 1: Human3.6M, ground-truth 2D", "h36m", ("h36m", *_KUDO),
        (*_H36M, "data.options.keypoints=gt"), ("gt", "projected"),
    ),
    "table2": Table(
        "Table 2: Human3.6M, detected 2D", "h36m", ("h36m_detected", *_KUDO),
        (*_H36M, "data.options.keypoints=detected"), ("detected", "sh", "sh_mpii", "cpn", "detectron"),
    ),
    "3dhp": Table("MPI-INF-3DHP", "mpi_inf_3dhp", ("mpi_inf_3dhp",)),
}  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """A task with further words and a seed, for one table."""

    table: str
    task: str
    words: tuple[str, ...]
    seed: int

    @classmethod
    def of(cls, table: str, task: str, words: Sequence[str], seed: int) -> Recipe:
        """Return the recipe on the table's data; ``words`` are the user's and replace those of the table."""
        chosen = load_settings(task).data
        moved = () if _is_of(chosen.use, chosen.options.get("keypoints"), TABLES[table]) else TABLES[table].words
        if chosen.use != TABLES[table].use and not moved:
            raise UserError(f"task {task} is on other data than {TABLES[table].title}.")
        given = {word.partition("=")[0] for word in words}
        return cls(table, task, (*(word for word in moved if word.partition("=")[0] not in given), *words), seed)

    def settings(self) -> Settings:
        """Return the settings of the fit."""
        return load_settings(self.task, [*self.words, f"seed={self.seed}"])

    @property
    def command(self) -> str:
        """As a reader types it, without this machine's folders."""
        words = [w if not w.startswith("data.root=") else "data.root=FOLDER" for w in self.words]
        return " ".join(["uplift fit", f"task={self.task}", *words, f"seed={self.seed}"])


def _is_of(use: str | None, keypoints: str | None, table: Table) -> bool:
    return use == table.use and (not table.keypoints or (keypoints or "gt") in table.keypoints)


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
        f"{where}: was fitted on {data.use or data.train or 'simulated frames'}, tested on {data.test}: the tables are of "
        "Human3.6M and MPI-INF-3DHP, tested on their split 'test'."
    )


def budget_of(settings: Settings) -> str:
    """Return how long a fit takes, for a row's name: ``10min``, ``20epochs``, ``6000steps``."""
    trainer = settings.trainer
    parts = []
    if trainer.max_time:
        hours, minutes, seconds = (float(part) for part in str(trainer.max_time).split(":"))
        parts.append(f"{60 * hours + minutes + seconds / 60:.4g}min")
    if trainer.max_epochs:
        parts.append(f"{trainer.max_epochs:g}epochs")
    if trainer.max_steps:
        parts.append(f"{trainer.max_steps}steps")
    return "-".join(parts)


def uses_of(settings: Settings) -> str:
    """Return what the fit learns from, in a few words."""
    lifter, labelled = settings.lifter, settings.data.labelled
    uses = ["2D"]
    if lifter.intrinsics != "off" and lifter.camera != "orthographic":
        uses.append("lenses")
    of = [*(labelled.subjects or []), *(labelled.actions or [])]
    if of or labelled.fraction is not None or labelled.file:
        share = "" if labelled.fraction is None else f"{100 * labelled.fraction:g} % of "
        what = ", ".join(map(str, of)) or (Path(labelled.file).name if labelled.file else "the frames")
        uses.append(f"3D of {share}{what}{' alone' if labelled.only else ''}")
    return ", ".join(uses)


def place_of(table: str, settings: Settings) -> Path:
    """Return the file of a result; fits that differ in anything but the machine have other files."""
    plain = dataclasses.asdict(settings)
    for name in _BY_CHANCE:
        del plain[name]
    plain["data"] = {**plain["data"], **{key: Path(plain["data"][key] or "").name for key in ("train", "test")}}
    for name in ("root", "get", "name"):
        del plain["data"][name]
    for name in _NO_MATTER:
        del plain["trainer"][name]
    mark = hashlib.sha256(json.dumps(plain, sort_keys=True, default=str).encode()).hexdigest()[:8]
    return RESULTS / table / f"{settings.task or 'own'}_{budget_of(settings)}_{mark}_seed{settings.seed}.json"
