"""The reading benchmark on small files: every format is measured, and what is read is what was written."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reading import __main__ as reading
from benchmarks.reading import measure
from benchmarks.reading.bodies import Walk
from benchmarks.reading.cells import CELLS
from benchmarks.reading.text_files import GAP, decimals, filled, whole_numbers, words
from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.export import WRITERS

ROWS = 300
_NEEDS = {"deeplabcut h5": "tables"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("reading")


def test_every_format_has_a_cell():
    assert {cell.format for cell in CELLS} == set(KEYPOINT_FORMATS) - {"shards"}  # a folder, made of any of the others
    assert len({cell.name for cell in CELLS}) == len({cell.file for cell in CELLS}) == len(CELLS)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.name)
def test_a_file_is_written_and_read_as_its_format(cell, folder):
    pytest.importorskip(_NEEDS.get(cell.name, "numpy"))
    if cell.format in ("sleap_slp", "sleap_h5", "nwb", "jabs"):
        pytest.importorskip("h5py")
    path = folder / cell.file
    expected = measure.make(cell.name, path, ROWS)
    found = measure.read_file(cell.name, path)
    assert (found["rows"], found["joints"]) == (ROWS, cell.joints) and expected["bytes"] > 1000
    assert found["cpu_s"] > 0 and found["peak_gb"] > 0.01


def test_wrong_results_of_reading_are_detected(folder):
    path = folder / "checked.npz"
    measure.make("npz", path, ROWS)
    expected, data = json.loads(measure.expected_file(path).read_text()), read(path)
    measure.check(data, expected)
    moved = data.keypoints + np.float32(0.01)
    for wrong in (
        data.select(np.arange(ROWS - 1)),
        replace(data, keypoints=moved),
        replace(data, confidence=data.confidence * np.float32(0.9)),
        replace(data, identity={**data.identity, "frame": data.identity["frame"] + 1}),
    ):
        with pytest.raises(SystemExit):
            measure.check(wrong, expected)


def test_results_are_stored_one_by_one_and_shown(tmp_path, capsys, monkeypatch):
    out = tmp_path / "results" / "reading.json"
    words = ["--rows", str(ROWS), "--frames", "100", "--times", "1", "--out", str(out)]
    assert reading.main([*words, "--only", "videopose3d", ".trc", "--folder", str(tmp_path)]) == 0
    found = json.loads(out.read_text())
    assert list(found["read"]) == ["videopose3d"] and list(found["write"]) == ["write .trc"]
    assert found["read"]["videopose3d"]["rows"] == ROWS and found["commit"] and str(tmp_path) not in out.read_text()
    assert found["command"] == "python -m benchmarks.reading --rows=300 --frames=100 --times=1"
    assert "| videopose3d | 300 | 17 |" in capsys.readouterr().out
    done = {"wall_s": 1.0, "cpu_s": 2.0, "peak_gb": 0.5, "rows": ROWS, "joints": 17, "frames": 100, "bytes": 9}
    asked = []

    def process(*words):
        asked.append(words)
        if words[0] == "make":
            measure.expected_file(words[2]).write_text(json.dumps({"bytes": 9, "making_cpu_s": 1.0}))
        return dict(done)

    monkeypatch.setattr(reading, "_process", process)
    assert reading.main(words) == 0
    assert not any(words[1] == "videopose3d" for words in asked)  # it is stored
    found = json.loads(out.read_text())
    assert list(found["read"]) == [cell.name for cell in CELLS]
    assert list(found["write"]) == [f"write {ending}" for ending in WRITERS["poses"]]
    assert {cell.format for cell in CELLS if cell.name in found["read"]} == set(KEYPOINT_FORMATS) - {"shards"}
    asked.clear()
    capsys.readouterr()
    assert reading.main([*words, "--print"]) == 0
    printed = capsys.readouterr().out
    assert not asked and all(f"| {cell.name} |" in printed for cell in CELLS)
    assert "json 2.00 s, ratio 1.0" in printed


@pytest.mark.parametrize("ending", [".npz", ".csv", ".json"])
def test_a_writer_is_measured(ending, tmp_path):
    found = measure.write_prediction(ending, tmp_path, 50)
    assert found["bytes"] == (tmp_path / f"walk{ending}").stat().st_size > 1000
    assert found["frames"] == 50 and found["cpu_s"] > 0


def test_templates_are_filled_with_numbers():
    values = np.array([[0.5, 12.25], [123.000001, 0.0]])
    missing = np.array([[False, False], [False, True]])
    numbers = decimals(values, 8, missing, "nan")
    text = filled(f"<{GAP},{GAP}|{GAP}|{GAP}>", [numbers, whole_numbers(np.array([7, 1230]))[:, None], words(["a"], 2)])
    first, second = text.decode()[1:-1].split("><")
    assert first.startswith("0.500000") and first.endswith("|7|a") and ",12.250000" in first
    assert second.startswith("123.000001") and second.endswith(",nan|1230|a")
    assert [len(part) for part in first.split("|")[0].split(",")] == [10, 11]


def test_bodies_are_deterministic_and_move_smoothly():
    one, two = (Walk(20_000, bodies=2).all_frames() for _ in range(2))
    assert np.array_equal(one.xy, two.xy) and one.xy.shape == (10_000, 2, 17, 2)
    assert one.frame.tolist() == list(range(10_000))
    assert np.abs(np.diff(one.xy.mean(2), axis=0)).max() < 10
    assert 0.04 < one.missing.mean() < 0.06
