"""Parsers of file types, each safe on files of unknown origin."""
