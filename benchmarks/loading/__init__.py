"""A full-size data set: loading time, memory, and training speed compared with a small set."""
