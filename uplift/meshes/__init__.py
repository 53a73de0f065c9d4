"""Meshes: read, posed, made up, filled, drawn as masks, cut out of occupancy grids."""
