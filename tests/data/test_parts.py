"""Files in parts: the parts together are the file, clips stay whole, and shards give back what went in."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uplift.data.formats import read
from uplift.data.formats.npz import read_npz, write_keypoints
from uplift.data.formats.shards import Shards, write_shards
from uplift.data.parts import frames_of, iterate_parts
from uplift.data.pieces import cuts
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.geometry.lens import Lens
from uplift.skeleton import load_skeleton

H36M = load_skeleton("h36m17")
FIELDS = ("keypoints", "confidence", "pose", "root", "tilt_deg", "gravity", "masks", "mask_box")


@pytest.fixture(scope="module")
def people() -> PoseData:
    """Return a thousand frames in clips of 30, some joints missing."""
    return simulate(H36M, 1000, seed=3, missing=0.1)


def same(one: PoseData, other: PoseData, **tolerance: float) -> None:
    """Check that two hold the same frames, whatever their notes and sources."""
    for name in FIELDS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_allclose(a, b, err_msg=name, **(tolerance or {"rtol": 0, "atol": 0}))
    assert set(one.identity) == set(other.identity)
    for key, values in one.identity.items():
        assert (np.asarray(values).astype(str) == np.asarray(other.identity[key]).astype(str)).all(), key
    assert (one.joint_names, one.fps, one.image_size, one.unit) == (
        other.joint_names,
        other.fps,
        other.image_size,
        other.unit,
    )
    assert (one.focal_px, one.lenses, one.stills) == (other.focal_px, other.lenses, other.stills)


def saved(data: PoseData, path: Path, packed: bool = True) -> Path:
    write_keypoints(data, path)
    if not packed:
        with np.load(path) as file:
            np.savez(path, **dict(file))
    return path


@given(st.lists(st.integers(0, 5), min_size=1, max_size=40), st.integers(1, 12))
def test_cuts_keep_clips_whole_and_pieces_small(clip: list[int], frames: int):
    """Every cut leaves each clip on one side, and no piece could have been cut earlier."""
    rows = np.array(clip)
    starts = np.flatnonzero(np.diff(rows, prepend=-1))
    ends = cuts(starts, np.unique(rows[starts], return_inverse=True)[1], len(rows), frames)
    assert ends[0] == 0
    assert ends[-1] == len(rows)
    for start, end in pairwise(ends):
        assert not set(clip[:end]) & set(clip[end:])
        whole = [at for at in range(start + 1, end + 1) if not set(clip[:at]) & set(clip[at:])]
        assert end - start <= frames or whole == [end]
        assert not any(
            end < at <= start + frames and not set(clip[:at]) & set(clip[at:]) for at in range(end + 1, len(clip) + 1)
        )


@pytest.mark.parametrize("packed", [True, False])
def test_parts_of_an_npz_are_the_file(people: PoseData, tmp_path: Path, packed: bool):
    path = saved(people, tmp_path / "people.npz", packed)
    parts = list(iterate_parts(path, 170))
    assert frames_of(path) == 1000
    assert [len(part) for part in parts] == [150] * 6 + [100]  # whole clips of 30
    same(PoseData.concat(parts), read_npz(path))


def test_frames_without_clips_are_cut_anywhere(people: PoseData, tmp_path: Path):
    alone = replace(people, identity={"subject": people.identity["subject"]})
    path = saved(alone, tmp_path / "alone.npz")
    parts = list(iterate_parts(path, 300))
    assert [len(part) for part in parts] == [300, 300, 300, 100]
    same(PoseData.concat(parts), read_npz(path))


def test_clips_that_take_turns_are_one_part(people: PoseData, tmp_path: Path):
    turns = people.select(np.arange(120).reshape(4, 30).T.ravel())
    path = saved(turns, tmp_path / "turns.npz")
    assert [len(part) for part in iterate_parts(path, 60)] == [120]
    write_shards(iterate_parts(path, 60), tmp_path, frames=60)  # which puts them in order
    shards = Shards(tmp_path)
    assert [shard.frames for shard in shards.shards] == [60, 60]
    same(shards.read(), people.select(slice(0, 120)))


def test_per_cent_and_focal_lengths_are_those_of_the_file(people: PoseData, tmp_path: Path):
    """A part of weak keypoints, and one of one camera, is read as the whole file is."""
    confidence = people.confidence * np.linspace(99, 0.5, 1000, dtype=np.float32)[:, None]
    path = tmp_path / "odd.npz"
    focal = np.repeat([900.0, 1100.0], [600, 400])
    with_two = dict(people.identity)
    np.savez(path, keypoints=people.keypoints, confidence=confidence, joint_names=people.joint_names, focal_px=focal,
             image_size=(1000, 1000), **with_two)  # fmt: skip
    parts = list(iterate_parts(path, 90))
    whole = read(path)
    assert whole.confidence.max() <= 1
    np.testing.assert_array_equal(np.concatenate([part.confidence for part in parts]), whole.confidence)
    assert {part.lenses for part in parts} == {whole.lenses}
    np.testing.assert_array_equal(np.concatenate([part.lens for part in parts]), whole.lens)


def test_wrong_npz_files_say_what_the_reader_says(people: PoseData, tmp_path: Path):
    path = tmp_path / "wrong.npz"
    np.savez(path, keypoints=people.keypoints, joint_names=people.joint_names, confidence=people.confidence[:-1])
    with pytest.raises(UserError, match="'confidence' is float32 of shape"):
        list(iterate_parts(path, 100))
    np.savez(path, keypoints=people.keypoints, joint_names=people.joint_names, confidance=people.confidence)
    with pytest.raises(UserError, match="unknown array 'confidance'"):
        list(iterate_parts(path, 100))


@pytest.mark.parametrize("frames", [1, 100, 5000])
def test_shards_give_back_what_went_in(people: PoseData, tmp_path: Path, frames: int):
    index = write_shards([people.select(slice(0, 510)), people.select(slice(510, None))], tmp_path, frames=frames)
    shards = Shards(tmp_path)
    same(shards.read(), people)
    same(read(tmp_path / "shards.json"), people)
    same(PoseData.concat(list(iterate_parts(tmp_path, 333))), people)
    assert sum(one["clips"] for one in index["shards"]) == 34
    assert max(shard.frames for shard in shards.shards) <= max(frames, 30)
    assert len(shards) == frames_of(tmp_path) == 1000


def test_float16_is_off_by_a_2048th_of_the_body(people: PoseData, tmp_path: Path):
    write_shards([people], tmp_path, dtype="float16")
    found = Shards(tmp_path).read()
    seen = people.confidence > 0
    np.testing.assert_array_equal(found.confidence > 0, seen)
    points = np.where(seen[..., None], people.keypoints, np.nan)
    middle = (np.nanmax(points, 1) + np.nanmin(points, 1)) / 2
    away = np.abs(points - middle[:, None])
    off = np.abs(found.keypoints - points)
    assert np.nanmax(off - away / 2048 - 1e-4) < 0
    assert np.nanmean(off) > 1e-3  # it is float16
    assert (found.pose == people.pose).all()
    sizes = [sum(file.stat().st_size for file in tmp_path.rglob(f"{name}.npy")) for name in ("keypoints", "confidence")]
    assert sum(sizes) < 1000 * 17 * 3 * 2 + 1000


def test_files_keep_their_sequences_cameras_and_joints_apart(people: PoseData, tmp_path: Path):
    order = np.random.default_rng(0).permutation(17)
    names = tuple(np.array(people.joint_names)[order])
    first = replace(people.select(slice(0, 60)), source="a.npz")
    second = replace(
        people.select(slice(0, 30)), keypoints=people.keypoints[:30, order] + 5, confidence=people.confidence[:30, order], pose=None,
        root=None, tilt_deg=None, joint_names=names, focal_px=2000.0, source="b.npz", fps=25.0,
    )  # fmt: skip
    write_shards([first, second], tmp_path, several=True)
    found = Shards(tmp_path).read()
    assert sorted(set(found.identity["sequence"])) == ["000000", "000001", "b.npz: 000000"]
    np.testing.assert_array_equal(found.keypoints[60:], first.keypoints[:30] + 5)
    assert np.isnan(found.pose[60:]).all()
    assert found.fps is None
    assert any("fps" in note for note in found.notes)
    assert found.lenses == (Lens.ideal(first.focal_px or 0, (1000, 1000)), Lens.ideal(2000.0, (1000, 1000)))
    assert found.lens is not None
    assert found.lens.tolist() == [0] * 60 + [1] * 30
    with pytest.raises(UserError, match=r"b\.npz: other joints than a\.npz"):
        write_shards([first, replace(second, joint_names=(*names[:-1], "tail"))], tmp_path / "no", several=True)


def test_damaged_shards_are_one_line(people: PoseData, tmp_path: Path):
    write_shards([people], tmp_path)
    index = tmp_path / "shards.json"
    good = json.loads(index.read_text())
    for change, message in (
        ({"format": "else"}, "format is 'else'"), ({"version": 99}, "later version"), ({"shards": [{"name": "../x"}]}, "cannot be read"),
        ({"image_size": "large"}, "cannot be read"), ({"joint_names": ["a"]}, "shape"),
    ):  # fmt: skip
        index.write_text(json.dumps(good | change))
        with pytest.raises(UserError, match=message):
            Shards(tmp_path).read()
    index.write_text(json.dumps(good))
    keypoints = tmp_path / "000000" / "keypoints.npy"
    keypoints.write_bytes(keypoints.read_bytes()[:-10])
    with pytest.raises(UserError, match=r"keypoints\.npy cannot be read"):
        Shards(tmp_path).read()
