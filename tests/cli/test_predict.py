"""What predict says of its input: several cameras of one scene, videos and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from uplift.cli.inputs import read_input
from uplift.cli.main import main
from uplift.cli.predict import _check_request
from uplift.cli.request import Request
from uplift.config.run import Weights
from uplift.config.trust import consent_of, granted
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.video.detect import Detection

SKELETON = Skeleton("arm", ("shoulder", "elbow", "wrist", "hand"), "shoulder", (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")))  # fmt: skip


def write_csv(file: Path, first: int = 0, camera: str = "") -> None:
    """Write eight frames of an arm, from frame ``first`` on."""
    file.parent.mkdir(exist_ok=True)
    head = ",".join(f"{joint}_{what}" for joint in SKELETON.joints for what in "xy")
    rows = np.random.default_rng(first).uniform(100, 300, (8, 8)).round(2).astype(str).tolist()
    lines = [",".join([str(first + number), *([camera] if camera else []), *row]) for number, row in enumerate(rows)]
    file.write_text("\n".join([f"frame,{'camera,' if camera else ''}{head}", *lines]) + "\n")


def notes_of(pattern: str) -> str:
    weights = Weights("run", Path("nowhere/lifter.pt"), {})
    request = Request(weights, pattern, None, (), True, 0, False, {}, None, None, None, {})
    return "; ".join(note for note in read_input(request, SKELETON).notes if "cameras of one scene" in note)


@pytest.mark.parametrize(
    ("files", "cameras"),
    [
        (("walk_cam1.csv", "walk_cam2.csv", "walk_cam3.csv"), "3 cameras of one scene (cam1, cam2, cam3)"),
        (("camA/walk.csv", "camB/walk.csv"), "2 cameras of one scene (camA, camB)"),
        (("walk.C1.csv", "walk.C2.csv"), "2 cameras of one scene (C1, C2)"),
        (("view-1 run.csv", "view-2 run.csv"), "2 cameras of one scene (view-1, view-2)"),
        (("walk_1.csv", "walk_2.csv"), ""),
        (("walk_cam1.csv", "run_cam2.csv"), ""),
        (("camel.csv", "camera.csv"), ""),
        (("camA/walk.csv",), ""),
    ],
)
def test_files_of_several_cameras_are_said_to_stay_apart(tmp_path: Path, files: tuple[str, ...], cameras: str):
    for file in files:
        write_csv(tmp_path / file)
    said = notes_of(",".join(str(tmp_path / file) for file in files))
    assert (f"{cameras}: each is lifted by itself" in said) if cameras else not said


def test_films_of_other_times_are_no_scene(tmp_path: Path):
    write_csv(tmp_path / "walk_cam1.csv")
    write_csv(tmp_path / "walk_cam2.csv", first=100)
    assert not notes_of(f"{tmp_path}/*.csv")


def test_cameras_that_one_video_names_are_a_scene(tmp_path: Path):
    write_csv(tmp_path / "a/walk.csv", camera="left")
    write_csv(tmp_path / "b/walk.csv", camera="right")
    (tmp_path / "walk.csv").write_text(
        (tmp_path / "a/walk.csv").read_text() + (tmp_path / "b/walk.csv").read_text().split("\n", 1)[1]
    )
    assert "2 cameras of one scene (left, right)" in notes_of(str(tmp_path / "walk.csv"))


# Videos and pictures.

DOTS = """
import numpy as np
import uplift

class Dots(uplift.Detector):
    names = ("hand", "wrist", "elbow", "shoulder")

    def detect(self, image):
        return np.array([[(10.5, 20), (30, 25), (50, 40), (20, 60)]]), np.full((1, 4), 0.9)
