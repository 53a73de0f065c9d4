"""`uplift predict` of long inputs: in parts as in one go, and on from where it was ended."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lifts import H36M, small_lifter

from uplift.cli.main import main
from uplift.cli.part_store import PartStore
from uplift.config.lock import only_one
from uplift.config.settings import LifterSettings
from uplift.data.formats.csv import write_keypoints_csv
from uplift.data.formats.npz import write_keypoints
from uplift.data.formats.shards import write_shards
from uplift.data.pieces import pieces_of
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.models.model import Model

FRAMES, PART = 600, 200
SETTINGS = LifterSettings(options={"units": 16, "blocks": 1}, uncertainty=False)


@pytest.fixture(scope="module")
def film() -> PoseData:
    return simulate(H36M, FRAMES, seed=3, clip_seconds=5.0, missing=0.1)


@pytest.fixture
def predict(here: Path, film: PoseData) -> Callable[..., int]:
    """Return a function that predicts ``film.npz`` by a small lifter, in parts, each frame by itself."""
    Model(small_lifter().eval(), H36M, SETTINGS).save("lifter.pt")
    write_keypoints(film, "film.npz")

    def run(output: str, *words: str, input: str = "film.npz", part: int = PART) -> int:
        given = ["predict", "run=lifter.pt", f"input={input}", f"output={output}", f"part_frames={part}"]
        return main([*given, "check=false", "refine=off", *words])

    return run


@pytest.fixture
def lifted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the list of how many frames each call of the lifter has."""
    calls: list[int] = []
    once = Model.predict

    def predict(self: Model, data: PoseData, *words, **how):
        calls.append(len(data))
        return once(self, data, *words, **how)

    monkeypatch.setattr(Model, "predict", predict)
    return calls


def arrays(path: str) -> dict[str, np.ndarray]:
    with np.load(path) as file:
        return dict(file)


def assert_same(one: str, other: str) -> None:
    first, second = arrays(one), arrays(other)
    assert first.keys() == second.keys()
    for name, array in first.items():
        if array.dtype.kind == "f":
            np.testing.assert_allclose(second[name], array, rtol=1e-4, atol=1e-2, err_msg=name)
        else:
            np.testing.assert_array_equal(second[name], array, err_msg=name)


def test_any_input_in_parts_gives_the_files_of_one_go(
    predict: Callable[..., int], film: PoseData, lifted: list[int], capsys: pytest.CaptureFixture
):
    Path("film").mkdir()
    write_shards(pieces_of(film, 400), Path("film"), frames=400)
    write_keypoints_csv(film, "film.csv")
    for input in ("film.npz", "film", "film.csv"):
        lifted.clear()
        name = input.replace(".", "_")
        assert predict(f"{name}_whole.npz,{name}_whole.csv", input=input, part=0) == 0 and lifted == [FRAMES]
        lifted.clear()
        assert predict(f"{name}_parts.npz,{name}_parts.csv,{name}_parts.html", input=input) == 0
        assert len(lifted) == 3 and sum(lifted) == FRAMES
        assert "lifted in 3 parts of about 200 frames" in capsys.readouterr().out
        assert_same(f"{name}_whole.npz", f"{name}_parts.npz")
        rows = [Path(f"{name}_{how}.csv").read_text().splitlines() for how in ("whole", "parts")]
        assert rows[0][0] == rows[1][0] and len(rows[0]) == len(rows[1])
        assert Path(f"{name}_parts.html").stat().st_size > 10_000 and not list(Path().glob(".*"))


