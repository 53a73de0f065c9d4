"""The picture of a skeleton: every joint has its place, sides lie where they should, the file is a PNG."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from uplift.config.files import shipped_names
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.draw import draw_skeleton, rest_pose, skeleton_layout

BLUE, VERMILION = (0, 114, 178), (213, 94, 0)


def nearest(skeleton: Skeleton) -> float:
    place = skeleton_layout(skeleton)
    apart = np.linalg.norm(place[:, None] - place[None], axis=2) + np.eye(len(place)) * 1e9
    return float(apart.min() / np.ptp(place, axis=0).max())


@pytest.mark.parametrize("name", shipped_names("skeletons"))
def test_joints_stand_apart(name):
    skeleton = load_skeleton(name)
    assert np.isfinite(skeleton_layout(skeleton)).all()
    assert nearest(skeleton) > 0.01


@pytest.mark.parametrize("name", ["h36m17", "mediapipe33", "openpose25"])
def test_a_person_faces_us_head_up(name):
    place = dict(zip((skeleton := load_skeleton(name)).joints, skeleton_layout(skeleton), strict=True))
    folded = {joint.casefold(): at for joint, at in place.items()}
    ankles = [at for joint, at in folded.items() if "ankle" in joint]
    assert folded["nose"][1] < min(at[1] for at in ankles)
    for right, left in skeleton.mirror:
        assert place[left][0] > place[right][0]


def test_a_four_legged_body_is_seen_from_above_or_in_3d():
    skeleton = load_skeleton("quadruped28")
    place = dict(zip(skeleton.joints, skeleton_layout(skeleton), strict=True))
    if rest_pose(skeleton) is None:
        assert place["nose"][1] < place["croup"][1] < place["tail_3"][1]
        assert place["L_hip"][0] < place["R_hip"][0]


def test_rest_pose_has_the_lengths_and_directions_it_was_given():
    data = {"joints": ["a", "b", "c"], "root": "a", "bones": [["a", "b"], ["b", "c"]]}
    body = {"rest": {"b": [0, -2, 0], "c": [3, 0, 4]}, "proportions": {"b": 0.5, "c": 10}}
    pose = rest_pose(Skeleton.from_dict(data | body))
    assert pose is not None
    assert np.allclose(pose, [[0, 0, 0], [0, -0.5, 0], [6, -0.5, 8]])
    assert rest_pose(Skeleton.from_dict(data | {"rest": {"b": [0, 1, 0]}})) is None


@pytest.mark.parametrize("name", ["h36m17", "hand21", "chair10"])
def test_picture_is_a_png_with_the_colours_of_the_sides(name, tmp_path):
    skeleton = load_skeleton(name)
    draw_skeleton(skeleton, tmp_path / "s.png")
    with Image.open(tmp_path / "s.png") as image:
        assert image.format == "PNG"
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
    for colour in (BLUE, VERMILION):
        share = (np.abs(pixels.astype(int) - colour).max(1) < 4).mean()
        assert (share > 1e-4) == (bool(skeleton.mirror) or colour == BLUE)


def test_odd_skeletons_are_drawn(tmp_path):
    chain = [f"j{i}" for i in range(60)]
    ring = [[one, other] for one, other in zip(chain, [*chain[1:], chain[0]], strict=True)]
    star = [[chain[0], joint] for joint in chain[1:]]
    for bones, loops in ((ring[:-1], False), (ring, True), (star, False)):
        data = {"joints": chain, "root": "j0", "bones": bones, "loops": loops}
        draw_skeleton(Skeleton.from_dict(data), tmp_path / "odd.png")
        assert (tmp_path / "odd.png").stat().st_size > 1000


def test_a_path_that_cannot_be_written_is_a_clear_error(tmp_path):
    with pytest.raises(UserError, match="cannot write"):
        draw_skeleton(load_skeleton("chair10"), tmp_path / "nowhere" / "s.png")
