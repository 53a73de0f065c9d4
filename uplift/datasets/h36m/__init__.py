"""Human3.6M, from whichever of its files are there."""

from __future__ import annotations

from uplift.datasets.h36m.human36m import Human36M

__all__ = ["Human36M"]
