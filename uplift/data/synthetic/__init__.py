"""Data made up from nothing: bodies in motion, furniture, vehicles, animals, and their masks."""
