"""Contact-constrained forward dynamics, impacts and their ranks, numerically."""
