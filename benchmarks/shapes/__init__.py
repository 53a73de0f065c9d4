"""Shapes lifted from masks: fits compared with baselines and a supervised twin, and the cost of resolution."""
