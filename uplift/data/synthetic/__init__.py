"""Synthetic data: bodies in motion, furniture, vehicles, animals, and their masks."""
