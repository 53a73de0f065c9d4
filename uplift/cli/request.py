"""What `predict` is asked for, whatever is lifted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from uplift.cli.outputs import outputs_of
from uplift.config.run import Weights
from uplift.data.formats.base import ReadOptions
from uplift.models.known_camera import KnownCamera
from uplift.video.detect import Detection

__all__ = ["Request", "request_of"]


@dataclass(frozen=True)
class Request:
    """What is to be lifted, and what becomes of it: the arguments of `predict`."""

    weights: Weights
    input: str | Path
    output: str | Path | Sequence[str] | None = None
    overrides: tuple[str, ...] = ()
    refine: bool | str = True
    hypotheses: int = 0
    constant_bones: bool = False
    size: Mapping[str, Any] = field(default_factory=dict)
    reading: ReadOptions | None = None
    axes: str | None = None
    page: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of the writers."""
    camera: KnownCamera | None = None
    ground: bool = False
    detection: Detection = field(default_factory=Detection)
    keypoints: str | Path | None = None
    check: bool = True
    accelerator: str = "auto"
    part_frames: int | None = 0
    """Frames that are lifted at a time where there are more; 0: all at once; None: long inputs in parts (`uplift.models.parts`)."""

    @property
    def outputs(self) -> list[str]:
        """The files to write."""
        return outputs_of(self.output)

    @property
    def title(self) -> str:
        """The name of the first file."""
        return Path(str(self.input).split(",")[0]).stem


_DETECTION = {"detector": "detector", "detector_options": "options"} | {
    name: name for name in ("people", "start_s", "end_s")
}
"""Arguments of `predict` -> fields of `Detection`."""


def request_of(
    weights: Weights,
    input: str | Path,
    output: str | Path | Sequence[str] | None,
    overrides: tuple[str, ...],
    given: Mapping[str, Any],
) -> Request:
    """Return the request of the arguments of `predict`; those that are no field's are ``options``."""
    rest = {name: value for name, value in given.items() if value is not None}
    how = {field: rest.pop(name) for name, field in _DETECTION.items() if name in rest}
    known = {one.name: rest.pop(one.name) for one in fields(Request) if one.name in rest}
    known |= {"part_frames": given["part_frames"]} if "part_frames" in given else {}
    return Request(weights, input, output, overrides, detection=Detection(**how), options=rest, **known)
