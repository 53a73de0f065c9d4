"""The fits of lifters of masks: what is fitted on which masks, and its stored result."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, BenchmarkError, data_folder, facts, max_time, store
from uplift.config.loading import load_settings
from uplift.data.concat import concat_masks
from uplift.data.formats.masks_npz import write_masks_npz
from uplift.data.load_masks import views_of
from uplift.data.masks import MaskData
from uplift.data.parsers.meshes import MeshOptions, read_meshes
from uplift.data.synthetic.masks import simulate_masks
from uplift.errors import UserError

__all__ = [
    "COMMANDS",
    "FAMILIES",
    "HELD_OUT",
    "MODELNET",
    "PARTS",
    "RESULTS",
    "TASK",
    "Cell",
    "Sizes",
    "animal_masks",
    "ceiling_key",
    "cells_of",
    "modelnet_masks",
    "run_cell",
]

RESULTS = ROOT / "benchmarks" / "results" / "shapes.json"
TASK = "masks_demo"
FAMILIES = ("chairs", "sofas", "cars", "animals")
MODELNET = ("chair", "sofa")
COMMANDS = ("demo", "families", "twin", "semi", "animals", "modelnet")
"""The commands that fit; `cost` measures steps, `ceiling` trains the supervised network."""


_FULL = ("data.simulate=4000", "trainer.max_steps=2200")
"""What the figures of families are of; the demo is shorter."""
LABELLED = (0.02, 0.1)
"""Shares of the shapes that are known; each also without the other masks."""
HELD_OUT = ("Cow", "ShibaInu")
"""Species of the test, as in the keypoints of `quadruped`."""
PARTS = ("items", "overall", "floors", "per_category", "notes")
_SIMULATED_SEED, _TRAIN_SEED, _TEST_SEED = 0, 1, 2


@dataclass(frozen=True)
class Cell:
    """One fit: a task with further settings."""

    name: str
    """The row it belongs to; all seeds share a row."""
    seed: int
    task: str = TASK
    words: tuple[str, ...] = ()
    minutes: float | None = None
    """Training time; None: the task's."""
    animals: bool = False
    """Whether it is trained on `animal_masks`."""
    modelnet: str = ""
    """The category of `modelnet_masks` that it is trained on."""

    @property
    def spent(self) -> str:
        """The training time, as shown in tables."""
        return "task's" if self.minutes is None else f"{self.minutes:g}min"

    @property
    def key(self) -> str:
        """The key of the result."""
        budget = "" if self.minutes is None else f"_{self.spent}"
        return f"{self.name}{budget}_seed{self.seed}"

    @property
    def overrides(self) -> list[str]:
        """The settings of `uplift fit` after the task."""
        words = [*self.words, f"seed={self.seed}"]
        if self.minutes is not None:
            words.append(max_time(self.minutes))
        return words


def ceiling_key(family: str, seconds: float, seed: int) -> str:
    """Return the key of the stored result."""
    return f"ceiling_{family}_{seconds:g}s_seed{seed}"


def cells_of(
    command: str,
    seeds: Sequence[int],
    minutes: float | None = None,
    families: Sequence[str] = FAMILIES,
    shares: Sequence[float] = LABELLED,
) -> list[Cell]:
    """Return the fits of a command, seed by seed, so that every row has results early."""
    rows = {
        "demo": [("demo", TASK, ())],
        "families": [(f"family_{family}", TASK, (f"data.family={family}", *_FULL)) for family in families],
        "twin": [("twin", TASK, ("data.labelled.fraction=1", "data.labelled.only=true", *_FULL))],
        "semi": [
            (f"semi_{100 * share:g}%{only}", "masks_semi", (f"data.labelled.fraction={share}", *words, *_FULL))
            for share in shares
            for only, words in (("", ()), ("_only", ("data.labelled.only=true",)))
        ],
        "animals": [("animals", "masks_animals", ())],
        "modelnet": [(f"modelnet_{category}", TASK, ()) for category in MODELNET],
    }[command]
    return [
        Cell(
            name,
            seed,
            task,
            words,
            minutes,
            command == "animals",
            name.removeprefix("modelnet_") if command == "modelnet" else "",
        )
        for seed in seeds
        for name, task, words in rows
    ]


def run_cell(cell: Cell, runs: Path | None = None, folder: Path | None = None) -> dict[str, Any]:
    """Fit, evaluate, store the result and return it; the run is kept in ``runs``, if given. ``folder``: ModelNet10's.

    Raises:
        BenchmarkError: the fit failed, or nothing was evaluated.
    """
    words = [*_data_words(cell, folder), *cell.overrides]
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as empty, contextlib.chdir(runs or empty):
        evaluation = _evaluation(cell.task, words)
    result = {
        "command": " ".join(["uplift fit", f"task={cell.task}", *words]).replace(
            str(_cache_folder().absolute()), "$UPLIFT_BENCHMARK_CACHE/shapes"
        ),
        "benchmark": f"python -m benchmarks.shapes {cell.name.partition('_')[0].replace('family', 'families')}",
        "seed": cell.seed,
        "minutes": cell.minutes,
        **facts(),
        "wall_seconds": round(time.monotonic() - start, 1),
        **{part: evaluation[part] for part in PARTS if part in evaluation},
    }
    store(RESULTS, cell.key, result)
    return result


