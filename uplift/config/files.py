"""Files and folders: where shipped ones are, what a path means, and writing so that a file is complete or absent."""

from __future__ import annotations

import glob
import os
import re
import secrets
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from uplift.errors import UserError

__all__ = [
    "absolute", "data_root", "files_of", "inside", "names_from", "read_torch", "refuse_existing", "refuse_output", "replacing", "save_torch",
    "shipped", "shipped_names", "without_folders",
]  # fmt: skip

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(folder: str) -> Path:
    """Return the folder of shipped ``skeletons`` or ``tasks``.

    A wheel carries them inside the package, a checkout beside it. The checkout is looked for
    first when it is one (it has a pyproject.toml): an editable install can leave a stale copy
    in site-packages.
    """
    checkout = _PACKAGE.parent / folder
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "shipped" / folder


def shipped_names(folder: str) -> list[str]:
    """Return the sorted names of the shipped YAML files of ``folder``, without their ending."""
    return sorted(path.stem for path in shipped(folder).glob("*.yaml"))


def data_root(name: str, root: str | None) -> Path:
    """Return the folder of the data set ``name``: ``root``, else ``$UPLIFT_DATA/name``, else ``data/name``."""
    if root:
        return Path(root).expanduser()
    base = os.environ.get("UPLIFT_DATA")
    return (Path(base).expanduser() if base else Path("data")) / name


# What a path on the command line means: one file, several with commas, or all that match a pattern.


def files_of(path: str | Path) -> list[Path]:
    """Return the files or folders that ``path`` names: itself where it exists, else those between commas or that match ``*``, ``?`` or ``[``.

    Raises UserError: a file that does not exist, or a pattern without a match.
    """
    if Path(path).exists():
        return [Path(path)]
    found: list[Path] = []
    for part in str(path).split(","):
        if any(sign in part for sign in "*?["):
            matching = sorted(Path(name) for name in glob.glob(part))
            if not matching:
                raise UserError(f"No file matches {part} (looked in {Path(part).absolute().parent}).")
            found += matching
        elif part:
            found.append(Path(part))
    missing = [one for one in found if not one.exists()]
    if missing or not found:
        where = missing[0] if missing else Path(path)
        raise UserError(f"No file {where} (looked in {where.absolute().parent}).")
    return list(dict.fromkeys(found))


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
_PART = re.compile(r"[^\s'\"`,;:()<>=]+")
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
        if not _PART.fullmatch(text[here + 1 : following]) and not os.path.isdir(text[start:following]):
            break
        here = following
    return here + 1


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path`` and put it in the place of ``path`` once it is complete.

    Any failure (a full disk, Ctrl-C) removes the temporary file, leaves what was at ``path``
    untouched and propagates. Raises UserError where ``path`` cannot be a file.
    """
    target = Path(os.path.realpath(Path(path).expanduser()))
    if not target.parent.is_dir():
        raise UserError(f"cannot write {path}: the folder {target.parent} does not exist. Create it first.")
    if target.exists() and not target.is_file():
        raise UserError(f"cannot write {path}: it exists and is not an ordinary file. Choose another name.")
    temporary = target.with_name(f".{target.name[:80]}.{secrets.token_hex(4)}.part")
    try:
        handle = open(temporary, "xb")  # noqa: SIM115 (closed below, before the file is moved)
    except PermissionError as error:
        raise UserError(f"cannot write {path}: no permission to create files in {target.parent}.") from error
    try:
        with handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


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
    """Raise UserError where ``path`` is there already: what a user has is not overwritten."""
    if path.exists():
        raise UserError(f"{path} exists already and is not overwritten: remove it or choose another name.")


def refuse_output(path: Path) -> None:
    """Raise UserError where ``output=path`` is there already, or its folder is not."""
    refuse_existing(path)
    if not path.absolute().parent.is_dir():
        raise UserError(f"output={path}: no folder {path.absolute().parent}. Create it first.")
