"""Solvers of the sparse NLP: one driver a solver, one result for all."""
