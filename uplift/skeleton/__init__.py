"""Skeletons: joints, bones, mirror pairs and directions, read from YAML and checked."""

from __future__ import annotations

from uplift.skeleton.core import Skeleton, load_skeleton

__all__ = ["Skeleton", "load_skeleton"]
