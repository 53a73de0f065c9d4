"""What a user is told of an exception that ended a command: one line, and the exit status."""

from __future__ import annotations

import errno
import io
import os
import re
import shlex
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from uplift.errors import MissingFiles, UserError

__all__ = ["RUN_VARIABLE", "clear_output", "one_line", "status_of", "told"]

DEBUG = "UPLIFT_DEBUG"
"""Environment variable that shows the traceback of an unexpected error in place of the file that has it."""
RUN_VARIABLE = "UPLIFT_RUN_OF_THIS_FIT"
"""Environment variable with the run folder of the fit that is under way, for its other processes and its traceback."""
_PACKAGE = Path(__file__).resolve().parents[1]
_LONGEST_COMMAND = 300
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that end a line, move the cursor, or turn the direction of text."""

# What another path, more space or fewer data mend.
_FIXABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP,
            errno.EINVAL, errno.ENOENT, errno.EEXIST, errno.ENOTEMPTY, errno.EXDEV, errno.EMFILE)  # fmt: skip


@contextmanager
def clear_output() -> Iterator[None]:
    """Print on terminals of any encoding, and leave out the warnings of other packages."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.filterwarnings("ignore", module=r"(?!uplift)")
            warnings.filterwarnings("ignore", category=RuntimeWarning)  # NumPy's, of numbers that are not finite
        yield


def status_of(error: BaseException, words: Sequence[str]) -> int:
    """Print one line on what ended the command of these words, and return its exit status.

    That is 2 for what the user can mend, 130 for Ctrl-C, and 1 for all else.
    """
    if isinstance(error, KeyboardInterrupt):
        print("\nuplift: interrupted", file=sys.stderr)
        return 130
    if isinstance(error, BrokenPipeError):
        return 1
    if os.environ.get(DEBUG) and not _is_known(error):
        traceback.print_exception(error)
        return 1
    message, status = told(error, words)
    lines = message.splitlines() if isinstance(error, MissingFiles) else [message]
    print("uplift: " + "\n".join(map(one_line, lines)), file=sys.stderr)
    return status


def told(error: BaseException, words: Sequence[str]) -> tuple[str, int]:
    """Return what is said of an exception that ended the work of these words, and its exit status."""
    if isinstance(error, UserError):
        return str(error), 2
    if _is_out_of_memory(error):
        return "out of memory. Use fewer frames or masks (data.select.fraction) or smaller batches.", 1
    if isinstance(error, RecursionError):
        return f"something in the input is nested too deeply to be read{_command(words)}.", 2
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename else ""
        fixable = error.errno in _FIXABLE
        rest = "" if fixable else " What was saved before is complete."
        return f"{error.strerror or error}{where}.{rest}", 2 if fixable else 1
    return _unexpected(error, words), 1


def one_line(text: str) -> str:
    """Return a text without the control characters of names in it."""
    return _CONTROL.sub(_escaped, text)


def _escaped(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


def _is_known(error: BaseException) -> bool:
    """Return whether `told` says it without a traceback."""
    return isinstance(error, UserError | RecursionError | OSError) or _is_out_of_memory(error)


def _is_out_of_memory(error: BaseException) -> bool:
    """Return whether memory ran out, of the machine or of an accelerator."""
    known = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    return known or (isinstance(error, RuntimeError) and "can't allocate memory" in str(error))


def _unexpected(error: BaseException, words: Sequence[str]) -> str:
    """Return what failed where, and in which file the traceback is."""
    kind, *detail = traceback.format_exception_only(error)[-1].strip().split(":", 1)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _PACKAGE in Path(frame.filename).parents]
    place = f" ({Path(frames[-1].filename).relative_to(_PACKAGE)}, line {frames[-1].lineno})" if frames else ""
    what = " ".join(f"{kind}:{detail[0]}".split() if detail else [kind])[:200]
    return f"unexpected error{place}{_command(words)}: {what}. {_saved(error)}"


def _command(words: Sequence[str]) -> str:
    return f" in `uplift {shlex.join(words)[:_LONGEST_COMMAND]}`"


def _saved(error: BaseException) -> str:
    """Write the traceback into the folder of the run, else among the temporary files; return where it is."""
    run = Path(os.environ.get(RUN_VARIABLE, ""))
    folder = run if RUN_VARIABLE in os.environ and run.is_dir() else None
    try:
        # A new file that nobody else can read or has put there.
        with tempfile.NamedTemporaryFile(
            "w",
            prefix="traceback_",
            suffix=".txt",
            dir=folder,
            delete=False,
            encoding="utf-8",
            errors="backslashreplace",
        ) as file:
            traceback.print_exception(error, file=file)
    except OSError:
        return f"{DEBUG}=1 shows the traceback."
    return f"This is a fault of uplift's: please report it with the traceback in {file.name}"
