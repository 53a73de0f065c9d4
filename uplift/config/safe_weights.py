"""Lifters as ``.safetensors``: tensors, and what they belong to as JSON in the header. Reading runs nothing of the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uplift.config.files import refuse_special, replacing
from uplift.errors import UserError

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["ENDING", "describe_safe", "read_safe", "save_safe"]

ENDING = ".safetensors"
_KEY = "uplift"
"""Of the header's metadata, whose values are texts. There is one: the order of several is not the same in every file."""


def save_safe(state: dict[str, Any], path: Path, *, half: bool = False) -> None:
    """Write the tensors of ``state["state"]``, and all else of ``state`` as JSON; complete or not at all.

    With ``half`` matrices become float16: half the size, and a thousandth of each weight lost. Vectors stay float32.

    Raises:
        UserError: ``half`` with weights beyond 65,504, the largest of float16.
    """
    from safetensors.torch import save

    weights = {name: _halved(name, value) if half else value.contiguous() for name, value in state["state"].items()}
    plain = {name: value for name, value in state.items() if name != "state"}
    with replacing(path) as file:
        file.write(save(weights, {_KEY: json.dumps(plain)}))


def _halved(name: str, value: Tensor) -> Tensor:
    if value.ndim < 2 or not value.is_floating_point():
        return value.contiguous()
    halved = value.half().contiguous()
    if value.isfinite().all() and not halved.isfinite().all():
        raise UserError(f"half=True: {name} has weights up to {value.abs().max():.3g}, float16 ends at 65,504.")
    return halved


def read_safe(path: Path, kind: str) -> dict[str, Any]:
    """Return what `save_safe` wrote, tensors in float32.

    Raises UserError: not there, not such a file, damaged, or tensors that are not as long as the file says.
    """
    import torch

    with _Opened(path, kind, "pt") as file:
        state = _described(file)
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (a handle, no mapping)
        copied = {
            name: one.to(torch.float32 if one.is_floating_point() else one.dtype, copy=True)
            for name, one in tensors.items()
        }
        return {**state, "state": copied}


def describe_safe(path: Path, kind: str = "lifter") -> dict[str, Any]:
    """Return what a file says of its tensors, without reading these; raises UserError as `read_safe` does."""
    with _Opened(path, kind, "np") as file:
        return _described(file)


def _described(file: Any) -> dict[str, Any]:
    found = json.loads((file.metadata() or {}).get(_KEY, "null"))
    if not isinstance(found, dict):
        raise ValueError(f"no '{_KEY}' in its header: it holds weights, but not what they are of")
    return found


class _Opened:
    """A file that is open for reading; whatever is wrong with it becomes one line."""

    def __init__(self, path: Path, kind: str, framework: str):
        from safetensors import safe_open

        self.path, self.kind, self.file = path, kind, None
        if not path.is_file():
            raise UserError(f"No {kind} {path}.")
        refuse_special(path)
        try:
            self.file = safe_open(path, framework=framework)
        except Exception as error:
            raise self._refused(error) from error

    def __enter__(self) -> Any:
        return self.file.__enter__()  # type: ignore[union-attr]

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        self.file.__exit__(kind, error, trace)  # type: ignore[union-attr]
        if isinstance(error, Exception):
            raise self._refused(error) from error

    def _refused(self, error: Exception) -> UserError:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        return UserError(f"{self.path} cannot be read as a {self.kind}: damaged, or another kind of file ({reason}).")
