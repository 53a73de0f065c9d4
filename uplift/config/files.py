"""Files and folders: where shipped ones are, what a path means, and writing so that a file is complete or absent."""

from __future__ import annotations

import errno
import glob
import os
import platform
import re
import secrets
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO

from uplift.errors import UserError

__all__ = [
    "Existing", "absolute", "as_bytes", "building", "cache_folder", "clear_parts", "data_root", "files_of", "holds_run", "inside", "names_from", "read_torch",
    "refuse_existing", "refuse_output", "refuse_special", "replacing", "replacing_by_name", "save_torch", "scratch", "shipped",
    "shipped_names", "without_folders",
]  # fmt: skip

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(folder: str) -> Path:
    """Return the folder of shipped ``skeletons``, ``tasks`` or ``lifters``.

    A wheel carries them inside the package, a checkout beside it. The checkout is looked for
    first when it is one (it has a pyproject.toml): an editable install can leave a stale copy
    in site-packages.
    """
    checkout = _PACKAGE.parent / folder
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "shipped" / folder


_ENDINGS = {"lifters": ".safetensors"}
"""Of the shipped files of a folder; elsewhere .yaml."""


def shipped_names(folder: str) -> list[str]:
    """Return the sorted names of the shipped files of ``folder``, without their ending."""
    return sorted(path.stem for path in shipped(folder).glob(f"*{_ENDINGS.get(folder, '.yaml')}"))


def holds_run(path: Path) -> bool:
    """Return whether a folder is a run, or that of a task with its ``last``."""
    return any((one / "config.yaml").is_file() for one in (path, path / "last"))


def cache_folder(kind: str) -> Path:
    """Return where what can be made again is kept: a folder in ``$UPLIFT_CACHE``, else in ``uplift`` of the user's cache.

    It need not exist.
    """
    named = os.environ.get("UPLIFT_CACHE")
    if named:
        return Path(named).expanduser() / kind
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "uplift" / kind


def data_root(name: str, root: str | None) -> Path:
    """Return the folder of the data set ``name``: ``root``, else ``$UPLIFT_DATA/name``, else ``data/name``."""
    if root:
        return Path(root).expanduser()
    base = os.environ.get("UPLIFT_DATA")
    return (Path(base).expanduser() if base else Path("data")) / name


# What a path on the command line means: one file, several with commas, or all that match a pattern.


def files_of(path: str | Path) -> list[Path]:
    """Return the files or folders that ``path`` names: itself where it exists, else those between commas or that match ``*``, ``**`` (folders), ``?`` or ``[``.

    Raises UserError: a file that does not exist, a pattern without a match, a pipe or a device.
    """
    if Path(path).exists():
        refuse_special(Path(path))
        return [Path(path)]
    found: list[Path] = []
    for part in str(path).split(","):
        if any(sign in part for sign in "*?["):
            matching = sorted(Path(name) for name in glob.glob(part, recursive=True))
            if not matching:
                raise UserError(f"No file matches {part} (looked in {Path(part).absolute().parent}).")
            found += matching
        elif part:
            found.append(Path(part))
    missing = [one for one in found if not one.exists()]
    if missing or not found:
        where = missing[0] if missing else Path(path)
        raise UserError(f"No file {where} (looked in {where.absolute().parent}).")
    for one in found:
        refuse_special(one)
    return list(dict.fromkeys(found))


