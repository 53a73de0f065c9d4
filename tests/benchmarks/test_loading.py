"""The loading benchmark on small files of the same structure, in fresh processes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.loading import __main__ as loading
from benchmarks.loading import measure
from benchmarks.loading.files import settings_of, write_full_size
from benchmarks.stepping import stepper, teacher
from uplift.data.clean import clean
from uplift.data.load import load_data, load_split
from uplift.data.module import KeypointData
from uplift.data.sampler import LabelledSampler
from uplift.skeleton import load_skeleton


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    folder = tmp_path_factory.mktemp("full")
    write_full_size(folder, 1000, keypoints=("gt", "cpn"))
    with pytest.MonkeyPatch.context() as patch:  # what one test has read, the next finds in the cache
        patch.setenv("UPLIFT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield folder


def test_the_set_is_loaded_twice_and_the_result_stored(full, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    out = tmp_path / "results" / "loading.json"
    assert loading.main(["--folder", str(full), "--no-training", "--out", str(out)]) == 0
    found = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert "from the cache" in printed and "NO" not in printed
    assert found["command"] == "python -m benchmarks.loading --no-training"
    assert str(full) not in out.read_text()
    assert found["first"]["frames"] == found["from_cache"]["frames"] == found["views"]
    assert 700 * 4 < found["views"] < 1000 * 4
    assert found["cache_bytes"] > 0.5e9 * found["first"]["arrays_gb"]
    assert 0 < found["from_cache"]["load_s"] < found["first"]["load_s"]
    assert all(found["holds"].values())
    assert not (full / "cache").exists()


def test_an_exceeded_limit_is_reported(tmp_path, capsys, monkeypatch):
    names = ("frames", "load_cpu_s", "arrays_gb", "training_set_s", "peak_gb", "load_peak_gb", "load_s")
    one = dict(zip(names, (1, 3.0, 0.0, 1.0, 7.0, 7.0, 4.0), strict=True))
    monkeypatch.setattr(loading, "_process", lambda *_: one)
    monkeypatch.setattr(loading, "write_full_size", lambda *_: None)
    assert loading.main(["--no-training", "--out", str(tmp_path / "loading.json")]) == 1
    assert "NO" in capsys.readouterr().out
    held = json.loads((tmp_path / "loading.json").read_text())["holds"]
    assert held == {"first load, s < 60": True, "load from the cache, s < 5": True, "peak memory, GB < 6": False}


def test_the_files_have_the_structure_of_the_real_ones(full, monkeypatch):
    settings = settings_of(full)
    data = load_data(settings, load_skeleton("h36m17"))
    assert data.test is not None and data.train.pose is not None
    assert [len(set(data.train.identity[key])) for key in ("subject", "action", "camera")] == [5, 15, 4]
    assert len(set(data.test.identity["sequence"])) == 30
    assert data.train.fps == 50
    detected = replace(settings, data=replace(settings.data, options={"keypoints": "detected", "fps": 50}))
    noise = load_data(detected, load_skeleton("h36m17")).train.keypoints - data.train.keypoints
    assert np.abs(noise).mean() == pytest.approx(3 * np.sqrt(2 / np.pi), rel=0.05)


def test_both_stages_are_measured_on_both_sets(full, monkeypatch):
    for name, value in (("SMALL", 500), ("_WARM_UP", 1), ("_STEPS", 1), ("_TURNS", 2)):
        monkeypatch.setattr(measure, name, value)
    monkeypatch.setattr(measure, "settings_of", lambda folder, *_: settings_of(
        folder, "priors.flow.steps=1", "teacher.batch_size=16", "student.batch_size=16"
    ))  # fmt: skip
    threads = torch.get_num_threads()
    try:
        found = measure.train(full)
    finally:
        torch.set_num_threads(threads)
    assert found["small_frames"] == 500 < found["frames"]
    for stage in ("teacher", "student"):
        assert found[stage]["steps_per_s"] > 0 and found[stage]["ratio"] > 0


def test_steps_draw_different_rows(full, monkeypatch):
    settings = settings_of(full, "priors.flow.steps=1", "teacher.batch_size=16")
    skeleton = load_skeleton("h36m17")
    frames = KeypointData.of(load_data(settings, skeleton), skeleton, settings).frames(settings.lifter)
    module = teacher(settings, frames)
    drawn, draw = [], LabelledSampler.__call__
    monkeypatch.setattr(LabelledSampler, "__call__", lambda self, count: drawn.append(draw(self, count)) or drawn[-1])
    before = [p.detach().clone() for p in module.lifter.parameters()]
    stepper(module, 16)(2)
    assert not torch.equal(drawn[0], drawn[-1])
    assert any(not torch.equal(a, b) for a, b in zip(before, module.lifter.parameters(), strict=True))


def test_cleaning_in_blocks_gives_the_same_result(full, monkeypatch):
    settings, skeleton = settings_of(full), load_skeleton("h36m17")
    for _ in range(2):  # changes in memory do not reach the cache
        loaded = load_split(settings, "test", skeleton)
        first = loaded.keypoints[0].copy()
        assert first.any()
        loaded.keypoints[0] = 0
    data = loaded.select(np.arange(5000) % len(loaded))
    rng = np.random.default_rng(0)
    data.keypoints[rng.random(data.confidence.shape) < 0.2] = np.nan
    data.confidence[-3:] = 0
    complete, report = clean(data, skeleton, drop=False)
    parts = [clean(data.select(rows), skeleton, drop=False) for rows in np.array_split(np.arange(5000), 3)]
    assert np.array_equal(complete.keypoints, np.concatenate([part.keypoints for part, _ in parts]))
    assert np.array_equal(complete.confidence, np.concatenate([part.confidence for part, _ in parts]))
    assert report.missing_joints == sum(of.missing_joints for _, of in parts) > 0
    assert report.too_few == sum(of.too_few for _, of in parts) >= 3
    order = rng.permutation(5000)  # lenses in order, and mixed
    assert np.array_equal(complete.select(order).straightened().keypoints, complete.straightened().keypoints[order])
