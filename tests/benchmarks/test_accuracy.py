"""The accuracy benchmark: rigs, hidden joints, and the runner that stores results."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from bodies import QUICK, status_of, write_body

from benchmarks.accuracy import __main__ as runner
from benchmarks.accuracy import cells, mended, occlusion, video, work
from benchmarks.accuracy.cells import cells_of, read_fit
from benchmarks.accuracy.occlusion import LIMBS, growth, hidden_joints, occlusion_table, show, write_occluded
from benchmarks.accuracy.rigs import RIGS, TEST_SUBJECTS, build_rigs, camera_axes, film
from benchmarks.accuracy.show import sheets_of
from benchmarks.accuracy.work import fill_in, run_cell
from benchmarks.common import BenchmarkError, markdown, text
from uplift.config.loading import load_settings
from uplift.config.settings import LifterSettings
from uplift.data.formats import read
from uplift.errors import UserError
from uplift.metrics.pose_metrics import facing_sign
from uplift.metrics.scores import Scores
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.skeleton import load_skeleton

HUMAN = load_skeleton("h36m17")
TABLES = yaml.safe_load((Path(cells.__file__).parent / "cells.yaml").read_text())


def a_world(seconds: float = 1.5) -> dict[str, np.ndarray]:
    """Return rigid moving bodies in the layout of world.npz: three sequences of each split."""
    rng = np.random.default_rng(3)
    frames = round(30 * seconds)
    joints, subject, sequence = [], [], []
    for number in range(6):
        body = rng.normal(size=(17, 3)) * 0.3 + [0, 1.0, 0]
        path = np.linspace(0, 1, frames)[:, None, None] * rng.normal(size=3) * [2, 0, 2]
        joints.append(body + path + rng.normal(size=(frames, 17, 3)) * 0.01)
        subject += [["S1", "S5", "S135", "S2"][number % 4]] * frames
        sequence += [f"clip{number}"] * frames
    return {
        "joints": np.concatenate(joints).astype(np.float32),
        "joint_names": np.array(HUMAN.joints),
        "subject": np.array(subject),
        "action": np.array(["walk"] * len(subject)),
        "sequence": np.array(sequence),
        "fps": np.asarray(30, np.float32),
    }


@pytest.mark.parametrize("name", RIGS)
def test_projecting_a_rigs_poses_gives_its_keypoints(name: str) -> None:
    rig = RIGS[name]
    found = film(a_world(), rig, rig.splits[0])
    points = found["pose"].astype(np.float64) + found["root"][:, None]
    rays, centred = points[..., :2] / points[..., 2:], found["keypoints"] - found["image_size"] / 2
    clip = found["camera"] + 10 * np.unique(found["sequence"], return_inverse=True)[1]
    focals = []
    for one in np.unique(clip):  # the focal length of each clip, from all its joints
        here, there = rays[clip == one], centred[clip == one]
        focals.append((here * there).sum() / (here * here).sum())
        assert np.abs(here * focals[-1] - there).max() < 1e-2
    if name == "wide":
        assert "focal_px" not in found and 800 <= min(focals) < 1400 and 1800 < max(focals) <= 2400
    else:
        assert focals == pytest.approx(np.full(len(focals), found["focal_px"]), rel=1e-6)
    assert points[..., 2].min() >= rig.nearest_mm
    assert found["keypoints"].min() > -200.1
    assert (found["keypoints"].max((0, 1)) < found["image_size"] + 200.1).all()
    assert (found["pose"][:, 0] == 0).all()


@pytest.mark.parametrize("name", RIGS)
def test_a_rigs_tilt_is_that_of_gravity(name: str) -> None:
    world = a_world()
    found = film(world, RIGS[name], "test")
    for row in range(0, len(found["frame"]), 7):
        there = np.flatnonzero(world["sequence"] == found["sequence"][row])[found["frame"][row]]
        body = world["joints"][there].astype(np.float64)
        # The rotation from the world to the camera, from the two poses alone.
        turn, *_ = np.linalg.lstsq((body - body[0]) * 1000, found["pose"][row].astype(np.float64), rcond=None)
        assert np.linalg.det(turn) == pytest.approx(1, abs=1e-4)
        gravity = np.array([0, -1.0, 0]) @ turn
        assert gravity[2] == pytest.approx(np.sin(np.radians(found["tilt_deg"][row])), abs=1e-4)
        assert gravity == pytest.approx(found["gravity"][row] if name == "wide" else [0, *gravity[1:]], abs=1e-4)
    assert ("gravity" in found) == (name == "wide")


def test_the_wide_rig_has_cameras_of_every_kind() -> None:
    found = film(a_world(), RIGS["wide"], "test")
    clips = {}
    for row, key in enumerate(zip(found["sequence"], found["camera"], strict=True)):
        clips.setdefault(key, []).append(row)
    gravity = np.stack([found["gravity"][rows[0]] for rows in clips.values()])
    roll = np.degrees(np.arctan2(-gravity[:, 0], gravity[:, 1]))
    assert all((found["gravity"][rows] == found["gravity"][rows[0]]).all() for rows in clips.values())
    assert (
        len(clips) == len(set(found["tilt_deg"])) and found["tilt_deg"].min() >= -20 and found["tilt_deg"].max() <= 50
    )
    assert np.ptp(roll) > 15 and np.abs(roll).max() <= 25
    assert np.ptp(found["root"][:, 2]) > 2000
    assert set(film(a_world(), RIGS["wide"], "unseen")["subject"]) == {"S2"}


def test_rigs_share_no_subject_and_know_their_tilts() -> None:
    world = a_world()
    train, test = (film(world, RIGS["mixed"], split) for split in ("train", "test"))
    assert set(test["subject"]) == {"S5", "S135"} <= set(TEST_SUBJECTS)
    assert set(train["subject"]) == {"S1", "S2"}
    clips = {(s, c): t for s, c, t in zip(train["sequence"], train["camera"], train["tilt_deg"], strict=True)}
    assert len(clips) == len(set(clips.values())) == 3 * 3
    assert 0 <= min(clips.values()) < 12 < 28 < max(clips.values()) <= 40
    assert set(film(world, RIGS["fixed30"], "test")["tilt_deg"]) == {30}
    again = film(world, RIGS["mixed"], "train")
    assert all(np.array_equal(again[key], train[key]) for key in train)


def test_camera_axes_are_a_rotation_without_roll() -> None:
    for tilt, azimuth in np.random.default_rng(0).uniform(0, 1, (20, 2)) * [1.2, 6.3]:
        axes = camera_axes(tilt, azimuth)
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)
        assert axes[0, 1] == pytest.approx(0)


def test_rig_files_are_data_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cmu").mkdir()
    np.savez(tmp_path / "cmu" / "world.npz", **a_world())  # type: ignore[arg-type]
    write_body(tmp_path / "cmu" / "train.npz", subject=np.array(["S1", "S2", "S17"] * 20))
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    monkeypatch.setenv("UPLIFT_BENCHMARK_CACHE", str(tmp_path / "cache"))
    built = build_rigs(tmp_path / "one")
    assert [str(path.relative_to(tmp_path / "one")) for path in built] == [
        f"{rig}/{split}.npz" for rig in ("mixed", "fixed30") for split in ("train", "test")
    ] + ["wide/test.npz", "wide/unseen.npz", "unseen/train.npz", "unseen/test.npz"]
    held_out, known = read(built[-1]), read(built[-2])
    assert set(held_out.identity["subject"]) == {"S2", "S17"} and set(known.identity["subject"]) == {"S1"}
    assert len(held_out) == 40 and held_out.gravity is None and read(built[-4]).gravity is not None
    data = read(built[0])
    assert (data.joint_names, data.fps, data.image_size, data.focal_px) == (HUMAN.joints, 10, (1000, 1000), 1145)
    assert data.follows().sum() == len(data) - 9
    cached = Path(fill_in("{rigs}/mixed/train.npz"))
    assert cached.parent.parent == (tmp_path / "cache").resolve()
    assert cached.read_bytes() == built[0].read_bytes()
    (tmp_path / "cmu" / "world.npz").unlink()
    assert fill_in("{rigs}") == str(cached.parent.parent)
    assert cells.place("wide") == "{rigs}/wide/test.npz" and cells.place("unseen/train") == "{rigs}/unseen/train.npz"
    assert cells.place("cmu/test.npz") == "{data}/cmu/test.npz"
    with pytest.raises(UserError, match="made from cmu/world.npz"):
        build_rigs(tmp_path / "two")


def test_a_rig_of_real_motion_shows_people_facing_forward(benchmark_data) -> None:
    with np.load(benchmark_data("cmu/world.npz")) as file:
        world = {key: file[key] for key in ("joints", "joint_names", "subject", "action", "sequence", "fps")}
    few = np.isin(world["sequence"], np.unique(world["sequence"][world["subject"] == "S5"])[:6])
    part = {key: value[few] if value.shape[:1] == few.shape else value for key, value in world.items()}
    found = film(part, RIGS["mixed"], "test")
    assert facing_sign(found["pose"].astype(np.float64), HUMAN).mean() > 0.97
    with np.load(benchmark_data("cmu/train.npz")) as file:
        assert set(file.files) == set(found)
        assert list(file["joint_names"]) == list(found["joint_names"])


@pytest.fixture(scope="module")
def lifter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an untrained lifter, whose errors are large but constant."""
    settings = LifterSettings(options={"units": 16, "blocks": 1})
    path = tmp_path_factory.mktemp("lifter") / "lifter.pt"
    Model(Lifter(HUMAN, settings).eval(), HUMAN, settings).save(path)
    return path


