"""Input and result that all solvers share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trajopt.solvers.status import Status

# A solver's limit of time is positive, s; with less than this it makes no useful iteration.
LEAST_TIME = 1e-3
Option = str | int | float
# Called at every iteration with its figures and a function that returns the variables there (empty where the
# solver does not give them), to be called before the callback returns. False stops at the iterate.
Callback = Callable[[dict[str, float], Callable[[], np.ndarray]], bool]

# Figures with the same name in the engine's outcome of a solve and in the result.
SAME_NAMES = (
    "x", "lam_g", "lam_x", "iterations", "wall_time", "function_time", "primal", "dual", "complementarity",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Result:
    """Outcome of a solve in scaled units; ``wall_time`` and ``function_time`` in s.

    lam_g, lam_x: multipliers of rows and bounds, of the Lagrangian f + lam_g . g + lam_x . x.
    recent_primal: median of primal over the last iterations, where they were watched.
    primal, dual, complementarity: the solver's own infeasibilities (largest entries, unscaled by its
    multipliers) at ``x``; NaN where it was not started. figures: further figures of the solver.
    """

    x: np.ndarray
    lam_g: np.ndarray
    lam_x: np.ndarray
    status: Status
    solver_status: str
    iterations: int
    objective: float
    wall_time: float
    function_time: float
    primal: float = math.nan
    dual: float = math.nan
    complementarity: float = math.nan
    recent_primal: float = math.inf
    figures: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_engine(cls, raw: Mapping[str, Any], status: Status) -> Result:
        """The result of a solve by the engine, as it returns it, with what its status means."""
        same = {name: raw[name] for name in SAME_NAMES}
        figures = {f"{name}_time_s": raw["timings"][name][0] for name in ("factorization", "substitution")}
        figures["kkt_operations"] = raw["operations"]
        return cls(status=status, solver_status=raw["status"], objective=raw["f"], figures=figures, **same)


@dataclass(frozen=True, kw_only=True)
class WarmMultipliers:
    """Multipliers of a warm start, as `Result`'s; None where there are none."""

    lam_g: np.ndarray | None = None
    lam_x: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class StoppingCriteria:
    """When a solver stops: ``tolerance`` of optimality in scaled units, iterations, s.

    feasibility_share: the tolerance on rows as a fraction of it, see `Solver`.
    """

    tolerance: float = 1e-6
    max_iterations: int = 500
    max_time: float = 600.0
    feasibility_share: float = 1.0

    @property
    def feasibility(self) -> float:
        """Largest violation of a row, scaled units."""
        return self.feasibility_share * self.tolerance

    def left(self, iterations: int, seconds: float) -> StoppingCriteria:
        """What is left of the limits after so much; never no time at all, which solvers refuse."""
        return replace(
            self,
            max_iterations=max(self.max_iterations - iterations, 0),
            max_time=max(self.max_time - seconds, LEAST_TIME),
        )
