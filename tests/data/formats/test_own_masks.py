"""A format of masks of a user's own: what its class gives is cut out and cleaned as pictures are."""

from __future__ import annotations

import re
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from bodies import refusal, status_of
from hypothesis import given
from hypothesis import strategies as st
from mask_files import blob, save
from shape_stand_in import stand_in

import uplift
from uplift.config.plugins import find_class
from uplift.config.trust import granted
from uplift.data.formats import read_masks
from uplift.data.formats.masks_npz import write_masks_npz
from uplift.data.synthetic.masks import simulate_masks

READER = '''
import numpy as np

import uplift
from uplift.data.formats.masks_npz import read_masks_npz


class MyMasks(uplift.MaskFormat):
    """Arrays of labels."""

    ending = ".npy"

    def read(self, path, options):
        labels = np.load(path)
        for number in np.unique(labels[labels > 0]):
            yield f"{path.stem}:{number}", labels == number


class True_(uplift.MaskFormat):
    """Cut out already."""

    def read(self, path, options):
        return read_masks_npz(path)
'''
OWN = "my_masks.py:MyMasks"


@pytest.fixture(autouse=True, scope="module")
def as_users_run_it():
    """Switch off the checks of types, which only tests have: a user's code may give what it likes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jaxtyping.config, "jaxtyping_disable", True)
        yield


@pytest.fixture
def mine(here: Path) -> Path:
    """Return the current folder, with the reader, two images of two labels, and the same as pictures of one object."""
    (here / "my_masks.py").write_text(READER)
    (here / "labels").mkdir()
    for image in range(2):
        labels = np.zeros((60, 160), np.int64)
        for place, number in enumerate((3, 7)):
            mask = blob(seed=2 * image + place)
            labels[:, 80 * place : 80 * place + 80][mask] = number
            whole = np.zeros((60, 160), np.uint8)
            whole[:, 80 * place : 80 * place + 80][mask] = 255
            save(here / f"pictures/{image}-{number}.png", whole)
        np.save(here / f"labels/{image}.npy", labels)
    (here / "labels/notes.md").write_text("nothing")
    return here


def test_masks_are_those_of_the_same_pictures(mine: Path) -> None:
    found, expected = read_masks("labels", format=OWN), read_masks("pictures", format="png_folder")
    assert np.array_equal(found.masks, expected.masks)
    assert np.array_equal(found.centre_px, expected.centre_px)
    assert np.array_equal(found.scale_px, expected.scale_px)
    assert found.names == ["0:3", "0:7", "1:3", "1:7"]
    assert found.notes[0] == "read as Arrays of labels (my_masks.py:MyMasks)"
    assert found.notes[-1] == "1 files of other kinds in the folder were left out"


def own(folder: Path, body: str, **options) -> uplift.MaskData:
    """Return what a format of this ``body`` reads."""
    source = (
        "import numpy as np\nimport uplift\nfrom uplift.data.masks import Found\n"
        "ONE = np.zeros((60, 80), bool); ONE[10:40, 20:50] = True\n"
        "CROPS = np.full((3, 16, 16), 255, np.uint8)\n"
        f"class Mine(uplift.MaskFormat):\n    def read(self, path, options):\n        {body}\n"
    )
    path = folder / f"mine_{abs(hash(source))}.py"
    path.write_text(source)
    (folder / "x.dat").write_text("x")
    return read_masks(folder / "x.dat", format=f"{path}:Mine", **options)


@pytest.mark.parametrize(
    ("body", "names"),
    [
        ("return [ONE, ONE]", ["x.dat:0", "x.dat:1"]),
        ("return ONE", ["x.dat:0"]),
        ("return np.stack([ONE, ONE])", ["x.dat:0", "x.dat:1"]),
        ("return {'a': ONE, 'b': ONE}", ["a", "b"]),
        ("return ((name, ONE) for name in 'ab')", ["a", "b"]),
        ("yield Found('a', 255 * ONE.astype(np.uint8))", ["a"]),
        ("return [Found('a', ONE[10:40, 20:50], corner_px=(20, 10), image_size=(80, 60))]", ["a"]),
    ],
)
def test_what_a_class_may_give(here: Path, body: str, names: list[str]) -> None:
    found = own(here, body)
    assert found.names == names
    assert found.centre_px.tolist() == [[35, 25]] * len(names)  # the box is 20 to 50 and 10 to 40
    assert found.masks.shape == (len(names), 64, 64)


def test_categories_photos_and_most(mine: Path) -> None:
    body = "yield from (Found(name, ONE, category='cow' if name in '02' else 'dog') for name in '0123')"
    assert own(mine, body, category="Cow").names == ["0", "2"]
    assert own(mine, body, most=3).names == ["0", "1", "2"]
    assert own(mine, body, most=1, category="dog").notes[-1] == "the first 1 masks are taken (most=1)"
    save(mine / "photos/1.jpg", np.zeros((8, 8, 3), np.uint8))
    found = own(mine, body, images="photos")
    assert found.images is not None
    assert found.images.tolist() == ["", "photos/1.jpg", "", ""]
    with pytest.raises(uplift.UserError, match="category=cat: .*Did you mean 'cow'|category=cat: .* Valid"):
        own(mine, body, category="cat")


def test_masks_that_are_cut_out(here: Path) -> None:
    found = own(here, "return uplift.MaskData(CROPS, list('abc'), np.zeros((3, 2)), np.ones(3))", most=2, side=16)
    assert np.array_equal(found.masks, np.full((2, 16, 16), 255))
    assert set(found.names) < set("abc")


@given(seed=st.integers(0, 999), kind=st.sampled_from(["bool", "uint8", "uint16", "int64", "float32", "float64"]))
def test_masks_of_any_kind_of_numbers(tmp_path_factory, seed: int, kind: str) -> None:
    folder = tmp_path_factory.getbasetemp()
    (folder / "held_masks.py").write_text(
        "import uplift\nclass Held(uplift.MaskFormat):\n"
        "    def read(self, path, options):\n        return self.held.copy()\n"
    )
    (folder / "any.bin").write_text("x")
    mask = blob(seed=seed)
    full = {"uint8": 255, "uint16": 65535}.get(kind, 1)
    with granted(frozenset({str((folder / "held_masks.py").resolve())})):
        held = find_class(f"{folder}/held_masks.py:Held", {}, "format")
    held.held = (full * mask).astype(kind)  # type: ignore[attr-defined]
    found = read_masks(folder / "any.bin", format=f"{folder}/held_masks.py:Held", side=32)
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    assert found.centre_px[0].tolist() == [(columns[0] + columns[-1] + 1) / 2, (rows[0] + rows[-1] + 1) / 2]
    longer = max(np.ptp(rows), np.ptp(columns)) + 1
    assert found.scale_px[0] == pytest.approx(longer / 2 / 0.85)
    covered = found.masks[0].astype(float).sum() / 255 * (2 * found.scale_px[0] / 32) ** 2
    assert covered == pytest.approx(mask.sum(), rel=0.05)


AS = r"x.dat, as mine_\d+.py:Mine read it: "
LINE = r"x.dat: Mine.read failed in .*mine_\d+.py, line 8: "


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("1 / 0", LINE + "ZeroDivisionError"),
        ("yield ONE; 1 / 0", LINE + "ZeroDivisionError"),
        ("yield ONE; raise uplift.UserError('no')", r"x.dat: Mine.read, in .*py, line 8: no$"),
        ("pass", AS + "Mine.read returned nothing, expected masks: arrays .height, width."),
        ("return 'x'", AS + "Mine.read returned str"),
        ("return 3", AS + "Mine.read returned int"),
        ("return []", AS + "Mine.read gave no mask"),
        ("return [[[0, 1]]]", AS + "mask 0 is list, expected an array"),
        ("return [ONE, ('a', 3)]", AS + "mask 1 is int, expected an array"),
        ("return [(ONE, 'a')]", AS + "mask 0 is tuple"),
        ("return {3: ONE}", AS + "mask 0 is tuple"),
        ("return [ONE[None]]", AS + r"mask 0 is bool of shape \(1, 60, 80\), expected numbers of shape"),
        ("return [ONE.astype(str)]", AS + "mask 0 is <U5 of shape"),
        ("return [ONE[:0]]", AS + r"mask 0 is bool of shape \(0, 80\)"),
        ("return [Found('a', ONE, corner_px='ab')]", AS + "mask 0: 'corner_px' is 'ab'"),
        ("return [Found('a', ONE, corner_px=(-1, 0))]", AS + "mask 0: 'corner_px'"),
        ("return [Found('a', ONE, image_size=(0, 9))]", AS + "mask 0: 'image_size'"),
        ("return [Found('a', ONE, slack_px='x')]", AS + "mask 0: 'slack_px'"),
        ("return [Found('a', ONE, category=3)]", AS + "mask 0: 'category' is 3"),
        ("return [Found(3, ONE)]", AS + "mask 0: 'name' is 3"),
        ("return [ONE * 0]", "x.dat: none of 1 masks can be used: 1: empty"),
        ("return uplift.MaskData([[1]], ['a'], np.zeros((1, 2)), np.ones(1))", r"line 8: masks are list, expected an"),
        ("return uplift.MaskData(CROPS[0], ['a'], np.zeros((1, 2)), np.ones(1))", r"line 8: masks are uint8 of shape"),
        ("return uplift.MaskData(CROPS, ['a'], np.zeros((3, 2)), np.ones(3))", "line 8: 'names' has shape"),
        (
            "return uplift.MaskData(CROPS, list('abc'), np.zeros((3, 2)), np.zeros(3))",
            AS + "'scale_px' is 0 at .0., ex",
        ),
        ("return uplift.MaskData(CROPS, list('abc'), np.full((3, 2), np.nan), np.ones(3))", AS + "'centre_px' is nan"),
        ("return uplift.MaskData(CROPS[:0], [], np.zeros((0, 2)), np.zeros(0))", AS + "no masks"),
    ],
)
def test_what_is_given_is_checked(here: Path, body: str, says: str) -> None:
    with pytest.raises(uplift.UserError, match=says) as found:
        own(here, body)
    assert len(str(found.value)) < 500


def test_masks_and_crops_do_not_mix(mine: Path) -> None:
    body = "def read(self, path, options): return read_masks_npz('x.npz') if '1' in path.stem else [np.eye(60)]"
    Path("mixed.py").write_text(READER + f"\nclass Mixed(MyMasks):\n    {body}\n")
    write_masks_npz(simulate_masks("chairs", 2, seed=1, side=32), "x.npz")
    with pytest.raises(uplift.UserError, match="labels/1.npy, as .* MaskData from one file and masks from another"):
        read_masks("labels", format="mixed.py:Mixed")


# Every command takes it, with a stand-in for the lifter.


def test_fit_predict_and_data_check(mine: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    stand_in(monkeypatch)
    words = ["task=masks", "data.train=labels", f"data.format={OWN}", "data.side=32"]
    assert status_of("data", "check", *words) == 0
    text = capsys.readouterr().out
    assert "to load: 4 masks of 32 x 32 px, no true shapes; read as Arrays of labels (my_masks.py:MyMasks)" in text
    assert status_of("fit", *words) == 0
    assert "train: read as Arrays of labels (my_masks.py:MyMasks)" in capsys.readouterr().out
    run = Path("runs/masks/last").resolve()
    (mine / "else").mkdir()
    monkeypatch.chdir(mine / "else")
    new = mine / "labels/1.npy"
    assert status_of("predict", f"run={run}", f"input={new}", "output=shapes.npz", "trust=../my_masks.py") == 0
    assert "lifted 2 masks" in capsys.readouterr().out
    assert status_of("predict", f"run={run}", f"input={new}", "output=more.npz", f"format=../{OWN}") == 0
    message = refusal(capsys, "predict", f"run={run}", f"input={new}", "output=no.npz", "format=../my_masks.py:MyMask")
    assert re.search("no class 'MyMask' there. Did you mean 'MyMasks'", message)


def test_evaluation_on_masks_with_truth(mine: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    stand_in(monkeypatch)
    write_masks_npz(simulate_masks("chairs", 6, seed=1, side=32), mine / "true.npz")
    format = "data.format=my_masks.py:True_"
    assert status_of("fit", "task=masks", "data.train=true.npz", "data.test=true.npz", format, "data.side=32") == 0
    run = Path("runs/masks/last").resolve()
    (mine / "else").mkdir()
    monkeypatch.chdir(mine / "else")
    assert uplift.evaluate(run, trust="../my_masks.py").items == 6
    assert uplift.evaluate(run, mine / "true.npz", trust="../my_masks.py").items == 6
