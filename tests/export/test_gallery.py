"""The gallery: what turns, what is chosen, what a page of it holds; and predict on published sets."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import body_arrays, refusal, status_of, write_body
from hypothesis import given
from hypothesis import strategies as st
from page_browser import Browser, Page
from PIL import Image
from writers_samples import prediction, tilted

from uplift.cli.predict import predict
from uplift.config.settings import LifterSettings
from uplift.data.formats import read
from uplift.errors import UserError
from uplift.export import write
from uplift.export.gallery import Crop, chosen_rows, crop_of, filled_points, gallery_text, photo_svg, turned
from uplift.export.html import Photos
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton, load_skeleton

_NASTY = '</style><script>alert(1)</script><b>"it\'s" & {{frames}} <!--'
_SVG = "{http://www.w3.org/2000/svg}"


def parsed(text: str) -> ET.Element:
    """Return the body of a page, which is well-formed."""
    return ET.fromstring(re.search(r"<body>.*</body>", text, re.S)[0])  # type: ignore[index]


def frames_of(text: str) -> list[ET.Element]:
    return parsed(text).findall(".//article")


def lines_of(drawing: ET.Element) -> np.ndarray:
    """Return (lines 2 2) ends of the bones drawn, without their rims, in the order of the bones' colours."""
    paths = [path.get("d") for path in drawing.findall(".//path") if path.get("class") != "k"]
    return np.array([re.findall(r"-?\d+", path or "") for path in paths], float).reshape(-1, 2, 2)