def test_the_requested_joints_are_hidden() -> None:
    order = np.random.default_rng(5).permutation(17)
    names = [HUMAN.joints[joint] for joint in order]
    sets = hidden_joints(names, 4000, "hip")
    hip = names.index("hip")
    assert list(sets) == ["missing20", "missing20_root", *LIMBS]
    assert sets["missing20_root"].mean() == pytest.approx(0.2, abs=0.01)
    assert not sets["missing20"][:, hip].any()
    others = np.arange(17) != hip
    assert (sets["missing20"] == sets["missing20_root"])[:, others].all()
    for limb, joints in LIMBS.items():
        assert {names[joint] for joint in np.flatnonzero(sets[limb].all(0))} == set(joints)
        assert sets[limb].sum() == 2 * 4000
    assert list(hidden_joints(["tail", "nose"], 5, "nose")) == ["missing20", "missing20_root"]
    with pytest.raises(UserError, match="no root joint 'croup'"):
        hidden_joints(names, 5, "croup")


def test_occluded_files_differ_only_in_the_hidden_joints(tmp_path: Path) -> None:
    test = write_body(tmp_path / "test.npz")
    original = read(test)
    for name, path in write_occluded(test, tmp_path).items():
        data = read(path)
        hidden = hidden_joints(original.joint_names, len(original), "hip")[name]
        assert ((data.confidence == 0) == hidden).all()
        assert (data.keypoints[hidden] == 0).all()
        assert (data.keypoints[~hidden] == original.keypoints[~hidden]).all()
        assert (data.pose == original.pose).all()