def test_a_prediction_that_was_ended_goes_on(
    predict: Callable[..., int], lifted: list[int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    assert predict("whole.npz,whole.json", part=100) == 0
    parts = len(lifted)
    lifted.clear()
    counted = Model.predict

    def stopped(self: Model, *words, **how):
        if len(lifted) == 2:
            raise KeyboardInterrupt
        return counted(self, *words, **how)

    with monkeypatch.context() as here:
        here.setattr(Model, "predict", stopped)
        assert predict("on.npz,on.json", part=100) == 130
    assert "2 parts are kept in .on.npz.parts: the same command goes on" in capsys.readouterr().err
    with monkeypatch.context() as here:  # a disk that is full when the next part comes
        here.setattr(PartStore, "save", lambda *given: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left")))
        assert predict("on.npz,on.json", part=100) == 1
    assert "No space left" in capsys.readouterr().err
    assert sorted(os.listdir(".on.npz.parts"))[:2] == ["000000.npz", "000001.npz"]
    assert not list(Path().glob("on.*")) and not list(Path().glob("*.part"))
    lifted.clear()
    assert predict("on.npz,on.json", part=100) == 0
    assert len(lifted) == parts - 2 and "going on: 2 parts are there from before" in capsys.readouterr().out
    assert Path("on.npz").read_bytes() == Path("whole.npz").read_bytes()
    assert Path("on.json").read_bytes() == Path("whole.json").read_bytes()
    assert not Path(".on.npz.parts").exists()


def test_parts_of_another_input_lifter_or_option_are_not_gone_on_with(
    predict: Callable[..., int], film: PoseData, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    def ended(*words: str) -> str:
        """Predict until the second part, and return what was said."""
        before = Model.predict
        calls = []

        def stopped(self: Model, *given, **how):
            calls.append(1)
            if len(calls) == 2:
                raise KeyboardInterrupt
            return before(self, *given, **how)

        with monkeypatch.context() as here:
            here.setattr(Model, "predict", stopped)
            assert predict("x.npz", *words) == 130
        return capsys.readouterr().out

    ended()
    assert "beginning anew" not in ended()
    assert "beginning anew: other options" in ended("camera.tilt_deg=5")
    write_keypoints(film.select(slice(0, 590)), "film.npz")
    assert "beginning anew: another input" in ended("camera.tilt_deg=5")
    Model(small_lifter(seed=1).eval(), H36M, SETTINGS).save("lifter.pt")
    assert "beginning anew: another lifter" in ended("camera.tilt_deg=5")


def test_two_commands_do_not_work_on_one_output(predict: Callable[..., int], capsys: pytest.CaptureFixture):
    Path(".x.npz.parts").mkdir()
    with only_one(Path(".x.npz.parts/lock"), "x.npz"):
        assert predict("x.npz") == 2
    assert "x.npz: another command is at work on it" in capsys.readouterr().err
    assert predict("x.npz") == 0


def test_a_file_that_nobody_is_in_is_refused_and_frames_without_anybody_are_not(
    predict: Callable[..., int], film: PoseData, capsys: pytest.CaptureFixture
):
    confidence = film.confidence.copy()
    confidence[:250] = 0
    for path, values in (("some.npz", confidence), ("none.npz", 0 * confidence)):
        np.savez(path, keypoints=film.keypoints, confidence=values, joint_names=np.array(H36M.joints), **film.identity)
    assert predict("some_poses.npz", input="some.npz") == 0
    assert "250 of 600 frames cannot be lifted" in capsys.readouterr().out
    assert np.isnan(arrays("some_poses.npz")["pose"]).all((1, 2)).sum() == 250
    assert predict("no_poses.npz", input="none.npz") == 2
    assert "none of 600 frames can be lifted" in capsys.readouterr().err
    assert not list(Path().glob("no_poses*")) and not Path(".no_poses.npz.parts").exists()


def test_a_part_is_kept_with_everything_it_has(here: Path, predict: Callable[..., int], film: PoseData):
    model = Model(small_lifter().eval(), H36M, SETTINGS)
    found = model.predict(film.select(slice(0, 50)), "a title")
    with pytest.raises(KeyError), PartStore("x.npz", {"input": 1}, H36M) as store:
        store.save(7, found)
        raise KeyError
    with PartStore("x.npz", json.loads('{"input": 1}'), H36M) as store:
        again = store.load(7)
        assert 7 in store and 6 not in store
    for name, value in vars(found).items():
        if name == "identity":
            assert again.identity.keys() == value.keys()
            assert all(np.array_equal(np.asarray(again.identity[key]), np.asarray(value[key])) for key in value)
        else:
            np.testing.assert_equal(getattr(again, name), value, err_msg=name)