def refuse_special(path: Path) -> None:
    """Raise UserError for a pipe, a device or a socket: reading one may never end, or wait for ever."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # not there, or not to be looked at: whoever opens it says so
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise UserError(f"{path} is a pipe or a device, expected a file or a folder: save its content to a file first.")


def absolute(path: str) -> str:
    """Return the same files by absolute paths."""
    if Path(path).expanduser().exists():
        return str(Path(path).expanduser().absolute())
    return ",".join(str(Path(part).expanduser().absolute()) for part in path.split(",") if part)


# Names found in files: what they mean, and what they say.


def inside(folder: Path, name: str) -> Path | None:
    """Return what a name that was found in a file means: a place in ``folder``; None for one that leads out of it.

    Links are resolved first: whoever made the file may have made the links beside it too.
    """
    path = folder / name
    try:
        return path if Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)) else None
    except (OSError, ValueError):  # a name that no file can have
        return None


def names_from(folder: Path, paths: Sequence[str | Path]) -> list[str]:
    """Return paths by names that say nothing of this machine: from ``folder`` what lies in it, else from the folder they share.

    What is no absolute path, such as the name of a file, stays as it is.
    """
    there = os.path.realpath(folder)
    real = [os.path.realpath(path) if path and (os.path.isabs(path) or Path(path).exists()) else "" for path in paths]
    outside = {os.path.dirname(one) for one in real if one and not Path(one).is_relative_to(there)}
    shared = os.path.commonpath(outside) if outside else there
    return [
        Path(os.path.relpath(one, there if Path(one).is_relative_to(there) else shared)).as_posix()
        if one
        else str(path)
        for one, path in zip(real, paths, strict=True)
    ]


_ABSOLUTE = re.compile(r"(?<![\w/.~\\-])(?:[A-Za-z]:)?([/\\])(?=[^\s/\\])")
"""Where an absolute path begins in a text."""
_FOLDER = re.compile(r"[^\s'\"`,;:()<>=]+")
"""A folder's name that needs no look at the disk to be told from other words."""


def without_folders(text: str) -> str:
    """Return a text for others to read: files by their names, without the folders of absolute paths."""
    kept, at = "", 0
    for found in _ABSOLUTE.finditer(text):
        end = _end_of_folder(text, found.start(), found[1])
        if found.start() >= at and end > found.end():
            kept, at = kept + text[at : found.start()], end
    return kept + text[at:]


def _end_of_folder(text: str, start: int, slash: str) -> int:
    """Return the end of the folders of the path at ``start``: names with spaces and other signs are those on the disk."""
    here = text.index(slash, start)
    while (following := text.find(slash, here + 1)) > 0:
        if not _FOLDER.fullmatch(text[here + 1 : following]) and not os.path.isdir(text[start:following]):
            break
        here = following
    return here + 1


# Writing: complete or not at all, and never over what another command has made meanwhile.


class Existing(UserError):
    """What was to be made is there already."""


