"""What people do with uplift, one verb per file; the command line and the Python API share them."""
