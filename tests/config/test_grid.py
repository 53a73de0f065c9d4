"""Lists and ranges on the command line: what is one value, what are several, and the grid that they span."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.config.grid import cells_of, split_grid
from uplift.config.loading import load_settings
from uplift.errors import UserError


def values_of(word: str) -> list[str]:
    """Return the values of a word that has several."""
    plain, (axis,) = split_grid([word])
    assert not plain
    assert axis.key == word.partition("=")[0]
    return list(axis.values)


@pytest.mark.parametrize(
    ("word", "values"),
    [
        ("seed=0,1,5..7", ["0", "1", "5", "6", "7"]),
        ("seed=0..3", ["0", "1", "2", "3"]),
        ("lifter.options.units=128,256", ["128", "256"]),
        ("lifter.options.units=128..512:log3", ["128", "256", "512"]),
        ("teacher.batch_size=64..512:log4", ["64", "128", "256", "512"]),
        ("priors.bones.weight=0..0.3:4", ["0", "0.1", "0.2", "0.3"]),
        ("teacher.learning_rate=1e-4..1e-2:log3", ["0.0001", "0.001", "0.01"]),
        ("trainer.gradient_clip_val=0.5,1", ["0.5", "1"]),
        ("lifter.camera=orthographic,perspective", ["orthographic", "perspective"]),
        ("lifter.fill=true,false", ["true", "false"]),
        ("teacher.average=null,0.99", ["null", "0.99"]),
        ("trainer.max_time=60,00:02:00", ["60", "00:02:00"]),
        ("priors.mine.use=a.py:A,b.py:B", ["a.py:A", "b.py:B"]),
        ("views.azimuth_deg=[-30,30],[-90,90]", ["[-30,30]", "[-90,90]"]),
        ("student.rounds=[1],[0.3,0.7]", ["[1]", "[0.3,0.7]"]),
        ("data.train=[a.npz,b.npz],[c.npz]", ["a.npz,b.npz", "c.npz"]),
        ("lifter.options.layers=[64,64],[32]", ["[64,64]", "[32]"]),
    ],
)
def test_what_has_several_values(word: str, values: list[str]) -> None:
    assert values_of(word) == values


@pytest.mark.parametrize(
    "word",
    [
        "seed=3", "views.azimuth_deg=-30,30", "views.azimuth_deg=[-30,30]", "student.rounds=0.35,0.65", "data.train=a.npz,b.npz",
        "data.focal_px=left:1145,right:1200", "trainer.logger=csv,tensorboard", "priors.mine.joints=[hip, nose]",
        'loggers.wandb.tags="a,b"', "description=first, second", "priors={flow: 1, bones: 2}", "sweep.options.x=1,2", "task=a,b",
        "data.select.subjects=S1,S7", "priors.mine.x=!<tag:yaml.org,2002:int> 3", "skeleton=../a.yaml", "trainer.max_time={minutes: 1, seconds: 30}",
    ],
)  # fmt: skip
def test_what_has_one_value_stays_as_it_is(word: str) -> None:
    assert split_grid([word]) == ([word], [])


@given(st.integers(-50, 50), st.integers(0, 60))
def test_a_whole_range_has_both_ends_and_all_between(first: int, more: int) -> None:
    plain, axes = split_grid([f"priors.bones.weight={first}..{first + more}"])
    found = axes[0].values if axes else [plain[0].partition("=")[2]]
    assert [int(value) for value in found] == [*range(first, first + more + 1)]


@given(st.floats(0.001, 100), st.floats(1.5, 1000), st.integers(2, 30), st.booleans())
def test_ranges_are_evenly_spaced(low: float, ratio: float, count: int, log: bool) -> None:
    space = np.geomspace if log else np.linspace
    low, high = float(f"{low:.6g}"), float(f"{low * ratio:.6g}")
    found = values_of(f"priors.bones.weight={low}..{high}:{'log' * log}{count}")
    assert np.allclose([float(value) for value in found], space(low, high, count), rtol=1e-5)


def test_a_file_with_a_comma_in_its_name_is_one(here: Path) -> None:
    (here / "a,b.yaml").touch()
    assert split_grid(["skeleton=a,b.yaml"]) == (["skeleton=a,b.yaml"], [])


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("seed=5..3", "an empty range, as 5 is above 3. Write 3..5"),
        ("seed=0,,1", "an empty value"),
        ("seed=0,0", "the value 0 is there twice"),
        ("seed=0..99999999", "100,000,000 values"),
        ("seed=range(0,4)", "whole numbers as 0..63"),
        ("lifter.distance=1.5..2.5", "how many values? 1.5..2.5:4"),
        ("lifter.distance=0..2:log3", "begins above 0"),
        ("lifter.distance=2..3:1", "1 values"),
        ("lifter.camera=1..3", "a range goes with numbers"),
        ("lifter.fill=0..1", "a range goes with numbers"),
        ("views.azimuth_deg=-90..90", "brackets around each value: views.azimuth_deg=[...],[...]"),
        ("data.train=0..3", "brackets around each value"),
        ("views.azimuth_deg=[1,2],3", "brackets around each"),
        ("sed=1,2", "Did you mean 'seed'?"),
    ],
)
def test_what_is_ambiguous_or_empty_is_refused_in_a_line(word: str, says: str) -> None:
    with pytest.raises(UserError) as error:
        split_grid([word])
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_cells_are_the_product_each_with_its_own_name_and_settings() -> None:
    words = [
        "trainer.max_steps=9",
        "seed=0..2",
        "lifter.camera=orthographic,perspective",
        "views.azimuth_deg=[-9,9],[-5,5]",
    ]
    plain, axes = split_grid(words)
    cells = cells_of(axes)
    assert [tuple(cell.values.values()) for cell in cells] == list(product(*(axis.values for axis in axes)))
    assert len({cell.name for cell in cells}) == len(cells) == 12
    assert all(Path(cell.name).name == cell.name and cell.name.isascii() for cell in cells)
    settings = load_settings("demo", [*plain, *cells[-1].words])
    assert (settings.seed, settings.lifter.camera, list(settings.views.azimuth_deg)) == (2, "perspective", [-5, 5])


def test_names_of_folders_do_not_leave_the_sweep() -> None:
    _, axes = split_grid(["init=../../a/b,c d/e", "student.rounds=[1],[0.5,0.5]"])
    assert [cell.name for cell in cells_of(axes)][::3] == ["0_init=b_rounds=1", "3_init=e_rounds=0.5,0.5"]
