"""Splits: by identity and by fraction, in whole clips, the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import body_arrays
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.data.poses import PoseData
from uplift.data.select import chosen_clips, chosen_rows, chosen_windows
from uplift.errors import UserError


def data(frames: int = 60) -> PoseData:
    arrays = body_arrays(frames)
    identity = {key: arrays[key] for key in ("subject", "action", "sequence", "camera", "frame")}
    sure = np.ones((frames, 17), np.float32)
    return PoseData(arrays["keypoints"], sure, tuple(arrays["joint_names"]), identity=identity, source="a.npz")


def test_all_keys_given_must_hold() -> None:
    chosen = data().select(chosen_rows(data(), {"subjects": ["S1", "S3"], "actions": ["sit down"]}))
    assert set(chosen.identity["subject"]) == {"S1", "S3"}
    assert set(chosen.identity["action"]) == {"sit down"}
    assert len(chosen) == 20


def test_numbers_are_chosen_by_their_text() -> None:
    assert chosen_rows(data(), {"cameras": ["0"]}).all()
    assert chosen_rows(data(), {"sequences": ["clip00"]}).sum() == 10


@pytest.mark.parametrize(
    ("choice", "says"),
    [
        ({"subjects": ["s2"]}, "no frame with subject 's2'. Did you mean 'S2'?"),
        ({"cameras": ["1"]}, "no frame with camera '1'"),
        ({"subjects": ["S1"], "sequences": ["clip05"]}, "no frame is left"),
        ({"fraction": 0.0}, "expected more than 0 and at most 1"),
        ({"fraction": 1.5}, "expected more than 0 and at most 1"),
        ({"fraction": float("nan")}, "expected more than 0 and at most 1"),
        ({"fraction": 0.001}, "less than one frame"),
    ],
)
def test_a_choice_that_cannot_be_met(choice: dict, says: str) -> None:
    with pytest.raises(UserError) as caught:
        chosen_rows(data(), choice)
    assert says in str(caught.value)
    assert "a.npz" in str(caught.value)


def test_a_key_the_file_does_not_have() -> None:
    bare = data()
    bare.identity = {"frame": bare.identity["frame"]}
    with pytest.raises(UserError, match=r"has no 'subject' \(identity keys: frame\)"):
        chosen_rows(bare, {"subjects": ["S1"]})


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 9), min_size=1, max_size=12),
    fraction=st.floats(0.01, 1),
    more=st.floats(0, 1),
    seed=st.integers(0, 99),
)
def test_a_fraction_is_whole_clips_but_the_last_and_larger_ones_contain_smaller(sizes, fraction, more, seed) -> None:
    clip = np.repeat(np.arange(len(sizes)), sizes)
    wanted = round(fraction * len(clip))
    if not wanted:
        with pytest.raises(UserError):
            chosen_clips(clip, fraction, seed)
        return
    mask = chosen_clips(clip, fraction, seed)
    assert mask.sum() == wanted
    np.testing.assert_array_equal(mask, chosen_clips(clip, fraction, seed))
    shares = [mask[clip == name].mean() for name in range(len(sizes))]
    assert sum(0 < share < 1 for share in shares) <= 1
    larger = chosen_clips(clip, min(1.0, fraction + more), seed)
    assert (larger | ~mask).all()


def test_another_seed_chooses_other_clips() -> None:
    clip = np.repeat(np.arange(50), 4)
    assert (chosen_clips(clip, 0.3, 0) != chosen_clips(clip, 0.3, 1)).any()


def test_a_fraction_counts_after_the_other_keys() -> None:
    mask = chosen_rows(data(), {"subjects": ["S2"], "fraction": 0.5})
    assert mask.sum() == 10
    assert set(data().identity["subject"][mask]) == {"S2"}


def test_clips_are_one_subject_sequence_camera_and_instance() -> None:
    assert len(set(data().clips())) == 6
    two = data()
    two.identity["camera"] = np.arange(60) % 2
    assert len(set(two.clips())) == 12
    del two.identity["sequence"]
    assert len(set(two.clips())) == 60


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 40), min_size=1, max_size=8),
    fraction=st.floats(0.01, 1),
    more=st.floats(0, 1),
    seed=st.integers(0, 9),
)
def test_a_window_of_each_clip_is_frames_in_a_row_and_larger_ones_contain_smaller(sizes, fraction, more, seed) -> None:
    clip = np.repeat(np.arange(len(sizes)), sizes)
    frame = np.concatenate([np.random.default_rng(seed).permutation(size) for size in sizes])
    counts = [round(fraction * size) for size in sizes]
    if not sum(counts) or not round(fraction * len(clip)):
        with pytest.raises(UserError, match="fraction"):
            chosen_windows(clip, frame, fraction, seed)
        return
    mask = chosen_windows(clip, frame, fraction, seed)
    for name, count in enumerate(counts):
        taken = np.sort(frame[(clip == name) & mask])
        assert len(taken) == count and (np.diff(taken) == 1).all(), "one run of frame numbers"
    assert (chosen_windows(clip, frame, min(1.0, fraction + more), seed) | ~mask).all()


@pytest.mark.parametrize(("length", "first", "count"), [(1383, 403, 138), (2478, 1653, 248), (3000, 1898, 300)])
def test_windows_are_those_of_videopose3d(length: int, first: int, count: int) -> None:
    """The first frames were computed with ``sha256sum`` of the length, its first four bytes from low to high."""
    mask = chosen_windows(np.zeros(length, int), np.arange(length), 0.1, 0)
    np.testing.assert_array_equal(np.flatnonzero(mask), np.arange(first, first + count))
    assert np.flatnonzero(chosen_windows(np.zeros(length, int), np.arange(length), 0.1, 1))[0] != first


def test_the_cameras_of_a_take_share_their_window_and_other_subjects_have_none() -> None:
    two = data()
    two.identity["camera"] = np.tile([0, 1], 30)
    mask = chosen_rows(two, {"subjects": ["S1"], "fraction": 0.4, "of_each_clip": True})
    assert set(two.identity["subject"][mask]) == {"S1"}
    assert len(set(two.clips()[mask])) == len(set(two.clips()[two.identity["subject"] == "S1"]))
    with pytest.raises(UserError, match="of_each_clip=true needs a fraction"):
        chosen_rows(two, {"of_each_clip": True})


def test_a_clip_is_cut_after_its_first_frames_and_the_seed_is_0() -> None:
    clip = np.arange(3000) % 3
    counts = [np.flatnonzero(chosen_clips(clip, 0.5, 3)[clip == one]).tolist() for one in range(3)]
    assert sorted(counts, key=len) == [[], list(range(500)), list(range(1000))]
    by_default, seeds = (
        chosen_rows(data(), {"fraction": 0.3}),
        [chosen_rows(data(), {"fraction": 0.3}, n) for n in (0, 1)],
    )
    assert (by_default == seeds[0]).all() and (by_default != seeds[1]).any()
