"""Masks to shapes: the lifter of masks, what it predicts, and how it is trained."""
