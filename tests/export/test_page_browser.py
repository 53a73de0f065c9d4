"""The page in headless Chromium: it draws, plays, scrubs, turns, answers keys and asks nothing of the network."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_browser import Browser, Page
from videos import numbered, write_video
from writers_samples import figure, prediction

from uplift.biomechanics.angles import joint_angles
from uplift.export import write
from uplift.export.live import LivePage
from uplift.models.live import LivePose
from uplift.models.prediction import Prediction
from uplift.skeleton.core import Angle

Open = Callable[..., Page]


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Open:
    """Return a function that writes a prediction's page and opens it."""

    def opened(sample: Prediction, **more: Any) -> Page:
        write(sample, tmp_path / "page.html")
        return Page(browser, tmp_path / "page.html", **more)

    return opened


def _two_clips() -> Prediction:
    identity = {"sequence": np.repeat(["first", "second"], [60, 20]), "frame": np.r_[0:60, 0:20] * 3}
    sample = prediction(frames=80, identity=identity, truth=True, uncertainty=True)
    sample.confidence[:, 3] = 0
    return sample


def test_it_draws_plays_scrubs_and_answers_keys(show: Open) -> None:
    page = show(_two_clips())
    page.until("uplift.state().playing && uplift.state().moment > 2")
    assert not page.key(" ")["playing"]
    assert page.key("Home")["moment"] == 0
    deep, flat = page.ink("deep"), page.ink("flat")
    assert deep[0] > 3000 and flat[0] > 800
    assert page.key("ArrowRight")["moment"] == 1
    assert page.key("ArrowRight", shift=True)["moment"] == 11
    assert page.key("ArrowLeft")["moment"] == 10
    assert page.ink("deep")[1] != deep[1] and page.ink("flat")[1] != flat[1]
    assert page.key("End")["moment"] == 59 == page.key("ArrowRight")["moment"]
    x, y = page.middle("scrub")
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y, button="left", clickCount=1)
    assert page.state()["moment"] in (29, 30)
    assert page.run("document.getElementById('clock').textContent").startswith(f"frame {3 * page.state()['moment']} ")
    page.run("{ const c = document.getElementById('clip'); c.value = 1; c.dispatchEvent(new Event('change')); }")
    assert {"clip": 1, "moment": 0, "frames": 20}.items() <= page.state().items()
    assert page.troubles() == []


def test_it_turns_zooms_and_comes_back(show: Open) -> None:
    page = show(_two_clips())
    page.key(" ")
    home, deep, flat = page.key("Home"), page.ink("deep"), page.ink("flat")
    x, y = page.middle("deep")
    page.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    page.mouse("mouseMoved", x + 90, y - 40, button="left", buttons=1)
    page.mouse("mouseReleased", x + 90, y - 40, button="left", clickCount=1)
    turned = page.state()
    assert turned["yaw"] == pytest.approx(home["yaw"] - 0.72) and turned["pitch"] == pytest.approx(home["pitch"] - 0.32)
    assert page.ink("deep")[1] != deep[1] and page.ink("flat") == flat
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-800)
    page.until("uplift.state().zoom > 1.3")
    page.key("0")
    page.until(f"uplift.state().zoom === 1 && uplift.state().yaw === {home['yaw']}")
    assert page.ink("deep") == deep
    page.key("2")
    page.until("Math.abs(uplift.state().yaw - Math.PI / 2) < 1e-9")
    page.key("r")
    page.until("uplift.state().yaw > Math.PI / 2 + 0.05")
    assert page.troubles() == []


def test_it_tells_the_joint_and_switches_what_is_drawn(show: Open) -> None:
    page = show(_two_clips())
    page.key(" ")
    drawn = [page.ink("deep")[1]]
    for name, setting, value in (
        ("l", "level", False),
        ("t", "truth", False),
        ("u", "uncertainty", True),
        ("n", "names", True),
    ):
        assert page.key(name)[setting] is value
        drawn.append(page.ink("deep")[1])
    assert len(set(drawn)) == len(drawn)
    page.run(
        "{ const flat = document.getElementById('flat'), box = flat.getBoundingClientRect(), tip = document.getElementById('tip');"
        "for (let x = box.left; x < box.right; x += 9) for (let y = box.top; y < box.bottom && tip.hidden; y += 9)"
        "flat.dispatchEvent(new PointerEvent('pointermove', {clientX: x, clientY: y, bubbles: true})); }"
    )
    text = page.run("document.getElementById('tip').textContent")
    assert text.startswith(page.state()["hover"]) and " mm" in text and "confidence 1.00" in text
    assert page.troubles() == []


