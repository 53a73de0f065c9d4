"""The benchmark of lifted shapes: fits, held-out species, stored results and tables, the cost of a step."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from benchmarks.common import BenchmarkError, store
from benchmarks.shapes import __main__ as benchmark
from benchmarks.shapes import ceiling, cost, fits
from benchmarks.shapes.fits import COMMANDS, FAMILIES, Cell, cells_of
from uplift.cli import fit
from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.config.settings import Settings
from uplift.data.formats.masks_npz import read_masks_npz
from uplift.data.synthetic.masks import FAMILIES as MADE_UP
from uplift.data.synthetic.masks import simulate_masks
from uplift.metrics.baselines import score_with_baselines, shape_baselines


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of the results, which does not exist yet."""
    file = tmp_path / "stored" / "shapes.json"
    monkeypatch.setattr(fits, "RESULTS", file)
    return file


@pytest.fixture
def task(tmp_path: Path) -> str:
    (tmp_path / "masks_here.yaml").write_text("lifts: masks\ndata: {simulate: 20}\n")
    return str(tmp_path / "masks_here.yaml")


def quick_fit(settings: Settings) -> RunFolder:
    """Make a run of few masks whose shapes are visual hulls; the baselines and the scores are real."""
    data = settings.data
    if data.simulate:
        train = simulate_masks(data.family, 8, seed=settings.seed)
        test = simulate_masks(data.family, 3, seed=settings.seed + 100)
    else:
        train, test = (read_masks_npz(str(path)).select(np.arange(3)) for path in (data.train, data.test))
    run = RunFolder.create(settings, "uplift fit")
    found = shape_baselines(train, test, resolution=16)
    scored = score_with_baselines(found["hull"], train, test, "made-up", found, resolution=24)
    (run.path / "evaluation.json").write_text(json.dumps(scored.to_dict()))
    return run


@pytest.mark.parametrize("command", COMMANDS)
def test_cells_are_settings_of_a_fit(command: str, task: str) -> None:
    cells = cells_of(command, [0, 5], 1.5)
    assert len({cell.key for cell in cells}) == len(cells)
    assert not {cell.key for cell in cells} & {cell.key for cell in cells_of(command, [0, 5])}
    for cell in cells:
        settings = load_settings(task, cell.overrides)
        assert settings.seed == cell.seed and settings.trainer.max_time == "00:01:30"
        assert settings.data.labelled.only == (command == "twin" or cell.name.endswith("_only"))
    assert [cell.seed for cell in cells] == sorted(cell.seed for cell in cells)  # complete rows early
    assert set(FAMILIES) <= set(MADE_UP)


def test_from_the_fit_to_the_table(
    results: Path, task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fit, "fit_settings", quick_fit)
    monkeypatch.setattr(benchmark, "cells_of", lambda *given: [replace(c, task=task) for c in cells_of(*given)])
    runs = tmp_path / "runs here"
    assert benchmark.main(["demo", "--seeds", "0", "1", "--runs", str(runs)]) == 0
    found = json.loads(results.read_text())
    assert list(found) == ["demo_seed0", "demo_seed1"]
    one, two = found.values()
    assert one["command"].endswith(" seed=0") and two["seed"] == 1 and one["commit"]
    assert one["benchmark"] == "python -m benchmarks.shapes demo"
    assert set(one["floors"]) == {"hull", "mean_shape", "nearest"} and one["items"] == 3
    assert len(list(runs.glob("runs/masks_here/*/evaluation.json"))) == 2
    monkeypatch.setattr(fit, "fit_settings", None)  # stored results are not run again
    capsys.readouterr()
    assert benchmark.main(["demo", "--seeds", "0", "1", "--markdown"]) == 0
    printed = capsys.readouterr().out
    lines = [line for line in printed.splitlines() if line.startswith("| demo")]
    row = [cell.strip() for cell in lines[0].strip("|").split("|")]
    unseen = [result["overall"]["silhouette_iou_unseen"] for result in (one, two)]
    gain = [v - r["overall"]["best_floor_silhouette_iou_unseen"] for v, r in zip(unseen, (one, two), strict=True)]
    assert row[:3] == ["demo", "task's", "2"]
    assert float(row[3].split()[0]) == pytest.approx(np.mean(unseen), abs=6e-4)
    assert row[3].endswith(f"({min(unseen):.3f} to {max(unseen):.3f})")
    assert float(row[5].split()[0]) == pytest.approx(np.mean(gain), abs=6e-4)
    assert [line.split("|")[2].strip() for line in lines[1:]] == ["hull", "mean_shape", "nearest"]


