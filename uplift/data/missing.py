"""What is said where data is missing: what, where it comes from, where to put it, what runs without."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uplift.config import DataSettings, Settings
from uplift.datasets import DataSet, WantedFile

__all__ = ["how_to_get", "missing_file", "missing_files"]

_MOST_NAMED = 6


def missing_file(settings: Settings, path: Path) -> str:
    """Return the message for a file that is not there."""
    data = settings.data
    lines = [f"No file {path}" + (f", which task '{settings.task}' needs." if settings.task else ".")]
    return "\n".join([*lines, *_get(data), *_places(data, "it"), *_instead(settings)])


def missing_files(settings: Settings, source: DataSet, missing: Sequence[WantedFile]) -> str:
    """Return the message for files of a published set that are not there."""
    return f"{_named(settings, source, missing)}\n{how_to_get(settings, source)}"


def how_to_get(settings: Settings, source: DataSet | None) -> str:
    """Return where missing files come from, where to put them, and what runs without them."""
    origin = [source.about.strip()] if source is not None and source.about.strip() else _get(settings.data)
    return "\n".join([*origin, *_places(settings.data, "them"), *_instead(settings)])


def _named(settings: Settings, source: DataSet, missing: Sequence[WantedFile]) -> str:
    needed = f", which task '{settings.task}' needs" if settings.task else ""
    count = f"{len(missing)} file is" if len(missing) == 1 else f"{len(missing)} files are"
    shown = missing[:_MOST_NAMED]
    names = [_within(file.path, source.folder) for file in shown]
    wide = max(map(len, names))
    lines = [f"{source.title or type(source).__name__}{needed}: {count} not in {source.folder}"]
    lines += [f"  {name:<{wide}}  {file.what}" for name, file in zip(names, shown, strict=True)]
    return "\n".join(lines + [f"  and {len(missing) - len(shown)} more"] * (len(missing) > len(shown)))


def _within(path: Path, folder: Path) -> str:
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(path)


def _get(data: DataSettings) -> list[str]:
    return [f"Get it: {data.get.strip()}"] if data.get else []


def _places(data: DataSettings, what: str) -> list[str]:
    if not data.name or Path(data.name).is_absolute():
        return []
    return [
        f"Put {what} there, or name another folder: data.root=FOLDER (or UPLIFT_DATA=FOLDER, with a subfolder {data.name}/)."
    ]


def _instead(settings: Settings) -> list[str]:
    if settings.lifts == "masks":
        return ["Without: `uplift fit task=masks_demo` needs no data."]
    free = "" if settings.data.name == "cmu" else "`uplift fit task=semi_cmu` runs on open data, "
    return [f"Without: {free}`uplift fit task=demo` {'on none' if free else 'needs no data'}."]
