"""The time and memory of reading and writing each format."""
