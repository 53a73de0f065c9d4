"""Data: containers, files they come from, cleaning, selection, tensors."""
