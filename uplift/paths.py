"""Where things live: shipped skeletons and tasks, data sets, runs."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["data_root", "shipped", "shipped_names"]

_PACKAGE = Path(__file__).resolve().parent


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
