from .feedback import with_gains as with_gains
from .graded import solve_graded as solve_graded
from .graded import solve_within as solve_within
from .reference import converged_reference as converged_reference
