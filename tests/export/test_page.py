"""The page: what it embeds, what it escapes, what it leaves out."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from videos import numbered, write_video
from videos import shown as number_of
from writers_samples import figure, prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.clips import arrange
from uplift.export.html import _ASSETS, Term, curve_charts, pack, read_html, report_html, unpack
from uplift.export.page import choose, page_text
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.skeleton.core import CENTRE, LEFT, RIGHT, joint_sides

_NASTY = '</script><script>alert(1)</script><b>"it\'s" & {{data}} <!--'


def _arrays(sample: Prediction) -> dict[str, np.ndarray]:
    found = re.search(r'id="data">(.*?)</script>', page_text(sample), re.S)
    assert found is not None
    data = json.loads(found[1])
    return unpack(data["packed"], data["layout"])


@given(
    arrays(np.float32, array_shapes(min_dims=2, max_dims=3, max_side=9), elements=st.floats(-1e4, 1e4, width=32)),
    st.floats(1e-3, 1.0),
)
@settings(deadline=None, derandomize=True, max_examples=60)
def test_packing_is_exact_to_half_a_step(values: np.ndarray, finest: float) -> None:
    text, layout = pack({"a": (values, finest), "b": (-values, finest)})
    found = unpack(text, layout)
    step = layout[0]["step"]
    assert step <= max(finest, np.ptp(values) / 65532) * (1 + 1e-6)
    np.testing.assert_allclose(found["a"], values, atol=step * 0.5001)
    np.testing.assert_allclose(found["b"], -values, atol=step * 0.5001)


def test_packing_keeps_zero_and_absence() -> None:
    values = np.array([[0.0, np.nan], [np.inf, 7.3]])
    found = unpack(*pack({"a": (values, 0.01)}))["a"]
    assert found[0, 0] == 0 and np.isnan(found[0, 1]) and np.isnan(found[1, 0])


def test_page_gives_back_the_poses(tmp_path: Path) -> None:
    sample = prediction(frames=40, truth=True, uncertainty=True)
    write(sample, tmp_path / "page.html")
    data = read_html(tmp_path / "page.html")
    steps = np.abs(sample.pose).max() / 4096
    np.testing.assert_allclose(data["arrays"]["pose"], sample.pose, atol=steps)
    assert sample.truth is not None
    np.testing.assert_allclose(data["arrays"]["truth"], sample.truth, atol=2 * steps)
    np.testing.assert_allclose(data["arrays"]["keypoints"], sample.keypoints, atol=0.05)
    level = np.einsum("fik,fjk->fji", data["arrays"]["level"], data["arrays"]["pose"])
    np.testing.assert_allclose(level, sample.level_pose, atol=4 * steps)
    assert tuple(data["joints"]) == sample.joint_names and data["unit"] == "mm"


def test_truth_of_another_size_is_drawn_at_the_size_of_the_pose(tmp_path: Path) -> None:
    sample = prediction(frames=5)
    sample.unit, sample.truth = "relative", sample.pose * 7
    write(sample, tmp_path / "page.html")
    data = read_html(tmp_path / "page.html")
    np.testing.assert_allclose(data["arrays"]["truth"], sample.pose, atol=0.5)
    np.testing.assert_allclose(data["arrays"]["error"], 0, atol=1e-6)
    assert "not metric" in (tmp_path / "page.html").read_text()


def test_individuals_stand_apart_as_in_the_image(tmp_path: Path) -> None:
    write(prediction(frames=30, individuals=3), tmp_path / "page.html")
    data = read_html(tmp_path / "page.html")
    across = [data["arrays"]["place"][data["arrays"]["individual"] == one, 0].mean() for one in range(3)]
    np.testing.assert_allclose(np.diff(across), 200 / 0.2, rtol=0.05)
    assert data["clips"][0]["individuals"] == ["animal 0", "animal 1", "animal 2"]


def test_known_places_are_kept_and_levelled_as_one() -> None:
    sample = prediction(frames=60, individuals=2, rooted=True)
    assert sample.root is not None
    found = _arrays(sample)
    np.testing.assert_allclose(found["place"], sample.root, atol=0.5)
    # One turn takes all places from the camera's axes to level ones.
    u, _, vt = np.linalg.svd(found["place"].T @ found["levelPlace"])
    assert np.linalg.det(u @ vt) > 0
    np.testing.assert_allclose(found["place"] @ u @ vt, found["levelPlace"], atol=2)
    # Every pose has its own tilt; the floor that they stand on is one, and even.
    pose = np.einsum("fik,fjk->fji", found["level"], found["pose"])
    lowest = (pose + found["levelPlace"][:, None])[..., 1].max(1)
    assert np.ptp(lowest) < 5
    np.testing.assert_allclose(np.diff(found["levelPlace"][:60, 0]), 10, atol=1)


def test_a_lost_place_lies_between_its_neighbours(tmp_path: Path) -> None:
    sample = prediction(frames=60, individuals=2, rooted=True)
    assert sample.root is not None
    whole = sample.root.copy()
    sample.root[[0, 20, 21, 80]] = np.nan
    write(sample, tmp_path / "page.html")
    found = read_html(tmp_path / "page.html")["arrays"]["place"]
    np.testing.assert_allclose(
        found[[20, 21]], whole[[19]] + np.array([[1], [2]]) / 3 * (whole[22] - whole[19]), atol=0.5
    )
    np.testing.assert_allclose(found[0], whole[1], atol=0.5)
    assert "4 poses without a known place" in (tmp_path / "page.html").read_text()


def test_filled_joints_are_told_or_those_without_confidence() -> None:
    sample = prediction(frames=4)
    sample.confidence[:, 2] = 0
    assert (_arrays(sample)["filled"].nonzero()[1] == 2).all()
    sample.filled = np.zeros(sample.confidence.shape, bool)
    sample.filled[1, 5] = True
    assert np.argwhere(_arrays(sample)["filled"]).tolist() == [[1, 5]]


def test_other_axes_are_refused() -> None:
    sample = prediction(frames=1)
    sample.axes = "blender"
    with pytest.raises(UserError, match="in 'blender'"):
        page_text(sample)


def test_photos_are_counted_as_such() -> None:
    sample = prediction(frames=3, identity={"image": np.array(["a.jpg", "b.jpg", "c.jpg"])})
    text = page_text(sample)
    assert "3 photos" in text and "3 frames" not in text and "3 clips" not in text


def test_numbers_in_names_say_of_what(tmp_path: Path) -> None:
    identity = {
        "sequence": np.repeat(["000000", "walk"], 2),
        "camera": np.array([0, 1, 0, 0]),
        "instance": np.arange(4) % 2,
    }
    clips = arrange(identity, 4)
    assert [clip.title for clip in clips] == ["clip 000000 · camera 0", "clip 000000 · camera 1", "walk · camera 0"]
    assert [clip.name for clip in clips] == ["000000 · 0", "000000 · 1", "walk · 0"]  # in names of files
    write(prediction(frames=4, identity=identity), tmp_path / "page.html")
    shown = read_html(tmp_path / "page.html")["clips"]
    assert [clip["individuals"] for clip in shown] == [
        ["individual 0"],
        ["individual 1"],
        ["individual 0", "individual 1"],
    ]


def _luminance(colour: str) -> float:
    """Return the relative luminance of WCAG 2."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("sheet", ["page.css", "gallery.css"])
