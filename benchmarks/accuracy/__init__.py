"""Recipes compared on the same data, split, time budget and machine."""
