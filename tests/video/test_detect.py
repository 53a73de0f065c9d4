"""From frames to keypoints: a detector of coloured dots, whose places are known, and what detectors may not return."""

import numpy as np
import pytest
from PIL import Image

import uplift
from uplift.data.formats import read
from uplift.errors import UserError
from uplift.video.detect import keypoints_of
from uplift.video.detector import Detector, make_detector
from uplift.video.frames import open_frames

SIZE = (160, 90)
DOTS = {"head": (255, 0, 0), "hand": (0, 255, 0), "foot": (0, 0, 255), "tail": (255, 255, 0)}
MY = """
import numpy as np
import uplift

class Dots(uplift.Detector):
    \"\"\"Middles of dots of four colours; of two people the dots to the left and to the right of the middle.\"\"\"
    names = ("head", "hand", "foot", "tail")

    def __init__(self, sure: float = 0.9):
        self.sure = sure

    def detect(self, image):
        found = []
        for half in np.split(np.arange(image.shape[1]), 2):
            marks = np.full((4, 2), np.nan)
            for place, colour in enumerate([(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)]):
                rows, columns = np.nonzero((abs(image[:, half].astype(int) - colour) < 60).all(-1))
                if len(rows):
                    marks[place] = half[columns].mean() , rows.mean()
            if np.isfinite(marks).any():
                found.append(marks)
        found = np.array(found).reshape(-1, 4, 2)
        return found, np.full(found.shape[:2], self.sure)
"""


