"""Sweeps: many fits with one command, where settings have several values; run at once, kept, scored and compared."""
