"""Settings, task files and run folders, checked where they are read."""