def test_it_follows_the_scheme_and_narrow_windows(show: Open) -> None:
    page = show(_two_clips(), width=360, height=740, prefers_color_scheme="dark")
    assert page.run("document.documentElement.dataset.theme") == "dark"
    assert page.run("document.documentElement.scrollWidth") <= 360
    outside = "[...document.querySelectorAll('button, select, input')].filter((e) => e.getBoundingClientRect().right > 360).length"
    assert page.run(outside) == 0
    boxes = page.run(
        "['deep', 'flat', 'play'].map((id) => { const b = document.getElementById(id).getBoundingClientRect(); return [b.top, b.right]; })"
    )
    # The buttons of the clock are next to what they move.
    assert boxes[0][0] < boxes[2][0] < boxes[1][0] and all(right <= 360 for _, right in boxes)
    assert boxes[2][0] < 740
    assert page.run("document.getElementById('deep').width") == 2 * round(
        page.run("document.getElementById('deep').clientWidth")
    )
    assert page.troubles() == []


def test_a_phone_hits_every_button_and_swipes_past_the_poses(show: Open) -> None:
    two = prediction(
        frames=20, individuals=2, identity={"sequence": np.repeat(["0", "1"], 20)}, rooted=True, uncertainty=True
    )
    page = show(two, width=390, height=700, prefers_reduced_motion="reduce")
    assert page.small_targets() == []
    assert page.run("document.documentElement.scrollWidth") <= 390
    home = page.state()
    page.run("scrollTo(0, 0)")
    page.swipe("deep", down=-250)
    page.until("scrollY > 100")
    assert (page.state()["yaw"], page.state()["pitch"]) == (home["yaw"], home["pitch"])
    page.swipe("deep", across=-120, down=-20)
    assert page.state()["yaw"] > home["yaw"] + 0.5 and page.state()["pitch"] < home["pitch"]
    assert page.troubles() == []


def test_the_legend_tells_of_uncertainty_while_it_is_drawn(show: Open) -> None:
    page = show(prediction(frames=3, uncertainty=True), prefers_reduced_motion="reduce")
    shown = "[...document.querySelectorAll('.legend > span')].filter((e) => e.checkVisibility()).map((e) => e.innerText).join()"
    assert "expected error" not in page.run(shown)
    page.key("u")
    assert "expected error of a depth" in page.run(shown)


def test_reduced_motion_neither_plays_nor_glides(show: Open) -> None:
    page = show(_two_clips(), prefers_reduced_motion="reduce")
    assert not page.state()["playing"]
    assert page.key("3")["pitch"] == pytest.approx(np.pi / 2, abs=0.01)


@pytest.mark.parametrize("case", ["one frame", "crowd", "133 joints", "nothing seen"])
def test_it_draws_unusual_data(case: str, show: Open) -> None:
    sample = {
        "one frame": prediction(frames=1, fps=None, image_size=None),
        "crowd": prediction(frames=20, individuals=6, tilt=False),
        "133 joints": prediction(frames=5, joints=133),
        "nothing seen": prediction(frames=3, truth=True),
    }[case]
    if case == "nothing seen":
        sample.confidence[:], sample.keypoints[:], sample.pose[1] = 0, 0, np.nan
    page = show(sample)
    assert page.state()["figures"] == (6 if case == "crowd" else 1)
    assert page.run("document.body.innerText.includes('As in the image')") is (case == "crowd")
    assert page.ink("deep")[0] > 1500
    assert page.ink("flat")[0] > 500
    assert page.troubles() == []


def test_individuals_stand_where_they_are_or_in_place(show: Open) -> None:
    page = show(prediction(frames=40, individuals=3, rooted=True, uncertainty=True))
    page.key(" ")
    first, last = page.key("Home"), page.key("End")
    roots = np.array([first["roots"], last["roots"]])
    np.testing.assert_allclose(roots[1, :, 0] - roots[0, :, 0], 390, atol=3)
    np.testing.assert_allclose(np.diff(roots[0, :, 0]), 2000, atol=3)
    drawn = page.ink("deep")
    page.key("p")
    slots = [page.key(name)["roots"] for name in ("Home", "End")]
    np.testing.assert_array_equal(np.array(slots)[0, :, 0], np.array(slots)[1, :, 0])
    assert page.ink("deep")[1] != drawn[1]
    page.run("document.querySelector('#people button').click()")
    assert page.state()["figures"] == 2
    page.run("document.querySelector('#people button').click()")
    before = page.ink("flat")[1]
    assert page.key("c")["tint"] and page.ink("flat")[1] != before and page.state()["figures"] == 3
    assert page.troubles() == []


