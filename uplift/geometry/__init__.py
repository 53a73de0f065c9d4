"""Cameras, rotations, units, meshes: geometry that knows nothing of data or training."""
