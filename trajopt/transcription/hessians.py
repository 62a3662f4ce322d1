"""Names of the available Hessians of the Lagrangian."""

EXACT = "exact"
# Built from the slopes of least-squares costs, without the curvature of constraints.
GAUSS_NEWTON = "gauss-newton"
# Approximated from gradients by the solver.
LIMITED_MEMORY = "limited-memory"
HESSIANS = (EXACT, GAUSS_NEWTON, LIMITED_MEMORY)
DEFAULT_HESSIAN = EXACT
