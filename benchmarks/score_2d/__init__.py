"""How well the score without truth ranks lifters: `python -m benchmarks.score_2d`."""