"""


@pytest.fixture
def film(tmp_path: Path) -> tuple[Path, str]:
    """A folder of pictures that are a film, and a detector for it."""
    (tmp_path / "film").mkdir()
    for number in range(8):
        Image.fromarray(np.zeros((80, 100, 3), np.uint8)).save(tmp_path / f"film/f_{number:02}.png")
    (tmp_path / "dots.py").write_text(DOTS)
    return tmp_path / "film", f"{tmp_path / 'dots.py'}:Dots"


def request_of(input: Path, detector: str | None = None, **changed) -> Request:
    weights = Weights("run", Path("nowhere/lifter.pt"), {})
    request = Request(weights, input, None, (), True, 0, False, {}, None, None, None, {})
    return replace(request, detection=Detection(detector), **changed)


def test_pictures_are_read_by_a_detector_and_their_keypoints_kept_read_the_same(film, tmp_path: Path):
    folder, detector = film
    kept = tmp_path / "kept.npz"
    with granted(consent_of([detector])):
        data = read_input(request_of(folder, detector, keypoints=kept, reading=ReadOptions(fps=25.0)), SKELETON)
    assert data.joint_names == SKELETON.joints and data.fps == 25 and len(np.unique(data.clips())) == 1
    np.testing.assert_allclose(data.keypoints[0], [(20, 60), (50, 40), (30, 25), (10.5, 20)])
    again = read_input(request_of(kept), SKELETON)
    np.testing.assert_array_equal(again.keypoints, data.keypoints)
    assert again.fps == 25 and again.image_size == data.image_size == (100, 80)


def test_what_does_not_go_with_pictures_or_with_files_is_refused(film, tmp_path: Path):
    folder, detector = film
    write_csv(tmp_path / "file.csv")
    wrong = [
        (request_of(tmp_path / "file.csv", detector), "detector= goes with a video or pictures"),
        (request_of(tmp_path / "file.csv", keypoints="x.npz"), "keypoints= goes with a video or pictures"),
        (request_of(folder, detector, keypoints=tmp_path / "x.txt"), "keypoints=.*written as .npz or .csv"),
        (request_of(folder, detector, keypoints=tmp_path / "file.csv"), "exists already and is not overwritten"),
        (request_of(folder, detector, keypoints=tmp_path / "none/x.csv"), "keypoints=.*no folder"),
    ]
    for request, said in wrong:
        with pytest.raises(UserError, match=said):
            _check_request(request, {}, {})
    for reading, said in (
        (ReadOptions(format="coco"), "format= goes with files"),
        (ReadOptions(image_size=(5, 5)), "image_size= goes"),
    ):
        with pytest.raises(UserError, match=said):
            read_input(request_of(folder, detector, reading=reading), SKELETON)
    with pytest.raises(UserError, match="no built-in detector finds the joints of arm"):
        read_input(request_of(folder), SKELETON)


def test_the_words_of_the_command_reach_the_detector(film, tmp_path: Path, capsys: pytest.CaptureFixture):
    folder, detector = film
    words = [
        "detect",
        f"input={folder}",
        f"output={tmp_path / 'out.csv'}",
        f"detector={detector}",
        "people=1",
        "fps=25",
    ]
    assert main(words) == 0
    assert "found 1 clip, 8 rows, 4 joints, mean confidence 0.90" in capsys.readouterr().out
    assert read(tmp_path / "out.csv").fps == 25
    assert main(words) == 2 and "exists already" in capsys.readouterr().err
    assert main([*words[:2], f"output={tmp_path / 'b.npz'}", words[3], "detector.options.x=1"]) == 2
    assert "takes no such option" in capsys.readouterr().err
    assert main(["detect", f"input={tmp_path / 'out.csv'}", f"output={tmp_path / 'b.npz'}"]) == 2
    assert "expected a video, a picture" in capsys.readouterr().err
    assert main(["detectors"]) == 0 and "mediapipe_hand" in capsys.readouterr().out
    assert main(["detectors", "get", "mediapip"]) == 2 and "Did you mean 'mediapipe'" in capsys.readouterr().err
