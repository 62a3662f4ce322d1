"""Counts and times of the ticks of a tracker."""

from dataclasses import dataclass, field

from trajopt.control.inverse_dynamics import RELAXED


@dataclass
class TickCounts:
    """Ticks so far, their number by what was relaxed (see `RELAXED`), solver iterations, and times in s.

    ``slack`` is the largest one of a `TickResult`.
    """

    ticks: int = 0
    relaxed: list[int] = field(default_factory=lambda: [0] * len(RELAXED))
    iterations: int = 0
    slack: float = 0.0
    times: list[float] = field(default_factory=list)
