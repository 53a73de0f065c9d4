"""The beetle tutorial, followed to the letter in an empty folder."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from bodies import QUICK, status_of
from page_browser import Page

from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.synthetic.simulate import simulate
from uplift.skeleton import load_skeleton
from uplift.skeleton.propose import propose

PAGE = Path(__file__).resolve().parents[2] / "docs/beetle.md"
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
# The tutorial does not use the critic; everything else is made small.
_SMALL = (*(word for word in QUICK if not word.startswith("priors.critic.")), "lifter.refine.iterations=3")
_FEWER = {"12000": "240", "3000": "60", "clip_seconds=30": "clip_seconds=0.6"}


@dataclass
class Step:
    """A command of the page, its exit status and its output."""

    command: str
    status: int
    output: str


@dataclass
class Story:
    """The folder in which the page was followed, and the results."""

    folder: Path
    steps: list[Step]
    shown: list[tuple[str, str]]
    """Lines of output that the page shows, each with the output of all commands before it."""


def _blocks() -> Iterator[tuple[str, str]]:
    yield from ((kind, text) for kind, text in _FENCE.findall(PAGE.read_text()))


def _without_figures(text: str) -> str:
    text = re.sub(r"\d{4}-\d\d-\d\d_[-\d]+", "<time>", text)
    text = re.sub(r"\d[\d.,]*", "#", text)
    return re.sub(r"\s+", " ", text).strip()


def _smaller(command: str) -> list[str]:
    """Return the arguments of a command, with few frames and short fits."""
    words = shlex.split(re.sub(r"\s+#.*", "", command))
    if words[1] == "simulate":
        words = [_FEWER.get(word, word) for word in words]
        words = [f"frames={_FEWER[word[7:]]}" if word.startswith("frames=") else word for word in words]
    return [*words[1:], *(_SMALL if words[1] == "fit" else ())]


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Story]:
    """Follow the page once: write its files and run its commands, in order."""
    folder = tmp_path_factory.mktemp("beetle")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield _followed(folder)


def _followed(folder: Path) -> Story:
    found = Story(folder, [], [])
    output = ""
    for kind, text in _blocks():
        name = re.match(r"# ([\w.]+)\n", text)
        if kind in ("yaml", "python"):
            assert name, f"a file without a name: {text[:60]}"
            (folder / name[1]).write_text(text)
        elif kind == "text":
            found.shown += [(line, output) for line in text.splitlines()]
        elif kind == "":
            for line in text.splitlines():
                if line.startswith("mkdir "):
                    (folder / line.split()[1]).mkdir()
                    continue
                out = io.StringIO()
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
                    status = status_of(*_smaller(line))
                found.steps.append(Step(line, status, out.getvalue()))
                output += out.getvalue()
    return found


def test_every_command_does_what_the_page_says(story: Story) -> None:
    assert len(story.steps) > 12
    for step in story.steps:
        expected = re.search(r"exit status (\d)", step.command)
        assert step.status == (int(expected[1]) if expected else 0), f"{step.command}\n{step.output}"


def test_every_command_writes_its_file(story: Story) -> None:
    for step in story.steps:
        output = re.search(r"output=(\S+)", step.command)
        if output and "tracker=" not in step.command:
            assert (story.folder / output[1]).stat().st_size > 1000, step.command
    assert len(list((story.folder / "videos").glob("video_*.csv"))) == 40
    assert len(list((story.folder / "new").glob("new_*.csv"))) == 10
    assert (story.folder / "beetle.png").is_file()


def test_the_page_shows_the_output_of_its_commands(story: Story) -> None:
    """Figures change with the length of the fit; the rest is compared to the letter."""
    parts = [(part, output) for line, output in story.shown for part in line.split("...") if part.strip()]
    assert len(parts) > 30
    for part, output in parts:
        assert _without_figures(part) in _without_figures(output), part


def test_the_truth_has_the_frames_of_the_videos(story: Story) -> None:
    truth = read(story.folder / "truth.npz")
    files = sorted((story.folder / "new").glob("new_*.csv"))
    videos = [read(file, ReadOptions(min_confidence=0.6)) for file in files]
    seen = np.concatenate([video.confidence for video in videos]) > 0
    assert videos[0].joint_names == truth.joint_names
    np.testing.assert_array_equal(seen, truth.confidence > 0)
    assert 0.02 < 1 - seen.mean() < 0.08
    np.testing.assert_array_equal(np.concatenate([v.keypoints for v in videos])[seen], truth.keypoints[seen])


def test_guesses_of_the_tracker_have_a_low_likelihood(story: Story) -> None:
    truth = read(story.folder / "truth.npz")
    files = sorted((story.folder / "new").glob("new_*.csv"))
    guesses = np.concatenate([read(file).confidence for file in files])[truth.confidence == 0]
    assert len(guesses) > 20
    assert (guesses > 0).all() and (guesses < 0.5).all()


def test_the_proposal_is_wrong_where_the_page_says(story: Story) -> None:
    body = load_skeleton(story.folder / "beetle_body.yaml")
    data = simulate(body, 12000, clip_seconds=30.0, noise_px=2.0, missing=0.05).without_truth()
    first = data.select(data.identity["sequence"] == data.identity["sequence"][0])
    proposed, corrected = propose(first, "beetle").skeleton, load_skeleton(story.folder / "beetle.yaml")
    assert proposed.joints == corrected.joints
    assert proposed.root == corrected.root
    assert proposed.mirror == corrected.mirror
    assert not proposed.facing
    wrong = set(map(frozenset, proposed.bones)) - set(map(frozenset, corrected.bones))
    assert wrong == {
        frozenset((f"hind_hip_{side}", f"{joint}_{side}")) for joint in ("middle_hip", "middle_knee") for side in "lr"
    }


def test_the_poses_are_in_mm_and_as_long_as_a_beetle(story: Story) -> None:
    with np.load(story.folder / "poses.npz") as poses:
        names = poses["joint_names"].tolist()
        pose = poses["pose"]
        assert str(poses["unit"]) == "mm"
    head, thorax, abdomen = (pose[:, names.index(name)] for name in ("head", "thorax", "abdomen"))
    length = np.linalg.norm(head - thorax, axis=1) + np.linalg.norm(abdomen - thorax, axis=1)
    assert 17 < np.median(length) < 19


def test_the_prior_is_part_of_the_fit(story: Story) -> None:
    rows = [line.split(",") for line in (story.folder / "runs/beetle_task/last/metrics.csv").read_text().splitlines()]
    values = [float(row[3]) for row in rows[1:] if row[2] == "claws"]
    assert values and max(values) > 0
    plain = (story.folder / "runs/beetle_plain/last/metrics.csv").read_text()
    assert "claws" not in plain


def test_the_page_draws_its_poses(story: Story, request: pytest.FixtureRequest) -> None:
    assert "hind_claw_l" in (story.folder / "poses.html").read_text()
    page = Page(request.getfixturevalue("browser"), story.folder / "poses.html")
    assert min(page.ink("deep")[0], page.ink("flat")[0]) > 100
    assert page.troubles() == []
