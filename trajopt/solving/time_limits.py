"""Seconds beyond a solver's time limit before a caller gives it up."""

# That a solver may take to finish a step.
GRACE = 30.0
# For what is not the solver's in a solve to a grade: building, compiling and checking its meshes, an order of
# magnitude above what the largest robots take on a busy machine.
BESIDE = 600.0
