"""The commands that produce every figure in the README and the documentation."""
