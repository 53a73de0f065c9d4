"""The page on an animal of one's own, followed in an empty folder; the fit is a few steps long."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from bodies import status_of

PAGE = Path(__file__).resolve().parents[2] / "docs/my-animal.md"
SMALL = (
    "trainer.max_time=null",
    "trainer.max_steps=6",
    "trainer.threads=1",
    "priors.flow.steps=5",
    "teacher.batch_size=48",
)


def commands() -> list[list[str]]:
    """Return the commands of the page's blocks, in order."""
    blocks = re.findall(r"^```\n(.*?)^```$", PAGE.read_text(), re.M | re.S)
    return [shlex.split(line) for block in blocks for line in block.splitlines()]


def test_every_command_of_the_page_works(here: Path, capsys: pytest.CaptureFixture) -> None:
    for first, *words in commands():
        if first == "mkdir":
            (here / words[0]).mkdir()
            continue
        few = [word.replace("frames=1200", "frames=240").replace("clip_seconds=4", "clip_seconds=1") for word in words]
        status = status_of(*few, *(SMALL if words[0] == "fit" else ()))
        assert status == 0, (words, capsys.readouterr())
        for path in (word.partition("=")[2] for word in words if word.startswith("output=")):
            assert path.startswith("videos/") or (here / path).stat().st_size > 500
    angles = (here / "dog_angles.csv").read_text().splitlines()
    assert "right_stifle_angle_deg" in angles[0] and len(angles) > 10