@given(st.floats(-30, 30), st.integers(0, 1000))
def test_turning_is_about_gravity_and_keeps_the_pose(tilt_deg: float, seed: int) -> None:
    pose = np.random.default_rng(seed).normal(size=(7, 3))
    level = tilted(np.array([tilt_deg]))[0].T
    views = turned(pose, level, pose[0], list(range(0, 360, 30)))
    np.testing.assert_allclose(views[0], pose - pose[0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(views, axis=-1) - np.linalg.norm(views[0], axis=-1), 0, atol=1e-9)
    down = views @ level[1]  # along gravity, in the camera's frame: the same from all sides
    np.testing.assert_allclose(down - down[0], 0, atol=1e-9)
    np.testing.assert_allclose(np.sum(views[[0, 6]], 0) @ level[[0, 2]].T, 0, atol=1e-9)
    step = turned(views[3], level, np.zeros(3), [30])[0]
    np.testing.assert_allclose(step, views[4], atol=1e-9)


def test_at_90_degrees_the_camera_stands_on_the_images_right() -> None:
    pose = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    view = turned(pose, np.eye(3), np.zeros(3), [90])[0]
    np.testing.assert_allclose(view[1], [0, 0, -1], atol=1e-12)  # what was right is near
    np.testing.assert_allclose(view[2], [1, 0, 0], atol=1e-12)  # what was far is right


@given(st.integers(1, 400), st.integers(1, 60), st.integers(0, 50), st.integers(0, 9))
def test_frames_are_spread_seeded_and_have_poses(total: int, count: int, blank: int, seed: int) -> None:
    sample = prediction(frames=total)
    gone = np.random.default_rng(seed).permutation(total)[: min(blank, total - 1)]
    sample.pose[gone] = np.nan
    rows = chosen_rows(sample, count, seed)
    lifted = np.setdiff1d(np.arange(total), gone)
    assert len(rows) == min(count, len(lifted)) == len(set(rows.tolist()))
    assert np.isin(rows, lifted).all()
    part = (np.searchsorted(lifted, rows) + 0.5) * len(rows) / len(lifted)
    assert (np.abs(part - np.arange(len(rows)) - 0.5) <= 0.5 + len(rows) / len(lifted)).all()
    np.testing.assert_array_equal(rows, chosen_rows(sample, count, seed))


def test_another_seed_shows_other_frames() -> None:
    sample = prediction(frames=1000)
    assert not np.array_equal(chosen_rows(sample, 40, 0), chosen_rows(sample, 40, 1))


@pytest.mark.parametrize("count", [0, -3, 501])
def test_a_count_that_is_none_is_refused(count: int) -> None:
    with pytest.raises(UserError, match="1 to 500 frames"):
        gallery_text(prediction(frames=5), frames=count)


def test_nothing_lifted_is_refused() -> None:
    sample = prediction(frames=3)
    sample.pose[:] = np.nan
    with pytest.raises(UserError, match="no frame of the input could be lifted"):
        gallery_text(sample)
    with pytest.raises(UserError, match="no frame of the input could be lifted"):
        gallery_text(prediction(frames=0))


def test_every_frame_has_its_input_and_twelve_views() -> None:
    frames = frames_of(gallery_text(prediction(frames=90), frames=8))
    assert len(frames) == 8
    for frame in frames:
        assert len(frame.findall(".//figure[@class='input']/svg")) == 1
        assert [text.text for text in frame.findall(".//text")] == [f"{angle}°" for angle in range(0, 360, 30)]
        for drawing in frame.findall(".//svg"):
            assert len(lines_of(drawing)) == 6
        label = frame.find(".//*[@class='views']").get("aria-label")  # type: ignore[union-attr]
        assert frame.find(".//h2").text in label  # type: ignore[union-attr, operator]


def test_the_first_view_is_what_the_camera_saw() -> None:
    frame = frames_of(gallery_text(prediction(frames=30), frames=1))[0]
    flat, first = (lines_of(drawing) for drawing in frame.findall(".//svg")[:2])
    flat, first = (lines[np.lexsort(lines[:, 1].T)] for lines in (flat, first))
    scaled = (flat - flat.mean((0, 1))) / flat.std()
    seen = (first - first.mean((0, 1))) / first.std()
    gap = min(np.abs(scaled - seen).max(), np.abs(scaled - seen[:, ::-1]).max())
    assert gap < 0.4  # the keypoints of the sample are without perspective


def test_every_view_stays_inside_its_drawing() -> None:
    sample = prediction(frames=20, truth=True)
    for array in (sample.pose, sample.level_pose, sample.truth):
        array *= np.geomspace(0.01, 100, 20)[:, None, None]
    for frame in frames_of(gallery_text(sample, frames=20)):
        for drawing in frame.findall(".//*[@class='views']/svg"):
            ends = lines_of(drawing).reshape(-1, 2)
            assert ends.min() >= 0
            assert (ends.max(0) <= [400, 480]).all()
            assert np.ptp(ends, axis=0).max() > 100


def test_truth_is_drawn_beneath_at_the_size_of_the_pose() -> None:
    sample = prediction(frames=6, truth=True)
    sample.unit, sample.truth = "px", sample.pose * 7
    for frame in frames_of(gallery_text(sample)):
        lifted, truth = frame.findall(".//figure[@class='turns']")
        assert [row.findtext("figcaption") for row in (lifted, truth)] == ["Lifted", "Truth"]
        for one, other in zip(lifted.findall(".//svg"), truth.findall(".//svg"), strict=True):
            np.testing.assert_allclose(lines_of(one), lines_of(other), atol=1)
        assert "error at the best scale (n_mpjpe) 0" in "".join(frame.itertext())


def test_a_frame_without_truth_among_others_with() -> None:
    sample = prediction(frames=4, truth=True)
    sample.truth[2] = np.nan  # type: ignore[index]
    rows = [len(frame.findall(".//figure[@class='turns']")) for frame in frames_of(gallery_text(sample))]
    assert rows == [2, 2, 1, 2]


def test_missing_joints_are_drawn_as_missing() -> None:
    sample = prediction(frames=2)
    sample.confidence[0, 3] = 0
    sample.keypoints[0, 5] = np.nan
    first, second = frames_of(gallery_text(sample))
    assert "not seen: lhand, lfoot" in "".join(first.itertext())
    assert "5 of 7 joints seen" in first.find(".//svg").get("aria-label")  # type: ignore[operator, union-attr]
    for drawing in first.findall(".//svg"):
        assert len([dot for dot in drawing.findall("circle") if dot.get("class") == "ol"]) == 2
        assert len([path for path in drawing.findall("path") if (path.get("class") or "").endswith(" u")]) == 2
    assert not [dot for dot in second.findall(".//circle") if (dot.get("class") or "").startswith("o")]


def test_missing_joints_stand_where_the_pose_has_them() -> None:
    sample = prediction(frames=1)
    seen = np.array([True] * 5 + [False] * 2)
    found = filled_points(sample.keypoints[0], seen, sample.pose[0])
    np.testing.assert_allclose(found, sample.keypoints[0], atol=1e-6)
    assert np.isnan(filled_points(sample.keypoints[0], np.arange(7) < 1, sample.pose[0])[1:]).all()


def test_not_a_number_never_reaches_the_page() -> None:
    sample = prediction(frames=4, truth=True)
    sample.pose[1, 2], sample.level_pose[1, 2], sample.keypoints[2] = np.nan, np.inf, np.nan
    sample.truth[3, 1], sample.confidence[0, 0] = np.nan, np.nan  # type: ignore[index]
    text = gallery_text(sample)
    assert len(frames_of(text)) == 4
    assert not re.search(r"\bnan\b|\binf\b", text, re.I)


def test_it_is_small_whole_and_needs_nothing_from_outside() -> None:
    sample = prediction(frames=400)
    text = gallery_text(sample)
    assert len(text) < 600_000
    assert "http://" not in text and "https://" not in text
    assert not re.search(r"<script|<link|<iframe|@import|url\(|\bsrc=|\bon\w+=", text)
    assert "default-src 'none'; style-src 'sha256-" in text
    assert text == gallery_text(sample)


def test_text_from_the_data_stays_text() -> None:
    skeleton = Skeleton(_NASTY, (_NASTY, "tip"), _NASTY, ((_NASTY, "tip"),))
    sample = prediction(frames=2, joints=2)
    sample.skeleton, sample.joint_names = skeleton, skeleton.joints
    sample.title = sample.source = _NASTY
    sample.identity = {"image": np.array([_NASTY, "other"])}
    sample.confidence[:, 0] = 0
    text = gallery_text(sample)
    assert "<script" not in text and "<!--" not in text and text.count("</style>") == 1
    assert frames_of(text)[0].findtext(".//h2") == _NASTY


def test_frames_are_named_by_what_is_known() -> None:
    assert [frame.findtext(".//h2") for frame in frames_of(gallery_text(prediction(frames=2)))] == ["row 0", "row 1"]
    clip = {"subject": np.array(["S9"]), "sequence": np.array(["walk 1"]), "frame": np.array([7])}
    assert frames_of(gallery_text(prediction(frames=1, identity=clip)))[0].findtext(".//h2") == "S9 · walk 1 · frame 7"
    image = clip | {"image": np.array(["0123.jpg"])}
    assert frames_of(gallery_text(prediction(frames=1, identity=image)))[0].findtext(".//h2") == "0123.jpg"


def _photographed(folder: Path, count: int = 3) -> Prediction:
    """Return a prediction with a photo each: green, with the body's square red."""
    folder.mkdir()
    names = np.array([f"{n:03d}.jpg" for n in range(count)])
    sample = prediction(frames=count, identity={"image": names})
    for name, points in zip(names, sample.keypoints, strict=True):
        photo = np.zeros((480, 640, 3), np.uint8)
        photo[..., 1] = 200
        (x0, y0), (x1, y1) = points.min(0).astype(int), points.max(0).astype(int)
        photo[max(y0, 0) : y1, max(x0, 0) : x1] = (220, 0, 0)
        Image.fromarray(photo).save(folder / name, quality=95)
    return sample


def _embedded(frame: ET.Element) -> np.ndarray | None:
    image = frame.find(".//image")
    if image is None:
        return None
    kind, _, data = (image.get("href") or "").partition(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_photos_are_cropped_to_the_body_and_small(tmp_path: Path) -> None:
    sample = _photographed(tmp_path / "photos")
    text = gallery_text(sample, images=tmp_path / "photos")
    for frame in frames_of(text):
        photo = _embedded(frame)
        assert photo is not None
        assert max(photo.shape[:2]) <= 320
        red = photo[..., 0] > 110
        # The body fills its square but for the margin, in the one direction that it is longest in.
        assert red.any(1).mean() > 0.7 or red.any(0).mean() > 0.7
        assert red[:3].sum() == red[-3:].sum() == 0
        assert "on the photo" in frame.find(".//svg").get("aria-label")  # type: ignore[operator, union-attr]
    assert len(text) < 150_000


def test_a_crop_beyond_the_photos_edge_stays_in_its_place(tmp_path: Path) -> None:
    Image.fromarray(np.full((100, 200, 3), 90, np.uint8)).save(tmp_path / "a.png")
    found = photo_svg(Photos(tmp_path), "a", Crop(-50.0, 20.0, 100.0))
    place = [float(re.search(rf'{name}="([\d.]+)"', found)[1]) for name in ("x", "y", "width", "height")]  # type: ignore[index]
    assert place == [200, 0, 200, 320]


def test_photos_that_are_absent_or_damaged_are_told(tmp_path: Path) -> None:
    sample = _photographed(tmp_path / "photos", 4)
    (tmp_path / "photos" / "001.jpg").unlink()
    (tmp_path / "photos" / "002.jpg").write_bytes(b"no photo")
    text = gallery_text(sample, images=tmp_path / "photos")
    assert [_embedded(frame) is None for frame in frames_of(text)] == [False, True, True, False]
    notes = "".join(parsed(text).find(".//footer").itertext())  # type: ignore[union-attr]
    assert "1 of 4 photos is not in photos: 001.jpg" in notes
    assert "1 of 4 photos is unusable: 002.jpg (" in notes


def test_a_folder_without_the_photos_is_refused(tmp_path: Path) -> None:
    sample = _photographed(tmp_path / "photos")
    with pytest.raises(UserError, match="no such folder"):
        gallery_text(sample, images=tmp_path / "other")
    (tmp_path / "other").mkdir()
    with pytest.raises(UserError, match=r"are not there: no 000\.jpg"):
        gallery_text(sample, images=tmp_path / "other")
    (tmp_path / "other" / "000.jpg").write_bytes(b"no photo")
    with pytest.raises(UserError, match=r"cannot be read: 000\.jpg"):
        gallery_text(sample, images=tmp_path / "other")
    sample.identity = {}
    with pytest.raises(UserError, match="'image'"):
        gallery_text(sample, images=tmp_path / "photos")


@pytest.mark.parametrize("name", ["../secret.png", "/{outside}/secret.png", "a/../../secret.png", "..", "", "."])
def test_no_name_leads_out_of_the_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(tmp_path / "secret.png")
    photos = Photos(tmp_path / "photos")
    assert photo_svg(photos, name.format(outside=tmp_path), Crop(0.0, 0.0, 20.0)) == ""
    assert photos.absent


def test_a_body_outside_of_its_photo_is_told(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(tmp_path / "a.png")
    photos = Photos(tmp_path)
    assert photo_svg(photos, "a.png", Crop(500.0, 500.0, 50.0)) == ""
    assert "what is to be shown is not in it" in photos.unreadable[0]


def test_a_crop_holds_all_points() -> None:
    points = np.array([[3.0, 4], [np.nan, 1], [90, 30]])
    placed = crop_of(points).place(points[[0, 2]])
    assert placed.min() > 0 and placed.max() < 400


# -- predict ----------------------------------------------------------------------------------------------

_SET = """
import numpy as np
from dataclasses import replace
from uplift.data.datasets import DataSet, WantedFile
from uplift.data.formats import read


class Photographs(DataSet):
    title = "Photographs"
    about = "Taken yesterday."

    def __init__(self, folder, shift_px: float = 0.0):
        super().__init__(folder)
        self.shift_px = shift_px

    def files(self, split):
        return [WantedFile(self.folder / f"{split}.npz", "annotations")]

    def read(self, split):
        data = read(self.folder / f"{split}.npz")
        names = np.array([f"{n:09d}.jpg" for n in range(len(data))])
        return replace(data, keypoints=data.keypoints + self.shift_px, identity={"image": names}, source="Photographs")
"""


@pytest.fixture
def lifter(here: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an untrained lifter's file, beside a set of one's own with its files."""
    monkeypatch.setenv("UPLIFT_CACHE", str(here / "cache"))
    (here / "photographs.py").write_text(_SET)
    (here / "files").mkdir()
    write_body(here / "files" / "train.npz", 30, skeleton="mpii16")
    torch.manual_seed(0)
    skeleton, settings = load_skeleton("mpii16"), LifterSettings(options={"units": 8, "blocks": 1})
    Model(Lifter(skeleton, settings).eval(), skeleton, settings).save(here / "lifter.pt")
    return here / "lifter.pt"


def test_poses_of_a_set_carry_the_names_of_their_images(lifter: Path, capsys) -> None:
    words = ["run=lifter.pt", "input=photographs.py:Photographs:train", "data.root=files"]
    assert status_of("predict", *words, "output=poses.npz") == 0
    assert "lifted 30 frames of mpii16" in capsys.readouterr().out
    data = read("poses.npz")
    assert data.identity["image"].tolist() == [f"{n:09d}.jpg" for n in range(30)]
    assert data.pose is not None and np.isfinite(data.pose).all() and data.unit == "px"
    np.testing.assert_allclose(data.keypoints, body_arrays(30, skeleton="mpii16")["keypoints"], atol=1e-3)
    assert status_of("predict", *words, "data.options.shift_px=50", "output=shifted.npz") == 0
    np.testing.assert_allclose(read("shifted.npz").keypoints - data.keypoints, 50, atol=1e-2)


def test_names_in_a_file_are_kept_too(lifter: Path) -> None:
    image = np.array([f"{n}.png" for n in range(30)])
    write_body(Path("a.npz"), 30, skeleton="mpii16", image=image, sequence=None)
    found = predict(lifter, "a.npz", "poses.npz")
    np.testing.assert_array_equal(found.identity["image"], image)
    np.testing.assert_array_equal(read("poses.npz").identity["image"], image)


def test_a_gallery_from_the_command_line(lifter: Path, capsys) -> None:
    words = ["run=lifter.pt", "input=photographs.py:Photographs:train", "data.root=files", "page=gallery"]
    assert status_of("predict", *words, "output=g.html", "frames=5", "seed=3") == 0
    assert "look: open g.html" in capsys.readouterr().out
    frames = frames_of(Path("g.html").read_text())
    rows = chosen_rows(predict(lifter, "photographs.py:Photographs:train", None, "data.root=files"), 5, 3)
    assert [frame.findtext(".//h2") for frame in frames] == [f"{row:09d}.jpg" for row in rows]
    assert all(len(frame.findall(".//figure[@class='turns']")) == 2 for frame in frames)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["input=mpi:train"], "Did you mean 'mpii'?"),
        (["input=photographs.py:Photographs:train"], "data.root=FOLDER"),
        (["input=photographs.py:Photos:train", "data.root=files"], "Did you mean 'Photographs'?"),
        (["input=photographs.py:Photographs:tarin", "data.root=files"], "Did you mean 'train'?"),
        (["input=photographs.py:Photographs:test", "data.root=files"], "Photographs: 1 file is not in"),
        (["input=photographs.py:Photographs:train", "data.root=files", "data.options.shift=3"], "'shift_px'"),
        (["input=files/train.npz", "data.root=files"], "input=files/train.npz is a file"),
        (["input=files/train.npz", "data.train=x"], "not one of its settings"),
        (["input=files/train.npz", "page=galery"], "Did you mean 'gallery'?"),
        (["input=files/train.npz", "page=gallery", "output=poses.npz"], "page=gallery is an .html"),
        (["input=files/train.npz", "page=gallery", "frames=many"], "frames='many', expected a whole number"),
        (["input=files/train.npz", "page=gallery", "frames=0"], "from 1 to 500"),
        (["input=files/train.npz", "page=gallery", "seed=-1"], "seed=-1"),
        (["input=files/train.npz", "page=gallery", "images=files"], "no clip00"),
        (["input=files/train.npz", "page=viewer", "frames=3"], "frames= goes with page=gallery"),
        (["input=files/train.npz", "seed=3"], "seed= goes with page=gallery"),
    ],
)
def test_what_does_not_go_together_is_refused(words: list[str], says: str, lifter: Path, capsys) -> None:
    output = [] if any(word.startswith("output=") for word in words) else ["output=page.html"]
    assert says in refusal(capsys, "predict", "run=lifter.pt", *words, *output)
    assert not Path("page.html").exists()


# -- in a browser -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "across"), [(1400, 12), (800, 6), (400, 4)])
def test_it_is_drawn_and_wraps(width: int, across: int, browser: Browser, tmp_path: Path) -> None:
    sample = _photographed(tmp_path / "photos")
    sample.confidence[:, 3] = 0
    write(sample, tmp_path / "page.html", page="gallery", images=tmp_path / "photos")
    page = Page(browser, tmp_path / "page.html", width=width)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert (
        page.run("getComputedStyle(document.querySelector('.views')).gridTemplateColumns.split(' ').length") == across
    )
    boxes = page.run(
        "[...document.querySelectorAll('.views svg')].map((s) => { const b = s.getBoundingClientRect(); return [b.width, b.height, b.right]; })"
    )
    assert len(boxes) == 36
    assert all(wide > 40 and tall > 50 and right <= width for wide, tall, right in boxes)
    colours = page.run(
        "['.l0', '.r0', '.k'].map((c) => getComputedStyle(document.querySelector('.frame ' + c)).stroke)"
    )
    assert len(set(colours)) == 3
    assert page.run("(async () => { const i = new Image(); i.src = document.querySelector('image').getAttribute('href'); await i.decode(); return i.naturalWidth; })()") > 50  # fmt: skip
    assert [trouble for trouble in page.troubles() if not trouble.startswith("request data:")] == []


def test_it_follows_the_scheme_and_prints_light(browser: Browser, tmp_path: Path) -> None:
    write(prediction(frames=2), tmp_path / "page.html", page="gallery")
    page = Page(browser, tmp_path / "page.html", prefers_color_scheme="dark")
    paper = "getComputedStyle(document.documentElement).getPropertyValue('--card').trim()"
    assert page.run(paper) == "#1c2024"
    page.call("Emulation.setEmulatedMedia", media="print", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    assert page.run(paper) == "#fffefb"
    assert page.run("getComputedStyle(document.querySelector('.frame')).breakInside") == "avoid"
