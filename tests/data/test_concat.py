"""Frames of several files as one, and which files a path means."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import body_arrays

from uplift.config.files import absolute, files_of
from uplift.data.concat import concat_poses
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import load_skeleton


def part(source: str, frames: int = 4, **more) -> PoseData:
    more.setdefault("keypoints", np.ones((frames, 3, 2), np.float32))
    return PoseData(confidence=np.ones((frames, 3), np.float32), joint_names=("a", "b", "c"),
                    source=source, **more)  # fmt: skip


def test_files_without_names_are_sequences_named_as_they_are():
    both = concat_poses([part("x/one.csv"), part("x/two.csv", 3)])
    assert both.identity["sequence"].tolist() == ["one"] * 4 + ["two"] * 3
    assert len(np.unique(both.clips())) == 2
    assert both.source == "2 files, one.csv to two.csv"


def test_a_name_that_two_files_share_is_told_apart():
    same = {"sequence": np.array(["walk"] * 4), "frame": np.arange(4)}
    both = concat_poses([part("a/v.csv", identity=dict(same)), part("b/v.csv", identity=dict(same))])
    assert len(np.unique(both.clips())) == 2
    assert both.follows().sum() == 6


def test_keys_that_only_one_has_are_blank_for_the_other():
    both = concat_poses([part("a.csv", identity={"instance": np.array(["x"] * 4)}), part("b.csv")])
    assert both.identity["instance"].tolist() == ["x"] * 4 + [""] * 4


def test_photos_make_no_clips():
    photos = [part(f"{name}.json", identity={"image": np.array(["p.jpg"] * 4)}) for name in "ab"]
    assert "sequence" not in concat_poses(photos).identity


def test_what_differs_is_left_out_and_said():
    both = concat_poses([part("a.csv", fps=30.0, focal_px=900.0), part("b.csv", fps=25.0, focal_px=900.0)])
    assert both.fps is None and both.focal_px == 900
    assert both.notes == ("fps is not the same in all 2 files and is not used",)


def test_poses_of_other_units_are_not_joined():
    pose = np.zeros((4, 3, 3), np.float32)
    with pytest.raises(UserError, match="mm and px"):
        concat_poses([part("a.npz", pose=pose), part("b.npz", pose=pose, unit="px")])
    half = concat_poses([part("a.npz", pose=pose), part("b.npz")])
    assert np.isnan(half.pose[4:]).all() and (half.pose[:4] == 0).all()


def test_notes_that_differ_in_numbers_are_told_once():
    notes = [("read as csv", "3 of 7 are weak"), ("read as csv", "5 of 70 are weak"), ("read as csv",)]
    joined = concat_poses([part(f"{n}.csv", notes=told) for n, told in enumerate(notes)])
    assert joined.notes == ("read as csv", "3 of 7 are weak (the like in 2 of 3 files)")


def test_one_file_is_itself():
    one = part("a.csv")
    assert concat_poses([one]) is one


def test_paths(here: Path):
    for name in ("b1.csv", "a1.csv", "odd,name.csv"):
        (here / name).write_text("x")
    assert files_of("odd,name.csv") == [Path("odd,name.csv")]
    assert files_of("*1.csv") == [Path("a1.csv"), Path("b1.csv")]
    assert files_of("b1.csv,a1.csv") == [Path("b1.csv"), Path("a1.csv")]
    assert files_of("b1.csv,*1.csv") == [Path("b1.csv"), Path("a1.csv")]
    assert absolute("b1.csv,*1.csv") == f"{here / 'b1.csv'},{here / '*1.csv'}"
    assert absolute("odd,name.csv") == str(here / "odd,name.csv")
    for wrong, says in (
        ("none.csv", "No file none.csv"),
        ("a1.csv,none.csv", "No file none.csv"),
        ("*9.csv", "No file matches"),
    ):
        with pytest.raises(UserError, match=says.replace("*", r"\*")):
            files_of(wrong)


def test_several_files_are_loaded_as_one(here: Path):
    skeleton = load_skeleton("h36m17")
    for number in (0, 1):
        arrays = body_arrays(20, seed=number)
        arrays["joint_names"] = arrays["joint_names"][::-1] if number else arrays["joint_names"]
        for key in ("keypoints", "pose"):
            arrays[key] = arrays[key][:, ::-1] if number else arrays[key]
        np.savez(here / f"f{number}.npz", **arrays)
    data = load_file("f*.npz", skeleton)
    assert len(data) == 40
    alone = load_file("f1.npz", skeleton)
    np.testing.assert_array_equal(data.keypoints[20:], alone.keypoints)
    np.testing.assert_array_equal(data.pose[20:], alone.pose)
    assert len(np.unique(data.clips())) == 2 * len(np.unique(alone.clips()))


def test_rows_of_a_clip_are_brought_together_in_time():
    frame = np.array([3, 0, 1, 0, 2, 1])
    who = np.array(["x", "x", "x", "y", "x", "y"])
    data = part("v.csv", 6, identity={"sequence": np.array(["v"] * 6), "instance": who, "frame": frame})
    ordered = data.select(data.in_order())
    assert ordered.identity["instance"].tolist() == ["x"] * 4 + ["y"] * 2
    assert ordered.identity["frame"].tolist() == [0, 1, 2, 3, 0, 1]
    assert ordered.follows().tolist() == [False, True, True, True, False, True]
    loose = replace(data, identity={})
    assert loose.in_order().tolist() == list(range(6))


def test_cameras_of_several_files_keep_their_focal_lengths():
    """A point at x/z = 0.1, y/z = -0.2 of each camera is at the same place for both, once they are one camera."""
    sizes, focals = [(1000, 800), (640, 480)], [900.0, 450.0]
    parts = []
    for name, (width, height), focal in zip("ab", sizes, focals, strict=True):
        keypoints = np.tile(np.float32([width / 2 + 0.1 * focal, height / 2 - 0.2 * focal]), (4, 3, 1))
        parts.append(part(f"{name}.csv", focal_px=focal, image_size=(width, height), keypoints=keypoints))
    both = concat_poses(parts)
    np.testing.assert_allclose(both.rays(), np.tile([0.1, -0.2], (8, 3, 1)), atol=1e-6)
    assert both.straightened().focal_px == 675 and both.notes == ()
    unknown = concat_poses([parts[0], part("c.csv", image_size=(640, 480))])
    assert unknown.rays() is None and "focal_px is not the same in all 2 files and is not used" in unknown.notes
