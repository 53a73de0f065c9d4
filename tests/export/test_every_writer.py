"""All writers of poses: bodies with gaps, without rates or sizes, of one frame or none, under names of any kind."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from writers_samples import ENDINGS, needed, pair, prediction

from uplift.cli.outputs import check_outputs
from uplift.errors import UserError
from uplift.export import WRITERS, write
from uplift.models.prediction import Prediction

ROOT = Path(__file__).resolve().parents[2]
OF_ALL = [ending for ending in ENDINGS if ending not in (".gif", ".mp4")]  # films have tests of their own
OF_ONE = [ending for ending in OF_ALL if WRITERS["poses"][ending].holds == "body"]
NAMES = st.one_of(
    st.sampled_from(
        ["../x", "/etc/x", "a:b", "a/b", "🐭", "CON", ".", "", "  ", "Skeletons", "\ud800", "a\x00b", "日" * 90]
    ),
    st.text(max_size=12),
)

SAMPLES = prediction(36), prediction(36, rooted=True)


@pytest.fixture(params=OF_ALL)
def ending(request: pytest.FixtureRequest) -> str:
    return needed(request.param)


@st.composite
def predictions(draw: st.DrawFn) -> Prediction:
    """Draw up to three bodies in up to two clips of up to six frames, some of them missing."""
    bodies = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    clips = draw(st.lists(NAMES, min_size=1, max_size=2, unique=True))
    places = [(clip, body, frame) for clip in clips for body in bodies for frame in range(draw(st.integers(0, 6)))]
    kept = [place for place in places if draw(st.integers(0, 3))]
    sample = draw(st.sampled_from(SAMPLES)).select(np.arange(len(kept)))
    columns = list(zip(*kept, strict=True)) if kept else [(), (), ()]
    first, step = draw(st.sampled_from([(0, 1), (1000, 1), (-2, 1), (7, 5)]))
    identity = {
        key: np.array(values, dtype=np.str_) for key, values in zip(("sequence", "instance"), columns, strict=False)
    }
    identity["frame"] = np.array(columns[2], dtype=np.int64) * step + first
    sample.pose[:: draw(st.integers(2, 5)), draw(st.integers(0, 6))] = np.nan
    fps, unit = draw(st.sampled_from([25.0, 29.97, 0.0, None])), draw(st.sampled_from(["mm", "mm", "px", "relative"]))
    return replace(sample, identity=identity, fps=fps, unit=unit, title=draw(NAMES))


@pytest.mark.filterwarnings("ignore:Do not use the `random`")  # which checks of types do
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(sample=predictions())
def test_it_is_written_beside_the_name_or_refused_in_a_line(
    ending: str, sample: Prediction, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("a") / "b"
    folder.mkdir()
    try:
        files = write(sample, folder / f"poses{ending}")
    except UserError as error:
        assert "\n" not in str(error) and not list(folder.iterdir())
        return
    assert files and set(folder.iterdir()) == set(files) and list(folder.parent.iterdir()) == [folder]
    for path in files:
        assert path.name.startswith("poses") and path.name.endswith(ending) and path.stat().st_size


def test_two_people_with_gaps_are_in_one_file_or_in_one_each(ending: str, tmp_path: Path) -> None:
    files = write(pair(), tmp_path / f"out{ending}")
    expected = [f"out_walk-{who}{ending}" for who in ("Anna", "Ben")] if ending in OF_ONE else [f"out{ending}"]
    assert [path.name for path in files] == expected


def test_one_frame_of_one_body_is_written(ending: str, tmp_path: Path) -> None:
    assert write(prediction(1), tmp_path / f"out{ending}")


def test_what_exists_is_not_overwritten_by_files_of_bodies(tmp_path: Path) -> None:
    kept = tmp_path / "out_walk-Ben.anipose.csv"
    kept.write_text("mine")
    with pytest.raises(UserError, match="exists already"):
        write(pair(), tmp_path / "out.anipose.csv")
    assert list(tmp_path.iterdir()) == [kept] and kept.read_text() == "mine"


@pytest.mark.parametrize("ending", [ending for ending, writer in WRITERS["poses"].items() if writer.needs])
def test_a_library_that_is_not_there_is_named_before_any_work(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, extras = WRITERS["poses"][ending], tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert writer.extra in extras["optional-dependencies"]
    monkeypatch.setitem(sys.modules, writer.needs[-1], None)
    says = rf'needs .*{writer.needs[-1]}: pip install "uplift3d\[{writer.extra}\]"'
    with pytest.raises(UserError, match=says):
        write(SAMPLES[1], tmp_path / f"a{ending}")
    with pytest.raises(UserError, match=says):
        check_outputs([f"{tmp_path}/a.csv", f"{tmp_path}/a{ending}"], None, None, {}, 0)
    assert not list(tmp_path.iterdir())
