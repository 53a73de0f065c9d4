"""Settings, task files, runs: what a user says, checked where it enters."""
