"""Training and prediction against the machine's own matrix-product peak, in one run."""