def test_text_can_be_read_in_light_and_dark(sheet: str) -> None:
    themes = [
        dict(re.findall(r"--(\w+): (#\w{6})", block))
        for block in re.findall(r"{[^{}]*--paper:[^{}]*}", (_ASSETS / sheet).read_text())
    ]
    assert len(themes) == 2
    for theme in themes:
        for text in ("ink", "soft"):
            for ground in ("paper", "card"):
                low, high = sorted(_luminance(theme[name]) for name in (text, ground))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (theme[text], theme[ground])


def test_page_needs_nothing_from_outside() -> None:
    text = page_text(prediction(frames=3, truth=True), curves={"loss": [(0, 1.0), (1, 0.5)]})
    assert "http://" not in text and "https://" not in text
    assert not re.search(r"<link|<img|<iframe|@import|url\(|\bsrc=|\bfetch\(|XMLHttp|WebSocket|eval\(", text)
    assert "default-src 'none'" in text


def test_text_from_the_data_stays_text(tmp_path: Path) -> None:
    skeleton = Skeleton(_NASTY, (_NASTY, "tip"), _NASTY, ((_NASTY, "tip"),))
    sample = prediction(frames=2, joints=2)
    sample.skeleton, sample.joint_names = skeleton, skeleton.joints
    sample.title = sample.source = _NASTY
    sample.identity = {"sequence": np.array([_NASTY, "other"])}
    options = {
        "sections": [(_NASTY, [(_NASTY, 1.0)], (_NASTY, _NASTY))],
        "curves": {_NASTY: [(0, 1), (1, 2)]},
        "notes": [_NASTY],
    }
    write(sample, tmp_path / "page.html", **options)
    text = (tmp_path / "page.html").read_text()
    assert text.count("<script") == text.count("</script>") == 2
    assert '<b>"' not in text and "<!--" not in text
    assert read_html(tmp_path / "page.html")["clips"][0]["name"] == _NASTY