def test_growth_compares_the_same_joints(tmp_path: Path, lifter: Path) -> None:
    test = write_body(tmp_path / "test.npz", frames=40)
    same = growth(lifter, test, test)
    assert same["p_mpjpe_growth"] == same["n_mpjpe_growth"] == 1
    assert same["hidden"] == 0
    assert "p_mpjpe_missing" not in same
    written = write_occluded(test, tmp_path)
    found = growth(lifter, test, written["no_arm"])
    assert found["hidden"] == pytest.approx(2 / 17)
    assert found["p_mpjpe_complete"] != same["p_mpjpe"]  # aligned without the two hidden joints
    assert found["p_mpjpe"] / found["p_mpjpe_complete"] == pytest.approx(found["p_mpjpe_growth"])
    assert found["n_mpjpe_missing"] != found["n_mpjpe_missing_complete"]
    table = occlusion_table(lifter, test)
    assert table["no_arm"] == found
    assert [line.split()[0] for line in show(table).splitlines()[3:]] == list(table)
    # A root filled from its neighbours still counts as hidden.
    assert table["missing20_root"]["hidden"] > table["missing20"]["hidden"]
    with pytest.raises(UserError, match="20 frames, but 40"):
        growth(lifter, test, write_body(tmp_path / "short.npz", frames=20))


