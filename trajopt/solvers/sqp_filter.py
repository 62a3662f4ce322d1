"""The filter that decides which steps of an SQP are accepted.

A point is a pair: theta, the sum of violations of all rows, and f, the objective. A step is accepted if it
improves one of the two over the present point, and over every pair kept before: no penalty weighs one against
the other. Rules and constants are those of Wächter and Biegler, "On the implementation of an interior-point
filter line-search algorithm for large-scale nonlinear programming", Mathematical Programming 106, 2006,
sections 2.3 and 2.4, with the objective in place of their barrier function.
"""

from dataclasses import dataclass

# Margins by which theta, and f by theta, must improve; Armijo's constant; and the powers of the switching
# condition.
THETA_MARGIN = 1e-5
F_MARGIN = 1e-5
ARMIJO = 1e-4
SLOPE_POWER, THETA_POWER = 2.3, 1.1
# Largest theta allowed, and largest for the switching condition, as multiples of max(1, initial theta).
FURTHEST, NEAR = 10.0, 1e-4
# Relative rounding error of an objective that is a sum of thousands of terms.
ROUNDING = 1e-11


@dataclass(frozen=True)
class FilterEntry:
    """Violation of the rows and objective at a point."""

    theta: float
    f: float


class Filter:
    """Pairs that later points must improve on, of a solve that begins at ``theta``."""

    def __init__(self, theta: float, negligible: float) -> None:
        self.furthest = FURTHEST * max(1.0, theta)
        self.near = NEAR * max(1.0, theta)
        self.negligible = negligible
        self.pairs: list[FilterEntry] = []

    def keep(self, here: FilterEntry) -> None:
        """Later points must improve on ``here``."""
        new = FilterEntry((1 - THETA_MARGIN) * here.theta, here.f - F_MARGIN * here.theta)
        self.pairs = [p for p in self.pairs if p.theta < new.theta or p.f < new.f] + [new]

    def forbids(self, there: FilterEntry) -> bool:
        """Whether a kept pair is as good in both respects; a pair that is not finite is forbidden, too."""
        improves = all(there.theta <= p.theta or there.f <= p.f for p in self.pairs)
        return not (there.theta <= self.furthest and there.f < float("inf") and improves)

    def takes(self, here: FilterEntry, there: FilterEntry, slope: float, share: float) -> bool:
        """Whether the step from ``here`` by ``share`` of a direction is accepted; ``slope`` of f along it."""
        if self.forbids(there):
            return False
        noise = ROUNDING * max(1.0, abs(here.f))
        if self.about_objective(here, slope, share):
            return there.f <= here.f + ARMIJO * share * slope + noise
        if max(here.theta, there.theta) <= self.negligible:
            return there.f <= here.f + noise
        improves = there.theta <= (1 - THETA_MARGIN) * here.theta
        return improves or there.f <= here.f - F_MARGIN * here.theta

    def about_objective(self, here: FilterEntry, slope: float, share: float) -> bool:
        """Switching condition: whether a step's predicted descent makes Armijo's condition apply."""
        if not (slope < 0 and here.theta <= self.near):
            return False
        return share * (-slope) ** SLOPE_POWER > here.theta**THETA_POWER
