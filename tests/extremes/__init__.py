"""The matrix of extremes: every cell states the outcome that is expected of it (docs/extremes.md)."""
