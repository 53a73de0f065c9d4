"""`Samples`: the base of dataclasses whose fields hold one row for each frame, item or view."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import Field, fields, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from uplift.data.names import Names

__all__ = ["SHARED", "TRUTH", "Samples"]

SHARED = {"shared": True}
"""Metadata of a field whose arrays belong to all rows at once."""
TRUTH = {"truth": True}
"""Metadata of a field that came from 3D."""

S = TypeVar("S", bound="Samples")

_AXES = re.compile(r"""ndarray, ['"]([^'"]*)['"]""")


class Samples:
    """Base of dataclasses of rows.

    Arrays, tensors, lists, dicts of arrays and other `Samples` hold one row for each sample, unless
    their field is `SHARED`; everything else (names, units, a skeleton) belongs to all of them. A field
    that is None is not known.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __len__(self) -> int:
        return next(len(value) for _, value in self._rows() if not isinstance(value, dict))

    def _rows(self) -> Iterator[tuple[Field[Any], Any]]:
        """Yield the fields that hold rows, with their values."""
        for field in fields(self):
            value = getattr(self, field.name)
            if _has_rows(value) and not field.metadata.get("shared"):
                yield field, value

    def select(self: S, rows: Any) -> S:
        """Return the samples that ``rows`` (a mask, indices or a slice) picks."""
        return replace(self, **{field.name: _pick(value, rows) for field, value in self._rows()})

    def to(self: S, device: Any) -> S:
        """Return the same samples with all tensors on ``device``."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: value.to(device) for name, value in values.items() if hasattr(value, "to")})

    def without_truth(self: S) -> S:
        """Return the same samples with everything that came from 3D taken out."""
        return replace(self, **{field.name: None for field in fields(self) if field.metadata.get("truth")})

    @classmethod
    def concat(cls: type[S], parts: Sequence[S], **changed: Any) -> S:
        """Return the samples of all ``parts``, one after the other, with the fields in ``changed`` as given.

        What belongs to all rows is the first part's. Where only some parts know a field, the others' rows
        are NaN, 0 or empty; of dicts the keys that all parts have are kept.
        """
        lengths = [len(part) for part in parts]
        for field in fields(cls):
            values = [getattr(part, field.name) for part in parts]
            if field.name not in changed and any(map(_has_rows, values)) and not field.metadata.get("shared"):
                changed[field.name] = _concat(values, lengths)
        return replace(parts[0], **changed)

    def misfit(self, **sizes: int) -> str:
        """Return what is wrong with the first array that does not have the shape of its annotation; empty where all fit.

        ``sizes`` gives the length of axes by name; the others are those of the first array that has them. What has
        no such annotation must have one row for each sample.
        """
        for field, value in self._rows():
            axes = _AXES.search(str(field.type))
            for name, leaf in value.items() if isinstance(value, dict) else [(field.name, value)]:
                found = np.shape(leaf) if hasattr(leaf, "dtype") else (len(leaf),)
                expected = _expected(axes[1].split() if axes else [], found, sizes) or (len(self), *found[1:])
                if found != expected:
                    return f"'{name}' has shape {found}, expected {expected}"
        return ""


def _expected(axes: list[str], found: tuple[int, ...], sizes: dict[str, int]) -> tuple[int | str, ...]:
    """Return the shape that ``axes`` mean, empty without any; ``sizes`` learns those that it does not have."""
    rest = found[len(axes) - 1 :] if axes[-1:] == ["..."] else ()
    axes = axes[:-1] if axes[-1:] == ["..."] else axes
    for axis, size in zip(axes, found, strict=False):
        sizes.setdefault(axis, size)
    return (*(int(axis) if axis.isdigit() else sizes.get(axis, "any") for axis in axes), *rest)


def _has_rows(value: Any) -> bool:
    return isinstance(value, dict | list | Samples) or hasattr(value, "dtype")


def _pick(value: Any, rows: Any) -> Any:
    if isinstance(value, dict):
        return {key: _pick(leaf, rows) for key, leaf in value.items()}
    if isinstance(value, list):
        return [value[row] for row in np.arange(len(value))[rows]]
    return value.select(rows) if isinstance(value, Samples) else value[rows]


def _concat(values: list[Any], lengths: list[int]) -> Any:
    """Return the rows of all ``values`` of one field, blank for those that are None."""
    known = next(value for value in values if value is not None)
    if isinstance(known, dict):
        keys = [key for key in known if all(key in value for value in values)]
        return {key: _concat([value[key] for value in values], lengths) for key in keys}
    if isinstance(known, list):
        return [row for value in values for row in value]
    if isinstance(known, Samples):
        return known.concat(values)
    if any(isinstance(value, Names) for value in values):
        return Names.concat(
            [np.full(rows, "") if value is None else value for value, rows in zip(values, lengths, strict=True)]
        )
    values = [_blank(known, rows) if value is None else value for value, rows in zip(values, lengths, strict=True)]
    if isinstance(known, np.ndarray):
        return np.concatenate(values)
    import torch  # what only reads files does without

    return torch.cat(values)


def _blank(like: Any, rows: int) -> Any:
    """Return rows of NaN, 0, False or empty text, as ``like`` has them."""
    shape = (rows, *like.shape[1:])
    if not isinstance(like, np.ndarray):
        return like.new_full(shape, np.nan if like.is_floating_point() else 0)
    return np.full(shape, {"f": np.nan, "U": "", "O": ""}.get(like.dtype.kind, 0), like.dtype)
