"""Metrics and protocols of poses and shapes, by name."""
