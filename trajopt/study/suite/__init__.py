"""Every problem on every robot: the pairs, their runs, the results, and comparison with earlier ones."""
