"""The commands for runs that lift masks, with a stand-in for the lifter: fit, evaluate, predict, compare and the rest."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bodies import refusal, status_of
from mask_files import blob, save
from shape_stand_in import StandInModel, stand_in

import uplift
from uplift.cli.predict_masks import groups_of
from uplift.data.formats.masks_npz import read_masks_npz, write_masks_npz
from uplift.data.synthetic.masks import simulate_masks
from uplift.models.prediction import ShapePrediction

pytestmark = pytest.mark.usefixtures("here")

DEMO = ("task=masks_demo", "data.simulate=20", "data.family=chairs", "data.side=32")


@pytest.fixture(autouse=True)
def lifter(monkeypatch: pytest.MonkeyPatch) -> list:
    return stand_in(monkeypatch)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a finished run of masks_demo."""
    folder = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        stand_in(patch)
        assert status_of("fit", *DEMO) == 0
    return (folder / "runs/masks_demo/last").resolve()


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained, tmp_path / "run"))


@pytest.fixture
def masks(here: Path) -> Path:
    """Return a folder of three masks, one of which is empty."""
    for number in range(2):
        save(here / f"masks/cow/{number}.png", (255 * blob(seed=number)).astype(np.uint8))
    save(here / "masks/cow/none.png", np.zeros((60, 80), np.uint8))
    return here / "masks"


def test_a_fit_leaves_what_a_fit_of_keypoints_leaves(trained: Path) -> None:
    for name in ("config.yaml", "run.json", "lifter.pt", "metrics.csv", "report.md", "page.html", "evaluation.csv"):
        assert (trained / name).is_file(), name
    found = json.loads((trained / "evaluation.json").read_text())
    assert found["items"] == 2
    assert set(found["floors"]) == {"hull", "mean_shape", "nearest"}
    assert found["overall"]["best_floor_volume_iou"] > 0
    report = (trained / "report.md").read_text()
    for part in (
        "train: 20 masks from simulated chairs", "test: 2 masks from simulated chairs, other shapes",
        "Learned from masks alone: no shape, view or category of the data was looked at.",
        "shapes stand upright; cameras look down by 25 degrees", "guess: 0 s of training", "| volume_iou |",
    ):  # fmt: skip
        assert part in report
    page = (trained / "page.html").read_text()
    assert "true shapes known" in page
    assert "guess: loss" in page
    assert "Overlap of the volumes (IoU)<small>volume_iou" in page


def test_what_a_fit_prints(lifter: list, capsys) -> None:
    assert status_of("fit", *DEMO, "seed=1") == 0
    text = capsys.readouterr().out
    for part in (
        "uplift fit: masks_demo, masks, seed 1\n", "a stand-in", "trained for 0 s", "Learned from masks alone",
        "simulated chairs, other shapes: 2 shapes", "hull", "best", "next: uplift evaluate run=runs/masks_demo/last",
        "uplift predict run=runs/masks_demo/last input=MASKS output=shapes.html",
    ):  # fmt: skip
        assert part in text or part == "best"
    assert lifter[0].masks.truth is None
    assert lifter[0].loaded.test is not None
    assert lifter[0].loaded.test.truth is None


def test_a_fit_of_a_few_known_shapes_is_given_these_alone(lifter: list, capsys) -> None:
    assert status_of("fit", *DEMO, "data.labelled.fraction=0.2") == 0
    assert "Learned from the true shapes and views of 4 labelled masks of 20;" in capsys.readouterr().out
    train = lifter[0].masks
    assert int(train.labelled.sum()) == 4
    assert np.isfinite(train.truth.scale).tolist() == train.labelled.tolist()
    assert len(train.truth.meshes) == 5


def test_several_seeds_and_the_spread(capsys) -> None:
    assert status_of("fit", *DEMO, "seed=3,4", "sweep.workers=1") == 0
    text = capsys.readouterr().out
    assert "seeds 3, 4: mean and standard deviation" in text
    assert "best_floor_silhouette_iou_unseen" in text


def test_masks_of_ones_own_without_truth(masks: Path, capsys) -> None:
    assert status_of("fit", "task=masks", "data.train=masks", "data.side=32") == 0
    text = capsys.readouterr().out
    assert "train: 2 masks from" in text
    assert "1 of 3 masks skipped: empty" in text
    assert "No true test shapes: nothing to evaluate." in text
    last = Path("runs/masks/last")
    assert not (last / "evaluation.json").exists()
    assert "2 shapes" in (last / "page.html").read_text()
    assert "is not an evaluation" not in text
    assert "no test masks: give data.test=FILE" in refusal(capsys, "evaluate", f"run={last}")
    write_masks_npz(simulate_masks("chairs", 5, seed=9, side=48), "truth.npz")
    assert status_of("evaluate", f"run={last}", "data.test=truth.npz") == 0
    text = capsys.readouterr().out
    assert "no baselines: they are made of true training shapes" in text
    assert "truth.npz: 5 shapes" in text
    assert "no true shapes to compare with" in refusal(capsys, "evaluate", f"run={last}", "data.test=masks")


