"""Shapes made up of simple closed parts, as many as wanted: furniture, vehicles, animals."""

from __future__ import annotations

from uplift.meshes.procedural.families import FAMILIES, make_shape, make_shapes

__all__ = ["FAMILIES", "make_shape", "make_shapes"]