def test_not_a_number_never_reaches_the_page(tmp_path: Path) -> None:
    sample = prediction(frames=4, truth=True, uncertainty=True)
    sample.pose[1, 2], sample.level_pose[1, 2], sample.keypoints[2] = np.nan, np.inf, np.nan
    assert sample.truth is not None and sample.uncertainty is not None
    sample.truth[3], sample.confidence[0, 0], sample.uncertainty[2, 1] = np.nan, np.nan, np.nan
    write(
        sample, tmp_path / "page.html", sections=[("t", [("x", float("nan"))])], curves={"c": [(0, np.nan), (1, 1.0)]}
    )
    found = read_html(tmp_path / "page.html")["arrays"]
    assert np.isnan(found["pose"][1, 2]).all() and np.isfinite(found["pose"]).sum() == found["pose"].size - 3
    assert (found["confidence"][2] == 0).all() and found["confidence"][0, 0] == 0
    assert np.isnan(found["error"][3]) and np.isfinite(found["error"][:3]).all()
    assert "NaN" not in re.sub(r"<script>.*?</script>", "", (tmp_path / "page.html").read_text(), flags=re.S)


def test_thousand_frames_of_three_are_small() -> None:
    assert len(page_text(prediction(frames=1000, individuals=3, uncertainty=True, rooted=True))) < 700_000


def test_empty_prediction_is_refused() -> None:
    with pytest.raises(UserError, match="no frame"):
        page_text(prediction(frames=0))


def test_a_file_that_is_no_page_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.html").write_text("<p>hello</p>")
    with pytest.raises(UserError, match="not a page"):
        read_html(tmp_path / "other.html")


def test_page_says_what_it_left_out(tmp_path: Path) -> None:
    identity = {"sequence": np.repeat([f"clip{n:02d}" for n in range(20)], 50)}
    write(prediction(frames=1000, identity=identity), tmp_path / "page.html", frames=200)
    data = read_html(tmp_path / "page.html")
    assert [clip["name"] for clip in data["clips"]] == ["clip00", "clip06", "clip13", "clip19"]
    assert "200 of 1,000 frames (4 of 20 clips" in (tmp_path / "page.html").read_text()


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 9)), max_size=60, min_size=1),
    st.booleans(), st.integers(1, 40),
)  # fmt: skip
@settings(deadline=None, derandomize=True, max_examples=80)
def test_every_row_is_in_one_clip_once(rows: list, several: bool, limit: int) -> None:
    sequence, instance, frame = (np.array(column) for column in zip(*rows, strict=True))
    identity = {"sequence": sequence, "frame": frame} | ({"instance": instance} if several else {})
    clips = arrange(identity, len(rows))
    assert sorted(row for clip in clips for row in clip.rows) == list(range(len(rows)))
    for clip in clips:
        assert len(set(sequence[clip.rows])) == 1
        assert set(clip.moment) == set(range(len(clip.frames)))
        assert frame[clip.rows].tolist() == [clip.frames[m] for m in clip.moment]
    chosen = choose(clips, limit, limit)
    assert chosen and sum(len(clip.frames) for clip in chosen) <= limit


def test_photos_are_clips_and_frames_of_a_film_are_not() -> None:
    image = np.array(["a.jpg", "b.jpg", "a.jpg"])
    assert [(clip.name, clip.rows.tolist()) for clip in arrange({"image": image}, 3)] == [
        ("a.jpg", [0, 2]),
        ("b.jpg", [1]),
    ]
    assert len(arrange({"image": image, "sequence": np.array(["walk"] * 3)}, 3)) == 1
    assert len(arrange({"image": image, "frame": np.arange(3)}, 3)) == 1


