"""An articulated-body simulator: random bodies, natural motion, random cameras, exact 3D."""

from __future__ import annotations

from uplift.simulator.simulate import build_body, rest_pose, simulate

__all__ = ["build_body", "rest_pose", "simulate"]
