"""Hessians of the Lagrangian to choose from, by name."""

EXACT = "exact"
# Of costs that are squares, without curvature of rows.
GAUSS_NEWTON = "gauss-newton"
# Approximated from gradients by the solver.
LIMITED_MEMORY = "limited-memory"
HESSIANS = (EXACT, GAUSS_NEWTON, LIMITED_MEMORY)
DEFAULT_HESSIAN = EXACT
