"""The ready lifters: fits of the included tasks, measured, and written as weights with a model card."""