def test_the_ceiling_and_the_share_of_it(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "few.yaml").write_text("lifts: masks\ndata: {simulate: 12}\nshape: {elevation_deg: [25, 8]}\n")
    monkeypatch.setattr(fits, "TASK", str(tmp_path / "few.yaml"))
    store(results, "family_cars_seed0", {"overall": {"silhouette_iou_unseen": 0.3, "f_score": 0.2, "volume_iou": 0.1}})
    words = ["ceiling", "--families", "cars", "--seconds", "0.5", "--seeds", "0"]
    assert benchmark.main(words) == 0
    found = json.loads(results.read_text())["ceiling_cars_0.5s_seed0"]
    assert found["steps"] >= 1 and found["items"] == 1 and set(found["floors"]) == {"hull", "mean_shape", "nearest"}
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("cars ")]
    above, mine, floor, share = ([float(cell) if cell != "-" else 0.0 for cell in row[-4:-1]] for row in rows)
    assert above[0] == pytest.approx(found["overall"]["silhouette_iou_unseen"], abs=6e-4) and mine == [0.3, 0.2, 0.1]
    assert floor[0] == pytest.approx(max(of["silhouette_iou_unseen"] for of in found["floors"].values()), abs=6e-4)
    top = found["overall"]["silhouette_iou_unseen"]
    assert share[0] == (pytest.approx(0.3 / top, abs=6e-3) if top else 0.0)


def test_the_supervised_network_stands_shapes_where_the_truth_stands() -> None:
    # Truths as poses and back, and what is seen of them: the camera's formula of `Placed`.
    data = simulate_masks("chairs", 4, seed=0)
    assert data.truth is not None
    pose = ceiling.pose_of(data.truth)
    placed = ceiling.standing_of(pose, 6.0)
    np.testing.assert_allclose(placed.view.numpy(), data.truth.view, atol=1e-5)
    np.testing.assert_allclose(placed.scale.numpy(), data.truth.scale, rtol=1e-5)
    point = np.array([0.2, -0.3, 0.4])
    camera = data.truth.scale[:, None] * (data.truth.view @ point)
    flat = (camera[:, :2] + data.truth.offset) / (1 + camera[:, 2:] / (6 * data.truth.scale[:, None]))
    found = placed.image_of(torch.tensor(point, dtype=torch.float32)[None])[:, 0]
    np.testing.assert_allclose(found.numpy(), flat, atol=1e-5)


