"""What predict says of its input: several cameras of one scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.cli.predict import Request, _read
from uplift.config.run import Weights
from uplift.skeleton import Skeleton

SKELETON = Skeleton("arm", ("shoulder", "elbow", "wrist", "hand"), "shoulder", (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")))  # fmt: skip


def write_csv(file: Path, first: int = 0, camera: str = "") -> None:
    """Write eight frames of an arm, from frame ``first`` on."""
    file.parent.mkdir(exist_ok=True)
    head = ",".join(f"{joint}_{what}" for joint in SKELETON.joints for what in "xy")
    rows = np.random.default_rng(first).uniform(100, 300, (8, 8)).round(2).astype(str).tolist()
    lines = [",".join([str(first + number), *([camera] if camera else []), *row]) for number, row in enumerate(rows)]
    file.write_text("\n".join([f"frame,{'camera,' if camera else ''}{head}", *lines]) + "\n")


def notes_of(pattern: str) -> str:
    weights = Weights("run", Path("nowhere/lifter.pt"), {})
    request = Request(weights, pattern, None, (), True, 0, False, {}, None, None, None, {})
    return "; ".join(note for note in _read(request, SKELETON).notes if "cameras of one scene" in note)


@pytest.mark.parametrize(
    ("files", "cameras"),
    [
        (("walk_cam1.csv", "walk_cam2.csv", "walk_cam3.csv"), "3 cameras of one scene (cam1, cam2, cam3)"),
        (("camA/walk.csv", "camB/walk.csv"), "2 cameras of one scene (camA, camB)"),
        (("walk.C1.csv", "walk.C2.csv"), "2 cameras of one scene (C1, C2)"),
        (("view-1 run.csv", "view-2 run.csv"), "2 cameras of one scene (view-1, view-2)"),
        (("walk_1.csv", "walk_2.csv"), ""),
        (("walk_cam1.csv", "run_cam2.csv"), ""),
        (("camel.csv", "camera.csv"), ""),
        (("camA/walk.csv",), ""),
    ],
)
def test_files_of_several_cameras_are_said_to_stay_apart(tmp_path: Path, files: tuple[str, ...], cameras: str):
    for file in files:
        write_csv(tmp_path / file)
    said = notes_of(",".join(str(tmp_path / file) for file in files))
    assert (f"{cameras}: each is lifted by itself" in said) if cameras else not said


def test_films_of_other_times_are_no_scene(tmp_path: Path):
    write_csv(tmp_path / "walk_cam1.csv")
    write_csv(tmp_path / "walk_cam2.csv", first=100)
    assert not notes_of(f"{tmp_path}/*.csv")


def test_cameras_that_one_video_names_are_a_scene(tmp_path: Path):
    write_csv(tmp_path / "a/walk.csv", camera="left")
    write_csv(tmp_path / "b/walk.csv", camera="right")
    (tmp_path / "walk.csv").write_text(
        (tmp_path / "a/walk.csv").read_text() + (tmp_path / "b/walk.csv").read_text().split("\n", 1)[1]
    )
    assert "2 cameras of one scene (left, right)" in notes_of(str(tmp_path / "walk.csv"))
