"""The folder a fit writes: resolved settings, what it ran on, weights, metrics, report."""

from __future__ import annotations

import datetime
import hashlib
import itertools
import json
import os
import platform
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any, NoReturn

from uplift.config.files import (
    Existing,
    absolute,
    building,
    clear_parts,
    data_root,
    holds_run,
    read_torch,
    refuse_special,
    replacing,
    shipped,
    shipped_names,
)
from uplift.config.loading import load_settings, save_settings, trust_of
from uplift.config.safe_weights import ENDING, read_safe
from uplift.config.settings import Settings
from uplift.errors import UserError, did_you_mean, nearest

__all__ = [
    "SWEEP", "USUAL_STEPS", "RunFolder", "Weights", "data_id", "idle_prior", "is_sweep", "lifter_label", "link", "new_name",
    "read_weights",
    "runs_of", "version_of",
]  # fmt: skip


USUAL_STEPS = 10_000
"""Steps of the default recipe in its ten minutes on one core."""
_SHORT = 0.1
"""Share of them below which results are expected to be poor."""


def idle_prior(name: str, steps: int) -> str:
    """Return the warning about a prior that had no gradient in any of so many steps."""
    why = "a satisfied hinge, or a loss that does not depend on what was lifted (.detach(), a comparison, times 0)?"
    return f"priors.{name} had no gradient in any of {steps:,} steps, so no effect: {why}"


_KINDS_OF_FACTS = {"task": str, "command": str, "versions": dict, "steps": dict, "idle_priors": dict, "init": dict}
"""Of what is used again; the rest is for readers."""


