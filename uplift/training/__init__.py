"""Lightning modules that train lifters, the stages of a fit, and their callbacks."""
