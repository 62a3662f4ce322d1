"""What can be seen while a problem is solved: iterates, their convergence, their motion in Meshcat."""
