"""Families of made-up shapes: which kinds each draws from, and how often."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from uplift.errors import UserError, did_you_mean
from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.chairs import chair, stool
from uplift.meshes.procedural.seats import armchair, bench, sofa
from uplift.meshes.procedural.storage import bed, cabinet, shelf
from uplift.meshes.procedural.tables import desk, table

__all__ = ["FAMILIES", "Kind", "make_shape", "make_shapes"]

Kind = Callable[[np.random.Generator], Mesh]

_SEATS: dict[Kind, float] = {chair: 5, armchair: 2, sofa: 2, bench: 1.5, stool: 1.5}
FAMILIES: dict[str, dict[Kind, float]] = {
    "furniture": {**_SEATS, table: 3, desk: 1, bed: 1.5, shelf: 1, cabinet: 1.5},
    "seats": _SEATS,
    "chairs": {chair: 1},
    "sofas": {sofa: 2, armchair: 1},
    "tables": {table: 3, desk: 1},
    "storage": {shelf: 1, cabinet: 1},
    "beds": {bed: 1},
}
"""Each family's kinds, and how often each is drawn against the others."""


def make_shape(family: str, rng: np.random.Generator) -> Mesh:
    """Return one made-up shape: closed parts whose union is the solid, in its own frame and unit.

    It stands upright and faces the camera: x is its left, y down, z behind it; its box is centred and
    the longest side 2 `UNIT_HALF`. Parts may overlap. `Mesh.category` names the kind.

    Raises:
        UserError: no such family.
    """
    if family not in FAMILIES:
        raise UserError(f"No family of shapes '{family}'.{did_you_mean(family, FAMILIES)}")
    kinds = FAMILIES[family]
    weights = np.array(list(kinds.values()), float)
    return list(kinds)[int(rng.choice(len(kinds), p=weights / weights.sum()))](rng)


def make_shapes(family: str, count: int, seed: int) -> list[Mesh]:
    """Return many made-up shapes, the same for the same seed: shape i is the same however many are made.

    Raises:
        UserError: no such family, fewer than one shape.
    """
    if count < 1:
        raise UserError(f"{count} shapes of '{family}' asked for, expected 1 or more.")
    shapes = []
    for number in range(count):
        shape = make_shape(family, np.random.default_rng((seed, number)))
        shapes.append(replace(shape, name=f"{family}-{seed}-{number}"))
    return shapes
