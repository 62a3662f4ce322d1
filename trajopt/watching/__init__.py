"""What can be seen while a problem is solved: iterates, their convergence, their motion in Meshcat."""

from trajopt.watching.iterate import Iterate, Watch, combined

__all__ = ["Iterate", "Watch", "combined"]