def test_ctrl_c_and_resume(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    stand_in(monkeypatch, stop=True)
    assert status_of("fit", *DEMO) == 130
    run = Path("runs/masks_demo/last").resolve()
    assert f"uplift fit resume={run.relative_to(Path.cwd())}" in capsys.readouterr().err
    assert "has no lifter.pt yet" in refusal(capsys, "predict", f"run={run}", "input=x", "output=y.html")
    assert "has no lifter.pt yet" in refusal(capsys, "evaluate", f"run={run}")
    assert status_of("fit", f"resume={run}") == 0
    assert (run / "lifter.pt").is_file()


def test_evaluate_writes_the_same_figures_again(run: Path, capsys) -> None:
    before = json.loads((run / "evaluation.json").read_text())
    (run / "evaluation.json").unlink()
    assert status_of("evaluate", f"run={run}") == 0
    assert json.loads((run / "evaluation.json").read_text()) == before
    assert "best" not in capsys.readouterr().out.split("metric")[0]
    assert status_of("evaluate", f"run={run}", "items=1") == 0
    text = capsys.readouterr().out
    assert "1 of 2 test masks were scored" in text
    found = uplift.evaluate(run, items=1)
    assert found.to_dict()["items"] == 1


def test_evaluate_without_the_training_files_has_no_floors(here: Path, capsys) -> None:
    write_masks_npz(simulate_masks("chairs", 12, seed=1, side=32), "train.npz")
    write_masks_npz(simulate_masks("chairs", 3, seed=2, side=32), "test.npz")
    words = ("task=masks", "data.train=train.npz", "data.test=test.npz", "data.side=32")
    assert status_of("fit", *words) == 0
    assert "mean_shape" in capsys.readouterr().out
    Path("train.npz").unlink()
    assert status_of("evaluate", "run=runs/masks", "data.test=test.npz") == 0
    text = capsys.readouterr().out
    assert "the training masks could not be read" in text
    assert "mean_shape" not in text


@pytest.mark.parametrize("ending", ["html", "npz", "csv", "json", "glb", "obj", "ply", "stl"])
def test_predict_writes_every_format(ending: str, run: Path, masks: Path, capsys) -> None:
    assert status_of("predict", f"run={run}", f"input={masks}", f"output=shapes.{ending}") == 0
    text = capsys.readouterr().out
    assert "1 of 3 masks skipped: empty" in text
    assert "lifted 2 masks, 16 x 16 x 16 voxels each" in text
    files = list(Path().glob(f"shapes*.{ending}"))
    assert len(files) == (2 if ending in ("obj", "ply", "stl") else 1)
    assert all(f"wrote {path}" in text for path in files)
    assert ("open shapes.html in a browser" in text) == (ending == "html")


@pytest.mark.parametrize(
    ("by", "names", "expected"),
    [
        ("all", ["a/1.png", "b/2.png"], [0, 0]),
        ("folder", ["a/1.png", "a/2.png", "b/1.png", "1.png", "a/b/1.png", "b/2.png"], [0, 0, 1, 2, 3, 1]),
        ("name", ["cow_001.png", "cow_002.png", "dog_001.png", "x/cow_003.png"], [0, 0, 1, 2]),
        ("name", ["cow_1_left.jp2", "cow_2_left.jp2", "cow_1_right.jp2"], [0, 0, 1]),
        ("name", ["f_001.png:3", "f_002.png:3", "f_001.png:4"], [0, 0, 1]),
        ("folder", ["v/001.png:3", "v/002.png:3", "v/001.png:4"], [0, 0, 1]),
    ],
)
def test_groups_by_name(by: str, names: list[str], expected: list[int]) -> None:
    found = groups_of(names, by)
    assert [list(dict.fromkeys(found)).index(one) for one in found] == expected


def test_groups_and_front_of_predict(run: Path, masks: Path, capsys) -> None:
    common = ("predict", f"run={run}", f"input={masks}")
    assert status_of(*common, "output=a.csv", "group=name", "front=180") == 0
    assert len(set(StandInModel.grouped[-1])) == 1
    save(masks / "sheep/lamb.png", (255 * blob(seed=5)).astype(np.uint8))
    says = refusal(capsys, *common[:2], "input=masks/cow/0.png,masks/sheep/lamb.png", "output=b.csv", "group=name")
    assert "no two of 2 masks have names that differ in the last number alone" in says


def test_predict_options(run: Path, masks: Path, capsys) -> None:
    common = ("predict", f"run={run}", f"input={masks}")
    assert status_of(*common, "output=a.glb", "height_mm=900", "axes=camera", "together=false", "smooth=0") == 0
    assert len(list(Path().glob("a_*.glb"))) == 2
    assert status_of(*common, "output=b.html", "page=gallery", "items=1") == 0
    assert status_of(*common, "output=c.npz", "category=cow", "most=1", "border=keep", "pieces=largest") == 0
    with np.load("c.npz") as found:
        assert found["occupancy"].shape == (1, 16, 16, 16)
        assert found["masks"].shape == (1, 32, 32)  # as the run was trained
    found = uplift.predict(run, masks, "d.ply", length_mm=100.0, most=1)
    assert isinstance(found, ShapePrediction)
    assert status_of("predict", f"run={run}/lifter.pt", f"input={masks}", "output=e.npz") == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("output=a.glb", "refine=off"), "refine= goes with a run that lifts keypoints"),
        (("output=a.glb", "focal_px=1000"), "focal_px= goes with a run that lifts keypoints"),
        (("output=a.glb", "bones=constant"), "bones= goes with a run that lifts keypoints"),
        (("output=a.glb", "data.options.x=1"), "data.options.x= goes with a run that lifts keypoints"),
        (("output=a.bvh",), "no writer of shapes for '.bvh'"),
        (("output=a",), "has no extension"),
        (("output=there.glb",), "exists already"),
        (("output=no/a.glb",), "no folder"),
        (("output=a.npz", "smooth=2"), "smooth= goes with the formats of meshes"),
        (("output=a.html", "together=true"), "together= goes with the formats of meshes"),
        (("output=a.npz", "items=3"), "items= is for a page"),
        (("output=a.glb", "smooth=-1"), "smooth=-1, expected a whole number"),
        (("output=a.html", "items=0"), "items=0, expected a whole number"),
        (("output=a.glb", "together=yes"), "expected true or false"),
        (("output=a.glb", "smooth=some"), "expected a whole number"),
        (("output=a.glb", "unit=mm"), "does not tell how large"),
        (("output=a.csv", "unit=mm"), "unit= goes with the formats of meshes"),
        (("output=a.csv", "front=90"), "front=90: shapes of this lifter are their own mirror image"),
        (("output=a.csv", "group=any"), "expected one of all, folder, name"),
        (("output=a.glb", "axes=up"), "axes=up"),
        (("output=a.html", "page=galery"), "Did you mean 'gallery'?"),
        (("output=a.glb", "category=horse"), "no such category"),
        (("output=a.glb", "format=cocoa"), "Did you mean 'coco'?"),
        (("output=a.glb", "border=maybe"), "expected skip or keep"),
        (("output=a.glb", "most=0"), "most=0"),
        (("output=a.glb", "input=empty"), "is an empty folder"),
        (("output=a.glb", "input=nowhere"), "nowhere"),
        (("output=a.glb", "input=masks/cow/0.png,here.npz"), "of several kinds"),
    ],
)
def test_predict_refuses(words: tuple[str, ...], says: str, run: Path, masks: Path, capsys) -> None:
    Path("there.glb").write_bytes(b"mine")
    Path("here.npz").write_bytes(b"mine")
    Path("empty").mkdir()
    assert says in refusal(capsys, "predict", f"run={run}", f"input={masks}", *words)
    assert not list(Path().glob("a*.*"))
    assert Path("there.glb").read_bytes() == b"mine"