class RunFolder:
    """A run on disk. `create` makes a new one, `open` finds one that is there."""

    def __init__(self, path: Path):
        self.path = path
        self.config = path / "config.yaml"
        """The resolved settings."""
        self.checkpoints = path / "checkpoints"
        """Each stage's training state."""
        self.weights = path / "lifter.pt"
        """The trained lifter alone."""
        self.evaluations = path / "evaluations"
        """Every evaluation, by its name."""
        self.created = False
        """Whether this process made the folder."""

    @classmethod
    def create(cls, settings: Settings, command: str, place: Path | None = None) -> RunFolder:
        """Make ``runs/<task>/<time>/`` in the current folder, or the folder ``place``."""
        base = runs_of(settings.task, settings.skeleton) if place is None else place.parent
        stamp = new_name() if place is None else place.name
        if settings.data.train and not settings.data.root:
            # The run finds its data again from any folder, whatever UPLIFT_DATA is then.
            root = str(data_root(settings.data.name, None).absolute())
            settings = replace(settings, data=replace(settings.data, root=root))
        clear_parts(base)
        for attempt in itertools.count(1):
            path = base / (stamp if attempt == 1 else f"{stamp}_{attempt}")
            with suppress(Existing), building(path) as made:
                run = cls(made)
                save_settings(settings, run.config)
                with replacing(made / "run.json") as file:
                    file.write(json.dumps(_facts(settings, command), indent=2).encode())
                run.checkpoints.mkdir()
                break
        run = cls(path)
        run.created = True
        return run

    def link_last(self) -> None:
        """Point the task's ``last`` to this run, which can now be resumed; what else has that name is left alone."""
        if not is_sweep(self.path.parent):  # a sweep has many, and says which is its task's last
            link(self.path.with_name("last"), self.path.name)

    def discard_if_empty(self) -> None:
        """Remove a run that this process made, and that ended before anything else came into its folder."""
        ours = [self.config, self.path / "run.json", self.path / "metrics.csv"]
        if not self.created or not set(self.path.iterdir()) <= {*ours, self.checkpoints}:
            return
        with suppress(OSError):  # a folder that is not empty stays
            self.checkpoints.rmdir()
            for path in ours:
                path.unlink(missing_ok=True)
            self.path.rmdir()

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """Return the run in ``path``, or that of a task's ``last``.

        Raises UserError: there is no such run; the message names the nearest.
        """
        path = Path(path)
        run = cls(path.resolve() if path.exists() else path)
        if run.config.is_file():
            return run
        if (path / "last" / "config.yaml").is_file():
            return cls((path / "last").resolve())
        if is_sweep(path):
            raise UserError(
                f"{path} is a sweep, expected one of its runs: run={path}/best, or one of the folders in it."
            )
        if path.exists():
            raise UserError(f"{path} is not a run: it has no config.yaml. `uplift fit` writes runs/<task>/<time>.")
        if str(path) in shipped_names("lifters"):
            raise UserError(f"{path} is a ready lifter, expected the folder of a run: one that `uplift fit` made.")
        none = " There are no runs here yet: `uplift fit task=demo`."
        raise UserError(f"No run {path}.{did_you_mean(str(path), _runs_here()) or none}")

    def settings(self, *changed: str) -> Settings:
        """Return the settings the run was made with, but those in the words ``changed``."""
        settings = load_settings(str(self.config), changed)
        settings.task = self.facts().get("task", "")
        return settings

    def trust_to_lift(self) -> str:
        """Return the words by which the user consents to code that lifting with the run needs; empty where it needs none."""
        return trust_of(self.settings(), "lifter.", "student.network", "data.")

    def facts(self) -> dict[str, Any]:
        """Return run.json: command, versions, seed, git state, machine."""
        try:
            found = _mapping(self.path / "run.json")
        except OSError as error:
            raise UserError(f"{self.path / 'run.json'} cannot be read: {error.strerror}.") from error
        for key, kind in _KINDS_OF_FACTS.items():
            if not isinstance(found.get(key, kind()), kind):
                what = "text" if kind is str else "a value for each name"
                raise UserError(f"{self.path / 'run.json'} is not what a fit writes: '{key}' is not {what}.")
        for key in ("steps", "idle_priors"):
            if not all(type(count) is int for count in found.get(key, {}).values()):
                raise UserError(f"{self.path / 'run.json'}: '{key}' are {found[key]!r:.80}, expected whole numbers.")
        return found

    def add_facts(self, **more: Any) -> None:
        """Add to run.json."""
        with replacing(self.path / "run.json") as file:
            file.write(json.dumps(self.facts() | more, indent=2).encode())

    def warnings(self) -> list[str]:
        """Return what casts doubt on the fit: few steps beside a usual one, priors without effect; nothing if not known."""
        facts = self.facts() if (self.path / "run.json").is_file() else {}
        steps, lines = sum(facts.get("steps", {}).values()), []
        if 0 < steps < _SHORT * USUAL_STEPS:
            share = f"{steps:,} steps, {100 * steps / USUAL_STEPS:.2g} % of the {USUAL_STEPS:,} of a usual fit"
            hint = "Expect poor results; train longer (trainer.max_time, trainer.max_steps)."
            lines.append(f"WARNING: a short fit: {share}. {hint}")
        return lines + [f"WARNING: {idle_prior(name, steps)}" for name, steps in facts.get("idle_priors", {}).items()]

    def evaluation(self, name: str | None = None) -> dict[str, Any] | None:
        """Return evaluation.json, None where the run was not evaluated; with a ``name`` that of ``evaluations/``.

        Raises UserError: no evaluation of that name, or a file that is none.
        """
        path = (
            self.path / "evaluation.json" if name is None else self.evaluations / f"{name.removesuffix('.json')}.json"
        )
        if not path.is_file():
            if name is None:
                return None
            known = sorted(one.stem for one in self.evaluations.glob("*.json"))
            raise UserError(
                f"evaluation={name}: {self.path} has no evaluation of this name.{did_you_mean(name, known)}"
            )
        found = _mapping(path)
        overall = found.get("overall")
        figures = isinstance(overall, dict) and all(type(value) in (int, float) for value in overall.values())
        if not figures or not isinstance(found.get("data"), str):
            again = "`uplift evaluate run=...` writes it again."
            raise UserError(f"{path} is not an evaluation: no 'data' and no figures in 'overall'. {again}")
        return found


SWEEP = "sweep.yaml"
"""The file that makes a folder of runs a sweep."""


def is_sweep(path: str | Path) -> bool:
    """Return whether a path is the folder of a sweep."""
    return (Path(path) / SWEEP).is_file()


def runs_of(task: str, skeleton: str) -> Path:
    """Return the folder ``runs/<task>`` in the current folder, made if needed."""
    base = Path("runs") / (task or Path(skeleton).stem or "own")
    try:
        base.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise UserError(f"Cannot make the folder {base.absolute()}: something else is in its place.") from error
    return base


def new_name() -> str:
    """Return the name of a run that starts now."""
    return datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def link(name: Path, target: str) -> None:
    """Make ``name`` point to ``target`` beside it; what else has that name is left alone."""
    if name.exists() and not name.is_symlink():
        return
    temporary = name.with_name(f".{name.name}.{os.getpid()}")
    try:
        temporary.symlink_to(target, target_is_directory=True)
        os.replace(temporary, name)
    except OSError:  # a file system without links, where `run=.../last` cannot work
        temporary.unlink(missing_ok=True)


def lifter_label(init: str) -> str:
    """Return a lifter's name for readers, without the folders that it lies in: of a run its task and its time."""
    path = Path(init)
    run = path.parent if path.name == "lifter.pt" else path
    return "/".join(run.parts[-2:]) if (run / "config.yaml").is_file() else path.name


