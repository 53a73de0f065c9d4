"""MediaPipe's networks: the geometry around them by hand, and the whole against what MediaPipe itself finds in a photo."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import skimage
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from uplift.errors import UserError
from uplift.skeleton import load_skeleton
from uplift.video import weights
from uplift.video.blazepose import BlazeHand, BlazePose, _along, _anchors, _crop, _hand, _merged, _refined, _Region
from uplift.video.detector import make_detector
from uplift.video.weights import find_network, has_networks

# Geometry.


def dot(x: float, y: float, size: tuple[int, int] = (300, 400)) -> np.ndarray:
    """Return a grey picture with a bright dot."""
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    bright = 200 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 72)
    return np.repeat((bright + 20).astype(np.uint8)[..., None], 3, 2)


@settings(max_examples=40, deadline=None)
@given(
    at=st.tuples(st.floats(20, 380), st.floats(20, 280)),
    middle=st.tuples(st.floats(-20, 420), st.floats(-20, 320)),
    angle=st.floats(-4, 4),
    side=st.floats(60, 900),
    black=st.booleans(),
)
def test_a_square_of_the_frame_shows_what_is_there(at, middle, angle, side, black):
    region = _Region(*middle, side, angle)
    crop = _crop(dot(*at), region, 128, black=black)[..., 0] - 20 / 255
    x, y = np.unravel_index(crop.argmax(), crop.shape)[::-1]
    if crop.max() < 0.7:  # not in the square
        return
    rows, columns = np.nonzero(crop > 0.5 * crop.max())
    shares = (np.array([columns.mean(), rows.mean()]) + 0.5) / 128
    found = region.to_frame(shares)
    if 4 < x < 124 and 4 < y < 124:
        assert np.abs(found - at).max() < max(1.5, side / 128)


def test_beyond_the_frame_its_edge_goes_on_or_it_is_black():
    image = np.full((50, 80, 3), 100, np.uint8)
    image[:, -10:] = 200
    beyond = _Region(120, 25, 80, 0.0)
    np.testing.assert_allclose(_crop(image, beyond._replace(x=115), 16)[:, 4:], 200 / 255, atol=0.01)
    np.testing.assert_array_equal(_crop(image, beyond, 16, black=True)[:, 1:], 0)
    assert _crop(image, _Region(300, 25, 1e4, 1.0), 16).shape == (16, 16, 3)
    assert beyond.shows(image) is False and _Region(105, -20, 60, 1.0).shows(image)
    assert not any(_Region(*odd, 1.0).shows(image) for odd in ((np.nan, 5, 60), (40, 5, np.nan), (1e5, 1e5, 60)))


def test_the_square_of_a_body_is_upright_along_it():
    region = _along(np.array([100.0, 200.0]), np.array([140.0, 200.0]))  # lies with its head to the right
    assert region == pytest.approx((100, 200, 100, np.pi / 2))
    np.testing.assert_allclose(region.to_frame(np.array([[0.5, 0.1]])), [[140, 200]])  # its head is at the top


@settings(max_examples=20, deadline=None)
@given(angle=st.floats(-3, 3), scale=st.floats(0.5, 3), shift=st.floats(-200, 200))
def test_the_square_of_a_hand_turns_and_grows_with_it(angle, scale, shift):
    points = np.random.default_rng(1).uniform(100, 200, (21, 2))
    points[0], points[[5, 9, 13]] = (150, 220), [(140, 150), (150, 148), (160, 150)]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    before, after = _hand(points), _hand(scale * points @ turn + shift)
    np.testing.assert_allclose((after.x, after.y), scale * np.array([before.x, before.y]) @ turn + shift, atol=1e-6)
    assert after.side == pytest.approx(scale * before.side)
    assert np.cos(after.angle - before.angle - angle) == pytest.approx(1)


def test_anchors_are_two_for_each_layer_in_the_middles_of_cells():
    body, palm = _anchors(224, (8, 16, 32, 32, 32)), _anchors(192, (8, 16, 16, 16))
    assert len(body) == 28 * 28 * 2 + 14 * 14 * 2 + 7 * 7 * 6 and len(palm) == 24 * 24 * 2 + 12 * 12 * 6
    np.testing.assert_allclose(body[:3] * 28, [[0.5, 0.5], [0.5, 0.5], [1.5, 0.5]])  # along the rows
    np.testing.assert_allclose(body[-1] * 7, [6.5, 6.5])


def test_boxes_that_overlap_become_their_mean_by_score_and_others_stay():
    boxes = np.array([[[0, 0], [1, 1]], [[0.1, 0], [1.1, 1]], [[5, 5], [6, 6]], [[0.8, 0], [1.8, 1]]], float)
    merged = _merged(boxes, np.array([0.6, 0.9, 0.7, 0.5]))
    np.testing.assert_allclose(merged, [[[0.06, 0], [1.06, 1]], [[5, 5], [6, 6]], [[0.8, 0], [1.8, 1]]])
    assert _merged(np.zeros((0, 4, 2)), np.zeros(0)).shape == (0, 4, 2)


def test_landmarks_move_to_the_heat_where_there_is_any():
    heat = np.full((64, 64, 3), -20, np.float32)
    heat[31, 22, 0], heat[31, 23, 0] = 20, 20  # two sure cells beside it
    heat[31, 23, 1] = -1  # not sure
    places = np.array([[0.34, 0.5], [0.34, 0.5], [1.3, 0.5]])
    np.testing.assert_allclose(_refined(places, heat), [[22.5 / 64, 31 / 64], [0.34, 0.5], [1.3, 0.5]], atol=1e-6)


# Which detector serves a skeleton, and where its networks are.


def test_skeletons_find_their_detector_by_the_names_of_joints(monkeypatch):
    monkeypatch.setattr(weights, "_folders", lambda: [])
    pytest.importorskip("ai_edge_litert", reason="the extra `video` is not installed")
    for name, network in (
        ("h36m17", "pose_detection"),
        ("openpose25", "pose_detection"),
        ("hand21", "palm_detection_full"),
    ):
        with pytest.raises(UserError, match=f"{network} is not on this machine.*uplift detectors get mediapipe"):
            make_detector(None, {}, load_skeleton(name))
    with pytest.raises(
        UserError, match=r"no built-in detector finds the joints of quadruped28 .*detector=my.py:MyDetector"
    ):
        make_detector(None, {}, load_skeleton("quadruped28"))


def test_networks_come_from_a_folder_or_a_task_file_and_what_is_none_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "_folders", lambda: [tmp_path / "cache"])
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache/pose_detection.tflite").write_bytes(b"cached")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/pose_landmark_heavy.tflite").write_bytes(b"heavy")
    with zipfile.ZipFile(tmp_path / "pose.task", "w") as task:
        task.writestr("pose_detector.tflite", b"detector")
        task.writestr("pose_landmarks_detector.tflite", b"landmarks")
    assert find_network("pose_detection") == b"cached"
    assert find_network("pose_landmark_heavy", str(tmp_path / "mine")) == b"heavy"
    assert (
        find_network("pose_detection", str(tmp_path / "mine")) == b"cached"
    )  # what a folder lacks is looked for elsewhere
    assert find_network("pose_detection", str(tmp_path / "pose.task")) == b"detector"
    assert find_network("pose_landmark_heavy", str(tmp_path / "pose.task")) == b"landmarks"
    assert has_networks(["pose_detection"]) and not has_networks(["pose_detection", "pose_landmark_full"])
    (tmp_path / "text.task").write_text("no zip")
    for path, said in ((tmp_path / "none", "no such folder"), (tmp_path / "text.task", "cannot be read")):
        with pytest.raises(UserError, match=said):
            find_network("pose_detection", str(path))
    with pytest.raises(UserError, match="nor on this machine"):
        find_network("hand_landmark_full", str(tmp_path / "mine"))


def test_a_wheel_with_other_networks_is_not_used(tmp_path):
    with zipfile.ZipFile(tmp_path / "mediapipe.whl", "w") as wheel:
        wheel.writestr("mediapipe/modules/pose_detection/pose_detection.tflite", b"another")
    with pytest.raises(UserError, match="not the file that is expected"):
        weights._unpack(tmp_path / "mediapipe.whl", tmp_path / "cache")
    assert not list((tmp_path / "cache").iterdir())


@pytest.mark.skipif(sys.version_info >= (3, 14), reason="says something else there")
def test_without_the_runtime_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(UserError, match=r'pip install "uplift3d\[video\]"'):
        BlazePose()


# The networks themselves.


@pytest.fixture(scope="module")
def photo():
    """A woman from the waist up, of scikit-image."""
    pytest.importorskip("ai_edge_litert", reason="the extra `video` is not installed")
    if not has_networks([*BlazePose.networks, *BlazeHand.networks]):
        pytest.skip("the networks are not here: uplift detectors get mediapipe")
    return np.asarray(Image.open(Path(skimage.__file__).parent / "data/astronaut.png"))


# MediaPipe 0.10.14, Pose(model_complexity=1, static_image_mode=True): pixels of landmarks that are in the picture.
_MEDIAPIPE = {
    "nose": (223, 128), "left_eye": (249, 112), "right_eye": (205, 103), "left_ear": (268, 123), "right_ear": (190, 107),
    "mouth_left": (234, 154), "mouth_right": (206, 148), "left_shoulder": (306, 257), "right_shoulder": (113, 240),
}  # fmt: skip


def test_a_photo_gives_what_mediapipe_gives_and_two_people_are_found(photo):
    detector = BlazePose(threads=1)
    keypoints, confidence = detector.detect(photo)
    assert keypoints.shape == (1, 33, 2)
    places = [BlazePose.names.index(name) for name in _MEDIAPIPE]
    off = np.linalg.norm(keypoints[0, places] - list(_MEDIAPIPE.values()), axis=1)
    assert np.median(off) < 3 and off.max() < 20  # shoulders are wide apart: the square is another by some pixels
    assert (confidence[0, places] > 0.9).all()
    assert confidence[0, BlazePose.names.index("left_ankle")] < 0.1  # below the picture
    detector.forget()
    both, _ = detector.detect(np.concatenate([photo, photo[:, ::-1]], 1))
    assert len(both) == 2
    first = both[np.argsort(both[:, 0, 0])]
    assert np.abs(first[0, 0] - keypoints[0, 0]).max() < 5
    assert np.abs(first[1, 0] - [1024 - keypoints[0, 0, 0], keypoints[0, 0, 1]]).max() < 5


def test_followed_from_frame_to_frame_and_found_again_after_a_cut(photo):
    detector = BlazePose(threads=1)
    first, _ = detector.detect(photo)
    for shift in (4, 8):
        moved = np.roll(photo, shift, axis=1)
        keypoints, _ = detector.detect(moved)
        assert np.abs(keypoints[0, :11] - first[0, :11] - [shift, 0]).max() < 8
    empty, _ = detector.detect(np.zeros_like(photo))
    assert empty.shape == (0, 33, 2)
    small, _ = detector.detect(np.asarray(Image.fromarray(photo).resize((128, 128))))
    assert np.abs(4 * small[0, :11] - first[0, :11]).max() < 16
    assert BlazeHand(threads=1).detect(np.zeros((40, 30, 3), np.uint8))[0].shape == (0, 21, 2)


def test_a_network_that_is_another_is_refused(photo, tmp_path):
    (tmp_path / "pose_detection.tflite").write_bytes(b"TFL3 not a network")
    with pytest.raises(UserError, match="pose_detection: the file is damaged, or not a network"):
        BlazePose(weights=str(tmp_path))
    (tmp_path / "pose_detection.tflite").write_bytes(find_network("palm_detection_full"))
    with pytest.raises(UserError, match="another network than MediaPipe's"):
        BlazePose(weights=str(tmp_path))
