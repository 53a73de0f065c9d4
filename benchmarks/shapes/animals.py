"""Masks of animals with species held out: made-up animals and animated ones to train on, two other species to test.

Some made-up animals have the proportions of a cow or a dog, guessed by eye: no mesh of the species held out is
trained on, but what resembles them is.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from benchmarks.accuracy.work import CellFailed
from uplift.data.concat import join
from uplift.data.formats.masks_npz import write_masks_npz
from uplift.data.masks import MaskData
from uplift.data.parsers.meshes import MeshOptions, read_meshes
from uplift.data.synthetic.masks import simulate_masks

__all__ = ["HELD_OUT", "Sizes", "animal_masks", "cache_folder", "posed_animals"]

HELD_OUT = ("Cow", "ShibaInu")
"""Species of the test, as the keypoints of `quadruped` have it."""
_MADE_UP_SEED, _TRAIN_SEED, _TEST_SEED = 0, 1, 2


@dataclass(frozen=True)
class Sizes:
    """How many masks there are of what."""

    made_up: int = 3000
    poses: int = 50
    """Of each species to train on."""
    views: int = 5
    """Of each of these poses."""
    test_poses: int = 50
    """Of each species held out, seen once."""


def cache_folder() -> Path:
    """Return where rendered masks stay: UPLIFT_BENCHMARK_CACHE, else ~/.cache/uplift."""
    return Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift").expanduser() / "shapes"


def animal_masks(folder: Path | None = None, sizes: Sizes | None = None) -> dict[str, Path]:
    """Return the files of the ``train`` and ``test`` masks; those that are not in ``folder`` are rendered.

    Raises:
        CellFailed: UPLIFT_DATA has no folder animal_meshes, or a species of the test is not in it.
    """
    folder, sizes = folder or cache_folder(), sizes or Sizes()
    known, other = _files()
    seen = f"{sizes.made_up}_{len(known)}x{sizes.poses}x{sizes.views}"
    found = {
        "train": folder / f"animals_train_{seen}.npz",
        "test": folder / f"animals_test_{len(other)}x{sizes.test_poses}.npz",
    }
    folder.mkdir(parents=True, exist_ok=True)
    if not found["train"].is_file():
        made_up = simulate_masks("animals", sizes.made_up, seed=_MADE_UP_SEED)
        write_masks_npz(join([made_up, posed_animals(known, sizes.poses, sizes.views, _TRAIN_SEED)]), found["train"])
    if not found["test"].is_file():
        write_masks_npz(posed_animals(other, sizes.test_poses, 1, _TEST_SEED), found["test"])
    return found


def posed_animals(files: list[Path], poses: int, views: int, seed: int) -> MaskData:
    """Return masks of animals in poses of their own animations, but for those they die in, ``views`` of each."""
    options = MeshOptions(poses=poses, animations=("-Death",), seed=seed)
    meshes = [mesh.in_unit() for mesh in read_meshes([str(file) for file in files], options)]
    return simulate_masks(meshes, len(meshes) * views, seed=seed, views_per_shape=views)


def _files() -> tuple[list[Path], list[Path]]:
    """Return the files of the species to train on, and of those held out."""
    root = os.environ.get("UPLIFT_DATA")
    if not root:
        raise CellFailed("UPLIFT_DATA is not set: it names the folder of the data sets")
    files = sorted((Path(root) / "animal_meshes").glob("*.glb"))
    names = {file.stem for file in files}
    missing = [name for name in HELD_OUT if name not in names]
    if missing or len(files) == len(HELD_OUT):
        raise CellFailed(
            f"UPLIFT_DATA has {', '.join(sorted(names)) or 'nothing'} in animal_meshes, expected .glb files of "
            f"{', '.join(HELD_OUT)} and of other species"
        )
    return [file for file in files if file.stem not in HELD_OUT], [file for file in files if file.stem in HELD_OUT]
