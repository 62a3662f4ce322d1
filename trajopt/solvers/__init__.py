"""Solvers of the sparse NLP: one driver a solver, one result for all."""

from trajopt.solvers.drivers import SOLVERS, Result, run
from trajopt.solvers.status import Status

__all__ = ["SOLVERS", "Result", "Status", "run"]
