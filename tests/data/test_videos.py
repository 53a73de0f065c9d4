"""Whether the frames of a sequence are a film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import body_arrays

from uplift.data.clean import JUMP, clean, jump_of
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton


@pytest.mark.parametrize("name", ["h36m17", "quadruped28", "hand21", "chair10"])
def test_films_are_films_whatever_the_order_of_rows(name: str):
    data = simulate(load_skeleton(name), 1000, seed=1)
    assert 0 < jump_of(data) < JUMP / 2
    mixed = data.select(np.random.default_rng(0).permutation(1000))
    assert jump_of(mixed) == pytest.approx(jump_of(data), rel=0.1)
    assert not clean(data, load_skeleton(name))[0].stills


@pytest.mark.parametrize("numbered", [True, False])
def test_views_of_cameras_of_their_own_are_none(numbered: bool):
    arrays = body_arrays(200, film=False)
    identity = {"sequence": arrays["sequence"]} | ({"frame": arrays["frame"]} if numbered else {})
    data = PoseData(
        arrays["keypoints"], np.ones((200, 17), np.float32), tuple(arrays["joint_names"]), identity=identity
    )
    assert jump_of(data) > 2 * JUMP
    cleaned, report = clean(data, load_skeleton("h36m17"))
    assert cleaned.stills and len(np.unique(cleaned.clips())) == 200 and not cleaned.follows().any()
    assert "jump" in report.lines()[-1]
    assert "sequence" in cleaned.identity  # the output keeps its rows' names


def test_a_body_that_moves_through_the_image_does_not_jump():
    data = simulate(load_skeleton("h36m17"), 300, seed=2)
    shift = np.random.default_rng(0).uniform(-500, 500, (300, 1, 2)).astype(np.float32)
    assert jump_of(replace(data, keypoints=data.keypoints + shift)) == pytest.approx(jump_of(data), rel=1e-3)


def test_nothing_to_compare_is_no_jump():
    data = simulate(load_skeleton("h36m17"), 30, seed=2)
    assert jump_of(replace(data, identity={})) == 0
    assert jump_of(replace(data, confidence=np.zeros_like(data.confidence))) == 0


@pytest.mark.parametrize(
    ("name", "film"), [("cmu/test.npz", True), ("quadruped/test.npz", False), ("hand/test.npz", False)]
)
def test_real_sets(name: str, film: bool, benchmark_data):
    from uplift.data.formats import read

    data = read(benchmark_data(name))
    assert (jump_of(data) < JUMP / 2) if film else (jump_of(data) > 2 * JUMP)


def test_a_quarter_turn_of_a_line_moves_it_by_a_known_share_of_its_size():
    """Ends at -1 and 1 and a middle: the root mean square from the middle is sqrt(2/3), the ends move by sqrt(2)."""
    line = np.array([[-1, 0], [1, 0], [0, 0], [50, 50]], np.float32)
    across = np.array([[0, -1], [0, 1], [0, 0], [-90, 7]], np.float32) + [30, 40]
    sure = np.array([[1, 1, 1, 0.0]] * 3, np.float32)  # the last joint is never seen
    keypoints = np.stack([line, across, across]).astype(np.float32)
    data = PoseData(keypoints, sure, tuple("abcd"), identity={"sequence": np.array(["x"] * 3)})
    turn = 2 * np.sqrt(2) / 3 / np.sqrt(2 / 3)
    assert jump_of(data.select([0, 1])) == pytest.approx(turn)
    assert jump_of(data) == pytest.approx(turn / 2)  # the median of a turn and of a rest
    frame = {**data.identity, "frame": np.array([4, 5, 9])}
    assert jump_of(replace(data, identity=frame)) == pytest.approx(turn)  # frame 9 does not follow frame 5
    assert jump_of(replace(data, identity=frame).select([2, 1, 0])) == pytest.approx(turn)
    four = np.concatenate([keypoints, keypoints[:, :1] * 9], 1)  # a joint that frame 0 or frame 1 does not show
    for row in (0, 1):
        shown = np.c_[sure, np.arange(3) != row].astype(np.float32)
        one = PoseData(four, shown, tuple("abcde"), identity=data.identity).select([0, 1])
        assert jump_of(one) == pytest.approx(turn)
    unseen = replace(data, confidence=sure * np.array([1, 0, 1, 0], np.float32))
    assert jump_of(unseen) == 0  # two joints are too few