def data_id(name: str) -> str:
    """Return what tells test data apart in evaluation.json, where files have names without folders: a hash of the full path."""
    name = absolute(name) if Path(name.partition(",")[0]).expanduser().exists() else name
    return hashlib.sha256(name.encode(errors="replace")).hexdigest()[:12]


def _mapping(path: Path) -> dict[str, Any]:
    refuse_special(path)
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:  # not JSON, not text, or nested without end
        raise UserError(f"{path} is not a complete JSON file: {error}.") from error
    if not isinstance(found, dict):
        raise UserError(f"{path} holds {type(found).__name__}, expected what a fit or an evaluation writes.")
    return found


def _facts(settings: Settings, command: str) -> dict[str, Any]:
    packages = ("uplift3d", "torch", "lightning", "numpy", "scikit-image", "trimesh", "omegaconf")
    return {
        "task": settings.task,
        "command": command,
        "seed": settings.seed,
        "started": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": {name: version_of(name) for name in packages},
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "git": _git(),
    }


def version_of(name: str) -> str | None:
    """Return the version of an installed package; None where it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _git() -> dict[str, Any] | None:
    """Return the commit that the package runs from and whether it was changed; None outside git."""
    git = ["git", "-C", str(Path(__file__).resolve().parent)]

    def ask(*words: str) -> str:
        done = subprocess.run([*git, *words], capture_output=True, text=True, check=True, timeout=10)
        return done.stdout.strip()

    try:
        return {"commit": ask("rev-parse", "HEAD"), "changed": bool(ask("status", "--porcelain", "-uno"))}
    except (OSError, subprocess.SubprocessError):
        return None


@dataclass(frozen=True)
class Weights:
    """A trained lifter's file that has been read."""

    run: str
    """The run or file as it was named, for messages."""
    path: Path
    state: dict[str, Any]
    ready: bool = False
    """Whether it is a ready lifter of this package."""
    note: str = ""
    """Which lifter it is, where the name alone does not say so."""

    @property
    def lifts(self) -> str:
        """What the lifter takes: "keypoints" or "masks"."""
        return "masks" if self.state.get("lifts") == "masks" else "keypoints"

    @property
    def folder(self) -> RunFolder | None:
        """The run that the file lies in; None where only the file is there."""
        folder = RunFolder(self.path.parent)
        return folder if folder.config.is_file() else None

    def settings(self) -> Settings | None:
        """Return the settings that the weights were trained with; None where only the file is there."""
        return None if self.folder is None else self.folder.settings()


def read_weights(run: str | Path) -> Weights:
    """Read a lifter: of a run (its folder, or runs/<task>/last), a ``lifter.pt`` or ``.safetensors`` file, or a ready one by its name.

    A run in a folder of that name comes before the ready lifter.

    Raises UserError: no such run or lifter, a run that has no weights yet, or a file that cannot be read.
    """
    path, note = Path(run), ""
    folder = RunFolder.open(path) if holds_run(path) else None
    named = not path.is_file() and str(run) in shipped_names("lifters")
    ready = named and folder is None
    if ready:
        path, note = shipped("lifters") / f"{run}{ENDING}", f"lifter: {run}, ready-made (uplift lifters {run})"
    elif not path.is_file():
        note = f"lifter: the run in the folder {run}, not the ready one of that name" if named else ""
        path = _weights_of(folder or _unknown(run))
    read = read_safe if path.suffix.lower() == ENDING else read_torch
    return Weights(str(run), path, read(path, "lifter"), ready, note)


def _weights_of(folder: RunFolder) -> Path:
    if not folder.weights.is_file():
        raise UserError(
            f"{folder.path} has no lifter.pt yet: its fit was ended early. "
            f"`uplift fit resume={folder.path}{trust_of(folder.settings())}` finishes it."
        )
    return folder.weights


def _unknown(run: str | Path) -> NoReturn:
    """Refuse a name that is neither a run nor a lifter's."""
    path, ready = Path(run), shipped_names("lifters")
    if path.suffix.lower() in (ENDING, ".pt"):
        raise UserError(f"No lifter {path} (looked in {path.absolute().parent}).")
    if path.exists() or nearest(str(run), _runs_here()) or not ready:
        RunFolder.open(path)
    raise UserError(f"No run {run}, and no ready lifter of that name.{did_you_mean(str(run), ready)} (uplift lifters)")


def _runs_here() -> list[str]:
    found = itertools.chain(Path("runs").glob("*/*"), Path("runs").glob("*/sweep_*/*"))
    return [str(path) for path in found if (path / "config.yaml").is_file()]
