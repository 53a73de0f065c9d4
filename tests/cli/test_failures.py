"""What ends a command is said in one line, whatever it is; the traceback of what was not expected is in a file."""

from __future__ import annotations

import io
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

from uplift.cli.main import main
from uplift.errors import MissingFiles, UserError

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch, here: Path):
    """Return a function that makes `uplift tasks` do something else; temporary files go into ``tmp``."""
    (here / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(here / "tmp"))
    for name in ("UPLIFT_DEBUG", "UPLIFT_RUN_OF_THIS_FIT"):
        monkeypatch.delenv(name, raising=False)

    def with_what(error: BaseException) -> int:
        def fail(words: list[str]) -> None:
            raise error

        monkeypatch.setitem(sys.modules["uplift.cli.main"]._RUN, "tasks", fail)
        return main(["tasks", "input=a b.csv"])

    return with_what


@pytest.mark.parametrize("place", ["tmp", "runs/a"])
def test_an_unexpected_error_is_one_line_and_a_private_file(place: str, ends, here: Path, monkeypatch, capsys) -> None:
    if place != "tmp":
        (here / place).mkdir(parents=True)
        monkeypatch.setenv("UPLIFT_RUN_OF_THIS_FIT", str(here / place))
    assert ends(KeyError("no\nsuch \x1b[31m thing")) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "\x1b" not in message
    assert "in `uplift tasks 'input=a b.csv'`: KeyError:" in message
    (file,) = (here / place).iterdir()
    assert message.endswith(f"{file}\n")
    assert file.stat().st_mode & 0o777 == 0o600
    text = file.read_text()
    assert text.startswith("Traceback (most recent call last):")
    assert "in fail\n" in text


def test_where_no_file_can_be_written_the_line_says_how_to_see_the_traceback(ends, here: Path, capsys) -> None:
    (here / "tmp").rmdir()
    assert ends(RuntimeError("odd")) == 1
    assert capsys.readouterr().err.endswith("RuntimeError: odd. UPLIFT_DEBUG=1 shows the traceback.\n")


def test_debugging_shows_the_traceback(ends, here: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("UPLIFT_DEBUG", "1")
    assert ends(KeyError("thing")) == 1
    assert capsys.readouterr().err.endswith("KeyError: 'thing'\n")
    assert not list((here / "tmp").iterdir())


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (OSError(28, "No space left on device", "a.npz"), 1, "No space left on device (a.npz). What was saved before is complete."),
        (OSError(5, "Input/output error"), 1, "Input/output error. What was saved before is complete."),
        (PermissionError(13, "Permission denied", "a.npz"), 2, "Permission denied (a.npz)."),
        (OSError(30, "Read-only file system", "a.npz"), 2, "Read-only file system (a.npz)."),
        (FileNotFoundError(2, "No such file or directory", "a\nb"), 2, "No such file or directory (a\\nb)."),
        (MemoryError(), 1, "out of memory. Use fewer frames or masks (data.select.fraction) or smaller batches."),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), 1, "out of memory. Use fewer frames or masks (data.select.fraction) or smaller batches."),
        (RecursionError("maximum"), 2, "something in the input is nested too deeply to be read in `uplift tasks 'input=a b.csv'`."),
        (UserError("no \u202e joint\n'\ud800'"), 2, "no \\u202e joint\\n'\\ud800'"),
        (MissingFiles("no file\n  a\tb\nget it"), 2, "no file\n  a\\tb\nget it"),
    ],
)  # fmt: skip
def test_the_line_and_the_status(error: Exception, status: int, line: str, ends, here: Path, capsys) -> None:
    """Names with line ends or marks that turn the text stay on their line; what the user can mend is status 2."""
    assert ends(error) == status
    assert capsys.readouterr().err.encode("utf-8", "backslashreplace").decode() == f"uplift: {line}\n"
    assert not list((here / "tmp").iterdir())


def test_ctrl_c_and_a_closed_pipe_leave_no_traceback(ends, here: Path, capsys) -> None:
    assert ends(KeyboardInterrupt()) == 130
    assert capsys.readouterr().err == "\nuplift: interrupted\n"
    assert ends(BrokenPipeError()) == 1
    assert capsys.readouterr().err == ""
    assert not list((here / "tmp").iterdir())


def test_an_ascii_terminal_shows_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    monkeypatch.setitem(sys.modules["uplift.cli.main"]._RUN, "tasks", lambda words: print("caf\u00e9 \udce9"))
    assert main(["tasks"]) == 0
    assert main(["skeleton", "check", "caf\u00e9\udce9.yaml"]) == 2
    sys.stdout.flush()
    sys.stderr.flush()
    assert sys.stdout.buffer.getvalue() == b"caf\\xe9 \\udce9\n"  # type: ignore[attr-defined]
    assert b"caf\\xe9\\udce9.yaml" in sys.stderr.buffer.getvalue()  # type: ignore[attr-defined]


def test_warnings_of_other_packages_are_left_out_and_ours_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def warn(words: list[str]) -> None:
        warnings.warn_explicit("theirs", UserWarning, "x.py", 1, module="numpy.core")
        warnings.warn_explicit("of numbers", RuntimeWarning, "x.py", 1, module="uplift.data.clean")
        warnings.warn_explicit("ours", UserWarning, "x.py", 1, module="uplift.priors.handedness")

    monkeypatch.setitem(sys.modules["uplift.cli.main"]._RUN, "tasks", warn)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        monkeypatch.setattr(sys, "warnoptions", [])
        assert main(["tasks"]) == 0
    assert [str(one.message) for one in seen] == ["ours"]
