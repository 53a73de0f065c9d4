"""Measures of a moving body: joint angles and gait."""