@pytest.mark.parametrize("table", TABLES)
def test_the_cells_are_valid(table: str) -> None:
    found = cells_of(table, TABLES[table])
    names = {cell.fit.name for cell in found}
    assert len({cell.path for cell in found}) == len(found)
    for cell in found:
        assert cell.fit.reference is None or cell.fit.reference in names
        if cell.fit.skeleton:
            load_skeleton(cell.fit.skeleton)
    for fit in {cell.fit.name: cell.fit for cell in found}.values():
        words = [word for word in shlex.split(fit.command) if "{here}" not in word]
        if not fit.python and not fit.floor:
            task = next((word.removeprefix("task=") for word in words if word.startswith("task=")), None)
            overrides = [word for word in words if not word.startswith("task=")]
            settings = load_settings(task, [*overrides, "trainer.max_time=00:01:00"])
            load_skeleton(settings.skeleton or "h36m17")


def test_baselines_have_no_minutes_and_no_seeds() -> None:
    floor = {"floor": "flat", "train": "a.npz", "test": "b.npz", "skeleton": "h36m17"}
    table = {"minutes": [1, 2], "seeds": [0, 1], "occlusion": True, "fits": {"flat": floor, "cmu": "task=cmu"}}
    found = cells_of("t", table)
    assert [(cell.fit.name, cell.minutes, cell.seed) for cell in found if cell.fit.floor] == [("flat", None, None)]
    assert len(found) == 5
    assert [cell.fit.probes for cell in found[:2]] == [(), ("occlusion",)]
    assert {cell.minutes for cell in cells_of("t", table, minutes=0.5)} == {None, 0.5}


def test_invalid_entries_are_rejected() -> None:
    for entry in ({"run": "x", "fit": "y"}, {"fits": "x"}, {"fit": "x", "seed": 3}, {"floor": "flat"}):
        with pytest.raises(ValueError, match="wrong: "):
            read_fit("wrong", entry, {})


def test_stored_results_are_shown() -> None:
    sheet = sheets_of("peers", TABLES["peers"], cells_of("peers", TABLES["peers"]))[0]
    assert sheet.head[-1] == "p_mpjpe ratio"
    folder = cells.RESULTS / "peers"
    known = [json.loads((folder / f"{name}_4min_seed0.json").read_text()) for name in ("kudo2018_code", "cmu")]
    kudo, cmu = (result["overall"]["p_mpjpe"] for result in known)
    row = next(row for row in sheet.rows if row[:2] == ["cmu", "4min"])
    assert row[2:4] == ["1", f"{cmu:.3f}"]
    assert row[-1] == f"{cmu / kudo:.3f}"
    assert len({len(line) for line in markdown(sheet).splitlines()[3:] for line in [line.split("|")]}) == 1


def test_seeds_are_averaged_with_their_spread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "RESULTS", tmp_path)
    fits = {"ours": {"fit": "task=cmu", "tests": {"other": "x.npz"}, "reference": "theirs"}, "theirs": "task=cmu"}
    found = cells_of("t", {"minutes": [1], "seeds": [0, 1, 2], "fits": fits})
    (tmp_path / "t").mkdir()
    curve = {"visible": {"0.5": 0.4}, "uncertainty_error": 0.1}
    for cell, value in zip(found[:4], (10.0, 20.0, 14.0, 30.0), strict=True):
        more = {"tests": {"other": {"p_mpjpe": 2 * value}}, "calibration": curve} if cell.fit.name == "ours" else {}
        more["occlusion"] = {"no_arm": {"p_mpjpe": value, "p_mpjpe_growth": 1.1}}
        cell.path.write_text(json.dumps({"overall": {"p_mpjpe": value}, **more}))
    errors, occlusion, calibration = sheets_of("t", {}, found)[:3]
    ours, other, theirs = errors.rows
    assert ours[:4] == ["ours", "1min", "2", "12.000 (10.000 to 14.000)"]
    assert other[:4] == ["ours, on other", "1min", "2", "24.000 (20.000 to 28.000)"]
    assert theirs[3] == "25.000 (20.000 to 30.000)"
    assert [row[-1] for row in errors.rows] == ["0.480", "0.960", "-"]
    assert occlusion.rows[0][2:6] == ["no_arm", "-", "12.000 (10.000 to 14.000)", "1.100 (1.100 to 1.100)"]
    assert calibration.rows == [["ours", "1min", "visible", "0.400 (0.400 to 0.400)", "0.100 (0.100 to 0.100)", "-"]]
    assert all(sheet.title in text(sheet) for sheet in (errors, occlusion, calibration))


