"""Seeing solutions: replay, plots, and iterates while solving."""
