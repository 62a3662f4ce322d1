"""Input and result that all solvers share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trajopt.solvers.status import Status

# Smallest time limit of a solver, s; it must be positive, and less allows no useful iteration.
LEAST_TIME = 1e-3
Option = str | int | float
# Called at each iteration with its figures and a function that returns the variables (empty if the solver
# does not provide them), to be called before the callback returns. False stops the solver at the iterate.
Callback = Callable[[dict[str, float], Callable[[], np.ndarray]], bool]

# Fields with the same name in the engine's output and in `Result`.
SAME_NAMES = (
    "x", "lam_g", "lam_x", "iterations", "wall_time", "function_time", "primal", "dual", "complementarity",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of a solve in scaled units; ``wall_time`` and ``function_time`` in s.

    ``lam_g`` and ``lam_x`` are multipliers of rows and bounds in the Lagrangian f + lam_g . g + lam_x . x.
    ``primal``, ``dual`` and ``complementarity`` are the solver's infeasibilities (largest entries, unscaled
    by its multipliers) at ``x``; NaN if it was not started. ``recent_primal`` is the median of ``primal``
    over the last iterations, inf if not recorded. ``figures`` are further figures of the solver.
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
        """Return the result for the engine's output ``raw``, with the given status."""
        same = {name: raw[name] for name in SAME_NAMES}
        figures = {f"{name}_time_s": raw["timings"][name][0] for name in ("factorization", "substitution")}
        figures["kkt_operations"] = raw["operations"]
        return cls(status=status, solver_status=raw["status"], objective=raw["f"], figures=figures, **same)


@dataclass(frozen=True, kw_only=True)
class WarmMultipliers:
    """Multipliers of a warm start, as in `Result`; None if there are none."""

    lam_g: np.ndarray | None = None
    lam_x: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class StoppingCriteria:
    """When a solver stops: ``tolerance`` on optimality in scaled units, limits of iterations and time (s).

    ``feasibility_share`` is the tolerance on rows as a fraction of ``tolerance``, see `Solver`.
    """

    tolerance: float = 1e-6
    max_iterations: int = 500
    max_time: float = 600.0
    feasibility_share: float = 1.0

    @property
    def feasibility(self) -> float:
        """Largest allowed violation of a row, scaled units."""
        return self.feasibility_share * self.tolerance

    def left(self, iterations: int, seconds: float) -> StoppingCriteria:
        """Return the limits left after so much is spent; the time stays positive, as solvers require."""
        return replace(
            self,
            max_iterations=max(self.max_iterations - iterations, 0),
            max_time=max(self.max_time - seconds, LEAST_TIME),
        )