def test_filled_joints_are_hollow_and_show_their_uncertainty(show: Open) -> None:
    sample, calm = prediction(frames=2, uncertainty=True), {"prefers_reduced_motion": "reduce"}
    drawn = {show(sample, **calm).ink("deep")[1]}
    sample.filled = np.zeros(sample.confidence.shape, bool)
    sample.filled[:, 4] = True
    page = show(sample, **calm)
    drawn.add(page.ink("deep")[1])
    page.run(_TAP.format(joint="rhand"))
    text = page.run("document.getElementById('tip').textContent")
    assert text.startswith("rhand") and "place ± 150 mm" in text and "not seen in 2D, filled in" in text
    assert page.troubles() == []
    sample.uncertainty = None
    drawn.add(show(sample, **calm).ink("deep")[1])
    assert len(drawn) == 3


# A finger on the canvas, point after point, until the tip tells of the joint.
_TAP = (
    "{{ const deep = document.getElementById('deep'), box = deep.getBoundingClientRect(), tip = document.getElementById('tip');"
    "for (let x = box.left; x < box.right; x += 8) for (let y = box.top; y < box.bottom && !tip.textContent.startsWith('{joint}'); y += 8)"
    "for (const kind of ['pointerdown', 'pointerup'])"
    "deep.dispatchEvent(new PointerEvent(kind, {{clientX: x, clientY: y, pointerId: 7, pointerType: 'touch', bubbles: true}})); }}"
)


def test_fingers_turn_zoom_and_scrub(show: Open) -> None:
    page = show(_two_clips(), prefers_reduced_motion="reduce")
    page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    home, (x, y) = page.state(), page.middle("deep")

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": px, "y": py, "id": n} for n, (px, py) in enumerate(points)]
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=at)

    touch("touchStart", (x, y))
    touch("touchMove", (x + 50, y))
    touch("touchEnd")
    assert page.state()["yaw"] == pytest.approx(home["yaw"] - 0.4) and page.state()["zoom"] == 1
    touch("touchStart", (x - 20, y), (x + 20, y))
    touch("touchMove", (x - 40, y), (x + 40, y))
    touch("touchEnd")
    assert page.state()["zoom"] == pytest.approx(2, rel=0.05)
    x, y = page.middle("scrub")
    touch("touchStart", (x, y))
    touch("touchEnd")
    assert page.state()["moment"] in (29, 30)
    assert page.troubles() == []


def test_keys_zoom_turn_and_change_speed(show: Open) -> None:
    page = show(_two_clips(), prefers_reduced_motion="reduce")
    home = page.state()
    assert page.key("+")["zoom"] == pytest.approx(1.2) and page.key("-")["zoom"] == pytest.approx(1)
    assert page.key("a")["yaw"] > home["yaw"] and page.key("w")["pitch"] > home["pitch"]
    assert page.key(".")["speed"] == 2 and page.key(",")["speed"] == 1 and page.key(",")["speed"] == 0.5
    assert page.key("PageDown")["clip"] == 1 == page.key("PageDown")["clip"] and page.key("PageUp")["clip"] == 0
    assert page.troubles() == []


def test_photos_are_stepped_through_and_found_by_name(show: Open) -> None:
    names = np.array([f"{animal}_{n}.jpg" for animal in ("cat", "dog") for n in range(10)])
    page = show(prediction(frames=20, identity={"image": names}, fps=None))
    assert {"clips": 20, "frames": 1, "playing": False}.items() <= page.state().items()
    drawn = page.ink("deep")[1]
    assert page.key("ArrowRight")["clip"] == 1 and page.ink("deep")[1] != drawn
    assert page.key("End")["clip"] == 19 and page.key("Home")["clip"] == 0
    assert page.run("document.getElementById('clock').textContent") == "photo 1 of 20"
    assert page.run("document.getElementById('play').hidden")
    page.run("{ const f = document.getElementById('find'); f.value = 'dog'; f.dispatchEvent(new Event('input')); }")
    assert page.state()["clip"] == 10 and page.run("document.getElementById('clip').options.length") == 10
    assert page.key("End")["clip"] == 19 and page.key("Home")["clip"] == 10
    assert page.troubles() == []


