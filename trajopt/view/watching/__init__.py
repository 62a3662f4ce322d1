"""Watching a solve: iterates, their convergence, their motion in Meshcat."""