_NEW: set[Path] = set()
"""Files that `refuse_existing` did not find, and that `replacing` must not put in the place of another."""


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path`` and put it in the place of ``path`` once it is complete.

    Any failure (a full disk, Ctrl-C) removes the temporary file, leaves what was at ``path`` untouched and
    propagates. A file that `refuse_existing` was asked about is only made where there is still none.
    Raises UserError where ``path`` cannot be a file.
    """
    target = _real(path)
    if not target.parent.is_dir():
        raise UserError(f"cannot write {path}: the folder {target.parent} does not exist. Create it first.")
    if target.exists() and not target.is_file():
        raise UserError(f"cannot write {path}: it exists and is not an ordinary file. Choose another name.")
    temporary = _part_of(target)
    try:
        handle = open(temporary, "xb")  # noqa: SIM115 (closed below, before the file is moved)
    except PermissionError as error:
        raise UserError(f"cannot write {path}: no permission to create files in {target.parent}.") from error
    try:
        with handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        if target in _NEW:
            _claim(target)
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        _NEW.discard(target)


@contextmanager
def replacing_by_name(path: str | Path) -> Iterator[Path]:
    """Give a new name with the ending of ``path`` to a library that writes files itself, and put what it made at ``path``, as `replacing`."""
    with replacing(path) as handle, tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / f"new{Path(path).suffix.lower()}"
        yield written
        with written.open("rb") as made:
            shutil.copyfileobj(made, handle)


def _claim(target: Path) -> None:
    """Make an empty file, which is atomic: of two commands only one can. Raises Existing for the other."""
    try:
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    except FileExistsError:
        raise Existing(
            f"{target}: another command has made it meanwhile. Run this one again with another name."
        ) from None


@contextmanager
def building(path: str | Path) -> Iterator[Path]:
    """Make a temporary folder beside ``path`` and put it in the place of ``path``, which is empty or absent, once it is complete.

    Any failure removes the temporary folder and propagates. Raises Existing where something is in ``path`` by then.
    """
    target = _real(path)
    temporary = _part_of(target)
    temporary.mkdir()
    try:
        yield temporary
        try:
            os.replace(temporary, target)
        except OSError as error:
            if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise Existing(f"{target}: another command has made it meanwhile. Choose another name.") from None
            raise
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def scratch(path: str | Path) -> IO[bytes]:
    """Open a nameless file in the folder of ``path``, for what memory cannot hold while ``path`` is made; closed, it is gone."""
    return tempfile.TemporaryFile(dir=_real(path).parent)


def _real(path: str | Path) -> Path:
    return Path(os.path.realpath(Path(path).expanduser()))


_PART = re.compile(r"\..*\.(?P<host>[\w]*)-(?P<process>[0-9]+)-[0-9a-f]{8}\.part")


def _part_of(target: Path) -> Path:
    """Return a name for what is to become ``target``, and remove what earlier commands that were killed left of theirs."""
    start = f".{target.name[:80]}."
    clear_parts(target.parent, start)
    return target.with_name(f"{start}{_host()}-{os.getpid()}-{secrets.token_hex(4)}.part")


def clear_parts(folder: Path, start: str = ".") -> None:
    """Remove the temporary files and folders whose names have that start and whose process on this machine is gone."""
    try:
        names = [name for name in os.listdir(folder) if name.startswith(start) and name.endswith(".part")]
    except OSError:
        return
    for name in names:
        found = _PART.fullmatch(name)
        if found and found["host"] == _host() and not _runs(int(found["process"])):
            path = folder / name
            with suppress(OSError):
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _host() -> str:
    return re.sub(r"\W", "_", platform.node())[:40]


def _runs(process: int) -> bool:
    """Return whether there is a process of that number."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's, or no number of a process
        return True
    return True


def as_bytes(text: str) -> bytes:
    """Return text in UTF-8; what is no text in it, such as a byte of a file's name in another encoding, as an escape."""
    return text.encode("utf-8", "backslashreplace")


def save_torch(state: dict[str, Any], path: Path) -> None:
    """Write tensors and plain data to ``path``, complete or not at all."""
    import torch

    try:
        with replacing(path) as file:
            torch.save(state, file)
    except RuntimeError as error:
        # torch turns a full disk into a RuntimeError.
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise OSError(f"cannot write {path}: {error}") from error


def read_torch(path: Path, kind: str) -> dict[str, Any]:
    """Read tensors and plain data; nothing in the file can run.

    Raises UserError: not there, not such a file, damaged, or holding anything but plain data.
    """
    import torch

    if not path.is_file():
        raise UserError(f"No {kind} {path}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch warns about files that are not checkpoints
            state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a file of another format
        reason = str(error).strip().splitlines()[0][:200] if str(error) else type(error).__name__
        raise UserError(
            f"{path} cannot be read as a {kind}: damaged, or holding more than tensors and plain data, "
            f"which is never opened ({reason})."
        ) from error
    if not isinstance(state, dict):
        raise UserError(f"{path} is not a {kind}: found {type(state).__name__}, expected what `uplift fit` writes.")
    return state


def refuse_existing(path: Path) -> None:
    """Raise Existing where ``path`` is there already: what a user has is not overwritten, by `replacing` neither."""
    if path.exists():
        raise Existing(f"{path} exists already and is not overwritten: remove it or choose another name.")
    _NEW.add(_real(path))


def refuse_output(path: Path) -> None:
    """Raise UserError where ``output=path`` is there already, or its folder is not."""
    refuse_existing(path)
    if not path.absolute().parent.is_dir():
        raise UserError(f"output={path}: no folder {path.absolute().parent}. Create it first.")
