"""Shapes lifted from masks: fits beside the floors and the supervised twin, held-out species, the cost of resolution."""
