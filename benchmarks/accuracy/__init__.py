"""Recipes side by side: the same data, split, time budget and machine."""
