"""`uplift data cmu`: from files as CMU and cgspeed give them to what a fit reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mocap_files import expected, motion, write_amc, write_asf, write_bvh

from uplift.cli.data_cmu import make_cmu_files
from uplift.data.datasets.cmu import JOINTS
from uplift.data.formats import read
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.metrics.pose_metrics import facing_sign
from uplift.skeleton import load_skeleton


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Return a folder with three subjects: two as .amc, one as .bvh."""
    folder = tmp_path / "cmu"
    for subject, scale in (("01", 1.0), ("35", 0.9)):
        (folder / subject).mkdir(parents=True)
        write_asf(folder / subject / f"{subject}.asf", scale)
        for trial in (1, 2):
            write_amc(folder / subject / f"{subject}_0{trial}.amc", motion(60, trial))
    write_bvh(folder / "12_01.bvh", motion(60, 7), scale=1.1)
    return folder


def run(*words: object) -> list[str]:
    return list(make_cmu_files([str(word) for word in words]))


def test_the_files_hold_the_motions_as_the_cameras_see_them(files: Path, tmp_path: Path):
    output = tmp_path / "out"
    said = run(files, f"output={output}", "test=S35", "fps=30", "cameras=3", "image_size=1280x720", "focal_px=900")
    assert said[0].startswith("5 motions of 3 subjects")
    assert said[-1] == f"next: uplift fit task=cmu data.root={output}"
    assert "mocap.cs.cmu.edu" in said[-2]
    train, test = read(output / "train.npz"), read(output / "test.npz")
    assert set(train.identity["subject"]) == {"S1", "S12"}
    assert set(test.identity["subject"]) == {"S35"}
    assert (len(train), len(test)) == (3 * 3 * 15, 2 * 3 * 15)
    for data in (train, test):
        assert (data.fps, data.focal_px, data.image_size, data.unit) == (30, 900, (1280, 720), "mm")
        assert data.pose is not None and data.root is not None
        points = data.pose.astype(np.float64) + data.root[:, None]
        again = 900 * points[..., :2] / points[..., 2:] + [640, 360]
        assert np.abs(again - data.keypoints).max() < 1e-3
        assert load_file(output / "test.npz", load_skeleton("h36m17")).joint_names == JOINTS


@pytest.mark.parametrize(("sequence", "seed", "scale", "bvh"), [("01_02", 2, 1.0, False), ("12_01", 7, 1.1, True)])
def test_distances_between_joints_are_those_of_the_motion(files: Path, tmp_path: Path, sequence, seed, scale, bvh):
    run(files, f"output={tmp_path / 'out'}", "fps=20", "test=S35")
    data = read(tmp_path / "out" / "train.npz")
    rows = (data.identity["sequence"] == sequence) & (data.identity["camera"] == 2)
    truth = expected(motion(60, seed), scale, as_bvh=bvh)
    world = np.stack([truth[joint] for joint in JOINTS], 1)[::6]
    assert data.pose is not None
    ours, theirs = (
        np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) for points in (data.pose[rows], world)
    )
    assert np.abs(ours - theirs).max() < 0.02


def test_an_index_names_the_actions(files: Path, tmp_path: Path):
    (files / "cmu-mocap-index-text.txt").write_text("Subject #1 (walk)\n\n01_01\twalk\n01_02\trun/jog\n")
    said = run(files, f"output={tmp_path / 'out'}", "test=S35")
    assert any("index" in line for line in said)
    action = read(tmp_path / "out" / "train.npz").identity["action"]
    assert set(action) == {"walk", "run/jog", "unknown"}


def test_without_an_index_there_are_no_actions(files: Path, tmp_path: Path):
    run(files, f"output={tmp_path / 'out'}")
    assert "action" not in read(tmp_path / "out" / "train.npz").identity


def test_the_same_words_write_the_same_numbers(files: Path, tmp_path: Path):
    for name in ("a", "b"):
        run(files, f"output={tmp_path / name}", "seed=3")
    for name in ("train.npz", "test.npz"):
        first, second = read(tmp_path / "a" / name), read(tmp_path / "b" / name)
        assert np.array_equal(first.keypoints, second.keypoints)
        assert np.array_equal(first.identity["sequence"], second.identity["sequence"])


def test_nothing_is_overwritten(files: Path, tmp_path: Path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "test.npz").write_text("mine")
    with pytest.raises(UserError, match=r"test\.npz exists already and is not overwritten"):
        run(files, f"output={tmp_path / 'out'}")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["test.npz"]
    assert (tmp_path / "out" / "test.npz").read_text() == "mine"