def test_sides_come_from_names_then_from_facing_then_from_order() -> None:
    def sides(mirror: tuple, facing: dict | None = None) -> list[int]:
        names = (*(name for pair in mirror for name in pair), "mid")
        return joint_sides(Skeleton("s", names, "mid", (), mirror=mirror, facing=facing or {}), names)

    assert joint_sides(figure(), figure().joints) == [CENTRE] * 3 + [LEFT, RIGHT] * 2
    assert sides((("HipL", "HipR"), ("R_toe", "L_toe"))) == [LEFT, RIGHT, RIGHT, LEFT, CENTRE]
    assert sides((("right_ear", "left_ear"), ("a", "b"))) == [RIGHT, LEFT, RIGHT, LEFT, CENTRE]
    assert sides((("a", "b"), ("c", "d")), {"left": (("d",), ("c",))}) == [LEFT, RIGHT, LEFT, RIGHT, CENTRE]


def test_a_row_of_titles_becomes_the_header() -> None:
    numbers = [["protocol", "this run", "flat"], ["p_mpjpe", 61.25, 121.0], ["facing", np.float32(0.9871), ""]]
    text = page_text(prediction(frames=1), sections=[("Errors", numbers), ("Settings", [("task", "cmu"), ("seed", 0)])])
    assert text.count("<thead>") == 1 and '<th scope="col">protocol</th>' in text.split("</thead>")[0]
    assert "<td>61.2</td>" in text and "<td>0.987</td>" in text and '<th scope="row">task</th><td>cmu</td>' in text


def test_charts_survive_flat_single_and_long_curves() -> None:
    curves = {"flat": [(0, 1.0), (9, 1.0)], "one": [(5, 2.0)], "long": [(n, n % 7) for n in range(9000)], "none": []}
    text = curve_charts(curves)
    assert text.count("<svg") == 2 and "nan" not in text and len(text) < 20_000
    assert "Logged once: one: 2, at step 5." in text  # a single point makes no line
    for shown, says in (({}, True), (curves, False), (None, False)):
        assert ("there are no curves" in report_html([], shown)) is says


def test_a_term_of_the_field_stands_below_plain_words() -> None:
    cell = Term("Joint error", "<mpjpe> · mm", 'a "meaning"')
    text = report_html([("Errors", [[cell, 12.0]], ["Measure", "this run"])], None)
    assert (
        '<th scope="row" title="a &quot;meaning&quot;">Joint error<small>&lt;mpjpe&gt; · mm</small></th><td>12</td>'
        in text
    )


def test_a_page_has_small_pictures_of_its_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("av")
    video = write_video(tmp_path / "a.mp4", numbered(30, (640, 480)))
    identity = {"sequence": np.repeat("a", 20), "frame": np.arange(5, 25)}
    sample = prediction(frames=20, identity=identity)
    write(sample, tmp_path / "page.html", video=video)
    (behind,) = read_html(tmp_path / "page.html")["behind"]
    seen = sample.keypoints.reshape(-1, 2)
    assert (seen.min(0) > [behind["x"], behind["y"]]).all()
    assert (seen.max(0) < [behind["x"] + behind["wide"], behind["y"] + behind["tall"]]).all()
    pictures = [Image.open(io.BytesIO(base64.b64decode(text))) for text in behind["jpegs"]]
    assert len(pictures) == 20 and behind["every"] == 1 and max(picture.width for picture in pictures) <= 480
    assert [number_of(np.asarray(picture)) for picture in pictures] == list(range(5, 25))
    whole = numbered(1, (640, 480))[0]
    left, top = round(behind["x"]), round(behind["y"])
    corner = whole[top : round(top + behind["tall"]), left : round(left + behind["wide"])]
    small = np.asarray(pictures[0].resize(corner.shape[1::-1])).astype(int)
    red = small[..., 0] - small[..., 1] > 120
    assert (red == (corner[..., 0] == 255)).mean() > 0.97  # at its place in the image
    monkeypatch.setattr("uplift.export.behind._MOST_BYTES", 2000)
    write(sample, tmp_path / "small.html", video=video)
    (behind,) = read_html(tmp_path / "small.html")["behind"]
    assert behind["every"] > 3 and len(behind["jpegs"]) == -(-20 // behind["every"])
    assert sum(map(len, behind["jpegs"])) * 3 / 4 < 2 * 2000 and "every" in (tmp_path / "small.html").read_text()
