"""The page in headless Chromium: it draws, plays, scrubs, turns, answers keys and asks nothing of the network."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from writers_samples import prediction

from uplift.prediction import Prediction
from uplift.writers.html import page_text

_BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(_BROWSER is None, reason="no Chromium on this machine (Debian: apt-get install chromium)")

_HELPERS = """
const found = {problems: []};
addEventListener('error', (event) => found.problems.push(String(event.message)));
addEventListener('securitypolicyviolation', (event) => found.problems.push(event.violatedDirective));
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const key = async (name, more = {}) => { document.body.dispatchEvent(new KeyboardEvent('keydown', {key: name, bubbles: true, cancelable: true, ...more})); await wait(80); };
const one = (id) => document.getElementById(id);
const ink = (id) => {
  const {data} = one(id).getContext('2d').getImageData(0, 0, one(id).width, one(id).height);
  let count = 0, sum = 0;
  for (let k = 0; k < data.length; k += 4) if (data[k + 3]) { count++; sum = (sum * 31 + data[k] + data[k + 1] * 3 + k) % 1e9; }
  return {count, sum};
};
const pointer = (id, type, x, y, more = {}) => {
  const box = one(id).getBoundingClientRect();
  one(id).dispatchEvent(new PointerEvent(type, {clientX: box.left + x * box.width, clientY: box.top + y * box.height, pointerId: 1, buttons: 1, bubbles: true, ...more}));
};
"""


def drive(folder: Path, text: str, steps: str, width: int = 1200, *flags: str) -> dict[str, Any]:
    """Run ``steps`` (JavaScript that fills ``found``) inside the page and return what it found."""
    script = (
        f"(async () => {{{_HELPERS}\nfor (let n = 0; n < 100 && !document.documentElement.dataset.ready; n++) await wait(20);"
        f"try {{ {steps} }} catch (error) {{ found.problems.push(String(error)); }}\n"
        "found.ready = document.documentElement.dataset.ready;"
        "found.requests = performance.getEntriesByType('resource').length;"
        "found.overflow = document.documentElement.scrollWidth - innerWidth;"
        "document.documentElement.dataset.found = JSON.stringify(found); })();"
    )
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    text = text.replace("script-src ", f"script-src 'sha256-{allowed}' ", 1)
    text = text.replace("</body>", f"<script>{script}</script></body>")
    (folder / "page.html").write_text(text, encoding="utf-8")
    command = [
        str(_BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
        f"--user-data-dir={folder / 'profile'}", f"--window-size={width},900", "--virtual-time-budget=6000", *flags,
        "--dump-dom", (folder / "page.html").as_uri(),
    ]  # fmt: skip
    dom = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False).stdout
    match = re.search(r'data-found="(.*?)"', dom)
    assert match, f"the page never finished; it says: {dom[-600:]}"
    return json.loads(html.unescape(match[1]))


_STEPS = """
found.start = uplift.state();
await wait(600);
found.played = uplift.state();
await key(' ');
found.paused = uplift.state();
await wait(300);
found.later = uplift.state();
await key('Home');
found.home = {...uplift.state(), deep: ink('deep'), flat: ink('flat')};
await key('ArrowRight'); await key('ArrowRight', {shiftKey: true});
found.right = uplift.state();
await key('End');
found.end = uplift.state();
one('scrub').value = 7; one('scrub').dispatchEvent(new Event('input')); await wait(80);
found.scrubbed = {...uplift.state(), deep: ink('deep'), flat: ink('flat'), clock: one('clock').textContent};
pointer('deep', 'pointerdown', .5, .5); pointer('deep', 'pointermove', .7, .4); pointer('deep', 'pointerup', .7, .4); await wait(80);
found.turned = {...uplift.state(), deep: ink('deep'), flat: ink('flat')};
one('deep').dispatchEvent(new WheelEvent('wheel', {deltaY: -300, cancelable: true})); await wait(80);
found.zoomed = uplift.state();
one('deep').dispatchEvent(new MouseEvent('dblclick')); await wait(600);
found.reset = uplift.state();
await key('2'); await wait(500);
found.side = uplift.state();
for (let x = .2; x < .8 && one('tip').hidden; x += .01) for (let y = .1; y < .9 && one('tip').hidden; y += .01) pointer('flat', 'pointermove', x, y);
await wait(80);
found.tip = {text: one('tip').textContent, hover: uplift.state().hover, hidden: one('tip').hidden};
await key('l'); found.camera = {...uplift.state(), deep: ink('deep')};
await key('t'); found.bare = {...uplift.state(), deep: ink('deep')};
await key('r'); await wait(300); found.spun = uplift.state(); await key('r');
one('clip').value = 1; one('clip').dispatchEvent(new Event('change')); await wait(80);
found.second = uplift.state();
one('theme').click(); await wait(80);
found.theme = document.documentElement.dataset.theme;
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what a drive through every control of a page of two clips found."""
    identity = {"sequence": np.repeat(["first", "second"], [60, 20]), "frame": np.r_[0:60, 0:20] * 3}
    sample = prediction(frames=80, identity=identity, truth=True, spread=True)
    sample.confidence[:, 3] = 0
    return drive(tmp_path_factory.mktemp("page"), page_text(sample), _STEPS)


def test_it_runs_without_trouble_or_network(found: dict[str, Any]) -> None:
    assert found["problems"] == [] and found["ready"] == "yes"
    assert found["requests"] == 0
    assert found["overflow"] <= 0


def test_it_draws_and_plays(found: dict[str, Any]) -> None:
    assert found["home"]["deep"]["count"] > 1500 and found["home"]["flat"]["count"] > 300
    assert found["start"]["playing"] and found["played"]["moment"] > found["start"]["moment"]
    assert not found["paused"]["playing"] and found["later"]["moment"] == found["paused"]["moment"]


def test_it_answers_keys_and_scrubs(found: dict[str, Any]) -> None:
    assert [found[name]["moment"] for name in ("home", "right", "end", "scrubbed")] == [0, 11, 59, 7]
    assert found["scrubbed"]["deep"]["sum"] != found["home"]["deep"]["sum"]
    assert found["scrubbed"]["flat"]["sum"] != found["home"]["flat"]["sum"]
    assert found["scrubbed"]["clock"].startswith("frame 21 ")


def test_it_turns_zooms_and_comes_back(found: dict[str, Any]) -> None:
    assert abs(found["turned"]["yaw"] - found["scrubbed"]["yaw"]) > 0.3
    assert found["turned"]["deep"]["sum"] != found["scrubbed"]["deep"]["sum"]
    assert found["turned"]["flat"]["sum"] == found["scrubbed"]["flat"]["sum"]
    assert found["zoomed"]["zoom"] > 1.3
    home = {name: found["home"][name] for name in ("yaw", "pitch", "zoom")}
    assert {name: found["reset"][name] for name in home} == pytest.approx(home)
    assert found["side"]["yaw"] == pytest.approx(np.pi / 2)


def test_it_tells_switches_and_spins(found: dict[str, Any]) -> None:
    assert not found["tip"]["hidden"] and found["tip"]["text"].startswith(found["tip"]["hover"])
    assert "confidence 1.00" in found["tip"]["text"] and " mm" in found["tip"]["text"]
    assert found["reset"]["level"] and not found["camera"]["level"]
    assert found["camera"]["truth"] and not found["bare"]["truth"]
    assert found["bare"]["deep"]["sum"] != found["camera"]["deep"]["sum"]
    assert found["spun"]["yaw"] > found["bare"]["yaw"] + 0.05
    assert (found["second"]["clip"], found["second"]["moment"], found["second"]["frames"]) == (1, 0, 20)
    assert found["theme"] == "dark"


_LOOK = "await wait(100); found.deep = ink('deep'); found.state = uplift.state(); found.motion = matchMedia('(prefers-reduced-motion: reduce)').matches;"


@pytest.mark.parametrize("case", ["one frame", "crowd, narrow", "133 joints", "nothing seen", "no motion"])
def test_it_draws_unusual_data(case: str, tmp_path: Path) -> None:
    sample: Prediction = {
        "one frame": prediction(frames=1, fps=None, image_size=None),
        "crowd, narrow": prediction(frames=20, individuals=6, tilt=False),
        "133 joints": prediction(frames=5, joints=133),
        "nothing seen": prediction(frames=3, truth=True),
        "no motion": prediction(frames=9),
    }[case]
    if case == "nothing seen":
        sample.confidence[:], sample.keypoints[:], sample.pose[1] = 0, 0, np.nan
    flags = ["--force-prefers-reduced-motion"] if case == "no motion" else []
    width = 500 if "narrow" in case else 1200
    found = drive(tmp_path, page_text(sample), _LOOK, width, *flags)
    assert found["problems"] == [] and found["ready"] == "yes" and found["requests"] == 0
    assert found["deep"]["count"] > 500 and found["overflow"] <= 0
    assert found["state"]["figures"] == (6 if "crowd" in case else 1)
    assert found["state"]["playing"] == (case in ("crowd, narrow", "133 joints", "nothing seen"))


def test_a_hostile_title_runs_nothing(tmp_path: Path) -> None:
    sample = prediction(frames=2, title="</title></script><script>window.hacked=1</script><img src=x onerror='window.hacked=1'>")
    steps = "await wait(50); found.hacked = Boolean(window.hacked); found.heading = document.querySelector('h1').textContent;"
    found = drive(tmp_path, page_text(sample), steps)
    assert not found["hacked"] and found["heading"] == sample.title and found["problems"] == []
