"""From a problem to a solution: one call, warm starts, sequences, refinement, references."""
