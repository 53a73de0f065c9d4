"""How far long work is: in a terminal, in a file, and nothing where it is short."""

from __future__ import annotations

import io
import sys

import pytest

from uplift.config import progress as module
from uplift.config.progress import is_quiet, progress, quiet


class Terminal(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ten seconds pass with every look at the clock."""
    times = iter(range(0, 100_000, 10))
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(times)))


def test_short_work_shows_nothing_and_parts_come_in_order(capsys: pytest.CaptureFixture) -> None:
    assert list(progress(range(5), "reading")) == [0, 1, 2, 3, 4]
    assert list(progress(iter("abc"), "reading")) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""


def test_quiet_shows_no_progress(slow: None, capsys: pytest.CaptureFixture) -> None:
    with quiet():
        assert list(progress(range(10), "reading files")) == list(range(10))
    assert capsys.readouterr().err == "" and not is_quiet()


def test_lines_in_a_file(slow: None, capsys: pytest.CaptureFixture) -> None:
    assert len(list(progress(range(10), "reading files"))) == 10
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["reading files: 3 of 10, 0.075 a second", "reading files: 7 of 10, 0.0875 a second"]


def test_a_bar_in_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(module, "_SILENT_S", 0.0)
    assert sum(progress(range(200), "refining clips")) == 19900
    assert "refining clips" in terminal.getvalue() and "200" in terminal.getvalue()
