"""When the SQP stops, and its options by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trajopt.errors import is_number
from trajopt.solvers.result import StoppingCriteria

# Options with what they allow; whole numbers count as numbers.
ALLOWED = {
    "early": "a number > 0, of violation in scaled units",
    "max_sqp": "a whole number of steps >= 0",
    "regularization": "a number >= 0",
}


@dataclass(frozen=True, kw_only=True)
class SqpSettings:
    """When to stop, in scaled units: ``tolerance`` of optimality, ``feasibility`` of rows; s.

    early: None, or the violation of rows at which to stop regardless of optimality, after at least one step.
    regularization: initial addition to the Hessian's diagonal.
    """

    tolerance: float
    feasibility: float
    max_iterations: int
    max_time: float
    early: float | None = None
    regularization: float = 0.0

    @classmethod
    def create(
        cls,
        options: Mapping[str, object],
        stop: StoppingCriteria,
    ) -> SqpSettings:
        """Settings with the solver's own options; raises ValueError for one unknown or not allowed."""
        for name, value in options.items():
            if name not in ALLOWED:
                raise ValueError(f"option '{name}' is unknown; allowed: {', '.join(ALLOWED)}")
            if not _is_allowed(name, value):
                raise ValueError(f"option '{name}' is {value!r}; allowed: {ALLOWED[name]}")
        given = {name: value for name, value in options.items() if isinstance(value, int | float)}
        return cls(
            tolerance=stop.tolerance,
            feasibility=stop.feasibility,
            max_iterations=min(stop.max_iterations, int(given.get("max_sqp", stop.max_iterations))),
            max_time=stop.max_time,
            early=given.get("early"),
            regularization=float(given.get("regularization", 0.0)),
        )


def _is_allowed(name: str, value: object) -> bool:
    if not is_number(value):
        return False
    if name == "max_sqp":
        return isinstance(value, int) and value >= 0
    return value > 0 if name == "early" else value >= 0
