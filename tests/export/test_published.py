"""What is passed on: no folder of this machine in any output, and no formula in a table."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from shape_samples import shapes
from writers_samples import ENDINGS, needed, prediction

from uplift.config.files import without_folders
from uplift.data.formats.csv import write_keypoints_csv
from uplift.data.formats.deeplabcut import write_deeplabcut_csv
from uplift.data.formats.masks_npz import read_masks_npz, write_masks_npz
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.export import PAGES, WRITERS, write
from uplift.export.html import read_html
from uplift.metrics.report import Evaluation
from uplift.skeleton import Skeleton

MARK = "Qx7 (a user's own)"


@pytest.fixture
def marked(tmp_path: Path) -> Path:
    """Return a folder that only this machine has, with a sign and spaces in its name."""
    (tmp_path / MARK / "in").mkdir(parents=True)
    (tmp_path / "out").mkdir()
    return tmp_path / MARK / "in"


def held(path: Path) -> str:
    """Return all that a file says: its bytes, what they pack, and its own name."""
    text = path.name + path.read_bytes().decode("latin-1")
    if path.suffix == ".npz":
        with np.load(path) as file:
            text += " ".join(str(file[name].tolist()) for name in file.files if file[name].dtype.kind == "U")
    if path.suffix == ".html" and "application/json" in text:
        data = read_html(path)
        text += str({key: value for key, value in data.items() if key != "arrays"})
    return text


@pytest.mark.parametrize(
    ("ending", "page"), [*((ending, None) for ending in ENDINGS if ending != ".mp4"), (".html", "gallery")]
)
def test_no_output_of_poses_names_a_folder_of_this_machine(
    ending: str, page: str | None, marked: Path, tmp_path: Path
) -> None:
    needed(ending)
    film = np.array([str(marked / f"S{n % 2}" / "film.mp4") for n in range(12)])
    clips = (
        {} if ending in (".csv", ".json", ".npz") else {"sequence": film}
    )  # these hand on what the input calls its rows
    identity = {"frame": np.arange(12) // 2, **clips}
    notes = (f"WARNING: {marked}/v.csv: odd", f"read {marked / 'a.csv'},{marked / 'b.csv'}")
    sample = prediction(frames=12, source=str(marked / "v.csv"), title="", identity=identity, notes=notes)
    files = write(sample, tmp_path / "out" / f"a{ending}", page)
    assert files
    for path in files:
        text = held(path)
        assert MARK not in text and "Qx7" not in text
        assert ending != ".html" or "v.csv" in text


@pytest.mark.parametrize("ending", WRITERS["shapes"])
def test_no_output_of_shapes_names_a_folder_of_this_machine(ending: str, marked: Path, tmp_path: Path) -> None:
    sample = shapes(2, names=[str(marked / "a.jpg:1"), "b"])
    sample.notes, sample.images = (
        (f"{marked}/a.npz: odd",),
        np.array([str(marked / "a.jpg"), str(marked / "b" / "c.jpg")]),
    )
    for path in write(
        sample, tmp_path / "out" / f"a{ending}", *([next(iter(PAGES["shapes"]))] if ending == ".html" else [])
    ):
        assert "Qx7" not in held(path)


def test_masks_are_handed_on_with_their_photos(marked: Path, tmp_path: Path) -> None:
    """Beside the file its photos are found again where both are moved to; of others the name is left."""
    (marked / "photos").mkdir()
    (marked / "photos" / "a.jpg").touch()
    names = [str(marked / "photos" / "a.jpg"), str(tmp_path / "b.jpg"), ""]
    data = MaskData(
        np.zeros((3, 32, 32), np.uint8), ["a", "b", "c"], np.zeros((3, 2)), np.ones(3), images=np.array(names),
        notes=(f"{marked}: odd",), source=str(marked / "m.json"),
    )  # fmt: skip
    write_masks_npz(data, marked / "masks.npz")
    assert "Qx7" not in held(marked / "masks.npz")
    moved = (marked.parent / "in").rename(tmp_path / "moved")
    found = read_masks_npz(moved / "masks.npz").images
    assert found is not None and found.tolist() == [str(moved / "photos" / "a.jpg"), str(moved / "b.jpg"), ""]


def test_texts_are_left_as_they_are_but_for_folders() -> None:
    for text in (
        "3 km/h and/or 2D / 3D, 5 steps/s",
        "https://host.org/a/b.html",
        "h36m:train",
        "in/a.csv ../b/c.csv",
        "/s /m",
    ):
        assert without_folders(text) == text
    assert without_folders("(/no/such/a.csv; C:\\Users\\me\\b.csv)") == "(a.csv; b.csv)"
    assert without_folders("x=/no/such/a.csv,/no/such/b.csv") == "x=a.csv,b.csv"


def test_an_evaluation_tells_files_of_one_name_apart(here: Path, marked: Path) -> None:
    import json

    from uplift.cli.evaluate import save_evaluation
    from uplift.cli.listing import compare
    from uplift.config.loading import load_settings, save_settings
    from uplift.config.run import RunFolder

    settings = load_settings("demo")
    for name, folder in (("a", "one"), ("b", "two"), ("c", "two")):
        run = RunFolder(here / name)
        run.path.mkdir()
        save_settings(settings, run.config)
        (run.path / "run.json").write_text("{}")
        save_evaluation(Evaluation(str(marked / folder / "test.npz"), {"mpjpe": 1.0}, {}, {}, {}, "mm", 3), run)
        assert json.loads((run.path / "evaluation.json").read_text())["data"] == "test.npz"
    assert "Not the same test data" in compare(["a", "b"])
    assert "test data: test.npz" in compare(["b", "c"])


# Formulas in tables: an independent list of what spreadsheets take for one (OWASP, "CSV Injection").

WILD = ["=1+1", "-x", "+b", "@sum", "\tz", "\r=q", "a;=1", "plain", "＝1"]


def formulas(path: Path) -> list[str]:
    """Return the cells that a spreadsheet would run, with commas or semicolons between cells."""
    with path.open(newline="", encoding="utf-8") as file:
        cells = [part for row in csv.reader(file) for cell in row for part in (cell, *cell.split(";"))]
    return [
        cell
        for cell in cells
        if re.match(r"[=+\-@\t\r＝＋－＠]", cell) and not re.fullmatch(r"[+-]?[\d.]+(e[+-]?\d+)?", cell)
    ]


def test_a_table_of_poses_holds_no_formula_where_that_is_asked_for(tmp_path: Path) -> None:
    wild = Skeleton("wild", tuple(WILD), WILD[0], tuple(pairwise(WILD)), gravity=False)
    identity = {"subject": np.array(WILD), "frame": np.arange(-4, 5)}
    sample = prediction(frames=9, title="", joints=len(WILD), identity=identity)
    sample = replace(sample, joint_names=wild.joints, skeleton=wild)
    write(sample, tmp_path / "wild.csv")
    write(sample, tmp_path / "safe.csv", csv_safe=True)
    assert formulas(tmp_path / "wild.csv") and not formulas(tmp_path / "safe.csv")
    rows = [
        list(csv.reader((tmp_path / f"{name}.csv").open(newline="", encoding="utf-8"))) for name in ("wild", "safe")
    ]
    assert [row[1:] for row in rows[0][1:]] == [row[1:] for row in rows[1][1:]], (
        "numbers, negative ones too, as they were"
    )
    assert [row[0].replace("'", "") for row in rows[1][1:]] == WILD


def test_other_tables_hold_no_formula(tmp_path: Path) -> None:
    joints = ("=a", "@b", "-c", "nose")
    data = PoseData(np.full((2, 4, 2), -3.0, np.float32), np.ones((2, 4), np.float32), joints)
    for name, writer in (("plain", write_keypoints_csv), ("deeplabcut", write_deeplabcut_csv)):
        writer(data, tmp_path / f"{name}_wild.csv")
        writer(data, tmp_path / f"{name}.csv", csv_safe=True)
        assert formulas(tmp_path / f"{name}_wild.csv") and not formulas(tmp_path / f"{name}.csv")
        assert "-3" in (tmp_path / f"{name}.csv").read_text()
    groups = {name: {"mpjpe": -1.0} for name in WILD}
    Evaluation("d", {"mpjpe": 1.0}, groups, groups, groups, "mm", 3).write_csv(tmp_path / "evaluation.csv")
    assert not formulas(tmp_path / "evaluation.csv")