def test_modelnet_is_rendered_in_its_split_and_skipped_where_it_is_not(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = trimesh.creation.box((1, 2, 3))
    for part in ("train", "test"):
        (tmp_path / f"chair/{part}").mkdir(parents=True)
        mesh.export(tmp_path / f"chair/{part}/chair_0001.off")
    found = fits.modelnet_masks("chair", tmp_path, tmp_path / "cache")
    train, test = (read_masks_npz(found[part]) for part in ("train", "test"))
    assert (len(train), len(test)) == (4, 1) and train.category is not None and set(train.category) == {"chair"}
    with pytest.raises(BenchmarkError, match=r"has no sofa/train. Download it"):
        fits.modelnet_masks("sofa", tmp_path)
    assert benchmark.main(["modelnet"]) == 0
    assert "modelnet: skipped, no --folder" in capsys.readouterr().out and not results.exists()


def test_failures_are_reported_and_not_stored(
    results: Path, task: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = Cell("demo", 0, task, ("data.simulate=0", "data.famly=chairs"))
    monkeypatch.setattr(benchmark, "cells_of", lambda *given: [nowhere])
    assert benchmark.main(["demo"]) == 1
    error = capsys.readouterr().err
    assert "demo_seed0: uplift fit" in error and "data.family" in error and not results.exists()
    assert benchmark.main(["demo", "--print"]) == 0
    with pytest.raises(SystemExit):
        benchmark.main(["demos"])


def test_species_are_held_out(results: Path, task: str, tmp_path: Path, monkeypatch, benchmark_data) -> None:
    monkeypatch.setenv("UPLIFT_DATA", str(benchmark_data("animal_meshes").parent))
    monkeypatch.setenv("UPLIFT_BENCHMARK_CACHE", str(tmp_path / "cache"))
    sizes = fits.Sizes(simulated=4, poses=2, views=2, test_poses=2)
    monkeypatch.setattr(fits, "Sizes", lambda: sizes)
    found = fits.animal_masks()
    train, test = (read_masks_npz(found[part]) for part in ("train", "test"))
    assert train.truth is not None and test.truth is not None
    assert train.category is not None and test.category is not None
    assert set(test.category) == set(fits.HELD_OUT) and len(test) == 2 * sizes.test_poses
    species = train.category[sizes.simulated :]
    assert len(set(species)) >= 6 and not set(species) & set(fits.HELD_OUT)
    assert len(train) == sizes.simulated + len(set(species)) * sizes.poses * sizes.views
    assert not any("Death" in mesh.name for mesh in (*train.truth.meshes, *test.truth.meshes))
    written = [path.stat().st_mtime_ns for path in found.values()]
    monkeypatch.setattr(fit, "fit_settings", quick_fit)
    [cell] = cells_of("animals", [4])
    result = fits.run_cell(replace(cell, task=task))
    assert written == [path.stat().st_mtime_ns for path in found.values()]
    assert "data.train=$UPLIFT_BENCHMARK_CACHE/shapes/animals_train" in result["command"]
    assert str(tmp_path / "cache") not in results.read_text()
    assert "floors" in result and result["items"] == 3


def test_missing_animals_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    with pytest.raises(BenchmarkError, match="UPLIFT_DATA is not set"):
        fits.animal_masks(tmp_path)
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    with pytest.raises(BenchmarkError, match=r"nothing in animal_meshes, expected .glb files of Cow, ShibaInu"):
        fits.animal_masks(tmp_path)


def test_the_cost_of_a_step_excludes_the_setup(
    results: Path, task: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[tuple[Settings, int]] = []

    def seconds(settings: Settings, data: object, steps: int) -> float:
        """Half a second, and 0.02 s a step at 32."""
        seen.append((settings, steps))
        return 0.5 + 0.02 * steps * settings.shape.detail / 32

    monkeypatch.setattr(cost, "_seconds", seconds)
    monkeypatch.setattr(cost, "MaskDataModule", SimpleNamespace(of=lambda loaded, settings: loaded))
    monkeypatch.setattr("uplift.data.load_masks.load_masks", lambda _: None)
    found = cost.measure(64, 10, threads=1, task=task)
    assert found["seconds_per_step"] == pytest.approx(0.04) and found["threads"] == 1
    assert [steps for _, steps in seen] == [6, 16]
    settings = seen[0][0]
    assert settings.shape.detail == settings.shape.resolution == 64 and settings.trainer.max_time is None
    assert found["peak_gb"] >= found["peak_before_gb"] > 0.05
    monkeypatch.setattr(benchmark, "measured_apart", lambda r, s, t: {**found, "resolution": r, "steps": s})
    assert benchmark.main(["cost", "--resolutions", "16", "48", "--steps", "7"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith(("16", "48"))]
    assert [row[0] for row in rows] == ["16", "48"] and rows[0][4] == "0.040"
    assert list(json.loads(results.read_text())) == ["cost_16", "cost_48"]


def test_a_failing_process_is_reported() -> None:
    with pytest.raises(BenchmarkError, match="cost 7 1 ended with status 2"):
        cost.measured_apart(7, 1)
