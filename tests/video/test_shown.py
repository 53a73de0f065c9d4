"""From a video to a page, an overlay and a live page, by the command line, with a detector that knows the keypoints."""

from __future__ import annotations

import json
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest
import torch
from videos import numbered, write_video

from uplift.cli.live import lift_live
from uplift.cli.main import main
from uplift.cli.predict import predict
from uplift.config.run import Weights, read_weights
from uplift.config.settings import LifterSettings
from uplift.data.formats.base import ReadOptions
from uplift.data.synthetic.simulate import simulate
from uplift.export.html import read_html
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.skeleton import load_skeleton
from uplift.video.detector import Detector
from uplift.video.frames import open_frames

H36M = load_skeleton("h36m17")
FRAMES = 24


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A lifter, a video, and keypoints of the bodies in it."""
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("scene")
    settings = LifterSettings()
    torch.manual_seed(0)
    Model(Lifter(H36M, settings).eval(), H36M, settings).save(folder / "lifter.pt")
    data = simulate(H36M, FRAMES, seed=0, clip_seconds=FRAMES / 10)
    points = (data.keypoints - data.keypoints.reshape(-1, 2).min(0)) / np.ptp(data.keypoints) * 300 + 40
    write_video(folder / "walk.mp4", numbered(FRAMES, (400, 400)), fps=10, codec="libx264")
    return folder, points


class Knows(Detector):
    """Two people, as they are."""

    names = H36M.joints

    def __init__(self, points):
        self.points, self.count = points, 0

    def detect(self, image):
        found = self.points[self.count % FRAMES]
        self.count += 1
        return np.stack([found, found * 0.5 + 150]), np.ones((2, len(self.names)))


def test_a_page_and_a_film_show_the_video_that_was_lifted(scene, tmp_path):
    folder, points = scene
    more = {"refine": False, "start_s": 0.5, "end_s": 1.5}
    found = predict(folder / "lifter.pt", folder / "walk.mp4", tmp_path / "a.html", detector=Knows(points), **more)
    assert found.identity["frame"].min() == 5 and found.identity["frame"].max() == 14
    (behind,) = read_html(tmp_path / "a.html")["behind"]
    assert len(behind["jpegs"]) == 10 and all(behind["jpegs"])
    predict(folder / "lifter.pt", folder / "walk.mp4", tmp_path / "a.gif", detector=Knows(points), **more)
    assert (tmp_path / "a.gif").stat().st_size > 20_000


def test_video_goes_with_what_shows_it(scene, tmp_path, capsys):
    folder, _ = scene
    csv, run = tmp_path / "walk.csv", f"run={folder / 'lifter.pt'}"
    csv.write_text("x\n")
    for words, says in {
        (
            f"input={csv}",
            f"video={folder / 'walk.mp4'}",
            f"output={tmp_path}/a.npz",
        ): "goes with output=FILE.html or .mp4 or .gif",
        (f"input={csv}", f"video={folder / 'none.mp4'}", f"output={tmp_path}/a.html"): "No file",
        (
            f"input={csv}",
            f"video={folder / 'walk.mp4'}",
            "rotate=90",
            f"output={tmp_path}/a.html",
        ): "turns the keypoints",
        (f"input={csv}", "video.start_s=1", f"output={tmp_path}/a.html"): "video.start_s= goes with a video",
        ("input=camera:0", f"output={tmp_path}/a.html"): "camera:0 has no end",
        (f"input={csv}", "output=live"): "output=live shows a camera",
        (f"input={folder / 'walk.mp4'}", "output=live", "ground=true"): "ground= does not go with output=live",
        ("input=camera:77", "output=live"): "no /dev/video77",
    }.items():
        assert main(["predict", run, *words]) == 2
        said = capsys.readouterr().err.strip()
        assert says in said and "\n" not in said


def test_a_video_in_place_of_a_camera_is_lifted_as_it_plays(scene, monkeypatch):
    folder, points = scene
    seen, refused = [], []

    def look(address):
        request = urllib.request.Request(f"{address}stream", headers={"Host": "evil.example"})
        try:
            urllib.request.urlopen(request)
        except urllib.error.HTTPError as error:
            refused.append(error.code)
        page = urllib.request.urlopen(address).read().decode()
        assert "EventSource" in page and "connect-src 'self'" in page
        for line in urllib.request.urlopen(f"{address}stream"):
            if line.startswith(b"data: {"):
                seen.append(json.loads(line[6:]))
            if line.startswith(b"event: end"):
                return

    looking = threading.Thread(target=lambda: look(address[0]))
    address: list[str] = []
    monkeypatch.setattr("uplift.cli.live.webbrowser.open", lambda url: (address.append(url), looking.start()))
    weights: Weights = read_weights(folder / "lifter.pt")
    with open_frames(folder / "walk.mp4") as frames:
        shown = lift_live(frames, weights, Knows(points), {}, 2, ReadOptions())
    looking.join(timeout=20)
    assert shown == FRAMES and refused == [403] and len(seen) > 5
    last = seen[-1]
    assert last["size"] == [400, 400] and [one["number"] for one in last["people"]] == [0, 1]
    place = last["frame"]
    np.testing.assert_allclose(last["people"][0]["keypoints"], points[place], atol=0.06)
    pose = np.array(last["people"][0]["pose"])
    assert pose.shape == (17, 3) and np.isfinite(pose).all()
    assert np.corrcoef(pose[:, 0], points[place][:, 0])[0, 1] > 0.9  # it stands as in the image