def a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **fits: object) -> None:
    """Make cells.yaml one table `t` of these fits, with results in ``tmp_path``."""
    path = tmp_path / "cells.yaml"
    path.write_text(yaml.safe_dump({"t": {"minutes": [0.1], "seeds": [0], "fits": fits}}, sort_keys=False))
    monkeypatch.setattr(runner, "_TABLES", path)
    monkeypatch.setattr(cells, "RESULTS", tmp_path / "results")


def test_a_failed_cell_is_reported_and_retried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "count.py"
    script.write_text(
        f"import sys\nopen(r'{tmp_path}/ran', 'a').write(' '.join(sys.argv[1:]) + '\\n')\nsys.exit('no luck')\n"
    )
    unknown = {"fit": "task=cmu", "tests": {"other": {"data": "x.npz", "words": "colour=red"}}}
    a_table(tmp_path, monkeypatch, bad={"run": f"{script} task=cmu"}, unknown=unknown)
    assert runner.main(["t"]) == 1
    printed = capsys.readouterr()
    assert "ended with status 1" in printed.err
    assert "no luck" in printed.err
    assert "`uplift evaluate` does not accept colour=red" in printed.err
    assert "2 cells failed" in printed.err
    assert runner.main(["t", "--only", "bad"]) == 1
    assert (tmp_path / "ran").read_text().splitlines() == ["task=cmu trainer.max_time=00:00:06 seed=0"] * 2
    with pytest.raises(SystemExit):
        runner.main(["t", "--only", "good"])


def _in_this_process(self, words, *, run=None, shown=True) -> str:
    """Run a cell's command in this process, which is faster."""
    command = " ".join(words[1:]).replace("uplift.cli.main", "uplift")
    if shown:
        self.commands.append(fill_in(command.replace(str(run), "RUN"), shown=True))
    filled = [fill_in(word) for word in words]
    with contextlib.chdir(self.folder), pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", filled[1:])
        probe = next((module for module in (occlusion, mended, video) if module.__name__ in filled[1]), None)
        assert (probe.main() if probe else status_of(*filled[2:])) == 0
    return ""


def _no_fit(self, words, **more) -> str:
    assert "fit" not in words
    return _in_this_process(self, words, **more)


