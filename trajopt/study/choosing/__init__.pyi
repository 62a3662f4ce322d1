from .solve_to import solve_to_accuracy as solve_to_accuracy
from .solve_to import solve_within as solve_within
