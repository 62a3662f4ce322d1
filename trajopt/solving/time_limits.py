"""Seconds beyond a solver's time limit before a caller gives up waiting."""

# Time that a solver may take to finish a step.
GRACE = 30.0
# Time for building, compiling and checking the meshes of a solve to a grade: an order of magnitude above what
# the largest robots take on a busy machine.
OVERHEAD_TIME = 600.0
