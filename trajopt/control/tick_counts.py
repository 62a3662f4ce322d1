"""What happened in the ticks of a tracker."""

from dataclasses import dataclass, field

from trajopt.control.inverse_dynamics import RELAXED


@dataclass
class TickCounts:
    """What happened so far: ticks, their programs by what was relaxed (see `RELAXED`), and times, s.

    slack: the largest of a `TickResult`.
    """

    ticks: int = 0
    relaxed: list[int] = field(default_factory=lambda: [0] * len(RELAXED))
    iterations: int = 0
    slack: float = 0.0
    times: list[float] = field(default_factory=list)
