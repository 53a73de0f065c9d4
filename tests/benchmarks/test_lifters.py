"""The command that makes the ready lifters: its fits are valid, layouts are as files have them, cards say everything."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.lifters.__main__ import LIFTERS, _weights_in
from benchmarks.lifters.card import card
from benchmarks.lifters.measure import Figures, _as_in, _some_clips
from uplift.config.loading import load_settings
from uplift.data.load import in_joints_of
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton


@pytest.mark.parametrize("name", LIFTERS)
def test_each_fit_is_valid_and_counts_steps(name: str) -> None:
    words = LIFTERS[name]["fit"].split()
    settings = load_settings(words[0].removeprefix("task="), [*words[1:], "trainer.max_time=null"])
    assert settings.trainer.max_steps >= 6000
    assert any(word.startswith("seed=") for word in words)
    assert LIFTERS[name].keys() >= {"title", "layouts", "trained on", "origin", "licence", "limits", "not for"}


def test_a_layout_is_as_a_file_of_it_would_be_built() -> None:
    skeleton, coco = load_skeleton("h36m17"), load_skeleton("coco17")
    data = simulate(skeleton, 20, seed=1)
    made = skeleton.sources["coco17"]
    names = [joint for joint in coco.joints if joint not in coco.midpoints]
    keypoints = np.zeros((20, len(names), 2), np.float32)
    for joint, parts in made.items():
        if len(parts) == 1:
            keypoints[:, names.index(parts[0])] = data.keypoints[:, skeleton.index(joint)]
    file = in_joints_of(PoseData(keypoints, np.ones(keypoints.shape[:2], np.float32), tuple(names)), skeleton)
    found = _as_in("coco17", skeleton, data)
    np.testing.assert_array_equal(found.confidence, file.confidence)
    seen = found.confidence > 0
    np.testing.assert_allclose(found.keypoints[seen], file.keypoints[seen], atol=1e-3)
    assert [joint for joint, shown in zip(skeleton.joints, seen.all(0), strict=True) if not shown] == ["headtop"]


def test_clips_are_chosen_whole() -> None:
    data = simulate(load_skeleton("h36m17"), 4000, seed=1)
    chosen, whole = _some_clips(data), np.bincount(data.clips())
    counts = np.unique(chosen.clips(), return_counts=True)[1]
    assert 500 < len(chosen) < 3000
    assert set(counts) <= set(whole)


def test_a_card_says_everything() -> None:
    found = Figures(
        {"p_mpjpe": 31.96, "n_mpjpe": 40.0}, "mm", 5, {"Layouts that lack joints": [["a", "b"], ["x|y", "1.0"]]}
    )
    text = card("person", LIFTERS["person"], {"seed": "1", "sha256 of the weights": "abc"}, found)
    for part in (
        "# person",
        "32.0 mm",
        "| sha256 of the weights | abc |",
        "NSF EIA-0196217",
        "| x\\|y | 1.0 |",
        "Not for:",
    ):
        assert part in text
    assert all(one in text for one in (*LIFTERS["person"]["limits"], *LIFTERS["person"]["not for"]))


def test_the_hash_is_of_the_weights_alone(tmp_path) -> None:
    import torch

    from uplift.config.safe_weights import save_safe

    state = {"state": {"weight": torch.ones(3, 3)}}
    save_safe(state, tmp_path / "a.safetensors")
    save_safe({**state, "about": {"title": "a longer header"}}, tmp_path / "b.safetensors")
    assert _weights_in(tmp_path / "a.safetensors") == _weights_in(tmp_path / "b.safetensors")
