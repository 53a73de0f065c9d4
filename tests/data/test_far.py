"""Keypoints far outside everything else are told, with frame, joint and numbers, and are missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import uplift
from uplift.cli.data_check import check_data
from uplift.cli.skeleton import map_joints
from uplift.data.far import without_far
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.skeleton import Skeleton

NAMES = ("a", "b", "c", "d", "e")
STAR = Skeleton("star", NAMES, "a", tuple(("a", name) for name in NAMES[1:]), gravity=False)
STAR_FILE = "joints: [a, b, c, d, e]\nroot: a\nbones: [[a, b], [a, c], [a, d], [a, e]]\ngravity: false\n"


def walk(frames: int = 50) -> np.ndarray:
    """A body of 200 px that crosses the image."""
    body = np.array([[0, 0], [100, 0], [-100, 0], [0, 100], [0, -100]], np.float32)
    return body + np.stack([400 + 10 * np.arange(frames), np.full(frames, 300)], 1)[:, None].astype(np.float32)


def data_of(keypoints: np.ndarray) -> PoseData:
    frames = np.arange(len(keypoints)) + 100
    return PoseData(keypoints, np.ones(keypoints.shape[:2], np.float32), NAMES, identity={"frame": frames})


def test_a_slip_is_missing_and_told_with_its_numbers() -> None:
    points = walk()
    points[7, 3] = 1e6, -1e6
    found = without_far(data_of(points))
    assert np.argwhere(found.confidence == 0).tolist() == [[7, 3]]
    kept = found.confidence > 0
    np.testing.assert_array_equal(found.keypoints[kept], walk()[kept])
    assert found.notes == (
        "WARNING: 1 keypoint is far outside everything else and taken as missing: d in frame 107 at (1,000,000, "
        "-1,000,000), the frame's others about (470, 300), mostly within 100 px",
    )


@pytest.mark.parametrize("away", [0, 300, 2000])
def test_what_is_near_or_elsewhere_as_a_whole_stays(away: float) -> None:
    points = walk()
    points[7, 3] += min(away, 300)
    points[20] += away * 100  # the whole body, as another camera or another body
    found = without_far(data_of(points))
    assert found.notes == ()
    assert (found.confidence == 1).all()


def test_many_slips_are_counted_and_the_first_are_named() -> None:
    points = walk()
    points[10:15, 1] = -50_000
    points[30, 4] = 1e30
    found = without_far(data_of(points))
    assert (found.confidence == 0).sum() == 6
    assert "6 keypoints are far outside" in found.notes[0]
    assert "; and 3 more" in found.notes[0]


def test_missing_and_empty_files_stay() -> None:
    points = walk(3)
    points[1] = np.nan
    assert without_far(data_of(points)).notes == ()
    assert len(without_far(data_of(walk(0)))) == 0


def test_every_way_to_read_tells_it(tmp_path: Path) -> None:
    points = walk()
    points[7, 3] = 1e6, -1e6
    rows = ["frame," + ",".join(f"{name}_x,{name}_y" for name in NAMES)]
    rows += [f"{frame}," + ",".join(map(str, values.ravel())) for frame, values in enumerate(points)]
    (tmp_path / "walk.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "star.yaml").write_text(STAR_FILE)
    path, skeleton = str(tmp_path / "walk.csv"), f"skeleton={tmp_path / 'star.yaml'}"
    module = uplift.KeypointData(points, skeleton=STAR, val=0)
    told = {
        "fit, predict": load_file(path, STAR).notes,
        "map": map_joints([path, skeleton])[0],
        "check": check_data([f"data.train={path}", skeleton])[0],
        "module": module.notes,
    }
    for verb, lines in told.items():
        assert "d in frame 7 at (1,000,000, -1,000,000)" in "\n".join(lines), verb
    assert (module.train_samples.confidence == 0).sum() == 1


def test_far_is_from_the_files_middle_wherever_that_is() -> None:
    points = walk() + 100_000
    points[7, 3] = 0
    found = without_far(data_of(points.astype(np.float32)))
    assert np.argwhere(found.confidence == 0).tolist() == [[7, 3]]


@pytest.mark.parametrize(
    ("others", "slip", "taken"),
    [(500, 500 + 0.99 * 4500, False), (500, 500 + 1.01 * 4500, True), (4640, 5090, True), (4800, 5090, False)],
)
def test_far_is_five_times_nine_tenths_of_the_file_and_twenty_times_the_frames_spread(others, slip, taken) -> None:
    """Bodies without extent from 0 to 1000: nine tenths are 900 px, a fiftieth of that, 18 px, is the least spread."""
    points = np.zeros((20_001, 5, 2), np.float32)
    points[:, :, 0] = np.linspace(0, 1000, 20_001)[:, None]
    points[77, :, 0] = [others, others, slip, others, others]
    assert np.argwhere(without_far(data_of(points)).confidence == 0).tolist() == ([[77, 2]] if taken else [])
