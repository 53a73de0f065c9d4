"""`uplift predict output=FOLDER/`: an output of each input, a manifest of what was done, and failures that stop nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flat_runs import across_the_image, flat_run
from mask_files import blob
from mask_files import save as save_picture
from PIL import Image
from shape_stand_in import StandInModel, stand_in, thick_shapes

from uplift.cli import predict_files
from uplift.cli.main import main
from uplift.cli.predict import predict_keys
from uplift.config.settings import ShapeSettings

INPUTS = ("a/walk", "a/run", "b/walk")


@pytest.fixture
def predict(here: Path) -> Callable[..., int]:
    """Return a function that predicts three files in two folders, and one that is damaged, one after the other."""
    flat_run(here)
    for name in (*INPUTS, "b/damaged"):
        path = Path("in") / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **across_the_image())
    Path("in/b/damaged.npz").write_text("nothing of the kind")

    def run(output: str, *words: str, workers: int = 1) -> int:
        given = ["predict", "run=lifter.pt", "input=in/**/*.npz", f"output={output}", f"workers={workers}"]
        return main([*given, *words])

    return run


@pytest.fixture
def lifted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the list of outputs that are made."""
    made: list[str] = []

    def lift(keys: Any, weights: Any, outputs: Any = ()) -> Any:
        made.extend(outputs)
        return predict_keys(keys, weights, outputs)

    monkeypatch.setattr(predict_files, "predict_keys", lift)
    return made


def files_in(folder: str) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*") if path.is_file())


def manifest(folder: str) -> dict[str, Any]:
    return {entry["input"]: entry for entry in json.loads(Path(folder, "predict.json").read_bytes())["files"]}


def test_each_input_has_an_output_of_its_name_and_what_fails_stops_nothing(
    predict: Callable[..., int], lifted: list[str], capsys: pytest.CaptureFixture
):
    assert predict("out/") == 2
    said = capsys.readouterr()
    assert "1 of 4 inputs failed (out/predict.json): b/damaged.npz: in/b/damaged.npz cannot be read" in said.err
    assert files_in("out") == ["a/run.npz", "a/walk.npz", "b/walk.npz", "predict.json"]
    found = manifest("out")
    assert found["b/damaged.npz"]["error"] and found["a/run.npz"] | {"notes": 0, "stamp": 0, "seconds": 0} == {
        "input": "a/run.npz", "outputs": {"a/run.npz": ["a/run.npz"]}, "frames": 80, "error": None, "notes": 0, "stamp": 0,
        "seconds": 0,
    }  # fmt: skip
    assert main(["predict", "run=lifter.pt", "input=in/a/run.npz", "output=alone.npz"]) == 0
    with np.load("alone.npz") as alone, np.load("out/a/run.npz") as among_others:
        np.testing.assert_array_equal(among_others["pose"], alone["pose"])


def test_what_is_done_is_not_done_again(predict: Callable[..., int], lifted: list[str], capsys: pytest.CaptureFixture):
    predict("out/")
    lifted.clear()
    np.savez("in/b/damaged.npz", **across_the_image())
    assert predict("out/") == 0 and lifted == ["out/b/damaged.npz"]
    assert "going on: 3 of 4 inputs were done before" in capsys.readouterr().out
    lifted.clear()
    Path("out/a/run.npz").unlink()
    assert predict("out/*.npz,out/*.trc", "height_mm=1750") == 2, "other settings are another prediction"
    assert "another value of 'settings': the usual then, height_mm=1750 now" in capsys.readouterr().err
    assert predict("out/*.npz,out/*_p.csv") == 0, "a further format is added"
    csv = [f"out/{name}_p.csv" for name in ("a/run", "a/walk", "b/damaged", "b/walk")]
    assert sorted(lifted) == sorted(["out/a/run.npz", *csv])
    assert manifest("out")["b/walk.npz"]["outputs"].keys() == {"b/walk.npz", "b/walk_p.csv"}


