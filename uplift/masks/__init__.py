"""Masks: the container, its files, and how they are cleaned."""