def scene(frame: int, people: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture and (people dots 2) where its dots are."""
    where = np.array([[[30, 20], [45, 40], [22, 70], [60, 55]], [[110, 20], [125, 40], [102, 70], [140, 55]]], float)[
        :people
    ]
    where[..., 0] += frame % 15
    image = np.full((*SIZE[::-1], 3), 40, np.uint8)
    for body in where.astype(int):
        for (x, y), colour in zip(body, DOTS.values(), strict=True):
            image[y - 2 : y + 3, x - 2 : x + 3] = colour
    return image, where


@pytest.fixture(scope="module")
def my(tmp_path_factory):
    file = tmp_path_factory.mktemp("my") / "my.py"
    file.write_text(MY)
    return f"{file}:Dots"


def pictures(folder, names, people=2):
    folder.mkdir(exist_ok=True)
    for frame, name in enumerate(names):
        Image.fromarray(scene(frame, people)[0]).save(folder / name)
    return folder


def test_everyone_in_numbered_pictures_is_followed_and_kept_in_a_file_that_reads_the_same(tmp_path, my):
    folder = pictures(tmp_path / "film", [f"f_{number:03}.png" for number in range(12)])
    data = uplift.detect(folder, tmp_path / "kept.npz", detector=my)
    assert data.joint_names == tuple(DOTS) and data.image_size == SIZE and data.fps is None
    assert data.identity["sequence"].tolist() == ["f"] * 24 and len(np.unique(data.clips())) == 2
    for person in "01":
        rows = data.identity["instance"] == person
        side = 0 if data.keypoints[rows][0, 0, 0] < 80 else 1
        np.testing.assert_allclose(data.keypoints[rows], [scene(frame)[1][side] for frame in range(12)], atol=0.01)
        assert data.identity["frame"][rows].tolist() == list(range(12))
    again = read(tmp_path / "kept.npz")
    np.testing.assert_array_equal(again.keypoints, data.keypoints)
    np.testing.assert_array_equal(again.confidence, np.float32(0.9))
    assert {key: values.tolist() for key, values in again.identity.items()} == {
        key: values.tolist() for key, values in data.identity.items()
    }
    alone = uplift.detect(folder, tmp_path / "kept.csv", detector=my, people=1, detector_options={"sure": 0.5})
    assert len(alone) == 12 and "instance" not in alone.identity and "1 of 2" in " ".join(alone.notes)
    table = read(tmp_path / "kept.csv")
    np.testing.assert_allclose(table.keypoints, alone.keypoints, atol=0.01)
    assert (table.confidence == np.float32(0.5)).all()


def test_photos_are_stills_and_the_detector_forgets_between_them(tmp_path):
    folder = pictures(tmp_path / "photos", ["ann.png", "bob.png", "joe.png"])
    calls = []

    class Told(Detector):
        names = ("a", "b", "c")

        def forget(self):
            calls.append("forget")

        def detect(self, image):
            calls.append("detect")
            return np.array([[[1.5, 2], [30, 40], [5, 60]], [[7, 8], [70, 80], [9, 9]]]), np.ones((2, 3))

        def close(self):
            calls.append("close")

    data = uplift.detect(folder, detector=Told())
    assert calls == ["forget", "detect"] * 3 + ["close"]
    assert data.stills and len(np.unique(data.clips())) == 6
    assert data.identity["image"].tolist() == ["ann.png", "ann.png", "bob.png", "bob.png", "joe.png", "joe.png"]
    assert uplift.detect(folder, detector=Told(), people=1).keypoints[:, 1, 1].tolist() == [80, 80, 80]  # the larger


def test_a_video_gives_what_its_pictures_give(tmp_path, my):
    pytest.importorskip("av", reason="the extra `video` is not installed")
    from videos import write_video

    path = write_video(tmp_path / "film.mp4", [scene(frame)[0] for frame in range(20)], fps=25, codec="mpeg4")
    data = uplift.detect(path, detector=my)
    assert data.fps == 25 and data.image_size == SIZE and data.identity["sequence"][0] == "film"
    true = np.array([scene(frame)[1] for frame in range(20)])
    for person in "01":
        found = data.keypoints[data.identity["instance"] == person]
        assert np.abs(found - true[:, 0 if found[0, 0, 0] < 80 else 1]).max() < 1.5


def returns(found, names=("a", "b", "c")):
    return type("Fake", (Detector,), {"names": names, "detect": lambda self, image: found})()


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (None, "returned NoneType, expected two arrays"),
        (np.zeros((2, 3)), "keypoints of shape (3,)"),
        ((np.zeros((1, 4, 2)), np.zeros((1, 4))), "expected (people, 3, 2) and (people, 3)"),
        ((np.zeros((1, 3, 3)), np.zeros((1, 3))), "keypoints of shape (1, 3, 3)"),
        ((np.zeros((3, 2)), np.zeros(3)), "keypoints of shape (3, 2)"),
        (("x", "y"), "expected two arrays"),
        ((np.full((1, 3, 2), 20.5), np.full((1, 3), 1e9)), "confidence goes from"),
        ((np.full((1, 3, 2), 20.5), np.zeros((1, 3))), "nothing was found in 1 frames; looked for a, b, c"),
        ((np.zeros((0, 3, 2)), np.zeros((0, 3))), "nothing was found in 1 frames"),
        ((np.full((1, 3, 2), np.nan), np.ones((1, 3))), "nothing was found in 1 frames"),
        (([], []), "nothing was found in 1 frames"),
    ],
)
def test_what_is_no_keypoints_is_said_in_one_line(tmp_path, found, said):
    folder = pictures(tmp_path / "one", ["a.png"])
    with pytest.raises(UserError) as error:
        uplift.detect(folder, detector=returns(found))
    assert said in str(error.value) and "\n" not in str(error.value)


def test_other_scales_are_put_right_as_in_files_of_trackers(tmp_path):
    folder = pictures(tmp_path / "one", ["a.png"])
    shares = np.array([[[0.25, 0.5], [0.5, 0.75], [0.1, 0.2]]])
    data = uplift.detect(folder, detector=returns((shares, np.full((1, 3), 87.0))))
    np.testing.assert_allclose(data.keypoints, shares * SIZE, rtol=1e-5)
    np.testing.assert_allclose(data.confidence, 0.87, rtol=1e-5)
    assert any("shares of the image" in note for note in data.notes)


def test_a_detector_that_fails_or_says_nothing_is_named(tmp_path, my):
    folder = pictures(tmp_path / "one", ["a.png"])
    broken = tmp_path / "broken.py"
    broken.write_text(
        "import uplift\nclass Bad(uplift.Detector):\n    names = ('a', 'b', 'c')\n    def detect(self, image):\n        image[0] = 1\n"
    )
    with pytest.raises(UserError, match=r"Bad.detect failed in .*broken.py, line 5: ValueError"):
        uplift.detect(folder, detector=f"{broken}:Bad")
    with pytest.raises(UserError, match="no method detect"):
        uplift.detect(folder, detector=type("Empty", (Detector,), {"names": ("a",)})())
    for names, said in (
        ((), "is empty"),
        (("a", "a"), "'a' twice"),
        ("abc", "expected the names"),
        ((1, 2), "expected the names"),
    ):
        with pytest.raises(UserError, match=said):
            make_detector(returns(None, names), {})
    with pytest.raises(UserError, match="sure='x': expected a number"):
        uplift.detect(folder, detector=my, detector_options={"sure": "x"})
    with pytest.raises(UserError, match=r"detectors?=.*no such built-in.* Did you mean 'mediapipe'"):
        uplift.detect(folder, detector="mediapip")


def test_memory_does_not_hold_frames(tmp_path):
    """Of ten times as many frames only the keypoints are kept."""
    import tracemalloc

    class Two(Detector):
        names = ("a", "b", "c")

        def detect(self, image):
            return np.array([[[1.5, 2], [30, 40], [5, 60]]], np.float32), np.ones((1, 3), np.float32)

    folder = pictures(tmp_path / "film", [f"{number}.png" for number in range(60)])
    tracemalloc.start()
    with open_frames(folder) as frames:
        keypoints_of(frames, Two())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * np.prod(SIZE) * 3
