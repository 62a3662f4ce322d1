"""Solvers for the sparse NLP: one driver per solver, one result type for all."""
