"""A full-size data set: how long it takes to load, how much memory, and whether it trains as fast as a small one."""