def test_a_cell_from_the_fit_to_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    train, other = write_body(tmp_path / "train.npz"), write_body(tmp_path / "other.npz", seed=4)
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    words = ["skeleton=h36m17", "data.train={data}/train.npz", *(w for w in QUICK if "max_time" not in w)]
    monkeypatch.setattr(work._Work, "_run", _in_this_process)
    monkeypatch.setenv("UPLIFT_BENCHMARK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(work, "facts", lambda: {"commit": "abc", "changed": False})
    probes = {"occlusion": True, "mended": True}
    fit = {"fit": shlex.join(words), "test": "train.npz", "tests": {"other": "other.npz"}, **probes}
    a_table(tmp_path, monkeypatch, own=fit)
    assert runner.main(["t"]) == 0
    result = json.loads((tmp_path / "results/t/own_0.1min_seed0.json").read_text())
    assert result["commands"][0].startswith("uplift fit skeleton=h36m17 data.train=$UPLIFT_DATA/train.npz ")
    assert result["commands"][0].endswith(" trainer.max_time=00:00:06 seed=0")
    assert result["commands"][1] == "uplift evaluate run=RUN data.test=$UPLIFT_DATA/train.npz"
    assert str(tmp_path) not in json.dumps(result)
    assert result["overall"]["p_mpjpe"] > 0
    assert result["tests"]["other"]["p_mpjpe"] != result["overall"]["p_mpjpe"]
    assert set(result["occlusion"]) == {"missing20", "missing20_root", *LIMBS}
    assert result["mended"]["frames"] == 60 and result["mended"]["flips_made"] >= 0
    assert sum(of["share"] for of in result["by_trunk_angle"].values()) == pytest.approx(1)
    assert set(result["sections"]["other"]) == {"by_trunk_angle", "signs"}
    assert result["wall_seconds"] > 0
    assert result["lifter_bytes"] > 0
    # Another table with the same fit takes the run that was kept.
    monkeypatch.setattr(work._Work, "_run", _no_fit)
    (again,) = cells_of("again", {"minutes": [0.1], "seeds": [0], "fits": {"own": fit | dict.fromkeys(probes, False)}})
    run_cell(again, os.sched_getaffinity(0))
    assert (kept := again.result()) is not None and "mended" not in kept
    assert kept["commands"][:2] == result["commands"][:2] and kept["overall"] == result["overall"]
    train.unlink()
    other.unlink()
    before = capsys.readouterr().out
    assert runner.main(["t", "--markdown"]) == 0  # stored: the data is not needed again
    assert "| own, on other | 0.1min | 1 |" in capsys.readouterr().out
    assert "own, on other" in before


def test_a_baseline_is_evaluated_like_any_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test = write_body(tmp_path / "test.npz")
    monkeypatch.setenv("UPLIFT_DATA", str(tmp_path))
    monkeypatch.setattr(cells, "RESULTS", tmp_path / "results")
    python = work._Work._run

    def run(self, words, **more):
        if "benchmarks.accuracy.floors" not in words:
            return python(self, words, **more)
        assert words[2:] == ["flat", "{data}/test.npz", "{data}/test.npz", "OUT.npz", "skeleton=h36m17"]
        data = read(test)
        flat = np.concatenate([data.keypoints - data.keypoints[:, :1], np.zeros((len(data), 17, 1))], -1)
        np.savez(self.folder / "OUT.npz", pose=flat, joint_names=np.array(data.joint_names))
        return ""

    monkeypatch.setattr(work._Work, "_run", run)
    floor = {"floor": "flat", "train": "test.npz", "test": "test.npz", "skeleton": "h36m17"}
    (cell,) = cells_of("t", {"minutes": [1], "seeds": [0], "fits": {"flat": floor}})
    run_cell(cell, os.sched_getaffinity(0))
    result = cell.result()
    assert result is not None
    assert result["overall"]["facing"] == 1
    assert result["commands"] == ["uplift evaluate poses=OUT.npz data.test=$UPLIFT_DATA/test.npz skeleton=h36m17"]


def test_a_missing_data_folder_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    with pytest.raises(BenchmarkError, match="UPLIFT_DATA is not set"):
        fill_in("{data}/x.npz")
    assert fill_in("data.train={data}/x.npz task={here}/y.yaml", shown=True) == (
        "data.train=$UPLIFT_DATA/x.npz task=benchmarks/accuracy/y.yaml"
    )


def test_sections_of_several_seeds_and_tests_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "RESULTS", tmp_path)
    table = {"minutes": [1], "seeds": [0, 1], "fits": {"a": {"fit": "task=cmu", "tests": {"unseen": "x.npz"}}}}
    found = cells_of("t", table)
    (tmp_path / "t").mkdir()
    for cell, value in zip(found, (10.0, 20.0), strict=True):
        camera = {
            "p_mpjpe": value,
            "roll_deg": 3.0,
            "roll_deg_clip": 2.0,
            "elevation_deg_clip": 1.0,
            "wrong_signs": 0.1,
        }
        worth = {"count": 5, "likeliest": value, "expected": value, "best_of": 5.0, "weight_error": 0.1}
        worth["calibration"] = {"0.5-0.6": {"said": 0.55, "found": value / 40, "hypotheses": 7}}
        trunk = {"60-90": {"frames": 9, "share": 0.5, "p_mpjpe": 3 * value, "flipped": 0.2, "wrong_signs": 0.1}}
        result = {
            "overall": camera, "tests": {"unseen": {"p_mpjpe": 2 * value}}, "by_trunk_angle": trunk,
            "sections": {"unseen": {"signs": {"hip-rhip": {"wrong": value / 100, "frames": 4}}, "hypotheses": worth}},
            "mended": {"frames": 8, "flips_made": value}, "video": {"blazepose": {"mean": {"p_mpjpe": value, "facing": 1.0}}},
        }  # fmt: skip
        cell.path.write_text(json.dumps(result))
    sheets = {sheet.title.removeprefix("t").removeprefix(": "): sheet for sheet in sheets_of("t", {}, found)}
    assert sheets[""].head[-4:] == ["wrong_signs", "elevation_deg_clip", "roll_deg", "roll_deg_clip"]
    assert sheets["by the trunk's angle from upright"].rows[0][:2] == ["a", "1min"]
    assert sheets["by the trunk's angle from upright"].rows[0][2:6:3] == ["60-90", "45.0 (30.0 to 60.0)"]
    assert sheets["depth signs"].rows == [["a, on unseen", "1min", "hip-rhip", "4 (4 to 4)", "0.150 (0.100 to 0.200)"]]
    assert sheets["clips against single frames"].rows[0][2:] == ["8 (8 to 8)", "15 (10 to 20)"]
    assert sheets["hypotheses, p_mpjpe"].rows[0][3] == "15.0 (10.0 to 20.0)"
    assert sheets["weights of hypotheses"].rows[0][2:] == [
        "0.5-0.6",
        "7 (7 to 7)",
        "0.550 (0.550 to 0.550)",
        "0.375 (0.250 to 0.500)",
    ]
    assert sheets["the real video, 13 joints"].rows[0][2:6] == ["blazepose", "mean", "-", "15.0 (10.0 to 20.0)"]


