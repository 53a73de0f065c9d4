"""Unnamed keypoints are taken for the layout whose bones are short."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO, OPENPOSE, SHIPPED, likely_layout, names_for
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton
from uplift.skeleton.match import build_joints

PEOPLE = [name for layouts in SHIPPED.values() for _, name in layouts if name in
          ("openpose25", "coco17", "h36m17", "halpe26", "mpi_inf_3dhp17")]  # fmt: skip


def joints(name: str) -> tuple[str, ...]:
    skeleton = load_skeleton(name)
    return tuple(joint for joint in skeleton.joints if joint not in skeleton.midpoints)


@pytest.mark.parametrize(("seed", "missing"), [(0, 0.0), (1, 0.3)])
@pytest.mark.parametrize("name", PEOPLE)
def test_bodies_are_found_in_their_own_layout(name: str, seed: int, missing: float):
    data = simulate(load_skeleton(name), 60, seed=seed)
    names = joints(name)
    keypoints, sure, _ = build_joints(data.keypoints, data.confidence, data.joint_names, load_skeleton(name))
    columns = [load_skeleton(name).index(joint) for joint in names]
    gone = np.random.default_rng(seed).random((60, len(names))) < missing
    layouts = [(shipped, joints(shipped)) for _, shipped in SHIPPED[len(names)]]
    found = likely_layout(keypoints[:, columns], np.where(gone, 0, sure[:, columns]).astype(np.float32), layouts)
    assert layouts[found][0] == name


def test_the_usual_layout_is_kept_where_nothing_can_be_told():
    layouts = [(shipped, joints(shipped)) for _, shipped in SHIPPED[17]]
    noise = np.random.default_rng(0).uniform(0, 100, (50, 17, 2)).astype(np.float32)
    assert likely_layout(noise, np.ones((50, 17), np.float32), layouts) == 0
    assert likely_layout(noise, np.zeros((50, 17), np.float32), layouts) == 0
    assert likely_layout(noise[:0], np.ones((0, 17), np.float32), layouts) == 0


def test_what_the_user_says_wins_and_the_note_says_how():
    data = simulate(load_skeleton("h36m17"), 60, seed=1)
    names, notes = names_for(Path("a.json"), 17, COCO, ReadOptions(), data.keypoints)
    assert names == load_skeleton("h36m17").joints
    assert "Human3.6M" in notes[0] and "layout=coco17 overrules" in notes[0]
    told, notes = names_for(Path("a.json"), 17, COCO, ReadOptions(layout="coco17"), data.keypoints)
    assert told == joints("coco17") and not notes


def test_every_layout_of_a_number_has_that_many():
    for count, layouts in SHIPPED.items():
        assert all(len(joints(name)) == count for _, name in layouts)
    assert OPENPOSE[25][0] == SHIPPED[25][0][0] and COCO[17][0] == SHIPPED[17][0][0]
    assert COCO[26][0] == SHIPPED[26][0][0]


@pytest.mark.parametrize("folder", ["single_person_cam01_json", "two_persons_cam02_json"])
def test_real_files_in_another_order_of_as_many_joints(folder: str, benchmark_data):
    data = read(benchmark_data(f"trackers/openpose/{folder}"))
    assert data.joint_names == joints("openpose25b")
    neck, shoulders = data.joint_names.index("UpperNeck"), [data.joint_names.index(f"{s}Shoulder") for s in "LR"]
    seen = (data.confidence[:, [neck, *shoulders]] > 0).all(1)
    off = np.linalg.norm(data.keypoints[:, neck] - data.keypoints[:, shoulders].mean(1), axis=-1)[seen]
    size = np.ptp(data.keypoints[seen], axis=1).max(-1)
    assert np.median(off / size) < 0.15