def test_a_thousand_frames_of_three_play_on_time(show: Open) -> None:
    page = show(prediction(frames=1000, individuals=3, fps=50.0, rooted=True, uncertainty=True))
    start, before = time.monotonic(), page.state()
    page.until("uplift.state().moment > 80", 10)
    took, after = time.monotonic() - start, page.state()
    shown = (after["painted"] - before["painted"]) / (after["moment"] - before["moment"])
    # 50 a second is asked for; a busy machine may drop drawings, not fall behind the clock by half.
    assert took < 2 * 80 / 50 and shown > 0.3
    page.key(" ")
    times = page.run(
        "Array.from({length: 60}, (_, n) => { uplift.draw({moment: 9 * n}); return uplift.state().drawMs; })"
    )
    assert np.median(times) < 8


def test_a_hostile_title_runs_nothing(show: Open) -> None:
    title = "</title></script><script>window.hacked=1</script><img src=x onerror='window.hacked=1'>"
    page = show(prediction(frames=2, title=title))
    assert page.run("window.hacked === undefined") and page.run("document.querySelector('h1').textContent") == title
    assert page.troubles() == []


def test_the_video_is_drawn_behind_the_keypoints(browser: Browser, tmp_path: Path) -> None:
    pytest.importorskip("av")
    video = write_video(tmp_path / "a.mp4", numbered(30, (640, 480)))
    sample = prediction(frames=20, identity={"sequence": np.repeat("a", 20), "frame": np.arange(5, 25)})
    write(sample, tmp_path / "page.html", video=video)
    page = Page(browser, tmp_path / "page.html")
    page.until("!document.querySelector('[data-toggle=video]').hidden")
    page.key(" ")
    last = page.key("End")["moment"]
    grey = "(() => { const c = document.getElementById('flat'); const [x, y] = [c.width / 2, c.height * 0.9];"
    grey += " return Array.from(c.getContext('2d').getImageData(x, y, 1, 1).data); })()"
    page.until(f"Math.abs({grey}[0] - {8 * (5 + last)}) < 12")
    page.key("v")
    assert page.run(grey)[3] == 0 and not page.state()["video"]


def test_joint_angles_are_plotted_by_name_and_seek(show: Open) -> None:
    skeleton = replace(
        figure(),
        angles={
            "right_arm": Angle((("neck",), ("rhand",)), (("neck",), ("hip",))),
            "trunk_lean": Angle((("hip",), ("neck",)), "up"),
        },
    )
    sample = replace(prediction(frames=60, uncertainty=True), skeleton=skeleton)
    page = show(sample)
    page.key(" ")
    assert page.run("[...document.getElementById('angle').options].map((one) => one.text).join()") == "arm,trunk lean"
    first = page.ink("plot")
    assert first[0] > 500
    page.run(
        "{ const c = document.getElementById('angle'); c.selectedIndex = 1 - c.selectedIndex; c.dispatchEvent(new Event('change')); }"
    )
    page.key("Home")
    assert page.ink("plot")[1] != first[1]
    x, y = page.middle("plot")
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y, button="left", clickCount=1)
    assert abs(page.state()["moment"] - 29) <= 3
    page.run("{ const c = document.getElementById('angle'); c.value = 0; c.dispatchEvent(new Event('change')); }")
    page.key("ArrowRight")
    told, found = page.run("document.getElementById('angle-note').textContent"), joint_angles(sample)
    right, left = found.values[page.state()["moment"], :2]
    assert told.startswith(f"right {right:.0f}° ± ") and f"left {left:.0f}° ± " in told
    assert page.troubles() == []


def test_a_skeleton_without_angles_shows_no_plot(show: Open) -> None:
    page = show(prediction(frames=20))
    assert page.run("document.getElementById('angles').hidden") is True
    assert page.troubles() == []


def test_a_live_page_draws_what_comes(browser: Browser) -> None:
    class Address:
        def as_uri(self) -> str:
            return live.address

    sample = prediction(frames=3)
    image = numbered(1, (640, 480))[0]
    with LivePage("Sample", sample.skeleton) as live:
        ended = threading.Event()

        def send() -> None:
            for frame in range(400):
                row = frame % 3
                pose = sample.level_pose[row].astype(float) / 700
                one = LivePose(0, sample.keypoints[row], sample.confidence[row], pose, 150.0)
                live.show(frame, image, [one])
                if ended.wait(0.05):
                    return

        threading.Thread(target=send, daemon=True).start()
        page = Page(browser, Address())
        page.until("uplift.state().people === 1 && uplift.state().frame > 3")
        page.frames()
        flat = "(() => { const c = document.getElementById('flat'); const x = c.getContext('2d');"
        flat += " return Array.from(x.getImageData(c.width / 2 - 40, c.height / 2 - 100, 1, 1).data); })()"
        assert page.run(flat)[0] > 200  # the red quarter of the picture
        assert page.ink("deep")[0] > 200
        ended.set()
