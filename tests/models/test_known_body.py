"""Which bodies a lifter knows: people and no others for the ready one, whatever the place, the size and the order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import uplift
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.models.known_body import OTHER, STRANGE, check_body, hidden_errors, strangeness, usual_errors
from uplift.models.model import Model
from uplift.skeleton import load_skeleton

ANIMAL = {
    "hip": "croup", "rhip": "R_hip", "rknee": "R_stifle", "rankle": "R_hock", "lhip": "L_hip", "lknee": "L_stifle",
    "lankle": "L_hock", "spine": "back", "thorax": "withers", "nose": "nose", "headtop": "head", "lshoulder": "L_shoulder",
    "lelbow": "L_carpus", "lwrist": "L_front_toe", "rshoulder": "R_shoulder", "relbow": "R_carpus", "rwrist": "R_front_toe",
}  # fmt: skip
"""The joint of a four-legged animal that is most like each of a person's."""


@pytest.fixture(scope="module")
def person() -> Model:
    return uplift.load("person")


@pytest.fixture(scope="module")
def people() -> PoseData:
    return simulate(load_skeleton("h36m17"), 120, seed=3)


def horse() -> PoseData:
    """Return an animal under the names of a person's joints."""
    found = simulate(load_skeleton("quadruped28"), 120, seed=3)
    skeleton = load_skeleton("h36m17")
    places = [found.joint_names.index(ANIMAL[joint]) for joint in skeleton.joints]
    keypoints, confidence = found.keypoints[:, places], found.confidence[:, places]
    return PoseData(keypoints, confidence, skeleton.joints, identity=found.identity, source="horse.csv")


def test_people_are_known_and_animals_are_not(person: Model, people: PoseData) -> None:
    assert check_body(person, people, "person", refuse=True) is None
    with pytest.raises(
        UserError, match=r"horse.csv: these keypoints do not look like the body that person knows .*check=false"
    ):
        check_body(person, horse(), "person", refuse=True)
    warning = check_body(person, horse(), "runs/my/last", refuse=False)
    assert warning is not None
    assert warning.startswith("WARNING: these keypoints do not look like the body that runs/my/last knows")


@pytest.mark.parametrize("seed", range(4))
def test_mixed_up_joints_are_not_known(person: Model, people: PoseData, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(17)
    assert strangeness(person, replace(people, keypoints=people.keypoints[:, order]))[0] > 1.5 * OTHER


def test_place_size_side_and_order_do_not_matter(person: Model, people: PoseData) -> None:
    plain = replace(people, image_size=None, focal_px=None)
    found, frames, by_joint = strangeness(person, plain)
    moved = replace(plain, keypoints=(plain.keypoints * 3 + 700).astype(np.float32))
    assert strangeness(person, moved)[0] == pytest.approx(found, rel=1e-2)
    assert strangeness(person, plain.select(np.arange(len(plain))[::-1]))[0] == pytest.approx(found, rel=0.05)
    swap = list(person.skeleton.mirror_permutation)
    mirrored = replace(plain, keypoints=plain.keypoints[:, swap] * np.array([-1, 1], np.float32))
    assert strangeness(person, mirrored)[0] == pytest.approx(found, rel=0.2)
    assert frames == min(len(plain), 1600 // 17)
    assert np.isnan(by_joint[person.skeleton.root_index])


def test_missing_joints_are_not_strange(person: Model, people: PoseData) -> None:
    complete = strangeness(person, people)[0]
    for share in (0.2, 0.5):
        hidden = np.random.default_rng(0).random(people.confidence.shape) < share
        gaps = replace(people, confidence=np.where(hidden, 0, people.confidence).astype(np.float32))
        assert strangeness(person, gaps)[0] < max(STRANGE, 1.3 * complete)
    few = replace(people, confidence=np.where(np.arange(17) < 4, people.confidence, 0).astype(np.float32))
    assert np.isnan(strangeness(person, few)[0])
    assert check_body(person, few, "person", refuse=True) is None


def test_upside_down_is_another_matter(person: Model, people: PoseData) -> None:
    flipped = replace(
        people, keypoints=people.keypoints * np.array([1, -1], np.float32), image_size=None, focal_px=None
    )
    assert strangeness(person, flipped)[0] > STRANGE
    assert check_body(person, flipped, "person", refuse=True) is None


def test_one_strange_frame_is_not_refused(person: Model) -> None:
    one = horse().select(np.arange(1))
    assert check_body(person, one, "person", refuse=True).startswith("WARNING")  # type: ignore[union-attr]


def test_errors_are_those_of_joints_that_are_hidden_one_at_a_time(person: Model, people: PoseData) -> None:
    few = people.select(np.arange(5))
    errors = hidden_errors(person, few)
    moved = few.keypoints.copy()
    wrist = person.skeleton.index("lwrist")
    moved[:, wrist] += 40
    there = hidden_errors(person, replace(few, keypoints=moved))
    assert np.isnan(errors[:, person.skeleton.root_index]).all()
    assert (np.abs(there - errors)[:, wrist] > 0.05).all()
    usual = usual_errors(person, people)
    assert usual is not None
    shown, halved = usual
    assert 0 < sum(shown) < sum(halved)


def test_a_lifter_that_fills_nothing_in_judges_nobody(person: Model, people: PoseData) -> None:
    bare = replace(person, usual=None)
    assert check_body(bare, horse(), "person", refuse=True) is None
    person.lifter.fill, kept = False, person.lifter.fill
    try:
        assert usual_errors(person, people) is None
    finally:
        person.lifter.fill = kept


def test_what_is_known_is_saved(person: Model, tmp_path) -> None:
    for name in ("a.pt", "a.safetensors"):
        person.save(tmp_path / name)
        assert uplift.load(tmp_path / name).usual == person.usual
    bare = replace(person, usual=None)
    bare.save(tmp_path / "b.pt")
    assert "usual" not in torch.load(tmp_path / "b.pt", weights_only=True)
    bad = torch.load(tmp_path / "a.pt", weights_only=True) | {"usual": [[0.0, -1.0]]}
    torch.save(bad, tmp_path / "c.pt")
    with pytest.raises(UserError, match=r"'usual' has shape \(1, 2\), expected \(2, 17\)"):
        uplift.load(tmp_path / "c.pt")