def test_evaluate_and_compare_keep_the_kinds_apart(run: Path, capsys) -> None:
    assert "refine= goes with a run that lifts keypoints" in refusal(capsys, "evaluate", f"run={run}", "refine=off")
    assert "items=0" in refusal(capsys, "evaluate", f"run={run}", "items=0")
    assert status_of("compare", str(run), str(run)) == 0
    lines = capsys.readouterr().out.splitlines()
    table = [line for line in lines if line.startswith(("volume_iou ", "best_floor_silhouette_iou_unseen "))]
    assert len(table) == 2
    assert len({line.rindex(" ") for line in table}) == 1
    other = Path(shutil.copytree(run, run.with_name("poses")))
    (other / "evaluation.json").write_text(json.dumps({"data": "x", "overall": {"mpjpe": 50.0}}))
    (other / "config.yaml").write_text("lifts: keypoints\n")
    assert "lifts masks and" in refusal(capsys, "compare", str(run), str(other))


def test_data_check_and_tasks(masks: Path, capsys) -> None:
    assert status_of("data", "check", "task=masks_demo") == 0
    assert "train, test: 2,000 masks of simulated chairs" in capsys.readouterr().out
    assert status_of("data", "check", "task=masks", "data.train=masks") == 0
    assert "3 pictures, pictures of masks" in capsys.readouterr().out
    write_masks_npz(simulate_masks("chairs", 5, seed=9, side=48), "truth.npz")
    assert status_of("data", "check", "task=masks", "data.train=truth.npz", "data.test=gone.npz") == 2
    text = capsys.readouterr().out
    assert "5 masks of 48 x 48 px, with true shapes" in text
    assert "MISSING  gone.npz" in text
    Path("bad.npz").write_bytes(b"no archive")
    assert status_of("data", "check", "task=masks", "data.train=bad.npz") == 2
    assert "WRONG" in capsys.readouterr().out
    assert "simulated" not in refusal(capsys, "data", "check", "task=masks_demo", "data.family=char")
    assert status_of("tasks") == 0
    text = capsys.readouterr().out
    assert "masks_demo         no data needed" in text
    assert "masks              data.train=..." in text
    assert len(read_masks_npz("truth.npz")) == 5
