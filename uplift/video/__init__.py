"""Videos, pictures and cameras in: their frames, one at a time."""