def test_a_damaged_file_leaves_nothing_behind(files: Path, tmp_path: Path):
    path = files / "35" / "35_02.amc"
    path.write_text(path.read_text()[:-40])
    with pytest.raises(UserError, match=r"35_02\.amc, line \d+"):
        run(files, f"output={tmp_path / 'out'}")
    assert not (tmp_path / "out").exists()
    run(files, f"output={tmp_path / 'out'}", "skip=35_02")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["DIR"], "needs output="),
        (["output=OUT"], "takes one FOLDER"),
        (["DIR", "DIR", "output=OUT"], "takes one FOLDER"),
        (["DIR", "output=OUT", "camera=4"], "'camera=.' is not one of its settings. Did you mean 'cameras'"),
        (["DIR", "output=OUT", "fps="], "'fps=' has no value"),
        (["DIR", "output=OUT", "fps=fast"], "fps='fast', expected a number above 0"),
        (["DIR", "output=OUT", "fps=7"], "cannot be thinned out to fps=7"),
        (["DIR", "output=OUT", "cameras=2.5"], "cameras=2.5, expected a whole number"),
        (["DIR", "output=OUT", "cameras=0"], "from 1 to 100"),
        (["DIR", "output=OUT", "image_size=big"], "image_size='big'"),
        (["DIR", "output=OUT", "focal_px=0"], "focal_px=0, expected a number above 0"),
        (["DIR", "output=OUT", "tilt=nan"], "tilt='nan'"),
        (["DIR", "output=OUT", "test=S99"], "test=S99: no such subject or motion"),
        (["DIR", "output=OUT", "rate=S99:60"], "rate=S99:...: no such subject or motion"),
        (["DIR", "output=OUT", "rate=S35:slow"], "rate='slow'"),
        (["DIR", "output=OUT", "index=DIR/none.txt"], "No index file"),
        (["DIR", "output=OUT", "unit_mm=1"], "thigh and shin are .* Say the unit with unit_mm="),
        (["DIR", "output=OUT/deep"], "no folder .* Create it first"),
        (["DIR", "output=DIR/12_01.bvh"], "is a file, expected a folder"),
        (["DIR/none", "output=OUT"], "No folder"),
    ],
)
def test_wrong_words_are_one_message(files: Path, tmp_path: Path, words: list[str], message: str):
    swapped = [word.replace("DIR", str(files)).replace("OUT", str(tmp_path / "out")) for word in words]
    with pytest.raises(UserError, match=message):
        run(*swapped)
    assert not (tmp_path / "out").exists()


def test_a_slow_capture_counts_time_as_the_others(files: Path, tmp_path: Path):
    run(files, f"output={tmp_path / 'out'}", "rate=S1:60", "test=S35")
    data = read(tmp_path / "out" / "train.npz")
    assert ((data.identity["sequence"] == "01_01") & (data.identity["camera"] == 0)).sum() == 10
    assert ((data.identity["sequence"] == "12_01") & (data.identity["camera"] == 0)).sum() == 5
    assert set(np.diff(data.identity["frame"][:10])) == {12}


def test_progress_is_said_while_many_files_are_read(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("uplift.cli.data_cmu._EVERY_S", 0.0)
    said = run(files, f"output={tmp_path / 'out'}")
    assert "read 3 of 5 motions" in said


def test_real_clips_of_three_kinds_become_people_the_right_way_round(benchmark_data, tmp_path: Path):
    folder = tmp_path / "real"
    folder.mkdir()
    for name in ("asf_amc/35.asf", "asf_amc/35_01.amc", "bvh/cmu_12_01_walk.bvh", "bvh/09_03.bvh"):
        path = benchmark_data(f"trackers/{name}")
        (folder / path.name).symlink_to(path)
    run(folder, f"output={tmp_path / 'out'}")
    skeleton = load_skeleton("h36m17")
    for name in ("train.npz", "test.npz"):
        data = load_file(tmp_path / "out" / name, skeleton)
        assert data.pose is not None
        assert np.nanmean(facing_sign(data.pose, skeleton) > 0) > 0.95
        height = data.pose[:, JOINTS.index("lankle"), 1] - data.pose[:, JOINTS.index("headtop"), 1]
        assert 1100 < np.median(height) < 1700  # upright: y is down
