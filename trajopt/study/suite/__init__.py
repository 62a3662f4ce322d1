"""Every problem on every robot: pairs, runs, results, and comparison with earlier ones."""
