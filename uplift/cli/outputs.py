"""The outputs of predict: files of several formats of one prediction, each with the options that are about its format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uplift.config.files import refuse_output
from uplift.errors import UserError
from uplift.export import MEASURES, check_axes, check_library, ending_of, open_stream, write, writer_for
from uplift.export.gallery import check_options
from uplift.export.nwb import check_nwb
from uplift.export.osim import beside_model, check_beside
from uplift.export.stream import Stream
from uplift.models.prediction import Prediction

__all__ = [
    "can_grow",
    "check_outputs",
    "open_output",
    "outputs_of",
    "refuse_outputs",
    "shows_video",
    "write_outputs",
]

_OF_FORMATS = {"csv_safe": (".csv",), "mass_kg": (".osim",), "nwb": (".nwb",), "video": (".html", ".mp4", ".gif")}
"""Options of some formats alone, by their endings; all others are those of page=gallery."""


def outputs_of(output: str | Path | Sequence[str] | None) -> list[str]:
    """Return the files to write: a list as it is, several in a text between commas."""
    if output is None or isinstance(output, list | tuple):
        return list(output or ())
    return [part for part in str(output).split(",") if part]


def shows_video(output: str) -> bool:
    """Return whether a video can be shown in a file."""
    return _takes(output, "video")


def check_outputs(
    outputs: Sequence[str], page: str | None, axes: str | None, options: Mapping[str, Any], hypotheses: int
) -> None:
    """Raise UserError for files that cannot be written, or exist, and for options that are not about any of them."""
    pages = [output for output in outputs if _is_page(output)]
    for output in outputs:
        check_library(output, page if output in (pages or outputs) else None)
    for output in [output for output in outputs if _has_axes(output)] or outputs:
        check_axes(output, axes)
    shown = ", ".join(outputs)
    for key in options:
        if key not in _OF_FORMATS and page != "gallery":
            raise UserError(f"{key}= goes with page=gallery.")
        if not any(_takes(output, key) for output in outputs):
            raise UserError(f"{key}= goes with output=FILE{' or '.join(_OF_FORMATS[key])}, not with {shown}.")
    check_nwb(options.get("nwb", {}))
    if page == "gallery":
        check_options(**{key: value for key, value in options.items() if key not in _OF_FORMATS})
    if hypotheses and not any(ending_of(output) == ".npz" for output in outputs):
        raise UserError(f"hypotheses= goes with output=FILE.npz, which can hold several poses, not with {shown}.")
    refuse_outputs(outputs)
    _refuse_beside(outputs)


def refuse_outputs(outputs: Sequence[str]) -> None:
    """Raise UserError for a file that exists, cannot be made, or is there twice."""
    for output in outputs:
        if outputs.count(output) > 1:
            raise UserError(
                f"output={','.join(outputs)}: '{output}' is there twice. Give every file a name of its own."
            )
        refuse_output(Path(output))


def _refuse_beside(outputs: Sequence[str]) -> None:
    """Raise UserError for what OpenSim's model brings along, where that exists, or is written by another output."""
    for output in outputs:
        if ending_of(output) == ".osim":
            check_beside(output)
            if twice := set(map(str, beside_model(output))) & set(outputs):
                raise UserError(f"output={','.join(outputs)}: {min(twice)} is written beside {output}: leave it out.")


def write_outputs(
    prediction: Prediction, outputs: Sequence[str], page: str | None, axes: str | None, options: Mapping[str, Any]
) -> dict[Path, str]:
    """Write every output, each with the options that are about its format; return the files with a remark on each."""
    files: dict[Path, str] = {}
    for output in outputs:
        of_page = page if _is_page(output) else None
        files |= write(prediction, output, of_page, axes if _has_axes(output) else None, **_mine(output, options))
    return files


def can_grow(output: str, page: str | None) -> bool:
    """Return whether a file can be written part by part."""
    return bool(writer_for(output, page if _is_page(output) else None).stream)


def open_output(output: str, page: str | None, axes: str | None, options: Mapping[str, Any]) -> Stream:
    """Open a file that `can_grow`, with the options that are about its format."""
    of_page = page if _is_page(output) else None
    return open_stream(output, of_page, axes if _has_axes(output) else None, **_mine(output, options))


def _mine(output: str, options: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in options.items() if _takes(output, key)}


def _takes(output: str, option: str) -> bool:
    return ending_of(output) in _OF_FORMATS.get(option, (".html",))


def _is_page(output: str) -> bool:
    return ending_of(output) == ".html"


def _has_axes(output: str) -> bool:
    """Return whether a file holds poses in axes: a page turns them, angles and gait have none."""
    return not _is_page(output) and writer_for(output) not in MEASURES.values()