def _data_words(cell: Cell, folder: Path | None) -> list[str]:
    """Return the settings of the cell's mask files, if they differ from the task's."""
    if not cell.animals and not cell.modelnet:
        return []
    files = modelnet_masks(cell.modelnet, folder) if cell.modelnet else animal_masks()
    return ["data.simulate=0", f"data.train={files['train'].absolute()}", f"data.test={files['test'].absolute()}"]


def _evaluation(task: str, words: list[str]) -> dict[str, Any]:
    """Fit in the current folder and return the content of evaluation.json."""
    from uplift.cli import fit

    try:
        evaluation = fit.fit_settings(load_settings(task, words)).evaluation()
    except UserError as error:
        raise BenchmarkError(f"uplift fit task={task} {' '.join(words)}: {error}") from error
    if evaluation is None:
        raise BenchmarkError(f"uplift fit task={task} {' '.join(words)}: nothing was evaluated")
    return evaluation


# Masks of animals: simulated and animated ones for training, two other species for the test. Some simulated animals
# have roughly the proportions of a cow or a dog: no mesh of the held-out species is in the training, but similar
# shapes are.


@dataclass(frozen=True)
class Sizes:
    """Numbers of masks."""

    simulated: int = 3000
    poses: int = 50
    """Per training species."""
    views: int = 5
    """Per pose."""
    test_poses: int = 50
    """Per held-out species, one view each."""


def _cache_folder() -> Path:
    """Return the folder of rendered masks, in UPLIFT_BENCHMARK_CACHE or ~/.cache/uplift."""
    return Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift").expanduser() / "shapes"


def animal_masks(folder: Path | None = None, sizes: Sizes | None = None) -> dict[str, Path]:
    """Return the files of the ``train`` and ``test`` masks; those missing in ``folder`` are rendered.

    Raises:
        BenchmarkError: UPLIFT_DATA has no folder animal_meshes, or it lacks a species of the test.
    """
    folder, sizes = folder or _cache_folder(), sizes or Sizes()
    known, other = _files()
    seen = f"{sizes.simulated}_{len(known)}x{sizes.poses}x{sizes.views}"
    found = {
        "train": folder / f"animals_train_{seen}.npz",
        "test": folder / f"animals_test_{len(other)}x{sizes.test_poses}.npz",
    }
    folder.mkdir(parents=True, exist_ok=True)
    if not found["train"].is_file():
        simulated = simulate_masks("animals", sizes.simulated, seed=_SIMULATED_SEED)
        both = [simulated, _posed_animals(known, sizes.poses, sizes.views, _TRAIN_SEED)]
        write_masks_npz(concat_masks(both), found["train"])
    if not found["test"].is_file():
        write_masks_npz(_posed_animals(other, sizes.test_poses, 1, _TEST_SEED), found["test"])
    return found


def _posed_animals(files: list[Path], poses: int, views: int, seed: int) -> MaskData:
    """Return masks of animals in poses of their animations, except for those of dying, ``views`` of each."""
    options = MeshOptions(poses=poses, animations=("-Death",), seed=seed)
    meshes = [mesh.in_unit() for mesh in read_meshes([str(file) for file in files], options)]
    return simulate_masks(meshes, len(meshes) * views, seed=seed, views_per_shape=views)


# Masks of ModelNet10, which its user has downloaded (docs/masks-data.md), in its own split.

_VIEWS = 4
"""Per training shape; each test shape is seen once."""
_UP = MeshOptions(up="z")


def modelnet_masks(category: str, folder: Path | None, cache: Path | None = None) -> dict[str, Path]:
    """Return the files of the ``train`` and ``test`` masks of a category; those missing in ``cache`` are rendered.

    Raises:
        BenchmarkError: no folder with this category.
    """
    if folder is None or not (folder / category / "train").is_dir():
        where = "not given" if folder is None else f"{folder} has no {category}/train"
        raise BenchmarkError(f"ModelNet10: {where}. Download it (docs/masks-data.md) and give its --folder.")
    cache = cache or _cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    views = views_of(load_settings(TASK, []))
    found = {part: cache / f"modelnet_{category}_{part}.npz" for part in ("train", "test")}
    for (part, path), count, seed in zip(found.items(), (_VIEWS, 1), (_TRAIN_SEED, _TEST_SEED), strict=True):
        if not path.is_file():
            meshes = [mesh.in_unit() for mesh in read_meshes(folder / category / part, _UP)]
            masks = simulate_masks(meshes, len(meshes) * count, seed=seed, views=views, views_per_shape=count)
            write_masks_npz(masks, path)
    return found


def _files() -> tuple[list[Path], list[Path]]:
    """Return the files of the training species, and of those held out."""
    files = sorted((data_folder() / "animal_meshes").glob("*.glb"))
    names = {file.stem for file in files}
    missing = [name for name in HELD_OUT if name not in names]
    if missing or len(files) == len(HELD_OUT):
        raise BenchmarkError(
            f"UPLIFT_DATA has {', '.join(sorted(names)) or 'nothing'} in animal_meshes, expected .glb files of "
            f"{', '.join(HELD_OUT)} and of other species"
        )
    return [file for file in files if file.stem not in HELD_OUT], [file for file in files if file.stem in HELD_OUT]