def test_an_input_that_has_changed_is_said_and_nothing_is_overwritten(
    predict: Callable[..., int], lifted: list[str], capsys: pytest.CaptureFixture
):
    Path("in/b/damaged.npz").unlink()
    assert predict("out/") == 0
    lifted.clear()
    np.savez("in/a/run.npz", **across_the_image() | {"fps": np.array(50.0)})
    before = Path("out/a/run.npz").read_bytes()
    assert predict("out/") == 2 and not lifted
    assert "in/a/run.npz has changed since out/a/run.npz was made of it" in capsys.readouterr().err
    assert Path("out/a/run.npz").read_bytes() == before
    Path("out/a/run.npz").unlink()
    assert predict("out/") == 0 and lifted == ["out/a/run.npz"]


def test_a_command_that_was_ended_goes_on(
    predict: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    done: list[str] = []

    def stopped(keys: Any, weights: Any, outputs: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.extend(outputs)
        return predict_keys(keys, weights, outputs)

    Path("in/b/damaged.npz").unlink()
    with monkeypatch.context() as here:
        here.setattr(predict_files, "predict_keys", stopped)
        assert predict("out/") == 130
    assert len(manifest("out")) == 2
    assert predict("out/") == 0
    said = capsys.readouterr().out
    assert "going on: 2 of 3 inputs were done before" in said and "1/1 b/walk.npz: 80 frames" in said


def test_workers_give_what_one_does(predict: Callable[..., int]):
    assert predict("one/") == predict("two/", workers=2) == 2
    assert files_in("one") == files_in("two")
    for name in INPUTS:
        assert Path(f"one/{name}.npz").read_bytes() == Path(f"two/{name}.npz").read_bytes()
    assert manifest("two")["b/damaged.npz"]["error"] == manifest("one")["b/damaged.npz"]["error"]


@pytest.mark.parametrize(
    ("output", "words", "said"),
    [
        ("out.npz", (), "workers= goes with an output for each input"),
        ("out/*,x.npz", (), "output 'x' has no extension"),
        ("out/,x.npz", (), "'x.npz' is one file, the others are one for each input. Write 'FOLDER/*.npz' for it"),
        ("*/x.npz", (), "expected one * in the name of the file"),
        ("out/*.foo", (), "no writer of poses for '.foo'"),
        ("no/out/", (), "output=no/out: no folder"),
        ("out/", ("together=true",), "together=true makes one body of all inputs"),
        ("out/", ("keypoints=2d.npz",), "keypoints=2d.npz: expected a * for the name of each input"),
        ("out/", ("bone_mm=-3",), "bone_mm=-3, expected"),
    ],
)
def test_what_cannot_be_done_is_refused_before_any_work(
    predict: Callable[..., int], capsys: pytest.CaptureFixture, output: str, words: tuple[str, ...], said: str
):
    assert predict(output, *words) == 2
    assert said in capsys.readouterr().err and not Path("out").exists()


def test_inputs_with_one_output_are_refused(predict: Callable[..., int], capsys: pytest.CaptureFixture):
    Path("in/a/run.json").write_text("{}")
    assert main(["predict", "run=lifter.pt", "input=in/a/run.*", "output=out/"]) == 2
    assert "would both be written to out/run.npz: rename one of them" in capsys.readouterr().err


def test_masks_have_an_output_each_too(here: Path, monkeypatch: pytest.MonkeyPatch):
    stand_in(monkeypatch)
    StandInModel(thick_shapes(0.4), ShapeSettings()).save(here / "lifter.pt")
    Path("masks").mkdir()
    for number in range(2):
        save_picture(here / f"masks/m{number}.png", blob(seed=number))
    assert main(["predict", "run=lifter.pt", "input=masks/*.png", "output=out/*.obj", "workers=1"]) == 0
    assert files_in("out") == ["m0.obj", "m1.obj", "predict.json"]
    Path("photos").mkdir()
    picture = Image.open(here / "masks/m0.png")
    Image.new("RGB", picture.size, (10, 20, 200)).save(here / "photos/m0.jpg")
    one = ["predict", "run=lifter.pt", "input=masks/m0.png", "images=photos"]
    assert main([*one, "output=blue.obj"]) == main([*one, "output=plain.obj", "texture=false"]) == 0
    for name, numbers in {"blue": 6, "plain": 3}.items():
        corners = [line.split()[1:] for line in Path(f"{name}.obj").read_text().splitlines() if line.startswith("v ")]
        assert corners and {len(corner) for corner in corners} == {numbers}
    assert main([*one, "output=a.stl", "texture=true"]) == 2
