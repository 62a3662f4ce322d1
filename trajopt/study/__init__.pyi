from .choosing import solve_to_accuracy as solve_to_accuracy
from .choosing import solve_within as solve_within
