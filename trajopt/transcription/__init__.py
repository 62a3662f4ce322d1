"""From a problem to a nonlinear program: schemes, meshes, rows, derivatives, compiled code."""
