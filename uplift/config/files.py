"""Files and folders: where shipped ones are, what a path means, and writing so that a file is complete or absent."""

from __future__ import annotations

import glob
import os
import secrets
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from uplift.errors import UserError

__all__ = [
    "absolute", "data_root", "files_of", "read_torch", "refuse_existing", "refuse_output", "refuse_special", "replacing",
    "save_torch", "shipped", "shipped_names",
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

    Raises UserError: a file that does not exist, a pattern without a match, a pipe or a device.
    """
    if Path(path).exists():
        refuse_special(Path(path))
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