def test_clips_against_single_frames_counts_what_changed() -> None:
    signs = np.array([[0, 1, np.nan], [1, 1, 0], [0, 0, 0], [1, 0, np.nan]])
    single = Scores({"facing": np.array([1.0, 1, 0, 0]), "p_mpjpe": np.array([10.0, 20, 30, 5])}, wrong=signs)
    after = np.array([[1, 1, np.nan], [0, 0, 0], [0, 0, 1], [1, 0, np.nan]])
    together = Scores({"facing": np.array([0.0, 1, 1, 1]), "p_mpjpe": np.array([12.0, 14, 31, 9])}, wrong=after)
    found = mended.differences(single, together, np.array([0, 0, 1, 2]))
    assert (found["flips_made"], found["flips_mended"]) == (1, 2)
    assert (found["signs"], found["signs_made"], found["signs_mended"]) == (10, 2, 2)
    assert (found["clips"], found["clips_better"], found["clips_worse"]) == (1, 1, 0)


def test_the_real_video_is_scored_over_the_joints_that_detectors_share(benchmark_data, lifter: Path) -> None:
    folder = benchmark_data("beam/cameras.json").parent
    found = video.video(lifter, folder)
    assert set(found) == set(video.DETECTORS)
    # The figures of the file's own README, worked out apart: flat depth, MediaPipe's own 3D, frames that count.
    blazepose = found["blazepose"]
    assert [round(blazepose[f"cam{n}"]["flat"]) for n in video.CAMERAS] == [126, 94, 149, 104]
    assert [round(blazepose[f"cam{n}"]["mediapipe"]) for n in video.CAMERAS] == [79, 72, 92, 88]
    assert [blazepose[f"cam{n}"]["frames"] for n in video.CAMERAS] == [100, 67, 100, 100]
    assert [round(found["body25b"][f"cam{n}"]["flat"]) for n in video.CAMERAS] == [134, 92, 148, 97]
    assert blazepose["mean"]["flat"] == pytest.approx(np.mean([blazepose[f"cam{n}"]["flat"] for n in video.CAMERAS]))
    assert {"tilt_deg", "roll_deg", "facing", "p_mpjpe"} <= set(blazepose["cam1"])
