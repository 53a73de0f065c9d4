"""Hostile inputs by seed: damaged files of every kind and wrong words, and what the commands make of them."""
